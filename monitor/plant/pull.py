"""Copying arms' histories: pages by cursor from the arm into the database, in threads side by side, each arm once at a time. I/O."""

import itertools
import logging
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import orjson

from monitor.errors import BadInput, BusError, MonitorError, StoreError
from monitor.plant.arm import ArmName
from monitor.plant.cursor import AnotherLog, Disordered, Entry, step
from monitor.plant.database import Database, DataRefused
from monitor.plant.ingest import (
    CHANGES,
    EVENTS,
    CursorMoved,
    Gap,
    HistoriesWithoutEnd,
    Known,
    add_changes,
    add_transitions,
    begin_another_history,
    known,
)
from monitor.plant.links import Link
from monitor.publish.documents import Event, Events, History, HistoryChange, read
from monitor.reason import Reason, Sentence

log = logging.getLogger(__name__)

PAGE = 2000  # rows or transitions: 3 MB of JSON at most
FEW_GAPS = 3  # that a sentence names
TRIES = 5  # where another one copies the same log, or an arm's history is replaced while it is copied


NOT_STORED = Sentence("history_not_stored", "its history cannot be stored: {why}")
CHANGES_MEANWHILE = Sentence("history_changes_meanwhile", "its history changes while it is copied; tried again")()
NOT_IN_ORDER = Sentence("answer_not_in_order", "its answer is not in order")()
AGAIN_AND_AGAIN = Sentence("histories_without_end", "{why}, time and again within the hour; copied again when it keeps one history")
NOTHING_FOLLOWS = Sentence("nothing_follows", "its answer says that more follows, and nothing does")()
GAPS = Sentence("history_has_gaps", "its own history lacks the {entries:word} {few}; those after them are copied")
MORE_GAPS = Sentence(
    "history_has_more_gaps", "its own history lacks the {entries:word} {few} and {more} more gaps; those after them are copied"
)
REFUSES = Sentence("arm_refuses", "it refuses: {why}")
ANSWER_UNREADABLE = Sentence("answer_unreadable", "its answer on {log:word} cannot be read: {why}")
INTERNAL = Sentence("copying_failed", "internal: {error}")


class CannotCopy(MonitorError):
    """An arm's history cannot be copied now, and why."""


class Way(Protocol):
    """A way to the arms."""

    def ask(self, key: str) -> bytes:
        """The one answer to a query. Raises BusError where nobody answers, BadInput with the text of a refusal."""
        ...


def pull(database: Database, way: Way, prefix: str, site: str, robot: str, now: Callable[[], float]) -> Known:
    """Copy everything that is new of an arm's two logs. Returns how far it is copied then.

    Raises CannotCopy with the reason that lies with the arm, StoreError with one that lies with the database.
    """
    for _ in range(TRIES):
        at = known(database, site, robot, now())
        try:
            if not all(_log(database, way, prefix, at, name, f"{site}/{robot}", now) for name in (EVENTS, CHANGES)):
                continue  # of another history: everything of it is asked for
            return known(database, site, robot, now())
        except CursorMoved:
            continue
        except DataRefused as refused:
            raise CannotCopy(NOT_STORED(why=refused.reason)) from None
    raise CannotCopy(CHANGES_MEANWHILE)


