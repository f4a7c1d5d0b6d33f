"""Who looks at the plant's screen, and what he may: users by token, people of a trusted proxy, or everybody of this machine. I/O."""

import base64
import logging
import os
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from monitor.errors import BadInput
from monitor.plant.screen.people import NEEDED, Person, Role, User, digest, person_of_proxy, printable, read_users, user_of
from monitor.plant.screen.settings import ScreenSettings
from monitor.publish.session import prefix
from monitor.views.web.access import OwnPages, Sessions, local_hosts

log = logging.getLogger(__name__)

HERE = Person("this machine", Role.configure)  # where nobody must say who he is
PROXY_HEADER = "x-proxy-secret"
TELL_AGAIN_S = 60.0  # between two lines of the journal on a proxy without its secret
SAME_TOKEN_S, MOST_WRONG = 3600.0, 1000  # a program that keeps asking with one wrong token is a line of the audit an hour
LONGEST_ACT = 40  # letters of what somebody calls a command
INTERFACE = "/api/v1"
Audit = Callable[[str, str, str | None, str], None]  # who, act, robot, text


class PlantAccess(OwnPages):
    """Answers who may; every refusal goes to the audit. It is the `PageAccess` of every arm's page of the screen."""

    def __init__(self, settings: ScreenSettings, folder: Path, port: int, audit: Audit) -> None:
        """Raises BadInput where the file of users cannot be read."""
        super().__init__(None if settings.knows_people else local_hosts(settings.address()[0], port))
        self._settings, self.audit = settings, audit
        self._roles = settings.roles()
        everybody = settings.proxy_role
        self._everybody = Role[everybody] if everybody else None
        self._file = settings.users_path(folder)
        self._told_at = -TELL_AGAIN_S
        self._wrong: dict[str, float] = {}  # digests of wrong tokens of requests: when each was noted
        self._users_of: tuple[int, int] | None = None
        self._users: dict[str, User] = {}
        self._sessions = Sessions(f"joint-monitor-plant-{port}")
        self._read_users(begins=True)

    @property
    def has_tokens(self) -> bool:
        """Whether people sign in here."""
        return self._file is not None

    @property
    def names_people(self) -> bool:
        """Whether it is known who somebody is."""
        return self._settings.knows_people

    def person(self, request: Request) -> Person | None:
        """Who sends this; None: nobody who is known."""
        if not self._settings.knows_people:
            return HERE
        if self._from_proxy(request) and (found := self._of_proxy(request)) is not None:
            return found
        self._read_users()
        if (token := bearer(request)) is not None:  # it alone counts then
            user = user_of(token, self._users)
            return None if user is None else user.person
        name, _, kept = (self._sessions.of(request) or "").partition(":")
        user = self._users.get(name)
        return user.person if user is not None and user.digest == kept else None

    def by_token(self, request: Request) -> bool:
        """Whether its own token alone says who sends this: what a proxy adds to a browser's requests proves nothing of the page."""
        proxied = self._from_proxy(request) and self._of_proxy(request) is not None
        return self._settings.knows_people and not proxied and bearer(request) is not None

    def _from_proxy(self, request: Request) -> bool:
        """Whether a proxy whose word is believed sends this: by its address, and by its secret where there is one."""
        if request.client is None or request.client.host not in self._settings.proxies:
            return False
        secret = self._settings.proxy_secret.encode()
        given = request.headers.get(PROXY_HEADER, "").encode(), _basic_password(request.headers.get("authorization", ""), len(secret))
        if not secret or sum(secrets.compare_digest(each, secret) for each in given) > 0:
            return True
        if self._names(request) and time.monotonic() - self._told_at > TELL_AGAIN_S:
            self._told_at = time.monotonic()
            log.warning("screen: %s names a person and does not send the proxy_secret; it is not believed", request.client.host)
        return False

    @staticmethod
    def _names(request: Request) -> list[str]:
        """What a proxy calls whoever sends this; nothing where it says one of them twice: the browser may have sent the other."""
        said = [_lines(request, f"x-forwarded-{kind}") for kind in ("preferred-username", "email", "user")]
        return [] if any(len(lines) > 1 for lines in said) else [line for lines in said for line in lines if line]

    @property
    def unknown(self) -> str:
        """What somebody is told who is not known."""
        return "sign in first" if self.has_tokens else "the proxy names nobody who may look: proxy_roles and proxy_role say who may"

    def _of_proxy(self, request: Request) -> Person | None:
        """Whom the proxy names, as oauth2-proxy does with --pass-user-headers or --set-xauthrequest."""
        lines = _lines(request, "x-forwarded-groups")  # a line a group, or all in one
        groups = [each.strip() for line in lines for each in line.split(",") if each.strip()]
        return person_of_proxy(self._names(request), groups, self._roles, self._everybody)

    def sign_in(self, token: str, request: Request, response: Response) -> bool:
        """Begin the session of whoever has this token; False where nobody has it."""
        self._read_users()
        user = user_of(token, self._users)
        if user is None:
            self.audit(f"nobody ({self._address(request)})", "sign in", None, "refused: a token that nobody has")
            return False
        self._sessions.open(request, response, f"{user.name}:{user.digest}")  # it ends with this token, not only with the name
        self.audit(user.name, "sign in", None, "by token")
        return True

    def wrong_token(self, request: Request, token: str) -> None:
        """Note that a request came with a token that nobody has."""
        given, now = digest(token), time.monotonic()
        if now - self._wrong.get(given, -SAME_TOKEN_S) < SAME_TOKEN_S:
            return
        while len(self._wrong) >= MOST_WRONG:
            self._wrong.pop(next(iter(self._wrong)), None)
        self._wrong[given] = now
        self.audit(f"nobody ({self._address(request)})", "sign in", None, "refused: a token that nobody has")

    def may(self, request: Request, role: Role) -> bool:
        """Whether whoever sends this has at least this role, at every site."""
        person = self.person(request)
        return person is not None and person.role >= role

    def refused(self, request: Request, act: str, robot: str | None, why: str) -> None:
        """Note a refusal."""
        person = self.person(request)
        who = f"nobody ({self._address(request)})" if person is None else person.name
        self.audit(who, printable(act)[:LONGEST_ACT], robot, f"refused: {why}")

    # --- as the PageAccess of one arm's page

    def signed_in(self, request: Request) -> bool:
        """Whether the request may see the page."""
        return self.may(request, Role.look)

    def token_matches(self, given: str) -> bool:  # noqa: ARG002 - of PageAccess
        """No: people sign in at the plant's screen, and not at an arm's page."""
        return False

    def open_session(self, request: Request, response: Response) -> None:  # noqa: ARG002 - of PageAccess
        """Not here."""
        raise BadInput("sign in at the plant's screen")

    def refusal(self, request: Request, command: str) -> str | None:
        """Why whoever sent the request may not send this command; it is noted in the audit. None: he may."""
        needed = NEEDED.get(command)
        if needed is None:
            why = "this is done at the arm itself, by its own page or joint-monitor allow"
            self.refused(request, command, robot_of(request), why)
            return why
        return self.lacks(request, needed, command)

    def lacks(self, request: Request, needed: Role, act: str) -> str | None:
        """Why whoever sent the request has not this role where the request's arm is; it is noted in the audit. None: he has it."""
        person, robot = self.person(request), robot_of(request)
        site = None if robot is None else robot.partition("/")[0]
        if person is None:
            why = "sign in first"
        elif person.at(site) < needed:
            where = f" at {site}" if site is not None and person.sites else ""
            why = f"{person.name} may {person.at(site).name}{where}; this needs the role {needed.name}"
        else:
            return None
        self.refused(request, act, robot, why)
        return why

    def note(self, request: Request, command: str, why: str) -> None:
        """Note that a command was refused before anybody asked who sent it."""
        self.refused(request, command, robot_of(request), why)

    def signed(self, request: Request, document: dict[str, Any]) -> dict[str, Any]:
        """The command in the name of whoever sent it, where he is known; what he typed as his name does not count then."""
        person = self.person(request)
        return document if person is None or person is HERE else {**document, "by": person.name}

    def _read_users(self, *, begins: bool = False) -> None:
        """Read the file again where it has changed: who was taken out is out at once. A file that cannot be read lets nobody in."""
        if self._file is None:
            return
        try:
            stat = os.stat(self._file)
            if self._users_of == (stat.st_mtime_ns, stat.st_size):
                return
            self._users = read_users(self._file.read_text("utf-8"), str(self._file))
            self._users_of = (stat.st_mtime_ns, stat.st_size)
        except (OSError, UnicodeDecodeError, BadInput) as error:
            why = f"users_file {self._file}: cannot be read: {error.strerror}" if isinstance(error, OSError) else str(error)
            if begins:
                raise BadInput(f"screen: {why}") from None
            if self._users:
                log.error("trouble=users: %s; nobody is let in by a token", why, extra={"trouble": "users"})
            self._users, self._users_of = {}, None

    @staticmethod
    def _address(request: Request) -> str:
        return request.client.host if request.client else "?"


