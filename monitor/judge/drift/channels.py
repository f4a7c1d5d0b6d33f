"""What the channels beside F(v*) remember of each joint, and what they found: values only.

Shapes: C channels in the order of `CHANNELS`, N joints, P features of the regression, W replays of the window.
"""

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from monitor.judge.drift.observation import Observation
from monitor.judge.drift.slots import SLOTS
from monitor.recording import Array

CONTRAST, SLOW, FAST, RESIDUAL, NOISE = range(5)
CHANNELS = ("contrast", "slow", "fast", "residual", "noise")
WINDOW = 32  # W [replays] in which a change is looked for; older replays are the baseline
SLOPE, CURVE, LAG = SLOTS, SLOTS + 1, SLOTS + 2  # features after the levels: t, t², warming
FEATURES = SLOTS + 3  # P


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelState:
    """The channels of N joints. In the window, index 0 is the newest replay."""

    mean: Annotated[Array, "C N P"]  # levels of the contexts' slots, slope [1/K], curve [1/K²], lag [1/(K/min)] of the baseline
    cov: Annotated[Array, "C N P P"]
    values: Annotated[Array, "C N L"]  # NaN where there is none
    t: Annotated[Array, "N L"]  # temperature less the origin [K]
    warming: Annotated[Array, "N L"]  # [K/min]
    slot: Annotated[Array, "N L"]  # of the replay's context
    variance: Annotated[Array, "C N"]  # of one replay around the baseline
    product: Annotated[Array, "C N"]  # mean product of two successive replays' residuals
    weight: Annotated[Array, "C N"]  # replays in both
    slow_ratio: Annotated[Array, "C N"]  # mean square of the window's mean over what correlated noise explains
    last: Annotated[Array, "C N"]  # residual of the last replay that left the window; NaN: none to compare with
    log_torque: Annotated[Array, "N"]  # y of the last replay that was resolved
    shift: Annotated[
        Array, "C N"
    ]  # [log] how far the replays since the likeliest change are from the baseline, beyond the arm's other joints
    shift_std: Annotated[Array, "C N"]
    level: Annotated[Array, "C N"]  # [log] of the baseline in the last replay's context at its temperature
    found: Annotated[Array, "C N"]  # 1 where that change is beyond chance


def no_channels(joints: int) -> ChannelState:
    """The channels of N joints before the first replay."""
    C, N, W = len(CHANNELS), joints, WINDOW
    unknown, zero = np.full((C, N), np.nan), np.zeros((C, N))
    mean, cov = prior(N)
    variance = np.full((C, N), PRIOR_STD**2)
    return ChannelState(
        mean=mean,
        cov=cov,
        values=np.full((C, N, W), np.nan),
        t=np.zeros((N, W)),
        warming=np.zeros((N, W)),
        slot=np.full((N, W), -1.0),
        variance=variance,
        product=PRIOR_CORRELATION * variance,
        weight=np.full((C, N), PRIOR_REPLAYS),
        slow_ratio=np.ones((C, N)),
        last=unknown,
        log_torque=np.full(N, np.nan),
        shift=zero,
        shift_std=zero,
        level=unknown,
        found=zero,
    )


DIFFUSE_VAR = 100.0  # [log²] of an unknown level
PRIOR_STD = 0.05  # [log] of one replay: fc and fv of real joints scatter by 4–10 %, and are anti-correlated
PRIOR_CORRELATION = 0.5  # of successive replays, as is assumed of friction: `DriftSettings.autocorrelation`
PRIOR_REPLAYS = 5.0  # weight of both
FALL_PER_K = 0.015  # viscous friction falls by 0.8–2.2 %/K, Coulomb friction hardly: Raviola et al. (2021)
SLOPES_PER_K = np.array([FALL_PER_K, 0.3 * FALL_PER_K, -0.3 * FALL_PER_K, 0.0, 0.0])  # (C,) the share of viscous friction is 0.2 to 0.8
SLOPE_STDS_PER_K = np.array([0.007, 0.005, 0.005, 0.01, 0.01])  # (C,) likewise; what temperature does to residual and noise is not known
CURVE_STDS = np.full(5, 1e-4)  # [1/K²] Vogel's law beyond an exponential; of sums, k²/2 · share · (1 − share)
LAG_MIN, LAG_STD_MIN = 3.0, 6.0  # [min] of the grease behind the motor's sensor


