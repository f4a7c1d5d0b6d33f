"""Below both protocols over plain sockets: a connection that nobody waits for, and packages out of bytes that come in pieces."""

import errno
import ipaddress
import os
import select
import socket
import struct
import threading
from collections.abc import Iterator
from concurrent import futures
from typing import Self

READ_BYTES = 65_536
MOST_READ = 1 << 20  # bytes in one call: whoever floods a port must not hold the caller up


class Link:
    """A TCP connection that is opened and read without waiting. Every method but `wait` returns at once."""

    def __init__(self, connection: socket.socket) -> None:
        """Read this connection, which stands already."""
        connection.setblocking(False)
        self._socket = connection
        self.ended = False  # nothing comes after what `read` has returned
        self._port: int | None = None  # while it connects
        self._failed = 0  # what the kernel said when the connection began
        self._looked_up: futures.Future[str] | None = None  # the address of a host's name, while it is asked for

    @classmethod
    def to(cls, host: str, port: int) -> Self:
        """Begin to connect. What goes wrong is raised by `read`."""
        link = cls(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        link._port = port
        if _is_address(host):
            link._failed = link._socket.connect_ex((host, port))
        else:  # a name server may take long to answer
            link._looked_up = _looked_up(host)
        return link

    @property
    def stands(self) -> bool:
        """Whether `read` has seen it connected."""
        return self._port is None

    @property
    def looks_up(self) -> bool:
        """Whether a name server has not answered yet."""
        return self._looked_up is not None

    def wait(self, timeout_s: float) -> bool:
        """Wait until `read` has something to do, at most so long; whether it has."""
        if self._looked_up is not None:
            futures.wait([self._looked_up], timeout_s)
            return self._looked_up.done()
        poll = select.poll()
        poll.register(self._socket, select.POLLIN if self.stands else select.POLLOUT)
        return bool(poll.poll(1000.0 * timeout_s))

    def read(self) -> bytes:
        """What has come; nothing while it connects. Raises OSError where it has ended, or cannot be opened."""
        data = bytearray()
        while self._connected() and not self.ended and len(data) < MOST_READ:
            try:
                part = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                break
            self.ended = not part
            data += part
        if self.ended and not data:
            raise OSError("the controller closed the connection")
        return bytes(data)

    def send(self, data: bytes) -> None:
        """Send a few bytes. Raises OSError."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close it."""
        self._socket.close()

    def _connected(self) -> bool:
        """Go on connecting; whether it stands. Raises OSError."""
        if self._port is None:
            return True
        if self._looked_up is not None:
            if not self._looked_up.done():
                return False
            found, self._looked_up = self._looked_up, None
            self._failed = self._socket.connect_ex((found.result(), self._port))
        if not self.wait(0.0):
            return False
        failed = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if self._failed not in {0, errno.EINPROGRESS}:
            failed = self._failed
        if failed:
            raise OSError(failed, os.strerror(failed))
        self._port = None
        return True


def _is_address(host: str) -> bool:
    """Whether this is an address already."""
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        return False
    return True


def _looked_up(host: str) -> "futures.Future[str]":
    """The address of a name, or the OSError of its name server, once it has answered."""
    found: futures.Future[str] = futures.Future()
    threading.Thread(target=_look_up, args=(host, found), daemon=True, name="look-up").start()
    return found


def _look_up(host: str, found: "futures.Future[str]") -> None:
    try:
        found.set_result(socket.gethostbyname(host))
    except (OSError, UnicodeError) as error:  # a name that is no name is a UnicodeError
        found.set_exception(OSError(errno.EADDRNOTAVAIL, f"{host}: {error}"))


LONGEST = 65_536  # bytes; a state on the primary port has about 1500


def take_packages(waiting: bytearray, head: struct.Struct) -> Iterator[tuple[int, bytes]]:
    """Type and payload of every package that is complete; each is taken off `waiting`. head : length with this head, type.

    Raises OSError at a length that no package has.
    """
    while len(waiting) >= head.size:
        length, kind = head.unpack_from(waiting)
        if not head.size <= length <= LONGEST:
            raise OSError("a package without a head")
        if len(waiting) < length:
            return
        payload = bytes(waiting[head.size : length])
        del waiting[:length]
        yield kind, payload
