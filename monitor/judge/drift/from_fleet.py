"""The state of joints of which a fleet told beforehand how their friction depends on temperature."""

import numpy as np

from monitor.judge.friction.prior import FleetPrior
from monitor.judge.friction.states import CURVE, LAG, SLOPE
from monitor.judge.friction.step import FrictionState
from monitor.recording import Array


def with_fleet(state: FrictionState, prior: FleetPrior, n: np.ndarray) -> None:
    """The fleet's dependence on temperature for the channels n (numbers), in place; the mean of an arm has that of its joints."""
    arms = len(state.replays) // (state.joints_per_arm + 1)

    def of_all(joints: Array) -> Array:
        values: Array = np.tile(np.append(joints, joints.mean()), arms)[n]
        return values

    for entry, value, std in (
        (SLOPE, -prior.slope_per_k, prior.slope_std_per_k),
        (CURVE, prior.curve_per_k2, prior.curve_std_per_k2),
        (LAG, prior.lag, prior.lag_std),
    ):
        state.x[:, entry, n] = of_all(value)
        state.P[:, entry, :, n] = state.P[:, :, entry, n] = 0.0
        state.P[:, entry, entry, n] = of_all(std) ** 2
