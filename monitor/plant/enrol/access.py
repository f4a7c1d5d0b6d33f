"""Who may say and hear what on a plant's bus: Zenoh's access control for each router, arm and person, as documents. Pure.

The way is arm → router of its site → core. Each router knows its neighbours by the common name of their certificate, and lets through what
that neighbour may say: an arm speaks below its own key and nowhere else, a site's router for its own site and no other. A person's
certificate is judged by the router to which he connects. Whatever no rule allows is refused.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from monitor.plant.enrol.inventory import Arm
from monitor.publish.registry import COMMANDS
from monitor.publish.session import PLANT, ROOT

CORE = "core"
MOVES = ("cmd/replay",)  # what makes an arm move
ANSWERED = tuple(command for command in COMMANDS if command not in MOVES)  # what changes what is known of an arm

_SAYS = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]
_ASKS = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]


class Person(NamedTuple):
    """A kind of certificate that people and their programs hold, and the commands that it may send to every arm."""

    name: str
    commands: tuple[str, ...]
    about: str


PEOPLE = (
    Person("viewer", (), "looks"),
    Person("maintenance", ANSWERED, "looks, acknowledges, shelves, declares work"),
    Person("operator", COMMANDS, "as maintenance, and asks for replays: the arm moves"),
    Person("plant", COMMANDS, "the service `joint-monitor plant`, which knows its own users"),
)


class Tls(NamedTuple):
    """Where a host finds its certificates."""

    folder: str  # e.g. /etc/joint-monitor/tls
    name: str  # of the files NAME.pem and NAME.key there

    def document(self, *, listens: bool) -> dict[str, Any]:
        """Zenoh's `transport/link/tls`. Both ends show a certificate."""
        own = {"certificate": f"{self.folder}/{self.name}.pem", "private_key": f"{self.folder}/{self.name}.key"}
        kinds = ("listen", "connect") if listens else ("connect",)
        return {
            "root_ca_certificate": f"{self.folder}/ca.pem",
            **{f"{kind}_{what}": path for kind in kinds for what, path in own.items()},
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }


def client_document(tls: Tls) -> dict[str, Any]:
    """Zenoh as an arm's daemon, a person's program or the plant's service speaks it: it connects to a router, and opens no port."""
    return {"transport": {"link": {"tls": tls.document(listens=False)}}}


def site_router_document(site: str, arms: Sequence[Arm], endpoint: str, core: str, tls: Tls) -> dict[str, Any]:
    """The router of one site: its arms connect to it, and people of the site; it connects to the core where there is one."""
    acl = _Rules()
    for arm in arms:
        key = f"{ROOT}/{arm.site}/{arm.id}"
        acl.add(_rule(f"{arm.name} speaks", ["ingress"], [*_SAYS, *_ASKS], f"{key}/**"), arm.name)
        acl.add(_rule(f"{arm.name} hears", ["egress"], _SAYS, f"{key}/**"), arm.name, with_rules=(IS_ASKED, *ASKS_PLANT))
        permits = _rule(f"{cell_name(arm)} permits", ["ingress", "egress"], ["query", "reply", "declare_queryable"], f"{key}/permit/**")
        acl.add(permits, cell_name(arm))
    if core:  # whom the core lets through, the site believes
        acl.add(_rule("the core asks", ["ingress"], _ASKS, f"{ROOT}/**"), CORE, with_rules=IS_PLANT)
        acl.add(_rule("the core hears", ["egress"], _SAYS, f"{ROOT}/{site}/**"), CORE)
    return _router(endpoint, [core] if core else [], tls, acl)


def core_router_document(sites: Sequence[str], endpoint: str, tls: Tls) -> dict[str, Any]:
    """The router in the middle: sites connect to it, and those who look at several of them."""
    acl = _Rules()
    for site in sites:
        acl.add(_rule(f"{site} speaks", ["ingress"], _SAYS, f"{ROOT}/{site}/**"), router_name(site), with_rules=(IS_ASKED, *ASKS_PLANT))
    return _router(endpoint, [], tls, acl)


def router_name(site: str) -> str:
    """The common name of a site's router. An arm's is SITE.ID, and no site holds the sign @."""
    return f"router@{site}"


def cell_name(arm: Arm) -> str:
    """The common name of the program of an arm's cell, which answers whether the arm may move."""
    return f"cell@{arm.name}"


IS_ASKED = "is asked"
PLANT_ITSELF = "plant"  # of PEOPLE
ASKS_PLANT = ("asks the plant", "hears the plant")
IS_PLANT = ("the plant says", "the plant is asked")


class _Rules:
    """The rules of one router, and who is under which. Those of people stand in every router."""

    def __init__(self) -> None:
        self.rules = [
            _rule(IS_ASKED, ["egress"], _ASKS, f"{ROOT}/**"),
            _rule("look", ["ingress"], _ASKS, f"{ROOT}/**"),
            _rule("hear", ["egress"], _SAYS, f"{ROOT}/**"),
            _rule("asks the plant", ["ingress"], ["query"], f"{PLANT}/**"),
            _rule("hears the plant", ["egress"], ["reply", "declare_queryable"], f"{PLANT}/**"),
            _rule("the plant says", ["ingress"], ["reply", "declare_queryable"], f"{PLANT}/**"),
            _rule("the plant is asked", ["egress"], ["query"], f"{PLANT}/**"),
            *(_rule(f"no {command}", ["ingress"], ["query"], f"{ROOT}/*/*/{command}", permission="deny") for command in COMMANDS),
            # a command of a later version, which this table does not know
            _rule("no command", ["ingress"], ["query"], f"{ROOT}/*/*/cmd/**", permission="deny"),
        ]
        self.of: dict[str, list[str]] = {person.name: ["look", "hear", *ASKS_PLANT, *_refused(person)] for person in PEOPLE}
        self.of[PLANT_ITSELF] += IS_PLANT

    def add(self, rule: dict[str, Any], subject: str, with_rules: Sequence[str] = ()) -> None:
        self.rules.append(rule)
        self.of.setdefault(subject, []).extend([rule["id"], *with_rules])

    def document(self) -> dict[str, Any]:
        """Zenoh's `access_control`."""
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self.rules,
            "subjects": [{"id": name, "cert_common_names": [name]} for name in self.of],
            "policies": [{"rules": rules, "subjects": [name]} for name, rules in self.of.items()],
        }


def _refused(person: Person) -> list[str]:
    if not person.commands:
        return ["no command"]
    return [f"no {command}" for command in COMMANDS if command not in person.commands]


def _rule(name: str, flows: list[str], messages: list[str], key: str, *, permission: str = "allow") -> dict[str, Any]:
    return {"id": name, "permission": permission, "flows": flows, "messages": messages, "key_exprs": [key]}


def _router(endpoint: str, connect: list[str], tls: Tls, acl: _Rules) -> dict[str, Any]:
    return {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "connect": {"endpoints": connect, "timeout_ms": -1, "exit_on_failure": False},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "link": {
                # a client that no longer reads is cut off after half a second; Zenoh's 5 s would be everybody's
                "tx": {"queue": {"congestion_control": {"block": {"wait_before_close": 500_000}}}},
                "tls": tls.document(listens=True),
            }
        },
        "access_control": acl.document(),
    }