def prior(joints: int) -> tuple[Array, Array]:
    """Mean (C, N, P) and covariance (C, N, P, P) of a baseline before its first replay."""
    C, N = len(CHANNELS), joints
    mean = np.zeros((C, N, FEATURES))
    mean[..., SLOPE] = SLOPES_PER_K[:, None]
    mean[..., LAG] = -LAG_MIN * SLOPES_PER_K[:, None]
    std = np.full((C, FEATURES), np.sqrt(DIFFUSE_VAR))
    std[:, SLOPE], std[:, CURVE] = SLOPE_STDS_PER_K, CURVE_STDS
    std[:, LAG] = LAG_STD_MIN * np.hypot(SLOPES_PER_K, SLOPE_STDS_PER_K)
    cov = np.zeros((C, N, FEATURES, FEATURES))
    cov[..., range(FEATURES), range(FEATURES)] = (std**2)[:, None, :]
    return mean, cov


# --- What F(v*) does not show: a change of the contrast log fc − log fv, of friction at two more speeds, of residual and noise ---

AGES = np.array([5, 7, 10, 14, 20, 28])  # [replays] since a change; between them the loss of evidence is below a tenth
LENGTHS = np.append(AGES, WINDOW).astype(float)  # (A + 1,)
SINCE = (np.arange(WINDOW) < LENGTHS[:, None]).astype(float)  # (A + 1, W) which replays a mean is of
LEAST_KNOWN = 4  # replays of these that are known
CLIPPED = 3.5  # [σ] a replay counts with no more than this: most noise has longer tails than a Gaussian
SIGMAS = 5.5  # of the mean since the change: 0.002 a robot-year of Gaussian noise, the rest is for noise that changes
SETTLED = 0.25  # share of a replay's noise below which the baseline's variance must be, so that residuals are evidence of noise
LEAST_LEARNT = 12  # [replays] that noise must be learnt from, in one joint of the arm, before a change may be found
SUSPECT = 4.0  # [σ] from which the baseline does not learn: a change that is not found at once is not taken for the baseline
HELD = 0.5  # share of both thresholds at which a change that was found is over
# (C,) [log] smaller ones are within the error of the temperature law and of the fit; noise that grew by less is nothing to look at
LEAST_SHIFT = np.array([0.12, 0.04, 0.04, 0.2, np.log(2.0)])
LEAST_STD = np.array([0.02, 0.01, 0.01, 0.02, 0.02])  # (C,) [log] least noise of a replay that is assumed
CAUTION = (
    20.0  # variance estimated from n replays is multiplied by 1 + CAUTION/(n + ALIKE): noise has heavy tails, and replays are correlated
)
NEWEST, PERSISTS = 3, 0.5  # replays, and the share of the shift that they must have: a shock decays, and wear stays
MEMORY = 300.0  # [replays] over which noise is averaged
ALIKE = 30.0  # [replays] weight of the arm's mean noise in each joint's
MOST_CORRELATION = 0.95  # at 1 a mean of replays would tell nothing, however many there are
SLOW_WEIGHT = 2.0  # [windows] weight of the prior that noise is no slower than its correlation says
SLOW_CAUTION = 1.15  # a mean of squares that leaves out the largest is too small


class ChannelReplay(NamedTuple):
    """One replay as the channels need it, (N,) each."""

    observation: Observation
    origin_c: Array  # that temperature is counted from
    slot: Array
    opened: np.ndarray  # the slot's level is unknown
    replaced: np.ndarray  # the joint was replaced


def update_channels(before: ChannelState | None, replay: ChannelReplay, joints_per_arm: int) -> ChannelState:
    """The channels after a replay. Joints without friction or without temperature, and channels without a value, stay as they are."""
    state = no_channels(len(replay.slot)) if before is None else before
    state = restart(state, replay.slot, replay.opened, replay.replaced)
    seen = replay.observation
    t = seen.temperature_c - replay.origin_c
    here = np.isfinite(seen.log_torque) & np.isfinite(t)
    if not here.any():
        return state
    values = channel_values(seen)
    C = np.flatnonzero(np.isfinite(values).any(axis=1) | np.isfinite(state.values).any(axis=(1, 2)))  # channels that anybody measures
    warming = np.where(np.isfinite(seen.warming_k_per_min), seen.warming_k_per_min, 0.0)
    state = learn_oldest(state, C, here, joints_per_arm)
    t = np.where(here, t, 0.0)

    def pushed(old: Array, new: Array) -> Array:
        moved = np.concatenate([np.broadcast_to(new[..., None], (*old.shape[:-1], 1)), old[..., :-1]], axis=-1)
        return np.where(here[:, None], moved, old)

    state = replace(
        state,
        values=pushed(state.values, values),
        t=pushed(state.t, t),
        warming=pushed(state.warming, warming),
        slot=pushed(state.slot, replay.slot.astype(float)),
        log_torque=np.where(here, seen.log_torque, state.log_torque),
    )
    return look_for_changes(state, C, here, joints_per_arm)


