"""RTDE over a plain socket: the software's version, and a few rows of variables that ur-rtde asks for and offers no reading of.

Nothing moves by it.

The protocol is version 2 of the manufacturer's Real-Time Data Exchange guide: version, output recipe, start, then rows.
"""

import socket
import struct
import time
from collections.abc import Iterator

import numpy as np

from monitor.acquire.ur.ports.packages import take_packages
from monitor.errors import RobotUnreachable
from monitor.recording import Array

PORT = 30004
HEAD = struct.Struct(">HB")  # length with this head, type
VERSION, OUTPUTS, START, ROW, SOFTWARE = ord("V"), ord("O"), ord("S"), ord("U"), ord("v")
NUMBERS = struct.Struct(">4I")  # major, minor, bugfix, build
VECTOR6D = struct.Struct(">6d")
PATIENCE_S = 5.0  # for a whole conversation: a controller answers within some milliseconds, a busy host or network takes seconds


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
            send(connection, VERSION, struct.pack(">H", 2))
            _answer(packages, VERSION)
            send(connection, OUTPUTS, struct.pack(">d", rate_hz) + ",".join(variables).encode())
            recipe = _answer(packages, OUTPUTS)
            if recipe[1:].decode("ascii", "replace").split(",") != [kind] * len(variables):
                return None
            send(connection, START, b"")
            _answer(packages, START)
            return [_answer(packages, ROW)[1:] for _ in range(count)]
    except (OSError, struct.error) as error:
        raise RobotUnreachable(f"{host}: RTDE on port {PORT}: {error}") from None


def software_of(host: str, timeout_s: float = PATIENCE_S) -> str | None:
    """The version of the controller's software, for example "10.12.0.5"; None where it does not answer as the protocol says."""
    until = time.monotonic() + timeout_s
    try:
        with socket.create_connection((host, PORT), timeout=timeout_s) as connection:
            send(connection, SOFTWARE, b"")
            numbers = NUMBERS.unpack_from(_answer(_packages(connection, until), SOFTWARE))
    except (OSError, struct.error):
        return None
    return ".".join(map(str, numbers))


def send(connection: socket.socket, kind: int, payload: bytes) -> None:
    """Send one package."""
    connection.sendall(HEAD.pack(HEAD.size + len(payload), kind) + payload)


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
