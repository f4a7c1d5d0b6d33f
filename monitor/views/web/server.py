"""The page's HTTP server: a thread with an event loop of its own, so that a slow or hostile browser cannot hold up the monitor."""

import logging
import socket
import threading
from typing import Any, Self

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from monitor.errors import cannot_listen
from monitor.views.web.access import Access, local_hosts
from monitor.views.web.app import PageApp
from monitor.views.web.page_content import PageContent
from monitor.views.web.settings import PageSettings

log = logging.getLogger(__name__)

IDLE_S = 10.0  # a connection without a request is closed after one to two such times
MAX_CONNECTIONS = 200  # more are refused; a browser opens up to six
KEEP_ALIVE_S = 20  # after an answer, until the next request of the same connection
MAX_HEADER_BYTES = 16_384
BACKLOG = 64  # connections that wait to be accepted
STOP_S = 5.0  # how long the monitor waits for the server's thread
COOKIE = "joint-monitor-{port}"  # a browser sends a host's cookies to all of its ports, so each monitor of a machine has its own name


class WebServer:
    """Serves one application in a thread of its own. A context manager; `serve` begins, the context's end ends it."""

    def __init__(self, listen: str, host: str, port: int, what: str) -> None:
        """Take the address. `listen` and `what` are named in messages. Raises as `cannot_listen`."""
        self._what = what
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family, backlog=BACKLOG)
        except OSError as error:
            raise cannot_listen(f"{what}: {listen}", error.errno, str(error.strerror)) from None
        # asyncio sets it only for a socket that was made with IPPROTO_TCP; without it each answer waits 40 ms for an acknowledgement
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.port = int(self._socket.getsockname()[1])
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        self._closing: threading.Event | None = None
        self._server: uvicorn.Server | None = None
        self._thread: threading.Thread | None = None

    def serve(self, application: ASGIApp, closing: threading.Event, remark: str = "") -> None:
        """Begin. `closing` is set when it ends, for the streams of the application."""
        config = uvicorn.Config(
            application,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,  # who asks is the other end of the connection; what a proxy says is judged where it is believed
            lifespan="off",
            ws="none",  # nothing here speaks it
            http=_ClosesIdleConnections,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=MAX_HEADER_BYTES,
        )
        # invalid requests of strangers must not fill the journal
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        self._closing = closing
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, args=(self._server,), name=self._what, daemon=True)
        self._thread.start()
        log.info("%s on %s%s", self._what, self.url, remark)

    def _run(self, server: uvicorn.Server) -> None:
        try:
            server.run(sockets=[self._socket])
        except Exception:  # the monitor goes on without its page
            log.exception("%s: the server ended", self._what)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._server is not None and self._closing is not None and self._thread is not None:
            self._closing.set()
            self._server.should_exit = True
            self._thread.join(timeout=STOP_S)
        self._socket.close()


class PageServer(WebServer):
    """The page of one arm. A context manager; it serves until the context ends. `url` is the page's address."""

    def __init__(self, settings: PageSettings, content: PageContent, token: str | None = None) -> None:
        """Begin to serve. token : what a browser must enter; None serves everybody who reaches the page.

        Raises as `cannot_listen`.
        """
        host, port = settings.address()
        super().__init__(settings.listen, host, port, "page")
        app = PageApp(content, Access(token, COOKIE.format(port=self.port), local_hosts(host, self.port) if token is None else None))
        self.serve(app.starlette, app.closing, " (asks for a token)" if token else "")


class _ClosesIdleConnections(H11Protocol):
    """HTTP that closes a connection without a request. uvicorn itself waits without limit for a request that never begins or never ends."""

    _idle = False  # at the last check

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.loop.call_later(IDLE_S, self._check)

    def _check(self) -> None:
        if self.transport.is_closing():
            return
        busy = self.cycle is not None and not self.cycle.response_complete
        if self._idle and not busy:
            self.transport.close()
            return
        self._idle = not busy
        self.loop.call_later(IDLE_S, self._check)
