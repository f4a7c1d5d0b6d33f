"""Motions that a program renews in every control period: servoj, speedj and speedl."""

import itertools
import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from itertools import chain

import numpy as np

from monitor.recording import Array
from monitor.simulate.machine.journal import TextMessage
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.moves import PROGRAM_STOP_RAD_S2, Move, StopMotion
from monitor.simulate.machine.state import ASKED
from monitor.simulate.program import queries
from monitor.simulate.program.interpreter import Execution, Halted
from monitor.simulate.program.language import ScriptError, Source
from monitor.simulate.program.steps import (
    Critical,
    Declare,
    ForceMode,
    Freedrive,
    Join,
    Kill,
    Output,
    PathProgress,
    Popup,
    ProtectiveStop,
    Run,
    Say,
    Servo,
    Speed,
    Step,
    Wait,
    Watch,
    Write,
    takes_time,
)

SERVO_TIME_MIN_S, SERVO_TIME_MAX_S = 1e-4, 10.0  # range of servoj's argument `time`; a shorter time means one control period
LOOKAHEAD_S, GAIN = (0.03, 0.2), (100.0, 2000.0)  # documented ranges of servoj's arguments


def follow(machine: Machine, targets: Sequence[Sequence[float]], time_s: float, lookahead_s: float, gain: float) -> bool:
    """Give targets (J,) of servoj, oldest first, to the reference. Returns False if they lead to a protective stop."""
    if not all(map(math.isfinite, (*chain.from_iterable(targets), time_s, lookahead_s, gain))):
        machine.supervisor.protective_stop("servoj with a target that is not a number")
        return False
    jump = machine.moves.sudden(targets[-1]) if targets else None
    if jump:
        machine.supervisor.protective_stop(f"servoj: {jump.text}", joint=jump.joint)
        return False
    time_s = min(time_s, SERVO_TIME_MAX_S) if time_s > SERVO_TIME_MIN_S else 0.0
    lookahead_s, gain = min(max(lookahead_s, LOOKAHEAD_S[0]), LOOKAHEAD_S[1]), min(max(gain, GAIN[0]), GAIN[1])
    machine.reference.follow([list(target) for target in targets], time_s, lookahead_s, gain)
    return True


def joint_speed(machine: Machine, wanted: Array, acceleration: float) -> None:
    """Give the speed of speedj (J,) [rad/s] to the reference. A figure that is not finite is a protective stop."""
    if np.isfinite(wanted).all() and math.isfinite(acceleration):
        machine.reference.speed(wanted, acceleration)
    else:
        machine.supervisor.protective_stop("speedj with a target that is not a number")


def tool_speed(machine: Machine, wanted: Array, acceleration: float) -> None:
    """Give the speed of speedl (6,) [m/s, rad/s] along the base's axes to the reference.

    A figure that is not finite is a protective stop.
    """
    if np.isfinite(wanted).all() and math.isfinite(acceleration):
        machine.moves.tool_speed(wanted, acceleration)
    else:
        machine.supervisor.protective_stop("speedl with a target that is not a number")


# --- Programs that are a sequence of steps --------------------------------------------------------------

MOTIONS = (Move, Servo, Speed)


class Program:
    """What plays on a controller. This one does nothing: a stepped replay moves the reference itself, and no other program starts."""

    command_register = ""  # the input whose packets the program is told of

    def received(self) -> None:
        """Note that a packet with the command register has arrived."""

    def step(self) -> bool:
        """Play on for a control period. Returns False when the program has ended. Raises ScriptError for a runtime exception."""
        return True


