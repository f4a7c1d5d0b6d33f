"""The published form of a Health: the fields that the schema names, without the judge's internal counts."""

from collections.abc import Mapping
from typing import Any

from monitor.judge.alerts.health import Health, HealthSettings, alert_document, health_from_document
from monitor.judge.alerts.states import FOR_DAYS, NOT_YET, stale_joints, stale_reason
from monitor.reason import Reason, with_reasons
from monitor.recording import DAY_S


def published_health(health: Health | None, now_unix_s: float, settings: HealthSettings) -> dict[str, Any]:
    """States, reasons and alerts, each with its staleness; `state` is None before the first assessment.

    Staleness stands beside the state: an alert stays until a replay clears it, and readers of v1 know five states.
    """
    if health is None or not health.joints:
        alerts = () if health is None else health.alerts
        why = next((alert.text for alert in alerts if alert.active), None)
        early: dict[str, Any] = {"state": None, "joints": [], "alerts": [alert_document(alert) for alert in alerts]}
        return early if why is None else with_reasons(early, why=why)
    silent = stale_joints(health, now_unix_s, settings)
    document = {
        "state": health.state,
        "since_unix_s": health.since_unix_s,
        "stale": any(silent),
        "joints": [
            with_reasons(
                {
                    "joint": joint.joint,
                    "state": joint.state,
                    "since_unix_s": joint.since_unix_s,
                    "stale": old,
                    "learnt_at_unix_s": joint.learnt_at_unix_s,
                },
                why=joint.why,
            )
            for joint, old in zip(health.joints, silent, strict=True)
        ],
        "alerts": [alert_document(alert) for alert in health.alerts],
    }
    return with_reasons(document, why=health.why, stale_why=_stale_why(health, silent, now_unix_s, settings))


def with_stale(document: Mapping[str, Any], now_unix_s: float, settings: HealthSettings) -> dict[str, Any]:
    """The stored document of a Health with staleness added. Raises BadInput where it is none."""
    health = health_from_document(document)
    silent = stale_joints(health, now_unix_s, settings)
    joints = [{**joint, "stale": old} for joint, old in zip(document["joints"], silent, strict=True)]
    alerts = [alert_document(alert) for alert in health.alerts]  # a stored one does not say whether it is active
    why = _stale_why(health, silent, now_unix_s, settings)
    return with_reasons({**document, "stale": any(silent), "joints": joints, "alerts": alerts}, stale_why=why)


def _stale_why(health: Health, silent: tuple[bool, ...], now_unix_s: float, settings: HealthSettings) -> Reason | None:
    """For how long there was no figure, and of which joints; None where there was one of every joint."""
    if not any(silent):
        return None
    old = [joint for joint, is_old in zip(health.joints, silent, strict=True) if is_old]
    known = [joint.learnt_at_unix_s for joint in old if joint.learnt_at_unix_s is not None]
    limit = settings.stale_days
    since = FOR_DAYS(days=(now_unix_s - min(known)) / DAY_S, limit=limit) if known else NOT_YET(limit=limit)
    return stale_reason([joint.joint for joint in old], len(health.joints), since)
