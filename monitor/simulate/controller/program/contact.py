"""Contact of the arm with something outside, as programs ask for it."""

import math

import numpy as np

from monitor.recording import Array
from monitor.simulate.controller.moves import Move, StopMotion
from monitor.simulate.controller.program.machine import Machine

TOUCH_NM = 2.0  # a joint torque from outside that counts as a contact; a real arm notices about 20 N at its tool
STOP_M_S2 = 3.0  # deceleration after a contact, as in ur-rtde's script
BACK_M_S, BACK_M_S2 = 0.25, 1.2  # URScript's defaults of the movel back to where the contact began


def touched(machine: Machine) -> bool:
    """Whether something presses against the arm."""
    arm = machine.arm
    return arm.contact is not None and float(np.abs(arm.contact.torque_nm(arm.q)).max()) > TOUCH_NM


class UntilContact:
    """ur-rtde's moveUntilContact: the tool moves at a speed until it touches something, stops, and goes back to where it touched first.

    Where nothing is in its way the arm goes on to its limits, and ends in a protective stop there.
    """

    def __init__(self, machine: Machine, speed: Array, acceleration: float) -> None:
        """`speed` (6,) is that of the tool along the base's axes [m/s, rad/s]."""
        self._machine, self._speed, self._acceleration = machine, speed, acceleration
        self._touched_at: Array | None = None
        self._going_back = False

    def over(self) -> bool:
        """Go on by one control period. Returns whether the motion has ended."""
        machine = self._machine
        if not machine.modes.may_move:
            return False
        if self._touched_at is None:
            self._advance()
            return False
        if not machine.moves.over:
            return False
        if self._going_back:
            return True
        self._going_back = True
        back = Move(tuple(self._touched_at.tolist()), pose=False, straight=True, speed=BACK_M_S, acceleration=BACK_M_S2)
        return bool(machine.moves.start(back))  # an obstacle: the arm stays where it stopped

    def _advance(self) -> None:
        machine = self._machine
        if touched(machine):
            self._touched_at = machine.measurements.latest.q.copy()
            machine.moves.stop(StopMotion(STOP_M_S2, straight=True))
        elif np.isfinite(self._speed).all() and math.isfinite(self._acceleration):
            machine.moves.tool_speed(self._speed, self._acceleration)
            self._stop_at_limits()
        else:
            machine.supervisor.protective_stop("moveUntilContact with a figure that is not a number")

    def _stop_at_limits(self) -> None:
        outside = self._machine.limits.outside(self._machine.reference.q)
        if outside:
            self._machine.supervisor.protective_stop(f"moveUntilContact: {outside}")