def channel_values(seen: Observation) -> Array:
    """(C, N) the channels of a replay; NaN where a figure is missing or no friction."""
    N = len(seen.log_torque)

    def log(value: Array) -> Array:
        positive = np.isfinite(value) & (value > 0)
        return np.where(positive, np.log(np.where(positive, value, 1.0)), np.nan)

    def optional(value: Array) -> Array:
        return value if np.shape(value) == (N,) else np.full(N, np.nan)

    values = np.empty((len(CHANNELS), N))
    values[CONTRAST] = log(seen.coulomb_nm) - log(seen.viscous_nm_s_per_rad)
    values[SLOW] = optional(seen.log_torque_slow) - seen.log_torque
    values[FAST] = optional(seen.log_torque_fast) - seen.log_torque
    values[RESIDUAL] = log(optional(seen.residual_rms_nm))
    values[NOISE] = log(optional(seen.current_noise_a))
    return values


def rows(t: Array, warming: Array, slot: Array) -> Array:
    """(…, P) regressors of replays."""
    H = np.empty((*t.shape, FEATURES))
    H[..., :SLOTS] = slot[..., None] == np.arange(SLOTS)
    H[..., SLOPE], H[..., CURVE], H[..., LAG] = t, t * t, warming
    return H


def restart(state: ChannelState, slot: Array, opened: np.ndarray, replaced: np.ndarray) -> ChannelState:
    """The state with an unknown level in the slot of the joints in `opened`, and in every slot of those in `replaced`."""
    if not (opened.any() or replaced.any()):
        return state
    mean, cov, values = state.mean.copy(), state.cov.copy(), state.values.copy()
    for k in range(SLOTS):
        n = np.flatnonzero(replaced | (opened & (slot == k)))
        cov[:, n, k, :] = 0.0
        cov[:, n, :, k] = 0.0
        cov[:, n, k, k] = DIFFUSE_VAR
        mean[:, n, k] = 0.0
        values[:, (state.slot == k) & (replaced | (opened & (slot == k)))[:, None]] = np.nan
    new = replaced | opened
    return replace(
        state,
        mean=mean,
        cov=cov,
        values=values,
        last=np.where(new, np.nan, state.last),
        shift=np.where(new, 0.0, state.shift),
        shift_std=np.where(new, 0.0, state.shift_std),
        found=np.where(new, 0.0, state.found),
    )


def correlation(state: ChannelState, C: np.ndarray, joints_per_arm: int) -> Array:
    """(C, N) of successive replays' noise, one value for each arm: the mean over its joints, without the largest and the smallest."""
    rho = np.sort((state.product[C] / state.variance[C]).reshape(len(C), -1, joints_per_arm), axis=-1)
    trim = 1 if joints_per_arm > 3 else 0
    each = np.clip(rho[..., trim : joints_per_arm - trim].mean(axis=-1), 0.0, MOST_CORRELATION)
    of_joints: Array = np.repeat(each, joints_per_arm, axis=-1)
    return of_joints


def noise_variance(state: ChannelState, C: np.ndarray, joints_per_arm: int) -> Array:
    """(C, N) of one replay around the baseline: the joint's own, shrunk towards the arm's mean."""
    own, n = state.variance[C], state.weight[C]
    mean = np.repeat(own.reshape(len(C), -1, joints_per_arm).mean(axis=-1), joints_per_arm, axis=-1)
    cautious = (n * own + ALIKE * mean) / (n + ALIKE) * (1.0 + CAUTION / (n + ALIKE))
    shrunk: Array = np.maximum(cautious, LEAST_STD[C, None] ** 2)
    return shrunk


def noise_known(state: ChannelState, C: np.ndarray, joints_per_arm: int) -> np.ndarray:
    """(C, N) whether noise was learnt from enough replays of any joint of the arm: its joints have similar noise."""
    most = state.weight[C].reshape(len(C), -1, joints_per_arm).max(axis=-1)
    known: np.ndarray = np.repeat(most >= PRIOR_REPLAYS + LEAST_LEARNT, joints_per_arm, axis=-1)
    return known


def of_mean(rho: Array, n: float) -> Array:
    """Variance of the mean of n replays over that of one: (1+ρ)/((1−ρ)·n) − 2ρ·(1−ρⁿ)/(n·(1−ρ))², with noise of a correlation ρ."""
    away = 1.0 - rho
    ratio: Array = (1.0 + rho) / (away * n) - 2.0 * rho * (1.0 - rho**n) / (n * away) ** 2
    return ratio


