"""The simulated robot as one process: sockets and a precise clock around `Controller`."""

import asyncio
import errno
import gc
import logging
import os
import signal
import socket
from collections.abc import Callable

from monitor.errors import BadInput
from monitor.simulate.commands import LINE_MAX_BYTES, Commands
from monitor.simulate.controller import Controller
from monitor.simulate.ports import DashboardPort, Ports, RtdePort, ScriptPort
from monitor.simulate.settings import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORTS, SimulateSettings
from monitor.simulate.timer import expirations, periodic_timer

log = logging.getLogger(__name__)

CATCH_UP_S = 0.02  # of missed ticks are made good at once; the rest is time that never was


def serve(settings: SimulateSettings, on_ready: Callable[[], None] | None = None) -> None:
    """Be that robot until SIGINT, SIGTERM or the command `shutdown`. Run it in a process of its own.

    Raises BadInput where a port is taken or the address cannot be bound.
    """
    sockets = bound(settings)
    try:
        asyncio.run(_run(settings, sockets, on_ready))
    finally:
        for listening in sockets.values():
            listening.close()


def bound(settings: SimulateSettings) -> dict[int, socket.socket]:
    """A bound socket for each port, or none at all.

    Raises BadInput naming the port and what stands in the way.
    """
    sockets: dict[int, socket.socket] = {}
    for port in (RTDE_PORT, DASHBOARD_PORT, *SCRIPT_PORTS, settings.command_port):
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sockets[port] = listening
        try:
            listening.bind((settings.bind, port))
            listening.listen(64)  # here, not later: two processes may both bind, only one can listen
        except OSError as wrong:
            for other in sockets.values():
                other.close()
            taken = "is in use: another robot is there already; choose another --bind 127.x.y.z"
            why = taken if wrong.errno == errno.EADDRINUSE else f"cannot be bound: {wrong.strerror}"
            raise BadInput(f"simulate: port {port} on {settings.bind} {why}") from None
    return sockets


async def _run(settings: SimulateSettings, sockets: dict[int, socket.socket], on_ready: Callable[[], None] | None) -> None:
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    controller = Controller(settings)
    ports = Ports(controller)
    commands = Commands(controller, ports, end.set)
    servers = [
        await loop.create_server(lambda: RtdePort(ports), sock=sockets[RTDE_PORT]),
        await loop.create_server(lambda: DashboardPort(ports), sock=sockets[DASHBOARD_PORT]),
        *[await loop.create_server(lambda: ScriptPort(ports), sock=sockets[port]) for port in SCRIPT_PORTS],
        await asyncio.start_server(commands.serve, sock=sockets[settings.command_port], limit=LINE_MAX_BYTES),
    ]
    clock = _Clock(controller, ports, commands)
    timer = periodic_timer(controller.tick_s)
    loop.add_reader(timer, clock.tick, timer)
    gc.collect()
    gc.freeze()  # what exists now lives as long as the process: collections stay short
    if on_ready is not None:
        on_ready()
    try:
        await end.wait()
    finally:
        loop.remove_reader(timer)
        os.close(timer)
        for server in servers:
            server.close()
        ports.drop_rtde(reset=False)
        for transport in list(ports.others):
            transport.close()


class _Clock:
    """Turns the timer's expirations into ticks."""

    def __init__(self, controller: Controller, ports: Ports, commands: Commands) -> None:
        self._controller, self._ports, self._commands = controller, ports, commands
        self._catch_up = max(1, round(CATCH_UP_S / controller.tick_s))
        self._figures = commands.ticks
        self._figures.update(tick_s=controller.tick_s, run=0, late=0, dropped=0)

    def tick(self, timer: int) -> None:
        """Make good what is due; while a stepped replay owns the clock only tell what is."""
        due = expirations(timer)
        now_s = asyncio.get_running_loop().time()
        if self._commands.stepping:
            self._ports.publish(now_s)
            return
        run = min(due, self._catch_up)
        self._figures["run"] += run
        self._figures["late"] += due > 1
        self._figures["dropped"] += due - run
        for _ in range(run):
            self._controller.step()
            self._ports.publish(now_s)
