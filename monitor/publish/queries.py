"""What is asked over the bus: payloads as types, selector parameters, and their checks, with every mistake named.

A command (`cmd/…`) needs a valid payload; a query about the past takes selector parameters (`history?joint=3;limit=100`).
"""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from monitor.errors import BadInput
from monitor.publish.documents import Joint, Rows
from monitor.publish.timestamps import unix_s

MOST_ROWS = 10_000
MOST_EVENTS = 100
Who = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S", description="name of the person or program that acts")]
Why = Annotated[str, Field(max_length=2000)]


class Request(BaseModel):
    """What is asked: an unknown field is a mistake, and is named."""

    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True, strict=True)


class AckRequest(Request):
    """An alert has been seen, by whom and why it may wait."""

    joint: Joint | None = Field(description="null is the arm")
    condition: Annotated[str, Field(min_length=1, max_length=100)]
    by: Who
    why: Why = ""


class UnackRequest(AckRequest):
    """The acknowledgements of an alert are taken back: it waits for a person again."""


class UnshelveRequest(AckRequest):
    """A shelved alert is to be shown again."""


class ShelveRequest(AckRequest):
    """An alert need not be shown for some time."""

    hours: Annotated[float, Field(gt=0.0, le=24.0 * 90)]


class ServicedRequest(Request):
    """Work on a joint: it was replaced, greased or overhauled."""

    joint: Joint
    kind: Annotated[str, Field(pattern="^(replaced|overhauled|greased)$", description="replaced, overhauled or greased")]
    by: Who
    why: Annotated[str, Field(min_length=1, max_length=2000, pattern=r"\S", description="what was found and done")]
    at: str | None = Field(default=None, description="when it was done, e.g. 2026-01-31; null: now")


class UndoServicedRequest(Request):
    """The last declared work on a joint was a mistake, and is taken back."""

    joint: Joint
    by: Who
    why: Why = ""


class ReplayRequest(Request):
    """A replay is asked for."""

    by: Who
    why: Why = ""


class InspectedRequest(Request):
    """A check was made."""

    item: Annotated[str, Field(min_length=1, max_length=100)]
    by: Who
    why: Annotated[str, Field(min_length=1, max_length=2000, pattern=r"\S", description="what was found")]
    at: str | None = Field(default=None, description="when it was made, e.g. 2026-01-31; null: now")


class UndoInspectedRequest(Request):
    """The last record of a check was a mistake, and is taken back."""

    item: Annotated[str, Field(min_length=1, max_length=100)]
    by: Who
    why: Why = ""


class TorqueRequest(Request):
    """One sample or N; q̈ is 0 where not given, temperatures the present ones."""

    q: Rows = Field(description="rad")
    qd: Rows = Field(description="rad/s")
    qdd: Rows | None = Field(default=None, description="rad/s²")
    temperature_c: Rows | None = None


Asked = TypeVar("Asked", bound=Request)


class HistoryQuestion(NamedTuple):
    """The rows that a query on `history` asks for."""

    joint: int | None
    from_unix_s: float | None
    to_unix_s: float | None
    after: int
    limit: int
    changed_after: int | None = None  # the question is for changes after this number, not for a page of rows
    stored_after: int | None = None  # likewise, for the rows of the history's own tables


class EventsQuestion(NamedTuple):
    """The transitions that a query on `event` asks for."""

    after: int
    limit: int | None  # so many, the oldest; None: the newest MOST_EVENTS


def request(model: type[Asked], key: str, payload: Mapping[str, Any]) -> Asked:
    """A query's payload as a request of this type. Raises BadInput that names the key and every wrong field."""
    try:
        return model.model_validate(payload)
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(str(part) for part in problem['loc']) or 'payload'}: {problem['msg']}" for problem in error.errors())
        raise BadInput(f"{key}: {wrong}") from None


def history_question(parameters: Mapping[str, str], joints: int) -> HistoryQuestion:
    """From selector parameters: joint (1…J), from, to (RFC 3339), after (a replay's number), limit (1…10 000); changed_after; stored_after.

    Raises BadInput naming the parameter, its value and what would be right.
    """
    logs = ("changed_after", "stored_after")
    _known("history", parameters, {"joint", "from", "to", "after", "limit", *logs})
    for log in logs:
        if log in parameters and (others := sorted(({"joint", "from", "to", "after", *logs} - {log}) & parameters.keys())):
            raise BadInput(f"history: {log} and {others[0]} exclude each other; expected {log} alone, or with limit")
    joint = _whole("history", parameters, "joint", 1, joints)
    after, limit = _whole("history", parameters, "after", 0, 2**53), _whole("history", parameters, "limit", 1, MOST_ROWS)
    return HistoryQuestion(
        joint=joint,
        from_unix_s=_time("history", parameters, "from"),
        to_unix_s=_time("history", parameters, "to"),
        after=after or 0,
        limit=1000 if limit is None else limit,
        changed_after=_whole("history", parameters, "changed_after", 0, 2**53),
        stored_after=_whole("history", parameters, "stored_after", 0, 2**53),
    )


def events_question(parameters: Mapping[str, str]) -> EventsQuestion:
    """From selector parameters: after (a transition's number; 0 where none is given), limit (1…10 000). Raises BadInput."""
    _known("event", parameters, {"after", "limit"})
    return EventsQuestion(
        after=_whole("event", parameters, "after", 0, 2**53) or 0, limit=_whole("event", parameters, "limit", 1, MOST_ROWS)
    )


def _known(key: str, parameters: Mapping[str, str], names: set[str]) -> None:
    for name in parameters:
        if name not in names and not name.startswith("_"):  # names that begin with _ are Zenoh's own
            raise BadInput(f"{key}: unknown parameter {name!r}; known are {', '.join(sorted(names))}")


def _whole(key: str, parameters: Mapping[str, str], name: str, least: int, most: int) -> int | None:
    text = parameters.get(name)
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 17 and least <= int(text) <= most):
        raise BadInput(f"{key}: {name} = {text!r}; expected a whole number from {least} to {most}")
    return int(text)


def _time(key: str, parameters: Mapping[str, str], name: str) -> float | None:
    text = parameters.get(name)
    if text is None:
        return None
    try:
        return unix_s(text)
    except ValueError:
        raise BadInput(f"{key}: {name} = {text!r}; expected a time such as 2026-01-31T03:00:00Z") from None
