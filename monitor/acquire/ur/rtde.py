"""RTDE over a plain socket, received only: rows as a session, one look at the arm, a few variables, the software's version.

A daemon listens for years, beside many others on its host. ur-rtde needs a process with an interpreter and numpy of its own, and a thread
that wakes a thousand times a second; this needs a socket that is never waited for. What moves an arm and what records every tick are
ur-rtde's. The protocol is version 2 of the manufacturer's Real-Time Data Exchange guide: version, output recipe, start, then rows.
"""

import socket
import struct
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from monitor.acquire.driver import SessionEnded
from monitor.acquire.rows import WIDTHS, layout
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur.packages import Link, take_packages
from monitor.errors import RobotUnreachable
from monitor.reason import Sentence
from monitor.recording import Array

JOINTS = 6
COLUMN, WIDTH = layout(JOINTS)  # of a row of these arms


class Signal(NamedTuple):
    """One RTDE variable and the getter of ur-rtde that reads it."""

    variable: str  # its name in a row
    getter: str
    optional: bool = False  # controllers of some generations do not report it; the row holds NaN then

    @property
    def width(self) -> int:
        """Values a tick."""
        return WIDTHS[self.variable] or JOINTS


SIGNALS: tuple[Signal, ...] = (
    Signal("timestamp", "getTimestamp"),
    Signal("actual_q", "getActualQ"),
    Signal("actual_qd", "getActualQd"),
    Signal("actual_current", "getActualCurrent"),
    Signal("joint_temperatures", "getJointTemperatures"),
    Signal("target_q", "getTargetQ"),
    Signal("target_qd", "getTargetQd"),
    Signal("target_qdd", "getTargetQdd"),
    Signal("target_current", "getTargetCurrent"),
    Signal("target_moment", "getTargetMoment"),
    Signal("robot_mode", "getRobotMode"),
    Signal("safety_mode", "getSafetyMode"),
    Signal("runtime_state", "getRuntimeState"),
    Signal("safety_status_bits", "getSafetyStatusBits"),
    Signal("speed_scaling", "getSpeedScaling", optional=True),
    Signal("target_speed_fraction", "getTargetSpeedFraction", optional=True),
    Signal("payload", "getPayload", optional=True),  # from software 3.11 and 5.6 on
    Signal("payload_cog", "getPayloadCog", optional=True),
    Signal("actual_tool_accelerometer", "getActualToolAccelerometer", optional=True),
    Signal("actual_digital_input_bits", "getActualDigitalInputBits", optional=True),
    Signal("robot_status_bits", "getRobotStatus", optional=True),
    Signal("joint_mode", "getJointMode", optional=True),
    Signal("actual_TCP_pose", "getActualTCPPose", optional=True),
    Signal("actual_TCP_force", "getActualTCPForce", optional=True),
)


PORT = 30004
HEAD = struct.Struct(">HB")  # length with this head, type
VERSION, OUTPUTS, START, ROW, SOFTWARE = ord("V"), ord("O"), ord("S"), ord("U"), ord("v")
NUMBERS = struct.Struct(">4I")  # major, minor, bugfix, build
VECTOR6D = struct.Struct(">6d")
PATIENCE_S = 5.0  # for a whole conversation: a controller answers within some milliseconds, a busy host or network takes seconds


NO_RTDE = Sentence("no_rtde", "{host}: RTDE on port {port}: {why}")


def rows_of(host: str, variables: tuple[str, ...], *, count: int, rate_hz: float, timeout_s: float) -> Array | None:
    """`count` rows (N, V, 6) of V variables of six numbers each; None where the controller does not report one of them.

    Raises RobotUnreachable where the controller does not answer as the protocol says, within timeout_s.
    """
    rows = _payloads(host, variables, "VECTOR6D", count=count, rate_hz=rate_hz, timeout_s=timeout_s)
    return (
        None if rows is None else np.array([[VECTOR6D.unpack_from(row, VECTOR6D.size * k) for k in range(len(variables))] for row in rows])
    )


def output_integers(host: str, registers: tuple[int, ...], timeout_s: float = PATIENCE_S) -> tuple[int, ...] | None:
    """What stands in these output registers of integers; None where the controller has one of them not. Raises RobotUnreachable."""
    variables = tuple(f"output_int_register_{register}" for register in registers)
    rows = _payloads(host, variables, "INT32", count=1, rate_hz=10.0, timeout_s=timeout_s)
    return None if rows is None else struct.unpack_from(f">{len(registers)}i", rows[0])


