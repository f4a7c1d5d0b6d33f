"""The simulated robot as one process: sockets and a precise clock around `Controller`."""

import asyncio
import errno
import gc
import logging
import os
import signal
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial

from monitor.errors import BadInput
from monitor.simulate.commands import LINE_MAX_BYTES, Commands
from monitor.simulate.controller.controller import Controller
from monitor.simulate.controller.modes import RobotMode
from monitor.simulate.faults import SERVICES, Place
from monitor.simulate.settings import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORTS, SimulateSettings
from monitor.simulate.wire.ports import DashboardPort, Port, Ports, RtdePort, StatePort
from monitor.simulate.wire.ticking import TickSelector
from monitor.simulate.wire.timer import expirations, periodic_timer

log = logging.getLogger(__name__)

LOG_LINES, LOG_PERIOD_S = 20, 60.0
CATCH_UP_S = 0.02  # of missed ticks are made good at once; the rest is time that never was
SERVICE_PORTS = dict(zip(SERVICES, (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS), strict=True))


def serve(settings: SimulateSettings, on_ready: Callable[[], None] | None = None) -> None:
    """Be that robot until SIGINT, SIGTERM or the command `shutdown`. Run it in a process of its own.

    Raises BadInput where a port is taken or the address cannot be bound.
    """
    sockets, selector = bound(settings), TickSelector()
    for handler in (*logging.getLogger().handlers, logging.lastResort):
        if handler is not None:
            handler.addFilter(Sparing())
    try:
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selector)) as runner:
            runner.run(_run(settings, sockets, on_ready, selector))
    finally:
        for listening in sockets.values():
            listening.close()


def bound(settings: SimulateSettings) -> dict[int, socket.socket]:
    """A bound socket for each port, or none at all.

    Raises BadInput naming the port and what stands in the way.
    """
    sockets: dict[int, socket.socket] = {}
    for port in (*SERVICE_PORTS.values(), settings.command_port):
        try:
            sockets[port] = _listening(settings.bind, port)
        except OSError as wrong:
            for other in sockets.values():
                other.close()
            taken = "is in use: another robot is there already; choose another --bind 127.x.y.z"
            why = taken if wrong.errno == errno.EADDRINUSE else f"cannot be bound: {wrong.strerror}"
            raise BadInput(f"simulate: port {port} on {settings.bind} {why}") from None
    return sockets


