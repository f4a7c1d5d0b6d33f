"""The filter state of joints of which a fleet told beforehand, and how such a joint is let go where its replays say otherwise."""

from dataclasses import replace

import numpy as np

from monitor.judge.drift.filter_state import CURVE, LAG, NOISE, SLOPE, FilterState
from monitor.judge.drift.noise.chance import SIDES
from monitor.judge.drift.prior import FleetPrior, contradicts

# The prior is held against the replays so often and no more: a slope that was let go is soon known better than the fleet's prior again, and
# would be let go at every replay; later the prior weighs no more than the replays.
LOOKED_AT_REPLAYS = (10.0, 20.0, 40.0, 80.0)


def begin_from_fleet(state: FilterState, prior: FleetPrior) -> FilterState:
    """The state before the first replay, with the fleet's dependence on temperature and its noise."""
    N = state.joints
    state = temperature_from_fleet(state, prior, np.ones(N, dtype=bool))
    step_var, product, weight = (_of_all(each, N) for each in (prior.step_var, prior.product, prior.noise_replays))
    cov = state.cov.copy()
    cov[:, NOISE, NOISE] = step_var + product
    chance = state.chance
    if prior.chance is not None:
        mean = np.broadcast_to(prior.chance[None, :, None, :] / SIDES, chance.mean.shape).copy()
        chance = replace(chance, mean=mean, replays=np.full_like(chance.replays, prior.chance_replays))
    return replace(state, cov=cov, step_var=step_var, product=product, noise_weight=weight, chance=chance)


def temperature_from_fleet(state: FilterState, prior: FleetPrior, which: np.ndarray) -> FilterState:
    """The state with the fleet's dependence on temperature in the joints of `which` (N,)."""
    mean, cov = state.mean.copy(), state.cov.copy()
    pairs = (
        (SLOPE, prior.slope_per_k, prior.slope_std_per_k),
        (CURVE, prior.curve_per_k2, prior.curve_std_per_k2),
        (LAG, prior.lag, prior.lag_std),
    )
    n = np.flatnonzero(which)
    for entry, value, std in pairs:
        mean[n, entry] = _of_all(value, state.joints)[n]
        cov[n, entry, :] = 0.0
        cov[n, :, entry] = 0.0
        cov[n, entry, entry] = _of_all(std, state.joints)[n] ** 2
    return replace(state, mean=mean, cov=cov)


def let_go(state: FilterState, prior: FleetPrior, family_std_per_k: float) -> FilterState:
    """The state with the family's doubt of the slope, where the replays of a young joint contradict the fleet's.

    family_std_per_k : standard deviation of the slope [1/K] among all arms of the family.
    """
    var = state.cov[:, SLOPE, SLOPE]
    looked_at = np.isin(state.replays, LOOKED_AT_REPLAYS) & state.learnt_from
    other = looked_at & contradicts(state.mean[:, SLOPE], var, prior)
    if not other.any():
        return state
    cov = state.cov.copy()
    cov[other, SLOPE, SLOPE] += family_std_per_k**2
    return replace(state, cov=cov)


def _of_all(of_arm: np.ndarray, joints: int) -> np.ndarray:
    """(N,) of the (J,) of one arm, for every arm."""
    return np.tile(of_arm, joints // len(of_arm))
