"""One period of an arm's production, belief → belief and health → health.

The filter step is that of the replays. Production alone raises an advisory at most: a graver tier asks for a replay, which is the arbiter.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.identify.production.estimate import ProductionEstimate, estimate
from monitor.identify.production.information import ProductionInformation
from monitor.identify.settings import ProductionSettings
from monitor.judge.alerts.health import Health, Transition
from monitor.judge.alerts.rules import judge_production
from monitor.judge.belief import Belief
from monitor.judge.drift.contexts import differences
from monitor.judge.drift.step import Replay, step
from monitor.judge.friction.figures import suspected_rise
from monitor.judge.production_observation import ProductionHistory, ProductionObservation, context_of_production
from monitor.judge.settings import AssessSettings
from monitor.recording import DAY_S, Array, Context


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionAssessment:
    """What one period of production leads to."""

    belief: Belief
    health: Health
    transitions: tuple[Transition, ...]
    learnt: np.ndarray  # (J,) joints that the filter learned from
    asks: tuple[int, ...]  # joints (from 1) of which a replay shall confirm what production alone has found
    suspects: tuple[int, ...]  # joints (from 1) of which production makes wear likely: replays shall tell


def assess_production(
    observation: ProductionObservation,
    context: Context,
    *,
    belief: Belief,
    health: Health,
    settings: AssessSettings,
) -> ProductionAssessment:
    """The verdict of one period of production, with belief and health for what comes next. context : as it is declared for that time.

    Before an arm's first replay there is no belief, and production teaches nothing. Raises BadInput where observation and belief are of
    different arms, or the period ended before the one before it.
    """
    if observation.joints != belief.joints:
        raise BadInput(f"the observation from production has {observation.joints} joints, the belief {belief.joints}; they must agree")
    before = belief.production
    if before is not None and observation.end_unix_s <= before.at_unix_s:
        raise BadInput(f"this period of production ended {before.at_unix_s - observation.end_unix_s:.0f} s before the one learnt last")
    here = context_of_production(context)
    opened = before is None or before.arm != observation.arm or bool(differences(before.context, here))
    at = max(observation.end_unix_s, belief.at_unix_s)  # a replay may have come before the period was judged
    replay = Replay(
        observation=observation.seen(settings.drift),
        days=np.array([(at - belief.at_unix_s) / DAY_S]),
        opened=np.array([opened]),
        awaiting_proof=belief.awaiting_proof,
        from_production=True,
    )
    result = step(belief.drift_state, replay, settings)
    resolved = np.isfinite(result.observation.log_torque)
    learnt: np.ndarray = resolved & result.state.learnt_from
    times = np.full(belief.joints, np.nan) if before is None else before.learnt_at_unix_s
    known = ProductionHistory(
        context=here,
        observations=1 + (0 if before is None else before.observations),
        at_unix_s=observation.end_unix_s,
        learnt_at_unix_s=np.where(learnt, observation.end_unix_s, times),
        share=observation.share,
        arm=observation.arm,
    )
    after = replace(belief.with_drift_state(result.state), at_unix_s=at, production=known)
    judged = judge_production(health, after, learnt, settings)
    asks = tuple(sorted({*judged.asks, *_still_asking(before, resolved)}))
    likely = np.flatnonzero(suspected_rise(result.state.friction, settings.friction) & learnt) + 1
    suspects = tuple(int(joint) for joint in likely if joint not in asks)
    after = replace(after, production=replace(known, asks=asks, suspects=suspects))
    return ProductionAssessment(
        belief=after, health=judged.health, transitions=judged.transitions, learnt=learnt, asks=asks, suspects=suspects
    )


def _still_asking(before: ProductionHistory | None, resolved: np.ndarray) -> tuple[int, ...]:
    """Joints that asked for a replay before, and of which this period says nothing."""
    return () if before is None else tuple(joint for joint in before.asks if not resolved[joint - 1])


# --- Information from production → the observation of one UTC day: each joint is told of by the days since it was told of last ---


def observation_of(
    information: ProductionInformation,
    identification: Identification,
    settings: ProductionSettings,
    *,
    learnt_at_unix_s: Array | None,
    last_day: int,
    arm: str,
) -> ProductionObservation | None:
    """What production until the end of a UTC day (counted from 1970-01-01) tells; None where nothing was listened to in these days.

    learnt_at_unix_s : (J,) end of the production by which each joint was observed last, NaN: never. No production counts twice:
    observations of a joint are of days that do not overlap. identification : of the replay whose rigid parameters production is freed
    from; `arm` names it. Raises BadInput where the information is of another arm.
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
        reasons=tuple(None if found.known[j] else next(told, None) for j in range(joints)),
        left_out_s=dict(found.left_out_s),
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
