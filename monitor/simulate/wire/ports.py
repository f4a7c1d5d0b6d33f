"""The robot's own ports as asyncio protocols: RTDE, dashboard, state and scripts. Every buffer has a limit."""

import asyncio
import itertools
import logging
import socket
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.simulate.controller.controller import Controller
from monitor.simulate.faults import CONNECTIONS_MAX, SERVICES
from monitor.simulate.machine.journal import SafetyMessage
from monitor.simulate.machine.state import Runtime
from monitor.simulate.program.scripts import Framer
from monitor.simulate.wire import dashboard, primary
from monitor.simulate.wire.external_control import requested
from monitor.simulate.wire.rtde import ProtocolError, RtdeSession, text_message
from monitor.simulate.wire.variables import output_variables

log = logging.getLogger(__name__)

BACKLOG_MAX_BYTES = 256 * 1024  # when a client has left so much unread, newer packets are skipped, as documented for a real controller
DEAF_AFTER_S = 10.0  # a client that reads nothing for so long is disconnected
SEND_BUFFER_BYTES = 64 * 1024  # the kernel's buffer of a state port: a client that does not read must not collect old states
LATE_MAX = 2500  # packets that the fault `late` holds back at most: 5 s at 500 Hz


@dataclass(slots=True)
class WireFaults:
    """The present faults of the wire."""

    muted_until_s: float = 0.0  # on the event loop's clock: before this time no RTDE data packets are sent
    mute: bool = False  # requests are read and not answered
    late_s: float = 0.0  # delay of a late packet
    late_share: float = 0.0  # this share of the packets is late, with all packets behind them
    skip_share: float = 0.0  # this share of the control periods is never sent
    robot_api: str = ""  # how the Robot API answers wrongly; empty: it answers
    text_at_connect: bool = False  # a new RTDE connection gets a text message first


class Ports:
    """All connections of one robot. `dead` tells that the controller was killed: connections are then refused."""

    def __init__(self, controller: Controller, shut_down: Callable[[], None]) -> None:
        """`shut_down` ends the whole simulator."""
        self.shut_down = shut_down
        self.open: dict[str, set[Port]] = {service: set() for service in SERVICES}
        self.faults = WireFaults()
        self._dice = np.random.default_rng(controller.settings.seed)
        self._delayed_until_s = 0.0
        self._state_every = max(1, round(primary.PERIOD_S / controller.clock.tick_s))
        self.numbers = itertools.count(1)  # of the connections, in the order in which they were accepted
        self.attach(controller)

    def attach(self, controller: Controller) -> None:
        """Serve this controller from now on."""
        self.controller, self.dead, self.silent = controller, False, False
        self._variables = output_variables(controller)
        self._local = controller.identity.local
        self._realtime = primary.realtime_packing(controller, self._variables, controller.settings.polyscope)

    def rtde_session(self) -> RtdeSession:
        """A session for a new RTDE connection."""
        return RtdeSession(self.controller, self._variables, next(self.numbers))

    @property
    def streaming(self) -> bool:
        """Whether there are RTDE clients and all of them have started their data packets."""
        for port in self.open["rtde"]:
            if not port.started:
                return False
        return bool(self.open["rtde"])

    @property
    def watched(self) -> bool:
        """Whether somebody receives states, or a program runs: then each control period has its own time."""
        opened = self.open
        clients = opened["rtde"] or opened["realtime"] or opened["primary"] or opened["secondary"]
        return bool(clients) or self.controller.programs.current is not None

    def publish(self, now_s: float) -> None:
        """Send what is due in this control period to all clients that read."""
        controller, opened = self.controller, self.open
        if controller.identity.local != self._local:
            self._local = controller.identity.local
            self.drop("dashboard", reset=False)  # the dashboard ends its connections when the control mode is switched
        tick = controller.clock.ticks
        if opened["rtde"]:
            self._publish_rtde(tick, now_s)
        if opened["realtime"]:
            _to_all(opened["realtime"], self._realtime)
        messages = controller.journal.messages
        # the state that a message about the safety mode speaks of comes before it: the manufacturer's client expects them to agree
        if tick % self._state_every == 0 or any(isinstance(message, SafetyMessage) for message in messages):
            self._publish_state(opened["primary"] | opened["secondary"])
        while messages:
            message = primary.encoded(messages.popleft())
            _to_all(opened["primary"], lambda message=message: message)  # type: ignore[misc]

    def _publish_state(self, readers: set["Port"]) -> None:
        fresh = {port for port in readers if not port.started}
        for some, first in ((fresh, True), (readers - fresh, False)):
            if some:
                state = primary.state(self.controller, first=first)
                _to_all(some, lambda state=state: state)  # type: ignore[misc]
        for port in fresh:
            port.started = not port.full

    def _publish_rtde(self, tick: int, now_s: float) -> None:
        faults = self.faults
        if now_s < faults.muted_until_s or (faults.skip_share and self._dice.random() < faults.skip_share):
            return
        if self._delayed_until_s and now_s >= self._delayed_until_s:
            self._delayed_until_s = 0.0  # the packets that were held back go out now, before others are held back
        elif faults.late_share and not self._delayed_until_s and self._dice.random() < faults.late_share:
            self._delayed_until_s = now_s + faults.late_s
        hold = now_s < self._delayed_until_s
        made: dict[tuple[str, ...], bytes] = {}
        for port in tuple(self.open["rtde"]):
            port.publish(tick, now_s, made, hold=hold)

    def in_order(self, service: str) -> "list[Port]":
        """The open connections of one service or of `all`, the oldest first."""
        return sorted(
            (port for name, ports in self.open.items() if service in (name, "all") for port in ports), key=lambda port: port.number
        )

    def connections(self) -> list[dict[str, Any]]:
        """The open connections, the oldest first: service, the client's port, and whether the client has claimed inputs."""
        return [{"service": port.service, "client_port": port.client_port, "controls": port.controls} for port in self.in_order("all")]

    def kill(self) -> None:
        """Reset all connections, and refuse new ones until another controller is attached."""
        self.dead = True
        self.drop("all", reset=True)

    def cut_power(self, *, reset: bool) -> None:
        """The controller is gone: its connections are reset, or stay open without a word, and new ones get none either."""
        self.dead, self.silent = True, not reset
        if reset:
            self.drop("all", reset=True)

    def clear_faults(self) -> None:
        """End the faults of the wire."""
        self.faults = WireFaults()

    def drop(self, service: str, *, reset: bool, connection: int = 0) -> int:
        """Close connections of one service or of `all`, with FIN or RST: all, or the one of this number (1: the oldest that is open).

        Returns how many were closed.
        """
        dropped = self.in_order(service)
        if connection:
            dropped = dropped[connection - 1 : connection]
        for port in dropped:
            port.drop(reset=reset)
        return len(dropped)


