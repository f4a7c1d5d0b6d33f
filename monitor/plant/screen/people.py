"""Who may do what: roles, users with hashed tokens, and what a trusted proxy says of a person. No I/O.

A token is drawn by chance and is long, so one round of SHA-256 keeps it: nothing shorter than the token itself can be guessed.
"""

import hashlib
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from monitor.errors import BadInput

TOKEN_BYTES = 24
GROUP, USER = "group:", "user:"  # before a name in proxy_roles: of which kind it is
_NAME = re.compile(r"[\w.@+ -]{1,100}\Z")


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
    role: Role


@dataclass(frozen=True, slots=True)
class User:
    """A person with a token of the plant's own."""

    name: str
    role: Role
    digest: str  # SHA-256 of the token, hexadecimal


def role_named(text: str) -> Role:
    """Raises BadInput where it is none."""
    try:
        return Role[text]
    except KeyError:
        raise BadInput(f"{text!r} is no role; expected {', '.join(role.name for role in Role)}") from None


def new_user(name: str, role: Role) -> tuple[User, str]:
    """A user and his token, which is known to nobody else afterwards. Raises BadInput where the name cannot stand in the file."""
    if not _NAME.match(name) or name != name.strip():
        raise BadInput(f"{name!r}: expected a name of up to 100 letters, digits and . @ + _ -")
    token = secrets.token_urlsafe(TOKEN_BYTES)
    return User(name, role, digest(token)), token


def digest(token: str) -> str:
    """What is kept of a token."""
    return hashlib.sha256(token.encode()).hexdigest()


def read_users(text: str, where: str) -> dict[str, User]:
    """Users by name, from lines NAME:ROLE:DIGEST. Raises BadInput that names every line that is none."""
    users: dict[str, User] = {}
    mistakes = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, _, rest = line.strip().partition(":")
        role, _, kept = rest.partition(":")
        try:
            user = User(name, role_named(role), kept)
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
    return f"{user.name}:{user.role.name}:{user.digest}"


def user_of(token: str, users: Mapping[str, User]) -> User | None:
    """Whose token this is. All are compared, each in the same time."""
    given, found = digest(token), None
    for user in users.values():
        if secrets.compare_digest(given, user.digest):
            found = user
    return found


def person_of_proxy(names: Sequence[str], groups: Sequence[str], roles: Mapping[str, Role], everybody: Role | None) -> Person | None:
    """A person whom a proxy has signed in: the highest role of his names and groups, and of everybody whom the proxy lets through.

    names : what the proxy calls him, the one to be shown first. None where there is none, or no role for him. A role of `group:NAME` is for
    a group alone, one of `user:NAME` for a person alone: where people choose their names, one could call himself as a group is called.
    """
    plain = (each for each in (*groups, *names) if not each.startswith((GROUP, USER)))
    found = [roles[each] for each in (*plain, *(GROUP + each for each in groups), *(USER + each for each in names)) if each in roles]
    if everybody is not None:
        found.append(everybody)
    return Person(names[0], max(found)) if names and found else None


def printable(text: str) -> str:
    """A text for a line of the journal: signs that would end the line, move a terminal or turn the text round are written out."""
    return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)
