"""The page's addresses: its files, its documents, the stream of what is new, sign-in, and commands.

Live values go out as server-sent events. Each browser receives the newest value of every key at its own pace, never a backlog. Commands go
the same way as `cmd/*` on the bus.
"""

import asyncio
import json
import math
import os
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from monitor.errors import BadInput, StoreError
from monitor.views.language.catalogue import Language
from monitor.views.web.access import PageAccess
from monitor.views.web.page_content import PageContent
from monitor.views.web.worded import Told, Worded, with_headers

STATIC = {
    "page.css": "text/css",
    "page.js": "text/javascript",
    "arm.js": "text/javascript",
    "charts.js": "text/javascript",
    "elements.js": "text/javascript",
    "alerts.js": "text/javascript",
    "controls.js": "text/javascript",
    "inspection.js": "text/javascript",
    "uPlot.iife.min.js": "text/javascript",
    "uPlot.min.css": "text/css",
    "uPlot.LICENSE.txt": "text/plain",
    "icon.svg": "image/svg+xml",
}
COMMANDS = ("ack", "unack", "shelve", "unshelve", "serviced", "unserviced", "inspected", "uninspected", "replay", "allow")
STREAM_PERIOD_S = 0.2  # how often a stream looks for new values: as often as live torque is published by default
CLOCK_PERIOD_S = 5.0  # between two times in a stream: a page that misses them knows that it is cut off, and a proxy keeps the stream open
MAX_STREAMS = 32  # browsers at once; each costs a task and a copy of what was sent to it
MAX_BODY_BYTES = 20_000  # of a command; a long reason has some hundred bytes
BODY_TIMEOUT_S = 10.0  # for the body of a command to arrive
WRONG_TOKEN_DELAY_S = 1.0  # before a wrong token is refused: guessing gets slow

# the report has its style and its drawings in itself, and nothing that runs
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"

Endpoint = Callable[[Request], Awaitable[Response]]


