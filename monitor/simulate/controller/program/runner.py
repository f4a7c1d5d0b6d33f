"""The program that runs on a controller: what starts, pauses and ends it."""

import logging

from monitor.simulate.controller.logbook import CLIENT, SIMULATOR, SOMEBODY_ELSE
from monitor.simulate.controller.modes import Runtime
from monitor.simulate.controller.moves import PROGRAM_STOP_RAD_S2
from monitor.simulate.controller.program.control import ControlProgram
from monitor.simulate.controller.program.files import ProgramFiles
from monitor.simulate.controller.program.foreign import ForeignProgram
from monitor.simulate.controller.program.language import ScriptError, Source
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.player import CellProgram, SteppedProgram
from monitor.simulate.controller.program.scripts import ControlScript, Refused
from monitor.simulate.controller.program.surroundings import Surroundings
from monitor.simulate.controller.program.threads import ScriptProgram
from monitor.simulate.controller.registers import Recipe
from monitor.simulate.polyscope import X

log = logging.getLogger(__name__)

EXCEPTION = "runtime exception"  # how the reason of a stop begins when a program made a mistake
FOREIGN_NAME = "cell"  # of a program that somebody else starts

Program = ControlProgram | ScriptProgram | SteppedProgram | ForeignProgram | CellProgram


class Programs:
    """Runs at most one program at a time on one machine. `current` is the program, or None."""

    def __init__(self, machine: Machine, surroundings: Surroundings | None = None) -> None:
        """`surroundings` is the cell whose program is loaded; None if the arm stands in none."""
        self._machine, self._surroundings = machine, surroundings
        self.current: Program | None = None
        self._full_speed_at_s = 0.0  # until this time after a start, `speed_scaling` is 0
        self.files = ProgramFiles(
            machine.settings.program,
            silent=machine.settings.polyscope.major >= X,
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
            self.stop(f"{EXCEPTION}: {wrong.text}", by="itself", place=(wrong.line, wrong.column))

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
                machine.journal.exception_message(script.report, script.line, script.column)
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
        machine.modes.play()
        self._full_speed_at_s = machine.clock.now_s + machine.personality.start_s()
        machine.journal.program_message("PROGRAM_XXX_STARTED", name)

    def _run_beside(self, script: Source) -> None:
        """Run a secondary program at once. The program that runs goes on."""
        try:
            ScriptProgram(script, self._machine).instant()
        except ScriptError as wrong:
            self._machine.journal.exception_message(wrong.text, wrong.line, wrong.column)

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
            self.current, self._name = SteppedProgram(), "stepped"
            self._machine.journal.logbook.program_began(SIMULATOR)
            self._machine.modes.play()
        return obstacle

    def stop(self, reason: str, *, kind: str = "program_stop", by: str = "controller", place: tuple[int, int] = (1, 1)) -> bool:
        """End the program; the arm decelerates to standstill. `by` is for the logbook. Returns False if no program was running.

        A reason that begins with EXCEPTION is reported with its place in the script: line and column.
        """
        machine, reference = self._machine, self._machine.reference
        if self.current is None:
            return False
        machine.journal.stop(kind, reason)
        machine.journal.logbook.program_ended(kind, by, reason)
        if reason.startswith(EXCEPTION):
            machine.journal.exception_message(reason.removeprefix(f"{EXCEPTION}: "), *place)
        machine.journal.program_message("PROGRAM_XXX_STOPPED", self._name)
        self.current = None
        machine.modes.end_program()
        machine.watchdog.clear()
        machine.modes.popup = ""
        machine.moves.forget()
        machine.giving.end()
        if reference.mode != "stop" or reference.queued:
            reference.stop(PROGRAM_STOP_RAD_S2)
        return True

    def pause(self) -> bool:
        """Pause the program; the arm stops. Returns False if no program was playing."""
        machine = self._machine
        if machine.modes.runtime != Runtime.PLAYING:
            return False
        machine.modes.pause()
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
        machine.modes.play()
        machine.watchdog.feed()
        machine.moves.resume()
        return True
