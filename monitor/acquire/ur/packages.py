"""Below both protocols over plain sockets: the address of a host that may be a name, and packages out of bytes that come in pieces."""

import errno
import ipaddress
import socket
import struct
import threading
from collections.abc import Iterator
from concurrent import futures


def is_address(host: str) -> bool:
    """Whether this is an address already."""
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        return False
    return True


def looked_up(host: str) -> "futures.Future[str]":
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