class Player:
    """Plays the steps of one thread. A script's move comes to rest at its end: only the programs of cells have blend radii."""

    def __init__(
        self,
        steps: Iterable[Step],
        machine: Machine,
        on_progress: Callable[[int], None] = lambda _: None,
        threads: "ScriptProgram | None" = None,
        *,
        waits_for_arm: bool = True,
    ) -> None:
        """`on_progress` receives the numbers of the path's progress signals; `threads` is what the thread asks of the others.

        `waits_for_arm` tells whether the first step waits until the motion before it has ended.
        """
        self._left: Iterator[Step] = iter(steps)
        self._machine, self._on_progress, self._threads = machine, on_progress, threads
        self._held: Step | None = None  # a motion that begins when the arm may move
        self._answer: int | None = None  # what the next step is told about the last one
        self._waits: Callable[[], bool] = lambda: machine.moves.over or not waits_for_arm  # tells whether the present step has ended
        self.moves = False  # whether the present step moves the arm

    def over(self) -> bool:
        """Play as many steps as possible now. Returns whether all steps have ended.

        Raises ScriptError where a real controller raises a runtime exception, and Halted where the program says `halt`.
        """
        while self._waits():
            self.moves = False
            step = self._held or self._next()
            if step is None:
                return True
            self._held = step if isinstance(step, MOTIONS) and not self._machine.modes.may_move else None
            if self._held is not None:
                return False
            self._play(step)
            if takes_time(step) and not isinstance(step, Move | StopMotion):
                return False  # a wait lasts at least until the next control period
        return False

    def instant(self) -> None:
        """Play all steps at once, as a secondary program. Raises ScriptError for a step that takes time."""
        while (step := self._next()) is not None:
            if takes_time(step):
                raise ScriptError("a secondary program may take no time; this one moves or waits")
            self._play(step)

    def abandon(self) -> None:
        """Leave the present step. A motion of it ends in a stop."""
        if self.moves:
            self._machine.reference.stop(PROGRAM_STOP_RAD_S2)
        self.moves = False

    def _next(self) -> Step | None:
        answer, self._answer = self._answer, None
        try:
            return self._left.send(answer) if isinstance(self._left, Generator) else next(self._left)
        except StopIteration:
            return None

    def _wait(self, seconds: float) -> None:
        """Wait this long, and no less than until the next control period."""
        clock = self._machine.clock
        until_s = clock.now_s + max(seconds, 0.0) - 0.5 * clock.tick_s
        self._waits = lambda: clock.now_s >= until_s

    def _play(self, step: Step) -> None:
        machine = self._machine
        match step:
            case Move() | Servo() | Speed():
                self._begin(step)
            case StopMotion() as stop:
                self.moves, self._waits = True, lambda: machine.moves.over
                machine.moves.stop(stop)
            case Run() | Kill() | Join() | Critical():
                self._ask(step)
            case Popup(text, blocking):
                machine.modes.popup = text
                if blocking:
                    self._waits = lambda: not machine.modes.popup
                else:
                    self._wait(0.0)
            case Watch(variable, frequency, action):
                machine.watchdog.watch(variable, frequency, action)
            case Write(register, value, whole):
                if whole:
                    machine.registers.output_ints[register] = int(value)
                else:
                    machine.registers.output_doubles[register] = value
            case PathProgress(value):
                self._on_progress(value)
            case Wait(seconds):
                self._wait(seconds)
            case Say(text):
                machine.journal.tell(TextMessage, text)
            case Output(number, on):
                bits = machine.registers.outputs
                bits.digital = bits.digital | 1 << number if on else bits.digital & ~(1 << number)
            case Declare(what, figures):
                _declare(machine, what, figures)
            case ForceMode(comply):
                machine.compliance.comply(comply)
            case Freedrive(begins):
                machine.compliance.freedrive = begins
            case ProtectiveStop():
                machine.supervisor.protective_stop("asked for by the program", ASKED)

    def _ask(self, step: Run | Kill | Join | Critical) -> None:
        """Start, end or wait for another thread, or keep the others from running."""
        if self._threads is None:
            raise ScriptError("runtime_error: threads are not available here")
        match step:
            case Run(name):
                self._answer = self._threads.start(name)
            case Kill(number):
                self._threads.kill(number)
            case Join(number):
                threads = self._threads
                self._waits = lambda: not threads.runs(number)
            case Critical(begins):
                self._threads.hold(self if begins else None)

    def _begin(self, step: Move | Servo | Speed) -> None:
        """Begin a motion. Raises ScriptError where another thread moves the arm."""
        if self._threads is not None and self._threads.others_move(self):
            raise ScriptError("runtime_error: another thread is already controlling the robot")
        self.moves = True
        match step:
            case Move():
                self._move(step)
            case Servo():
                follow(self._machine, [list(step.target)], step.seconds, step.lookahead_s, step.gain)
                self._wait(max(step.seconds, self._machine.clock.tick_s))
            case Speed():
                self._speed(step)

    def _speed(self, step: Speed) -> None:
        machine, wanted = self._machine, np.array(step.speed)
        if step.straight:
            tool_speed(machine, wanted, step.acceleration)
        else:
            joint_speed(machine, wanted, step.acceleration)
        if step.seconds > 0.0:
            self._wait(step.seconds)
        elif step.straight:
            self._wait(machine.clock.tick_s)
        else:
            top = machine.robot.max_speed_rad_s
            self._waits = lambda: bool(np.allclose(machine.reference.qd, np.clip(wanted, -top, top), atol=1e-6))

    def _move(self, move: Move) -> None:
        """Start a move. A tool pose that a movel cannot reach leads to a protective stop, and any other obstacle to an exception."""
        machine = self._machine
        self._waits = lambda: machine.moves.flows(move.blend_m)
        obstacle = machine.moves.start(move)
        if obstacle and move.straight and move.pose and machine.moves.inverse(np.array(move.target)) is None:
            machine.supervisor.protective_stop(f"movel: {obstacle}", ASKED)
        elif obstacle:
            self._left = iter(())
            raise ScriptError(f"runtime_error: {'movel' if move.straight else 'movej'}: {obstacle}")


