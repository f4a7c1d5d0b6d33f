"""A child process: the frames in which it reports, its parent's side, and its own side.

A maker's library may crash, hang and print, so it lives in a process that may be killed at any moment. The child's standard input is its
lifeline: when it ends, the parent is gone. Rows and messages go back through a pipe of their own; the child never waits for its parent.
"""

import base64
import contextlib
import ctypes
import fcntl
import json
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any, NoReturn

import numpy as np

from monitor.acquire.driver import SessionEnded
from monitor.reason import ANYTHING, Sentence
from monitor.recording import Array

NO_PROCESS = Sentence("no_process", "{module}: cannot start a process: {why}")
ENDED = Sentence("child_process_ended", "the child process has ended")
HEADER = struct.Struct("<BI")  # kind, length of the body in bytes
ROW, MESSAGE, SEEN = 0, 1, 2
LARGEST_BODY = 4096 - HEADER.size  # bytes; the kernel writes up to PIPE_BUF = 4096 bytes whole or not at all
LONGEST_TEXT = 1000  # characters of a reason's text where the whole reason does not fit into one frame


def row_frame(row: Array, kind: int = ROW) -> bytes:
    """The frame of one row (WIDTH,), as float64 in little-endian order. kind : SEEN: it is none of the play, but a sign of life."""
    return _frame(kind, np.ascontiguousarray(row, dtype="<f8").tobytes())


def message_frame(kind: str, content: dict[str, Any]) -> bytes:
    """The frame of one message: a JSON object with its kind. Of a `reason` too long for a frame, the beginning of its text is sent."""
    body = json.dumps({"kind": kind, **content}).encode()
    if len(body) > LARGEST_BODY and "reason" in content:
        short = ANYTHING(text=content["reason"]["text"][:LONGEST_TEXT]).document()
        body = json.dumps({"kind": kind, **content, "reason": {**short, "parameters": {}}}).encode()
    return _frame(MESSAGE, body)


def _frame(kind: int, body: bytes) -> bytes:
    if len(body) > LARGEST_BODY:
        raise ValueError(f"frame of {len(body)} bytes; at most {LARGEST_BODY}")
    return HEADER.pack(kind, len(body)) + body


class FrameReader:
    """Cuts a stream of bytes into frames; bytes of an incomplete frame wait for the rest."""

    def __init__(self) -> None:
        self._waiting = b""

    def frames(self, data: bytes) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) and messages that are complete with this data, oldest first. `alive` has its `row` where it was sent with one."""
        data, at = self._waiting + data, 0
        complete = []
        while len(data) - at >= HEADER.size:
            kind, length = HEADER.unpack_from(data, at)
            body = data[at + HEADER.size : at + HEADER.size + length]
            if len(body) < length:
                break
            at += HEADER.size + length
            complete.append((kind, body))
        self._waiting = data[at:]
        for kind, body in complete:
            if kind == MESSAGE:
                yield json.loads(body)
            else:
                row = np.frombuffer(body, dtype="<f8").copy()
                yield row if kind == ROW else {"kind": "alive", "row": row}


PIPE_BYTES = 1 << 20  # about 14 s of rows at 125 Hz: a busy parent does not stop the arm
PRINTED_TAIL = 2000  # bytes of the child's output that are kept


class Child:
    """One running child, as a `Session`. The thread that makes it must outlive it: the kernel ties the death signal to that thread."""

    def __init__(self, module: str, job: object) -> None:
        """Start `python -m module` and send it the job, pickled. Raises SessionEnded where no process can be started."""
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
                # the child multiplies small matrices one at a time: a pool of threads would only disturb its cycle
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        except OSError as error:
            os.close(out)
            raise SessionEnded(NO_PROCESS(module=module, why=str(error))) from None
        finally:
            os.close(way_back)
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # so that the job fits, and this process waits for no interpreter to start
            fcntl.fcntl(self._process.stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.set_blocking(out, False)
        self._pipe: int | None = out
        self._reader = FrameReader()
        self._printed = b""
        self.send(base64.b64encode(pickle.dumps((os.getpid(), way_back, job))).decode())

    @property
    def printed(self) -> str:
        """The end of what the child and ur-rtde printed."""
        return self._printed.decode(errors="replace").strip()

    def send(self, word: str) -> None:
        """One line to the child; without effect where the child has ended, which `frames` reports."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(word.encode() + b"\n")

    def wait(self, timeout_s: float) -> None:
        """Wait until `frames` has something, at most so long."""
        if self._pipe is not None:
            select.select([self._pipe], [], [], timeout_s)

    def frames(self, timeout_s: float) -> Iterator[Array | dict[str, Any]]:
        """Rows (WIDTH,) and messages that have come, after waiting up to timeout_s for the first.

        Raises SessionEnded once the pipe is at its end and everything in it has been delivered.
        """
        if self._pipe is None:
            raise SessionEnded(ENDED())
        assert self._process.stdout is not None
        stdout = self._process.stdout.fileno()
        poll = select.poll()
        poll.register(self._pipe, select.POLLIN | select.POLLHUP)
        if not self._process.stdout.closed:
            poll.register(stdout, select.POLLIN)
        received, ended = b"", False
        for fd, _ in poll.poll(timeout_s * 1000.0):
            data = os.read(fd, PIPE_BYTES)
            if fd == stdout:
                self._printed = (self._printed + data)[-PRINTED_TAIL:]
            else:
                received, ended = data, not data
        yield from self._reader.frames(received)
        if ended:
            os.close(self._pipe)
            self._pipe = None
            raise SessionEnded(ENDED())

    def end(self, patience_s: float = 0.0) -> int:
        """Reap the child, killed unless it leaves by itself within patience_s. Returns its exit code, or minus the signal's number."""
        until = time.monotonic() + patience_s
        while self._process.poll() is None and time.monotonic() < until:
            time.sleep(0.005)
        if self._process.poll() is None:
            self._process.kill()
        code = self._process.wait()
        if self._process.stdout is not None and not self._process.stdout.closed:
            os.set_blocking(self._process.stdout.fileno(), False)
            with contextlib.suppress(OSError):
                self._printed = (self._printed + (self._process.stdout.read() or b""))[-PRINTED_TAIL:]
            self._process.stdout.close()
        if self._process.stdin is not None:
            self._process.stdin.close()
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        return code


PR_SET_PDEATHSIG = 1  # option of prctl(2)
REAL_TIME_PRIORITY = 10  # above every ordinary process, below the kernel's own real-time threads

ALIVE, WAITING = (message_frame(kind, {}) for kind in ("alive", "waiting"))  # made once: they are sent often

EXIT_ORPHANED = 70  # the parent is gone
EXIT_PIPE = 71  # the parent does not read, or its end of the pipe is closed


def begin() -> tuple[Any, "Outbox", "Lifeline"]:
    """Bind this process's life to its parent's and read the job: returns the job, the pipe to the parent and standard input.

    A child process calls it before anything else. From then on the system kills this process when its parent ends, and the signals of a
    terminal (SIGINT, SIGTERM) have no effect. Leaves the process with EXIT_ORPHANED where the parent has ended already.
    """
    bind_to_parent()
    lifeline = Lifeline()
    parent_pid, pipe, job = pickle.loads(base64.b64decode(lifeline.line()))  # noqa: S301 - from our own parent
    leave_if_orphaned(parent_pid)
    return job, Outbox(pipe), lifeline


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

    def alive(self, row: Array | None) -> None:
        """Send a sign of life with which all is in order, with the newest row (WIDTH,), if any; leaves the process as `row`."""
        self._write(ALIVE if row is None else row_frame(row, SEEN))

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
