"""The robot's own ports as asyncio protocols: RTDE, dashboard, state and scripts. Every buffer is bounded."""

import asyncio
import logging
import socket
import struct
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from monitor.simulate.controller.program.scripts import Framer
from monitor.simulate.faults import SERVICES, WireFaults
from monitor.simulate.wire import dashboard, primary
from monitor.simulate.wire.rtde import ProtocolError, RtdeSession, text_message

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

log = logging.getLogger(__name__)

BACKLOG_MAX_BYTES = 256 * 1024  # unread by the client: newer packets are skipped, as documented for the real controller
DEAF_AFTER_S = 10.0  # and a client that reads nothing for so long is dropped
CONNECTIONS_MAX = 64  # per service
SEND_BUFFER_BYTES = 64 * 1024  # of the kernel on the state ports: a client that never reads must not collect history
LATE_MAX = 2500  # packets held back at most: as long as `late` may ask for, at 500 Hz


class Ports:
    """All connections of one robot."""

    def __init__(self, controller: "Controller") -> None:
        self.controller = controller
        self.open: dict[str, set[Port]] = {service: set() for service in SERVICES}
        self.faults = WireFaults()
        self.shut_down: Callable[[], None] = lambda: None  # the whole simulator
        self._dice = np.random.default_rng(controller.settings.seed)
        self._held_until_s = 0.0
        self._state_every = max(1, round(primary.PERIOD_S / controller.tick_s))
        self._numbers = 0
        self.dead = False  # the controller is: who got through to it just before is reset

    def number(self) -> int:
        """A new connection's number."""
        self._numbers += 1
        return self._numbers

    @property
    def streaming(self) -> bool:
        """Whether clients only stream: some do over RTDE, and none is still introducing itself."""
        for port in self.open["rtde"]:
            if not port.started:
                return False
        return bool(self.open["rtde"])

    def publish(self, now_s: float) -> None:
        """Send what is due in this tick to everyone who reads."""
        controller, opened = self.controller, self.open
        tick = controller.ticks
        if opened["rtde"]:
            self._publish_rtde(tick, now_s)
        if opened["realtime"]:
            _to_all(opened["realtime"], controller.realtime)
        messages = controller.messages
        while messages:
            message = messages.popleft()
            _to_all(opened["primary"], lambda message=message: message)  # type: ignore[misc]
        if tick % self._state_every == 0 and (opened["primary"] or opened["secondary"]):
            state = primary.state(controller)
            _to_all(opened["primary"] | opened["secondary"], lambda: state)

    def _publish_rtde(self, tick: int, now_s: float) -> None:
        faults = self.faults
        if now_s < faults.muted_until_s or (faults.skip_share and self._dice.random() < faults.skip_share):
            return
        if self._held_until_s and now_s >= self._held_until_s:
            self._held_until_s = 0.0  # what was held back goes now, before more is
        elif faults.late_share and not self._held_until_s and self._dice.random() < faults.late_share:
            self._held_until_s = now_s + faults.late_s
        hold = now_s < self._held_until_s
        made: dict[tuple[str, ...], bytes] = {}
        for port in tuple(self.open["rtde"]):
            port.publish(tick, now_s, made, hold=hold)

    def drop(self, service: str, *, reset: bool) -> int:
        """Close the connections of one service or of `all`, with FIN or RST; how many there were."""
        dropped = [port for name, ports in self.open.items() if service in (name, "all") for port in ports]
        for port in dropped:
            port.drop(reset=reset)
        return len(dropped)


