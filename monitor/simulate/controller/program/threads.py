"""A program in URScript that plays: its main thread, and the threads that it starts."""

import itertools

from monitor.simulate.controller.program.interpreter import Execution, Halted
from monitor.simulate.controller.program.language import ScriptError, Source
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.player import Player

MAIN = 0  # number of the main thread; a program may compare the number of a thread with 0
THREADS_MAX = 32


class ScriptProgram:
    """A program in URScript. It ends with its main thread; its threads take turns in every control period, the oldest first."""

    command_register = ""

    def __init__(self, program: Source, machine: Machine) -> None:
        self._execution, self._machine = Execution(program, machine), machine
        self._numbers = itertools.count(MAIN + 1)
        self._players = {MAIN: Player(self._execution.main(), machine, threads=self)}
        self._alone: Player | None = None  # the thread in a critical section

    def received(self) -> None:
        """Input packets do not matter to a program that reads registers."""

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
