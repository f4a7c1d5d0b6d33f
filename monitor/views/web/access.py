"""Who may use the page: names of the host, sessions after the token was entered, and proof that a command comes from the page itself."""

import secrets
import threading
import time
from typing import Any, Protocol

from starlette.requests import Request
from starlette.responses import Response

SESSION_S = 12 * 3600.0  # a working day and its evening; then the token is asked for again
MAX_SESSIONS = 1000  # the oldest is dropped for a further one, so that sign-ins cannot fill the memory


class PageAccess(Protocol):
    """Who may use a page, and for what."""

    page_token: str

    def knows_host(self, request: Request) -> bool:
        """Whether the request names this page's host."""

    def same_origin(self, request: Request) -> bool:
        """Whether a page of this very host sent the request."""

    def from_page(self, request: Request) -> bool:
        """Whether our own page sent the request."""

    def signed_in(self, request: Request) -> bool:
        """Whether the request may see the page."""

    def token_matches(self, given: str) -> bool:
        """Whether this is the token."""

    def open_session(self, request: Request, response: Response) -> None:
        """Begin a session, and set its cookie in the response."""

    def refusal(self, request: Request, command: str) -> str | None:
        """Why whoever sent the request may not send this command; None: he may."""

    def note(self, request: Request, command: str, why: str) -> None:
        """Note that a command was refused before anybody asked who sent it."""

    def signed(self, request: Request, document: dict[str, Any]) -> dict[str, Any]:
        """The command with the name of whoever sent it, where that is known."""


class Sessions:
    """Who has signed in. The memory of it ends with the process."""

    def __init__(self, cookie: str) -> None:
        """Begin without anybody. cookie : the name of the session's cookie."""
        self._cookie = cookie
        self._open: dict[str, tuple[float, str]] = {}  # by session: its end (monotonic), and whose it is
        self._opening = threading.Lock()  # two people may sign in at once, each in a thread

    def of(self, request: Request) -> str | None:
        """Whose session the request belongs to; None where it has none that has not ended."""
        end, name = self._open.get(request.cookies.get(self._cookie, ""), (0.0, ""))
        return name if time.monotonic() < end else None

    def open(self, request: Request, response: Response, name: str) -> None:
        """Begin a session, and set its cookie in the response."""
        now = time.monotonic()
        session = secrets.token_urlsafe(32)
        with self._opening:
            self._open = {session: kept for session, kept in self._open.items() if kept[0] > now}
            while len(self._open) >= MAX_SESSIONS:
                del self._open[next(iter(self._open))]
            self._open[session] = (now + SESSION_S, name)
        secure = request.url.scheme == "https" or request.headers.get("x-forwarded-proto") == "https"
        response.set_cookie(self._cookie, session, max_age=int(SESSION_S), httponly=True, samesite="strict", secure=secure)


class OwnPages:
    """Tells a request of a page that was served from here from others."""

    def __init__(self, hosts: frozenset[str] | None) -> None:
        """Hosts : the Host headers that are accepted; None for any, where the page asks who one is."""
        self._hosts = hosts
        self.page_token = secrets.token_urlsafe(24)  # only a page that was served from here can read it

    def knows_host(self, request: Request) -> bool:
        """Whether the request names this page's host.

        A foreign site may make its own name resolve to this machine (DNS rebinding); the Host header shows it.
        """
        return self._hosts is None or request.headers.get("host", "") in self._hosts

    def same_origin(self, request: Request) -> bool:
        """Whether a page of this very host sent the request.

        A browser that says so itself is believed, as no page can make it say that: a proxy may have put another Host into the request.
        """
        if request.headers.get("sec-fetch-site") == "same-origin":
            return True
        origin = request.headers.get("origin")
        return origin is not None and origin.partition("://")[2] == request.headers.get("host", "")

    def from_page(self, request: Request) -> bool:
        """Whether our own page sent the request: the same origin, and the token that only the page can read."""
        given = request.headers.get("x-page-token", "")
        return self.same_origin(request) and secrets.compare_digest(given.encode(), self.page_token.encode())


class Access(OwnPages):
    """Answers who may. Its memory of sessions ends with the process."""

    def __init__(self, token: str | None, cookie: str, hosts: frozenset[str] | None) -> None:
        """Take the token, None where everybody who reaches the page may use it; the cookie's name; and the Host headers that are accepted.

        hosts : None where any is accepted, as the page asks for a token.
        """
        super().__init__(hosts)
        self._token, self._sessions = token, Sessions(cookie)

    def signed_in(self, request: Request) -> bool:
        """Whether the request may see the page: always without a token, else with the cookie of a session that has not ended."""
        return self._token is None or self._sessions.of(request) is not None

    def token_matches(self, given: str) -> bool:
        """Whether this is the token. The comparison takes the same time for every wrong one."""
        return self._token is not None and secrets.compare_digest(given.encode(), self._token.encode())

    def refusal(self, request: Request, command: str) -> str | None:  # noqa: ARG002 - of PageAccess
        """None: whoever sees this page may send every command."""
        return None

    def note(self, request: Request, command: str, why: str) -> None:
        """Nothing: this page keeps no audit."""

    def signed(self, request: Request, document: dict[str, Any]) -> dict[str, Any]:  # noqa: ARG002 - of PageAccess
        """As it is: a person says his name himself."""
        return document

    def open_session(self, request: Request, response: Response) -> None:
        """Begin a session, and set its cookie in the response."""
        self._sessions.open(request, response, "")


def local_hosts(host: str, port: int) -> frozenset[str]:
    """The Host headers by which a browser of this machine may call a page that asks for no token."""
    names = {host, "localhost", "127.0.0.1", "[::1]"}
    return frozenset(f"{f'[{name}]' if ':' in name and not name.startswith('[') else name}:{port}" for name in names)
