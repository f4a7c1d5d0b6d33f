"""The sockets that ur-rtde opened, found by their peer: ur-rtde itself offers no way to them."""

import contextlib
import os
import select
import socket
import stat
from collections.abc import Iterator

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999


def connected_to(host: str, port: int) -> Iterator[socket.socket]:
    """Copies of the sockets of this process that are connected to that address; closing a copy does not close the connection."""
    for name in os.listdir("/proc/self/fd"):
        fd = int(name)
        try:
            if not stat.S_ISSOCK(os.fstat(fd).st_mode):
                continue
            copy = socket.socket(fileno=os.dup(fd))
        except OSError:  # closed meanwhile
            continue
        try:
            if copy.family == socket.AF_INET and copy.getpeername() == (host, port):
                yield copy
                continue
        except OSError:  # not connected any more
            pass
        copy.close()


class PeerWatch:
    """Tells whether the controller has closed or reset one of the connections to it, before a call of ur-rtde blocks on it."""

    def __init__(self, host: str, port: int) -> None:
        self._kept = tuple(connected_to(host, port))  # copies: ur-rtde may close its own at any time
        self._poll = select.poll()
        for connection in self._kept:
            self._poll.register(connection, select.POLLRDHUP)  # errors and resets are always reported

    @property
    def ended(self) -> bool:
        """Whether one of them has come to its end, or none stood any more when this watch began."""
        return not self._kept or bool(self._poll.poll(0))


def send_at_once(host: str) -> None:
    """Let every target leave at once. ur-rtde asks for that too, but loses the option when it connects.

    Without it the kernel holds a small packet back until the controller has acknowledged the one before.
    """
    for connection in connected_to(host, RTDE_PORT):
        with contextlib.suppress(OSError), connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def end_dashboard(host: str) -> None:
    """End ur-rtde's conversation with the dashboard server: it would use it to stop a program that is not its own."""
    for connection in connected_to(host, DASHBOARD_PORT):
        with contextlib.suppress(OSError), connection:
            connection.shutdown(socket.SHUT_RDWR)


def end_scripts(host: str) -> None:
    """Send no more on the connection that carried the control program: from now on no program can be started from here."""
    for connection in connected_to(host, SCRIPT_PORT):
        with contextlib.suppress(OSError), connection:
            connection.shutdown(socket.SHUT_WR)
