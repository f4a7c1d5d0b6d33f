"""What stands around an arm, as its controller knows it: it acts on the arm in every control period, and brings the cell's program."""

import logging
from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np

from monitor.recording import Array
from monitor.simulate.machine.journal import CLIENT, SIMULATOR, SOMEBODY_ELSE, ExceptionMessage, ProgramMessage
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.moves import PROGRAM_STOP_RAD_S2, Move
from monitor.simulate.machine.registers import Recipe
from monitor.simulate.machine.state import Runtime
from monitor.simulate.polyscope import Version, X
from monitor.simulate.program.control import ControlProgram
from monitor.simulate.program.language import ScriptError, Source
from monitor.simulate.program.player import CellProgram, Program, ScriptProgram
from monitor.simulate.program.scripts import ControlScript, Refused, parse
from monitor.simulate.program.steps import Step
from monitor.simulate.program_tree import Host, ProgramTree


class Surroundings(Protocol):
    """A cell around one arm. The steps of its program may ask for the state of the machine."""

    name: str

    def program(self, machine: Machine) -> Iterator[Step]:
        """The steps of the cell's program from its beginning, as at Play."""

    def step(self, machine: Machine) -> None:
        """Act on the arm: grip, press, lead it by the hand."""

    def wrench(self, machine: Machine) -> Array:
        """(6,) force [N] and torque [N·m] that the controller shows as `actual_TCP_force`."""


# --- The program files of a controller. They are in memory: two programs that a cell may run by itself, and the one that is loaded ---

FOLDERS = ("", "/programs/", "/ursim/programs/")  # where a file may be said to be: on an arm, and in the manufacturer's own simulator
INSTALLATIONS = frozenset({"default.installation"})
SCRIPT_PROGRAM = "rtde_control.urp"  # what is loaded at first; programs that come over a script port are reported under the loaded name
PROGRAMS = {  # file name → what it does
    "wait_program.urp": "def wait_program():\n  while True:\n    sleep(1.0)\n  end\nend",
    "back_and_forth.urp": (
        "def back_and_forth():\n"
        "  here = get_target_joint_positions()\n"
        "  there = here + [0, 0, 0, 0, 0, 0.4]\n"
        "  while True:\n"
        "    movej(there, a=1.0, v=0.5)\n"
        "    movej(here, a=1.0, v=0.5)\n"
        "  end\n"
        "end"
    ),
}


