"""The robot's own ports as asyncio protocols: RTDE, dashboard, scripts. Every buffer is bounded."""

import asyncio
import logging
import socket
import struct
from typing import TYPE_CHECKING

from monitor.simulate import dashboard
from monitor.simulate.rtde import ProtocolError, RtdeSession
from monitor.simulate.scripts import Framer

if TYPE_CHECKING:
    from monitor.simulate.controller import Controller

log = logging.getLogger(__name__)

BACKLOG_MAX_BYTES = 256 * 1024  # unread by the client: newer packets are skipped, as documented for the real controller
DEAF_AFTER_S = 10.0  # and a client that reads nothing for so long is dropped
CONNECTIONS_MAX = 64  # per port


class Ports:
    """All connections of one robot."""

    def __init__(self, controller: "Controller") -> None:
        self.controller = controller
        self.rtde: set[RtdePort] = set()
        self.others: set[asyncio.Transport] = set()
        self.muted_until_s = 0.0  # loop time: no RTDE data packets before
        self._numbers = 0

    def number(self) -> int:
        """A new connection's number."""
        self._numbers += 1
        return self._numbers

    def publish(self, now_s: float) -> None:
        """Send what is due in this tick to everyone who reads."""
        if now_s < self.muted_until_s:
            return
        tick = self.controller.ticks
        for port in list(self.rtde):
            port.publish(tick, now_s)

    def drop_rtde(self, *, reset: bool) -> int:
        """Close the RTDE connections, with FIN or RST; how many there were."""
        dropped = list(self.rtde)
        for port in dropped:
            port.drop(reset=reset)
        return len(dropped)


class RtdePort(asyncio.Protocol):
    """One RTDE connection."""

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._session = RtdeSession(ports.controller, ports.number())
        self._transport: asyncio.Transport | None = None
        self._deaf_since_s: float | None = None
        self.skipped = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept, unless there are too many."""
        assert isinstance(transport, asyncio.Transport)
        if len(self._ports.rtde) >= CONNECTIONS_MAX:
            transport.abort()
            return
        _no_delay(transport)
        self._transport = transport
        self._ports.rtde.add(self)

    def data_received(self, data: bytes) -> None:
        """Requests and inputs."""
        if self._transport is None or self._transport.is_closing():
            return
        _acknowledge(self._transport)
        try:
            replies = self._session.feed(data)
        except ProtocolError as wrong:
            log.warning("rtde connection closed: %s", wrong)
            self._transport.abort()
            return
        if replies:
            self._transport.write(replies)
            if self._transport.get_write_buffer_size() > BACKLOG_MAX_BYTES:
                self._transport.abort()  # asks and never reads

    def publish(self, tick: int, now_s: float) -> None:
        """The data packet of this tick, or none while the client does not read."""
        if self._transport is None or self._transport.is_closing():
            return
        if self._transport.get_write_buffer_size() > BACKLOG_MAX_BYTES:
            self.skipped += 1
            self._deaf_since_s = self._deaf_since_s or now_s
            if now_s - self._deaf_since_s > DEAF_AFTER_S:
                log.warning("rtde connection closed: it has not read for %g s", DEAF_AFTER_S)
                self._transport.abort()
            return
        self._deaf_since_s = None
        packet = self._session.output(tick)
        if packet is not None:
            self._transport.write(packet)

    def drop(self, *, reset: bool) -> None:
        """Close from this side."""
        if self._transport is None:
            return
        if reset:
            wire = self._transport.get_extra_info("socket")
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._transport.abort()
        else:
            self._transport.close()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Inputs become free; RST is as normal an end as FIN."""
        self._session.close()
        self._ports.rtde.discard(self)


class DashboardPort(asyncio.Protocol):
    """One dashboard connection."""

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._buffer = b""
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        self._transport = _accept(self._ports, transport)
        if self._transport is not None:
            self._transport.write(dashboard.GREETING.encode() + b"\n")

    def data_received(self, data: bytes) -> None:
        """One reply a line."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            answer = dashboard.reply(self._ports.controller, line[: dashboard.LINE_MAX_BYTES].decode("utf-8", "replace"))
            transport.write(answer.encode() + b"\n")
            if answer == "Disconnected":
                transport.close()
                return
        if len(self._buffer) > dashboard.LINE_MAX_BYTES or transport.get_write_buffer_size() > BACKLOG_MAX_BYTES:
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Forget it."""
        if self._transport is not None:
            self._ports.others.discard(self._transport)


class ScriptPort(asyncio.Protocol):
    """One connection that may write scripts; nothing is streamed to it, ur-rtde never reads there."""

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._framer = Framer()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept, unless there are too many."""
        self._transport = _accept(self._ports, transport)

    def data_received(self, data: bytes) -> None:
        """Run what is complete."""
        for text in self._framer.feed(data):
            self._ports.controller.run_script(text)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Forget it: the program goes on."""
        if self._transport is not None:
            self._ports.others.discard(self._transport)


def _accept(ports: Ports, transport: asyncio.BaseTransport) -> asyncio.Transport | None:
    assert isinstance(transport, asyncio.Transport)
    if len(ports.others) >= CONNECTIONS_MAX:
        transport.abort()
        return None
    _no_delay(transport)
    ports.others.add(transport)
    return transport


def _acknowledge(transport: asyncio.Transport) -> None:
    """At once: ur-rtde's small writes wait for it (its TCP_NODELAY is lost), and would come in bunches. Not lasting: ask each time."""
    wire = transport.get_extra_info("socket")
    if wire is not None:
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)


def _no_delay(transport: asyncio.Transport) -> None:
    wire = transport.get_extra_info("socket")
    if wire is not None:
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
