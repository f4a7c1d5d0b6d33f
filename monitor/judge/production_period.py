"""Information from ordinary work → the observation of one UTC day: each joint is told of by the days since it was told of last."""

import math
from dataclasses import replace

import numpy as np

from monitor.identify.identification import Identification
from monitor.identify.production.estimate import ProductionEstimate, estimate
from monitor.identify.production.information import ProductionInformation
from monitor.identify.production.settings import ProductionSettings
from monitor.judge.production_observation import ProductionObservation
from monitor.recording import DAY_S, Array


def observation_of(
    information: ProductionInformation,
    identification: Identification,
    settings: ProductionSettings,
    *,
    learnt_at_unix_s: Array | None,
    last_day: int,
    arm: str,
) -> ProductionObservation | None:
    """What work until the end of a UTC day (counted from 1970-01-01) tells; None where nothing was listened to in these days.

    learnt_at_unix_s : (J,) end of the work by which each joint was observed last, NaN: never. No work counts twice: observations of a joint
    are of days that do not overlap. identification : of the replay whose rigid parameters work is freed from; `arm` names it.
    Raises BadInput where the information is of another arm.
    """
    J = len(identification.coulomb_nm)
    earliest = last_day + 1 - math.ceil(settings.period_days)
    learnt = np.full(J, np.nan) if learnt_at_unix_s is None else learnt_at_unix_s
    first = np.maximum(np.where(np.isfinite(learnt), np.floor(np.nan_to_num(learnt) / DAY_S) + 1.0, -np.inf), earliest)
    found: ProductionObservation | None = None
    past = information.of_days(earliest, last_day)
    for day in sorted({int(each) for each in first}):
        days = information.of_days(day, last_day)
        if not days.seen_s:
            continue
        one = _observation(estimate(days, identification, settings, (last_day + 1) * DAY_S, past=past), J, arm)
        which = first == day
        found = one if found is None else _with_joints(found, one, which)
    return found


def _observation(found: ProductionEstimate, joints: int, arm: str) -> ProductionObservation:
    told = iter(found.reasons)  # one for each joint that is not known
    return ProductionObservation(
        begin_unix_s=found.begin_unix_s,
        end_unix_s=found.end_unix_s,
        reference_speed_rad_s=found.reference_speed_rad_s,
        friction_nm=found.friction_nm,
        deviation_nm=found.deviation_nm,
        noise_nm=found.noise_nm,
        temperature_c=found.temperature_c,
        share=found.share,
        known=found.known.astype(float),
        arm=arm,
        reasons=tuple("" if found.known[j] else next(told, "") for j in range(joints)),
        left_out_s=tuple(found.left_out_s.items()),
        seen_s=found.seen_s,
    )


def _with_joints(found: ProductionObservation, other: ProductionObservation, which: np.ndarray) -> ProductionObservation:
    """The observation with the joints in `which` (J,) from another one, whose days began later."""
    names = ("friction_nm", "deviation_nm", "noise_nm", "temperature_c", "share", "known")
    return replace(
        found,
        **{name: np.where(which, getattr(other, name), getattr(found, name)) for name in names},
        end_unix_s=max(found.end_unix_s, other.end_unix_s),
        reasons=tuple(other.reasons[j] if which[j] else found.reasons[j] for j in range(found.joints)),
    )
