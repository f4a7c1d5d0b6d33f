"""A disposable child process and its two pipes, seen from both ends.

ur-rtde segfaults and hangs on lost connections, and prints from C++ on the standard descriptors, so it lives in a
process that may be killed at any moment. The child's standard input stays open as a lifeline: its end means that the
parent is gone. Rows and messages come back on a pipe of their own.
"""

import contextlib
import ctypes
import fcntl
import json
import os
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np

from monitor.errors import MonitorError
from monitor.recording import Array

HEADER = struct.Struct("<BI")  # kind, length of the body
ROW, MESSAGE = 0, 1
LARGEST_BODY = 4096 - HEADER.size  # PIPE_BUF: a frame is written whole or not at all
PIPE_BYTES = 1 << 20  # about 14 s of rows: a busy parent does not stop the arm
STDERR_TAIL = 2000
PR_SET_PDEATHSIG = 1
PR_SET_TIMERSLACK = 29
REAL_TIME_PRIORITY = 10  # above everything ordinary, below what a kernel does for itself

EXIT_ORPHANED = 70
EXIT_PIPE = 71  # the parent does not read, or its end is closed


# --- the child's end --------------------------------------------------------------------------------------------


def begin() -> tuple[dict[str, Any], "Outbox", "Lifeline"]:
    """First thing in a child: bind its life to the parent's, read the job, open the way back."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the parent decides when and how the arm stops
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    lifeline = Lifeline()
    job = json.loads(lifeline.line())
    if os.getppid() != job["parent_pid"]:  # it died before prctl
        os._exit(EXIT_ORPHANED)
    return job, Outbox(job["pipe"]), lifeline


def real_time() -> bool:
    """Ask for real-time priority for this process and every thread that it will start; False where that is not permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
    except OSError:
        return False
    return True


def set_timer_slack(slack_s: float) -> None:
    """Let every sleep of this thread, and of those that it starts, last up to `slack_s` longer (0: as at the process's start).

    Without effect on real-time threads. ur-rtde's receiving thread looks for data every 0.1 ms while it waits: a tenth of a core, which
    who is in no hurry need not spend.
    """
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(int(slack_s * 1e9)), 0, 0, 0)


class Outbox:
    """Frames to the parent. Never blocks: a parent that does not read must not hold up the stream of targets."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd = fd

    def row(self, row: Array) -> None:
        """One row, as it is."""
        self._write(ROW, np.ascontiguousarray(row, dtype="<f8").tobytes())

    def message(self, kind: str, **content: Any) -> None:
        """One small JSON object."""
        text = content.get("text")
        if isinstance(text, str):
            content["text"] = text[:1000]
        self._write(MESSAGE, json.dumps({"kind": kind, **content}).encode())

    def _write(self, kind: int, body: bytes) -> None:
        if len(body) > LARGEST_BODY:
            raise ValueError(f"frame of {len(body)} bytes; at most {LARGEST_BODY}")
        try:
            os.write(self._fd, HEADER.pack(kind, len(body)) + body)
        except OSError:
            os._exit(EXIT_PIPE)


class Lifeline:
    """The child's standard input: the job, later single words, and its end when the parent is gone."""

    def __init__(self) -> None:
        self._poll = select.poll()
        self._poll.register(0, select.POLLIN | select.POLLHUP)
        self._waiting = b""

    def line(self) -> str:
        """The next line, however long it takes; leaves the process if there is none."""
        while b"\n" not in self._waiting:
            self._take()
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode()

    def word(self) -> str | None:
        """A line if one is there; leaves the process at once if the parent is gone."""
        if self._poll.poll(0):
            self._take()
        return self.line() if b"\n" in self._waiting else None

    def _take(self) -> None:
        data = os.read(0, 65536)
        if not data:
            os._exit(EXIT_ORPHANED)
        self._waiting += data


def leave(code: int) -> NoReturn:
    """End now: no destructor of ur-rtde runs, each would hold the interpreter for half a second or for ever."""
    os._exit(code)


# --- the parent's end -------------------------------------------------------------------------------------------


class ChildLost(MonitorError):
    """The child process ended without a last word."""


class Child:
    """One running child. The thread that makes it must outlive it: the kernel ties the death signal to that thread."""

    def __init__(self, module: str, job: dict[str, Any]) -> None:
        out, way_back = os.pipe()
        try:
            with contextlib.suppress(OSError):  # a smaller pipe works too
                fcntl.fcntl(way_back, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
            self._process = subprocess.Popen(
                [sys.executable, "-m", module],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[way_back],
                start_new_session=True,  # Ctrl-C is for the parent
                bufsize=0,
                # one small matrix at a time: a pool of threads would only disturb the pace
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        except OSError as error:
            os.close(out)
            raise ChildLost(f"{module}: cannot start a process: {error}") from None
        finally:
            os.close(way_back)
        os.set_blocking(out, False)
        self._pipe: int | None = out
        self._waiting = b""
        self._printed = b""
        self.send(json.dumps({**job, "parent_pid": os.getpid(), "pipe": way_back}))

    @property
    def pid(self) -> int:
        """Of the child."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    @property
    def printed(self) -> str:
        """The end of what the child and ur-rtde printed."""
        return self._printed.decode(errors="replace").strip()

    def send(self, line: str) -> None:
        """One line to the child. A child that is gone shows in `frames`."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(line.encode() + b"\n")

    def frames(self, timeout_s: float) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) and messages that have come, after waiting up to timeout_s for the first.

        Raises ChildLost once the pipe is at its end and everything in it has been delivered.
        """
        if self._pipe is None:
            raise ChildLost("the child process has ended")
        assert self._process.stdout is not None
        stdout = self._process.stdout.fileno()
        poll = select.poll()
        poll.register(self._pipe, select.POLLIN | select.POLLHUP)
        if not self._process.stdout.closed:
            poll.register(stdout, select.POLLIN)
        ended = False
        for fd, _ in poll.poll(timeout_s * 1000.0):
            data = os.read(fd, PIPE_BYTES)
            if fd == stdout:
                self._printed = (self._printed + data)[-STDERR_TAIL:]
            else:
                self._waiting += data
                ended = not data
        yield from self._cut()
        if ended:
            os.close(self._pipe)
            self._pipe = None
            raise ChildLost("the child process has ended")

    def _cut(self) -> Iterator[Array | dict[str, Any]]:
        data, at = self._waiting, 0
        whole = []
        while len(data) - at >= HEADER.size:
            kind, length = HEADER.unpack_from(data, at)
            body = data[at + HEADER.size : at + HEADER.size + length]
            if len(body) < length:
                break
            at += HEADER.size + length
            whole.append((kind, body))
        self._waiting = data[at:]
        for kind, body in whole:
            yield np.frombuffer(body, dtype="<f8").copy() if kind == ROW else json.loads(body)

    def end(self, patience_s: float = 0.0) -> int:
        """Reap the child, killed unless it leaves by itself within patience_s; returns its exit code."""
        until = time.monotonic() + patience_s
        while self._process.poll() is None and time.monotonic() < until:
            time.sleep(0.005)
        if self._process.poll() is None:
            self._process.kill()
        code = self._process.wait()
        if self._process.stdout is not None and not self._process.stdout.closed:
            os.set_blocking(self._process.stdout.fileno(), False)
            with contextlib.suppress(OSError):
                self._printed = (self._printed + (self._process.stdout.read() or b""))[-STDERR_TAIL:]
            self._process.stdout.close()
        if self._process.stdin is not None:
            self._process.stdin.close()
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        return code