def _listening(address: str, port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((address, port))
        listening.listen(64)  # here, not later: two processes may both bind, only one can listen
    except OSError:
        listening.close()
        raise
    return listening


class Sparing(logging.Filter):
    """So many lines of the log a period: what strangers send must not fill a disk, or a pipe that nobody reads."""

    def __init__(self) -> None:
        super().__init__()
        self._since_s, self._count = 0.0, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether this line may be written."""
        if record.created - self._since_s > LOG_PERIOD_S:
            self._since_s, self._count = record.created, 0
        self._count += 1
        return self._count <= LOG_LINES


class Listeners:
    """Who accepts connections to the robot's services; any of them may go away and come back."""

    def __init__(self, settings: SimulateSettings, ports: Ports, sockets: dict[int, socket.socket]) -> None:
        self._settings, self._ports = settings, ports
        self._sockets = {service: sockets[port] for service, port in SERVICE_PORTS.items()}
        self._servers: dict[str, asyncio.Server] = {}
        self._timers: list[asyncio.TimerHandle] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self.down = False  # the controller is dead: no tick, no answer
        self.powered = False  # after a restart
        self._rebirth: asyncio.TimerHandle | None = None
        self._gone: dict[str, object] = {}  # by service: the last command that sent its listener away
        self.changed: Callable[[Controller], None] = lambda _: None

    async def start(self) -> None:
        """Accept on every service."""
        for service in SERVICE_PORTS:
            await self._open(service)

    async def _open(self, service: str) -> None:
        if service in self._servers:
            return
        wire = self._sockets.get(service)
        if wire is None or wire.fileno() < 0:
            try:
                wire = _listening(self._settings.bind, SERVICE_PORTS[service])
            except OSError as wrong:  # somebody else took it meanwhile
                log.warning("%s cannot listen again: %s", service, wrong)
                return
        made: Callable[[], Port]
        if service == "rtde":
            made = partial(RtdePort, self._ports)
        elif service == "dashboard":
            made = partial(DashboardPort, self._ports)
        else:
            made = partial(StatePort, self._ports, service)
        self._sockets[service] = wire
        self._servers[service] = await asyncio.get_running_loop().create_server(made, sock=wire)

    def close(self) -> None:
        """Accept no more; what waits for its time is forgotten."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        for service in list(self._servers):
            self._shut(service)

    def _shut(self, service: str) -> None:
        server = self._servers.pop(service, None)
        if server is not None:
            server.close()
            self._sockets[service].close()

    def away(self, service: str, seconds: float) -> None:
        """Nobody listens for a service, or for `all`; 0 s: until `back`."""
        gone = [name for name in SERVICE_PORTS if service in (name, "all")]
        command = object()
        for name in gone:
            self._shut(name)
            self._gone[name] = command
        if seconds > 0.0:
            self._later(seconds, lambda: self.back([name for name in gone if self._gone[name] is command]))

    def back(self, services: Iterable[str] = tuple(SERVICE_PORTS)) -> None:
        """Listen again, unless the controller is dead."""
        if self.down:
            return
        for service in services:
            task = asyncio.get_running_loop().create_task(self._open(service))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def restart(self, seconds: float) -> None:
        """Kill the controller: everything is reset at once; a new one with the same arm answers after so long."""
        self.down = self._ports.dead = True
        self._ports.drop("all", reset=True)
        self.away("all", 0.0)
        if self._rebirth is not None:
            self._rebirth.cancel()  # killed once more before it was back
        self._rebirth = self._later(seconds, self._reborn)

    def _reborn(self) -> None:
        before = self._ports.controller
        controller = Controller(self._settings, before=before)
        controller.place = before.place
        if self.powered:
            controller.power(RobotMode.IDLE)
            controller.power(RobotMode.RUNNING)
        self._ports.controller = controller
        self.changed(controller)
        self.down = self._ports.dead = False
        self.back()

    def freeze(self, seconds: float) -> None:
        """The whole process stands still, as if it had been stopped by a signal: after the answer to whoever asked for it."""
        self._later(0.02, lambda: time.sleep(seconds))

    def _later(self, seconds: float, act: Callable[[], None]) -> asyncio.TimerHandle:
        self._timers = [timer for timer in self._timers if timer.when() > asyncio.get_running_loop().time()]
        self._timers.append(asyncio.get_running_loop().call_later(seconds, act))
        return self._timers[-1]


async def _run(
    settings: SimulateSettings, sockets: dict[int, socket.socket], on_ready: Callable[[], None] | None, selector: TickSelector
) -> None:
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    ports = Ports(Controller(settings))
    ports.shut_down = end.set
    listeners = Listeners(settings, ports, sockets)

    def place() -> Place:
        return Place(controller=ports.controller, ports=ports, listeners=listeners, now_s=loop.time())

    ports.controller.place = place
    commands = Commands(ports, place, end.set)
    await listeners.start()
    asking = await asyncio.start_server(commands.serve, sock=sockets[settings.command_port], limit=LINE_MAX_BYTES)
    clock = _Clock(ports, commands, listeners)
    timer = periodic_timer(ports.controller.tick_s)
    loop.add_reader(timer, clock.tick, timer)
    selector.follow(timer)
    selector.ticking = lambda: ports.streaming and not commands.stepping
    gc.collect()
    gc.freeze()  # what exists now lives as long as the process: collections stay short
    if on_ready is not None:
        on_ready()
    try:
        await end.wait()
    finally:
        selector.forget()
        loop.remove_reader(timer)
        os.close(timer)
        asking.close()
        listeners.close()
        ports.drop("all", reset=False)


class _Clock:
    """Turns the timer's expirations into ticks."""

    def __init__(self, ports: Ports, commands: Commands, listeners: Listeners) -> None:
        self._ports, self._commands, self._listeners = ports, commands, listeners
        self._time = asyncio.get_running_loop().time
        tick_s = ports.controller.tick_s
        self._catch_up = max(1, round(CATCH_UP_S / tick_s))
        self._figures = commands.ticks
        self._figures.update(tick_s=tick_s, run=0, late=0, dropped=0)

    def tick(self, timer: int) -> None:
        """Make good what is due; while a stepped replay owns the clock only tell what is."""
        due = expirations(timer)
        now_s = self._time()
        if self._listeners.down:
            return
        if self._commands.stepping:
            self._ports.publish(now_s)
            return
        run = min(due, self._catch_up)
        self._figures["run"] += run
        self._figures["late"] += due > 1
        self._figures["dropped"] += due - run
        for _ in range(run):
            self._ports.controller.step()
            self._ports.publish(now_s)
