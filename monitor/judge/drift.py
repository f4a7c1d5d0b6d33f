"""Evidence, belief → belief: level, temperature slope, wear and wear rate of every joint, by a Kalman filter.

Per joint, with y = log F(v*, T), the friction torque at a reference speed:  y = a − β(T − T0) + w + ε,  w⁺ = w + ẇ·Δt.
Level a and wear w cannot be told apart by looking: w begins at 0 without doubt and a carries all of it. A new context
makes a unknown again and keeps w. The filter is filterpy's `predict` and `update`, one scalar measurement a joint and replay.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from filterpy.kalman import predict, update

from monitor.errors import BadConfiguration, BadInput
from monitor.identify.solve import Caveat, Identification
from monitor.judge.belief import LEVEL, ORDINARY, OUTLIER, RATE, SLOPE, STEP, UNSEEN, WEAR, Belief, OpenedContext, comparable, differences
from monitor.judge.temperature import TemperatureSettings, begun, inside_range, learnt, reopened
from monitor.recording import Array, Context

SECONDS_PER_DAY = 86_400.0
DIFFUSE_VAR = 100.0  # log² of an unknown level: e^±10 holds every torque, and leaves 10 digits of float64 to the rest
CONTEXTS_KEPT = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftSettings:
    """How friction is expected to move when nothing, or something, is wrong."""

    reference_speed_rad_s: float = 0.4  # F here repeats to 1.3–2.3 % where fv alone scatters 4–10 %
    between_std: float = 0.02  # fraction, replay to replay, until the history tells better
    between_replays: float = 10.0  # how many replays that belief is worth
    between_floor: float = 0.003  # no history makes us surer than this: temperatures come in 1/16 K and friction is no constant
    memory_replays: float = 100.0  # the noise of long ago is forgotten
    autocorrelation: float = 0.3  # of the noise of successive replays, at first; then learnt
    autocorrelation_max: float = 0.7
    rate_std_per_day: float = 3e-4  # a new arm's wear rate: 11 % a year is one σ
    rate_walk_per_sqrt_day: float = 5e-5  # wear changes its pace within months
    wear_walk_per_sqrt_day: float = 5e-4  # 1 % in a year by chance
    gate_sigma: float = 4.0  # one replay further off than this is not learnt from …
    gate_run: int = 3  # … so many in a row on one side are a step
    cusum_slack: float = 0.5  # [σ] a shift of twice this is found quickest
    cusum_limit: float = 6.0  # [σ] by chance about once a robot-year; it only loosens the filter, it raises nothing
    resolution: float = 0.25  # a replay whose own std is a larger fraction of F says nothing of that joint
    settle_replays: int = 20  # T0 is the mean temperature of the first so many replays
    unknown_temperature_c: float = 25.0  # stands in where nothing measured it …
    unknown_temperature_std_k: float = 6.0  # … with this doubt

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the figure that is out of its range."""
        if not 0.2 <= self.reference_speed_rad_s <= 0.6:
            raise BadConfiguration(f"drift.reference_speed_rad_s = {self.reference_speed_rad_s!r}; expected 0.2 to 0.6 rad/s")
        for name in (
            "between_std",
            "between_floor",
            "between_replays",
            "memory_replays",
            "rate_std_per_day",
            "gate_sigma",
            "cusum_limit",
            "resolution",
        ):
            if not getattr(self, name) > 0:
                raise BadConfiguration(f"drift.{name} = {getattr(self, name)!r}; expected a positive number")
        for name in ("rate_walk_per_sqrt_day", "wear_walk_per_sqrt_day"):
            if not getattr(self, name) > 0:
                raise BadConfiguration(f"drift.{name} = {getattr(self, name)!r}; expected a positive number: silence must cost certainty")
        if not 0 <= self.autocorrelation <= self.autocorrelation_max < 1:
            raise BadConfiguration(f"drift.autocorrelation = {self.autocorrelation!r}; expected 0 ≤ it ≤ autocorrelation_max < 1")
        if self.gate_run < 2:
            raise BadConfiguration(f"drift.gate_run = {self.gate_run!r}; expected 2 or more")


