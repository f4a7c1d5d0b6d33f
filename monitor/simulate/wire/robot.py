"""The listening sockets of the robot's services. Any of them may disappear and come back."""

import asyncio
import logging
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial

from monitor.simulate.cells.catalogue import cell
from monitor.simulate.cells.cell import CellAround
from monitor.simulate.controller.controller import Controller
from monitor.simulate.controller.faults import Effect
from monitor.simulate.machine.state import RobotMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.ports import DashboardPort, Port, Ports, RtdePort, StatePort
from monitor.simulate.wire.robot_api import RobotApiPort

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


# --- One simulated robot that clients reach over its sockets, and the faults of its connections and its process ---

FREEZE_DELAY_S = 0.02  # so that the client that asks for a freeze gets its reply first


class ServedRobot:
    """A controller, the ports that serve clients, and the sockets that accept them. A fault may replace the controller; the arm stays."""

    def __init__(self, settings: SimulateSettings, sockets: dict[int, socket.socket], shut_down: Callable[[], None]) -> None:
        """`sockets` listen already, by port. `shut_down` ends the whole simulator."""
        self._settings = settings
        self._around = None if settings.cell is None else CellAround(cell(settings.cell, settings.arm, settings.seed))
        self.faults: dict[str, Effect] = {
            effect.__name__.removeprefix("_"): effect
            for effect in (
                *(self._stall, self._close, self._reset, self._listener_gone, self._restart, self._power_cut, self._freeze, self._late),
                *(self._skip, self._mute, self._robot_api, self._text_at_connect, self._clear),
            )
        }
        controller = Controller(settings, wire=self.faults, surroundings=self._around)
        if self._around is not None:
            controller.programs.play()
        self.ports = Ports(controller, shut_down)
        self.listeners = Listeners(settings, self.ports, sockets)
        self._rebirth: asyncio.TimerHandle | None = None

    @property
    def controller(self) -> Controller:
        """The present controller."""
        return self.ports.controller

    @property
    def dead(self) -> bool:
        """Whether the controller was killed and has not started again."""
        return self.ports.dead

    def _clear(self) -> str:
        self.ports.clear_faults()
        self.listeners.back()
        return "every lasting fault of the wire is over"

    def _stall(self, seconds: float) -> str:
        self.ports.faults.muted_until_s = asyncio.get_running_loop().time() + seconds
        return f"no RTDE data for {seconds:g} s"

    def _close(self, service: str, connection: float) -> str:
        return f"closed {self.ports.drop(service, reset=False, connection=int(connection))} connections of {service}"

    def _reset(self, service: str, connection: float) -> str:
        return f"reset {self.ports.drop(service, reset=True, connection=int(connection))} connections of {service}"

    def _listener_gone(self, service: str, seconds: float) -> str:
        self.listeners.away(service, seconds)
        return f"nobody listens for {service}" + (f" for {seconds:g} s" if seconds else " until `clear`")

    def _freeze(self, seconds: float) -> str:
        self.listeners.later(FREEZE_DELAY_S, lambda: time.sleep(seconds))  # the whole process stands still, as if a signal had stopped it
        return f"the whole controller stands still for {seconds:g} s, its connections open"

    def _late(self, seconds: float, share: float) -> str:
        self.ports.faults.late_s, self.ports.faults.late_share = seconds, share
        return f"{100 * share:g} % of the packets come {1000 * seconds:g} ms late, with those behind them"

    def _skip(self, share: float) -> str:
        self.ports.faults.skip_share = share
        return f"{100 * share:g} % of the packets are never sent"

    def _mute(self) -> str:
        self.ports.faults.mute = True
        return "requests are read and never answered"

    def _robot_api(self, answer: str) -> str:
        self.ports.faults.robot_api = answer
        return f"the answers of the Robot API are {answer}"

    def _text_at_connect(self) -> str:
        self.ports.faults.text_at_connect = True
        return "every new RTDE connection is greeted by a text message"

    def _restart(self, seconds: float, power: str) -> str:
        """Kill the controller: all connections are reset at once. A new controller with the same arm answers later."""
        self.ports.kill()
        self.listeners.away("all", 0.0)
        self._come_back(seconds, with_power=power == "on")
        return f"the controller was killed and comes back in {seconds:g} s, its clock at zero, power {power}"

    def _power_cut(self, seconds: float, connections: str) -> str:
        """Switch everything off at once: the brakes stop the arm. A new controller with the same arm answers later."""
        self.controller.safety.lose_power()
        self.ports.cut_power(reset=connections == "reset")
        if connections == "reset":
            self.listeners.away("all", 0.0)
        self._come_back(seconds, with_power=False)
        return f"the main switch is off, every connection {connections}; the controller is back in {seconds:g} s, without power"

    def _come_back(self, seconds: float, *, with_power: bool) -> None:
        if self._rebirth is not None:
            self._rebirth.cancel()  # the controller was killed again before it was back
        self._rebirth = self.listeners.later(seconds, lambda: self._start_again(with_power=with_power))

    def _start_again(self, *, with_power: bool) -> None:
        self.ports.drop("all", reset=True)  # a controller that was switched off knows nothing of its connections
        controller = Controller(self._settings, before=self.controller, wire=self.faults, surroundings=self._around)
        if with_power:
            controller.safety.power(RobotMode.IDLE)
            controller.safety.power(RobotMode.RUNNING)
        self.ports.attach(controller)
        self.listeners.back()
