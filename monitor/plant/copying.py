"""The threads that copy histories: each arm at most once at a time, several arms side by side. I/O."""

import itertools
import logging
import queue
import threading
from collections.abc import Callable
from typing import NamedTuple

from monitor.errors import BusError, StoreError
from monitor.plant.database import Database
from monitor.plant.ingest import Known
from monitor.plant.links import ArmName, Link
from monitor.plant.pull import CannotCopy, pull

log = logging.getLogger(__name__)


STOP, SOON, LATER = range(3)  # an arm that does not answer holds up a thread for seconds: it waits for those that answer


class Copied(NamedTuple):
    """What became of one attempt."""

    arm: ArmName
    known: Known | None  # how far it is copied; None: it could not be
    problem: str | None  # of the arm
    database: StoreError | None  # of the database: the arm is not to blame


class _Job(NamedTuple):
    """An arm to copy."""

    arm: ArmName
    ways: frozenset[str]
    last_values: bool


class Copying:
    """A pool of threads. A context manager."""

    def __init__(self, database: Database, links: dict[str, Link], workers: int, now: Callable[[], float]) -> None:
        self._database, self._links, self._now = database, links, now
        self._jobs: queue.PriorityQueue[tuple[int, int, _Job | None]] = queue.PriorityQueue()
        self._count = itertools.count()  # of equals the first one first
        self._waiting: set[ArmName] = set()
        self._lock = threading.Lock()
        self.done: queue.SimpleQueue[Copied] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=self._work, name=f"copy-{n}", daemon=True) for n in range(workers)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "Copying":
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        for _thread in self._threads:
            self._jobs.put((STOP, next(self._count), None))
        for thread in self._threads:
            thread.join(timeout=15.0)

    @property
    def length(self) -> int:
        """Arms that wait or are being copied."""
        with self._lock:
            return len(self._waiting)

    def ask(self, arm: ArmName, ways: set[str], *, last_values: bool, doubtful: bool = False) -> bool:
        """Copy what is new of an arm, by one of these ways; False where it waits or is being copied already.

        last_values : they are asked for as well. doubtful : it could not be copied last time, and others come first.
        """
        with self._lock:
            if arm in self._waiting:
                return False
            self._waiting.add(arm)
        self._jobs.put((LATER if doubtful else SOON, next(self._count), _Job(arm, frozenset(ways), last_values)))
        return True

    def _work(self) -> None:
        while (job := self._jobs.get()[2]) is not None and not self._stopping.is_set():
            arm, ways, last_values = job
            try:
                outcome = self._copy(arm, ways, last_values)
            except Exception as error:  # the thread must survive whatever an arm says
                log.exception("%s: could not be copied", arm)
                outcome = Copied(arm, None, f"internal: {type(error).__name__}", None)
            with self._lock:
                self._waiting.discard(arm)
            self.done.put(outcome)

    def _copy(self, arm: ArmName, ways: frozenset[str], last_values: bool) -> Copied:
        links = [self._links[way] for way in sorted(ways) if self._links[way].up] or [self._links[way] for way in sorted(ways)]
        if not links:
            return Copied(arm, None, None, None)
        try:
            if last_values:
                links[0].ask_last_values(arm)
            return Copied(arm, pull(self._database, links[0], arm.prefix, arm.site, arm.robot, self._now), None, None)
        except (CannotCopy, BusError) as problem:
            if not links[0].reached():  # no fault of the arm: it is copied as soon as there is a way again
                return Copied(arm, None, None, None)
            return Copied(arm, None, str(problem), None)
        except StoreError as error:
            return Copied(arm, None, None, error)
