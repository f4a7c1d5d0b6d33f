"""A simulated robot as one process: sockets and a precise clock around a controller."""

import asyncio
import errno
import gc
import logging
import math
import os
import signal
import socket
from collections.abc import Callable

from monitor.errors import BadInput
from monitor.simulate.commands import LINE_MAX_BYTES, Commands, TickCounts
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.robot import ServedRobot, listening
from monitor.simulate.wire.ticking import REST_S, TickSelector, expirations, periodic_timer

LOG_LINES, LOG_PERIOD_S = 20, 60.0  # the log gets at most so many lines in such a period
CATCH_UP_S = 0.02  # control periods that were missed within this time are computed at once; older ones are dropped
LONGEST_REST = 1.1  # of REST_S: what the last rest left to compute belongs to it, and the selector rounds up


def serve(settings: SimulateSettings, on_ready: Callable[[], None] | None = None) -> None:
    """Simulate this robot until SIGINT, SIGTERM or the command `shutdown`. It needs a process of its own.

    Raises BadInput if a port is in use or the address cannot be bound.
    """
    sockets, selector = bound(settings), TickSelector()
    for handler in (*logging.getLogger().handlers, logging.lastResort):
        if handler is not None:
            handler.addFilter(LogLimit())
    try:
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selector)) as runner:
            runner.run(_run(settings, sockets, on_ready, selector))
    finally:
        for wire in sockets.values():
            wire.close()


def bound(settings: SimulateSettings) -> dict[int, socket.socket]:
    """A listening socket for each port.

    Raises BadInput with the port and the reason if one of them is not possible; then no socket stays open.
    """
    sockets: dict[int, socket.socket] = {}
    for port in (*settings.service_ports.values(), settings.command_port):
        try:
            sockets[port] = listening(settings.bind, port)
        except OSError as wrong:
            for other in sockets.values():
                other.close()
            taken = "is in use: another robot is there already; choose another --bind 127.x.y.z"
            if wrong.errno == errno.EACCES:
                why = "needs rights: choose another with --robot-api-port, e.g. 8080, and tell the monitor: robot.robot_api_port"
                raise BadInput(f"simulate: port {port} on {settings.bind} {why}") from None
            why = taken if wrong.errno == errno.EADDRINUSE else f"cannot be bound: {wrong.strerror}"
            raise BadInput(f"simulate: port {port} on {settings.bind} {why}") from None
    return sockets


class LogLimit(logging.Filter):
    """Limits the lines of the log per period: clients must not be able to fill a disk, or a pipe that nobody reads."""

    def __init__(self) -> None:
        super().__init__()
        self._since_s, self._count = 0.0, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether this line is written."""
        if record.created - self._since_s > LOG_PERIOD_S:
            self._since_s, self._count = record.created, 0
        self._count += 1
        return self._count <= LOG_LINES


async def _run(
    settings: SimulateSettings, sockets: dict[int, socket.socket], on_ready: Callable[[], None] | None, selector: TickSelector
) -> None:
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    robot, ticks = ServedRobot(settings, sockets, end.set), TickCounts(settings.tick_s)
    commands = Commands(robot, ticks, end.set)
    await robot.listeners.start()
    asking = await asyncio.start_server(commands.serve, sock=sockets[settings.command_port], limit=LINE_MAX_BYTES)
    ticker = _Ticker(robot, commands, ticks)
    timer = periodic_timer(settings.tick_s)
    loop.add_reader(timer, ticker.tick, timer)
    selector.follow(timer, lambda: robot.ports.streaming and not commands.stepping, ticker.rests)
    gc.collect()
    gc.freeze()  # all objects of now live as long as the process: later collections need not look at them
    if on_ready is not None:
        on_ready()
    try:
        await end.wait()
    finally:
        selector.forget()
        loop.remove_reader(timer)
        os.close(timer)
        asking.close()
        robot.listeners.close()
        robot.ports.drop("all", reset=False)


class _Ticker:
    """Computes a control period at each expiration of the timer."""

    def __init__(self, robot: ServedRobot, commands: Commands, ticks: TickCounts) -> None:
        self._robot, self._commands, self._ticks = robot, commands, ticks
        self._ports = robot.ports
        self._time = asyncio.get_running_loop().time
        self._catch_up = max(1, round(CATCH_UP_S / ticks.tick_s))
        self._in_a_rest = math.ceil(LONGEST_REST * REST_S / ticks.tick_s)

    def rests(self) -> bool:
        """Whether nobody could tell that several control periods are computed at once."""
        return not self._ports.watched and not self._commands.stepping

    def tick(self, timer: int) -> None:
        """Compute the control periods that are due. During a stepped replay, only publish the present state."""
        due = expirations(timer)
        now_s, ports = self._time(), self._ports
        if ports.dead:
            return
        if self._commands.stepping:
            ports.publish(now_s)
            return
        expected = self._in_a_rest if self.rests() else 1
        run = min(due, expected - 1 + self._catch_up)
        self._ticks.run += run
        self._ticks.late += due > expected
        self._ticks.dropped += due - run
        for _ in range(run):
            ports.controller.step()
            ports.publish(now_s)
