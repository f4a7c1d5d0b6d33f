"""NE 107 states of joints and arm: the gravest of everything that holds, and why; what changed friction, what is stale or unseen."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.judge.alerts.condition import ArmSituation, JointSituation
from monitor.judge.alerts.conditions import CONDITIONS, outside_learnt_range
from monitor.judge.alerts.health import CHECK_FUNCTION, NORMAL, OFF_SPEC, STATES, Alert, Attribution, Health, JointHealth, State
from monitor.judge.belief import Belief
from monitor.judge.drift.maintenance import GREASED, MAINTENANCE, OVERHAULED, REPLACED, SERIALS
from monitor.judge.drift.step import OUTLIER, UNRESOLVED
from monitor.judge.friction.figures import UnseenStep, change_found, expected, expected_row
from monitor.judge.friction.states import LEVEL
from monitor.judge.friction.step import FrictionModel
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S, Array

KNOWN_VAR = 1.0  # [log²] a level that any replay has taught is far better known, one of no replay far worse


def attribute_changes(belief: Belief, model: FrictionModel) -> tuple[Attribution | None, ...]:
    """The causes of the change of every joint since its first replays; None before there is a change to attribute."""
    state = belief.friction
    whole = belief.last_log_torque - belief.first_log_torque  # (J,) as all below
    T0 = np.where(np.isfinite(belief.first_temperature_c), belief.first_temperature_c, belief.reference_temperature_c)
    T = np.where(np.isfinite(belief.temperature_c), belief.temperature_c, T0)
    slot = belief.contexts[-1].slot or 0
    now, first = np.full(belief.joints, slot), np.array([_first_slot(belief, j, slot) for j in range(belief.joints)])
    still = np.zeros(belief.joints)
    at_first, at_now, at_last = (
        expected(state, expected_row(state, t, still, model, slot))[0] for t, slot in ((T0, first), (T0, now), (T, now))
    )
    temperature, payload, wear = at_last - at_now, at_now - at_first, change_found(state)
    parts = np.stack([whole, temperature, payload, wear, whole - temperature - payload - wear], axis=1)  # (J, 5)
    return tuple(Attribution(*of_joint) if math.isfinite(of_joint[0]) else None for of_joint in parts.tolist())


def _first_slot(belief: Belief, j: int, slot: int) -> int:
    """The slot of the oldest baseline that is still kept and known of joint j; that in force where none is.

    A level that is not known, as after a replacement, is no reference: the difference to it would be the logarithm of a torque.
    """
    P, levels = belief.friction.P, belief.friction.x.shape[1] - LEVEL
    known = [
        context
        for context in belief.contexts
        if context.slot is not None and context.slot < levels and P[0, LEVEL + context.slot, LEVEL + context.slot, j] < KNOWN_VAR
    ]
    return (min(known, key=lambda context: context.opened_at_unix_s).slot or 0) if known else slot


# --- Which joints no replay has updated for a long time --------------------------------------------------


def stale_joints(health: Health, now_unix_s: float, settings: HealthSettings) -> tuple[bool, ...]:
    """(J,) whether the last replay that updated a joint is older than `stale_days`, or there is none."""
    limit = now_unix_s - settings.stale_days * DAY_S
    return tuple(joint.learnt_at_unix_s is None or joint.learnt_at_unix_s < limit for joint in health.joints)


STALE = Sentence("stale_joints", "STALE: {who:name}: nothing was learnt {since}: the state is of then, not of {then}")
ALL_STALE = Sentence("all_joints_stale", "STALE: all joints: nothing was learnt {since}: the state is of then, not of {then}")
FOR_DAYS = Sentence("for_days", "for {days:.0f} days (health.stale_days = {limit:g})")
NOT_YET = Sentence("not_yet", "yet (health.stale_days = {limit:g})")
SINCE, IN_PERIOD = Sentence("since", "since {at_unix_s:time}"), Sentence("in_period", "in this period")()
NOW, PERIODS_END = Sentence("now", "now")(), Sentence("periods_end", "the period's end")()


def stale_reason(stale: Sequence[int], joints: int, since: Reason, then: Reason = NOW) -> Reason:
    """What bus, page and report publish of stale joints.

    stale : numbers of the stale joints, from 1; joints : J; since : for how long; then : the time that the state does not stand for.
    """
    return ALL_STALE(since=since, then=then) if len(stale) == joints else STALE(who=stale, since=since, then=then)


# --- Which steps of friction may be unseen yet -----------------------------------------------------------

UNSEEN_STEP = Sentence("unseen_step", "a step of the last {days:.0f} days up to {rise:.0%} may be unseen")
UNSEEN_STEPS = Sentence(
    "unseen_steps", "The ± of wear does not hold for a fresh step: one of the last {days:.0f} days may be unseen up to {each}."
)
RISE_OF_JOINT = Sentence("rise_of_joint", "{joint:name} {rise:.0%}")


def unseen_steps(friction: Sequence[Mapping[str, Any]]) -> Reason | None:
    """Of all joints, from their friction documents; None where nothing is known."""
    known = [row for row in friction if row.get("unseen_step") is not None]
    if not known:
        return None
    each = [RISE_OF_JOINT(joint=row["joint"], rise=row["unseen_step"]) for row in known]
    return UNSEEN_STEPS(days=max(row["unseen_step_days"] for row in known), each=each)


# --- NE 107 states of the joints and of the arm after a replay -------------------------------------------

StateAndWhy = tuple[State, Reason]
SINCE_BEGINNING = Sentence("friction_since_beginning", "friction {change:+z.1%} ± {std:.1%} since the beginning")
SINCE_MAINTENANCE = {  # by the kind of the maintenance from which friction counts
    REPLACED: Sentence("friction_since_replaced", "friction {change:+z.1%} ± {std:.1%} since it was replaced on {at_unix_s:day}"),
    OVERHAULED: Sentence("friction_since_overhauled", "friction {change:+z.1%} ± {std:.1%} since it was overhauled on {at_unix_s:day}"),
    GREASED: Sentence("friction_since_greased", "friction {change:+z.1%} ± {std:.1%} since it was greased on {at_unix_s:day}"),
    MAINTENANCE: Sentence("friction_since_maintained", "friction {change:+z.1%} ± {std:.1%} since its maintenance on {at_unix_s:day}"),
    SERIALS: Sentence("friction_since_serial", "friction {change:+z.1%} ± {std:.1%} since it may have been replaced on {at_unix_s:day}"),
}
UNSEEN_BESIDE = Sentence("with_unseen_step", "{friction}; {unseen}")
OF_JOINT = Sentence("of_joint", "{joint:joint}: {why}")
OF_ALERT = Sentence("of_alert", "{condition:word}: {text}")
ALERT_ACTIVE = Sentence("alert_active", "{condition:word} ({tier:word})")
ALERT_ACTIVE_BY = Sentence("alert_active_by", "{condition:word} ({tier:word}): {change:+z.1%}")
NO_ACTION = Sentence("no_action", "no action is needed; {notice}")
AS_AT_BEGINNING = Sentence("as_at_beginning", "all joints are as they were at the beginning")()
NOTHING_IS_LEARNT = Sentence("nothing_is_learnt", "nothing is learnt of wear: {why}")
UNRESOLVED_JOINT = Sentence("unresolved", "the last replay does not resolve this joint's friction")()
OFF = Sentence("off", "the last replay is {change:+z.1%} off: waiting for the next")
OUTSIDE_RANGE = Sentence("outside_temperatures", "{temperature_c:.1f} °C is outside the temperatures learnt so far")


def joint_state(
    situation: JointSituation, wear: Array, wear_std: Array, unseen: UnseenStep, alerts: tuple[Alert, ...], *, of_replay: bool = True
) -> JointHealth:
    """The joint's health with its state after a replay.

    wear, wear_std, unseen : (J,) logarithm of friction torque, as it is published; alerts : of the arm and all joints, after the replay.
    of_replay : whether it follows a replay, and not production.
    """
    joint, belief = situation.health, situation.belief
    j = situation.j
    act = belief.counted_since(joint.joint)
    figures = {"change": math.expm1(wear[j]), "std": wear_std[j]}
    normal = SINCE_BEGINNING(**figures) if act is None else SINCE_MAINTENANCE[act.kind](**figures, at_unix_s=act.at_unix_s)
    if math.isfinite(unseen.days[j]):
        step = UNSEEN_STEP(rise=math.expm1(unseen.log_rise[j]), days=unseen.days[j])
        normal = UNSEEN_BESIDE(friction=normal, unseen=step)
    waiting = [one.reason for one in belief.maintenance if one.waiting and one.joint == joint.joint]
    state, why = joint_of(joint.joint, waiting[-1] if waiting else normal, alerts, _of_replay(situation) if of_replay else ())
    return replace(joint, state=state, why=why, since_unix_s=joint.since_unix_s if state == joint.state else belief.at_unix_s)


def joint_of(joint: int, normal: Reason, alerts: tuple[Alert, ...], others: Sequence[StateAndWhy] = ()) -> StateAndWhy:
    """State of a joint (from 1) and why, by its active alerts and `others`. normal : what is said where nothing speaks against it."""
    active = [alert for alert in alerts if alert.active and alert.joint == joint]
    return max([(NORMAL, normal), *others, *map(_of_alert, active)], key=_precedence)


def arm_state(situation: ArmSituation, joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...]) -> tuple[str, Reason]:
    """The gravest state of the joints and of the arm's own alerts, and why."""
    undeclared = situation.undeclared
    return arm_of(joints, alerts, () if undeclared.condition is None else ((CHECK_FUNCTION, undeclared.reason),))


