"""Who may use the page: names of the host, sessions after the token was entered, and proof that a command comes from the page itself."""

import secrets
import time

from starlette.requests import Request
from starlette.responses import Response

SESSION_S = 12 * 3600.0  # a working day and its evening; then the token is asked for again
MAX_SESSIONS = 1000  # the oldest is dropped for a further one, so that sign-ins cannot fill the memory


class Access:
    """Answers who may. Its memory of sessions ends with the process."""

    def __init__(self, token: str | None, cookie: str, hosts: frozenset[str] | None) -> None:
        """Take the token, None where everybody who reaches the page may use it; the cookie's name; and the Host headers that are accepted.

        hosts : None where any is accepted, as the page asks for a token.
        """
        self._token, self._cookie, self._hosts = token, cookie, hosts
        self._session_ends: dict[str, float] = {}  # monotonic, by session
        self.page_token = secrets.token_urlsafe(24)  # only a page that was served from here can read it

    def knows_host(self, request: Request) -> bool:
        """Whether the request names this page's host.

        A foreign site may make its own name resolve to this machine (DNS rebinding); the Host header shows it.
        """
        return self._hosts is None or request.headers.get("host", "") in self._hosts

    def same_origin(self, request: Request) -> bool:
        """Whether a page of this very host sent the request."""
        origin = request.headers.get("origin")
        return origin is not None and origin.partition("://")[2] == request.headers.get("host", "")

    def from_page(self, request: Request) -> bool:
        """Whether our own page sent the request: the same origin, and the token that only the page can read."""
        given = request.headers.get("x-page-token", "")
        return self.same_origin(request) and secrets.compare_digest(given.encode(), self.page_token.encode())

    def signed_in(self, request: Request) -> bool:
        """Whether the request may see the page: always without a token, else with the cookie of a session that has not ended."""
        if self._token is None:
            return True
        end = self._session_ends.get(request.cookies.get(self._cookie, ""))
        return end is not None and time.monotonic() < end

    def token_matches(self, given: str) -> bool:
        """Whether this is the token. The comparison takes the same time for every wrong one."""
        return self._token is not None and secrets.compare_digest(given.encode(), self._token.encode())

    def open_session(self, request: Request, response: Response) -> None:
        """Begin a session, and set its cookie in the response."""
        now = time.monotonic()
        self._session_ends = {session: end for session, end in self._session_ends.items() if end > now}
        while len(self._session_ends) >= MAX_SESSIONS:
            del self._session_ends[next(iter(self._session_ends))]
        session = secrets.token_urlsafe(32)
        self._session_ends[session] = now + SESSION_S
        secure = request.url.scheme == "https" or request.headers.get("x-forwarded-proto") == "https"
        response.set_cookie(self._cookie, session, max_age=int(SESSION_S), httponly=True, samesite="strict", secure=secure)


def local_hosts(host: str, port: int) -> frozenset[str]:
    """The Host headers by which a browser of this machine may call a page that asks for no token."""
    names = {host, "localhost", "127.0.0.1", "[::1]"}
    return frozenset(f"{f'[{name}]' if ':' in name and not name.startswith('[') else name}:{port}" for name in names)
