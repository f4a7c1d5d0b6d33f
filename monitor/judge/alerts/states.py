"""NE 107 states of the joints and of the arm after a replay: the gravest of everything that holds, and why."""

import math
from collections.abc import Sequence
from dataclasses import replace

from monitor.judge.alerts.condition import ArmSituation, JointSituation
from monitor.judge.alerts.conditions import CONDITIONS, outside_learnt_range
from monitor.judge.alerts.health import Alert, Health, JointHealth
from monitor.judge.alerts.ne107 import CHECK_FUNCTION, NORMAL, OFF_SPEC, STATES, State
from monitor.judge.alerts.reasons.unseen_step import unseen_step_text
from monitor.judge.drift.filter_state import OUTLIER, UNRESOLVED
from monitor.judge.drift.undetected_change import UnseenStep
from monitor.reason import joint_text
from monitor.recording import Array

Reason = tuple[State, str]


def joint_state(
    situation: JointSituation, wear: Array, wear_std: Array, unseen: UnseenStep, alerts: tuple[Alert, ...], *, of_replay: bool = True
) -> JointHealth:
    """The joint's health with its state after a replay.

    wear, wear_std, unseen : (J,) logarithm of friction torque, as it is published; alerts : of the arm and all joints, after the replay.
    of_replay : whether it follows a replay, and not ordinary work.
    """
    joint, belief = situation.health, situation.belief
    j = situation.j
    act = belief.counted_since(joint.joint)
    since = "the beginning" if act is None else f"it {act.verb} on {act.day}"
    normal = f"friction {math.expm1(wear[j]):+z.1%} ± {wear_std[j]:.1%} since {since}"
    if math.isfinite(unseen.days[j]):
        normal += f"; {unseen_step_text(math.expm1(unseen.log_rise[j]), unseen.days[j])}"
    waiting = [one.text for one in belief.maintenance if one.waiting and one.joint == joint.joint]
    state, why = joint_of(joint.joint, waiting[-1] if waiting else normal, alerts, _of_replay(situation) if of_replay else ())
    return replace(joint, state=state, why=why, since_unix_s=joint.since_unix_s if state == joint.state else belief.at_unix_s)


def joint_of(joint: int, normal: str, alerts: tuple[Alert, ...], others: Sequence[Reason] = ()) -> tuple[State, str]:
    """State of a joint (from 1) and why, by its active alerts and `others`. normal : what is said where nothing speaks against it."""
    active = [alert for alert in alerts if alert.active and alert.joint == joint]
    return max([(NORMAL, normal), *others, *map(_of_alert, active)], key=_precedence)


def arm_state(situation: ArmSituation, joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...]) -> tuple[str, str]:
    """The gravest state of the joints and of the arm's own alerts, and why."""
    undeclared = situation.undeclared
    return arm_of(joints, alerts, () if undeclared.condition is None else ((CHECK_FUNCTION, undeclared.text),))


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


def arm_of(joints: tuple[JointHealth, ...], alerts: tuple[Alert, ...], others: Sequence[Reason] = ()) -> tuple[str, str]:
    """State of the arm and why, by its joints, its own active alerts and `others`, which come first of equally grave ones."""
    reasons = [*others, *((joint.state, f"{joint_text(joint.joint)}: {joint.why}") for joint in joints)]
    reasons += [(_state_of(alert), f"{alert.condition}: {alert.text}") for alert in alerts if alert.active and alert.joint is None]
    state, why = max(reasons, key=_precedence)
    if state != NORMAL:
        return state, why
    noticed = {alert.joint for alert in alerts if alert.active}
    notices = [f"{joint_text(joint.joint)}: {joint.why}" for joint in joints if joint.joint in noticed]
    return NORMAL, f"no action is needed; {notices[0]}" if notices else "all joints are as they were at the beginning"


def _of_replay(situation: JointSituation) -> list[Reason]:
    """What one replay says before any alert is raised."""
    belief, j, undeclared = situation.belief, situation.j, situation.arm.undeclared
    reasons: list[Reason] = []
    if undeclared.withheld:
        reasons.append((CHECK_FUNCTION, f"nothing is learnt of wear: {undeclared.text}"))
    elif belief.event[j] == UNRESOLVED:
        reasons.append((CHECK_FUNCTION, "the last replay does not resolve this joint's friction"))
    if belief.event[j] == OUTLIER:
        reasons.append((CHECK_FUNCTION, f"the last replay is {belief.filter_state.innovation[j]:+z.1%} off: waiting for the next"))
    if outside_learnt_range(situation):
        reasons.append((OFF_SPEC, f"{belief.temperature_c[j]:.1f} °C is outside the temperatures learnt so far"))
    return reasons


def _of_alert(alert: Alert) -> Reason:
    """State and reason of a joint with an active alert."""
    if alert.awaiting_proof:
        return CHECK_FUNCTION, alert.text
    condition = CONDITIONS.get(alert.condition)
    of_friction = condition is not None and condition.probability_of is not None
    change = f": {alert.change:+z.1%}" if of_friction else ""  # the change of other conditions is 0
    return _state_of(alert), f"{alert.condition} ({alert.tier}){change}"


def _state_of(alert: Alert) -> State:
    """An alert whose condition or tier this release does not know, for example one that a later release raised, is to be checked."""
    condition = CONDITIONS.get(alert.condition)
    return condition.tiers[alert.tier].state if condition is not None and alert.tier in condition.tiers else CHECK_FUNCTION


def _precedence(reason: tuple[str, str]) -> int:
    """The later in `STATES`, the graver; of equally grave reasons the first one is given."""
    return STATES.index(reason[0])
