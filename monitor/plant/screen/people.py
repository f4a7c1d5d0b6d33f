"""Who may do what, and at which sites: roles, users with hashed tokens, and what a trusted proxy says of a person. No I/O.

A token is drawn by chance and is long, so one round of SHA-256 keeps it: nothing shorter than the token itself can be guessed.
"""

import hashlib
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from monitor.errors import BadInput

TOKEN_BYTES = 24
GROUP, USER = "group:", "user:"  # before a name in proxy_roles: of which kind it is
_NAME = re.compile(r"[\w.@+ -]{1,100}\Z")
_SITE = re.compile(r"[a-z0-9_-]{1,100}\Z")


class Role(IntEnum):
    """What a person may do; each role may do what those before it may."""

    look = 1
    acknowledge = 2
    move = 3
    configure = 4


NEEDED = {  # by command of an arm
    **dict.fromkeys(("ack", "unack", "shelve", "unshelve", "serviced", "unserviced", "inspected", "uninspected"), Role.acknowledge),
    "replay": Role.move,
}


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who is known."""

    name: str
    role: Role  # at every site, and of what is of the whole plant
    sites: Mapping[str, Role] = field(default_factory=dict)  # higher ones, at these sites alone

    def at(self, site: str | None) -> Role:
        """What he may at a site; None: for the whole plant."""
        return max(self.role, self.sites.get(site or "", self.role))


class Grant(NamedTuple):
    """A role, and the sites to which it is limited; none: it holds everywhere."""

    role: Role
    sites: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class User:
    """A person, or a program, with a token of the plant's own."""

    name: str
    role: Role
    digest: str  # SHA-256 of the token, hexadecimal
    sites: tuple[str, ...] = ()

    @property
    def person(self) -> Person:
        """Whom the token names."""
        return granted(self.name, [Grant(self.role, self.sites)])


def role_named(text: str) -> Role:
    """Raises BadInput where it is none."""
    try:
        return Role[text]
    except KeyError:
        raise BadInput(f"{text!r} is no role; expected {', '.join(role.name for role in Role)}") from None


def grant_named(role: str, sites: Sequence[str]) -> Grant:
    """Raises BadInput where the role is none, a site can be none, or the role cannot be limited to sites."""
    grant = Grant(role_named(role), tuple(sites))
    for site in sites:
        if not _SITE.match(site):
            raise BadInput(f"{site!r} is no site; expected only a–z, 0–9, _ and -")
    if sites and grant.role is Role.look:
        raise BadInput("look is of the whole plant: whoever is known sees every site; sites limit what he may do there")
    return grant


def granted(name: str, grants: Sequence[Grant]) -> Person:
    """The person of these grants, of which there is one at least: whoever is known may look everywhere."""
    everywhere = max([Role.look, *(each.role for each in grants if not each.sites)])
    at: dict[str, Role] = {}
    for each in grants:
        at |= {site: max(each.role, at.get(site, everywhere)) for site in each.sites if each.role > everywhere}
    return Person(name, everywhere, at)


def new_user(name: str, role: Role, sites: Sequence[str] = ()) -> tuple[User, str]:
    """A user and his token, which is known to nobody else afterwards. Raises BadInput where the name cannot stand in the file."""
    if not _NAME.match(name) or name != name.strip():
        raise BadInput(f"{name!r}: expected a name of up to 100 letters, digits and . @ + _ -")
    token = secrets.token_urlsafe(TOKEN_BYTES)
    return User(name, role, digest(token), grant_named(role.name, sites).sites), token


def digest(token: str) -> str:
    """What is kept of a token."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_users(text: str, where: str) -> dict[str, User]:
    """Users by name, from lines NAME:ROLE:DIGEST or NAME:ROLE:DIGEST:SITE,SITE. Raises BadInput that names every line that is none."""
    users: dict[str, User] = {}
    mistakes = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, _, rest = line.strip().partition(":")
        role, _, rest = rest.partition(":")
        kept, limited, sites = rest.partition(":")
        try:
            grant = grant_named(role, sites.split(",") if limited else ())
            user = User(name, grant.role, kept, grant.sites)
        except BadInput as error:
            mistakes.append(f"line {number}: {error}")
            continue
        if not _NAME.match(name) or not re.fullmatch(r"[0-9a-f]{64}", kept):
            mistakes.append(f"line {number}: expected NAME:ROLE:DIGEST as joint-monitor plant user writes it")
        elif name in users:
            mistakes.append(f"line {number}: {name} stands there already")
        else:
            users[name] = user
    if mistakes:
        raise BadInput(f"{where}: " + "; ".join(mistakes))
    return users


def line_of(user: User) -> str:
    """His line in the file of users."""
    return f"{user.name}:{user.role.name}:{user.digest}" + (f":{','.join(user.sites)}" if user.sites else "")


def user_of(token: str, users: Mapping[str, User]) -> User | None:
    """Whose token this is. All are compared, each in the same time."""
    given, found = digest(token), None
    for user in users.values():
        if secrets.compare_digest(given, user.digest):
            found = user
    return found


def person_of_proxy(
    names: Sequence[str], groups: Sequence[str], roles: Mapping[str, Sequence[Grant]], everybody: Role | None
) -> Person | None:
    """A person whom a proxy has signed in: the highest role of his names and groups, and of everybody whom the proxy lets through.

    names : what the proxy calls him, the one to be shown first. None where there is none, or no role for him. A role of `group:NAME` is for
    a group alone, one of `user:NAME` for a person alone: where people choose their names, one could call himself as a group is called.
    """
    plain = (each for each in (*groups, *names) if not each.startswith((GROUP, USER)))
    known = (*plain, *(GROUP + each for each in groups), *(USER + each for each in names))
    found = [grant for each in known for grant in roles.get(each, ())]
    if everybody is not None:
        found.append(Grant(everybody))
    return granted(names[0], found) if names and found else None


def printable(text: str) -> str:
    """A text for a line of the journal: signs that would end the line, move a terminal or turn the text round are written out."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)
