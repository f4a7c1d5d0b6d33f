"""Programs that are a sequence of steps."""

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import chain

import numpy as np

from monitor.simulate.controller.codes import ASKED
from monitor.simulate.controller.moves import Move, StopMotion
from monitor.simulate.controller.program import queries
from monitor.simulate.controller.program.interpreter import run
from monitor.simulate.controller.program.language import ScriptError, Source
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.steps import Declare, Output, PathProgress, ProtectiveStop, Say, Step, Wait, Write, takes_time


class Player:
    """Plays steps. Every move comes to rest at its end: blend radii are not modelled."""

    def __init__(self, steps: Iterable[Step], machine: Machine, on_progress: Callable[[int], None] = lambda _: None) -> None:
        """`on_progress` receives the numbers of the path's progress signals."""
        self._left: Iterator[Step] = iter(steps)
        self._machine, self._on_progress = machine, on_progress
        self._until_s = -math.inf  # the end of the present wait

    def over(self) -> bool:
        """Play as many steps as possible now. Returns whether all steps have ended.

        Raises ScriptError where a real controller raises a runtime exception.
        """
        machine = self._machine
        while machine.moves.over and machine.clock.now_s >= self._until_s:
            step = next(self._left, None)
            if step is None:
                return True
            if isinstance(step, Move) and not machine.modes.may_move:
                self._left = chain((step,), self._left)
                return False
            self._play(step)
            if takes_time(step) and not isinstance(step, Move | StopMotion):
                return False  # a wait lasts at least until the next control period
        return False

    def instant(self) -> None:
        """Play all steps at once, as a secondary program. Raises ScriptError for a step that takes time."""
        for step in self._left:
            if takes_time(step):
                raise ScriptError("a secondary program may take no time; this one moves or waits")
            self._play(step)

    def _play(self, step: Step) -> None:
        machine = self._machine
        match step:
            case Move() as move:
                self._move(move)
            case StopMotion() as stop:
                machine.moves.stop(stop)
            case Write(register, value, whole):
                if whole:
                    machine.registers.output_ints[register] = int(value)
                else:
                    machine.registers.output_doubles[register] = value
            case PathProgress(value):
                self._on_progress(value)
            case Wait(seconds):
                self._until_s = machine.clock.now_s + seconds
            case Say(text):
                machine.journal.text_message(text)
            case Output(number, on):
                bits = machine.registers.outputs
                bits.digital = bits.digital | 1 << number if on else bits.digital & ~(1 << number)
            case Declare(what, figures):
                _declare(machine, what, figures)
            case ProtectiveStop():
                machine.supervisor.protective_stop("asked for by the program", ASKED)

    def _move(self, move: Move) -> None:
        """Start a move. A tool pose that a movel cannot reach leads to a protective stop, and any other obstacle to an exception."""
        machine = self._machine
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
    except (queries.ImpossibleArguments, ValueError, IndexError) as wrong:
        raise ScriptError(f"runtime_error: {what}: {wrong}") from None


class StepsProgram:
    """A program in URScript. It ends after the last step."""

    command_register = ""

    def __init__(self, program: Source, machine: Machine) -> None:
        self._player = Player(run(program, machine), machine)

    def received(self) -> None:
        """Input packets do not matter to a program without a command register."""

    def step(self) -> bool:
        """Play on. Returns False when the program has ended. Raises ScriptError where a controller raises a runtime exception."""
        return not self._player.over()

    def instant(self) -> None:
        """Play all steps at once, as a secondary program. Raises ScriptError for a step that takes time."""
        self._player.instant()


class SteppedProgram:
    """A program that does nothing. A stepped replay moves the reference itself and runs this program, so that no other one starts."""

    command_register = ""

    def received(self) -> None:
        """Input packets do not matter to a program without a command register."""

    def step(self) -> bool:
        """Run until somebody stops the program."""
        return True