class Observation(NamedTuple):
    """One replay as the filter sees it, (J,) each; NaN in `log_torque` where a joint was not resolved."""

    log_torque: Array
    variance: Array  # of log_torque, within the replay
    temperature_c: Array  # NaN where unknown
    viscous_share: Array  # of the torque at the reference speed


class Learnt(NamedTuple):
    """The belief after a replay, and what the reader must know of how it came about."""

    belief: Belief
    caveats: tuple[Caveat, ...]


def observe(identification: Identification, settings: DriftSettings) -> Observation:
    """The logarithm of friction torque at the reference speed, of every joint that moved and is resolved."""
    v = settings.reference_speed_rad_s
    torque, std = identification.friction_at(v)
    resolved = (torque > 0) & (std <= settings.resolution * np.abs(torque)) & (identification.max_speed_rad_s >= v)
    resolved &= np.isfinite(torque) & np.isfinite(std)
    F = np.where(resolved, torque, 1.0)
    unknown = np.full(len(F), np.nan)
    return Observation(
        log_torque=np.where(resolved, np.log(F), np.nan),
        variance=np.where(resolved, (std / F) ** 2, np.nan),  # Var log F ≈ Var F / F²
        temperature_c=unknown if identification.temperature_c is None else identification.temperature_c,
        viscous_share=np.clip(np.where(resolved, identification.viscous_nm_s_per_rad * v / F, 0.4), 0.05, 0.95),
    )


def begin(
    robot: str, context: Context, identification: Identification, at_unix_s: float, *, settings: DriftSettings, laws: TemperatureSettings
) -> Belief:
    """The belief before the first replay: no wear, an unknown level, the robot family's temperature slopes.

    Only T0 and the size of the slopes are taken from the identification; `learn` then learns from it as from any other.
    """
    seen = observe(identification, settings)
    J = len(seen.log_torque)
    known = np.isfinite(seen.temperature_c)
    T0 = np.where(known, seen.temperature_c, settings.unknown_temperature_c)
    mean = np.zeros((J, 4))
    mean[:, SLOPE] = laws.viscous_fall_per_k * seen.viscous_share
    cov = np.zeros((J, 4, 4))
    cov[:, LEVEL, LEVEL] = DIFFUSE_VAR
    cov[:, SLOPE, SLOPE] = (laws.viscous_fall_std_per_k * seen.viscous_share) ** 2 + laws.coulomb_fall_std_per_k**2
    cov[:, RATE, RATE] = settings.rate_std_per_day**2
    fc, fv = identification.coulomb_nm, identification.viscous_nm_s_per_rad
    return Belief(
        robot=robot,
        reference_speed_rad_s=settings.reference_speed_rad_s,
        at_unix_s=at_unix_s,
        began_at_unix_s=at_unix_s,
        replays=0,
        days=0,
        contexts=(OpenedContext(comparable(context), at_unix_s, 0),),
        reference_temperature_c=T0,
        mean=mean,
        cov=cov,
        joint_replays=np.zeros(J),
        noise_var=np.full(J, settings.between_std**2),
        noise_lag=np.full(J, settings.autocorrelation * settings.between_std**2),
        noise_weight=np.full(J, settings.between_replays),
        consistency=np.ones(J),
        innovation=np.full(J, np.nan),
        normalised_innovation=np.full(J, np.nan),
        event=np.full(J, float(UNSEEN)),
        gate_run=np.zeros(J),
        cusum=np.zeros((J, 2)),
        cusum_replays=np.zeros((J, 2)),
        outliers=np.zeros(J),
        temperature_c=seen.temperature_c,
        inside_range=np.zeros(J),
        viscous=begun(T0, fv, fall_per_k=laws.viscous_fall_per_k, fall_std_per_k=laws.viscous_fall_std_per_k, scatter=laws.scatter),
        coulomb=begun(T0, fc, fall_per_k=0.0, fall_std_per_k=laws.coulomb_fall_std_per_k, scatter=laws.scatter),
    )


