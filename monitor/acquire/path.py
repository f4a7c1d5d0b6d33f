"""A smooth straight path in joint space; all joints begin and end together.

The speed along the path rises and falls as a smoothstep and is constant in between, so the acceleration is continuous, and zero at both
ends. The path is streamed point by point, because a blocking moveJ would not feed the controller's watchdog.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor.recording import Array

SHORTEST_S = 0.2  # a path of no length takes this time too, so that a phase always has a beginning and an end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """A path from start to end; the joint that moves farthest keeps the speed and the acceleration that were asked for."""

    start: Array  # (J,) [rad]
    end: Array  # (J,) [rad]
    ramp_s: float  # how long the speed rises, and how long it falls
    duration_s: float

    def at(self, t_s: float) -> Array:
        """The position (J,) at time t; before the beginning it is the start, after the end it is the end."""
        t = min(max(t_s, 0.0), self.duration_s)
        cruise = 1.0 / (self.duration_s - self.ramp_s)  # share of the path that is covered in a second of constant speed
        if t < self.ramp_s:
            share = cruise * _cruise_time_s(t, self.ramp_s)
        elif t > self.duration_s - self.ramp_s:
            share = 1.0 - cruise * _cruise_time_s(self.duration_s - t, self.ramp_s)
        else:
            share = cruise * (t - 0.5 * self.ramp_s)
        position: Array = self.start + share * (self.end - self.start)
        return position


def _cruise_time_s(t_s: float, ramp_s: float) -> float:
    """Time that constant speed needs for the way covered in the first t of a ramp: ∫₀ᵗ 3u² − 2u³ dt, u = t/ramp (a smoothstep)."""
    u = t_s / ramp_s
    return ramp_s * (u**3 - 0.5 * u**4)


def joint_path(start: Array, end: Array, *, speed_rad_s: float, acceleration_rad_s2: float) -> JointPath:
    """The quickest such path from start to end, both (J,) [rad], within a speed and an acceleration.

    A smoothstep of duration r up to the speed v has its greatest acceleration 1.5·v/r in its middle.
    """
    way = float(np.max(np.abs(end - start)))
    ramp_s = 1.5 * speed_rad_s / acceleration_rad_s2
    if way >= speed_rad_s * ramp_s:
        duration_s = way / speed_rad_s + ramp_s
    else:  # the way is too short to reach the speed: v = way/r, hence 1.5·way/r² = a
        ramp_s = math.sqrt(1.5 * way / acceleration_rad_s2)
        duration_s = 2.0 * ramp_s
    if duration_s < SHORTEST_S:
        ramp_s, duration_s = 0.5 * SHORTEST_S, SHORTEST_S
    return JointPath(start=start, end=end, ramp_s=ramp_s, duration_s=duration_s)
