"""The parent's side of a child process: start it, read its frames, send it words, end and reap it."""

import contextlib
import fcntl
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

from monitor.acquire.driver import SessionEnded
from monitor.acquire.ur.frames import FrameReader
from monitor.recording import Array

PIPE_BYTES = 1 << 20  # about 14 s of rows at 125 Hz: a busy parent does not stop the arm
PRINTED_TAIL = 2000  # bytes of the child's output that are kept


class Child:
    """One running child, as a `Session`. The thread that makes it must outlive it: the kernel ties the death signal to that thread."""

    def __init__(self, module: str, job: dict[str, Any]) -> None:
        """Start `python -m module` and send it the job. Raises SessionEnded where no process can be started."""
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
            raise SessionEnded(f"{module}: cannot start a process: {error}") from None
        finally:
            os.close(way_back)
        os.set_blocking(out, False)
        self._pipe: int | None = out
        self._reader = FrameReader()
        self._printed = b""
        self.send(json.dumps({**job, "parent_pid": os.getpid(), "pipe": way_back}))

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
            raise SessionEnded("the child process has ended")
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
            raise SessionEnded("the child process has ended")

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