def aged(belief: Belief, at_unix_s: float, settings: DriftSettings) -> Belief:
    """The same belief at a later time, less sure: wear goes on at its rate, and the rate wanders. Silence never shrinks it.

    Raises BadInput for a time before the belief's.
    """
    days = (at_unix_s - belief.at_unix_s) / SECONDS_PER_DAY
    if not days >= 0:
        raise BadInput(f"a belief of {belief.at_unix_s:.0f} s cannot be aged to {at_unix_s:.0f} s: that is before it")
    F = np.eye(4)
    F[WEAR, RATE] = days
    q = settings.rate_walk_per_sqrt_day**2
    Q = np.zeros((4, 4))  # exact integral of a wandering rate, so that 30 days are 30 times one day
    Q[WEAR, WEAR] = settings.wear_walk_per_sqrt_day**2 * days + q * days**3 / 3.0
    Q[WEAR, RATE] = Q[RATE, WEAR] = q * days**2 / 2.0
    Q[RATE, RATE] = q * days
    steps = [predict(x, P, F, Q) for x, P in zip(belief.mean, belief.cov, strict=True)]
    return replace(belief, mean=np.array([x for x, _ in steps]), cov=np.array([P for _, P in steps]), at_unix_s=at_unix_s)


def referred(belief: Belief, temperature_c: Array) -> Belief:
    """The same belief told at another T0 (J,): a' = a − β(T0' − T0). Nothing is learnt or forgotten."""
    M = np.tile(np.eye(4), (belief.joints, 1, 1))
    M[:, LEVEL, SLOPE] = belief.reference_temperature_c - temperature_c
    return replace(
        belief,
        mean=np.einsum("jab,jb->ja", M, belief.mean),
        cov=_symmetric(M @ belief.cov @ np.swapaxes(M, 1, 2)),  # (J, 4, 4)
        reference_temperature_c=temperature_c,
    )


def in_new_context(belief: Belief, context: Context, at_unix_s: float, laws: TemperatureSettings) -> Belief:
    """The level unknown again, wear and its rate kept with their doubt: wear that coincides with the change cannot be seen."""
    cov = belief.cov.copy()
    cov[:, LEVEL, :] = cov[:, :, LEVEL] = 0.0
    cov[:, LEVEL, LEVEL] = DIFFUSE_VAR
    cov[:, SLOPE, SLOPE] += (0.25 * belief.mean[:, SLOPE]) ** 2  # another load shifts the viscous share
    ledger = (*belief.contexts, OpenedContext(comparable(context), at_unix_s, 0))
    return replace(
        belief,
        contexts=ledger[-CONTEXTS_KEPT:],
        cov=cov,
        innovation=np.full(belief.joints, np.nan),
        normalised_innovation=np.full(belief.joints, np.nan),
        gate_run=np.zeros(belief.joints),
        cusum=np.zeros((belief.joints, 2)),
        cusum_replays=np.zeros((belief.joints, 2)),
        viscous=reopened(belief.viscous, laws),
        coulomb=reopened(belief.coulomb, laws),
    )