class PageApp:
    """The routes. `starlette` is the application; once `closing` is set, all streams end."""

    def __init__(self, content: PageContent, access: PageAccess, base: str = "", closing: threading.Event | None = None) -> None:
        """A page with these routes.

        base : the path below which they are mounted, without a slash at its end. closing : of a server with several pages; None: its own.
        """
        self._content, self._access, self._base = content, access, base
        self._streams = 0
        # one at a time, and behind everything else: what it makes takes seconds of the processors that may be moving an arm
        self._maker = ThreadPoolExecutor(1, "page-maker", _step_back)
        self.closing = threading.Event() if closing is None else closing
        package = files("monitor.views.web").joinpath("static")
        static = {name: (package.joinpath(name).read_bytes(), kind) for name, kind in STATIC.items()}
        self._pages = Worded(static, content.language, base)
        self._index = package.joinpath("index.html").read_text("utf-8")
        self._login = package.joinpath("login.html").read_text("utf-8")
        self._told = Told(content)
        self.starlette = Starlette(
            routes=[
                Route("/", self._guarded(self._page)),
                Route("/static/{name}", self._pages.file),
                Route("/words/{code}.js", self._pages.words),
                Route("/login", self._sign_in, methods=["GET", "POST"]),
                Route("/api/about", self._guarded(self._about)),
                Route("/api/history", self._guarded(self._document_of(content.history))),
                Route("/api/schedule", self._guarded(self._document_of(content.schedule))),
                Route("/api/monitor", self._guarded(self._document_of(content.monitor))),
                Route("/report", self._guarded(self._report)),
                Route("/history.csv", self._guarded(self._history_table)),
                Route("/api/live", self._guarded(self._live)),
                Route("/api/cmd/{command}", self._guarded(self._command), methods=["POST"]),
            ]
        )

    def _guarded(self, endpoint: Endpoint) -> Endpoint:
        """The endpoint for those who may see the page; others get a refusal."""

        async def guarded(request: Request) -> Response:
            if not self._access.knows_host(request):
                return with_headers(Response("this name is not this page's", status_code=421))
            if not self._access.signed_in(request):
                if request.url.path == f"{self._base}/":
                    return with_headers(Response(self._pages.in_words(self._login, request), status_code=401, media_type="text/html"))
                return with_headers(JSONResponse({"error": "sign in first"}, status_code=401))
            return with_headers(await endpoint(request))

        return guarded

    async def _sign_in(self, request: Request) -> Response:
        if request.method != "POST":  # a wrong token leaves a person at this address, and a reload asks for it
            return with_headers(RedirectResponse(f"{self._base}/", status_code=303))
        body = await read_body(request)
        given = parse_qs((body or b"").decode("utf-8", "replace")).get("token", [""])[0].strip()
        if not (self._access.knows_host(request) and self._access.same_origin(request)):
            return with_headers(Response("not from here", status_code=403))
        if not self._access.token_matches(given):
            await asyncio.sleep(WRONG_TOKEN_DELAY_S)
            return with_headers(
                Response(self._pages.in_words(self._login, request).replace("hidden", "", 1), status_code=401, media_type="text/html")
            )
        response = RedirectResponse(f"{self._base}/", status_code=303)
        self._access.open_session(request, response)
        return with_headers(response)

    async def _page(self, request: Request) -> Response:
        return Response(self._pages.in_words(self._index, request).replace("%CSRF%", self._access.page_token), media_type="text/html")

    async def _report(self, request: Request) -> Response:
        """The report on the whole history, to be printed."""
        return await self._made(self._content.report, self._pages.language(request), media_type="text/html")

    async def _history_table(self, request: Request) -> Response:
        """Friction of every replay as CSV."""
        response = await self._made(self._content.table, self._pages.language(request), media_type="text/csv")
        response.headers["Content-Disposition"] = f'attachment; filename="{self._content.file_name}.csv"'
        return response

    async def _made(self, make: Callable[[str], str] | None, say: Language, media_type: str) -> Response:
        """What `make` makes, in a thread of its own."""
        if make is None:
            return Response("not offered here", status_code=404)
        try:
            text = await asyncio.get_running_loop().run_in_executor(self._maker, make, say.code)
        except (BadInput, StoreError) as error:
            return Response(say.say(error.reason), status_code=409, media_type="text/plain")
        response = Response(text, media_type=media_type)
        if media_type == "text/html":  # its drawings and its style stand in the page
            response.headers["Content-Security-Policy"] = REPORT_POLICY
        return response

    async def _about(self, request: Request) -> Response:
        return JSONResponse(self._pages.language(request).document(self._content.about))

    def _document_of(self, read: Callable[[], dict[str, Any]]) -> Endpoint:
        """An endpoint that answers with what `read` returns. It reads in a thread, so that SQL does not hold up the streams."""

        async def endpoint(request: Request) -> Response:
            say = self._pages.language(request)
            body = await asyncio.to_thread(lambda: _encoded(say.document(read())))
            return Response(body, media_type="application/json")

        return endpoint

    async def _live(self, request: Request) -> Response:
        if request.headers.get("sec-fetch-site") in {"cross-site", "same-site"}:  # it can read nothing, and would take somebody's place
            return JSONResponse({"error": "live values are for the page itself"}, status_code=403)
        if self._streams >= MAX_STREAMS:
            return JSONResponse({"error": f"{MAX_STREAMS} browsers are looking already"}, status_code=503)
        return StreamingResponse(
            self._events(request, self._pages.language(request)), media_type="text/event-stream", headers={"X-Accel-Buffering": "no"}
        )

    async def _events(self, request: Request, say: Language) -> AsyncIterator[bytes]:
        """Server-sent events: `value` for every key that has a new value, `time` every CLOCK_PERIOD_S.

        They end when the server closes, or whoever asked may no longer see the page.
        """
        self._streams += 1
        try:
            sent: dict[str, object] = {}
            clock_sent = -math.inf
            while not self.closing.is_set() and self._access.signed_in(request):
                last = self._content.bus.last_payloads()
                new = [(key, payload) for key, payload in last.items() if sent.get(key) is not payload]
                sent.update(new)
                new = await self._told.tell(new, last, say)
                events = []
                if time.monotonic() - clock_sent >= CLOCK_PERIOD_S:
                    clock_sent = time.monotonic()
                    events.append(f"event: time\ndata: {1000.0 * self._content.now():.0f}\n\n".encode())
                # a document is one line: JSON as the bus encodes it has no line break
                events += [b"event: value\ndata: " + json.dumps(key).encode() + b" " + payload + b"\n\n" for key, payload in new]
                if events:
                    yield b"".join(events)
                await asyncio.sleep(STREAM_PERIOD_S)
        finally:
            self._streams -= 1

    async def _command(self, request: Request) -> Response:
        """Answer like `cmd/*` on the bus; a command that does not come from our own page is refused."""
        command = request.path_params["command"]
        if command not in COMMANDS:
            return await self._refused(request, 404, f"no command {command!r}; known are {', '.join(COMMANDS)}")
        if not self._access.from_page(request):
            return await self._refused(request, 403, "commands come from the page itself; load it anew")
        if (why := await asyncio.to_thread(self._access.refusal, request, command)) is not None:
            return JSONResponse({"error": self._pages.language(request).say(why)}, status_code=403)
        if request.headers.get("content-type", "").partition(";")[0] != "application/json":
            return await self._refused(request, 415, "expected application/json")
        body = await read_body(request)
        if body is None:
            return await self._refused(request, 413, f"more than {MAX_BODY_BYTES} bytes, or slower than {BODY_TIMEOUT_S:g} s")
        try:
            document = json.loads(body, parse_constant=_no_figure)
            json.dumps(document, allow_nan=False)  # 1e999 is read as infinity, which would go on as null
        except (ValueError, RecursionError):
            return await self._refused(request, 400, "is no JSON")
        if not isinstance(document, dict):
            return await self._refused(request, 409, "expected a JSON object")
        try:
            answer = await asyncio.to_thread(self._content.act, command, self._access.signed(request, document))
        except BadInput as error:
            return JSONResponse({"error": self._pages.language(request).say(error.reason)}, status_code=409)
        return JSONResponse(self._pages.language(request).document(dict(answer)))

    async def _refused(self, request: Request, status: int, why: str) -> Response:
        """The answer to a command that is none, or comes from elsewhere; it is noted."""
        await asyncio.to_thread(self._access.note, request, request.path_params["command"], why)
        return JSONResponse({"error": self._pages.language(request).say(why)}, status_code=status)


def _no_figure(name: str) -> float:
    raise ValueError(f"{name} is no figure")


def _step_back() -> None:
    """Give this thread a low priority."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)  # Linux takes the number of a thread here


async def read_body(request: Request) -> bytes | None:
    """At most MAX_BODY_BYTES bytes; None where there are more, or they do not arrive within BODY_TIMEOUT_S."""
    body = b""
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            async for part in request.stream():
                body += part
                if len(body) > MAX_BODY_BYTES:
                    return None
    except TimeoutError:
        return None
    return body


def _encoded(document: dict[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()
