"""The state of the drift filter, as arrays over N joints: those of one arm, or of every arm of a fleet at once.

For each joint, with y = log F, F the friction torque at the reference speed, t = T − origin and Ṫ the rate at which the joint warms:

    y = a_c − β·t + γ·t² + λ·h(Ṫ) + w + n + ε,   w⁺ = w + e^(−w)·ẇ·Δu,   n⁺ = ρ·n + noise.

a_c is the level in context c, w the wear, n the noise between replays with correlation ρ, ε the noise within a replay. The observations do
not separate levels from wear: w begins at 0 with no uncertainty, and the level has all of it. A context that returns still has its level.
h is Ṫ where the joint warms slowly, and saturates: the grease lags behind the motor's sensor by nothing when motion begins, when Ṫ is
largest and both are equally cold, by most some time later, and by nothing in the steady state.
Δu is usage in usual days, and ẇ the increase of friction in a usual day as a fraction of the friction without wear. Equal usage causes
equal wear, so friction increases along a straight line and its logarithm does not.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from monitor.judge.drift.channels import ChannelState
from monitor.judge.drift.kalman import predict
from monitor.judge.drift.noise.chance import Chance, nothing_seen
from monitor.judge.drift.noise.correlation import own_correlation
from monitor.judge.drift.noise.size import STEADY, alike, present
from monitor.judge.drift.noise.volatility import Volatility, steady
from monitor.judge.drift.observation import VISCOUS_SHARE, Observation
from monitor.judge.drift.reference import Reference, forget, from_beginning
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.two_sources import TwoSources
from monitor.judge.drift.wear_history import age_history, empty_history, history_of_posterior, rescale_production, settle_slot
from monitor.recording import Array

WEAR, RATE, NOISE, SLOPE, CURVE, LAG = range(6)  # w [log], ẇ [1/usual day], n [log], β [1/K], γ [1/K²], λ [1/(K/min)]; then the levels
LEVELS = 6  # index of the first level
STATES = LEVELS + SLOTS  # S of an arm whose production never was observed; with production two more, see `two_sources`
PRODUCTION_LEVEL, PRODUCTION_NOISE = STATES, STATES + 1  # a_w [log], m [log] of production, where it was observed
PRODUCTION_LEVEL_WALK_PER_SQRT_DAY = 1e-3  # [log] random walk of a_w: 2 % in a year, as production changes little by little
WINDOW = 48  # W, number of replays at which a sudden change may have begun: the latest ones, and fewer of the older ones …
OLDEST = 200  # … up to so many replays ago
KINDS = 2  # of sudden changes: a step of wear, a new wear rate
DIFFUSE_VAR = 100.0  # [log²] of an unknown level: e^±10 covers every torque, and float64 keeps 10 digits for the rest
LOG_RISE = np.array([-3.0, 3.0])  # [log] bounds of wear: no joint has 20 times its friction, or a twentieth of it
RISE = np.exp(LOG_RISE)
UNKNOWN_NOISE = 1.5  # times the prior noise is assumed at first: noise above its prior would be taken for changes while it is learnt
PRIOR_CORRELATION = 8.0  # [replays] weight of the prior correlation of noise
REPLAYS_PER_LENGTH = 6.0  # of noise: a correlation over 1/(1 − ρ) replays needs so many times as many to show
SLOPE_CHANGE = 0.15  # [fraction] by which another load may change β: it shifts the share of viscous friction
FAST_K_PER_MIN = 0.1  # Ṫ at which h is half of Ṫ: two heat nodes of lags 3 to 30 min leave the same 0.1 to 0.5 % of F with 0.05 to 0.2
# What Ṫ does not tell of a lag L makes the steady state uncertain. Grease has T − L·Ṫ + L²·T̈ − …: the filter knows the second term, and
# the third is L/τ times as large in a motor that warms within τ. So the uncertainty grows with L². Learnt lags are about half of the true
# ones, because h saturates and Ṫ is noisy, and steady states were off by more than the third term: this time instead of τ covers that. It
# is a compromise by trial, as the square of the share that is extrapolated: 90 % intervals hold where lags are 3–6 min and where they are
# 10–30 min, where motors warm by 6–16 K and by 15–30 K.
LAG_SERIES_MIN = 2.0
LEAST_EXTRAPOLATED = 0.5  # a rare cold start differs much from the other replays, and tells little of what they see
LONGEST_LAG_MIN = 30.0  # more is not believed of a joint whose friction hardly depends on temperature, so that its lag is not known
LEAST_SLOPE = 1e-3  # [1/K] the same: β of less says nothing of the lag
WARMING_REPLAYS = 60.0  # memory of the usual warming rate and its square
HOLIDAY = 10.0  # times the usual interval: so long a pause says nothing about the usual interval …
LEAST_USUAL_DAYS = 1.0  # … or times a day where it is less: after replays within minutes, every later one would be a holiday
SURE_SIGMAS = 1.645  # a wear rate further above 0 is surely positive: 95 %, as for remaining life
ORDINARY, SETTLING, STEP, OUTLIER, UNRESOLVED = range(5)  # what the last replay was to a joint; the filter learns from the first three


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterState:
    """The filter's state of N joints."""

    origin_c: Annotated[Array, "N"]  # [°C] that t is counted from
    mean: Annotated[Array, "N S"]
    cov: Annotated[Array, "N S S"]
    replays: Annotated[Array, "N"]  # number that the filter learned from
    interval_days: Annotated[Array, "N"]  # usual time between replays, to which ρ belongs
    step_var: Annotated[Array, "N"]  # γ₁: half the mean square difference of successive replays' noise, without the noise within a replay
    product: Annotated[Array, "N"]  # c₁: mean product of successive replays' noise
    noise_weight: Annotated[Array, "N"]  # number of replays in both
    activity: Annotated[Array, "N"]  # γ₁ of the last weeks over γ₁, of all joints of the arm
    volatility: Volatility  # what a joint does beside that
    residual: Annotated[
        Array, "N"
    ]  # of the last replay against its prediction without noise; NaN where the next one must not be compared with it
    consistency: Annotated[Array, "N"]  # running mean of normalised innovations squared: 1 where the filter is consistent
    innovation: Annotated[Array, "N"]  # of the last replay; NaN where it was unresolved
    normalised: Annotated[Array, "N"]  # the same over its standard deviation
    event: Annotated[Array, "N"]  # ORDINARY, SETTLING, STEP, OUTLIER or UNRESOLVED: the last replay
    gate_run: Annotated[Array, "N"]  # signed count of gated replays in a row
    outliers: Annotated[Array, "N"]  # number of gated replays so far, without those that proved a step
    responses: Annotated[Array, "N 2 W S"]  # error that a unit change at an earlier replay has left in the filter
    ages: Annotated[Array, "N W"]  # [replays] since then, ascending
    glr_scores: Annotated[Array, "N 2 W"]  # of each such change: Σ G·ν/S with ν clipped
    raw_glr_scores: Annotated[Array, "N 2 W"]  # the same with ν in full
    glr_informations: Annotated[Array, "N 2 W"]  # Σ G²/S
    usual_warming: Annotated[Array, "N"]  # [K/min] mean |h(Ṫ)| of replays
    warming_square: Annotated[Array, "N"]  # [K²/min²] mean h(Ṫ)² of replays; NaN before the first
    agreeing: Annotated[Array, "N"]  # number of replays that agree with the last one: 1, or all since a change that was detected
    stepped: Annotated[Array, "N"]  # [log] wear that came in steps
    chance: Chance  # by how much more chance moves friction than the model says, by age
    counted_from: Reference  # from which level wear counts
    history: Annotated[Array, "N B K"]  # the course of friction so far, see `wear_history`
    channels: ChannelState | None = None  # beside y; None before the first replay
    sources: TwoSources | None = None  # None: replays alone were observed so far

    @property
    def joints(self) -> int:
        """N."""
        return len(self.mean)

    @property
    def wear(self) -> Array:
        """(N,) mean of w."""
        return self.mean[:, WEAR]

    @property
    def change(self) -> Array:
        """(N,) log of friction over that at the beginning: wear, and what was moved out of it since."""
        return self.wear + self.counted_from.moved

    @property
    def wear_std(self) -> Array:
        """(N,) standard deviation of w, with what chance adds beyond the model."""
        return np.sqrt(np.maximum(self.cov[:, WEAR, WEAR], 0.0) * self.chance.of_wear())

    @property
    def learnt_from(self) -> np.ndarray:
        """(N,) whether the filter learned from the last replay of the joint."""
        learnt: np.ndarray = self.event <= STEP
        return learnt

    def autocorrelation(self, joints_per_arm: int, settings: DriftSettings) -> Array:
        """(N,) ρ of the noise of successive replays: the arm's, or the joint's own as far as this arm's joints differ.

        With γ₁ = E[(εₖ − εₖ₋₁)²]/2 = σ²(1−ρ) and c₁ = E[εₖ·εₖ₋₁] = σ²ρ: ρ = c₁/(c₁ + γ₁). Few replays cannot show a long correlation: a
        filter that believed in it would take all of their scatter for noise that fades, and go on believing.
        """
        J = joints_per_arm
        n = self.noise_weight.reshape(-1, J).mean(axis=1)
        most = np.clip(1.0 - REPLAYS_PER_LENGTH / np.maximum(n, 1e-9), settings.autocorrelation, settings.autocorrelation_max)
        centre = self.correlation_seen(J)
        shown = (n * centre + PRIOR_CORRELATION * settings.autocorrelation) / (n + PRIOR_CORRELATION)
        own = own_correlation(self.each_correlation_seen, np.repeat(centre, J), np.repeat(shown, J), self.noise_weight, J)
        rho: Array = np.clip(own, 0.0, np.repeat(most, J))
        return rho

    @property
    def each_correlation_seen(self) -> Array:
        """(N,) ρ of each joint alone, without a prior and bounds."""
        seen: Array = self.product / np.maximum(self.product + self.step_var, 1e-12)
        return seen

    def correlation_seen(self, joints_per_arm: int) -> Array:
        """(A,) ρ of each arm without its prior and its bounds: the trimmed mean over the arm's joints, since one of them may wear."""
        J = joints_per_arm
        each = np.sort(self.each_correlation_seen.reshape(-1, J), axis=1)
        trim = J // 6 + (J == 5)
        mean: Array = each[:, trim : J - trim].mean(axis=1)
        return mean

    def noise_var(self, joints_per_arm: int, settings: DriftSettings, rho: Array | None = None) -> Array:
        """(N,) variance of the noise between replays at present: σ² = γ₁/(1 − ρ), larger after few replays. rho : ρ, where it is known."""
        if rho is None:
            rho = self.autocorrelation(joints_per_arm, settings)
        usual = alike(self.step_var, self.noise_weight, joints_per_arm)
        cautious = 1.0 + settings.caution / np.sqrt(self.noise_weight)
        now = present(self.activity, joints_per_arm) * self.volatility.factor(joints_per_arm)
        var: Array = usual * now * cautious / (1.0 - rho)
        return var

    def level(self, slot: Array) -> Array:
        """(N,) mean of the level in a slot (N,), at the origin."""
        levels: Array = self.mean[np.arange(self.joints), LEVELS + slot]
        return levels

    def row(self, t: Array, warming: Array, slot: Array, *, noise: float = 1.0) -> Array:
        """(N, S) H of a replay at t = T − origin [K], a warming rate [K/min] and a slot, (N,) each; `noise` is the entry of n."""
        H = np.zeros((self.joints, self.mean.shape[1]))
        H[:, WEAR], H[:, NOISE] = 1.0, noise
        H[:, SLOPE], H[:, CURVE], H[:, LAG] = -t, t * t, saturating(warming)
        H[np.arange(self.joints), LEVELS + slot] = 1.0
        return H

    def slope_at(self, temperature_c: Array) -> Array:
        """(N,) −∂y/∂T at temperatures (N,): β − 2γt [1/K]."""
        slope: Array = self.mean[:, SLOPE] - 2.0 * self.mean[:, CURVE] * (temperature_c - self.origin_c)
        return slope

    def missed_var(self, settings: DriftSettings) -> Array:
        """(N,) variance of log F that an unknown temperature leaves in one replay."""
        var: Array = (self.mean[:, SLOPE] ** 2 + self.cov[:, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
        return var

    def reference_row(self, temperature_c: Array, slot: Array) -> Array:
        """(N, S) H of `reference`: wear included, noise left out."""
        return self.row(temperature_c - self.origin_c, np.zeros(self.joints), slot, noise=0.0)

    @property
    def extrapolated(self) -> Array:
        """(N,) share of the steady state that is extrapolated: the squared mean of the warming rates over their mean square.

        1 where all replays warm alike; less where some of them are made at other rates, nearer to the steady state or further from it.
        """
        known = self.warming_square > 0.0  # nor is NaN
        share: Array = np.where(known, self.usual_warming**2 / np.where(known, self.warming_square, 1.0), 1.0)
        return share

    def steady_mean(self, temperature_c: Array, slot: Array) -> Array:
        """(N,) mean of `reference`."""
        mean: Array = np.einsum("na,na->n", self.reference_row(temperature_c, slot), self.mean)
        return mean

    def reference(self, temperature_c: Array, slot: Array) -> tuple[Array, Array]:
        """Mean and standard deviation of log F at a temperature (N,) in the steady state, wear included and noise left out, (N,) each.

        Where replays are made while the joint warms, the steady state is an extrapolation: less certain the longer the lag, and the less
        the warming rate differs from replay to replay.
        """
        H = self.reference_row(temperature_c, slot)
        mean = np.einsum("na,na->n", H, self.mean)
        lag = np.minimum(np.abs(self.mean[:, LAG]) / np.maximum(np.abs(self.mean[:, SLOPE]), LEAST_SLOPE), LONGEST_LAG_MIN)
        extrapolated = np.maximum(self.extrapolated**2, LEAST_EXTRAPOLATED)
        unknown = self.mean[:, LAG] * self.usual_warming * extrapolated * lag / LAG_SERIES_MIN
        var = np.einsum("na,nab,nb->n", H, self.cov, H) + unknown**2
        return mean, np.sqrt(np.maximum(var, 0.0))


def initial_filter(
    observation: Observation, settings: DriftSettings, *, fall_per_k: float, fall_std_per_k: float, coulomb_std_per_k: float
) -> FilterState:
    """The state before the first replay: no wear, unknown levels, and the robot family's dependence on temperature.

    Only the origin and the size of the slopes come from the observation; the filter learns from it as from any other afterwards.
    fall_per_k, fall_std_per_k : by which viscous friction falls, as a fraction. coulomb_std_per_k : of Coulomb friction, whose mean is 0.
    """
    N = len(observation.log_torque)
    share = np.where(np.isfinite(observation.viscous_share), observation.viscous_share, VISCOUS_SHARE)  # an arm may begin absent
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
    var = np.full(N, (UNKNOWN_NOISE * settings.between_std) ** 2)
    std[:, NOISE] = UNKNOWN_NOISE * settings.between_std
    cov = std[:, :, None] * np.eye(STATES) * std[:, None, :]
    unknown = np.full(N, np.nan)
    return FilterState(
        origin_c=np.where(np.isfinite(observation.temperature_c), observation.temperature_c, settings.unknown_temperature_c),
        mean=mean,
        cov=cov,
        replays=np.zeros(N),
        interval_days=np.ones(N),
        step_var=var * (1.0 - rho),
        product=var * rho,
        noise_weight=np.full(N, settings.between_replays),
        activity=np.full(N, STEADY),
        volatility=steady(N),
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
        usual_warming=np.zeros(N),
        warming_square=unknown,
        agreeing=np.ones(N),
        stepped=np.zeros(N),
        history=empty_history(N, SLOTS),
        counted_from=from_beginning(N),
        chance=nothing_seen(N),
    )


def begin_history(state: FilterState, slot: Array) -> FilterState:
    """The state of a release that kept no history, with one along a straight line to its wear. slot : (N,) of the context in force."""
    rate, rate_std = state.mean[:, RATE], np.sqrt(np.maximum(state.cov[:, RATE, RATE], 0.0))
    history = history_of_posterior(
        state.level(slot),
        state.wear,
        rate,
        sure=(rate > SURE_SIGMAS * rate_std) & (state.wear > 0),
        slot=slot,
        slots=SLOTS,
        days=state.replays * state.interval_days,
    )
    return replace(state, history=history)


def predict_filter(state: FilterState, days: Array, joints_per_arm: int, settings: DriftSettings, use: Array | None = None) -> FilterState:
    """The state before the next replay: the Kalman filter's prediction. Wear grows at its rate, the rate wanders, the noise decays.

    days : (N,) time since the last replay [d]. use : (N,) usage in that time, in usual days of the joint; None where revolutions are not
    counted: then every day counts as a usual one. Wear and its rate follow the continuous white noise acceleration model of Bar-Shalom,
    Li and Kirubarajan (2001), section 6.2, over `use`.
    """
    N = state.joints
    use = days if use is None else use
    rho = state.autocorrelation(joints_per_arm, settings)
    interval = state.interval_days if state.sources is None else state.sources.interval_days
    decay = rho ** np.minimum(days / interval, 1e3)  # share of n that is left: an Ornstein–Uhlenbeck process
    S = state.mean.shape[1]
    F = np.repeat(np.eye(S)[None], N, axis=0)
    F[:, WEAR, RATE] = use
    F[:, NOISE, NOISE] = decay
    q = settings.rate_walk_per_sqrt_day**2 + (settings.pace_walk_per_sqrt_day * state.mean[:, RATE]) ** 2  # (N,)
    Q = np.zeros((N, S, S))  # exact integral of the rate's random walk, so that 30 days equal 30 times one day
    Q[:, WEAR, WEAR] = settings.wear_walk_per_sqrt_day**2 * days + q * use**3 / 3.0
    Q[:, WEAR, RATE] = Q[:, RATE, WEAR] = q * use**2 / 2.0
    Q[:, RATE, RATE] = q * use
    Q[:, NOISE, NOISE] = state.noise_var(joints_per_arm, settings, rho) * (1.0 - decay**2)
    sources, other_decay = state.sources, np.ones(N)
    if sources is not None:
        other = other_source(state, sources)
        other_rho = other.autocorrelation(joints_per_arm, settings)
        other_decay = other_rho ** np.minimum(days / sources.other_interval_days, 1e3)
        F[:, PRODUCTION_NOISE, PRODUCTION_NOISE] = other_decay
        Q[:, PRODUCTION_NOISE, PRODUCTION_NOISE] = other.noise_var(joints_per_arm, settings, other_rho) * (1.0 - other_decay**2)
        Q[:, PRODUCTION_LEVEL, PRODUCTION_LEVEL] = PRODUCTION_LEVEL_WALK_PER_SQRT_DAY**2 * days
        sources = replace(
            sources,
            since_days=sources.since_days + days,
            other_since_days=sources.other_since_days + days,
            unconfirmed=sources.unconfirmed + sources.unconfirmed_rate * use,
        )
    # friction increases along a straight line: predict e^w − 1, and return to w, with the derivative of each map in the covariance
    grown = np.exp(np.clip(state.mean[:, WEAR], *LOG_RISE))
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[:, WEAR] = grown - 1.0
    cov[:, WEAR, :] *= grown[:, None]
    cov[:, :, WEAR] *= grown[:, None]
    mean, cov = predict(mean, cov, F, Q)
    then = np.clip(1.0 + mean[:, WEAR], *RISE)
    mean[:, WEAR] = np.log(then)
    cov[:, WEAR, :] /= then[:, None]
    cov[:, :, WEAR] /= then[:, None]
    responses = state.responses.copy()
    responses[..., WEAR] = (grown[:, None, None] * responses[..., WEAR] + use[:, None, None] * responses[..., RATE]) / then[:, None, None]
    responses[..., NOISE] *= decay[:, None, None]
    if sources is not None:
        responses[..., PRODUCTION_NOISE] *= other_decay[:, None, None]
    return replace(state, mean=mean, cov=cov, responses=responses, history=age_history(state.history, use, days), sources=sources)


def other_source(state: FilterState, sources: TwoSources) -> FilterState:
    """The state as far as `noise_var` and `autocorrelation` of the other source need it: replays are in force."""
    return replace(
        state,
        step_var=sources.other_step_var,
        product=sources.other_product,
        noise_weight=sources.other_noise_weight,
        activity=sources.other_activity,
        volatility=sources.other_volatility,
    )


def rescale_rate(state: FilterState, factor: Array) -> FilterState:
    """The state after a usual day became `factor` (N,) times as much usage: the wear rate per usual day is as many times larger."""
    if (factor == 1.0).all():  # as ever where nobody counts revolutions
        return state
    mean, cov, responses = state.mean.copy(), state.cov.copy(), state.responses.copy()
    mean[:, RATE] *= factor
    cov[:, RATE, :] *= factor[:, None]
    cov[:, :, RATE] *= factor[:, None]
    responses[..., RATE] *= factor[:, None, None]
    return replace(state, mean=mean, cov=cov, responses=responses, history=rescale_production(state.history, factor))


def open_slot(state: FilterState, slot: Array, opened: np.ndarray) -> FilterState:
    """The state with an unknown level in the slot (N,) of the joints in `opened` (N,). Wear and its rate keep their uncertainty.

    Wear that coincides with the change cannot be observed. Another load changes the share of viscous friction, and with it the slope.
    """
    cov, mean, responses = state.cov.copy(), state.mean.copy(), state.responses.copy()
    of_replays = opened & (slot < SLOTS)
    history = settle_slot(state.history, np.minimum(slot, SLOTS - 1), state.level(slot), of_replays)
    n = np.flatnonzero(opened)
    at = LEVELS + slot[n]
    cov[n, at, :] = 0.0
    cov[n, :, at] = 0.0
    cov[n, at, at] = DIFFUSE_VAR
    mean[n, at] = 0.0
    responses[n, :, :, at] = 0.0
    cov[n, SLOPE, SLOPE] += (SLOPE_CHANGE * mean[n, SLOPE]) ** 2
    return replace(state, mean=mean, cov=cov, responses=responses, history=history)


def replace_joints(state: FilterState, new: np.ndarray, settings: DriftSettings) -> FilterState:
    """The state with no wear and unknown levels for the joints in `new` (N,), in every slot and in production.

    The slope becomes less certain.
    """
    slope_var = state.cov[new, SLOPE, SLOPE] + (SLOPE_CHANGE * state.mean[new, SLOPE]) ** 2  # once, and not once a slot
    for slot in range(SLOTS if state.sources is None else PRODUCTION_LEVEL - LEVELS + 1):
        state = open_slot(state, np.full(state.joints, slot), new)
    mean, cov = state.mean.copy(), state.cov.copy()
    cov[new, SLOPE, SLOPE] = slope_var
    pair = np.array([WEAR, RATE])
    mean[np.ix_(new, pair)] = 0.0
    cov[np.ix_(new, pair)] = 0.0
    cov[np.ix_(new, np.arange(cov.shape[1]), pair)] = 0.0
    cov[new, RATE, RATE] = settings.rate_std_per_day**2
    cleared: dict[str, Any] = {name: np.where(_of(new, getattr(state, name)), 0.0, getattr(state, name)) for name in _HISTORY}
    fresh = forget(state.counted_from, new)
    chance = state.chance.since_change(np.zeros(state.joints), new, np.zeros(state.joints))
    residual = np.where(new, np.nan, state.residual)
    sources = state.sources and state.sources.of_new_joints(new)
    return replace(state, mean=mean, cov=cov, counted_from=fresh, chance=chance, residual=residual, sources=sources, **cleared)


def unknown_joint(state: FilterState, new: np.ndarray, settings: DriftSettings, *, slope_std: float) -> FilterState:
    """The state with the noise of a joint never seen in the joints of `new` (N,), and a slope that is a first guess."""
    n = np.flatnonzero(new)
    rho, var = settings.autocorrelation, (UNKNOWN_NOISE * settings.between_std) ** 2
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[n, NOISE] = 0.0
    for entry, least_var in ((NOISE, 0.0), (SLOPE, slope_std**2)):
        own = np.maximum(cov[n, entry, entry], least_var) if entry == SLOPE else np.full(len(n), var)
        cov[n, entry, :] = 0.0
        cov[n, :, entry] = 0.0
        cov[n, entry, entry] = own
    return replace(
        state,
        mean=mean,
        cov=cov,
        step_var=np.where(new, var * (1.0 - rho), state.step_var),
        product=np.where(new, var * rho, state.product),
        noise_weight=np.where(new, settings.between_replays, state.noise_weight),
        volatility=state.volatility.of_new_joints(new),
        consistency=np.where(new, 1.0, state.consistency),
        agreeing=np.where(new, 1.0, state.agreeing),
    )


_HISTORY = ("replays", "outliers", "gate_run", "stepped", "responses", "glr_scores", "raw_glr_scores", "glr_informations", "history")


def _of(mask: np.ndarray, like: Array) -> np.ndarray:
    """The mask (N,), shaped to be broadcast against an array (N, …)."""
    return mask.reshape(-1, *(1,) * (like.ndim - 1))


def leave_context(state: FilterState, moved: np.ndarray) -> FilterState:
    """The state of joints that entered another context, `moved` (N,): the replays before are not compared with the next one."""
    return replace(
        state,
        residual=np.where(moved, np.nan, state.residual),
        gate_run=np.where(moved, 0.0, state.gate_run),
    )


def saturating(warming: Array) -> Array:
    """h(Ṫ) [K/min] at warming rates (N,): odd, so that the noise of a rate about zero cancels."""
    slowed: Array = warming / (1.0 + np.abs(warming) / FAST_K_PER_MIN)
    return slowed


def remember_warming(state: FilterState, warming_k_per_min: Array) -> FilterState:
    """The state with the usual warming rate after a replay at rates (N,), NaN where unknown, that the filter learned from."""
    seen = state.learnt_from & np.isfinite(warming_k_per_min)
    rate = np.abs(saturating(warming_k_per_min))
    first = np.isnan(state.warming_square)
    share = 1.0 / np.clip(state.replays, 1.0, WARMING_REPLAYS)

    def learn(mean: Array, value: Array) -> Array:
        learnt: Array = np.where(seen, np.where(first, value, mean + share * (value - mean)), mean)
        return learnt

    return replace(state, usual_warming=learn(state.usual_warming, rate), warming_square=learn(state.warming_square, rate**2))


def update_interval(state: FilterState, days: Array) -> FilterState:
    """The state with the usual interval after a replay that came `days` (N,) after the last one. A holiday does not change it."""
    return replace(state, interval_days=state.interval_days * interval_growth(days, state.interval_days, state.replays))


def interval_growth(days: Array, interval_days: Array, number: Array) -> Array:
    """(N,) factor on the usual interval after an observation `days` (N,) after the last one, `number` (N,) having been seen before.

    It is 1 after a holiday, and where `days` is 0.
    """
    usual = (days > 0) & (days < HOLIDAY * np.maximum(interval_days, LEAST_USUAL_DAYS))
    growth: Array = np.exp(np.log(np.where(usual, days, interval_days) / interval_days) / (np.minimum(number, 10.0) + 1.0))
    return growth
