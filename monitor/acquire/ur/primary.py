"""The controller's primary port, read only: its configuration, its stops with their errors, and which programs it starts and ends.

A controller sends its state some ten times a second, and its configuration with the first one. The layout is that of the manufacturer's
guide to the client interfaces. A robot message (type 20) is of a kind: an error code (6) has a code, an argument and a level; `C153A2` is
"position deviates from path", as noticed by the third joint (the manufacturer's error codes, CODE_153). A safety mode (5) has a code, an
argument and the new mode. A key message (7) has a code, an argument, a title with its length before it, and a text: PROGRAM_XXX_STARTED or
PROGRAM_XXX_STOPPED with the name of the program; of a script, the name in its first line. The time in such a message may be zero. A runtime
exception (10) has a line, a column and a text.
"""

import math
import socket
import struct
import time
from typing import NamedTuple, Self

from monitor.acquire.driver import Reported, ReportedError, ReportedMode
from monitor.acquire.state import JointLimits
from monitor.acquire.ur.packages import LONGEST, Link, take_packages
from monitor.acquire.ur.rtde import JOINTS

PORT = 30001
ROBOT_STATE, CONFIGURATION = 16, 6  # type of a message, type of a package within it
PAIRS = struct.Struct(f">{4 * JOINTS}d")  # lowest and highest position of each joint, then greatest speed and acceleration of each
KIND = struct.Struct(">i")  # of arm; after the limits, four defaults, a radius, 24 kinematic parameters and two versions
KIND_AT = PAIRS.size + 8 * (4 + 1 + 4 * JOINTS) + 2 * 4
KINDS = {1: "UR5", 2: "UR10", 3: "UR3", 4: "UR16", 5: "UR18", 6: "UR8LONG", 7: "UR20", 8: "UR30", 9: "UR15"}  # the manufacturer's numbers
HEAD = struct.Struct(">iB")  # length with this head, type
WITHIN_S = 0.5  # the first state comes within 0.1 s of the connection


class Configured(NamedTuple):
    """What the configuration data say; None where they do not say it, or where it makes no sense."""

    limits: JointLimits | None = None
    model: str | None = None  # for example "UR5"; an e-Series has the same as a CB3


def configured(host: str, within_s: float = WITHIN_S) -> Configured:
    """What the controller's configuration data say; nothing where none come within that time."""
    until = time.monotonic() + within_s
    waiting = bytearray()
    try:
        with socket.create_connection((host, PORT), timeout=within_s) as connection:
            while (left_s := until - time.monotonic()) > 0.0:
                connection.settimeout(left_s)
                data = connection.recv(LONGEST)
                if not data:
                    return Configured()
                waiting += data
                for kind, message in take_packages(waiting, HEAD):
                    if kind == ROBOT_STATE and (found := configured_in_state(message)):
                        return found
    except OSError:
        return Configured()
    return Configured()


def configured_in_state(state: bytes) -> Configured | None:
    """What the packages of one robot state say, without its head; None where it has no configuration data."""
    while len(state) >= HEAD.size:
        length, kind = HEAD.unpack_from(state)
        if not HEAD.size <= length <= len(state):
            return None
        if kind == CONFIGURATION and length >= HEAD.size + PAIRS.size:
            values = PAIRS.unpack_from(state, HEAD.size)
            position, motion = values[: 2 * JOINTS], values[2 * JOINTS :]
            limits = JointLimits(lowest_rad=position[::2], highest_rad=position[1::2], speed_rad_s=motion[::2])
            kind_at = HEAD.size + KIND_AT
            number = KIND.unpack_from(state, kind_at)[0] if length >= kind_at + KIND.size else 0
            return Configured(limits if _sensible(limits) else None, KINDS.get(number))
        state = state[length:]
    return None


def _sensible(limits: JointLimits) -> bool:
    """Whether every joint has a range and a speed."""
    figures = (*limits.lowest_rad, *limits.highest_rad, *limits.speed_rad_s)
    ranges = zip(limits.lowest_rad, limits.highest_rad, strict=True)
    return not any(map(math.isnan, figures)) and all(low < high for low, high in ranges) and min(limits.speed_rad_s) > 0.0


ROBOT_MESSAGE, ERROR_CODE, SAFETY_MODE = 20, 6, 5
MESSAGE = struct.Struct(">QbB")  # time, source, kind
ERROR = struct.Struct(">iii")  # code, argument, level
MODE = struct.Struct(">iiB")  # code, argument, safety mode
BY_JOINT = frozenset({153})  # codes whose argument is the joint, counted from 0
GRAVE = 2  # warnings, violations and faults; what is below tells of no stop
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
SILENT_S = 10.0  # a controller sends its state some ten times a second: after this the way to it is cut, or it does not answer


