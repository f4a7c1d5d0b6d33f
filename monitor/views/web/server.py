"""The page's HTTP server: a thread with an event loop of its own, so that a slow or hostile browser cannot hold up the monitor."""

import logging
import socket
import threading
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from monitor.errors import BusError
from monitor.views.web.access import Access, local_hosts
from monitor.views.web.app import PageApp
from monitor.views.web.content import Content
from monitor.views.web.settings import PageSettings

log = logging.getLogger(__name__)

IDLE_S = 10.0  # a connection without a request is closed after one to two such times
MAX_CONNECTIONS = 200  # more are refused; a browser opens up to six
KEEP_ALIVE_S = 20  # after an answer, until the next request of the same connection
MAX_HEADER_BYTES = 16_384
BACKLOG = 64  # connections that wait to be accepted
STOP_S = 5.0  # how long the monitor waits for the server's thread
COOKIE = "joint-monitor-{port}"  # a browser sends a host's cookies to all of its ports, so each monitor of a machine has its own name


class PageServer:
    """A context manager; it serves until the context ends. `url` is the page's address."""

    def __init__(self, settings: PageSettings, content: Content, token: str | None = None) -> None:
        """Begin to serve. token : what a browser must enter; None serves everybody who reaches the page.

        Raises BusError where the address is taken.
        """
        host, port = settings.address()
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family, backlog=BACKLOG)
        except OSError as error:
            raise BusError(f"page: cannot listen on {settings.listen}: {error.strerror}") from None
        # asyncio sets it only for a socket that was made with IPPROTO_TCP; without it each answer waits 40 ms for an acknowledgement
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        port = int(self._socket.getsockname()[1])
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
        self._app = PageApp(content, Access(token, COOKIE.format(port=port), local_hosts(host, port) if token is None else None))
        config = uvicorn.Config(
            self._app.starlette,
            log_config=None,
            access_log=False,
            server_header=False,
            lifespan="off",
            http=_ClosesIdleConnections,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=MAX_HEADER_BYTES,
        )
        # invalid requests of strangers must not fill the journal
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        log.info("page on %s%s", self.url, " (asks for a token)" if token else "")

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._socket])
        except Exception:  # the monitor goes on without its page
            log.exception("page: the server ended")

    def __enter__(self) -> "PageServer":
        return self

    def __exit__(self, *_: object) -> None:
        self._app.closing.set()
        self._server.should_exit = True
        self._thread.join(timeout=STOP_S)
        self._socket.close()


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