def _payloads(host: str, variables: tuple[str, ...], kind: str, *, count: int, rate_hz: float, timeout_s: float) -> list[bytes] | None:
    """`count` rows of variables of one kind, as they come; None where the controller does not report one of them so.

    Raises RobotUnreachable.
    """
    until = time.monotonic() + timeout_s
    try:
        with socket.create_connection((host, PORT), timeout=timeout_s) as connection:
            packages = _packages(connection, until)
            connection.sendall(packed(VERSION, struct.pack(">H", 2)))
            _answer(packages, VERSION)
            connection.sendall(packed(OUTPUTS, struct.pack(">d", rate_hz) + ",".join(variables).encode()))
            recipe = _answer(packages, OUTPUTS)
            if recipe[1:].decode("ascii", "replace").split(",") != [kind] * len(variables):
                return None
            connection.sendall(packed(START, b""))
            _answer(packages, START)
            return [_answer(packages, ROW)[1:] for _ in range(count)]
    except (OSError, struct.error) as error:
        raise RobotUnreachable(NO_RTDE(host=host, port=PORT, why=str(error))) from None


def software_of(host: str, timeout_s: float = PATIENCE_S) -> str | None:
    """The version of the controller's software, for example "10.12.0.5"; None where it does not answer as the protocol says."""
    until = time.monotonic() + timeout_s
    try:
        with socket.create_connection((host, PORT), timeout=timeout_s) as connection:
            connection.sendall(packed(SOFTWARE, b""))
            numbers = NUMBERS.unpack_from(_answer(_packages(connection, until), SOFTWARE))
    except (OSError, struct.error):
        return None
    return ".".join(map(str, numbers))


def packed(kind: int, payload: bytes) -> bytes:
    """One package."""
    return HEAD.pack(HEAD.size + len(payload), kind) + payload


def _packages(connection: socket.socket, until: float) -> Iterator[tuple[int, bytes]]:
    """Type and payload of every package, as they come."""
    waiting = bytearray()
    while True:
        yield from take_packages(waiting, HEAD)
        left_s = until - time.monotonic()
        if left_s <= 0.0:
            raise OSError("no answer in time")
        connection.settimeout(left_s)
        data = connection.recv(65_536)
        if not data:
            raise OSError("the controller closed the connection")
        waiting += data


def _answer(packages: Iterator[tuple[int, bytes]], wanted: int) -> bytes:
    """The payload of the next package of that type; texts for people and other packages are left out."""
    return next(payload for kind, payload in packages if kind == wanted)


