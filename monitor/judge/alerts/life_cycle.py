"""The life of an alert: raised, told again, latched until somebody has seen it, cleared once its condition is gone (ISA-18.2)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from monitor.errors import BadInput
from monitor.judge.alerts.health import ACTIONS, SEVERITY, TIERS, Alert, Attribution, Health, Transition
from monitor.judge.alerts.settings import HealthSettings
from monitor.recording import Array


class ConditionStatus(NamedTuple):
    """What one condition looks like now: `raise_tier` if it may be raised, `hold_tier` if it may be kept; None if not."""

    raise_tier: int | None
    hold_tier: int | None
    change: float
    probabilities: Array  # (3,) of the tiers
    text: Callable[[], str]  # told only when something is to be told
    split: Attribution | None = None


def next_step(
    alert: Alert | None, key: tuple[int | None, str], status: ConditionStatus, at: float, settings: HealthSettings
) -> Transition | None:
    """One alert's next step in life, or None where it stays as it is."""
    joint, condition = key
    tier = status.raise_tier
    if alert is None or not alert.active:
        if tier is None:
            return None
        raised = Alert(joint=joint, condition=condition, raised_at_unix_s=at, **_told(condition, tier, status, at))
        return Transition("raised", raised)

    now = TIERS.index(alert.tier)
    acknowledged = alert.acknowledged_at_unix_s is not None
    if acknowledged and tier is None and status.hold_tier is None:
        cleared = replace(
            alert, cleared_at_unix_s=at, updated_at_unix_s=at, change=status.change, text=status.text(), split=status.split
        )  # fmt: skip
        return Transition("cleared", cleared)
    highest = max((k for k in (tier, status.hold_tier) if k is not None), default=now)
    if tier is not None and tier > now:
        highest = tier
    else:
        highest = min(highest, now) if acknowledged else now  # latched: it steps down only once somebody has seen it
    if highest == now and abs(status.change - alert.change) < settings.update_step:
        return None
    told = replace(alert, **_told(condition, highest, status, at))
    if highest > now:  # a graver alert is to be seen again
        told = replace(told, acknowledged_at_unix_s=None, acknowledged_by=None, acknowledged_why=None, shelved_until_unix_s=None)
    return Transition("updated", told)


def acknowledge(health: Health, joint: int | None, condition: str, *, by: str, why: str, at_unix_s: float) -> Health:
    """The same health with one active alert acknowledged; it clears by itself once its condition is gone.

    Raises BadInput where there is no such active alert, or nobody says who acknowledges.
    """
    alert = _active(health, joint, condition, by)
    done = replace(alert, acknowledged_at_unix_s=at_unix_s, acknowledged_by=by, acknowledged_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def shelve(health: Health, joint: int | None, condition: str, *, by: str, why: str, until_unix_s: float, at_unix_s: float) -> Health:
    """The same health with one active alert shelved: it stays active, and need not be shown until then.

    Raises BadInput where there is no such active alert, nobody says who shelves, or the end lies in the past.
    """
    alert = _active(health, joint, condition, by)
    if not until_unix_s > at_unix_s:
        raise BadInput("shelve: the end lies in the past; expected a time to come")
    done = replace(alert, shelved_until_unix_s=until_unix_s, shelved_by=by, shelved_why=why)
    return replace(health, alerts=tuple(done if other is alert else other for other in health.alerts))


def _told(condition: str, tier: int, status: ConditionStatus, at: float) -> dict[str, Any]:
    """What an alert says at a tier, raised or told again."""
    return {
        "tier": TIERS[tier],
        "updated_at_unix_s": at,
        "change": status.change,
        "probability": float(status.probabilities[tier]),
        "text": status.text(),
        "action": ACTIONS[condition, TIERS[tier]],
        "severity": SEVERITY[TIERS[tier]],
        "split": status.split,
    }


def _active(health: Health, joint: int | None, condition: str, by: str) -> Alert:
    """The one active alert of that name. Raises BadInput."""
    if not by.strip():
        raise BadInput("by: expected the name of the person who acts")
    for alert in health.alerts:
        if alert.active and alert.key == (joint, condition):
            return alert
    active = ", ".join(f"{alert.joint or 'arm'}/{alert.condition}" for alert in health.alerts if alert.active) or "none"
    raise BadInput(f"no active alert {joint or 'arm'}/{condition}; active: {active}")
