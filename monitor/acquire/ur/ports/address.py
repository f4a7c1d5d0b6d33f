"""The address of a host that may be a name: a name server may take long to answer, and nobody waits for it."""

import errno
import ipaddress
import socket
import threading
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
