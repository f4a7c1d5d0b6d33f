"""The status page over HTTP: a thread and an event loop of its own, so that a slow or hostile browser harms nobody.

What is live comes as server-sent events: each browser is told the newest of every key at its own pace, never a backlog. Commands go
through the same code as `cmd/*` on the bus. They need a page of ours: the right Host, the right Origin, and a token that only a page
served from here can read.
"""

import asyncio
import json
import logging
import math
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from monitor.errors import BadInput, BusError
from monitor.views.web.content import Content
from monitor.views.web.settings import PageSettings

log = logging.getLogger(__name__)

STATIC = {
    "page.css": "text/css",
    "page.js": "text/javascript",
    "arm.js": "text/javascript",
    "charts.js": "text/javascript",
    "uPlot.iife.min.js": "text/javascript",
    "uPlot.min.css": "text/css",
    "uPlot.LICENSE.txt": "text/plain",
    "icon.svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
COMMANDS = ("ack", "shelve", "replay")
LOOK_S = 0.2  # how often a stream looks for something newer
SAYS_TIME_S = 5.0  # the monitor's clock: a page that misses it knows that it is cut off, and a proxy that the stream is alive
MOST_STREAMS = 32
LARGEST_COMMAND = 20_000  # bytes
SESSION_S = 12 * 3600.0
MOST_SESSIONS = 1000
PATIENCE_S = 1.0  # before a wrong token is refused
IDLE_S = 10.0  # a connection that asks nothing for so long twice is closed; a command's body takes no longer
COOKIE = "joint-monitor-{port}"  # a browser gives a host's cookies to all its ports: each monitor of a machine has its own


class PageServer:
    """Serves until it is left. A context manager; `url` says where."""

    def __init__(self, settings: PageSettings, content: Content, token: str | None = None) -> None:
        """Raises BusError where the address is taken."""
        host, port = settings.address()
        try:
            self._socket = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=64)
        except OSError as error:
            raise BusError(f"page: cannot listen on {settings.listen}: {error.strerror}") from None
        # asyncio does so only for sockets whose protocol it is told; without it every answer waits 40 ms for an acknowledgement
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        port = int(self._socket.getsockname()[1])
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        self._app = _App(content, token, COOKIE.format(port=port), hosts=_hosts(host, port) if token is None else None)
        config = uvicorn.Config(
            self._app.starlette,
            log_config=None,
            access_log=False,
            server_header=False,
            lifespan="off",
            http=_Impatient,
            limit_concurrency=200,
            timeout_keep_alive=20,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16_384,
        )
        # what strangers send must not fill the journal
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        log.info("page on %s%s", self.url, " (asks for a token)" if token else "")

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._socket])
        except Exception:  # the page may die, the monitor goes on
            log.exception("page: the server ended")

    def __enter__(self) -> "PageServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._app.closing.set()
        self._server.should_exit = True
        self._thread.join(timeout=5.0)
        self._socket.close()


class _Impatient(H11Protocol):
    """HTTP for a page that others share: uvicorn itself waits for ever for a request that never comes, or never ends."""

    _idle = False

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.loop.call_later(IDLE_S, self._look)

    def _look(self) -> None:
        if self.transport.is_closing():
            return
        asks = self.cycle is not None and not self.cycle.response_complete
        if self._idle and not asks:
            self.transport.close()
            return
        self._idle = not asks
        self.loop.call_later(IDLE_S, self._look)


def _hosts(host: str, port: int) -> frozenset[str]:
    """Names by which a browser of this machine may call a page without a token: any other is somebody else's name for it."""
    names = {host, "localhost", "127.0.0.1", "[::1]"}
    return frozenset(f"{f'[{name}]' if ':' in name and not name.startswith('[') else name}:{port}" for name in names)


