"""Copying arms' histories: pages by cursor from the arm into the database, in threads side by side, each arm once at a time. I/O."""

import hashlib
import itertools
import logging
import queue
import threading
from base64 import b64decode
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import orjson

from monitor.errors import BadInput, BusError, MonitorError, StoreError
from monitor.plant.arm import ArmName
from monitor.plant.cursor import AnotherLog, Cursor, Disordered, Entry, step
from monitor.plant.database import Database, DataRefused
from monitor.plant.ingest import (
    CHANGES,
    EVENTS,
    CursorMoved,
    Flaws,
    HistoriesWithoutEnd,
    Known,
    add_changes,
    add_stored,
    add_transitions,
    begin_another_history,
    known,
)
from monitor.plant.links import Link
from monitor.publish.documents import Event, Events, History, HistoryChange, mended, read, rows_of
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
TRANSITION_ASIDE = Sentence("transition_set_aside", "transition {seq}: {why}")
CHANGE_ASIDE = Sentence("change_set_aside", "change {seq}: {why}")
LARGEST_SEQ = 2**63  # no database has a larger number
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
            _stored(database, way, prefix, known(database, site, robot, now()))
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
        page = _page(way, prefix, name, cursor)
        identity, following = page.history_id, page.following
        found = step(cursor, at.history_id, identity, page.entries)
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
        gap = _gap(name, found.missing) if found.missing else None
        aside = [why for entry in found.new for why in page.aside.get(entry.seq, ())]
        flaws = Flaws(now(), robot, gap, aside) if gap or aside else None
        new = [entry for entry in found.new if entry.content is not None]
        before = page.newest if at.events_before is None else at.events_before
        if name == EVENTS and (found.new or identity != at.history_id or at.events_before is None):
            add_transitions(database, at, new, found.cursor, identity, flaws, before)
        elif name == CHANGES and (found.new or identity != at.history_id):
            add_changes(database, at, new, found.cursor, identity, flaws)
        for why in (gap, *aside):
            if why is not None:
                log.warning("%s: %s", robot, why.text)
        at = at._replace(history_id=identity or at.history_id)
        if name == EVENTS:
            at = at._replace(event=found.cursor, events_before=before)
        else:
            newest_replay = max([at.newest_replay, *(entry.content.replay for entry in new)])
            at = at._replace(change=found.cursor, newest_replay=newest_replay)
    return True


def _stored(database: Database, way: Way, prefix: str, at: Known) -> None:
    """Copy what is new in the history's own tables; a monitor of an earlier release refuses, and nothing of them is copied.

    Whether it is still the same history, the other logs say. Raises CursorMoved where it became another one in between.
    """
    following: int | None = at.stored
    while following is not None:
        try:
            payload = way.ask(f"{prefix}/history?stored_after={at.stored};limit={PAGE}")
        except BadInput:
            return
        except BusError as error:
            raise CannotCopy(error.reason) from None
        try:
            said = read(History, read_document(payload))
            rows = [(row.seq, row.table, row.row, None if row.content is None else b64decode(row.content)) for row in said.stored]
        except (BadInput, ValueError) as wrong:
            raise CannotCopy(ANSWER_UNREADABLE(log="history", why=str(wrong).splitlines()[0])) from None
        if said.history_id != at.history_id:
            raise CursorMoved
        if any(later <= earlier for earlier, later in pairwise([at.stored, *(row[0] for row in rows)])):
            raise CannotCopy(NOT_IN_ORDER)
        if not rows:
            return
        add_stored(database, at, rows)
        at, following = at._replace(stored=rows[-1][0]), said.next


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


class Page(NamedTuple):
    """One page of a log."""

    history_id: str | None
    entries: list[Entry[Any]]  # content None: it cannot be read
    following: int | None  # whether more follow
    newest: int  # transition that there is
    aside: dict[int, list[Reason]]  # by entry: what of it cannot be read


def _page(way: Way, prefix: str, name: str, cursor: Cursor) -> Page:
    """The page from the cursor on. What cannot be read in it is set aside, unless nothing of a log can be read."""
    kind, parameter, listed = ("event", "after", "events") if name == EVENTS else ("history", "changed_after", "changes")
    try:
        payload = way.ask(f"{prefix}/{kind}?{parameter}={cursor.asks_after};limit={PAGE}")
    except BadInput as refused:
        raise CannotCopy(REFUSES(why=refused.reason)) from None
    except BusError as error:
        raise CannotCopy(error.reason) from None
    try:
        document = read_document(payload)
        given = document.get(listed, []) if isinstance(document, dict) else None
        model: type[Events | History] = Events if name == EVENTS else History
        said = read(model, {**document, listed: []} if isinstance(given, list) else document)
        entries, aside = [], {}
        for place, each in enumerate(given or ()):
            entry, wrong = _event(each) if name == EVENTS else _change(each)
            if entry is None:
                raise BadInput(f"{listed}.{place}.{wrong[0].parameters['why']}")
            entries.append(entry)
            aside[entry.seq] = wrong
        if entries and cursor.seq == 0 and all(entry.content is None for entry in entries):
            raise BadInput(f"{listed}.0.{aside[entries[0].seq][0].parameters['why']}")
    except (BadInput, ValueError) as wrong_page:
        raise CannotCopy(ANSWER_UNREADABLE(log=kind, why=str(wrong_page).splitlines()[0])) from None
    newest = said.last or 0 if isinstance(said, Events) else 0
    return Page(said.history_id, entries, said.next, newest, aside)


def _event(given: object) -> tuple[Entry[Event | None] | None, list[Reason]]:
    """A transition, and what is wrong with it; None where it has no number."""
    try:
        event, why = mended(Event, given)
    except BadInput as error:
        return _aside(given, TRANSITION_ASIDE, str(error))
    return Entry(event.seq, _event_mark(event), event), [] if why is None else [TRANSITION_ASIDE(seq=event.seq, why=why)]


def _change(given: object) -> tuple[Entry[HistoryChange | None] | None, list[Reason]]:
    """A change with those of its rows that can be read, and what is wrong with the others; None where it has no number."""
    listed = given.get("rows") if isinstance(given, dict) else None
    try:
        if not isinstance(given, dict) or not isinstance(listed, list):
            change = read(HistoryChange, given)
        else:
            rows, refused = rows_of(listed)
            change = read(HistoryChange, {**given, "rows": []}).model_copy(update={"rows": rows})
            return Entry(change.seq, _change_mark(change), change), [each.reason for each in (*change.set_aside, *refused)]
    except BadInput as error:
        return _aside(given, CHANGE_ASIDE, str(error))
    return Entry(change.seq, _change_mark(change), change), []


def _aside(given: object, sentence: Sentence, why: str) -> tuple[Entry[Any] | None, list[Reason]]:
    """An entry that cannot be read: its number is kept, and a digest tells it from another one."""
    seq = given.get("seq") if isinstance(given, dict) else None
    if not isinstance(seq, int) or isinstance(seq, bool) or not 0 < seq < LARGEST_SEQ:
        return None, [sentence(seq=0, why=why)]
    digest = hashlib.sha256(orjson.dumps(given, option=orjson.OPT_SORT_KEYS)).hexdigest()[:16]
    return Entry(seq, f"unreadable {digest}", None), [sentence(seq=seq, why=why)]


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
