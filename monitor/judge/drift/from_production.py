"""Observations from production, in the filter of the replays.

Production is another motion than the excitation. What differs between the two for good is a level of its own; what differs from day to day
is a noise of its own, with a size and a correlation that are learnt as those of the replays are. Wear and temperature are the joint's,
whatever observes them. So an observation from production has this row of the filter, with the level a_w and the noise m of production:

    y = a_w − β·t + γ·t² + w + m + ε.

A replay is the arbiter: where it speaks against wear that production alone has found since the replay before, nobody knows whether the
joint or the production has changed, and the filter learns it from the replays.
"""

from dataclasses import replace

import numpy as np

from monitor.judge.drift.filter_state import (
    DIFFUSE_VAR,
    NOISE,
    PRODUCTION_LEVEL,
    PRODUCTION_NOISE,
    RATE,
    STEP,
    UNKNOWN_NOISE,
    WEAR,
    FilterState,
    interval_growth,
)
from monitor.judge.drift.noise.size import STEADY
from monitor.judge.drift.noise.volatility import steady
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.two_sources import EXTRA_STATES, TwoSources
from monitor.judge.drift.update.innovation import innovate
from monitor.judge.temperature.laws import inside_range
from monitor.recording import Array

NOISE_LEARNT = 12.0  # [observations] of a source, before which the correlation of its noise is a prior one, of successive observations
DOUBTED = 0.5  # share of the wear found by production alone that is its standard deviation, once a replay speaks against it


def begin_production(state: FilterState, joints_per_arm: int, settings: DriftSettings) -> FilterState:
    """The state with the two states of production, and the prior noise of a source that was never observed. Unchanged where it has them."""
    if state.sources is not None:
        return state
    N, S = state.joints, state.mean.shape[1]
    var, rho = np.full(N, (UNKNOWN_NOISE * settings.between_std) ** 2), settings.autocorrelation
    mean = np.concatenate([state.mean, np.zeros((N, EXTRA_STATES))], axis=1)
    cov = np.zeros((N, S + EXTRA_STATES, S + EXTRA_STATES))
    cov[:, :S, :S] = state.cov
    cov[:, PRODUCTION_LEVEL, PRODUCTION_LEVEL] = DIFFUSE_VAR
    cov[:, PRODUCTION_NOISE, PRODUCTION_NOISE] = var
    responses = np.concatenate([state.responses, np.zeros((*state.responses.shape[:-1], EXTRA_STATES))], axis=-1)
    zero = np.zeros(N)
    sources = TwoSources(
        interval_days=state.interval_days,
        since_days=zero,
        number=state.replays,
        other_interval_days=np.ones(N),
        other_since_days=zero,
        other_number=zero,
        other_step_var=var * (1.0 - rho),
        other_product=var * rho,
        other_noise_weight=np.full(N, settings.between_replays / joints_per_arm),
        other_activity=np.full(N, STEADY),
        other_volatility=steady(N),
        other_residual=np.full(N, np.nan),
        other_gate_run=zero,
        coldest_c=np.full(N, np.nan),
        warmest_c=np.full(N, np.nan),
        unconfirmed=zero,
        unconfirmed_rate=zero,
        risen=zero,
    )
    return replace(state, mean=mean, cov=cov, responses=responses, sources=sources)


def swapped(state: FilterState) -> FilterState:
    """The state with the other source in force. Twice is the state itself."""
    s = _sources(state)
    order = np.arange(state.mean.shape[1])
    order[[NOISE, PRODUCTION_NOISE]] = order[[PRODUCTION_NOISE, NOISE]]
    return replace(
        state,
        mean=state.mean[:, order],
        cov=state.cov[:, order][:, :, order],
        responses=state.responses[..., order],
        step_var=s.other_step_var,
        product=s.other_product,
        noise_weight=s.other_noise_weight,
        activity=s.other_activity,
        volatility=s.other_volatility,
        residual=s.other_residual,
        gate_run=s.other_gate_run,
        sources=replace(
            s,
            interval_days=s.other_interval_days,
            since_days=s.other_since_days,
            number=s.other_number,
            other_interval_days=s.interval_days,
            other_since_days=s.since_days,
            other_number=s.number,
            other_step_var=state.step_var,
            other_product=state.product,
            other_noise_weight=state.noise_weight,
            other_activity=state.activity,
            other_volatility=state.volatility,
            other_residual=state.residual,
            other_gate_run=state.gate_run,
        ),
    )


def reopen_production(state: FilterState, opened: np.ndarray) -> FilterState:
    """The state with an unknown level of production in the joints of `opened` (N,): production in another context.

    `state` has replays in force.
    """
    if not opened.any():
        return state
    mean, cov, responses = state.mean.copy(), state.cov.copy(), state.responses.copy()
    cov[opened, PRODUCTION_LEVEL, :] = 0.0
    cov[opened, :, PRODUCTION_LEVEL] = 0.0
    cov[opened, PRODUCTION_LEVEL, PRODUCTION_LEVEL] = DIFFUSE_VAR
    mean[opened, PRODUCTION_LEVEL] = 0.0
    responses[opened, :, :, PRODUCTION_LEVEL] = 0.0
    s = _sources(state)
    sources = replace(s, other_residual=np.where(opened, np.nan, s.other_residual), other_gate_run=np.where(opened, 0.0, s.other_gate_run))
    return replace(state, mean=mean, cov=cov, responses=responses, sources=sources)


