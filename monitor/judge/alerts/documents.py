"""Health and alerts as JSON objects, and back."""

from dataclasses import fields
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.health import Alert, Attribution, Confirmations, Health, JointHealth
from monitor.judge.document import entry, plain


def alert_document(alert: Alert) -> dict[str, Any]:
    """One alert, with `active` said outright."""
    return {**plain(alert), "active": alert.active}


def health_from_document(document: Any) -> Health:
    """A Health from `Health.as_document()`. Raises BadInput naming what is missing or wrong."""
    try:
        joints = tuple(
            JointHealth(
                **{
                    **o,
                    "rising": tuple(Confirmations(**e) for e in o["rising"]),
                    "falling": Confirmations(**o["falling"]),
                    "troubled": _troubled(o),
                }
            )
            for o in entry(document, "joints", where="health")
        )
        alerts = tuple(
            Alert(**{**o, "split": Attribution(**o["split"]) if o.get("split") else None})
            for o in entry(document, "alerts", where="health")
        )
        plainly = {f.name for f in fields(Health)} - {"joints", "alerts", "common", "troubled"}
        rest = {name: entry(document, name, where="health") for name in plainly}
        common = Confirmations(**entry(document, "common", where="health"))
        return Health(joints=joints, alerts=alerts, common=common, troubled=_troubled(document), **rest)
    except (TypeError, KeyError, ValueError) as wrong:
        raise BadInput(f"health: {wrong}") from None


def _troubled(document: dict[str, Any]) -> tuple[tuple[str, Confirmations], ...]:
    return tuple((str(condition), Confirmations(**evidence)) for condition, evidence in document.get("troubled", ()))
