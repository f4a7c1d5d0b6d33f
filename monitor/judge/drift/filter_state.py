"""Track: what the filter holds of each joint, as arrays over N joints: those of one arm, or of every arm of a fleet at once.

Per joint, with y = log F(v*), the friction torque at a reference speed, t = T − origin and Ṫ how fast the joint warms:

    y = a_c − β·t + γ·t² + λ·Ṫ + w + n + ε,   w⁺ = w + e^(−w)·ẇ·Δu,   n⁺ = ρ·n + noise.

a_c is the level in context c, n what is alike from one replay to the next, ε the noise within a replay. Levels and wear cannot
be told apart by looking: w begins at 0 without doubt, the level carries all of it. A context seen before has its level still.
u is use, counted in usual days of work; ẇ is the rise of friction itself, as a fraction of what it was, a usual day: the same work
wears off the same, so friction rises along a straight line and its logarithm does not.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from monitor.judge.drift.kalman import predict
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array

WEAR, RATE, NOISE, SLOPE, CURVE, LAG = range(6)  # log, 1/usual day, log, 1/K, 1/K², 1/(K/min); then the levels
SLOTS = 4  # contexts whose levels are kept side by side
LEVELS = 6
STATES = LEVELS + SLOTS
WINDOW = 48  # replays at which a sudden change may have begun: the last ones, then ever fewer …
OLDEST = 200  # … so many replays back
KINDS = 2  # of sudden changes: a step of wear, a new pace of it
DIFFUSE_VAR = 100.0  # log² of an unknown level: e^±10 holds every torque, and leaves 10 digits of float64 to the rest
LOG_RISE = np.array([-3.0, 3.0])  # no joint's friction is 20 times what it was, nor a twentieth
ORDINARY, SETTLING, STEP, OUTLIER, UNRESOLVED = range(5)  # what the last replay was to a joint; the last two are not learnt from


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterState:
    """The filter's state of N joints."""

    origin_c: Array  # (N,) from which temperatures are counted
    mean: Array  # (N, S)
    cov: Array  # (N, S, S)
    replays: Array  # (N,) learnt from
    interval_days: Array = field(metadata={"key": "cadence_days"})  # (N,) usual time between replays: ρ belongs to it
    step_var: Array  # (N,) half the mean square of what differs from one replay to the next, within-replay noise taken off
    product: Array  # (N,) mean product of what is noise in two successive replays
    noise_weight: Array  # (N,) replays behind both
    residual: Array  # (N,) of the last replay, as foreseen without noise; NaN where the next does not compare
    consistency: Array  # (N,) running mean of normalised innovations squared: 1 where the filter is consistent
    innovation: Array  # (N,) of the last replay; NaN where unseen
    normalised: Array  # (N,) the same in its own σ
    event: Array  # (N,) ORDINARY, SETTLING, STEP, OUTLIER or UNSEEN: the last replay
    gate_run: Array  # (N,) signed count of gated replays in a row
    outliers: Array  # (N,) gated so far
    responses: Array  # (N, 2, W, S) what a unit change, W replays ago or fewer, has left of error in the filter
    ages: Array  # (N, W) replays ago, ascending
    glr_scores: Array = field(metadata={"key": "scores"})  # (N, 2, W) of each such change: Σ G·ν/S with ν clipped
    raw_glr_scores: Array = field(metadata={"key": "raw_scores"})  # (N, 2, W) the same with ν in full
    glr_informations: Array = field(metadata={"key": "informations"})  # (N, 2, W) Σ G²/S
    agreeing: Array  # (N,) replays that the last one says agree with it: 1, or all since a change that was found
    stepped: Array  # (N,) wear that came in steps, log

    @property
    def joints(self) -> int:
        """N."""
        return len(self.mean)

    @property
    def wear(self) -> Array:
        """(N,) mean of w."""
        return self.mean[:, WEAR]

    @property
    def wear_std(self) -> Array:
        """(N,)."""
        return np.sqrt(np.maximum(self.cov[:, WEAR, WEAR], 0.0))

    @property
    def learnt_from(self) -> np.ndarray:
        """(N,) whether the last replay taught something of a joint."""
        learnt: np.ndarray = self.event <= STEP
        return learnt

    def autocorrelation(self, arm: int, settings: DriftSettings) -> Array:
        """(N,) ρ of successive replays, one for the `arm` joints of each arm: what lasts there lasts for all of them.

        With γ₁ = E[(εₖ − εₖ₋₁)²]/2 = σ²(1−ρ) and c₁ = E[εₖ·εₖ₋₁] = σ²ρ: ρ = c₁/(c₁ + γ₁). The joints' middle ones are averaged: wear
        that sets in looks like noise that lasts, and must not pass for it.
        """
        each = np.sort((self.product / np.maximum(self.product + self.step_var, 1e-12)).reshape(-1, arm), axis=1)
        trim = arm // 6 + (arm == 5)
        rho = np.clip(each[:, trim : arm - trim].mean(axis=1), 0.0, settings.autocorrelation_max)
        return np.repeat(rho, arm)

    def noise_var(self, arm: int, settings: DriftSettings) -> Array:
        """(N,) of y between replays: σ² = γ₁/(1 − ρ), drawn towards the arm's, and larger while few replays have told it."""
        var = self.step_var / (1.0 - self.autocorrelation(arm, settings))
        mean = np.repeat(var.reshape(-1, arm).mean(axis=1), arm)
        n, alike = self.noise_weight, settings.alike_replays
        cautious: Array = (n * var + alike * mean) / (n + alike) * (1.0 + settings.caution / np.sqrt(n))
        return cautious

    def level(self, slot: Array) -> Array:
        """(N,) mean of the level in a slot (N,), at the origin."""
        levels: Array = self.mean[np.arange(self.joints), LEVELS + slot]
        return levels

    def row(self, t: Array, warming: Array, slot: Array, *, noise: float = 1.0) -> Array:
        """(N, S) H of a replay at t = T − origin, warming [K/min], slot; each (N,)."""
        H = np.zeros((self.joints, STATES))
        H[:, WEAR], H[:, NOISE] = 1.0, noise
        H[:, SLOPE], H[:, CURVE], H[:, LAG] = -t, t * t, warming
        H[np.arange(self.joints), LEVELS + slot] = 1.0
        return H

    def slope_at(self, temperature_c: Array) -> Array:
        """(N,) −∂y/∂T at temperatures (N,) [1/K]: β − 2γt."""
        slope: Array = self.mean[:, SLOPE] - 2.0 * self.mean[:, CURVE] * (temperature_c - self.origin_c)
        return slope

    def reference_row(self, temperature_c: Array, slot: Array) -> Array:
        """(N, S) H of `reference`."""
        return self.row(temperature_c - self.origin_c, np.zeros(self.joints), slot, noise=0.0)

    def reference(self, temperature_c: Array, slot: Array) -> tuple[Array, Array]:
        """Log F(v*, T0), wear included and noise left out, and its standard deviation, each (N,)."""
        H = self.reference_row(temperature_c, slot)
        mean = np.einsum("na,na->n", H, self.mean)
        return mean, np.sqrt(np.maximum(np.einsum("na,nab,nb->n", H, self.cov, H), 0.0))


