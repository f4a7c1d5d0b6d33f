"""What a controller guards: following error, torque at the drives' limit, the joints' ranges, jumps of servoj's target."""

from collections.abc import Sequence
from operator import sub

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array

DEVIATION_MAX_RAD = 0.15  # following error at which the controller protects the arm
SATURATED_MAX_S = 0.1  # drives at their limit for so long: something blocks the arm
LIMIT_MARGIN_RAD = 1e-6
WAY_BACK_RAD = 0.01  # what an arm at rest beyond its range may settle


class Limits:
    """Of one arm. `broken` is asked every tick."""

    def __init__(self, robot: Robot, tick_s: float) -> None:
        self._robot, self._tick_s = robot, tick_s
        self._limit = robot.max_position_rad + LIMIT_MARGIN_RAD
        self._way_back: Array | None = None  # (J,) how far out the arm may be that was unlocked beyond its range
        self._max_speed: list[float] = robot.max_speed_rad_s.tolist()
        self._slowest = min(self._max_speed)
        self._saturated_s = 0.0

    def broken(self, wanted: Array, seen: Array, torque_nm: Array) -> str:
        """Why the arm must be protected now, or nothing; where it should be, where its encoders say it is, its drives: each (J,)."""
        size, deviation = np.abs(torque_nm), np.abs(wanted - seen)
        self._saturated_s = self._saturated_s + self._tick_s if True in (size >= self._robot.max_torque_nm).tolist() else 0.0
        if max(deviation.tolist()) > DEVIATION_MAX_RAD:
            return f"joint {int(np.argmax(deviation)) + 1} is {deviation.max():.3f} rad from where it should be"
        if self._saturated_s > SATURATED_MAX_S:
            return f"the drive of joint {int(np.argmax(size / self._robot.max_torque_nm)) + 1} is at its torque limit"
        beyond = self.outside(seen)
        if self._way_back is not None:
            if beyond and (np.abs(seen) <= self._way_back).all():
                return ""
            self._way_back = None
        return beyond

    def deviation_ratio(self, wanted: Array, seen: Array) -> float:
        """1 and more: the arm is protected."""
        return float(np.abs(wanted - seen).max()) / DEVIATION_MAX_RAD

    def reset(self, seen: Array) -> None:
        """A protective stop is over: the drives have their time again, and a joint beyond its range may go back, not further out."""
        self._saturated_s = 0.0
        self._way_back = np.maximum(self._limit, np.abs(seen) + WAY_BACK_RAD) if self.outside(seen) else None

    def outside(self, q: Array) -> str:
        """Which joint is beyond its range, or nothing."""
        beyond = (np.abs(q) > self._limit).tolist()
        if True not in beyond:
            return ""
        joint = beyond.index(True)
        return f"joint {joint + 1} at {q[joint]:.3f} rad is beyond ±{self._robot.max_position_rad[joint]:.3f}"

    def jump(self, target: Sequence[float], before: Sequence[float], since_s: float) -> str:
        """Whether a servoj target lies further from the one before than the arm could have gone since; says which joint, or nothing."""
        if max(map(abs, map(sub, target, before))) <= DEVIATION_MAX_RAD + self._slowest * since_s:
            return ""  # whichever joint it is
        for joint, (to, was, fastest) in enumerate(zip(target, before, self._max_speed, strict=True)):
            if not abs(to - was) <= DEVIATION_MAX_RAD + fastest * since_s:
                return f"sudden change of the target of joint {joint + 1} by {abs(to - was):.3f} rad within {1000 * since_s:.0f} ms"
        return ""
