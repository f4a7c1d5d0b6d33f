"""The life of an alert (ISA-18.2): raised, updated, latched until somebody acknowledges it, and cleared once its condition is gone.

Maintenance of a joint changes it too: its alerts wait for the replays that show what it did.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from monitor.errors import BadInput
from monitor.judge.alerts.condition import AlertCondition, ConditionStatus, ServiceSituation
from monitor.judge.alerts.conditions import FALLING, RISES, STOPPED
from monitor.judge.alerts.health import SEVERITY, TIERS, Acknowledgement, Alert, Gravest, Health, JointHealth, Transition
from monitor.judge.alerts.states import arm_of, joint_of
from monitor.judge.drift.maintenance import NEW_JOINT, NEW_REFERENCE, STILL_WORN, Maintenance
from monitor.judge.settings import HealthSettings
from monitor.reason import Reason, Sentence, together
from monitor.recording import DAY_S

ACKNOWLEDGED_AND_OVER = Sentence("acknowledged_and_over", "its condition is gone, and it was acknowledged")()
OVER = Sentence("over", "This is over since {since_unix_s:time}; it clears once somebody acknowledges it.")
MAINTAINED = Sentence(
    "maintained_since", "Maintenance since it was raised, which has not ended it: {kind:word} on {at_unix_s:day} by {by}."
)


def next_transition(
    alert: Alert | None, joint: int | None, condition: AlertCondition, status: ConditionStatus, at_unix_s: float, settings: HealthSettings
) -> Transition | None:
    """What becomes of an alert after a replay; None where it stays as it is.

    alert : the last alert of that joint (None: of the arm) and condition, None where there was none.
    """
    tier = status.raise_tier
    if alert is None or not alert.active:
        if tier is None:
            return None
        published = _published(condition, tier, status, at_unix_s)
        raised = Alert(joint=joint, condition=condition.name, raised_at_unix_s=at_unix_s, **published)
        return Transition("raised", replace(raised, gravest=raised.gravest_so_far))

    now = TIERS.index(alert.tier)
    acknowledged = alert.acknowledged_at_unix_s is not None
    if acknowledged and tier is None and status.hold_tier is None:
        return Transition("cleared", clear(alert, status, at_unix_s, ACKNOWLEDGED_AND_OVER))
    highest = max((k for k in (tier, status.hold_tier) if k is not None), default=now)
    if tier is not None and tier > now:
        highest = tier
    else:
        highest = min(highest, now) if acknowledged else now  # latched: the tier falls only after somebody has acknowledged it
    if highest == now and abs(status.change - alert.change) < settings.update_step and not status.restated:
        return None
    published = _published(condition, highest, status, at_unix_s)
    published["text"] = together(published["text"], _maintenance_so_far(alert))
    updated = with_gravest(replace(alert, **published), alert.gravest_so_far)
    if highest > now:  # somebody shall acknowledge the graver alert again
        updated = replace(updated, acknowledged_at_unix_s=None, acknowledged_by=None, acknowledged_why=None, shelved_until_unix_s=None)
    return Transition("updated", updated)


def clear(alert: Alert, status: ConditionStatus, at_unix_s: float, why: Reason) -> Alert:
    """The alert, cleared by a replay: it says what that replay found, and its gravest moment stays."""
    return replace(
        alert,
        cleared_at_unix_s=at_unix_s,
        updated_at_unix_s=at_unix_s,
        cleared_why=why,
        change=status.change,
        text=status.text(),
        attribution=status.attribution,
        lowest_at_unix_s=status.lowest_at_unix_s,
        from_production=False,
        gravest=alert.gravest_so_far,
        awaiting_proof=False,
    )


def with_gravest(alert: Alert, before: Gravest) -> Alert:
    """The alert with the graver of what it says now and its gravest moment before."""
    now = replace(alert, gravest=None).gravest_so_far
    graver = (TIERS.index(now.tier), abs(now.change)) > (TIERS.index(before.tier), abs(before.change))
    return replace(alert, gravest=now if graver else before)


def place_of(joint: int | None) -> str:
    """The first part of an alert's name, as the commands take it: j1, j2, … or arm."""
    return "arm" if joint is None else f"j{joint}"


def acknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The health with one active alert acknowledged. The alert clears by itself once its condition is gone.

    A second person's acknowledgement is appended: the first one stays the one that counts.
    Raises BadInput where there is no such active alert, or `by` is blank.
    """
    alert = _active(health, joint, condition, by)
    everyone = (*alert.acknowledgements, Acknowledgement(at_unix_s, by, why))
    if alert.acknowledged_at_unix_s is not None:
        return _with(health, alert, replace(alert, acknowledgements=everyone))
    first: dict[str, Any] = {"acknowledged_at_unix_s": at_unix_s, "acknowledged_by": by, "acknowledged_why": why}
    return _with(health, alert, replace(alert, acknowledgements=everyone, **first))


def unacknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The health with the acknowledgements of one active alert taken back: it waits for a person again, and does not clear by itself.

    Who acknowledged it, who took that back, when and why stay with the alert.
    Raises BadInput where there is no such active alert, it is not acknowledged, or `by` is blank.
    """
    alert = _active(health, joint, condition, by)
    if alert.acknowledged_at_unix_s is None:
        raise BadInput(f"{place_of(joint)}/{condition} is not acknowledged: there is nothing to take back")
    undone: dict[str, Any] = {"undone_at_unix_s": at_unix_s, "undone_by": by, "undone_why": why}
    everyone = tuple(one if one.undone_at_unix_s is not None else one._replace(**undone) for one in alert.acknowledgements)
    nobody: dict[str, Any] = {"acknowledged_at_unix_s": None, "acknowledged_by": None, "acknowledged_why": None}
    return _with(health, alert, replace(alert, acknowledgements=everyone, **nobody))


def shelve(health: Health, joint: int | None, condition: str, *, by: str, why: str, until_unix_s: float, at_unix_s: float) -> Health:
    """The health with one active alert shelved: the alert stays active, and programs need not show it until then.

    Raises BadInput where there is no such active alert, `by` is blank, or the end lies in the past.
    """
    alert = _active(health, joint, condition, by)
    if not until_unix_s > at_unix_s:
        raise BadInput("shelve: the end lies in the past; expected a time to come")
    return _with(health, alert, replace(alert, shelved_until_unix_s=until_unix_s, shelved_by=by, shelved_why=why))


def unshelve(health: Health, joint: int | None, condition: str, *, by: str, at_unix_s: float) -> Health:
    """The health with one shelved alert shown again. Raises BadInput where there is no such active alert, or it is not shelved."""
    alert = _active(health, joint, condition, by)
    if alert.shelved_until_unix_s is None or alert.shelved_until_unix_s <= at_unix_s:
        raise BadInput(f"{place_of(joint)}/{condition} is not shelved: there is nothing to take back")
    return _with(health, alert, replace(alert, shelved_until_unix_s=None, shelved_by=None, shelved_why=None))


def service_alert(condition: AlertCondition, text: Reason, at_unix_s: float) -> Alert:
    """An alert of the arm that the service raises about itself."""
    return Alert(
        joint=None, condition=condition.name, tier="advisory", raised_at_unix_s=at_unix_s, updated_at_unix_s=at_unix_s, change=0.0,
        probability=1.0, text=text, action=condition.action("advisory"),
    )  # fmt: skip


def service_transition(alert: Alert | None, condition: AlertCondition, situation: ServiceSituation) -> Transition | None:
    """What becomes of an alert of the service's own; None where it stays as it is.

    It is latched as the others are: over, it says so and stays until somebody acknowledges it. To allow motion again acknowledges
    `stopped`.
    alert : the last alert of the condition, None where there was none.
    """
    at = situation.now_unix_s
    text = condition.service(situation) if condition.service is not None else None
    if alert is None or not alert.active:
        return None if text is None else Transition("raised", service_alert(condition, text, at))
    if text is not None:
        # its text may change with every window; the log of transitions shall not: it is updated when it has lasted twice as long
        lasted_s, since_update_s = at - alert.raised_at_unix_s, at - alert.updated_at_unix_s
        over = alert.over_since_unix_s is not None
        if text == alert.text or not (over or (since_update_s >= DAY_S and 2.0 * since_update_s >= lasted_s)):
            return None
        return Transition("updated", replace(alert, text=text, updated_at_unix_s=at, over_since_unix_s=None))
    allowed, open_ = situation.allowed, alert.acknowledged_at_unix_s is None
    if condition.name == STOPPED and open_ and allowed is not None and allowed.at_unix_s >= alert.raised_at_unix_s:
        when, by, why = allowed
        alert = replace(alert, acknowledged_at_unix_s=when, acknowledged_by=by, acknowledged_why=why)
    if alert.acknowledged_at_unix_s is not None:
        return Transition("cleared", replace(alert, cleared_at_unix_s=at, updated_at_unix_s=at, cleared_why=ACKNOWLEDGED_AND_OVER))
    if alert.over_since_unix_s is not None:
        return None
    over_text = together(alert.text, OVER(since_unix_s=at))
    return Transition("updated", replace(alert, text=over_text, updated_at_unix_s=at, over_since_unix_s=at))