def initial_filter(
    seen: Observation, settings: DriftSettings, *, fall_per_k: float, fall_std_per_k: float, coulomb_std_per_k: float
) -> FilterState:
    """Before the first replay: no wear, unknown levels, what the robot family's friction does with temperature.

    Only the origin and the size of the slopes are taken from the observation; `follow` then learns from it as from any other.
    """
    N = len(seen.log_torque)
    share = seen.viscous_share
    slope = fall_per_k * share
    mean = np.zeros((N, STATES))
    mean[:, SLOPE] = slope
    # log(1 − s + s·e^(−kt)) to second order: what a share s that falls exponentially leaves beyond a straight line
    mean[:, CURVE] = curve = 0.5 * fall_per_k**2 * share * (1.0 - share)
    mean[:, LAG] = slope * settings.grease_lag_min
    std = np.zeros((N, STATES))
    std[:, RATE] = settings.rate_std_per_day
    std[:, SLOPE] = np.hypot(fall_std_per_k * share, coulomb_std_per_k)
    std[:, CURVE] = curve
    std[:, LAG] = np.hypot(slope * settings.grease_lag_std_min, std[:, SLOPE] * settings.grease_lag_min)
    std[:, LEVELS:] = np.sqrt(DIFFUSE_VAR)
    rho = settings.autocorrelation
    var = np.full(N, settings.between_std**2)
    std[:, NOISE] = settings.between_std
    cov = std[:, :, None] * np.eye(STATES) * std[:, None, :]
    unknown = np.full(N, np.nan)
    return FilterState(
        origin_c=np.where(np.isfinite(seen.temperature_c), seen.temperature_c, settings.unknown_temperature_c),
        mean=mean,
        cov=cov,
        replays=np.zeros(N),
        interval_days=np.ones(N),
        step_var=var * (1.0 - rho),
        product=var * rho,
        noise_weight=np.full(N, settings.between_replays),
        residual=unknown,
        consistency=np.ones(N),
        innovation=unknown,
        normalised=unknown,
        event=np.full(N, float(UNRESOLVED)),
        gate_run=np.zeros(N),
        outliers=np.zeros(N),
        responses=np.zeros((N, KINDS, WINDOW, STATES)),
        ages=np.tile(np.arange(WINDOW, dtype=float), (N, 1)),
        glr_scores=np.zeros((N, KINDS, WINDOW)),
        raw_glr_scores=np.zeros((N, KINDS, WINDOW)),
        glr_informations=np.zeros((N, KINDS, WINDOW)),
        agreeing=np.ones(N),
        stepped=np.zeros(N),
    )


