"""The run-in after rest: friction of a joint that has rested is higher, and falls while it moves.

Grease that has crept out of the contacts comes back with the first turns. Recordings of a UR10e show 3 to 5 % more friction after rest,
gone with a time constant of 10 to 20 s of motion. With r the share of the run-in that a joint has before it,

    friction = (1 + ρ·r)·friction of the moving joint,   ṙ = −r/τ_run while it moves,   ṙ = (1 − r)/τ_rest while it rests.

τ_rest is an assumption of the simulator: within an hour of rest the whole run-in is back.
"""

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.wear import PRODUCTION_MOVING

RUN_S = 15.0  # τ_run
REST_S = 900.0  # τ_rest
MOVING_RAD_S = 0.02  # mean speed of a joint that moves


class RunIn:
    """The run-in of each joint. With ρ = 0 there is none, and `factor` is exactly 1."""

    def __init__(self, joints: int, share: float) -> None:
        """The joints have rested. share : ρ, what rest adds to friction."""
        self.share = share
        self.rested: Array = np.ones(joints)  # r

    @property
    def factor(self) -> Array:
        """(J,) friction over that of the joint that has moved for long."""
        result: Array = 1.0 + self.share * self.rested
        return result

    def pass_by(self, elapsed_s: float, travel_rad: Array) -> None:
        """Let time pass in which each joint travelled so far, (J,)."""
        moving = travel_rad > MOVING_RAD_S * elapsed_s
        run, rest = np.exp(-elapsed_s / RUN_S), np.exp(-elapsed_s / REST_S)
        self.rested = np.where(moving, self.rested * run, 1.0 - (1.0 - self.rested) * rest)

    def work(self, elapsed_s: float, duty: float) -> None:
        """Let time pass in which the arm did a typical job in the share `duty` of it, with short rests in between."""
        moving = duty * PRODUCTION_MOVING
        rate = moving / RUN_S + (1.0 - moving) / REST_S
        level = (1.0 - moving) / REST_S / rate
        self.rested = level + (self.rested - level) * np.exp(-elapsed_s * rate)
