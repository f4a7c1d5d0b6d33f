"""Alerts that were active before the gateway first ran: their raising is told to nobody, so they are told once. No I/O, no clock."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from monitor.gateway.values import ACTIVE, ENDED, ArmState, Transition, gravity, time_said, transition_id


def already_active(arms: Iterable[ArmState], told: Collection[str], began_unix_s: float, now_unix_s: float) -> list[Transition]:
    """Those that nobody has acknowledged or shelved. told : names of alerts (`alert_id`) that are told. began_unix_s : of the gateway."""
    found = []
    for arm in arms:
        for alert in arm.alerts:
            raised, tier, joint = time_said(alert.get("raised_at")), str(alert.get("tier")), alert.get("joint")
            if raised is None or raised >= began_unix_s or not gravity(tier) or not _joint(joint) or _seen(alert, now_unix_s):
                continue
            one = _transition(arm, alert, tier, raised)
            if one.alert_id not in told:
                found.append(one)
    return found


def _transition(arm: ArmState, alert: Mapping[str, Any], tier: str, raised_unix_s: float) -> Transition:
    joint, condition = alert.get("joint"), str(alert.get("condition"))
    return Transition(
        id=transition_id(arm.name, joint, condition, ACTIVE, tier, raised_unix_s),
        arm=arm.name,
        joint=joint,
        condition=condition,
        before=ENDED,
        after=tier,
        kind=ACTIVE,
        at_unix_s=raised_unix_s,
        raised_at_unix_s=raised_unix_s,
        text=str(alert.get("text") or ""),
        document={**alert, "kind": ACTIVE},
    )


def _seen(alert: Mapping[str, Any], now_unix_s: float) -> bool:
    """Whether a person knows of it: it is acknowledged, or shelved at this time."""
    until = time_said(alert.get("shelved_until"))
    return bool(alert.get("acknowledged_at")) or (until is not None and until > now_unix_s)


def _joint(value: Any) -> bool:
    return value is None or (isinstance(value, int) and not isinstance(value, bool))