def _declare(machine: Machine, what: str, figures: tuple[float, ...]) -> None:
    """Do what a set_payload, set_target_payload, set_tcp or set_gravity asks for. Raises ScriptError if it is impossible."""
    try:
        queries.DECLARATIONS[what](machine, list(figures))
    except (ValueError, IndexError) as wrong:
        raise ScriptError(f"runtime_error: {what}: {wrong}") from None


class CellProgram(Program):
    """The program of a cell, made of steps and not of a script."""

    def __init__(self, steps: Iterable[Step], machine: Machine) -> None:
        self._player = Player(steps, machine)

    def step(self) -> bool:
        """Play on. Raises as `Player.over`."""
        return not self._player.over()


# --- A program in URScript that plays: its main thread, and the threads that it starts ------------------

MAIN = 0  # number of the main thread; a program may compare the number of a thread with 0
THREADS_MAX = 32


class ScriptProgram(Program):
    """A program in URScript. It ends with its main thread; its threads take turns in every control period, the oldest first."""

    def __init__(self, program: Source, machine: Machine) -> None:
        self._execution, self._machine = Execution(program, machine), machine
        self._numbers = itertools.count(MAIN + 1)
        self._players = {MAIN: Player(self._execution.main(), machine, threads=self)}
        self._alone: Player | None = None  # the thread in a critical section

    def step(self) -> bool:
        """Play on. Returns False when the program has ended. Raises ScriptError where a controller raises a runtime exception."""
        try:
            for number, player in list(self._players.items()):
                if number in self._players and self._alone in (None, player) and player.over():
                    self._end(number)
        except Halted:
            return False
        return MAIN in self._players

    def instant(self) -> None:
        """Play all steps at once, as a secondary program. Raises ScriptError for a step that takes time."""
        try:
            self._players[MAIN].instant()
        except Halted:
            return

    # --- what a thread asks of the others ----------------------------------------------------------------------
    def start(self, name: str) -> int:
        """Start a thread. Returns its number. Raises ScriptError for too many threads."""
        if len(self._players) >= THREADS_MAX:
            raise ScriptError(f"runtime_error: more than {THREADS_MAX} threads")
        number = next(self._numbers)
        self._players[number] = Player(self._execution.thread(name), self._machine, threads=self, waits_for_arm=False)
        return number

    def kill(self, number: int) -> None:
        """End a thread; its motion ends in a stop. A number that no thread has ends nothing."""
        if number in self._players and number != MAIN:
            self._players[number].abandon()
            self._end(number)

    def runs(self, number: int) -> bool:
        """Whether a thread has not ended."""
        return number in self._players

    def hold(self, alone: Player | None) -> None:
        """Let only this thread run, or all again."""
        self._alone = alone

    def others_move(self, player: Player) -> bool:
        """Whether a thread beside this one moves the arm."""
        return any(other.moves for other in self._players.values() if other is not player)

    def _end(self, number: int) -> None:
        if self._alone is self._players.pop(number):
            self._alone = None