def with_service_alert(health: Health, alert: Alert, at_unix_s: float) -> Health:
    """The health with a changed alert of the service's own, and with the arm's state as that alert makes it.

    The state is the gravest truth: a monitor that learns nothing does not go on saying NORMAL. A health without joints, before the first
    assessment, has no state; and an alert without a predicate of its own changes the state with the next replay.
    """
    condition = CONDITIONS.get(alert.condition)
    alerts = tuple(({other.key: other for other in health.alerts} | {alert.key: alert}).values())
    if not health.joints or condition is None or condition.service is None:
        return replace(health, alerts=alerts)
    state, why = arm_of(health.joints, alerts)
    since = health.since_unix_s if state == health.state else at_unix_s
    return replace(health, alerts=alerts, state=state, why=why, since_unix_s=since)


def arm_of(joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...], others: Sequence[StateAndWhy] = ()) -> tuple[str, Reason]:
    """State of the arm and why, by its joints, its own active alerts and `others`, which come first of equally grave ones."""
    reasons: list[tuple[str, Reason]] = [*others, *((joint.state, OF_JOINT(joint=joint.joint, why=joint.why)) for joint in joints)]
    reasons += [
        (_state_of(alert), OF_ALERT(condition=alert.condition, text=alert.text)) for alert in alerts if alert.active and alert.joint is None
    ]
    state, why = max(reasons, key=_precedence)
    if state != NORMAL:
        return state, why
    noticed = {alert.joint for alert in alerts if alert.active}
    notices = [OF_JOINT(joint=joint.joint, why=joint.why) for joint in joints if joint.joint in noticed]
    return NORMAL, NO_ACTION(notice=notices[0]) if notices else AS_AT_BEGINNING


