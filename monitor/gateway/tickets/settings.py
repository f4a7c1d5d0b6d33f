"""The section [tickets]: the maintenance system, and what its requests hold."""

import re
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal

from annotated_types import Interval

from monitor.errors import BadInput
from monitor.gateway.tickets.template import check_pointer, check_template
from monitor.judge.alerts.health import TIERS
from monitor.plant.screen.people import role_named
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.settings import address_of

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
