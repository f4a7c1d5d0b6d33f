"""A proxy between ur-rtde and a simulated controller that can cut one connection alone, by FIN or by RST, or hold everything back."""

import contextlib
import selectors
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

PORTS = {30004: "rtde", 30003: "script", 30002: "secondary", 30001: "primary", 29999: "dashboard"}
RECEIVE, CONTROL, SCRIPT, DASHBOARD, PRIMARY = "receive", "control", "script", "dashboard", "primary"
CONNECTIONS = (RECEIVE, CONTROL, SCRIPT, DASHBOARD, PRIMARY)
RESET_AT_CLOSE = struct.pack("ii", 1, 0)  # SO_LINGER: on, 0 s
SETUP_INPUTS = 73  # type of the packet by which an RTDE client claims inputs: it controls the arm


@dataclass(eq=False)
class Pair:
    """One connection: the client's end and the controller's."""

    service: str
    client: socket.socket
    server: socket.socket
    controls: bool = False
    open_ways: set[socket.socket] = field(default_factory=set)

    @property
    def name(self) -> str:
        return (CONTROL if self.controls else RECEIVE) if self.service == "rtde" else self.service


class CuttingProxy:
    """Forwards the ports of a controller. One thread of its own does everything but the cuts."""

    def __init__(self, address: str, controller: str) -> None:
        self._controller = controller
        self._pairs: list[Pair] = []
        self._lock = threading.Lock()
        self._selector = selectors.DefaultSelector()
        self._listening = []
        for port, service in PORTS.items():
            server = socket.create_server((address, port), backlog=8)
            server.setblocking(False)
            self._selector.register(server, selectors.EVENT_READ, service)
            self._listening.append(server)
        self._ends, self._held = False, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self, name: str, *, reset: bool) -> int:
        """Cut every connection of that name, or of `all`; returns how many there were."""
        with self._lock:
            hit = [pair for pair in self._pairs if name in (pair.name, "all")]
            for pair in hit:
                self._drop(pair, reset=reset)
        return len(hit)

    def hold(self) -> None:
        """The network is gone: nothing is forwarded and nobody is connected until `let_go`; what was sent meanwhile comes late."""
        self._held.set()

    def let_go(self) -> None:
        """The network is back."""
        self._held.clear()

    def close(self) -> None:
        self._ends = True
        self._thread.join(5.0)
        with self._lock:
            for pair in list(self._pairs):
                self._drop(pair, reset=False)
        for server in self._listening:
            server.close()
        self._selector.close()

    def _drop(self, pair: Pair, *, reset: bool) -> None:
        self._pairs.remove(pair)
        for end in (pair.client, pair.server):
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(end)
            if reset:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_CLOSE)
            else:  # a FIN, also where the other end has sent what nobody read
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _run(self) -> None:
        while not self._ends:
            if self._held.is_set():
                time.sleep(0.002)
                continue
            for key, _ in self._selector.select(0.05):
                with self._lock:
                    if self._held.is_set():
                        break
                    if isinstance(key.data, str):
                        self._accept(key.fileobj, key.data)
                    elif key.data in self._pairs:
                        self._forward(key.data, key.fileobj)

    def _accept(self, listening: socket.socket, service: str) -> None:
        client, _ = listening.accept()
        try:
            server = socket.create_connection((self._controller, listening.getsockname()[1]), timeout=1.0)
        except OSError:
            client.close()
            return
        pair = Pair(service, client, server, open_ways={client, server})
        for end in (client, server):
            end.setblocking(True)
            end.settimeout(0.2)
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._selector.register(end, selectors.EVENT_READ, pair)
        self._pairs.append(pair)

    def _forward(self, pair: Pair, end: socket.socket) -> None:
        other = pair.server if end is pair.client else pair.client
        try:
            data = end.recv(65536)
            if data:
                if end is pair.client and pair.service == "rtde" and data[2:3] == bytes([SETUP_INPUTS]):
                    pair.controls = True
                other.sendall(data)
                return
            # one way has ended: so it is for the other end, until both have
            self._selector.unregister(end)
            pair.open_ways.discard(end)
            other.shutdown(socket.SHUT_WR)
            if pair.open_ways:
                return
        except OSError:
            pass
        self._drop(pair, reset=False)


@contextmanager
def cutting_proxy(address: str, controller: str) -> Iterator[CuttingProxy]:
    """The proxy at that address, in front of a controller at another."""
    proxy = CuttingProxy(address, controller)
    try:
        yield proxy
    finally:
        proxy.close()
