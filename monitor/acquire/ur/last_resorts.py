"""What ends the streaming process when in doubt, and what it can know of ur-rtde's own sockets.

The dead-man timer: a call of ur-rtde may block for minutes, and a machine may stop this process for a while. In both cases the arm has
stopped by the time that the process goes on, and the process must not send another target then. A thread could not see to that: it needs
the interpreter, which may be busy. So the kernel sends SIGALRM, whose default disposition ends the process before one more instruction of
it runs.

No new connection: ur-rtde reconnects by itself when a connection breaks off, and the arm would move again with a program that nobody
watches. So once both connections stand and before the control program is sent, a seccomp filter forbids socket(2) and connect(2) to every
thread of this process. Open sockets, pipes and files go on as before. The process cannot take the filter back. Under systemd the service
must permit the system call `seccomp`, which is not part of @system-service; `prctl` is.
"""

import contextlib
import ctypes
import os
import platform
import select
import signal
import socket
import stat
import struct
from collections.abc import Iterator
from typing import NamedTuple


def end_this_process_on_alarm() -> None:
    """Let SIGALRM end this process, also where the parent had it blocked or ignored."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})


def report_within(seconds: float) -> None:
    """End this process unless this function is called again within so many seconds; 0 takes the timer away."""
    signal.setitimer(signal.ITIMER_REAL, seconds)


PR_SET_NO_NEW_PRIVS = 38  # option of prctl(2); without it only root may set a filter
SET_MODE_FILTER, GET_ACTION_AVAIL = 1, 2  # operations of seccomp(2)
TSYNC = 1  # the filter holds for every thread of the process: it is ur-rtde's own thread that reconnects
RETURN_ALLOW, RETURN_KILL_PROCESS = 0x7FFF_0000, 0x8000_0000
LOAD_WORD, JUMP_EQUAL, JUMP_GREATER_EQUAL, RETURN = 0x20, 0x15, 0x35, 0x06  # of the classic Berkeley packet filter
NUMBER_AT, ARCHITECTURE_AT = 0, 4  # offsets in the kernel's struct seccomp_data
X32_BIT = 0x4000_0000  # numbers of x86-64's second table of system calls begin here


class Numbers(NamedTuple):
    """The numbers of one architecture, from the kernel's own tables."""

    architecture: int  # AUDIT_ARCH_…
    socket: int
    connect: int
    seccomp: int


NUMBERS = {
    "x86_64": Numbers(architecture=0xC000_003E, socket=41, connect=42, seccomp=317),
    "aarch64": Numbers(architecture=0xC000_00B7, socket=198, connect=203, seccomp=277),
}


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_void_p))


def filter_program(numbers: Numbers) -> bytes:
    """The filter: socket, connect and every call of another architecture end the process; all else is allowed."""
    jumps = (  # instruction, value, instructions to skip if it holds, and if not
        (LOAD_WORD, ARCHITECTURE_AT, 0, 0),
        (JUMP_EQUAL, numbers.architecture, 0, 4),
        (LOAD_WORD, NUMBER_AT, 0, 0),
        (JUMP_GREATER_EQUAL, X32_BIT, 2, 0),
        (JUMP_EQUAL, numbers.socket, 1, 0),
        (JUMP_EQUAL, numbers.connect, 0, 1),
        (RETURN, RETURN_KILL_PROCESS, 0, 0),
        (RETURN, RETURN_ALLOW, 0, 0),
    )
    return b"".join(struct.pack("=HBBI", code, holds, fails, value) for code, value, holds, fails in jumps)


def forbid_new_sockets() -> str | None:
    """Set the filter for the whole process. Returns None where it holds from now on, else why it cannot be set."""
    numbers = NUMBERS.get(platform.machine())
    if numbers is None:
        return f"no table of system calls for {platform.machine()}; known are {', '.join(NUMBERS)}"
    if ctypes.sizeof(ctypes.c_void_p) != 8:
        return "a 32-bit process"
    libc = ctypes.CDLL(None, use_errno=True)
    libc.syscall.restype = ctypes.c_long
    action = ctypes.c_uint32(RETURN_KILL_PROCESS)
    if libc.syscall(ctypes.c_long(numbers.seccomp), ctypes.c_uint(GET_ACTION_AVAIL), ctypes.c_uint(0), ctypes.byref(action)) != 0:
        return f"seccomp is not available: {os.strerror(ctypes.get_errno())}"
    if libc.prctl(PR_SET_NO_NEW_PRIVS, ctypes.c_ulong(1), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0)) != 0:
        return f"prctl(PR_SET_NO_NEW_PRIVS): {os.strerror(ctypes.get_errno())}"
    code = filter_program(numbers)
    instructions = ctypes.create_string_buffer(code, len(code))
    program = _Program(len(code) // 8, ctypes.cast(instructions, ctypes.c_void_p))
    result = libc.syscall(ctypes.c_long(numbers.seccomp), ctypes.c_uint(SET_MODE_FILTER), ctypes.c_uint(TSYNC), ctypes.byref(program))
    if result < 0:
        return f"seccomp refuses the filter: {os.strerror(ctypes.get_errno())}"
    if result > 0:
        return f"seccomp cannot set the filter for thread {result}"
    return None


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
