"""The registry of documents on the bus: one entry a kind. The bus, the client, `schema` and the documentation's tests read it.

A new document is one entry in `KINDS` and the type of its content in `documents` (of a request: in `queries`).
"""

from dataclasses import dataclass
from enum import Enum
from string import Formatter
from typing import Any

from pydantic import BaseModel

from monitor.publish import documents, queries


class Delivery(Enum):
    """How a document travels."""

    LAST_VALUE = "published, and kept for every later `get`"
    STREAM = "published and kept; a sample is dropped where the network is slow"
    TRANSITION = "published once and not kept: a log that a query pages through"
    REQUEST = "the payload of a query that the monitor answers"
    ANSWER = "the answer to a query"
    QUESTION = "the payload of a query that the monitor asks, or its answer"
    REFUSAL = "the error reply to any query"


PUBLISHED = (Delivery.LAST_VALUE, Delivery.STREAM, Delivery.TRANSITION)


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentKind:
    """One kind of document, `joint-monitor.<name>.v1`."""

    name: str
    model: type[BaseModel]  # its content; the JSON Schema is made from it
    keys: tuple[str, ...]  # below the robot's prefix; a name in braces is filled in when the document is published
    delivery: Delivery
    when: str  # it is published or answered, in one sentence

    def key(self, **parts: Any) -> str:
        """The key of one document, e.g. `key(joint=3)` of `joint/{joint}/friction`. Raises KeyError where a part is missing."""
        return self.keys[0].format(**parts)

    def key_of(self, document: BaseModel) -> str:
        """The key of this document, which its own fields fill in."""
        return self.key(**{part: getattr(document, part) for _, part, _, _ in Formatter().parse(self.keys[0]) if part})

    @property
    def selectors(self) -> tuple[str, ...]:
        """Key expressions that match every document of this kind: `joint/*/friction`."""
        return tuple("/".join("*" if part.startswith("{") else part for part in key.split("/")) for key in self.keys)


def _entries(*kinds: DocumentKind) -> dict[str, DocumentKind]:
    return {kind.name: kind for kind in kinds}


def _entry(name: str, model: type[BaseModel], key: str | tuple[str, ...], delivery: Delivery, when: str) -> DocumentKind:
    return DocumentKind(name=name, model=model, keys=(key,) if isinstance(key, str) else key, delivery=delivery, when=when)


_LAST, _REQUEST, _ANSWER = Delivery.LAST_VALUE, Delivery.REQUEST, Delivery.ANSWER
COMMANDS = (
    *("cmd/ack", "cmd/unack", "cmd/shelve", "cmd/unshelve", "cmd/serviced", "cmd/unserviced"),
    *("cmd/inspected", "cmd/uninspected", "cmd/replay"),
)

