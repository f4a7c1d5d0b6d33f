"""The child process's own side: its life is bound to its parent's, and it talks to the parent without ever waiting for it.

ur-rtde crashes and hangs on lost connections and prints from C++, so it lives in a process that may be killed at any moment. The child's
standard input is its lifeline: when it ends, the parent is gone. Rows and messages go back through a pipe of their own.
"""

import ctypes
import json
import os
import select
import signal
from typing import Any, NoReturn

from monitor.acquire.ur.frames import message_frame, row_frame
from monitor.recording import Array

PR_SET_PDEATHSIG = 1  # option of prctl(2)
REAL_TIME_PRIORITY = 10  # above every ordinary process, below the kernel's own real-time threads

ALIVE, WAITING = (message_frame(kind, {}) for kind in ("alive", "waiting"))  # made once: one of them is sent in every tick

EXIT_ORPHANED = 70  # the parent is gone
EXIT_PIPE = 71  # the parent does not read, or its end of the pipe is closed


def begin() -> tuple[dict[str, Any], "Outbox", "Lifeline"]:
    """Bind this process's life to its parent's and read the job: returns the job, the pipe to the parent and standard input.

    A child process calls it before anything else. From then on the system kills this process when its parent ends, and the signals of a
    terminal (SIGINT, SIGTERM) have no effect. Leaves the process with EXIT_ORPHANED where the parent has ended already.
    """
    bind_to_parent()
    lifeline = Lifeline()
    job = json.loads(lifeline.line())
    leave_if_orphaned(job["parent_pid"])
    return job, Outbox(job["pipe"]), lifeline


def bind_to_parent() -> None:
    """Ignore a terminal's signals from now on, because the parent decides; the system kills this process when its parent ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def leave_if_orphaned(parent_pid: int) -> None:
    """Leave the process where that parent died before `bind_to_parent`."""
    if os.getppid() != parent_pid:
        os._exit(EXIT_ORPHANED)


def request_real_time() -> bool:
    """Ask for real-time priority for this process and every thread that it will start; False where the system does not permit it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
    except OSError:
        return False
    return True


class Outbox:
    """Frames to the parent. Writing never waits: a parent that does not read must not delay the targets."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd = fd

    def row(self, row: Array) -> None:
        """Send one row (WIDTH,); leaves the process where the pipe is full or closed."""
        self._write(row_frame(row))

    def message(self, kind: str, **content: Any) -> None:
        """Send one small message; leaves the process where the pipe is full or closed."""
        self._write(message_frame(kind, content))

    def alive(self) -> None:
        """Send a sign of life with which all is in order; leaves the process where the pipe is full or closed."""
        self._write(ALIVE)

    def waiting(self) -> None:
        """Send a sign of life while the controller's next row is late; leaves the process where the pipe is full or closed."""
        self._write(WAITING)

    def _write(self, frame: bytes) -> None:
        try:
            os.write(self._fd, frame)
        except OSError:
            os._exit(EXIT_PIPE)


class Lifeline:
    """The child's standard input: first the job, later single words; its end means that the parent is gone."""

    def __init__(self) -> None:
        self._poll = select.poll()
        self._poll.register(0, select.POLLIN | select.POLLHUP)
        self._waiting = b""

    def line(self) -> str:
        """The next line, however long it takes; leaves the process if the parent is gone."""
        while b"\n" not in self._waiting:
            self._take()
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode()

    def word(self) -> str | None:
        """The next line if one is there, else None; leaves the process at once if the parent is gone."""
        if self._poll.poll(0):
            self._take()
        return self.line() if b"\n" in self._waiting else None

    def _take(self) -> None:
        data = os.read(0, 65536)
        if not data:
            os._exit(EXIT_ORPHANED)
        self._waiting += data


def leave(code: int) -> NoReturn:
    """End this process now. No destructor of ur-rtde runs: each may block for half a second or for ever."""
    os._exit(code)
