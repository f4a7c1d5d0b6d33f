"""What a controller reports on its primary port of its stops: errors, and each change of the safety mode. Received only, never waited for.

The layout is that of the manufacturer's guide to the client interfaces: a robot message (type 20) of the kind error code (6) has a code, an
argument and a level; one of the kind safety mode (5) has a code, an argument and the new mode. `C153A2` is "position deviates from path",
as noticed by the third joint (the manufacturer's error codes, CODE_153).
"""

import errno
import socket
import struct
import time
from concurrent import futures
from typing import NamedTuple

from monitor.acquire.ur.ports.address import is_address, looked_up
from monitor.acquire.ur.ports.packages import take_packages
from monitor.acquire.ur.ports.primary import HEAD, JOINTS, PORT

ROBOT_MESSAGE, ERROR_CODE, SAFETY_MODE = 20, 6, 5
MESSAGE = struct.Struct(">QbB")  # time, source, kind
ERROR = struct.Struct(">iii")  # code, argument, level
MODE = struct.Struct(">iiB")  # code, argument, safety mode
BY_JOINT = frozenset({153})  # codes whose argument is the joint, counted from 0
GRAVE = 2  # warnings, violations and faults; what is below tells of no stop
READ_BYTES = 65_536
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
SILENT_S = 10.0  # a controller sends its state some ten times a second: after this the way to it is cut, or it does not answer


class ReportedError(NamedTuple):
    """One error."""

    code: str  # as the pendant writes it, e.g. C153A2
    joint: int | None  # from 1, where the code tells it


class ReportedMode(NamedTuple):
    """The safety mode has changed to this one."""

    mode: int


Reported = ReportedError | ReportedMode


class ReportedErrors:
    """A connection that `poll` opens, and opens again with growing pauses. For one thread."""

    def __init__(self, host: str, port: int = PORT) -> None:
        """The first `poll` begins to connect."""
        self._host, self._port, self._waiting = host, port, bytearray()
        self._looked_up: futures.Future[str] | None = None  # the address of a host's name, while it is asked for
        self._next_try_at, self._pause_s = 0.0, FIRST_PAUSE_S
        self._heard_at = 0.0
        self._socket: socket.socket | None = None

    def poll(self) -> list[Reported]:
        """What has come since the last call, oldest first; nothing while nobody answers."""
        if self._socket is None:
            if time.monotonic() < self._next_try_at:
                return []
            try:
                address = self._address()
            except OSError:
                self._lost()
                return []
            if address is None:
                return []
            self._connect(address)
        found: list[Reported] = []
        try:
            while self._socket is not None:
                data = self._socket.recv(READ_BYTES)
                if not data:
                    raise ConnectionResetError
                self._pause_s, self._heard_at = FIRST_PAUSE_S, time.monotonic()
                found += self._taken(data)
                if len(data) < READ_BYTES:
                    break
        except BlockingIOError:
            pass
        except OSError as error:
            if error.errno not in (errno.ENOTCONN, errno.EAGAIN):  # not connected yet
                self._lost()
        if self._socket is not None and time.monotonic() - self._heard_at > SILENT_S:
            self._lost()
        return found

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _address(self) -> str | None:
        """None while the host's name is looked up. Raises OSError where it has no address."""
        if is_address(self._host):
            return self._host
        if self._looked_up is None:
            self._looked_up = looked_up(self._host)
        if not self._looked_up.done():
            return None
        found, self._looked_up = self._looked_up, None
        return found.result()

    def _connect(self, address: str) -> None:
        self._waiting.clear()
        self._heard_at = time.monotonic()
        self._next_try_at = self._heard_at + self._pause_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        if self._socket.connect_ex((address, self._port)) not in (0, errno.EINPROGRESS):
            self._lost()

    def _lost(self) -> None:
        self.close()
        self._next_try_at = time.monotonic() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)

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