def learn(
    belief: Belief,
    identification: Identification,
    context: Context,
    at_unix_s: float,
    *,
    settings: DriftSettings,
    laws: TemperatureSettings,
) -> Learnt:
    """Evidence, belief → belief. The context is compared, the belief aged, T0 settled, the filter and the laws updated."""
    seen = observe(identification, settings)
    caveats: list[Caveat] = []
    changed = differences(belief.context, context)
    if changed:
        belief = in_new_context(belief, context, at_unix_s, laws)
        text = f"{'; '.join(changed)}: a new baseline begins, wear is carried over; wear that came with the change cannot be seen"
        caveats.append(Caveat("context_changed", text))
    elapsed_days = (at_unix_s - belief.at_unix_s) / SECONDS_PER_DAY
    new_day = belief.replays == 0 or math.floor(at_unix_s / SECONDS_PER_DAY) > math.floor(belief.at_unix_s / SECONDS_PER_DAY)
    belief = aged(belief, at_unix_s, settings)

    T = seen.temperature_c
    known = np.isfinite(T)
    if not known.all():
        text = f"joints {_numbers(~known)}: no temperature: the replay is learnt with more doubt and counts for no alert"
        caveats.append(Caveat("temperature_unknown", text))
    if belief.replays < settings.settle_replays:
        mean_c = belief.reference_temperature_c + (np.where(known, T, belief.reference_temperature_c) - belief.reference_temperature_c) / (
            belief.replays + 1
        )
        belief = referred(belief, mean_c)
    inside = inside_range(belief.viscous.range_c, T, laws.margin_k)  # as learnt before this replay

    belief, more = _filtered(belief, seen, elapsed_days, settings)
    caveats += more
    unworn = np.where(np.isin(belief.event, (ORDINARY, STEP)), np.exp(-belief.wear), np.nan)  # wear divided out, outliers left out
    now = belief.contexts[-1]
    return Learnt(
        replace(
            belief,
            replays=belief.replays + 1,
            days=belief.days + new_day,
            contexts=(*belief.contexts[:-1], now._replace(replays=now.replays + 1)),
            temperature_c=T,
            inside_range=inside.astype(float),
            viscous=learnt(belief.viscous, T, identification.viscous_nm_s_per_rad * unworn),
            coulomb=learnt(belief.coulomb, T, identification.coulomb_nm * unworn),
        ),
        tuple(caveats),
    )