class ReportedErrors:
    """A connection that `poll` opens, and opens again with growing pauses. For one thread."""

    def __init__(self, host: str, port: int = PORT) -> None:
        """The first `poll` begins to connect."""
        self._host, self._port, self._waiting = host, port, bytearray()
        self._next_try_at, self._pause_s = 0.0, FIRST_PAUSE_S
        self._heard_at = 0.0
        self._link: Link | None = None

    def poll(self) -> list[Reported]:
        """What has come since the last call, oldest first; nothing while nobody answers."""
        now = time.monotonic()
        if self._link is None:
            if now < self._next_try_at:
                return []
            self._link, self._waiting, self._heard_at = Link.to(self._host, self._port), bytearray(), now
        try:
            data = self._link.read()
            if data:
                self._pause_s = FIRST_PAUSE_S
            if data or self._link.looks_up:
                self._heard_at = now
            elif now - self._heard_at > SILENT_S:
                raise TimeoutError
            return self._taken(data)
        except OSError:
            self.close()
            self._next_try_at = now + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            return []

    def close(self) -> None:
        """Close the connection."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _taken(self, data: bytes) -> list[Reported]:
        """What is reported in what has come; raises OSError where it is not this protocol."""
        self._waiting += data
        messages = [message for kind, message in take_packages(self._waiting, HEAD) if kind == ROBOT_MESSAGE]
        found = (reported_error(message) or reported_mode(message) for message in messages)
        return [each for each in found if each is not None]


def reported_error(message: bytes) -> ReportedError | None:
    """The error in one robot message, without its head; None where it is of another kind, or tells of nothing grave."""
    if len(message) < MESSAGE.size + ERROR.size or MESSAGE.unpack_from(message)[2] != ERROR_CODE:
        return None
    code, argument, level = ERROR.unpack_from(message, MESSAGE.size)
    if level < GRAVE:
        return None
    joint = argument + 1 if code in BY_JOINT and 0 <= argument < JOINTS else None
    return ReportedError(f"C{code}A{argument}", joint)


def reported_mode(message: bytes) -> ReportedMode | None:
    """The safety mode in one robot message, without its head; None where it is of another kind."""
    if len(message) < MESSAGE.size + MODE.size or MESSAGE.unpack_from(message)[2] != SAFETY_MODE:
        return None
    return ReportedMode(MODE.unpack_from(message, MESSAGE.size)[2])


KEY_MESSAGE, RUNTIME_EXCEPTION = 7, 10
PLACE = struct.Struct(">ii")  # line and column of the script
KEY = struct.Struct(">iiB")  # code, argument, length of the title
STARTED, STOPPED = b"PROGRAM_XXX_STARTED", b"PROGRAM_XXX_STOPPED"
OUR_NAME = "rtde_control"  # of ur-rtde's program, in its first line
CONNECT_S = 0.5  # a controller answers within some milliseconds


class ProgramMessage(NamedTuple):
    """A program has started or ended."""

    started: bool
    name: str


class ProgramMessages:
    """A connection to the primary port that is opened once, and read without waiting. Where it is lost, nothing more is told."""

    def __init__(self, connection: socket.socket | None = None) -> None:
        """Read this connection; None: nothing is ever told."""
        self._link, self._waiting = None if connection is None else Link(connection), bytearray()
        self.running: str | None = None  # the program that was told to have started last, until it is told to have ended
        self.mistake = ""  # the last runtime exception; empty: none was told

    @classmethod
    def of(cls, host: str, port: int = PORT) -> Self:
        """Those of the controller at this address; where nobody listens, nothing is ever told."""
        try:
            return cls(socket.create_connection((host, port), timeout=CONNECT_S))
        except OSError:
            return cls()

    @property
    def open(self) -> bool:
        """Whether messages may still come."""
        return self._link is not None

    def started(self) -> list[str]:
        """The names of the programs that have started since the last call, oldest first."""
        names = []
        for message in self._messages():
            if message.started:
                names.append(message.name)
                self.running = message.name
            elif message.name == self.running:
                self.running = None
        return names

    def close(self) -> None:
        """Close the connection."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _messages(self) -> list[ProgramMessage]:
        """What has come since the last call, oldest first; mistakes are noted."""
        found: list[ProgramMessage] = []
        if self._link is None:
            return found
        try:
            self._waiting += self._link.read()
            for kind, message in take_packages(self._waiting, HEAD):
                if kind != ROBOT_MESSAGE:
                    continue
                if (told := program_message(message)) is not None:
                    found.append(told)
                self.mistake = mistake(message) or self.mistake
            if self._link.ended:
                self.close()
        except OSError:
            self.close()
        return found


def program_message(message: bytes) -> ProgramMessage | None:
    """The program in one robot message, without its head; None where it is of another kind."""
    if len(message) < MESSAGE.size + KEY.size or MESSAGE.unpack_from(message)[2] != KEY_MESSAGE:
        return None
    title_at = MESSAGE.size + KEY.size
    _, _, length = KEY.unpack_from(message, MESSAGE.size)
    title, text = message[title_at : title_at + length], message[title_at + length :]
    return ProgramMessage(title == STARTED, text.decode("utf-8", "replace")) if title in (STARTED, STOPPED) else None


def mistake(message: bytes) -> str:
    """The runtime exception in one robot message, without its head; empty where it is of another kind."""
    if len(message) < MESSAGE.size + PLACE.size or MESSAGE.unpack_from(message)[2] != RUNTIME_EXCEPTION:
        return ""
    line, column = PLACE.unpack_from(message, MESSAGE.size)
    return f"line {line}, column {column}: {message[MESSAGE.size + PLACE.size :].decode('utf-8', 'replace')}"