def observed(state: FilterState, here: np.ndarray, learnt: np.ndarray, joints_per_arm: int) -> FilterState:
    """The state with the clock of the source in force after an observation of the joints in `here` (N,); `learnt` (N,): learned from."""
    s = _sources(state)
    days = s.since_days
    growth = interval_growth(np.where(here, days, 0.0), s.interval_days, s.number)
    longer = np.where(s.number >= NOISE_LEARNT, growth, 1.0)
    return replace(
        correlated_over(state, longer, joints_per_arm),
        sources=replace(
            s,
            interval_days=s.interval_days * growth,
            since_days=np.where(here, 0.0, days),
            number=s.number + (here & learnt),
        ),
    )


def correlated_over(state: FilterState, longer: Array, joints_per_arm: int) -> FilterState:
    """The state whose usual interval between observations of the source in force became `longer` (N,) times as long.

    The correlation that was learnt belongs to the interval: noise fades with time, so over a week it is ρ⁷ where it was ρ over a day. Its
    size stays. With γ₁ = σ²(1 − ρ) and c₁ = σ²·ρ, see `FilterState.autocorrelation`. The ρ is that of the arm, as in the filter: what one
    joint shows is too uncertain, and of a ρ near 0 the seventh root is anything.
    """
    rho = np.repeat(state.correlation_seen(joints_per_arm), joints_per_arm)
    known = (rho > 0) & (rho < 1)
    before = np.where(known, rho, 0.5)
    step_var = np.where(known, state.step_var * (1.0 - before**longer) / (1.0 - before), state.step_var)
    return replace(state, step_var=step_var, product=state.product + (state.step_var - step_var))


def inside_production(state: FilterState, temperature_c: Array, margin_k: float) -> np.ndarray:
    """(N,) whether temperatures (N,) lie in the range that was learned from production before."""
    s = _sources(state)
    return inside_range(np.stack([s.coldest_c, s.warmest_c], axis=1), temperature_c, margin_k)


def widen_range(state: FilterState, temperature_c: Array, learnt: np.ndarray) -> FilterState:
    """The state with the temperatures (N,) of production that the joints in `learnt` (N,) learned from."""
    s = _sources(state)
    T = np.where(learnt, temperature_c, np.nan)
    return replace(state, sources=replace(s, coldest_c=np.fmin(s.coldest_c, T), warmest_c=np.fmax(s.warmest_c, T)))


def remember_unconfirmed(before: FilterState, after: FilterState, resolved: np.ndarray) -> FilterState:
    """The state after an observation from production, with the wear that it found; before : predicted to its time."""
    s = _sources(after)
    found = resolved & (after.event == STEP)
    wear, rate = (np.where(found, after.mean[:, k] - before.mean[:, k], 0.0) for k in (WEAR, RATE))
    # a joint that production does not tell anything of keeps what was known of its last observation
    kept = {name: np.where(resolved, getattr(after, name), getattr(before, name)) for name in ("event", "innovation", "normalised")}
    return replace(
        after, sources=replace(s, unconfirmed=s.unconfirmed + wear, unconfirmed_rate=s.unconfirmed_rate + rate), event=kept["event"],
        innovation=kept["innovation"], normalised=kept["normalised"],
    )  # fmt: skip


def arbitrate(state: FilterState, observation: Observation, slot: Array, joints_per_arm: int, settings: DriftSettings) -> FilterState:
    """The state before a replay is learned from: where the replay is nearer to the friction without the wear that production alone has
    found, that wear may as well be a change of production's level.
    """
    s = _sources(state)
    if not s.unconfirmed.any():
        return state
    seen = innovate(state, observation, slot, state.noise_var(joints_per_arm, settings), settings)
    against = seen.resolved & (np.abs(seen.value + s.unconfirmed) < np.abs(seen.value))
    if not against.any():
        return state
    # along w − a_w observations from production stay as they are
    away = np.zeros((2, *state.mean.shape))
    for k, found in enumerate((s.unconfirmed, s.unconfirmed_rate)):
        away[k, :, (WEAR, RATE)[k]] = np.where(against, DOUBTED * found, 0.0)
    away[0, :, PRODUCTION_LEVEL] = -away[0, :, WEAR]
    cov = state.cov + np.einsum("kna,knb->nab", away, away)
    return replace(state, cov=cov)


def confirmed(state: FilterState, learnt: np.ndarray) -> FilterState:
    """The state after a replay that the joints in `learnt` (N,) learned from: nothing of them is found by production alone any more."""
    s = _sources(state)
    return replace(
        state,
        sources=replace(s, unconfirmed=np.where(learnt, 0.0, s.unconfirmed), unconfirmed_rate=np.where(learnt, 0.0, s.unconfirmed_rate)),
    )


def _sources(state: FilterState) -> TwoSources:
    assert state.sources is not None
    return state.sources
