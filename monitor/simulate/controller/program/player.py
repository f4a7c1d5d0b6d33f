"""Programs that are a list of steps."""

import math
from collections import deque
from collections.abc import Callable

from monitor.simulate.controller.moves import Move, StopMotion
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.scripts import PathProgress, Step, Steps, Wait, Write


class Player:
    """Plays a list of steps. Every move comes to rest at its end: blend radii are not modelled."""

    def __init__(self, steps: tuple[Step, ...], machine: Machine, on_progress: Callable[[int], None] = lambda _: None) -> None:
        """`on_progress` receives the numbers of the path's progress signals."""
        self._left, self._machine, self._on_progress = deque(steps), machine, on_progress
        self._until_s = -math.inf  # the end of the present wait

    def over(self) -> bool:
        """Play as many steps as possible now. Returns whether all steps have ended."""
        machine = self._machine
        while machine.moves.over and machine.clock.now_s >= self._until_s:
            if not self._left:
                return True
            if isinstance(self._left[0], Move) and not machine.modes.may_move:
                return False
            if not self._play(self._left.popleft()):
                return False
        return False

    def _play(self, step: Step) -> bool:
        """Start one step. Returns False if the arm cannot make it: this ends the program."""
        machine = self._machine
        match step:
            case Move() as move:
                obstacle = machine.moves.start(move)
                if obstacle:
                    self._left.clear()
                    machine.supervisor.stop_program(f"runtime exception: {obstacle}")
                    return False
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
        return True


class StepsProgram:
    """A program that is a list of steps. It ends after the last step."""

    command_register = ""

    def __init__(self, script: Steps, machine: Machine) -> None:
        self._player = Player(script.steps, machine)

    def received(self) -> None:
        """Input packets do not matter to a program without a command register."""

    def step(self) -> bool:
        """Play on. Returns False when the program has ended."""
        return not self._player.over()


class SteppedProgram:
    """A program that does nothing. A stepped replay moves the reference itself and runs this program, so that no other one starts."""

    command_register = ""

    def received(self) -> None:
        """Input packets do not matter to a program without a command register."""

    def step(self) -> bool:
        """Run until somebody stops the program."""
        return True
