"""The life of an alert (ISA-18.2): raised, updated, latched until somebody acknowledges it, and cleared once its condition is gone."""

from dataclasses import replace
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.condition import AlertCondition, ConditionStatus
from monitor.judge.alerts.health import SEVERITY, TIERS, Alert, Health, Transition
from monitor.judge.alerts.settings import HealthSettings


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
        return Transition("raised", Alert(joint=joint, condition=condition.name, raised_at_unix_s=at_unix_s, **published))

    now = TIERS.index(alert.tier)
    acknowledged = alert.acknowledged_at_unix_s is not None
    if acknowledged and tier is None and status.hold_tier is None:
        cleared = replace(alert, cleared_at_unix_s=at_unix_s, updated_at_unix_s=at_unix_s)
        return Transition("cleared", replace(cleared, change=status.change, text=status.text(), attribution=status.attribution))
    highest = max((k for k in (tier, status.hold_tier) if k is not None), default=now)
    if tier is not None and tier > now:
        highest = tier
    else:
        highest = min(highest, now) if acknowledged else now  # latched: the tier falls only after somebody has acknowledged it
    if highest == now and abs(status.change - alert.change) < settings.update_step:
        return None
    updated = replace(alert, **_published(condition, highest, status, at_unix_s))
    if highest > now:  # somebody shall acknowledge the graver alert again
        updated = replace(updated, acknowledged_at_unix_s=None, acknowledged_by=None, acknowledged_why=None, shelved_until_unix_s=None)
    return Transition("updated", updated)


def acknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The health with one active alert acknowledged. The alert clears by itself once its condition is gone.

    Raises BadInput where there is no such active alert, or `by` is blank.
    """
    alert = _active(health, joint, condition, by)
    return _with(health, alert, replace(alert, acknowledged_at_unix_s=at_unix_s, acknowledged_by=by, acknowledged_why=why))


def shelve(health: Health, joint: int | None, condition: str, *, by: str, why: str, until_unix_s: float, at_unix_s: float) -> Health:
    """The health with one active alert shelved: the alert stays active, and programs need not show it until then.

    Raises BadInput where there is no such active alert, `by` is blank, or the end lies in the past.
    """
    alert = _active(health, joint, condition, by)
    if not until_unix_s > at_unix_s:
        raise BadInput("shelve: the end lies in the past; expected a time to come")
    return _with(health, alert, replace(alert, shelved_until_unix_s=until_unix_s, shelved_by=by, shelved_why=why))


def service_alert(condition: AlertCondition, text: str, at_unix_s: float) -> Alert:
    """An alert of the arm that the service raises about itself."""
    return Alert(
        joint=None, condition=condition.name, tier="advisory", raised_at_unix_s=at_unix_s, updated_at_unix_s=at_unix_s, change=0.0,
        probability=1.0, text=text, action=condition.tiers["advisory"].advice,
    )  # fmt: skip


def _published(condition: AlertCondition, tier: int, status: ConditionStatus, at_unix_s: float) -> dict[str, Any]:
    """What an alert of a tier says when it is raised or updated, by the names of its fields."""
    name = TIERS[tier]
    return {
        "tier": name,
        "updated_at_unix_s": at_unix_s,
        "change": status.change,
        "probability": float(status.probabilities[tier]),
        "text": status.text(),
        "action": condition.tiers[name].advice,
        "severity": SEVERITY[name],
        "attribution": status.attribution,
    }


def _active(health: Health, joint: int | None, condition: str, by: str) -> Alert:
    """The one active alert of that joint and condition. Raises BadInput where there is none, or `by` is blank."""
    if not by.strip():
        raise BadInput("by: expected the name of the person who acts")
    for alert in health.alerts:
        if alert.active and alert.key == (joint, condition):
            return alert
    active = ", ".join(f"{alert.joint or 'arm'}/{alert.condition}" for alert in health.alerts if alert.active) or "none"
    raise BadInput(f"no active alert {joint or 'arm'}/{condition}; active: {active}")


def _with(health: Health, alert: Alert, changed: Alert) -> Health:
    return replace(health, alerts=tuple(changed if other is alert else other for other in health.alerts))
