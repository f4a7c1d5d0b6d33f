"""The listening sockets of the robot's services. Any of them may disappear and come back."""

import asyncio
import logging
import socket
from collections.abc import Callable, Iterable
from functools import partial

from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.ports import DashboardPort, Port, Ports, RtdePort, StatePort
from monitor.simulate.wire.robot_api_port import RobotApiPort

log = logging.getLogger(__name__)

BACKLOG = 64  # connections that wait to be accepted


def listening(address: str, port: int) -> socket.socket:
    """A socket that listens. Raises OSError if the port is in use or the address cannot be bound."""
    wire = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        wire.bind((address, port))
        wire.listen(BACKLOG)  # here and not later: two processes may bind the same port, but only one of them can listen
    except OSError:
        wire.close()
        raise
    return wire


class Listeners:
    """Accepts connections to the services of one robot."""

    def __init__(self, settings: SimulateSettings, ports: Ports, sockets: dict[int, socket.socket]) -> None:
        """`sockets` listen already, by port; a port without one is opened when the listeners start."""
        self._address, self._ports = settings.bind, ports
        self._service_ports = settings.service_ports
        self._sockets = {service: sockets[port] for service, port in self._service_ports.items() if port in sockets}
        self._servers: dict[str, asyncio.Server] = {}
        self._timers: list[asyncio.TimerHandle] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._gone: dict[str, object] = {}  # for each service, the last request that closed its listener

    async def start(self) -> None:
        """Accept connections on every service."""
        for service in self._service_ports:
            await self._open(service)

    async def _open(self, service: str) -> None:
        if service in self._servers:
            return
        wire = self._sockets.get(service)
        if wire is None or wire.fileno() < 0:
            try:
                wire = listening(self._address, self._service_ports[service])
            except OSError as wrong:  # another process took the port meanwhile
                log.warning("%s cannot listen again: %s", service, wrong)
                return
        made: Callable[[], Port]
        if service == "rtde":
            made = partial(RtdePort, self._ports)
        elif service == "dashboard":
            made = partial(DashboardPort, self._ports)
        elif service == "robot_api":
            made = partial(RobotApiPort, self._ports)
        else:
            made = partial(StatePort, self._ports, service)
        self._sockets[service] = wire
        self._servers[service] = await asyncio.get_running_loop().create_server(made, sock=wire)

    def close(self) -> None:
        """Accept no more connections, and cancel everything that waits for its time."""
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
        """Stop listening for a service, or for `all`. 0 s means until `back`."""
        gone = [name for name in self._service_ports if service in (name, "all")]
        request = object()
        for name in gone:
            self._shut(name)
            self._gone[name] = request
        if seconds > 0.0:
            self.later(seconds, lambda: self.back([name for name in gone if self._gone[name] is request]))

    def back(self, services: Iterable[str] | None = None) -> None:
        """Listen again, unless the controller is dead."""
        if self._ports.dead:
            return
        for service in self._service_ports if services is None else services:
            task = asyncio.get_running_loop().create_task(self._open(service))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def later(self, seconds: float, act: Callable[[], None]) -> asyncio.TimerHandle:
        """Do something after a time, unless the listeners are closed before."""
        loop = asyncio.get_running_loop()
        self._timers = [timer for timer in self._timers if timer.when() > loop.time()]
        self._timers.append(loop.call_later(seconds, act))
        return self._timers[-1]
