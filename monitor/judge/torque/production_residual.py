"""Production residuals: what normal work between replays says of friction. This evidence may ask for a replay; it raises no alert.

If the friction of a moving joint changes by ΔF, measured minus predicted torque changes by ΔF in the direction that opposes the motion.
Over a span of motion, the ratio of this residual to the predicted friction is one observation of the change of friction since the model's
last replay. Production excites friction poorly: unknown loads, contact and slow motion make an observation uncertain, with a bias that is
similar from day to day. The first observations after a replay are therefore the baseline of this work, every observation has a large
standard deviation, and only a clear rise above the baseline in several observations in a row asks for a replay.
"""

import math
from typing import NamedTuple

import numpy as np

from monitor.judge.settings import ResidualSettings
from monitor.judge.torque.predictor import TorquePrediction
from monitor.reason import joint_text
from monitor.recording import Array

MAX_STEP_S = 1.0  # a longer pause between samples counts as so long
SHARED_SHARE = 0.5  # of an observation's variance that further observations do not reduce: the bias of similar work stays


class ProductionSample(NamedTuple):
    """One sample of the arm at work, (J,) each."""

    measured_nm: Array
    qd: Array  # [rad/s]
    qdd: Array  # [rad/s²]
    dt_s: float  # since the sample before


class ProductionResiduals(NamedTuple):
    """Sums of the present span and means of the observations since the last replay, (J,) each."""

    revision: int  # of the model that the residuals are of
    samples: Array  # of the present span
    moving_s: Array  # length of the present span
    friction2_s: Array  # Σ predicted friction²·dt over the present span [N²·m²·s]
    excess2_s: Array  # Σ residual·predicted friction·dt over the present span [N²·m²·s]
    observations: Array  # number of observations
    baseline: Array  # mean of the first observations, as a fraction of friction
    change: Array  # mean of the later observations less the baseline, as a fraction of friction; NaN before the first of them
    later_observations: Array  # number of observations after those of the baseline
    agreeing: Array  # number of consecutive observations above the rise, up to the last one


class ProductionEvidence(NamedTuple):
    """What work says of one joint's friction, compared with the baseline. The names are published."""

    joint: int  # from 1
    change: float  # as a fraction of friction
    std: float
    observations: int  # that `change` is the mean of
    probability: float  # that friction has risen at all


def initial(joints: int, revision: int) -> ProductionResiduals:
    """Residuals before the first sample, for a model of that revision."""
    zero = np.zeros(joints)
    return ProductionResiduals(revision, zero, zero, zero, zero, zero, zero, np.full(joints, np.nan), zero, zero)


def update(
    before: ProductionResiduals | None, revision: int, predicted: TorquePrediction, sample: ProductionSample, settings: ResidualSettings
) -> ProductionResiduals:
    """The residuals with one more sample. A model of another revision begins anew.

    predicted : one prediction, for the sample. Samples outside the learned temperatures, too slow or with too large an acceleration do not
    count.
    """
    J = len(sample.qd)
    if before is None or before.revision != revision or len(before.samples) != J:
        before = initial(J, revision)
    friction, qd = predicted.friction[0], sample.qd
    use = (np.abs(qd) >= settings.min_speed_rad_s) & (np.abs(sample.qdd) <= settings.max_acceleration_rad_s2) & ~predicted.extrapolated[0]
    use &= np.isfinite(sample.measured_nm) & np.isfinite(friction) & (friction * qd > 0)
    dt = float(np.clip(sample.dt_s, 0.0, MAX_STEP_S)) * use
    residual = np.where(use, sample.measured_nm - predicted.torque[0], 0.0)
    friction = np.where(use, friction, 0.0)
    now = before._replace(
        samples=before.samples + use,
        moving_s=before.moving_s + dt,
        friction2_s=before.friction2_s + friction**2 * dt,
        excess2_s=before.excess2_s + residual * friction * dt,
    )
    done = now.moving_s >= settings.span_s
    return _with_observations(now, done, settings) if done.any() else now


def production_evidence(residuals: ProductionResiduals | None, settings: ResidualSettings) -> tuple[ProductionEvidence, ...]:
    """The evidence of every joint that has an observation after its baseline."""
    if residuals is None:
        return ()
    found = []
    for j in np.flatnonzero(residuals.later_observations > 0):
        variance = SHARED_SHARE + (1.0 - SHARED_SHARE) / residuals.later_observations[j] + 1.0 / settings.baseline_observations
        std = settings.deviation * math.sqrt(variance)
        change = float(residuals.change[j])
        risen = 0.5 * math.erfc(-change / std / math.sqrt(2.0))
        found.append(ProductionEvidence(int(j) + 1, change, std, int(residuals.later_observations[j]), risen))
    return tuple(found)


def earlier_replay_reason(residuals: ProductionResiduals | None, settings: ResidualSettings) -> str | None:
    """Why the next replay should come sooner, as a sentence; None where production gives no reason.

    Whether a joint has worn, the replay decides.
    """
    if residuals is None:
        return None
    for each in production_evidence(residuals, settings):
        j = each.joint - 1
        if each.change >= settings.rise and each.probability >= settings.sure and residuals.agreeing[j] >= settings.min_observations:
            return (
                f"{joint_text(each.joint)}: at work, friction is {each.change:+z.0%} ± {each.std:.0%} from what is usual, "
                f"in {residuals.agreeing[j]:.0f} spans of motion in a row: a replay shall tell"
            )
    return None


def _with_observations(now: ProductionResiduals, done: np.ndarray, settings: ResidualSettings) -> ProductionResiduals:
    """The residuals with one more observation of each joint in `done` (J,), whose next span begins."""
    counts = done & (now.samples >= settings.min_samples) & (now.friction2_s > 0)
    observation = np.divide(now.excess2_s, now.friction2_s, out=np.zeros_like(now.friction2_s), where=counts)
    observations = now.observations + counts
    of_baseline = counts & (observations <= settings.baseline_observations)
    baseline = np.where(of_baseline, now.baseline + (observation - now.baseline) / np.maximum(observations, 1.0), now.baseline)
    later = counts & ~of_baseline
    later_observations = now.later_observations + later
    rise, mean = observation - baseline, np.nan_to_num(now.change)
    return now._replace(
        samples=np.where(done, 0.0, now.samples),
        moving_s=np.where(done, 0.0, now.moving_s),
        friction2_s=np.where(done, 0.0, now.friction2_s),
        excess2_s=np.where(done, 0.0, now.excess2_s),
        observations=observations,
        baseline=baseline,
        change=np.where(later, mean + (rise - mean) / np.maximum(later_observations, 1.0), now.change),
        later_observations=later_observations,
        agreeing=np.where(later, np.where(rise >= settings.rise, now.agreeing + 1.0, 0.0), now.agreeing),
    )