def _maintenance_so_far(alert: Alert) -> Reason | None:
    """Maintenance that did not end the alert; None where there was none."""
    if alert.serviced_kind is None or alert.serviced_at_unix_s is None:
        return None
    return MAINTAINED(kind=alert.serviced_kind, at_unix_s=alert.serviced_at_unix_s, by=alert.serviced_by)


def _published(condition: AlertCondition, tier: int, status: ConditionStatus, at_unix_s: float) -> dict[str, Any]:
    """What an alert of a tier says when it is raised or updated, by the names of its fields."""
    name = TIERS[tier]
    return {
        "tier": name,
        "updated_at_unix_s": at_unix_s,
        "change": status.change,
        "probability": float(status.probabilities[tier]),
        "text": status.text(),
        "action": condition.action(name),
        "severity": SEVERITY[name],
        "attribution": status.attribution,
        "lowest_at_unix_s": status.lowest_at_unix_s,
        "from_production": status.from_production,
    }


def _active(health: Health, joint: int | None, condition: str, by: str) -> Alert:
    """The one active alert of that joint and condition. Raises BadInput where there is none, or `by` is blank."""
    if not by.strip():
        raise BadInput("by: expected the name of the person who acts")
    for alert in health.alerts:
        if alert.active and alert.key == (joint, condition):
            return alert
    active = ", ".join(f"{place_of(alert.joint)}/{alert.condition}" for alert in health.alerts if alert.active) or "none"
    raise BadInput(f"no active alert {place_of(joint)}/{condition}; active: {active}")


def _with(health: Health, alert: Alert, changed: Alert) -> Health:
    return replace(health, alerts=tuple(changed if other is alert else other for other in health.alerts))


# --- What becomes of a joint's alerts when maintenance of it is declared ----------------------------------------

OF_FRICTION = (*RISES, FALLING)
NEXT_STEP = Sentence("await_proof", "Wait for the next replays, or ask for one: they show whether the maintenance helped.")()
NOT_HELPED = Sentence("not_helped", "Look at this joint again: friction is where it was before the maintenance.")()
BEFORE_IT = Sentence("before_maintenance", "Before it: {text}")
SERVICED = Sentence("serviced", "serviced: {act}")


class Serviced(NamedTuple):
    """Health after maintenance was declared between two replays, and the changes of alerts that led to it."""

    health: Health
    transitions: tuple[Transition, ...]


def declare(health: Health, maintenance: tuple[Maintenance, ...], at_unix_s: float) -> Serviced:
    """The health after maintenance was declared, without a replay.

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
    """What becomes of the joint's active alerts when maintenance of it is declared.

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
            waiting = replace(marked, awaiting_proof=True, text=together(act.reason, BEFORE_IT(text=alert.text)), action=NEXT_STEP)
            transitions.append(Transition("serviced", waiting))
    return transitions


def settle(alert: Alert, act: Maintenance, status: ConditionStatus, at_unix_s: float, advice: Reason) -> Transition | None:
    """What becomes of an active alert of friction when the replays have shown what the maintenance did; None where it says nothing of it.

    status : of the alert's condition after this replay. advice : what the alert asks for where the joint is still worn.
    """
    if act.outcome == NEW_REFERENCE or status.hold_tier is None:
        cleared = clear(alert, status, at_unix_s, SERVICED(act=act.act))
        return Transition("cleared", _cleared(cleared, act, at_unix_s))
    if not alert.awaiting_proof:
        return None
    action = together(NOT_HELPED, advice) if act.outcome == STILL_WORN else advice
    text = together(act.reason, status.text())
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
        lowest_at_unix_s=status.lowest_at_unix_s,
        from_production=False,
    )
    return Transition("updated", with_gravest(after, alert.gravest_so_far))


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
        cleared_why=SERVICED(act=act.act),
        text=act.reason,
        awaiting_proof=False,
    )


def _restated(joint: JointHealth, maintenance: tuple[Maintenance, ...], alerts: tuple[Alert, ...], at_unix_s: float) -> JointHealth:
    """The joint's health after work on it."""
    own = [act for act in maintenance if act.joint == joint.joint]
    if not own:
        return joint
    confirmations = () if own[-1].outcome == NEW_JOINT else joint.confirmations
    state, why = joint_of(joint.joint, own[-1].reason, alerts)
    return replace(
        joint, confirmations=confirmations, state=state, why=why, since_unix_s=joint.since_unix_s if state == joint.state else at_unix_s
    )
