"""Computations in a process of their own, which ends with them: what they load and take does not stay in the service.

A daemon waits for days between two replays, beside many others on its host. What only a verdict needs (scipy, filterpy, pyarrow,
pandas, plotting) is loaded by a child of some seconds. A computation is a function of a module; arguments and results travel pickled.
"""

import logging
import os
import pickle
import select
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import Any, NoReturn, ParamSpec, Protocol, TypeVar

from monitor.acquire.child import bind_to_parent, leave, leave_if_orphaned
from monitor.errors import MonitorError
from monitor.service.systemd import log_to_stderr

P = ParamSpec("P")
T = TypeVar("T")

log = logging.getLogger(__name__)

CHILD = "from monitor.service.computing import compute_and_leave; compute_and_leave()"
LENGTH = struct.Struct("<Q")  # before each pickled result
RESULT, FAILED = 0, 1
LOOK_EVERY_S = 1.0  # while it waits for a child, the caller is told so often that all is well
LONGEST_S = 1800.0  # a computation that takes longer has gone wrong: the longest, years of replays judged anew, takes minutes


class ComputingFailed(MonitorError):
    """The process that computes ended without a result: it was killed, ran out of memory, or met a fault of this program."""


class Compute(Protocol):
    """How a computation is done: here, or in a process of its own."""

    def __call__(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result. Raises what the function raises of this program's errors, and ComputingFailed."""

    def steps(self, function: Callable[P, Generator[T, None, None]], *args: P.args, **kwargs: P.kwargs) -> Generator[T, None, None]:
        """The results of a generator, each as soon as it is there. Raises as the call."""


class Here:
    """In this process: for commands, studies and tests, which have loaded everything or end soon."""

    def __call__(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The function's result."""
        return function(*args, **kwargs)

    def steps(self, function: Callable[P, Generator[T, None, None]], *args: P.args, **kwargs: P.kwargs) -> Generator[T, None, None]:
        """The generator's results."""
        return function(*args, **kwargs)


HERE = Here()


class Apart:
    """In a child of this process, which does not outlive it. The thread that calls must not end before the child."""

    def __init__(self, alive: Callable[[], None] = lambda: None) -> None:
        """`alive` is called often while a child computes."""
        self._alive = alive

    def __call__(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The function's result."""
        (result,) = self._results((function, args, kwargs, False))
        return result  # type: ignore[no-any-return]

    def steps(self, function: Callable[P, Generator[T, None, None]], *args: P.args, **kwargs: P.kwargs) -> Generator[T, None, None]:
        """The generator's results."""
        return self._results((function, args, kwargs, True))

    def _results(self, job: tuple[Any, ...]) -> Generator[Any, None, None]:
        child, out = _started()
        with open(out, "rb", buffering=0) as results:
            try:
                assert child.stdin is not None
                with suppress(BrokenPipeError):  # how it ended is told below
                    child.stdin.write(pickle.dumps(job, pickle.HIGHEST_PROTOCOL))
                    child.stdin.close()
                yield from self._received(child, results.fileno())
            finally:
                child.kill()
                child.wait()
                with suppress(BrokenPipeError):
                    child.stdin.close()  # type: ignore[union-attr]

    def _received(self, child: "subprocess.Popen[bytes]", results: int) -> Generator[Any, None, None]:
        poll = select.poll()
        poll.register(results, select.POLLIN | select.POLLHUP)
        waiting, until = bytearray(), time.monotonic() + LONGEST_S
        while True:
            self._alive()
            if not poll.poll(1000.0 * LOOK_EVERY_S):
                if time.monotonic() > until:
                    raise ComputingFailed(f"the computing process had not ended after {LONGEST_S:g} s")
                continue
            data = os.read(results, 1 << 20)
            if not data:
                break
            waiting += data
            while len(waiting) >= LENGTH.size and len(waiting) - LENGTH.size >= (size := LENGTH.unpack_from(waiting)[0]):
                kind, value = pickle.loads(bytes(waiting[LENGTH.size : LENGTH.size + size]))  # noqa: S301 - from our own child
                del waiting[: LENGTH.size + size]
                if kind == FAILED:
                    raise value
                yield value
        code = child.wait()
        if code:
            raise ComputingFailed(f"the computing process was ended by signal {-code}" if code < 0 else "the computing process ended early")


def _started() -> tuple["subprocess.Popen[bytes]", int]:
    """A computing process, and the end of the pipe by which its results come. Raises ComputingFailed."""
    try:
        out, way_back = os.pipe()
        try:
            child = subprocess.Popen(
                [sys.executable, "-c", CHILD, str(way_back), str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=2,  # what a library prints goes to the log
                pass_fds=[way_back],
                start_new_session=True,  # Ctrl-C is for the parent
            )
        except OSError:
            os.close(out)
            raise
        finally:
            os.close(way_back)
    except OSError as error:
        raise ComputingFailed(f"no process can be started: {error.strerror}") from None
    return child, out


def compute_and_leave() -> NoReturn:
    """The child's life: compute what standard input says, send the results, end. The arguments name their pipe, and the parent."""
    bind_to_parent()
    leave_if_orphaned(int(sys.argv[2]))
    log_to_stderr()
    with open(int(sys.argv[1]), "wb") as results:

        def send(kind: int, value: Any) -> None:
            data = pickle.dumps((kind, value), pickle.HIGHEST_PROTOCOL)
            results.write(LENGTH.pack(len(data)) + data)
            results.flush()

        try:
            function, args, kwargs, in_steps = pickle.load(sys.stdin.buffer)  # noqa: S301 - from our own parent
            for result in function(*args, **kwargs) if in_steps else (function(*args, **kwargs),):
                send(RESULT, result)
        except MonitorError as error:
            send(FAILED, error)
        except Exception as error:  # the parent says what was not computed; the log says why
            log.exception("a computation met a fault")
            send(FAILED, ComputingFailed(f"internal: {type(error).__name__}: {error}"))
    leave(0)  # no destructor of a library holds it up