def predict_filter(state: FilterState, days: Array, arm: int, settings: DriftSettings, use: Array | None = None) -> FilterState:
    """The same track `days` (N,) later, less sure: wear goes on at its rate, and the rate wanders. Silence never shrinks it.

    use : (N,) usual days of work done meanwhile; None where nobody counts: every day is one.
    """
    N = state.joints
    use = days if use is None else use
    rho = state.autocorrelation(arm, settings)
    held = rho ** np.minimum(days / state.interval_days, 1e3)  # of the noise; an Ornstein–Uhlenbeck process looked at now and then
    F = np.tile(np.eye(STATES), (N, 1, 1))
    F[:, WEAR, RATE] = use
    F[:, NOISE, NOISE] = held
    q = settings.rate_walk_per_sqrt_day**2 + (settings.pace_walk_per_sqrt_day * state.mean[:, RATE]) ** 2  # (N,)
    Q = np.zeros((N, STATES, STATES))  # exact integral of a wandering rate, so that 30 days are 30 times one day
    Q[:, WEAR, WEAR] = settings.wear_walk_per_sqrt_day**2 * days + q * use**3 / 3.0
    Q[:, WEAR, RATE] = Q[:, RATE, WEAR] = q * use**2 / 2.0
    Q[:, RATE, RATE] = q * use
    Q[:, NOISE, NOISE] = state.noise_var(arm, settings) * (1.0 - held**2)
    # friction rises along a straight line, not its logarithm: there and back again, with the slope of each
    grown = np.exp(np.clip(state.mean[:, WEAR], *LOG_RISE))
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[:, WEAR] = grown - 1.0
    cov[:, WEAR, :] *= grown[:, None]
    cov[:, :, WEAR] *= grown[:, None]
    mean, cov = predict(mean, cov, F, Q)
    then = np.clip(1.0 + mean[:, WEAR], *np.exp(LOG_RISE))
    mean[:, WEAR] = np.log(then)
    cov[:, WEAR, :] /= then[:, None]
    cov[:, :, WEAR] /= then[:, None]
    responses = state.responses.copy()
    responses[..., WEAR] = (grown[:, None, None] * responses[..., WEAR] + use[:, None, None] * responses[..., RATE]) / then[:, None, None]
    responses[..., NOISE] *= held[:, None, None]
    return replace(state, mean=mean, cov=cov, responses=responses)