def _basic_password(header: str, length: int) -> bytes:
    """The password of `Authorization: Basic`, as oauth2-proxy sends it with --basic-auth-password; empty where there is none.

    length : of the password that is expected. The name before it may hold colons, as Keycloak's names of people of an LDAP do.
    """
    scheme, _, encoded = header.partition(" ")
    if scheme.lower() != "basic":
        return b""
    try:
        given = base64.b64decode(encoded, validate=True)
    except ValueError:
        return b""
    name, colon, password = given[: -length - 1], given[-length - 1 : -length], given[-length:]
    return password if name and colon == b":" else b""


def _lines(request: Request, name: str) -> list[str]:
    """The lines of a header, in UTF-8 where they are: a name may hold any letter."""
    found = []
    for line in request.headers.getlist(name):
        with suppress(UnicodeError):
            line = line.encode("latin-1").decode()  # noqa: PLW2901 - as it was sent
        found.append(line.strip())
    return found


def bearer(request: Request) -> str | None:
    """The token of `Authorization: Bearer`; None where there is none."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None


def robot_of(request: Request) -> str | None:
    """SITE/ROBOT of an arm's page, or of the interface, by the address that was routed; None elsewhere, and where no arm is named."""
    parts = str(request.scope["path"]).removeprefix(INTERFACE).split("/")
    if len(parts) <= 4 or parts[1] != "arms":
        return None
    try:
        prefix(parts[2], parts[3])
    except BadInput:
        return None
    return f"{parts[2]}/{parts[3]}"