def slow_noise(state: ChannelState, C: np.ndarray, joints_per_arm: int) -> Array:
    """(C, N) κ of each arm, at least 1: the joint with the largest ratio may have worn, and is left out."""
    each = np.sort(state.slow_ratio[C].reshape(len(C), -1, joints_per_arm), axis=-1)
    kept = each[..., :-1] if joints_per_arm > 2 else each
    of_joints: Array = np.repeat(np.maximum(SLOW_CAUTION * kept.mean(axis=-1), 1.0), joints_per_arm, axis=-1)
    return of_joints


def learn_oldest(state: ChannelState, C: np.ndarray, here: np.ndarray, joints_per_arm: int) -> ChannelState:
    """The state whose baseline and noise have learnt the oldest replay of the window, which leaves it."""
    y = state.values[C, :, -1]
    h = rows(state.t[:, -1], state.warming[:, -1], state.slot[:, -1])  # (N, P)
    shift = np.abs(state.shift[C])
    suspect = (shift >= SUSPECT * state.shift_std[C]) & (shift >= LEAST_SHIFT[C, None]) & noise_known(state, C, joints_per_arm)
    learns = here & np.isfinite(y) & (state.found[C] == 0) & ~suspect
    if not learns.any():
        return state
    mean, cov = state.mean[C], state.cov[C]
    rho, sigma2 = correlation(state, C, joints_per_arm), noise_variance(state, C, joints_per_arm)
    Ph = np.einsum("cnpq,nq->cnp", cov, h)
    level_var = np.einsum("cnp,np->cn", Ph, h)
    e = np.where(learns, y - np.einsum("cnp,np->cn", mean, h), 0.0)
    clip = CLIPPED * np.sqrt(sigma2 + level_var)
    clipped = np.clip(e, -clip, clip)
    # correlated replays teach as much as fewer independent ones
    R = sigma2 * (1.0 + rho) / (1.0 - rho)
    gain = np.where(learns, 1.0, 0.0)[..., None] * Ph / (level_var + R)[..., None]
    settled = learns & (level_var < SETTLED * R)
    n = np.where(settled, np.minimum(state.weight[C] + 1.0, MEMORY), state.weight[C])
    variance = np.where(settled, state.variance[C] + (clipped**2 - state.variance[C]) / n, state.variance[C])
    pair = settled & np.isfinite(state.last[C])
    product = np.where(pair, state.product[C] + (clipped * np.nan_to_num(state.last[C]) - state.product[C]) / n, state.product[C])

    def with_channels(old: Array, new: Array) -> Array:
        out = old.copy()
        out[C] = new
        return out

    return replace(
        state,
        mean=with_channels(state.mean, mean + gain * clipped[..., None]),
        cov=with_channels(state.cov, cov - gain[..., :, None] * Ph[..., None, :]),
        variance=with_channels(state.variance, np.maximum(variance, LEAST_STD[C, None] ** 2)),
        product=with_channels(state.product, product),
        weight=with_channels(state.weight, n),
        last=with_channels(state.last, np.where(settled, clipped, np.where(here & np.isfinite(y), np.nan, state.last[C]))),
    )


class Means(NamedTuple):
    """The replays since each possible change against the baseline, (C, N, A + 1) each; the last mean is of the whole window."""

    newest: Annotated[Array, "C N"]  # mean of the `NEWEST` replays
    level: Annotated[Array, "C N"]  # of the baseline at the last replay
    number: Array  # of known replays
    full: Array  # mean of their deviations
    robust: Array  # the same by deviations without what the replay before explains, none of them beyond `CLIPPED` of its σ
    var: Array  # of `robust` by chance
    ratio: Annotated[
        Array, "C N"
    ]  # square of the window's mean over what correlated noise and the baseline explain; NaN where that is not known