class _App:
    """Routes, and who may use them."""

    def __init__(self, content: Content, token: str | None, cookie: str, hosts: frozenset[str] | None) -> None:
        self._content, self._token, self._cookie, self._hosts = content, token, cookie, hosts
        self._csrf = secrets.token_urlsafe(24)
        self._sessions: dict[str, float] = {}
        self._streams = 0
        self.closing = threading.Event()
        package = files("monitor.views.web").joinpath("static")
        self._static = {name: package.joinpath(name).read_bytes() for name in STATIC}
        self._index = package.joinpath("index.html").read_text("utf-8")
        self._login = package.joinpath("login.html").read_text("utf-8")
        routes = [
            Route("/", self._guarded(self._page)),
            Route("/static/{name}", self._file),
            Route("/login", self._enter, methods=["GET", "POST"]),
            Route("/api/about", self._guarded(self._about)),
            Route("/api/history", self._guarded(self._read(content.history))),
            Route("/api/schedule", self._guarded(self._read(content.schedule))),
            Route("/api/monitor", self._guarded(self._read(content.monitor))),
            Route("/api/live", self._guarded(self._live)),
            Route("/api/cmd/{command}", self._guarded(self._command), methods=["POST"]),
        ]
        self.starlette = Starlette(routes=routes)

    # --- who may ---------------------------------------------------------------------------------

    def _guarded(self, answer: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
        async def guarded(request: Request) -> Response:
            if not self._host_is_ours(request):
                return _finished(Response("this name is not this page's", status_code=421))
            if self._token is not None and not self._known(request.cookies.get(self._cookie, "")):
                if request.url.path == "/":
                    return _finished(Response(self._login, status_code=401, media_type="text/html"))
                return _finished(JSONResponse({"error": "sign in first"}, status_code=401))
            return _finished(await answer(request))

        return guarded

    def _host_is_ours(self, request: Request) -> bool:
        # a page elsewhere may make its own name resolve to this machine; its Host gives it away
        return self._hosts is None or request.headers.get("host", "") in self._hosts

    def _same_origin(self, request: Request) -> bool:
        origin = request.headers.get("origin")
        return origin is not None and origin.partition("://")[2] == request.headers.get("host", "")

    def _known(self, session: str) -> bool:
        until = self._sessions.get(session)
        return until is not None and time.monotonic() < until

    async def _enter(self, request: Request) -> Response:
        if request.method != "POST":  # somebody typed the address that a wrong token had left him at
            return _finished(RedirectResponse("/", status_code=303))
        body = await _body(request)
        given = parse_qs((body or b"").decode("utf-8", "replace")).get("token", [""])[0].strip()
        if not (self._host_is_ours(request) and self._same_origin(request)):
            return _finished(Response("not from here", status_code=403))
        if self._token is None or not secrets.compare_digest(given.encode(), self._token.encode()):
            await asyncio.sleep(PATIENCE_S)
            return _finished(Response(self._login.replace("hidden", "", 1), status_code=401, media_type="text/html"))
        now = time.monotonic()
        self._sessions = {key: until for key, until in self._sessions.items() if until > now}
        while len(self._sessions) >= MOST_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        session = secrets.token_urlsafe(32)
        self._sessions[session] = now + SESSION_S
        response = RedirectResponse("/", status_code=303)
        secure = request.url.scheme == "https" or request.headers.get("x-forwarded-proto") == "https"
        response.set_cookie(self._cookie, session, max_age=int(SESSION_S), httponly=True, samesite="strict", secure=secure)
        return _finished(response)

    # --- what is shown ---------------------------------------------------------------------------

    async def _page(self, _: Request) -> Response:
        return Response(self._index.replace("%CSRF%", self._csrf), media_type="text/html")

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self._static:
            return _finished(Response("not found", status_code=404))
        response = _finished(Response(self._static[name], media_type=STATIC[name]))
        response.headers["Cache-Control"] = "no-cache"
        return response

    async def _about(self, _: Request) -> Response:
        return JSONResponse(self._content.about)

    def _read(self, what: Callable[[], dict[str, Any]]) -> Callable[[Request], Awaitable[Response]]:
        async def read(_: Request) -> Response:
            # SQL in a thread: the loop goes on telling others what is new
            document = await asyncio.to_thread(what)
            return Response(await asyncio.to_thread(_encoded, document), media_type="application/json")

        return read

    async def _live(self, _: Request) -> Response:
        if self._streams >= MOST_STREAMS:
            return JSONResponse({"error": f"{MOST_STREAMS} browsers are looking already"}, status_code=503)
        return StreamingResponse(self._newest(), media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})

    async def _newest(self) -> AsyncIterator[bytes]:
        self._streams += 1
        try:
            told: dict[str, bytes] = {}
            said = -math.inf
            while not self.closing.is_set():
                last = self._content.bus.last_payloads()
                new = [(key, payload) for key, payload in last.items() if told.get(key) is not payload]
                told.update(new)
                lines = []
                if time.monotonic() - said >= SAYS_TIME_S:
                    said = time.monotonic()
                    lines.append(f"event: time\ndata: {1000.0 * self._content.now():.0f}\n\n".encode())
                # JSON as the bus encodes it holds no line break, so a document is one line
                lines += [b"event: value\ndata: " + json.dumps(key).encode() + b" " + payload + b"\n\n" for key, payload in new]
                if lines:
                    yield b"".join(lines)
                await asyncio.sleep(LOOK_S)
        finally:
            self._streams -= 1

    # --- what is done ----------------------------------------------------------------------------

    async def _command(self, request: Request) -> Response:
        command = request.path_params["command"]
        if command not in COMMANDS:
            return JSONResponse({"error": f"no command {command!r}; known are {', '.join(COMMANDS)}"}, status_code=404)
        given = request.headers.get("x-page-token", "")
        if not (self._same_origin(request) and secrets.compare_digest(given.encode(), self._csrf.encode())):
            return JSONResponse({"error": "commands come from the page itself; load it anew"}, status_code=403)
        if request.headers.get("content-type", "").partition(";")[0] != "application/json":
            return JSONResponse({"error": "expected application/json"}, status_code=415)
        body = await _body(request)
        if body is None:
            return JSONResponse({"error": f"more than {LARGEST_COMMAND} bytes, or slower than {IDLE_S:g} s"}, status_code=413)
        try:
            document = json.loads(body)
            if not isinstance(document, dict):
                raise BadInput("expected a JSON object")
            done = await asyncio.to_thread(self._content.bus.ask, f"cmd/{command}", document)
        except (ValueError, RecursionError):
            return JSONResponse({"error": "is no JSON"}, status_code=400)
        except BadInput as error:
            return JSONResponse({"error": str(error)}, status_code=409)
        return JSONResponse(done)


async def _body(request: Request) -> bytes | None:
    """At most LARGEST_COMMAND bytes; None where there are more, or they do not come."""
    body = b""
    try:
        async with asyncio.timeout(IDLE_S):
            async for part in request.stream():
                body += part
                if len(body) > LARGEST_COMMAND:
                    return None
    except TimeoutError:
        return None
    return body


def _encoded(document: dict[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()


def _finished(response: Response) -> Response:
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    return response
