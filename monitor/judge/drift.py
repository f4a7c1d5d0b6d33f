"""Evidence, belief → belief: level, temperature slope, wear and wear rate of every joint, by a Kalman filter.

Per joint, with y = log F(v*, T), the friction torque at a reference speed:  y = a − β(T − T0) + w + ε,  w⁺ = w + ẇ·Δt.
Level a and wear w cannot be told apart by looking: w begins at 0 without doubt and a carries all of it. A new context
makes a unknown again and keeps w. The filter is filterpy's `predict` and `update`, one scalar measurement a joint and replay.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from filterpy.kalman import predict

from monitor.errors import BadInput
from monitor.identify.caveats import Caveat
from monitor.identify.identification import Identification
from monitor.judge.belief import LEVEL, RATE, SLOPE, UNSEEN, WEAR, Belief, OpenedContext, comparable, differences
from monitor.judge.evidence import DriftSettings, observe
from monitor.judge.kalman import filtered, numbers, symmetric
from monitor.judge.temperature import TemperatureSettings, begun, inside_range, learnt, reopened
from monitor.recording import Array, Context

SECONDS_PER_DAY = 86_400.0
DIFFUSE_VAR = 100.0  # log² of an unknown level: e^±10 holds every torque, and leaves 10 digits of float64 to the rest
CONTEXTS_KEPT = 16


class Learnt(NamedTuple):
    """The belief after a replay, and what the reader must know of how it came about."""

    belief: Belief
    caveats: tuple[Caveat, ...]


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
        noise_step_var=np.full(J, settings.between_std**2 * (1.0 - settings.autocorrelation)),
        autocorrelation=np.full(J, settings.autocorrelation),
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
        cov=symmetric(M @ belief.cov @ np.swapaxes(M, 1, 2)),  # (J, 4, 4)
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
        event=np.full(belief.joints, float(UNSEEN)),  # what came before says nothing of the noise to come
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
        text = f"joints {numbers(~known)}: no temperature: the replay is learnt with more doubt and counts for no alert"
        caveats.append(Caveat("temperature_unknown", text))
    if belief.replays < settings.settle_replays:
        mean_c = belief.reference_temperature_c + (np.where(known, T, belief.reference_temperature_c) - belief.reference_temperature_c) / (
            belief.replays + 1
        )
        belief = referred(belief, mean_c)
    inside = inside_range(belief.viscous.range_c, T, laws.margin_k)  # as learnt before this replay

    belief, more = filtered(belief, seen, elapsed_days, settings)
    caveats += more
    unworn = np.where(belief.learnt_from, np.exp(-belief.wear), np.nan)  # wear divided out, outliers left out
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
