"""The filter state of joints of which a fleet told beforehand, and how such a joint is let go where its replays say otherwise."""

from dataclasses import replace

import numpy as np

from monitor.judge.drift.filter_state import CURVE, LAG, NOISE, SLOPE, FilterState
from monitor.judge.drift.noise.chance import SIDES
from monitor.judge.drift.prior import FleetPrior, contradicts
from monitor.recording import Array

# The prior is held against the replays so often and no more: a slope that was let go is soon known better than the fleet's prior again, and
# would be let go at every replay; later the prior weighs no more than the replays.
LOOKED_AT_REPLAYS = (10.0, 20.0, 40.0, 80.0)
YOUNG_REPLAYS = 90.0  # so long the fleet's noise counts in full for the joints of a new arm, and after as many again no more
LONGER_SIGMA = 2.0  # [σ] of chance by which the arm's noise may look longer than the fleet's
FEW_ARMS = 4.0  # a fleet of so many arms counts half


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


def widen_where_prior_fails(state: FilterState, prior: FleetPrior, family_std_per_k: float) -> FilterState:
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


def noise_known(state: FilterState, prior: FleetPrior | None) -> Array:
    """(N,) from 0 to 1: how far the noise of a young joint is known from the fleet, its size and how it averages out.

    0 without a fleet's prior, in a joint of which production has told, because the fleet says nothing of production's noise, and in an arm
    whose noise is correlated longer than the fleet's. Of the joints of an arm, the lowest and the highest correlation do not count: wear
    that begins looks like correlated noise.
    """
    if prior is None or prior.chance is None:
        return np.zeros(state.joints)
    J = len(prior.slope_per_k)
    prior_part = prior.noise_replays.mean() / J  # of each joint's weight, see `initial_state`
    weight = state.noise_weight.reshape(-1, J).mean(axis=1)
    own = np.maximum(weight - prior_part, 0.0)
    each = np.sort((state.product / np.maximum(state.product + state.step_var, 1e-12)).reshape(-1, J), axis=1)
    middle = each[:, 1:-1] if J > 2 else each
    rho = float(prior.noise_correlation.mean())
    # of n products of successive noises the correlation is known to √((1−ρ²)/n), and it counts here with the share of the arm's own
    chance = own / np.maximum(weight, 1e-9) * np.sqrt((1.0 - rho**2) / np.maximum(own * middle.shape[1], 1e-9))
    longer = middle.mean(axis=1) - rho > LONGER_SIGMA * chance
    young = np.clip(2.0 - state.replays / YOUNG_REPLAYS, 0.0, 1.0)
    known: Array = np.where(np.repeat(longer, J) | _told_by_both(state), 0.0, young * prior.arms / (prior.arms + FEW_ARMS))
    return known


def _told_by_both(state: FilterState) -> np.ndarray:
    """(N,) joints that the filter has learned of from replays and from production, whichever of them is in force."""
    s = state.sources
    both: np.ndarray = np.zeros(state.joints, dtype=bool) if s is None else (s.number > 0) & (s.other_number > 0)
    return both


def _of_all(of_arm: np.ndarray, joints: int) -> np.ndarray:
    """(N,) of the (J,) of one arm, for every arm."""
    return np.tile(of_arm, joints // len(of_arm))
