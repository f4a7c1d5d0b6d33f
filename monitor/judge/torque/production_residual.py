"""Production residuals: what normal work, listened to, says of friction between replays. Advisory evidence, never an alert.

A moving joint's torque is measured − predicted off by ΔF against its motion, whatever moves it. Over a span of work the ratio of that
to the friction foreseen is how much friction has changed since the model's last replay. Work is no excitation: unknown loads,
contact and slow samples make it unsure, and biased alike from day to day. So each span is one look with a wide doubt, the first
spans after a replay are what is usual in this work, and only a clear and lasting rise beyond them asks for a replay.
"""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval

from monitor.judge.torque.predictor import TorquePrediction
from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSettings:
    """What of normal work is listened to, and how much it must say."""

    min_speed_rad_s: Annotated[float, Interval(ge=0.01, le=3.0)] = 0.1  # slower, friction is pre-sliding and its sign is noise
    max_acceleration_rad_s2: Annotated[float, Interval(ge=0.1, le=100.0)] = 3.0  # harder, inertia of unknown loads hides friction
    span_s: Annotated[float, Interval(ge=60.0, le=86400.0)] = 3600.0  # of motion, by joint, that make one look
    min_samples: Annotated[int, Interval(ge=10, le=1_000_000)] = 200  # fewer in a span say nothing
    doubt: Annotated[float, Interval(ge=0.01, le=1.0)] = (
        0.08  # [fraction of friction] by which work of another kind is off; one σ of a look
    )
    baseline_looks: Annotated[int, Interval(ge=1, le=100)] = 3  # what is usual for this work, learnt anew after each replay
    rise: Annotated[float, Interval(ge=0.01, le=10.0)] = 0.10  # [fraction of friction] beyond the usual that matters
    sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.99  # P(rise > 0) that pulls a replay forward …
    min_looks: Annotated[int, Interval(ge=1, le=100)] = 3  # … in so many looks in a row


class ProductionResiduals(NamedTuple):
    """What was heard since the last replay, (J,) arrays; a value to be handed on from sample to sample."""

    revision: int  # of the model that it is measured against
    samples: Array  # of the present span
    moving_s: Array
    work: Array  # Σ foreseen friction² · dt
    excess: Array  # Σ residual along the motion · foreseen friction · dt
    looks: Array  # spans so far
    usual: Array  # mean change in the baseline looks, fraction
    change: Array  # mean change of the looks after, beyond the usual, fraction; NaN before
    later: Array  # looks in it
    agreeing: Array  # looks in a row beyond the rise


class ProductionEvidence(NamedTuple):
    """Of one joint: friction in production against what the model foresees, fraction, beyond what is usual; with its wide doubt."""

    joint: int  # from 1
    change: float
    std: float
    looks: int
    probability: float  # that friction has risen at all


def initial(joints: int, revision: int) -> ProductionResiduals:
    """Nothing was heard since the model of that revision."""
    zero = np.zeros(joints)
    return ProductionResiduals(revision, zero, zero, zero, zero, zero, zero, np.full(joints, np.nan), zero, zero)


def update(
    so_far: ProductionResiduals | None,
    revision: int,
    predicted: TorquePrediction,
    measured_nm: Array,
    qd: Array,
    qdd: Array,
    dt_s: float,
    settings: ResidualSettings,
) -> ProductionResiduals:
    """After one more sample of the arm at work, (J,) each; a new model begins anew.

    dt_s : since the last sample; a pause longer than a second counts as one second. Samples outside the learnt temperatures, too slow or
    too hard say nothing.
    """
    J = len(qd)
    if so_far is None or so_far.revision != revision or len(so_far.samples) != J:
        so_far = initial(J, revision)
    friction = predicted.friction[0]
    use = (np.abs(qd) >= settings.min_speed_rad_s) & (np.abs(qdd) <= settings.max_acceleration_rad_s2) & ~predicted.extrapolated[0]
    use &= np.isfinite(measured_nm) & np.isfinite(friction) & (friction * qd > 0)
    dt = float(np.clip(dt_s, 0.0, 1.0)) * use
    left = np.where(use, measured_nm - predicted.torque[0], 0.0)
    known = np.where(use, friction, 0.0)
    now = so_far._replace(
        samples=so_far.samples + use,
        moving_s=so_far.moving_s + dt,
        work=so_far.work + known**2 * dt,
        excess=so_far.excess + left * known * dt,
    )
    done = now.moving_s >= settings.span_s
    return _looked(now, done, settings) if done.any() else now


def production_evidence(residuals: ProductionResiduals | None, settings: ResidualSettings) -> tuple[ProductionEvidence, ...]:
    """Of every joint that was looked at often enough."""
    if residuals is None:
        return ()
    told = []
    for j in np.flatnonzero(residuals.later > 0):
        # what is usual is known no better than its looks tell, and work of another kind is alike from look to look: half of it stays
        std = settings.doubt * math.sqrt(0.5 + 0.5 / residuals.later[j] + 1.0 / settings.baseline_looks)
        change = float(residuals.change[j])
        told.append(ProductionEvidence(int(j) + 1, change, std, int(residuals.later[j]), 0.5 * math.erfc(-change / std / math.sqrt(2.0))))
    return tuple(told)


def pull_forward(residuals: ProductionResiduals | None, settings: ResidualSettings) -> str | None:
    """Why the next replay should not wait, in words; None where production says nothing of the kind.

    It asks for a replay and for nothing else: whether a joint has worn is for the replay to say.
    """
    if residuals is None:
        return None
    for each in production_evidence(residuals, settings):
        j = each.joint - 1
        if each.change >= settings.rise and each.probability >= settings.sure and residuals.agreeing[j] >= settings.min_looks:
            return (
                f"joint {each.joint}: at work, friction is {each.change:+z.0%} ± {each.std:.0%} from what is usual, "
                f"in {residuals.agreeing[j]:.0f} spans of motion in a row: a replay shall tell"
            )
    return None


def _looked(now: ProductionResiduals, done: np.ndarray, settings: ResidualSettings) -> ProductionResiduals:
    """One look a joint in `done`, and its next span."""
    tells = done & (now.samples >= settings.min_samples) & (now.work > 0)
    look = np.divide(now.excess, now.work, out=np.zeros_like(now.work), where=tells)
    looks = now.looks + tells
    baseline = tells & (looks <= settings.baseline_looks)
    usual = np.where(baseline, now.usual + (look - now.usual) / np.maximum(looks, 1.0), now.usual)
    after = tells & ~baseline
    later = now.later + after
    beyond = look - usual
    change = np.where(after, np.nan_to_num(now.change) + (beyond - np.nan_to_num(now.change)) / np.maximum(later, 1.0), now.change)
    agreeing = np.where(after, np.where(beyond >= settings.rise, now.agreeing + 1.0, 0.0), now.agreeing)
    return now._replace(
        samples=np.where(done, 0.0, now.samples),
        moving_s=np.where(done, 0.0, now.moving_s),
        work=np.where(done, 0.0, now.work),
        excess=np.where(done, 0.0, now.excess),
        looks=looks,
        usual=usual,
        change=change,
        later=later,
        agreeing=agreeing,
    )
