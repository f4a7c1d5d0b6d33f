"""A program that somebody else starts on the controller: from the pendant, or by another machine."""

import numpy as np

from monitor.simulate.controller.moves import Move
from monitor.simulate.controller.program.machine import Machine

SWAY_RAD, SWAY_RAD_S, SWAY_RAD_S2 = 0.1, 0.2, 0.5  # it moves all joints gently to and fro


class ForeignProgram:
    """Plays for a time. It moves the arm to and fro from where it stood, or only plays."""

    command_register = ""

    def __init__(self, machine: Machine, seconds: float, *, moves: bool) -> None:
        self._machine, self._moves = machine, moves
        self._until_s = machine.clock.now_s + seconds
        self._home = machine.reference.q.copy()
        self._away = False

    def received(self) -> None:
        """Input packets do not matter to a program without a command register."""

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
