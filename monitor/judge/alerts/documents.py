"""Health and alerts as JSON objects, and back. Their keys are published and stored; `metadata["key"]` of a field names an older key."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from monitor.errors import BadInput
from monitor.judge.alerts.health import Acknowledgement, Alert, Attribution, Confirmations, Gravest, Health, JointHealth
from monitor.judge.document import entry, key_of, plain


def alert_document(alert: Alert) -> dict[str, Any]:
    """One alert as a JSON object, with the key `active` in addition."""
    return {**plain(alert), "active": alert.active}


def alert_from_document(document: Mapping[str, Any]) -> Alert:
    """An Alert from a JSON object that may hold more, for example an event. Raises TypeError where a field is missing."""
    known = {key_of(f) for f in fields(Alert)}
    return _alert({key: value for key, value in document.items() if key in known})


def health_from_document(document: Any) -> Health:
    """A Health from `Health.as_document()`. Raises BadInput naming what is missing or wrong."""
    try:
        joints = tuple(_joint(joint) for joint in entry(document, "joints", where="health"))
        alerts = tuple(_alert(alert) for alert in entry(document, "alerts", where="health"))
        rest = {name: entry(document, name, where="health") for name in ("state", "why", "since_unix_s")}
        common = Confirmations(**entry(document, "common", where="health"))
        return Health(joints=joints, alerts=alerts, common=common, confirmations=_by_condition(document.get("troubled", ())), **rest)
    except (TypeError, KeyError, ValueError) as wrong:
        raise BadInput(f"health: {wrong}") from None


def _joint(document: Mapping[str, Any]) -> JointHealth:
    values = _by_field(JointHealth, document)
    values["rising"] = tuple(Confirmations(**each) for each in document["rising"])
    values["falling"] = Confirmations(**document["falling"])
    values["confirmations"] = _by_condition(document.get("troubled", ()))
    return JointHealth(**values)


def _alert(document: Mapping[str, Any]) -> Alert:
    values = _by_field(Alert, document)
    gravest = values.get("gravest")
    values["attribution"] = _attribution(values.get("attribution"))
    values["gravest"] = Gravest(**gravest | {"split": _attribution(gravest.get("split"))}) if gravest else None
    values["acknowledgements"] = tuple(Acknowledgement(**each) for each in values.get("acknowledgements") or ())
    return Alert(**values)


def _attribution(document: Mapping[str, Any] | None) -> Attribution | None:
    return Attribution(**document) if document else None


def _by_field(cls: type, document: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a JSON object by the names of a dataclass's fields; an unknown key keeps its name."""
    names = {key_of(f): f.name for f in fields(cls)}
    return {names.get(key, key): value for key, value in document.items()}


def _by_condition(document: Iterable[Any]) -> tuple[tuple[str, Confirmations], ...]:
    return tuple((str(condition), Confirmations(**confirmations)) for condition, confirmations in document)