class Port(asyncio.Protocol):
    """One connection to one service. `full` tells that too much is unread; `started` that RTDE's data packets or the states are on."""

    service = ""
    backlog_bytes = BACKLOG_MAX_BYTES

    def __init__(self, ports: Ports, service: str | None = None) -> None:
        self.ports = ports
        self.service = service or self.service
        self.number = next(ports.numbers)
        self.transport: asyncio.Transport | None = None
        self.full = False
        self.started = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept the connection, unless there are too many."""
        assert isinstance(transport, asyncio.Transport)
        mine = self.ports.open[self.service]
        if len(mine) >= CONNECTIONS_MAX or (self.ports.dead and not self.ports.silent):
            transport.abort()
            return
        wire = transport.get_extra_info("socket")
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        transport.set_write_buffer_limits(self.backlog_bytes, self.backlog_bytes)
        self.transport = transport
        mine.add(self)
        if not self.ports.dead:
            self.accepted(transport)

    def accepted(self, transport: asyncio.Transport) -> None:
        """Greet a new client."""

    @property
    def client_port(self) -> int:
        """The TCP port of the client."""
        peer = None if self.transport is None else self.transport.get_extra_info("peername")
        return int(peer[1]) if peer else 0

    @property
    def controls(self) -> bool:
        """Whether the client has claimed inputs. Only a client of RTDE can."""
        return False

    def pause_writing(self) -> None:
        """Skip packets from now on: asyncio calls this when too much is unread."""
        self.full = True

    def resume_writing(self) -> None:
        """Send packets again: asyncio calls this when the client has read."""
        self.full = False

    def publish(self, tick: int, now_s: float, made: dict[tuple[str, ...], bytes], *, hold: bool) -> None:
        """Send the data packet of this control period. Only RTDE has one."""

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        """Forget the connection. It may end with FIN or RST."""
        self.ports.open[self.service].discard(self)

    def drop(self, *, reset: bool) -> None:
        """Close the connection from this side."""
        if self.transport is None:
            return
        if reset:
            wire = self.transport.get_extra_info("socket")
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.transport.abort()
        else:
            self.transport.close()

    @property
    def must_ask_hosts(self) -> bool:
        """Whether Play now asks other hosts for the text of the loaded program."""
        controller = self.ports.controller
        starts = controller.modes.runtime == Runtime.STOPPED and bool(controller.programs.files.hosts)
        return starts and not controller.identity.local

    async def ask_hosts(self) -> None:
        """Ask the hosts of the loaded program for its text."""
        controller = self.ports.controller
        files = controller.programs.files
        files.serve(await requested(files.hosts, generation=controller.settings.polyscope.major))

    @property
    def writable(self) -> "asyncio.Transport | None":
        """The transport, if it is still open."""
        return None if self.transport is None or self.transport.is_closing() else self.transport


class RtdePort(Port):
    """One RTDE connection."""

    service = "rtde"

    def __init__(self, ports: Ports) -> None:
        super().__init__(ports)
        self._session = ports.rtde_session()
        self._deaf_since_s: float | None = None
        self._held: deque[bytes] = deque(maxlen=LATE_MAX)

    @property
    def controls(self) -> bool:
        """Whether the client has claimed inputs."""
        return self._session.has_inputs

    def accepted(self, transport: asyncio.Transport) -> None:
        """Send nothing first, except if a fault asks for a text message."""
        if self.ports.faults.text_at_connect:
            transport.write(text_message("Safety setup has not been confirmed yet", "SafetySetup", 2))

    def data_received(self, data: bytes) -> None:
        """Handle requests and inputs."""
        transport = self.writable
        if transport is None or self.ports.dead:
            return
        # Acknowledge at once: ur-rtde's small writes wait for the acknowledgement (its TCP_NODELAY is lost) and would come in bunches.
        # The kernel forgets this option after a while, so it is set again for every packet.
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
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
                transport.abort()  # this client asks and does not read the replies

    def publish(self, tick: int, now_s: float, made: dict[tuple[str, ...], bytes], *, hold: bool) -> None:
        """Send the data packet of this control period, unless the client does not read."""
        transport = self.transport
        if transport is None or transport.is_closing():
            return
        if self.full:
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
        """End the session: its inputs become free."""
        self._session.close()
        super().connection_lost(exc)


class DashboardPort(Port):
    """One dashboard connection."""

    service = "dashboard"

    def __init__(self, ports: Ports) -> None:
        super().__init__(ports)
        self._buffer = b""
        self._playing: asyncio.Future[None] | None = None  # a Play that waits for the hosts of its program

    def accepted(self, transport: asyncio.Transport) -> None:
        """Send the greeting."""
        transport.write(dashboard.GREETING.encode() + b"\n")

    def data_received(self, data: bytes) -> None:
        """Reply to each line."""
        transport = self.writable
        if transport is None or self.ports.faults.mute or self.ports.dead:
            return
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            if transport.is_closing():
                return
            text = line[: dashboard.LINE_MAX_BYTES].decode("utf-8", "replace")
            if text.strip().lower() == "play" and self.must_ask_hosts:
                self._playing = asyncio.ensure_future(self._play(transport))
                continue
            answer = dashboard.reply(self.ports.controller, text)
            transport.write(answer.encode() + b"\n")
            if answer in (dashboard.QUIT, dashboard.SHUTDOWN):
                transport.close()
                if answer == dashboard.SHUTDOWN:
                    self.ports.shut_down()
                return
        if len(self._buffer) > dashboard.LINE_MAX_BYTES or self.full:
            transport.abort()

    async def _play(self, transport: asyncio.Transport) -> None:
        """Ask the hosts of the loaded program, and play it."""
        await self.ask_hosts()
        answer = dashboard.reply(self.ports.controller, "play")
        if not transport.is_closing():
            transport.write(answer.encode() + b"\n")


class StatePort(Port):
    """One connection to port 30001, 30002 or 30003. It sends states, which are never queued, and receives scripts."""

    backlog_bytes = 0

    def __init__(self, ports: Ports, service: str) -> None:
        super().__init__(ports, service)
        self._framer = Framer()

    def accepted(self, transport: asyncio.Transport) -> None:
        """Send the version first, except on the real-time port."""
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        if self.service != "realtime":
            controller = self.ports.controller
            transport.write(primary.version(controller.identity, controller.settings.build_date, controller.clock.now_s))

    def data_received(self, data: bytes) -> None:
        """Run the scripts that are complete."""
        for text in [] if self.ports.dead else self._framer.feed(data):
            self.ports.controller.run_script(text)


def _to_all(ports: set[Port], packet: Callable[[], bytes]) -> None:
    """Send a packet to all clients that read. It is built only if there is one: ur-rtde's control client never reads."""
    made: bytes | None = None
    for port in tuple(ports):
        transport = port.transport
        if port.full or transport is None or transport.is_closing():
            continue
        made = packet() if made is None else made
        transport.write(made)
