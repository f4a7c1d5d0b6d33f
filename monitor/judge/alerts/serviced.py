"""What becomes of a joint's alerts when work on it is declared, and when the replays after it have shown what the work did."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from monitor.judge.alerts.condition import ConditionStatus
from monitor.judge.alerts.conditions import FALLING, RISES
from monitor.judge.alerts.health import NO_CONFIRMATIONS, TIERS, Alert, Health, JointHealth, Transition
from monitor.judge.alerts.life_cycle import clear, with_gravest
from monitor.judge.alerts.states import arm_of, joint_of
from monitor.judge.drift.maintenance import NEW_JOINT, NEW_REFERENCE, STILL_WORN, Maintenance
from monitor.reason import joint_text

OF_FRICTION = (*RISES, FALLING)
NEXT_STEP = "Wait for the next replays, or ask for one: they show whether the work helped."
NOT_HELPED = "Look at this joint again: friction is where it was before the work."


class Serviced(NamedTuple):
    """Health after work was declared between two replays, and the changes of alerts that led to it."""

    health: Health
    transitions: tuple[Transition, ...]


def declare(health: Health, maintenance: tuple[Maintenance, ...], at_unix_s: float) -> Serviced:
    """The health after works were declared, without a replay.

    A replaced joint has no alert any more. The rise of a joint that is the same one waits for its proof, and its state is CHECK_FUNCTION
    until then; its fall is explained.
    """
    alerts, transitions = {alert.key: alert for alert in health.alerts}, []
    for act in maintenance:
        for transition in begin(alerts, act, at_unix_s):
            alerts[transition.alert.key] = transition.alert
            transitions.append(transition)
    joints = tuple(_restated(joint, maintenance, tuple(alerts.values()), at_unix_s) for joint in health.joints)
    state, why = arm_of(joints, tuple(alerts.values()))
    since = health.since_unix_s if state == health.state else at_unix_s
    after = replace(health, state=state, why=why, since_unix_s=since, joints=joints, alerts=tuple(alerts.values()))
    return Serviced(after, tuple(transitions))


def begin(alerts: Mapping[tuple[int | None, str], Alert], act: Maintenance, at_unix_s: float) -> list[Transition]:
    """What becomes of the joint's active alerts when work on it is declared.

    Of a declaration that names no joint, a fall is cleared all the same: it is what the condition asks a person for.
    """
    transitions = []
    for alert in alerts.values():
        if not alert.active or alert.joint != act.joint:
            continue
        marked = _marked(alert, act, at_unix_s)
        if act.outcome == NEW_JOINT or alert.condition == FALLING:
            transitions.append(Transition("cleared", _cleared(marked, act, at_unix_s)))
        elif alert.condition in RISES:
            waiting = replace(marked, awaiting_proof=True, text=f"{act.text} Before it: {alert.text}", action=NEXT_STEP)
            transitions.append(Transition("serviced", waiting))
    return transitions


def settle(alert: Alert, act: Maintenance, status: ConditionStatus, at_unix_s: float, advice: str) -> Transition | None:
    """What becomes of an active alert of friction when the replays have shown what the work did; None where the work says nothing of it.

    status : of the alert's condition after this replay. advice : what the alert asks for where the joint is still worn.
    """
    if act.outcome == NEW_REFERENCE or status.hold_tier is None:
        cleared = clear(alert, status, at_unix_s, "")
        return Transition("cleared", _cleared(cleared, act, at_unix_s))
    if not alert.awaiting_proof:
        return None
    action = f"{NOT_HELPED} {advice}" if act.outcome == STILL_WORN else advice
    text = f"{act.text} {status.text()}"
    tier = max(status.hold_tier, TIERS.index(alert.tier)) if alert.acknowledged_at_unix_s is None else status.hold_tier
    after = replace(
        alert,
        awaiting_proof=False,
        updated_at_unix_s=at_unix_s,
        tier=TIERS[tier],
        change=status.change,
        probability=float(status.probabilities[tier]),
        text=text,
        action=action,
        attribution=status.attribution,
    )
    return Transition("updated", with_gravest(after, alert.gravest_so_far))


def without_confirmations(joint: JointHealth, maintenance: tuple[Maintenance, ...]) -> JointHealth:
    """The joint's health without the replays that confirmed a change of friction before work on it."""
    if all(act.joint != joint.joint for act in maintenance):
        return joint
    return replace(joint, rising=(NO_CONFIRMATIONS,) * len(TIERS), falling=NO_CONFIRMATIONS)


def _marked(alert: Alert, act: Maintenance, at_unix_s: float) -> Alert:
    return replace(
        alert,
        updated_at_unix_s=at_unix_s,
        gravest=alert.gravest_so_far,
        serviced_at_unix_s=act.at_unix_s,
        serviced_kind=act.kind,
        serviced_by=act.by,
        serviced_why=act.why,
    )


def _cleared(alert: Alert, act: Maintenance, at_unix_s: float) -> Alert:
    return replace(
        alert,
        cleared_at_unix_s=at_unix_s,
        cleared_why=f"serviced: {joint_text(act.joint)} {act.verb} on {act.day} ({act.by})",
        text=act.text,
        awaiting_proof=False,
    )


def _restated(joint: JointHealth, maintenance: tuple[Maintenance, ...], alerts: tuple[Alert, ...], at_unix_s: float) -> JointHealth:
    """The joint's health after work on it."""
    own = [act for act in maintenance if act.joint == joint.joint]
    if not own:
        return joint
    fresh = without_confirmations(joint, maintenance)
    if own[-1].outcome == NEW_JOINT:
        fresh = replace(
            JointHealth(joint=joint.joint), learnt_at_unix_s=joint.learnt_at_unix_s, state=joint.state, since_unix_s=joint.since_unix_s
        )
    state, why = joint_of(joint.joint, own[-1].text, alerts)
    return replace(fresh, state=state, why=why, since_unix_s=joint.since_unix_s if state == joint.state else at_unix_s)
