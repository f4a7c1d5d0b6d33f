"""One simulated robot that clients reach over its sockets, and the faults of its connections and its process."""

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Any

from monitor.simulate.cells.catalogue import cell
from monitor.simulate.cells.cell import CellAround
from monitor.simulate.controller.controller import Controller
from monitor.simulate.controller.modes import RobotMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.listeners import Listeners
from monitor.simulate.wire.ports import Ports

FREEZE_DELAY_S = 0.02  # so that the client that asks for a freeze gets its reply first


class ServedRobot:
    """A controller, the ports that serve clients, and the sockets that accept them. A fault may replace the controller; the arm stays."""

    def __init__(self, settings: SimulateSettings, sockets: dict[int, socket.socket], shut_down: Callable[[], None]) -> None:
        """`sockets` listen already, by port. `shut_down` ends the whole simulator."""
        self._settings = settings
        self._around = None if settings.cell is None else CellAround(cell(settings.cell, settings.arm, settings.seed))
        controller = Controller(settings, wire=self, surroundings=self._around)
        if self._around is not None:
            controller.programs.play()
        self.ports = Ports(controller, shut_down)
        self.listeners = Listeners(settings, self.ports, sockets)
        self._rebirth: asyncio.TimerHandle | None = None
        self._actions: dict[str, Callable[[dict[str, Any]], str]] = {
            "stall": self._stall,
            "close": self._close,
            "reset": self._reset,
            "listener_gone": self._listener_gone,
            "restart": self._restart,
            "power_cut": self._power_cut,
            "freeze": self._freeze,
            "late": self._late,
            "skip": self._skip,
            "mute": self._mute,
            "robot_api": self._robot_api,
            "text_at_connect": self._text_at_connect,
        }

    @property
    def controller(self) -> Controller:
        """The present controller."""
        return self.ports.controller

    @property
    def dead(self) -> bool:
        """Whether the controller was killed and has not started again."""
        return self.ports.dead

    def inject(self, name: str, arguments: dict[str, Any]) -> str:
        """Make a fault of the wire happen. The arguments are checked already. Returns a sentence that says what was done."""
        return self._actions[name](arguments)

    def clear(self) -> None:
        """End every lasting fault of the wire."""
        self.ports.clear_faults()
        self.listeners.back()

    def _stall(self, arguments: dict[str, Any]) -> str:
        self.ports.faults.muted_until_s = asyncio.get_running_loop().time() + arguments["seconds"]
        return f"no RTDE data for {arguments['seconds']:g} s"

    def _close(self, arguments: dict[str, Any]) -> str:
        return f"closed {self._dropped(arguments, reset=False)} connections of {arguments['service']}"

    def _reset(self, arguments: dict[str, Any]) -> str:
        return f"reset {self._dropped(arguments, reset=True)} connections of {arguments['service']}"

    def _dropped(self, arguments: dict[str, Any], *, reset: bool) -> int:
        return self.ports.drop(arguments["service"], reset=reset, connection=int(arguments["connection"]))

    def _listener_gone(self, arguments: dict[str, Any]) -> str:
        service, seconds = arguments["service"], arguments["seconds"]
        self.listeners.away(service, seconds)
        return f"nobody listens for {service}" + (f" for {seconds:g} s" if seconds else " until `clear`")

    def _freeze(self, arguments: dict[str, Any]) -> str:
        seconds = arguments["seconds"]
        self.listeners.later(FREEZE_DELAY_S, lambda: time.sleep(seconds))  # the whole process stands still, as if a signal had stopped it
        return f"the whole controller stands still for {seconds:g} s, its connections open"

    def _late(self, arguments: dict[str, Any]) -> str:
        faults = self.ports.faults
        faults.late_s, faults.late_share = arguments["seconds"], arguments["share"]
        return f"{100 * faults.late_share:g} % of the packets come {1000 * faults.late_s:g} ms late, with those behind them"

    def _skip(self, arguments: dict[str, Any]) -> str:
        self.ports.faults.skip_share = arguments["share"]
        return f"{100 * arguments['share']:g} % of the packets are never sent"

    def _mute(self, _: dict[str, Any]) -> str:
        self.ports.faults.mute = True
        return "requests are read and never answered"

    def _robot_api(self, arguments: dict[str, Any]) -> str:
        self.ports.faults.robot_api = arguments["answer"]
        return f"the answers of the Robot API are {arguments['answer']}"

    def _text_at_connect(self, _: dict[str, Any]) -> str:
        self.ports.faults.text_at_connect = True
        return "every new RTDE connection is greeted by a text message"

    def _restart(self, arguments: dict[str, Any]) -> str:
        """Kill the controller: all connections are reset at once. A new controller with the same arm answers later."""
        seconds, power = arguments["seconds"], arguments["power"]
        self.ports.kill()
        self.listeners.away("all", 0.0)
        self._come_back(seconds, with_power=power == "on")
        return f"the controller was killed and comes back in {seconds:g} s, its clock at zero, power {power}"

    def _power_cut(self, arguments: dict[str, Any]) -> str:
        """Switch everything off at once: the brakes stop the arm. A new controller with the same arm answers later."""
        seconds, connections = arguments["seconds"], arguments["connections"]
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
        controller = Controller(self._settings, before=self.controller, wire=self, surroundings=self._around)
        if with_power:
            controller.safety.power(RobotMode.IDLE)
            controller.safety.power(RobotMode.RUNNING)
        self.ports.attach(controller)
        self.listeners.back()