class ProgramFiles:
    """The files of one controller. `loaded` is the name of the loaded program."""

    def __init__(self, version: Version, tree: ProgramTree | None = None, *, of_cell: str | None = None) -> None:
        """A production program is loaded at first if one is given.

        of_cell : name of the program of the cell around the arm, which is then loaded at first; None if the arm stands in none.
        """
        self._of_cell = None if of_cell is None else f"{of_cell}.urp"
        self._version = version
        self._trees = {} if tree is None else {f"{tree.name}.urp": tree}
        self.loaded = self._of_cell or next(iter(self._trees), SCRIPT_PROGRAM)
        self._served: Mapping[Host, str | None] = {}

    def load(self, path: str) -> bool:
        """Load a program. Returns False if there is no such file."""
        name = self._name(path)
        found = name in self.names
        if found:
            self.loaded = name
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all program files."""
        return (*(() if self._of_cell is None else (self._of_cell,)), *self._trees, *PROGRAMS)

    @property
    def cell_loaded(self) -> bool:
        """Whether the program of the cell is the one that is loaded."""
        return self.loaded == self._of_cell

    @property
    def hosts(self) -> tuple[Host, ...]:
        """The hosts that the loaded program asks for text at Play."""
        return self._trees[self.loaded].hosts if self.loaded in self._trees else ()

    def serve(self, served: Mapping[Host, str | None]) -> None:
        """Take over what the hosts answered; None where one did not."""
        self._served = served

    def has_installation(self, path: str) -> bool:
        """Whether there is an installation file of this name."""
        return self._name(path) in INSTALLATIONS

    @property
    def program(self) -> Source | Refused | None:
        """The loaded program, made into a script as at Play; None if only scripts have run so far."""
        if self.loaded in self._trees:
            text = self._trees[self.loaded].script(self._served, silent=self._version.major >= X)
        elif self.loaded in PROGRAMS:
            text = PROGRAMS[self.loaded]
        else:
            return None
        script = parse(text, recognise=False, version=self._version)
        return script if isinstance(script, Source | Refused) else None

    @staticmethod
    def _name(path: str) -> str:
        folder, slash, name = path.rpartition("/")
        return name if folder + slash in FOLDERS else path


# --- A program that somebody else starts on the controller: from the pendant, or by another machine -----

SWAY_RAD, SWAY_RAD_S, SWAY_RAD_S2 = 0.1, 0.2, 0.5  # it moves all joints gently to and fro


class ForeignProgram(Program):
    """Plays for a time. It moves the arm to and fro from where it stood, or only plays."""

    def __init__(self, machine: Machine, seconds: float, *, moves: bool) -> None:
        self._machine, self._moves = machine, moves
        self._until_s = machine.clock.now_s + seconds
        self._home = machine.reference.q.copy()
        self._away = False

    def step(self) -> bool:
        """Play on. Returns False when the time is over."""
        machine = self._machine
        if machine.clock.now_s >= self._until_s:
            return False
        if self._moves and machine.modes.may_move and machine.moves.over:
            self._away = not self._away
            inwards = -np.where(self._home < 0.0, -1.0, 1.0)  # never against the end of a joint
            goal = self._home + (SWAY_RAD * inwards if self._away else 0.0)
            machine.moves.start(Move(tuple(goal.tolist()), pose=False, straight=False, speed=SWAY_RAD_S, acceleration=SWAY_RAD_S2))
        return True


# --- The program that runs on a controller: what starts, pauses and ends it -----------------------------

log = logging.getLogger(__name__)

FOREIGN_NAME = "cell"  # of a program that somebody else starts


class Programs:
    """Runs at most one program at a time on one machine. `current` is the program, or None."""

    def __init__(self, machine: Machine, surroundings: Surroundings | None = None) -> None:
        """`surroundings` is the cell whose program is loaded; None if the arm stands in none."""
        self._machine, self._surroundings = machine, surroundings
        self.current: Program | None = None
        self._full_speed_at_s = 0.0  # until this time after a start, `speed_scaling` is 0
        self.files = ProgramFiles(
            machine.settings.polyscope,
            machine.settings.program,
            of_cell=None if surroundings is None else surroundings.name,
        )
        self._name = ""  # of the present program

    def step(self) -> None:
        """Run the program for one control period."""
        machine = self._machine
        if machine.watchdog.expired:
            machine.journal.watchdog_trips += 1
            if machine.watchdog.action == "pause":
                machine.watchdog.clear()
                self.pause()
                return
            self.stop(f"{machine.watchdog.variable} was not received for {machine.watchdog.limit_s:.3g} s", kind="watchdog", by="watchdog")
        if self.current is None or machine.modes.runtime != Runtime.PLAYING:
            return
        try:
            if not self.current.step():
                self.stop("the program ended", kind="program_end", by="itself")
        except ScriptError as wrong:
            self.fail(wrong.text, wrong.line, wrong.column)

    def received(self, written: Recipe) -> None:
        """Note that a packet of inputs arrived."""
        self._machine.watchdog.received(written.names)
        if self.current is not None and self.current.command_register in written.names:
            self.current.received()

    def start(self, script: ControlScript | Source | Refused, owner: str = CLIENT) -> None:
        """Start a program in place of the one that runs, or refuse it. A secondary program runs at once beside the other."""
        machine = self._machine
        reason = script.reason if isinstance(script, Refused) else machine.modes.obstacle
        if reason or isinstance(script, Refused):
            log.warning("script refused: %s", reason)
            machine.journal.refused_scripts.append(reason)
            if isinstance(script, Refused) and script.report:
                machine.journal.tell(ExceptionMessage, script.report, script.line, script.column)
            return
        if isinstance(script, Source) and script.secondary:
            self._run_beside(script)
            return
        self.stop("replaced by another script", by=owner)
        machine.journal.scripts_started += 1
        program = ControlProgram(script, machine) if isinstance(script, ControlScript) else ScriptProgram(script, machine)
        self._begin(program, script.name, owner)

    def _begin(self, program: Program, name: str, owner: str) -> None:
        """Play a program, and report its name."""
        machine = self._machine
        machine.journal.logbook.program_began(owner)
        self.current, self._name = program, name
        machine.modes.runtime = Runtime.PLAYING
        self._full_speed_at_s = machine.clock.now_s + machine.personality.start_s()
        machine.journal.tell(ProgramMessage, "PROGRAM_XXX_STARTED", name)

    def _run_beside(self, script: Source) -> None:
        """Run a secondary program at once. The program that runs goes on."""
        try:
            ScriptProgram(script, self._machine).instant()
        except ScriptError as wrong:
            self._machine.journal.tell(ExceptionMessage, wrong.text, wrong.line, wrong.column)

    @property
    def speed_scaling(self) -> float:
        """The share of full speed at which a program plays, 0 … 1: 0 while none plays, and at first after a program's start."""
        machine = self._machine
        if machine.modes.runtime != Runtime.PLAYING or machine.clock.now_s < self._full_speed_at_s:
            return 0.0
        return machine.registers.speed_fraction

    def start_foreign(self, seconds: float, *, moves: bool) -> None:
        """Start a program of somebody else in place of the one that runs, unless the arm may not move."""
        machine = self._machine
        if machine.modes.obstacle:
            return
        self.stop("replaced by somebody else's program", by=SOMEBODY_ELSE)
        self._begin(ForeignProgram(machine, seconds, moves=moves), FOREIGN_NAME, SOMEBODY_ELSE)

    def start_stepped(self) -> str:
        """Reserve the arm for a stepped replay. Returns why this is not possible, or an empty text."""
        obstacle = self._machine.modes.obstacle or ("a program is running" if self.current is not None else "")
        if not obstacle:
            self.current, self._name = Program(), "stepped"
            self._machine.journal.logbook.program_began(SIMULATOR)
            self._machine.modes.runtime = Runtime.PLAYING
        return obstacle

    def fail(self, text: str, line: int = 1, column: int = 1) -> None:
        """End the program by a runtime exception at this place of its script."""
        self.stop(f"runtime exception: {text}", by="itself", exception=(text, line, column))

    def stop(
        self, reason: str, *, kind: str = "program_stop", by: str = "controller", exception: tuple[str, int, int] | None = None
    ) -> bool:
        """End the program; the arm decelerates to standstill. Returns False if no program was running.

        by : who did it, for the logbook. exception : that ended it, with its line and column.
        """
        machine, reference = self._machine, self._machine.reference
        if self.current is None:
            return False
        machine.journal.stop(kind, reason)
        machine.journal.logbook.program_ended(kind, by, reason)
        if exception is not None:
            machine.journal.tell(ExceptionMessage, *exception)
        machine.journal.tell(ProgramMessage, "PROGRAM_XXX_STOPPED", self._name)
        self.current = None
        machine.modes.runtime = Runtime.STOPPED
        machine.watchdog.clear()
        machine.modes.popup = ""
        machine.moves.forget()
        machine.compliance.end()
        if reference.mode != "stop" or reference.queued:
            reference.stop(PROGRAM_STOP_RAD_S2)
        return True

    def pause(self) -> bool:
        """Pause the program; the arm stops. Returns False if no program was playing."""
        machine = self._machine
        if machine.modes.runtime != Runtime.PLAYING:
            return False
        machine.modes.runtime = Runtime.PAUSED
        machine.moves.interrupt()
        machine.reference.stop(PROGRAM_STOP_RAD_S2)
        return True

    def play(self) -> bool:
        """Continue a paused program, or start the one that is loaded. Returns False if there is none or the arm may not move."""
        machine = self._machine
        if not machine.modes.may_move:
            return False
        if machine.modes.runtime != Runtime.PAUSED:
            if self.current is None and self._surroundings is not None and self.files.cell_loaded:
                name = self._surroundings.name
                self._begin(CellProgram(self._surroundings.program(machine), machine), name, SOMEBODY_ELSE)
                return True
            loaded = self.files.program
            if self.current is not None or loaded is None:
                return False
            self.start(loaded, SOMEBODY_ELSE)
            return not isinstance(loaded, Refused)
        machine.modes.runtime = Runtime.PLAYING
        machine.watchdog.feed()
        machine.moves.resume()
        return True