def _filtered(belief: Belief, seen: Observation, elapsed_days: float, settings: DriftSettings) -> tuple[Belief, list[Caveat]]:
    """Gate, update and learn the noise, joint by joint."""
    J = belief.joints
    mean, cov = belief.mean.copy(), belief.cov.copy()
    noise_var, noise_lag, noise_weight = belief.noise_var.copy(), belief.noise_lag.copy(), belief.noise_weight.copy()
    cusum, cusum_replays = belief.cusum.copy(), belief.cusum_replays.copy()
    gate_run, outliers, consistency = belief.gate_run.copy(), belief.outliers.copy(), belief.consistency.copy()
    innovation, normalised, event = np.full(J, np.nan), np.full(J, np.nan), np.full(J, float(UNSEEN))
    rho = np.clip(belief.autocorrelation, 0.0, settings.autocorrelation_max)
    # what is alike from replay to replay averages out slowly: n correlated replays are worth n·(1−ρ)/(1+ρ)
    dulled = (1.0 + rho) / (1.0 - rho)

    recent = elapsed_days <= 3.0  # noise of longer ago has nothing to do with today's

    for j in np.flatnonzero(np.isfinite(seen.log_torque)):
        warm = seen.temperature_c[j] - belief.reference_temperature_c[j]
        within = seen.variance[j]
        if not math.isfinite(warm):
            within += (mean[j, SLOPE] ** 2 + cov[j, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
            warm = 0.0
        H = np.array([[1.0, -warm, 1.0, 0.0]])
        nu = float(seen.log_torque[j] - H[0] @ mean[j])
        foreseen = float(H[0] @ cov[j] @ H[0])
        z = nu / math.sqrt(foreseen + within + noise_var[j])
        innovation[j], normalised[j], event[j] = nu, z, ORDINARY

        if abs(z) > settings.gate_sigma:
            side = math.copysign(1.0, z)
            gate_run[j] = gate_run[j] + side if gate_run[j] * side > 0 else side
            outliers[j] += 1
            if abs(gate_run[j]) < settings.gate_run:
                event[j] = OUTLIER
                continue
            event[j] = STEP
            jump = nu  # so many on one side are no accident: wear has jumped, by about as much
        else:
            before = belief.normalised_innovation[j] if recent and belief.event[j] == ORDINARY else 0.0
            white = (z - rho[j] * before) / math.sqrt(1.0 - rho[j] ** 2 * (before != 0.0))
            cusum[j] = np.maximum(cusum[j] + [white, -white] - settings.cusum_slack, 0.0)
            cusum_replays[j] = np.where(cusum[j] > 0, cusum_replays[j] + 1, 0)
            side = int(np.argmax(cusum[j]))
            jump = 0.0
            if cusum[j, side] > settings.cusum_limit:
                event[j] = STEP
                jump = (settings.cusum_slack + cusum[j, side] / cusum_replays[j, side]) * math.sqrt(foreseen + within + noise_var[j])
        gate_run[j] = 0.0
        if event[j] == STEP:
            # as unsure of wear as the jump is large, and of its rate as with a new arm
            cov[j, WEAR, WEAR] += jump**2
            cov[j, RATE, RATE] += settings.rate_std_per_day**2
            cusum[j] = cusum_replays[j] = 0.0

        R = within + noise_var[j] * dulled[j]
        mean[j], P = update(mean[j], cov[j], np.array([seen.log_torque[j]]), np.array([[R]]), H)
        cov[j] = _symmetric(P)
        # only where the replay was foreseen well does its surprise tell the noise
        if event[j] == ORDINARY and foreseen <= 2.0 * (within + noise_var[j]):
            n = noise_weight[j] = min(noise_weight[j] + 1.0, settings.memory_replays)
            previous = belief.innovation[j]
            noise_var[j] = max(noise_var[j] + (nu**2 - foreseen - within - noise_var[j]) / n, settings.between_floor**2)
            if recent and belief.event[j] == ORDINARY:
                noise_lag[j] += (nu * previous - noise_lag[j]) / n
            consistency[j] += (z**2 - consistency[j]) / 20.0

    updated = replace(
        belief,
        mean=mean,
        cov=cov,
        joint_replays=belief.joint_replays + ((event == ORDINARY) | (event == STEP)),
        noise_var=noise_var,
        noise_lag=noise_lag,
        noise_weight=noise_weight,
        consistency=consistency,
        innovation=innovation,
        normalised_innovation=normalised,
        event=event,
        gate_run=gate_run,
        cusum=cusum,
        cusum_replays=cusum_replays,
        outliers=outliers,
    )
    return updated, _told(updated, settings)


def _told(belief: Belief, settings: DriftSettings) -> list[Caveat]:
    """What of the last update a reader must know."""
    caveats = []
    for j in np.flatnonzero(belief.event == OUTLIER):
        off, sigmas = belief.innovation[j], abs(belief.normalised_innovation[j])
        text = f"joint {j + 1}: {off:+.1%} from the expected friction, {sigmas:.1f} σ: not learnt from"
        caveats.append(Caveat("outlier", text))
    for j in np.flatnonzero(belief.event == STEP):
        text = f"joint {j + 1}: several replays off to one side, now by {belief.innovation[j]:+.1%}: taken as a change of the joint"
        caveats.append(Caveat("step", text))
    if (belief.event == UNSEEN).any():
        text = (
            f"joints {_numbers(belief.event == UNSEEN)}: friction at {belief.reference_speed_rad_s:g} rad/s is not resolved in this replay"
        )
        caveats.append(Caveat("joint_unseen", text))
    if (belief.consistency > 2.5).any():  # 20 replays' mean of χ²(1): 2.5 is about 5 σ
        text = f"joints {_numbers(belief.consistency > 2.5)}: replays scatter more than the filter believes"
        caveats.append(Caveat("filter_inconsistent", text))
    return caveats


def _symmetric(P: Array) -> Array:
    """Rounding leaves a covariance slightly lopsided; this does not change it otherwise."""
    even: Array = 0.5 * (P + np.swapaxes(P, -1, -2))
    return even


def _numbers(mask: np.ndarray) -> str:
    """The joints of a mask, counted from 1."""
    return " ".join(str(j + 1) for j in np.flatnonzero(mask))
