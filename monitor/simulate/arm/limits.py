"""The limits that a controller supervises: following error, drive torque, joint ranges and jumps of servoj's target."""

from collections.abc import Sequence
from operator import sub

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array

DEVIATION_MAX_RAD = 0.15  # following error that leads to a protective stop
SATURATED_MAX_S = 0.1  # a drive at its torque limit for longer than this means that something blocks the arm
LIMIT_MARGIN_RAD = 1e-6  # rounding errors of a target exactly at the limit
ENDLESS_WRIST = frozenset({"ur3", "ur3e"})  # their last joint turns without end; it is published as ±2π all the same
WAY_BACK_RAD = 0.01  # how much farther out an arm may settle after it was unlocked beyond its range


class Limits:
    """The limits of one arm. The controller calls `broken` in every control period."""

    def __init__(self, robot: Robot, tick_s: float) -> None:
        self._robot, self._tick_s = robot, tick_s
        self._limit = robot.max_position_rad + LIMIT_MARGIN_RAD
        if robot.name in ENDLESS_WRIST:
            self._limit[-1] = np.inf
        self._way_back: Array | None = None  # (J,) largest |q| of an arm that was unlocked beyond its range
        self._max_speed: list[float] = robot.max_speed_rad_s.tolist()
        self._slowest = min(self._max_speed)
        self._saturated_s = 0.0

    def broken(self, target: Array, q: Array, torque_nm: Array) -> str:
        """Check target, encoder position and drive torque, each (J,). Returns the reason for a protective stop, or an empty text."""
        size, deviation = np.abs(torque_nm), np.abs(target - q)
        self._saturated_s = self._saturated_s + self._tick_s if True in (size >= self._robot.max_torque_nm).tolist() else 0.0
        if max(deviation.tolist()) > DEVIATION_MAX_RAD:
            return f"joint {int(np.argmax(deviation)) + 1} is {deviation.max():.3f} rad from where it should be"
        if self._saturated_s > SATURATED_MAX_S:
            return f"the drive of joint {int(np.argmax(size / self._robot.max_torque_nm)) + 1} is at its torque limit"
        beyond = self.outside(q)
        if self._way_back is not None:
            if beyond and (np.abs(q) <= self._way_back).all():
                return ""
            self._way_back = None
        return beyond

    def deviation_ratio(self, target: Array, q: Array) -> float:
        """Following error divided by DEVIATION_MAX_RAD. A ratio of 1 or more leads to a protective stop."""
        return float(np.abs(target - q).max()) / DEVIATION_MAX_RAD

    def reset(self, q: Array) -> None:
        """Begin anew after a protective stop. A joint beyond its range at q (J,) may go back, but not farther out."""
        self._saturated_s = 0.0
        self._way_back = np.maximum(self._limit, np.abs(q) + WAY_BACK_RAD) if self.outside(q) else None

    def outside(self, q: Array) -> str:
        """Check joint positions (J,). Returns the first joint beyond its range with its position, or an empty text."""
        beyond = (np.abs(q) > self._limit).tolist()
        if True not in beyond:
            return ""
        joint = beyond.index(True)
        return f"joint {joint + 1} at {q[joint]:.3f} rad is beyond ±{self._robot.max_position_rad[joint]:.3f}"

    def jump(self, target: Sequence[float], before: Sequence[float], since_s: float) -> str:
        """Check whether a servoj target (J,) is farther from the one before than the arm can have moved since.

        Returns the joint and the distance, or an empty text.
        """
        if max(map(abs, map(sub, target, before))) <= DEVIATION_MAX_RAD + self._slowest * since_s:
            return ""  # within the bound of the slowest joint
        for joint, (to, was, fastest) in enumerate(zip(target, before, self._max_speed, strict=True)):
            if not abs(to - was) <= DEVIATION_MAX_RAD + fastest * since_s:
                return f"sudden change of the target of joint {joint + 1} by {abs(to - was):.3f} rad within {1000 * since_s:.0f} ms"
        return ""
