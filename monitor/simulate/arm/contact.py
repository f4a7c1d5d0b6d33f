"""What presses against an arm from outside: a torque on one joint, or an elastic wall in its way."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from monitor.recording import Array


class Pressing(Protocol):
    """Whatever presses against an arm."""

    left_s: float  # time for which it lasts yet; inf: until it is removed

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,) [N·m]."""


@dataclass(slots=True, kw_only=True, eq=False)
class Contact:
    """One contact at one joint, for a time."""

    joint: int  # 0 … J−1
    left_s: float  # time for which it lasts yet; inf: until it is removed
    torque_nm_on_joint: float = 0.0  # constant torque on the joint, with its sign
    stiffness_nm_per_rad: float = 0.0  # of a wall that the joint touches at wall_rad
    wall_rad: float = 0.0
    side: float = 1.0  # the wall is above (1) or below (−1) the joint's position: it only pushes back

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,) [N·m]."""
        pressed = np.zeros_like(q)
        depth_rad = max(self.side * (float(q[self.joint]) - self.wall_rad), 0.0)
        pressed[self.joint] = self.torque_nm_on_joint - self.side * self.stiffness_nm_per_rad * depth_rad
        return pressed