class Port(asyncio.Protocol):
    """One connection to one service."""

    service = ""
    backlog_bytes = BACKLOG_MAX_BYTES

    def __init__(self, ports: Ports, service: str | None = None) -> None:
        self.ports = ports
        self.service = service or self.service
        self.transport: asyncio.Transport | None = None
        self.full = False  # more waits to be read than may
        self.started = False  # RTDE's data flow
        self.skipped = 0  # packets

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept, unless there are too many."""
        assert isinstance(transport, asyncio.Transport)
        mine = self.ports.open[self.service]
        if len(mine) >= CONNECTIONS_MAX or self.ports.dead:
            transport.abort()
            return
        wire = transport.get_extra_info("socket")
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        transport.set_write_buffer_limits(self.backlog_bytes, self.backlog_bytes)
        self.transport = transport
        mine.add(self)
        self.accepted(transport)

    def accepted(self, transport: asyncio.Transport) -> None:
        """The connection is there."""

    def pause_writing(self) -> None:
        """More waits to be read than may: asyncio's call."""
        self.full = True

    def resume_writing(self) -> None:
        """The client has read."""
        self.full = False

    def publish(self, tick: int, now_s: float, made: dict[tuple[str, ...], bytes], *, hold: bool) -> None:
        """What is due in this tick: RTDE's data."""

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Forget it; RST is as normal an end as FIN."""
        self.ports.open[self.service].discard(self)

    def drop(self, *, reset: bool) -> None:
        """Close from this side."""
        if self.transport is None:
            return
        if reset:
            wire = self.transport.get_extra_info("socket")
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.transport.abort()
        else:
            self.transport.close()

    @property
    def writable(self) -> "asyncio.Transport | None":
        """The transport, if it is still open."""
        return None if self.transport is None or self.transport.is_closing() else self.transport


class RtdePort(Port):
    """One RTDE connection."""

    service = "rtde"

    def __init__(self, ports: Ports) -> None:
        super().__init__(ports)
        self._session = RtdeSession(ports.controller, ports.number())
        self._deaf_since_s: float | None = None
        self._held: deque[bytes] = deque(maxlen=LATE_MAX)

    def accepted(self, transport: asyncio.Transport) -> None:
        """Nothing is said first, unless a fault wants it."""
        self._wire = transport.get_extra_info("socket")
        if self.ports.faults.text_at_connect:
            transport.write(text_message("Safety setup has not been confirmed yet", "SafetySetup", 2))

    def data_received(self, data: bytes) -> None:
        """Requests and inputs."""
        transport = self.writable
        if transport is None:
            return
        # acknowledge at once: ur-rtde's small writes wait for it (its TCP_NODELAY is lost), and would come in bunches; not lasting
        self._wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        if self.ports.faults.mute:
            return
        try:
            replies = self._session.feed(data)
        except ProtocolError as wrong:
            log.warning("rtde connection closed: %s", wrong)
            transport.abort()
            return
        if replies:
            self.started = self._session.started
            transport.write(replies)
            if self.full:
                transport.abort()  # asks and never reads

    def publish(self, tick: int, now_s: float, made: dict[tuple[str, ...], bytes], *, hold: bool) -> None:
        """The data packet of this tick, or none while the client does not read."""
        transport = self.transport
        if transport is None or transport.is_closing():
            return
        if self.full:
            self.skipped += 1
            self._deaf_since_s = self._deaf_since_s or now_s
            if now_s - self._deaf_since_s > DEAF_AFTER_S:
                log.warning("rtde connection closed: it has not read for %g s", DEAF_AFTER_S)
                transport.abort()
            return
        self._deaf_since_s = None
        packet = self._session.output(tick, made)
        if hold:
            if packet is not None:
                self._held.append(packet)
            return
        if self._held:
            packet = b"".join(self._held) + (packet or b"")
            self._held.clear()
        if packet is not None:
            transport.write(packet)

    def connection_lost(self, exc: Exception | None) -> None:
        """Inputs become free."""
        self._session.close()
        super().connection_lost(exc)


class DashboardPort(Port):
    """One dashboard connection."""

    service = "dashboard"

    def __init__(self, ports: Ports) -> None:
        super().__init__(ports)
        self._buffer = b""

    def accepted(self, transport: asyncio.Transport) -> None:
        """Greet."""
        transport.write(dashboard.GREETING.encode() + b"\n")

    def data_received(self, data: bytes) -> None:
        """One reply a line."""
        transport = self.writable
        if transport is None or self.ports.faults.mute:
            return
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            if transport.is_closing():
                return
            answer = dashboard.reply(self.ports.controller, line[: dashboard.LINE_MAX_BYTES].decode("utf-8", "replace"))
            transport.write(answer.encode() + b"\n")
            if answer in (dashboard.QUIT, dashboard.SHUTDOWN):
                transport.close()
                if answer == dashboard.SHUTDOWN:
                    self.ports.shut_down()
                return
        if len(self._buffer) > dashboard.LINE_MAX_BYTES or self.full:
            transport.abort()


class StatePort(Port):
    """One connection to 30001, 30002 or 30003: state goes out and is never queued, scripts may come in."""

    backlog_bytes = 0

    def __init__(self, ports: Ports, service: str) -> None:
        super().__init__(ports, service)
        self._framer = Framer()

    def accepted(self, transport: asyncio.Transport) -> None:
        """The version first, except on the real-time port."""
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        if self.service != "realtime":
            transport.write(primary.version(self.ports.controller))

    def data_received(self, data: bytes) -> None:
        """Run what is complete."""
        for text in self._framer.feed(data):
            self.ports.controller.run_script(text)


def _to_all(ports: set[Port], packet: Callable[[], bytes]) -> None:
    """Built only where somebody reads: ur-rtde's control client never does."""
    made: bytes | None = None
    for port in tuple(ports):
        transport = port.transport
        if port.full or transport is None or transport.is_closing():
            port.skipped += 1
            continue
        made = packet() if made is None else made
        transport.write(made)