KINDS: dict[str, DocumentKind] = _entries(
    _entry("info", documents.Info, "info", _LAST, "At the start, after a reload, and when serial number or firmware change."),
    _entry("health", documents.Health, "health", _LAST, "At every change, and every `[bus] health_period_s`."),
    _entry("friction", documents.Friction, "joint/{joint}/friction", _LAST, "After every assessed replay, one of each joint."),
    _entry("alert", documents.Alert, "alert/{where}/{condition}", _LAST, "At every change of this alert; `where` is j1, j2, … or arm."),
    _entry("event", documents.Event, "event", Delivery.TRANSITION, "At every transition of an alert."),
    _entry("events", documents.Events, "event", _ANSWER, "On a query with the parameter `after`."),
    _entry("model", documents.Model, "model", _LAST, "After every assessed replay."),
    _entry("compensation", documents.Compensation, "compensation", _LAST, "After every assessed replay."),
    _entry("torque-request", queries.TorqueRequest, "torque", _REQUEST, "When a client asks for torque."),
    _entry("torque", documents.Torque, "torque", _ANSWER, "On a query with a torque-request."),
    _entry("torque-live", documents.TorqueLive, "torque/live", Delivery.STREAM, "While the arm is received, at `[bus] live_rate_hz`."),
    _entry("history", documents.History, "history", _ANSWER, "On a query with parameters."),
    _entry("monitor", documents.Monitor, "monitor", _LAST, "Every ten seconds."),
    _entry("ack-request", queries.AckRequest, "cmd/ack", _REQUEST, "When a person acknowledges an alert."),
    _entry("unack-request", queries.UnackRequest, "cmd/unack", _REQUEST, "When a person takes acknowledgements back."),
    _entry("shelve-request", queries.ShelveRequest, "cmd/shelve", _REQUEST, "When a person shelves an alert."),
    _entry("unshelve-request", queries.UnshelveRequest, "cmd/unshelve", _REQUEST, "When a person ends a shelving."),
    _entry("serviced-request", queries.ServicedRequest, "cmd/serviced", _REQUEST, "When a person declares work on a joint."),
    _entry("unserviced-request", queries.UndoServicedRequest, "cmd/unserviced", _REQUEST, "When a person takes that back."),
    _entry(
        "maintenance",
        documents.Maintenance,
        "joint/{joint}/maintenance",
        _LAST,
        "When work on a joint is declared, taken back, or judged by a replay.",
    ),
    _entry(
        "from-production",
        documents.FromProduction,
        "from_production",
        _LAST,
        "At the start, and after each judged day of ordinary work (`[production] listen`).",
    ),
    _entry(
        "inspection",
        documents.Inspection,
        "inspection",
        _LAST,
        "Every ten minutes, at every stop of the arm's safety system, and when a check is recorded (`[inspection]`).",
    ),
    _entry("inspected-request", queries.InspectedRequest, "cmd/inspected", _REQUEST, "When a person records a check."),
    _entry("uninspected-request", queries.UndoInspectedRequest, "cmd/uninspected", _REQUEST, "When a person takes that back."),
    _entry("replay-request", queries.ReplayRequest, "cmd/replay", _REQUEST, "When a person asks for a replay."),
    _entry("replay", documents.Replay, "replay", _LAST, "Before the arm moves for a replay, and after it."),
    _entry(
        "permit",
        documents.Permit,
        "permit/replay",
        Delivery.QUESTION,
        "Before the arm moves, and every second while it moves, where the configuration asks for it.",
    ),
    _entry("permit-answer", documents.PermitAnswer, "permit/replay", Delivery.QUESTION, "The answer of the cell's own program."),
    _entry("answer", documents.Answer, COMMANDS, _ANSWER, "On a command that was carried out."),
    _entry("error", documents.Error, (), Delivery.REFUSAL, "On any query that is refused."),
)


def answer_kind(key: str) -> DocumentKind:
    """The kind of the answer to a query on a key. Raises KeyError where none is registered."""
    for kind in KINDS.values():
        if kind.delivery is Delivery.ANSWER and key in kind.keys:
            return kind
    raise KeyError(key)


def takes_payload(key: str) -> bool:
    """Whether a query on a key carries a request as payload; otherwise it carries the selector's parameters."""
    return any(kind.delivery is Delivery.REQUEST and key in kind.keys for kind in KINDS.values())


def published_at(key: str) -> DocumentKind | None:
    """The kind that is published on a key below the robot's prefix; None where none is."""
    levels = key.split("/")
    for kind in KINDS.values():
        if kind.delivery in PUBLISHED and _matches(kind.selectors[0].split("/"), levels):
            return kind
    return None


def _matches(selector: list[str], levels: list[str]) -> bool:
    return len(selector) == len(levels) and all(one in ("*", other) for one, other in zip(selector, levels, strict=True))


def kind_of(model: type[BaseModel]) -> DocumentKind:
    """The registered kind whose content has this type. Raises KeyError where there is none."""
    for kind in KINDS.values():
        if kind.model is model:
            return kind
    raise KeyError(model.__name__)


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema (2020-12) of a kind. Raises KeyError for a kind that is not registered."""
    body = KINDS[name].model.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": f"joint-monitor.{name}.v1", **body}
