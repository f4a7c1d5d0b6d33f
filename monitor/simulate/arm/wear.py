"""Wear of the simulated joints: dry and viscous friction grow with revolutions × load; steps, grease and new joints on command."""

from dataclasses import dataclass

import numpy as np

from monitor.recording import Array

RATED_LOAD = 0.25  # share of the maximum torque at which wear per revolution is quoted
HEALTHY_WEAR_PER_REVOLUTION = 2e-8  # 1 % in half a million revolutions, some months of hard work
VISCOUS_SHARE_OF_WEAR = 0.5  # metal and seals wear more than oil does
PRODUCTION_LOAD = 0.12  # share of the maximum torque, typical of a job without much payload
PRODUCTION_SPEED_RAD_S = 0.7  # of every joint while a typical job moves
PRODUCTION_MOVING = 0.6  # share of a duty hour in which one joint moves


@dataclass(slots=True, eq=False)
class Wear:
    """Multipliers of dry and viscous friction and what made them, each (J,)."""

    coulomb: Array
    viscous: Array
    per_revolution: Array
    revolutions: Array
    rated_revolutions: Array  # weighted by load

    @classmethod
    def fresh(cls, joints: int, per_revolution: Array | None) -> "Wear":
        """An arm as delivered."""
        rate = np.full(joints, HEALTHY_WEAR_PER_REVOLUTION) if per_revolution is None else per_revolution.astype(float)
        return cls(np.ones(joints), np.ones(joints), rate, np.zeros(joints), np.zeros(joints))

    def use(self, revolutions: Array, load: Array) -> None:
        """Turn by (J,) revolutions under a (J,) load, as a share of the maximum torque."""
        rated = revolutions * load / RATED_LOAD
        self.revolutions += revolutions
        self.rated_revolutions += rated
        self.coulomb += self.per_revolution * rated
        self.viscous += VISCOUS_SHARE_OF_WEAR * self.per_revolution * rated

    def regrease(self, joint: int, recovery: float) -> None:
        """New grease takes away this share of the joint's wear: what was worn off metal stays worn."""
        self.coulomb[joint] = 1.0 + (self.coulomb[joint] - 1.0) * (1.0 - recovery)
        self.viscous[joint] = 1.0 + (self.viscous[joint] - 1.0) * (1.0 - recovery)

    def renew(self, joint: int) -> None:
        """Another joint in its place: unworn, and wearing as healthy ones do."""
        self.coulomb[joint] = self.viscous[joint] = 1.0
        self.per_revolution[joint] = HEALTHY_WEAR_PER_REVOLUTION
        self.revolutions[joint] = self.rated_revolutions[joint] = 0.0


def rated_revolutions_an_hour(duty: float) -> float:
    """Of every joint in a typical job that moves for `duty` of the hour: what `Arm.live` counts."""
    return duty * PRODUCTION_MOVING * PRODUCTION_SPEED_RAD_S * 3600.0 / (2.0 * np.pi) * PRODUCTION_LOAD / RATED_LOAD
