"""What of the house's own documents is told outside: what the schemas name, and no running counts of the judge."""

from typing import Any

from monitor.assess import alert_document
from monitor.judge.health import Health


def health_told(health: Health | None) -> dict[str, Any]:
    """States, reasons and alerts; before the first replay `state` is None."""
    if health is None:
        return {"state": None, "joints": [], "alerts": []}
    return {
        "state": health.state,
        "why": health.why,
        "since_unix_s": health.since_unix_s,
        "joints": [
            {"joint": joint.joint, "state": joint.state, "why": joint.why, "since_unix_s": joint.since_unix_s} for joint in health.joints
        ],
        "alerts": [alert_document(alert) for alert in health.alerts],
    }
