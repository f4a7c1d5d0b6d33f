"""Moves that a program asks for: checked against what the arm can do, then handed to the reference."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm import motions
from monitor.simulate.arm.kinematics import se3
from monitor.simulate.controller.program.scripts import Move, StopMotion

if TYPE_CHECKING:
    import pinocchio as pin

    from monitor.simulate.controller.controller import Controller

PROGRAM_STOP_RAD_S2 = 15.0  # an arm at 2 rad/s stands after 0.13 s
SLOWEST = 1e-9  # of speeds and accelerations: 1/v is still a number
STOP_MAX_RAD_S2 = 40.0  # of a stopl with the tool near an axis


class Moves:
    """Of one controller."""

    def __init__(self, controller: "Controller") -> None:
        self._c = controller
        self.waypoint: Array | None = None  # pose that the last move goes to
        self.interrupted: Move | None = None  # by a pause or a protective stop: it goes on with the program
        self._last: Move | None = None
        self._servo_goal: Sequence[float] | None = None
        self._servo_goal_at_s = 0.0

    def start(self, move: Move) -> str:
        """Movej or movel; says why it cannot be made, or nothing."""
        self._last, self.interrupted = move, None
        target = np.array(move.target)
        if target.shape != self._c.arm.q.shape or not np.isfinite(target).all():
            return f"the target is not {self._c.robot.joints} finite numbers"
        if not (SLOWEST < move.speed < math.inf and SLOWEST < move.acceleration < math.inf):
            return f"speed {move.speed:g} and acceleration {move.acceleration:g} must be positive"
        q = self.inverse(target) if move.pose else target
        if q is None:
            return f"no joint positions for the tool at {target.round(4).tolist()}"
        why = self._c.limits.outside(q)
        if why:
            return why
        goal = se3(target) if move.pose else self._c.kinematics.at(target)
        if not move.straight:
            self._c.reference.move(q, move.speed, move.acceleration)
        elif self._c.reference.qd.any():  # a line begins at rest

            def then() -> None:
                wrong = self._line(goal, move)
                if wrong:
                    self._c.stop_program(f"runtime exception: movel: {wrong}")

            self._c.reference.stop(PROGRAM_STOP_RAD_S2, then)
        else:
            why = self._line(goal, move)
        self.waypoint = self._c.kinematics.pose(q)
        return why

    def _line(self, goal: "pin.SE3", move: Move) -> str:
        why = motions.line(self._c.reference, self._c.kinematics, goal, move.speed, move.acceleration, self._c.robot.max_speed_rad_s)
        if why:
            self._c.reference.hold()
        return why

    @property
    def over(self) -> bool:
        """Whether what was asked for last has been done, to its end."""
        return self._c.reference.at_rest and self.interrupted is None

    def interrupt(self) -> None:
        """The arm is about to be stopped, the program is not: its move is not done yet."""
        if self._c.reference.mode in {"move", "line"} or self._c.reference.queued:
            self.interrupted = self._last

    def resume(self) -> None:
        """The program goes on, and with it the move, from where the arm stands."""
        move, self.interrupted = self.interrupted, None
        why = "" if move is None else self.start(move)
        if why:
            self._c.stop_program(f"runtime exception: {why}")

    def stop(self, stop: StopMotion) -> None:
        """stopj, or stopl: the joints decelerate together, so that the tool does it with this many m/s²."""
        if not self._c.may_move:
            return  # a safety stop is not made softer
        self.interrupted = None
        deceleration = stop.deceleration
        fastest = float(np.max(np.abs(self._c.reference.qd)))
        if stop.straight and fastest > 0.0:
            tool = float(np.linalg.norm(self._c.kinematics.speed(self._c.reference.q, self._c.reference.qd)[:3]))
            deceleration = min(deceleration * fastest / max(tool, 1e-3), STOP_MAX_RAD_S2)
        self._c.reference.stop(deceleration)

    def sudden(self, target: Sequence[float]) -> str:
        """Whether a servoj target lies further from the last than the arm could have gone since; says which joint, or nothing."""
        c, before = self._c, self._servo_goal
        since_s = c.clock_s - self._servo_goal_at_s
        if c.reference.mode != "servo" or before is None:
            before, since_s = c.reference.q.tolist(), c.tick_s
        self._servo_goal, self._servo_goal_at_s = target, c.clock_s
        return c.limits.jump(target, before, since_s)

    def inverse(self, pose: Array, near: Array | None = None) -> Array | None:
        """(J,) joint positions for the tool at a pose (6,), or None."""
        return self._c.kinematics.inverse(se3(pose), self._c.reference.q if near is None else near)