TYPES = {  # of the guide, and the format of each in network order
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
ABSENT = "NOT_FOUND"  # in the place of a type: this controller does not report the variable


ENDED = Sentence("connection_ended", "the connection has ended")
CONNECTION_LOST = Sentence("rtde_connection_lost", "{host}: RTDE: {why}")


class Unanswered(Exception):
    """The controller does not answer as the protocol says."""


class Recipe:
    """What the bytes of a row mean, as the controller has answered."""

    def __init__(self, signals: tuple[Signal, ...], answer: bytes) -> None:
        """`answer` : number of the recipe and the types of its variables. Raises Unanswered where a type does not fit its variable."""
        types = answer[1:].decode("ascii", "replace").split(",")
        if len(types) != len(signals):
            raise Unanswered(f"{len(types)} types for {len(signals)} variables")
        self.absent = tuple(signal for signal, kind in zip(signals, types, strict=True) if kind == ABSENT)
        places: list[int] = []
        optional: list[bool] = []
        formats = [">B"]
        for signal, kind in zip(signals, types, strict=True):
            if kind == ABSENT:
                continue
            column = COLUMN[signal.variable]
            if kind not in TYPES or len(struct.unpack(f">{TYPES[kind]}", bytes(struct.calcsize(f">{TYPES[kind]}")))) != signal.width:
                raise Unanswered(f"{signal.variable} is {kind}; expected {signal.width} numbers")
            formats.append(TYPES[kind])
            places += range(column.start, column.stop)
            optional += [signal.optional] * signal.width
        self._struct = struct.Struct("".join(formats))
        self._places, self._optional = np.array(places), np.array(optional)

    def row(self, payload: bytes, received_monotonic_s: float) -> Array:
        """One row (WIDTH,). In it NaN means "not reported"; an optional value that is no number is inf. Raises Unanswered."""
        if len(payload) != self._struct.size:
            raise Unanswered(f"a row of {len(payload)} bytes; expected {self._struct.size}")
        values = np.array(self._struct.unpack(payload)[1:], float)
        values[np.isnan(values) & self._optional] = np.inf
        row = np.full(WIDTH, np.nan)
        row[self._places] = values
        row[COLUMN["host_monotonic_s"]] = received_monotonic_s
        return row


DONE = -1  # in place of the kind of an answer: none is expected any more


class Listening:
    """One connection, as a `Session` without a process. Nothing in it waits, unless `frames` is asked to."""

    printed = ""  # no library prints

    def __init__(self, host: str, rate_hz: float, port: int = PORT) -> None:
        """Begin to connect. What goes wrong comes as a message, like everything else."""
        self._host, self._rate_hz, self._port = host, rate_hz, port
        self._link: Link | None = None
        self._connect(SIGNALS)

    def send(self, word: str) -> None:
        """Without effect: a session that only receives is told nothing."""

    def end(self, patience_s: float = 0.0) -> int:  # noqa: ARG002 - there is no process to wait for
        """Close the connection; 0."""
        if self._link is not None:
            self._link.close()
            self._link = None
        return 0

    def wait(self, timeout_s: float) -> None:
        """Wait until `frames` has something, at most so long."""
        if self._link is not None:
            self._link.wait(timeout_s)

    def frames(self, timeout_s: float) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) that have come, oldest first; the last is a message `lost`. Raises SessionEnded after that."""
        if self._link is None:
            raise SessionEnded(ENDED())
        try:
            yield from self._received(self._link, timeout_s)
        except (OSError, struct.error, Unanswered) as error:
            self.end()
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            yield {"kind": "lost", "reason": CONNECTION_LOST(host=self._host, why=why).document()}

    def _connect(self, signals: tuple[Signal, ...]) -> None:
        self.end()
        self._signals, self._waiting = signals, bytearray()
        self._recipe: Recipe | None = None
        self._expected: int | None = None  # the kind of the answer that comes next; None: nothing was asked yet
        self._link = Link.to(self._host, self._port)

    def _received(self, link: Link, timeout_s: float) -> Iterator[Array]:
        if not link.wait(timeout_s):
            return
        now, data = time.monotonic(), link.read()
        if link.stands and self._expected is None:
            self._send(VERSION, struct.pack(">H", 2))
        self._waiting += data
        for kind, payload in take_packages(self._waiting, HEAD):
            if kind == ROW and self._recipe is not None:
                yield self._recipe.row(payload, now)
            elif kind == self._expected:
                self._answered(payload)
                if self._link is not link:  # it connects anew, and what came is of the connection before
                    return

    def _answered(self, payload: bytes) -> None:
        """Take the answer that was expected, and ask what follows it."""
        if self._expected == VERSION:
            if payload[:1] != b"\x01":
                raise Unanswered("the controller does not speak version 2 of the protocol")
            names = ",".join(signal.variable for signal in self._signals)
            self._send(OUTPUTS, struct.pack(">d", self._rate_hz) + names.encode())
        elif self._expected == OUTPUTS:
            recipe = Recipe(self._signals, payload)
            if needed := [signal.variable for signal in recipe.absent if not signal.optional]:
                raise Unanswered(f"the controller does not report {', '.join(needed)}")
            if recipe.absent:  # the whole recipe is refused: a new one without them
                self._connect(tuple(signal for signal in self._signals if signal not in recipe.absent))
                return
            self._recipe = recipe
            self._send(START, b"")
        else:
            if payload[:1] != b"\x01":
                raise Unanswered("the controller does not start to send")
            self._expected = DONE

    def _send(self, kind: int, payload: bytes) -> None:
        assert self._link is not None
        self._expected = kind
        self._link.send(packed(kind, payload))


ROWS = 13  # the accelerometer is averaged over so many: 0.1 s at 125 Hz


def observe(session: Listening, timeout_s: float) -> ArmState | None:
    """The state of the arm in the last of ROWS ticks, with the mean of their accelerometer readings; None where they do not all come.

    The session is ended. A row that repeats the time of the one before is no new tick: a controller that hangs is not in any state.
    """
    rows: list[Array] = []
    until = time.monotonic() + timeout_s
    try:
        while len(rows) < ROWS and (left_s := until - time.monotonic()) > 0.0:
            for frame in session.frames(left_s):
                if isinstance(frame, dict):
                    return None  # the connection was lost
                if not rows or frame[0] != rows[-1][0]:
                    rows.append(frame)
    except SessionEnded:
        return None
    finally:
        session.end()
    if len(rows) < ROWS:
        return None
    accelerometer = COLUMN["actual_tool_accelerometer"]
    last = rows[-1].copy()
    last[accelerometer] = np.mean([row[accelerometer] for row in rows[-ROWS:]], axis=0)
    return arm_state(last)