def _log(database: Database, way: Way, prefix: str, at: Known, name: str, robot: str, now: Callable[[], float]) -> bool:
    """Copy one log to its end; False where another history had to be begun."""
    following: int | None = 0
    while following is not None:
        cursor = at.event if name == EVENTS else at.change
        identity, entries, following, newest = _page(way, prefix, name, cursor.asks_after)
        found = step(cursor, at.history_id, identity, entries)
        if isinstance(found, Disordered):
            raise CannotCopy(NOT_IN_ORDER)
        if isinstance(found, AnotherLog):
            try:
                begin_another_history(database, at, robot, identity, found.why, now())
            except HistoriesWithoutEnd:
                raise CannotCopy(AGAIN_AND_AGAIN(why=found.why)) from None
            log.warning("%s: %s; its history is copied anew", robot, found.why)
            return False
        if following is not None and not found.new:  # it would be asked the same for ever
            raise CannotCopy(NOTHING_FOLLOWS)
        gap = Gap(now(), robot, _gap(name, found.missing)) if found.missing else None
        before = newest if at.events_before is None else at.events_before
        if name == EVENTS and (found.new or identity != at.history_id or at.events_before is None):
            add_transitions(database, at, found.new, found.cursor, identity, gap, before)
        elif name == CHANGES and (found.new or identity != at.history_id):
            add_changes(database, at, found.new, found.cursor, identity, gap)
        if gap is not None:
            log.warning("%s: %s", robot, gap.what.text)
        at = at._replace(history_id=identity or at.history_id)
        if name == EVENTS:
            at = at._replace(event=found.cursor, events_before=before)
        else:
            newest_replay = max([at.newest_replay, *(entry.content.replay for entry in found.new)])
            at = at._replace(change=found.cursor, newest_replay=newest_replay)
    return True


def _gap(name: str, missing: Sequence[tuple[int, int]]) -> Reason:
    """What its log lacks, in a sentence. A history that goes on after damage numbers on with a jump; anything else was taken away."""
    few = ", ".join(str(first) if first == last else f"{first} to {last}" for first, last in missing[:FEW_GAPS])
    entries, more = "transitions" if name == EVENTS else "changes", len(missing) - FEW_GAPS
    return MORE_GAPS(entries=entries, few=few, more=more) if more > 0 else GAPS(entries=entries, few=few)


def read_document(payload: bytes) -> Any:
    """A JSON document without the character NUL, which PostgreSQL does not store. Raises ValueError."""
    document = orjson.loads(payload)
    return _without_nul(document) if b"\\u0000" in payload else document


def _without_nul(value: Any) -> Any:
    if isinstance(value, str):
        return value.replace("\0", "")
    if isinstance(value, list):
        return [_without_nul(each) for each in value]
    return {_without_nul(key): _without_nul(each) for key, each in value.items()} if isinstance(value, dict) else value


def _page(way: Way, prefix: str, name: str, after: int) -> tuple[str | None, Sequence[Entry[Any]], int | None, int]:
    """One page of a log: the identity of the history, entries, whether more follow (as a number), and the newest transition there is."""
    parameter = "after" if name == EVENTS else "changed_after"
    key = f"{prefix}/{'event' if name == EVENTS else 'history'}?{parameter}={after};limit={PAGE}"
    try:
        payload = way.ask(key)
    except BadInput as refused:
        raise CannotCopy(REFUSES(why=refused.reason)) from None
    except BusError as error:
        raise CannotCopy(error.reason) from None
    try:
        document = read_document(payload)
        if name == EVENTS:
            events = read(Events, document)
            entries = [Entry(event.seq, _event_mark(event), event) for event in events.events]
            return events.history_id, entries, events.next, events.last or 0
        history = read(History, document)
        return history.history_id, [Entry(each.seq, _change_mark(each), each) for each in history.changes], history.next, 0
    except (BadInput, ValueError) as wrong:
        raise CannotCopy(ANSWER_UNREADABLE(log="event" if name == EVENTS else "history", why=str(wrong).splitlines()[0])) from None


def _event_mark(event: Event) -> str:
    """What tells a transition from another one with its number, in every version of the document."""
    return f"{event.at.timestamp():.0f} {event.joint} {event.condition} {event.kind}"


def _change_mark(change: HistoryChange) -> str:
    return f"{change.at.timestamp():.0f} {change.replay}"


# --- The threads that copy histories: each arm at most once at a time, several arms side by side

STOP, SOON, LATER = range(3)  # an arm that does not answer holds up a thread for seconds: it waits for those that answer


class Copied(NamedTuple):
    """What became of one attempt."""

    arm: ArmName
    known: Known | None  # how far it is copied; None: it could not be
    problem: Reason | None  # of the arm
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
                outcome = Copied(arm, None, INTERNAL(error=type(error).__name__), None)
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
            return Copied(arm, None, problem.reason, None)
        except StoreError as error:
            return Copied(arm, None, None, error)
