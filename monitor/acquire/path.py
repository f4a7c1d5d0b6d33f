"""A smooth straight path in joint space, all joints beginning and ending together.

Speed along the path rises and falls as a smoothstep, so acceleration is continuous and zero at both ends, and cruises
in between. Streamed point by point: a blocking moveJ would not feed the controller's watchdog.
"""

import math
from dataclasses import dataclass

import numpy as np

from monitor.recording import Array

SHORTEST_S = 0.2  # even a path of no length has a beginning and an end


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPath:
    """From start to end within a speed and an acceleration, each of the joint that moves farthest."""

    start: Array  # (J,) [rad]
    end: Array  # (J,) [rad]
    ramp_s: float  # speed rises for so long, and falls for so long
    duration_s: float

    def at(self, t_s: float) -> Array:
        """(J,) position at time t; before the beginning the start, after the end the end."""
        t = min(max(t_s, 0.0), self.duration_s)
        cruise = 1.0 / (self.duration_s - self.ramp_s)  # share of the path a second
        if t < self.ramp_s:
            share = cruise * _risen(t, self.ramp_s)
        elif t > self.duration_s - self.ramp_s:
            share = 1.0 - cruise * _risen(self.duration_s - t, self.ramp_s)
        else:
            share = cruise * (t - 0.5 * self.ramp_s)
        position: Array = self.start + share * (self.end - self.start)
        return position


def _risen(t_s: float, ramp_s: float) -> float:
    """∫₀ᵗ of the smoothstep 3u² − 2u³, u = t/ramp: time that cruising would have needed for the same way."""
    u = t_s / ramp_s
    return ramp_s * (u**3 - 0.5 * u**4)


def joint_path(start: Array, end: Array, *, speed_rad_s: float, acceleration_rad_s2: float) -> JointPath:
    """The quickest such path from start to end, both (J,) [rad].

    A smoothstep of length r up to speed v has its greatest acceleration 1.5·v/r in its middle.
    """
    way = float(np.max(np.abs(end - start)))
    ramp_s = 1.5 * speed_rad_s / acceleration_rad_s2
    if way >= speed_rad_s * ramp_s:
        duration_s = way / speed_rad_s + ramp_s
    else:  # too short to reach the speed: v = way/r, 1.5·way/r² = a
        ramp_s = math.sqrt(1.5 * way / acceleration_rad_s2)
        duration_s = 2.0 * ramp_s
    if duration_s < SHORTEST_S:
        ramp_s, duration_s = 0.5 * SHORTEST_S, SHORTEST_S
    return JointPath(start=start, end=end, ramp_s=ramp_s, duration_s=duration_s)