def means_since(state: ChannelState, C: np.ndarray, joints_per_arm: int) -> Means:
    """How far the replays since each possible change are from the baseline.

    Whitened noise is clipped, and not the noise itself: a shock that decays counts once, and wear counts in every replay.
    """
    H = rows(state.t, state.warming, state.slot)  # (N, W, P)
    mean, cov = state.mean[C], state.cov[C]
    rho, sigma2 = correlation(state, C, joints_per_arm), noise_variance(state, C, joints_per_arm)
    deviation = state.values[C] - np.einsum("nwp,cnp->cnw", H, mean)
    known = np.isfinite(deviation)
    e = np.where(known, deviation, 0.0)
    count = known @ SINCE.T
    many = np.maximum(count, 1.0)
    middle = SINCE @ H / LENGTHS[:, None]  # (N, A + 1, P)
    level_var = np.einsum("cnaq,naq->cna", np.matmul(middle, cov), middle)
    R = (sigma2 * (1.0 + rho) / (1.0 - rho))[..., None]  # n times the variance of the mean of n replays, for large n
    before = np.concatenate([np.where(known[..., 1:], e[..., 1:], e[..., :-1]), e[..., -1:]], axis=-1)
    # against the baseline's own error a replay is not clipped: an unknown level may be anywhere
    limit = CLIPPED * np.sqrt(sigma2 * (1.0 - rho**2) + level_var[..., -1])[..., None]
    white = np.where(known, np.clip(e - rho[..., None] * before, -limit, limit), 0.0) / (1.0 - rho[..., None])
    full = e @ SINCE.T / many
    explained = sigma2 * of_mean(rho, LENGTHS[-1]) * LENGTHS[-1] / many[..., -1] + level_var[..., -1]
    measured = (count[..., -1] >= 0.5 * WINDOW) & (level_var[..., -1] < SETTLED * R[..., 0])
    return Means(
        newest=e[..., :NEWEST].sum(axis=-1) / np.maximum(known[..., :NEWEST].sum(axis=-1), 1),
        level=np.einsum("np,cnp->cn", H[:, 0], mean),
        number=count,
        full=full,
        robust=white @ SINCE.T / many,
        var=slow_noise(state, C, joints_per_arm)[..., None] * R / many + level_var,
        ratio=np.where(measured, full[..., -1] ** 2 / explained, np.nan),
    )


def look_for_changes(state: ChannelState, C: np.ndarray, here: np.ndarray, joints_per_arm: int) -> ChannelState:
    """The state with the likeliest change of each joint's channels among the window's replays, for the joints in `here` (N,)."""
    means = means_since(state, C, joints_per_arm)
    enough = means.number >= np.maximum(LEAST_KNOWN, LENGTHS // 2)
    enough[..., -1] = False  # the whole window is for κ alone
    common = _common(np.where(enough, means.robust, np.nan), joints_per_arm)
    z = np.where(enough, _beyond(means.robust, common) / np.sqrt(means.var), 0.0)
    best = np.argmax(np.abs(z), axis=-1)[..., None]

    def pick(value: Array) -> Array:
        return np.take_along_axis(value, best, axis=-1)[..., 0]

    shift, sigmas = pick(_beyond(means.full, common)), np.abs(pick(z))
    before = state.found[C] > 0
    needed = np.where(before, HELD, 1.0)
    sure = noise_known(state, C, joints_per_arm)
    sure &= before | (means.newest * np.sign(shift) >= PERSISTS * np.abs(shift))
    found = sure & (sigmas >= needed * SIGMAS) & (np.abs(shift) >= needed * LEAST_SHIFT[C, None])
    replays = state.weight[C] + SLOW_WEIGHT * WINDOW
    learns = np.isfinite(means.ratio) & ~found
    slow_ratio = np.where(learns, state.slow_ratio[C] + (means.ratio - state.slow_ratio[C]) / replays, state.slow_ratio[C])

    def with_channels(old: Array, new: Array) -> Array:
        out = old.copy()
        out[C] = np.where(here, new, old[C])
        return out

    return replace(
        state,
        shift=with_channels(state.shift, shift),
        shift_std=with_channels(state.shift_std, np.sqrt(pick(means.var))),
        level=with_channels(state.level, means.level),
        found=with_channels(state.found, found.astype(float)),
        slow_ratio=with_channels(state.slow_ratio, slow_ratio),
    )


def _common(means: Array, joints_per_arm: int) -> Array:
    """(C, N, A) median over the arm's joints of the means since a change; 0 for an arm of one or two joints."""
    if joints_per_arm < 3:
        return np.zeros_like(means)
    C, N, A = means.shape
    of_arm = np.sort(means.reshape(C, -1, joints_per_arm, A), axis=2)  # NaN last
    known = np.isfinite(of_arm).sum(axis=2, keepdims=True)
    low = np.take_along_axis(of_arm, np.maximum((known - 1) // 2, 0), axis=2)
    high = np.take_along_axis(of_arm, np.minimum(known // 2, joints_per_arm - 1), axis=2)
    median = np.where(known >= 3, 0.5 * (low + high), 0.0)
    return np.repeat(median, joints_per_arm, axis=2).reshape(C, N, A)


def _beyond(value: Array, common: Array) -> Array:
    """The part of a change beyond the common one: nothing is left of a change that is smaller and on the same side."""
    return np.where(common >= 0, value - np.clip(value, 0.0, common), value - np.clip(value, common, 0.0))