def _of_replay(situation: JointSituation) -> list[StateAndWhy]:
    """What one replay says before any alert is raised."""
    belief, j, undeclared = situation.belief, situation.j, situation.arm.undeclared
    reasons: list[StateAndWhy] = []
    if undeclared.withheld:
        reasons.append((CHECK_FUNCTION, NOTHING_IS_LEARNT(why=undeclared.reason)))
    elif belief.event[j] == UNRESOLVED:
        reasons.append((CHECK_FUNCTION, UNRESOLVED_JOINT))
    if belief.event[j] == OUTLIER:
        reasons.append((CHECK_FUNCTION, OFF(change=belief.friction.of_joints(belief.friction.innovation)[j])))
    if outside_learnt_range(situation):
        reasons.append((OFF_SPEC, OUTSIDE_RANGE(temperature_c=belief.temperature_c[j])))
    return reasons


def _of_alert(alert: Alert) -> StateAndWhy:
    """State and reason of a joint with an active alert."""
    if alert.awaiting_proof:
        return CHECK_FUNCTION, alert.text
    condition = CONDITIONS.get(alert.condition)
    of_friction = condition is not None and condition.probability_of is not None
    if of_friction:
        return _state_of(alert), ALERT_ACTIVE_BY(condition=alert.condition, tier=alert.tier, change=alert.change)
    return _state_of(alert), ALERT_ACTIVE(condition=alert.condition, tier=alert.tier)  # there is no change of friction to say


def _state_of(alert: Alert) -> State:
    """An alert whose condition or tier this release does not know, for example one that a later release raised, is to be checked."""
    condition = CONDITIONS.get(alert.condition)
    return condition.tiers[alert.tier].state if condition is not None and alert.tier in condition.tiers else CHECK_FUNCTION


def _precedence(reason: tuple[str, Reason]) -> int:
    """The later in `STATES`, the graver; of equally grave reasons the first one is given."""
    return STATES.index(reason[0])
