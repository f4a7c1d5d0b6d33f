"""Wear of the simulated joints: dry and viscous friction grow in proportion to revolutions times load.

On command, friction also changes by a step, with new grease or with a new joint.
"""

from dataclasses import dataclass

import numpy as np

from monitor.recording import Array

RATED_LOAD = 0.25  # load that the wear per revolution refers to, as a share of the maximum torque
HEALTHY_WEAR_PER_REVOLUTION = 2e-8  # 1 % in half a million revolutions, which take some months of hard work
VISCOUS_SHARE_OF_WEAR = 0.5  # viscous friction grows half as fast as dry friction: metal and seals wear more than oil
PRODUCTION_LOAD = 0.12  # load in a typical job with a small payload, as a share of the maximum torque
PRODUCTION_SPEED_RAD_S = 0.7  # speed of a joint that moves in a typical job
PRODUCTION_MOVING = 0.6  # share of the working time in which one joint moves


@dataclass(slots=True, eq=False)
class Wear:
    """The wear factors of dry and viscous friction, and what has caused them, each (J,)."""

    coulomb: Array
    viscous: Array
    per_revolution: Array  # growth of the dry factor per revolution at rated load
    revolutions: Array
    rated_revolutions: Array  # revolutions weighted by load over RATED_LOAD

    @classmethod
    def fresh(cls, joints: int, per_revolution: Array | None) -> "Wear":
        """The wear of a new arm. None for the growth per revolution means that of a healthy arm."""
        rate = np.full(joints, HEALTHY_WEAR_PER_REVOLUTION) if per_revolution is None else per_revolution.astype(float)
        return cls(np.ones(joints), np.ones(joints), rate, np.zeros(joints), np.zeros(joints))

    def use(self, revolutions: Array, load: Array) -> None:
        """Wear by (J,) revolutions under a load (J,), which is a share of the maximum torque."""
        rated = revolutions * load / RATED_LOAD
        self.revolutions += revolutions
        self.rated_revolutions += rated
        self.coulomb += self.per_revolution * rated
        self.viscous += VISCOUS_SHARE_OF_WEAR * self.per_revolution * rated

    def regrease(self, joint: int, recovery: float) -> None:
        """Take away this share of a joint's wear by new grease. The rest stays: metal that was worn off does not come back."""
        self.coulomb[joint] = 1.0 + (self.coulomb[joint] - 1.0) * (1.0 - recovery)
        self.viscous[joint] = 1.0 + (self.viscous[joint] - 1.0) * (1.0 - recovery)

    def renew(self, joint: int) -> None:
        """Replace a joint by a new one, which wears as a healthy joint does."""
        self.coulomb[joint] = self.viscous[joint] = 1.0
        self.per_revolution[joint] = HEALTHY_WEAR_PER_REVOLUTION
        self.revolutions[joint] = self.rated_revolutions[joint] = 0.0


def rated_revolutions_an_hour(duty: float) -> float:
    """Rated revolutions of every joint in one hour of a typical job with this duty, as `Arm.pass_time` counts them."""
    return duty * PRODUCTION_MOVING * PRODUCTION_SPEED_RAD_S * 3600.0 / (2.0 * np.pi) * PRODUCTION_LOAD / RATED_LOAD
