"""Real-time priority for a simulated arm and for the process that sends its targets, where the system permits it.

A replay ends as `late` where one of the two gets no processor time for some tens of milliseconds, as it must. Which other processes a
machine has is not what the tests of a replay ask. Both sleep for most of each tick, so that they hold up nobody.
"""

import os
import threading
from contextlib import suppress
from typing import Any

from monitor.acquire.child import Child

ARM, STREAM = 20, 19  # of SCHED_RR: the controller goes before its client, both before whatever else has such a priority
STREAMS = "monitor.acquire.ur.stream"
wanted = False  # for what this process starts from now on
_begin = Child.__init__


def give(pid: int, priority: int) -> None:
    """Real-time priority for a process, and for the threads that it will start; nothing where the system permits none."""
    with suppress(OSError, AttributeError):  # AttributeError: not Linux
        os.sched_setscheduler(pid, os.SCHED_RR, os.sched_param(priority))


def permitted() -> bool:
    """Whether the system would: tried by a thread that ends."""
    found = []

    def ask() -> None:
        give(0, STREAM)
        found.append(os.sched_getscheduler(0) == os.SCHED_RR)

    if hasattr(os, "SCHED_RR"):
        thread = threading.Thread(target=ask)
        thread.start()
        thread.join()
    return found == [True]


def _begin_preferred(child: Child, module: str, job: dict[str, Any]) -> None:
    _begin(child, module, job)
    if wanted and module == STREAMS:
        give(child._process.pid, STREAM)


Child.__init__ = _begin_preferred  # type: ignore[method-assign]
