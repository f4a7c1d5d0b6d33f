"""Which programs a controller starts and ends, by name, and the mistake that ended one: its primary port tells it, and is only read.

The layout is that of the manufacturer's guide to the client interfaces: a robot message (type 20) of the kind key message (7) has a code,
an argument, a title with its length before it, and a text. The title is PROGRAM_XXX_STARTED or PROGRAM_XXX_STOPPED, and the text is the
name of the program; of a script, the name in its first line. The time in such a message may be zero. A runtime exception (kind 10) has a
line, a column and a text.
"""

import socket
import struct
from typing import NamedTuple, Self

from monitor.acquire.ur.ports.packages import take_packages
from monitor.acquire.ur.ports.primary import HEAD, PORT
from monitor.acquire.ur.ports.reported_errors import MESSAGE, READ_BYTES, ROBOT_MESSAGE

KEY_MESSAGE, RUNTIME_EXCEPTION = 7, 10
PLACE = struct.Struct(">ii")  # line and column of the script
KEY = struct.Struct(">iiB")  # code, argument, length of the title
STARTED, STOPPED = b"PROGRAM_XXX_STARTED", b"PROGRAM_XXX_STOPPED"
CONNECT_S = 0.5  # a controller answers within some milliseconds
READS = 16  # in one call, at most: whoever floods this port must not hold the caller up


class ProgramMessage(NamedTuple):
    """A program has started or ended."""

    started: bool
    name: str


class ProgramMessages:
    """A connection to the primary port that is opened once, and read without waiting. Where it is lost, nothing more is told."""

    def __init__(self, connection: socket.socket | None = None) -> None:
        """Read this connection; None: nothing is ever told."""
        self._socket, self._waiting = connection, bytearray()
        self.running: str | None = None  # the program that was told to have started last, until it is told to have ended
        self.mistake = ""  # the last runtime exception; empty: none was told
        if connection is not None:
            connection.setblocking(False)

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
        return self._socket is not None

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
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _messages(self) -> list[ProgramMessage]:
        """What has come since the last call, oldest first; mistakes are noted."""
        found: list[ProgramMessage] = []
        try:
            for _ in range(READS):
                if self._socket is None:
                    break
                data = self._socket.recv(READ_BYTES)
                if not data:
                    raise ConnectionResetError
                self._waiting += data
                for kind, message in take_packages(self._waiting, HEAD):
                    if kind != ROBOT_MESSAGE:
                        continue
                    if (told := program_message(message)) is not None:
                        found.append(told)
                    self.mistake = mistake(message) or self.mistake
        except BlockingIOError:
            pass
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