def rescale_rate(state: FilterState, factor: Array) -> FilterState:
    """The same track where a usual day has become `factor` (N,) as much work: a day's rate is as many times what it was."""
    mean, cov, responses = state.mean.copy(), state.cov.copy(), state.responses.copy()
    mean[:, RATE] *= factor
    cov[:, RATE, :] *= factor[:, None]
    cov[:, :, RATE] *= factor[:, None]
    responses[..., RATE] *= factor[:, None, None]
    return replace(state, mean=mean, cov=cov, responses=responses)


def open_slot(state: FilterState, slot: Array, opened: np.ndarray) -> FilterState:
    """For joints in `opened` (N,), the level of their slot (N,) unknown; wear and its rate stay with their doubt.

    Wear that coincides with the change cannot be seen. Another load shifts the viscous share, and with it the slope.
    """
    cov, mean, responses = state.cov.copy(), state.mean.copy(), state.responses.copy()
    n = np.flatnonzero(opened)
    at = LEVELS + slot[n]
    cov[n, at, :] = 0.0
    cov[n, :, at] = 0.0
    cov[n, at, at] = DIFFUSE_VAR
    mean[n, at] = 0.0
    responses[n, :, :, at] = 0.0
    cov[n, SLOPE, SLOPE] += (0.15 * mean[n, SLOPE]) ** 2
    return replace(state, mean=mean, cov=cov, responses=responses)


def replace_joints(state: FilterState, new: np.ndarray, settings: DriftSettings) -> FilterState:
    """For joints in `new` (N,), which were replaced: no wear, and levels unknown in every slot; temperature and noise stay the family's."""
    for slot in range(SLOTS):
        state = open_slot(state, np.full(state.joints, slot), new)
    mean, cov = state.mean.copy(), state.cov.copy()
    pair = np.array([WEAR, RATE])
    mean[np.ix_(new, pair)] = 0.0
    cov[np.ix_(new, pair)] = 0.0
    cov[np.ix_(new, np.arange(STATES), pair)] = 0.0
    cov[new, RATE, RATE] = settings.rate_std_per_day**2
    gone = {name: np.where(_of(new, getattr(state, name)), 0.0, getattr(state, name)) for name in _OF_THE_PAST}
    return replace(state, mean=mean, cov=cov, residual=np.where(new, np.nan, state.residual), **gone)


_OF_THE_PAST = ("replays", "outliers", "gate_run", "stepped", "responses", "glr_scores", "raw_glr_scores", "glr_informations")


def _of(mask: np.ndarray, like: Array) -> np.ndarray:
    """The mask (N,), to be broadcast against an array (N, …)."""
    return mask.reshape(-1, *(1,) * (like.ndim - 1))


def leave_context(state: FilterState, moved: np.ndarray) -> FilterState:
    """For joints in `moved` (N,), which are in another context now: what came just before does not compare."""
    return replace(
        state,
        residual=np.where(moved, np.nan, state.residual),
        gate_run=np.where(moved, 0.0, state.gate_run),
    )


def update_interval(state: FilterState, days: Array) -> FilterState:
    """The usual time between replays, after one that came `days` (N,) after the last; a holiday is no new habit."""
    usual = (days > 0) & (days < 10.0 * state.interval_days)
    step = np.log(np.where(usual, days, state.interval_days) / state.interval_days) / (np.minimum(state.replays, 10.0) + 1.0)
    return replace(state, interval_days=state.interval_days * np.exp(step))
