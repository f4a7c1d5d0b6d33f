"""The section [tickets], and requests from its templates: places in braces, in values and addresses; JSON pointers. Pure."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal
from urllib.parse import quote

from annotated_types import Interval

from monitor.errors import BadInput
from monitor.judge.alerts.health import TIERS
from monitor.plant.screen.people import role_named
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.settings import address_of

PLACES = {  # what may stand in braces, and what it becomes
    "key": "a name of the alert that no other one has",
    "site": "of the arm",
    "robot": "its id",
    "model": "its model, e.g. ur5e",
    "serial": "its serial number",
    "joint": "1 to 8; empty for the arm",
    "joint_name": "e.g. Elbow",
    "condition": "e.g. wear_rising",
    "tier": "wear or limit",
    "priority": "of the tier, from [tickets.priority]",
    "headline": "what is the case, in a sentence",
    "text": "the arm's own text with its figures",
    "action": "what to do",
    "change_percent": "by which friction has changed, e.g. 9.1",
    "raised_at": "RFC 3339, UTC",
    "at": "of this change, RFC 3339, UTC",
    "link": "to the arm's page of the plant's screen",
    "number": "of the ticket; once it is open",
}
_PLACE = re.compile(r"\{(\w+)\}")


def check_template(template: Any, where: str) -> None:
    """Raises BadInput naming a placeholder that does not exist."""
    for text in _texts(template):
        for name in _PLACE.findall(text):
            if name not in PLACES:
                raise BadInput(f"{where}: {{{name}}} is no placeholder; known are {', '.join(PLACES)}")


def filled(template: Any, values: Mapping[str, Any]) -> Any:
    """The template with its places filled. A text that is one place alone becomes the value itself: a figure stays a figure."""
    if isinstance(template, Mapping):
        return {key: filled(value, values) for key, value in template.items()}
    if isinstance(template, list | tuple):
        return [filled(value, values) for value in template]
    if not isinstance(template, str):
        return template
    alone = _PLACE.fullmatch(template)
    if alone is not None and alone[1] in values:
        return values[alone[1]]
    return _PLACE.sub(lambda place: _text(values.get(place[1], place[0])), template)


def filled_address(template: str, values: Mapping[str, Any]) -> str:
    """An address with its places filled; no value can add a part to it."""
    return _PLACE.sub(lambda place: quote(_text(values.get(place[1], "")), safe=""), template)


def pointed(document: Any, pointer: str) -> Any:
    """The value that a JSON pointer (RFC 6901) names; None where there is none."""
    found = document
    for part in pointer.split("/")[1:]:
        name = part.replace("~1", "/").replace("~0", "~")
        if isinstance(found, Mapping):
            found = found.get(name)
        elif isinstance(found, list) and re.fullmatch(r"0|[1-9]\d*", name) and int(name) < len(found):
            found = found[int(name)]
        else:
            return None
    return found


def check_pointer(pointer: str, where: str) -> None:
    """Raises BadInput where it is none."""
    if not re.fullmatch(r"(/([^~/]|~[01])*)+", pointer):
        raise BadInput(f'{where} = {pointer!r}; expected a JSON pointer (RFC 6901), e.g. "/id" or "/data/number"')


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _texts(template: Any) -> Iterator[str]:
    if isinstance(template, Mapping):
        for value in template.values():
            yield from _texts(value)
    elif isinstance(template, list | tuple):
        for value in template:
            yield from _texts(value)
    elif isinstance(template, str):
        yield template


# --- The section [tickets]: the maintenance system, and what its requests hold

Method = Literal["POST", "PUT", "PATCH"]


def _fields() -> dict[str, Any]:
    return {
        "title": "{site}/{robot}: {headline}",
        "description": "{text}\n\n{action}\n\n{link}",
        "asset": "{site}/{robot}",
        "priority": "{priority}",
        "reference": "{key}",
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class TicketSettings:
    """The section [tickets]. Without an address there are no tickets."""

    open_url: str = ""  # https://…: a request to it opens a ticket
    open_method: Method = "POST"
    fields: dict[str, Any] = field(default_factory=_fields)  # [tickets.fields]: the body of that request, with places in braces
    number: str = "/id"  # JSON pointer to the ticket's number in the answer
    find_url: str = ""  # asked before an attempt is repeated: whether the ticket is there already, e.g. "…?reference={key}"
    find_number: str = "/0/id"  # JSON pointer to its number in that answer
    update_url: str = ""  # where an alert becomes graver, e.g. "…/{number}"; empty: nothing is sent
    update_method: Method = "PATCH"
    update_fields: dict[str, Any] = field(default_factory=lambda: {"priority": "{priority}"})
    close_url: str = ""  # where an alert is over, e.g. "…/{number}"; empty: nothing is sent, a person closes the ticket
    close_method: Method = "PATCH"
    close_fields: dict[str, Any] = field(default_factory=lambda: {"status": "closed", "comment": "{text}"})
    web: str = ""  # address of a ticket for people, e.g. "https://cmms.plant.example/orders/{number}"
    authorization: str = field(default="", repr=False)  # the header of this name: "credential:NAME", which holds e.g. Bearer …
    headers: dict[str, str] = field(default_factory=dict, repr=False)  # further ones
    check_url: str = ""  # `gateway check` asks it with GET: whether we are let in
    ca_file: str = ""  # PEM of an authority of yours; empty: those that the system believes
    tiers: tuple[str, ...] = ("wear", "limit")  # that open a ticket
    priority: dict[str, Any] = field(default_factory=lambda: {"advisory": "low", "wear": "medium", "limit": "high"})
    sites: tuple[str, ...] = ("*",)  # patterns
    robots: tuple[str, ...] = ("*",)  # patterns of SITE/ROBOT
    conditions: tuple[str, ...] = ("*",)  # patterns
    language: str = ""  # en or de; empty: that of [gateway]
    give_up_days: Annotated[float, Interval(ge=1.0, le=60.0)] = 14.0
    listen: str = ""  # HOST:PORT where acknowledgements come in, e.g. "127.0.0.1:8410"; empty: nowhere
    webhook_secret: str = field(default="", repr=False)  # the key of their signatures: "credential:NAME"
    role: str = ""  # of the maintenance system: "acknowledge" lets it acknowledge alerts; empty: it may do nothing

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        for key in ("open_url", "find_url", "update_url", "close_url", "web", "check_url"):
            address = getattr(self, key)
            if address and not re.match(r"https?://[^\s/{}]+", address):
                raise BadInput(f"tickets: {key}: expected https://…")
            check_template(address, f"tickets: {key}")
        if not self.open_url and (self.find_url or self.update_url or self.close_url or self.listen):
            raise BadInput('tickets: expected open_url = "https://…" as well: without it no ticket is opened')
        for key in ("fields", "update_fields", "close_fields"):
            check_template(getattr(self, key), f"tickets: {key}")
        for key in ("open_url", "fields", "find_url"):
            if "{number}" in str(getattr(self, key)):
                raise BadInput(f"tickets: {key}: {{number}} is known only after the ticket is open")
        check_pointer(self.number, "tickets: number")
        check_pointer(self.find_number, "tickets: find_number")
        for key in ("tiers", "sites", "robots", "conditions"):
            if self.open_url and not getattr(self, key):
                raise BadInput(
                    f"tickets: {key} = []: no alert would ever open a ticket; leave it out for the default, or open_url for no tickets"
                )
        for key, given in (("tiers", self.tiers), ("priority", tuple(self.priority))):
            for each in given:
                if each not in TIERS:
                    raise BadInput(f"tickets: {key}: {each!r}; expected of {', '.join(TIERS)}")
        if self.language and self.language not in LANGUAGES:
            raise BadInput(f"tickets: language = {self.language!r}; expected {', '.join(LANGUAGES)}")
        for name, value in (*self.headers.items(), ("Authorization", self.authorization)):
            if not re.fullmatch(r"[A-Za-z0-9-]+", name) or not value.isprintable() or not value.isascii():
                raise BadInput(f"tickets: the header {name!r} cannot be sent: expected a name, and printable ASCII in one line")
        if self.role:
            role_named(self.role)
        if self.listen:
            address_of(self.listen, "tickets")
            if not self.webhook_secret or not self.role:
                raise BadInput('tickets: listen, but not both webhook_secret = "credential:NAME" and role = "acknowledge"')

    def concerns(self, site: str, robot: str, condition: str) -> bool:
        """Whether an alert of this arm and condition opens a ticket."""
        return (
            any(fnmatchcase(site, each) for each in self.sites)
            and any(fnmatchcase(f"{site}/{robot}", each) for each in self.robots)
            and any(fnmatchcase(condition, each) for each in self.conditions)
        )
