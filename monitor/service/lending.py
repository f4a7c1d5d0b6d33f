"""Windows where a program lends the arm: each makes a replay due, and the arm is taken at the first node at which every condition holds.

A window of the clock, or somebody's request, is due until the arm was had, or for `replay.hand_over_wait_h`: a cell that stands still over
the weekend lends its arm on Monday. Windows that open meanwhile join it. A cold start and evidence from production are over with their
window.
"""

import json
import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from threading import Lock
from typing import Protocol, Self

from monitor.acquire.driver import Driver
from monitor.acquire.schedule.windows import COLD_START, PULLED_FORWARD, Window, blackouts
from monitor.config.schema import Configuration
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.publish import documents
from monitor.publish.timestamps import rfc3339, utc
from monitor.reason import Reason, Sentence
from monitor.store.history.ledger import Borrow, Kind, LedgerRow
from monitor.store.store import Store

NOTE = "replay_due"
NOT_OFFERED = Sentence("not_offered", "not offered to the program: {why}")
PASSED_BY = Sentence("passed_by", "waiting for the program's node; at the last one: {why}")
NO_NODE_YET = Sentence("no_node_yet", "waiting for the program's node; none was reached yet")
NODE_REFUSED = Sentence("refused_at_node", "hand_over: at the last node: {why}")
NO_NODE = Sentence("no_node_reached", "hand_over: the program reached no node")
DUE_SINCE = Sentence("due_since", "due since {since} ({why}), {waits_for}")
SERVED = Sentence("window_served", "one replay serves this window and that of {window}")
DUE_ONCE = Sentence("due_once", "hand_over: due once, and not any longer after the restart")
BLACKOUT = Sentence("blackout", "blackout: nothing is replayed today")
HAS_WINDOW = Sentence("has_window", "hand_over: the history has this window already")


@dataclass(frozen=True, slots=True, kw_only=True)
class DueReplay:
    """Since when a replay is due, by which window, and what keeps it waiting."""

    key_unix_s: float  # of its window, as the ledger will know it
    since_unix_s: float
    until_unix_s: float  # without a replay by then its window is skipped
    kind: Kind = "scheduled"
    why: str = "cron"  # what opened its window
    tries: int = 0  # replays begun for it that this machine or the network ended
    refused: Reason | None = None  # why the program is not asked to offer the arm; None: it is
    passed_by: Reason | None = None  # why the arm was not taken at the last node; None: none was reached since

    @property
    def waits_for(self) -> Reason:
        """What it waits for, as a clause."""
        if self.refused is not None:
            return NOT_OFFERED(why=self.refused)
        return PASSED_BY(why=self.passed_by) if self.passed_by is not None else NO_NODE_YET()

    @property
    def reason(self) -> Reason:
        """Why its window ended without a replay."""
        if self.refused is not None:
            return self.refused
        return NODE_REFUSED(why=self.passed_by) if self.passed_by is not None else NO_NODE()

    def document(self) -> documents.DueReplay:
        """For the document `monitor`."""
        return documents.DueReplay(
            since=utc(self.since_unix_s),
            until=utc(self.until_unix_s),
            kind=self.kind,
            why=self.why,
            tries=self.tries,
            **self.waits_for.document(),
        )

    def keep(self, store: Store) -> None:
        """Note it. Raises StoreError."""
        lasting = {name: getattr(self, name) for name in ("key_unix_s", "since_unix_s", "until_unix_s", "kind", "why", "tries")}
        store.notes.set(NOTE, json.dumps(lasting))

    @classmethod
    def kept(cls, store: Store) -> Self | None:
        """The one that was noted; None where none is due. Raises StoreError."""
        noted = store.notes.get(NOTE)
        return cls(**json.loads(noted)) if noted else None

    def another_try(self, now_unix_s: float) -> Self:
        """The same after a replay that ended early: the ledger has its window already, so that the next try is one of its own."""
        return replace(self, key_unix_s=now_unix_s, tries=self.tries + 1, refused=None, passed_by=None)

    @property
    def due(self) -> Reason:
        """The whole as a sentence without its stop."""
        return DUE_SINCE(since=rfc3339(self.since_unix_s), why=self.why, waits_for=self.waits_for)


def forget(store: Store) -> None:
    """Note that none is due. Raises StoreError."""
    store.notes.set(NOTE, "")


# --- the window of a replay with a lent arm --------------------------------------------------------


class BorrowedWindow:
    """A context manager. While it is entered nothing else is replayed; before that nothing is held, because days may pass."""

    def __init__(
        self,
        store: Store,
        replaying: Lock,
        due: DueReplay,
        now: Callable[[], float],
        passed_by: Callable[[Reason], None] = lambda _: None,
        *,
        ask_program: Callable[[], str | None] = lambda: None,
    ) -> None:
        """`replaying` is held from the taking of the arm to the end of the context.

        passed_by : takes why it was not taken at a node. ask_program : which program plays, where that is known.
        """
        self._store, self._replaying, self._due, self._now = store, replaying, due, now
        self.passed_by, self._ask_program = passed_by, ask_program
        self._stack = ExitStack()
        self._entered_at = 0.0
        self._taken_at: float | None = None  # monotonic; None: the program has its arm
        self._back_at: float | None = None  # monotonic; None: the program has not had its arm back yet
        self._waited_s = 0.0
        self.ledger_id: int | None = None  # None: the arm was not taken yet

    def enter(self) -> int:
        """The window's number in the ledger, in which it is entered now if it was not. Raises StoreError, MotionRefused."""
        if self.ledger_id is None:
            with ExitStack() as stack:  # where it cannot be entered nothing is held: the arm goes back, and somebody may try again
                stack.enter_context(self._replaying)
                self._entered_at = self._now()
                self.ledger_id = self._store.ledger.claim(self._due.key_unix_s, self._due.kind, self._entered_at)
                if self.ledger_id is None:
                    raise MotionRefused(HAS_WINDOW())
                log.info("replay=%d begins: the program's node lends the arm", self.ledger_id, extra={"replay": self.ledger_id})
                self._stack = stack.pop_all()
        return self.ledger_id

    def taken(self) -> None:
        """The arm is ours, and the program waits for it."""
        self._taken_at, self._back_at = time.monotonic(), None

    def given_back(self) -> None:
        """The program has its arm again; a first pass and its replay borrow it twice."""
        if self._taken_at is not None:
            self._waited_s += time.monotonic() - self._taken_at
            self._taken_at, self._back_at = None, time.monotonic()
            self._note(given_back=True)  # it plays again: no question keeps it waiting

    @property
    def back_for_s(self) -> float:
        """For how long the program has had its arm again; 0 before."""
        return 0.0 if self._back_at is None else time.monotonic() - self._back_at

    def lost(self) -> None:
        """The program did not get its arm back, and has ended."""
        self._note(given_back=False)

    def _note(self, *, given_back: bool) -> None:
        if self.ledger_id is None:  # it could not be entered: the ledger has no row that this belongs to
            return
        self._store.borrows.add(
            Borrow(
                ledger_id=self.ledger_id,
                due_since_unix_s=self._due.since_unix_s,
                taken_at_unix_s=self._entered_at,
                program=self._ask_program(),
                waited_s=self._waited_s if given_back else None,
                given_back=given_back,
            )
        )

    def __enter__(self) -> "BorrowedWindow":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def program_of(driver: Driver, host: str) -> str | None:
    """The name of the program that plays on this controller; None where none is known."""
    try:
        return driver.playing_program(host) or None
    except RobotUnreachable:
        return None


# --- what is due -----------------------------------------------------------------------------------

log = logging.getLogger(__name__)

TRIGGERED = PULLED_FORWARD | {COLD_START}  # what such a window wants to see is gone when it closes
ENDED_EARLY = frozenset({"aborted", "skipped"})  # a window that the arm was taken for, and that taught nothing
LOOK_EVERY_S = 10.0  # between two looks whether the arm may be asked for again


class Lender(Protocol):
    """What replays at a node: the replay cycle."""

    @property
    def configuration(self) -> Configuration:
        """The settings in force."""

    def borrow(self, due: DueReplay, waits: Callable[[], bool], passed: Callable[[Reason], None]) -> LedgerRow | Reason:
        """Replay at the program's next node: the row of that; or why the arm was not taken, where it was not while `waits`.

        passed : takes why a node was passed by.
        """

    def note_due(self, due: DueReplay | None) -> None:
        """Take which replay waits for the program's node."""

    def skip(self, window_unix_s: float, reason: Reason, kind: Kind = "scheduled") -> None:
        """Enter a window as skipped, with the reason."""


class Lending:
    """What is due, kept over restarts."""

    def __init__(self, monitor: Lender, store: Store) -> None:
        self._monitor, self._store = monitor, store
        self._not_before = 0.0  # UTC
        self.due: DueReplay | None = None
        kept = DueReplay.kept(store)
        if kept is None:
            return
        if store.restored is not None or not self.lent:  # what became of it since the backup is not known; or nobody lends the arm any more
            monitor.skip(kept.key_unix_s, DUE_ONCE(), kept.kind)
            forget(store)
            return
        self._take(kept)

    @property
    def lent(self) -> bool:
        """Whether a program lends the arm."""
        return self._monitor.configuration.replay.lent is not None

    def open(self, window: Window, kind: Kind = "scheduled") -> None:
        """A window has opened, or somebody asks: a replay is due from now on. One that is due already serves both."""
        lent = self._monitor.configuration.replay.lent
        assert lent is not None
        if self.due is not None and window.opens_unix_s >= self.due.until_unix_s:
            self._give_up(self.due)
        if self.due is None or self.due.why in TRIGGERED:
            until = window.closes_unix_s if window.why in TRIGGERED else window.opens_unix_s + lent.wait_s
            due = DueReplay(key_unix_s=window.key_unix_s, since_unix_s=window.opens_unix_s, until_unix_s=until, kind=kind, why=window.why)
            if self.due is not None:
                self._monitor.skip(self.due.key_unix_s, SERVED(window=rfc3339(window.key_unix_s)), self.due.kind)
            due.keep(self._store)
            self._take(due)
            log.info("a replay is %s", due.due)
        elif kind == "scheduled":
            self._monitor.skip(window.key_unix_s, SERVED(window=rfc3339(self.due.key_unix_s)))
        self._not_before = 0.0

    def joined(self, window: Window) -> bool:
        """Whether this window joins the replay that is due already; it is entered then."""
        if self.due is None:
            return False
        if window.key_unix_s == self.due.key_unix_s:
            return True
        apart = window.closes_unix_s <= self.due.since_unix_s or window.opens_unix_s >= self.due.until_unix_s
        if apart or self.due.why in TRIGGERED:
            return False
        self._monitor.skip(window.key_unix_s, SERVED(window=rfc3339(self.due.key_unix_s)))
        return True

    def hindered(self, now: float) -> Reason | None:
        """Why nothing is replayed on this day; None where nothing speaks against it."""
        dark = any(begin <= now < end for begin, end in blackouts(self._monitor.configuration.schedule))
        return BLACKOUT() if dark else None

    def at_a_node(self, now: float, hindered: Reason | None, waits: Callable[[], bool]) -> LedgerRow | None:
        """Wait for the program's node as long as `waits`, and replay there; None where the arm was not taken.

        hindered : why the program is not asked at all now. Raises StoreError.
        """
        due = self.due
        assert due is not None
        if self._store.ledger.windows(due.key_unix_s, due.key_unix_s):  # the monitor ended during its replay: the ledger says how
            self._done()
            return None
        if now >= due.until_unix_s:
            self._give_up(due)
            return None
        if hindered is not None:
            self._take(replace(due, refused=hindered))
            return None
        if now < self._not_before:
            return None
        self._take(replace(due, refused=None))
        asked_to_yield = False

        def still() -> bool:
            nonlocal asked_to_yield
            asked_to_yield = asked_to_yield or not waits() or self.due is None or self.due.key_unix_s != due.key_unix_s
            return not asked_to_yield

        found = self._monitor.borrow(due, still, self._passed_by)
        if isinstance(found, Reason):
            if not asked_to_yield:
                if found != due.refused:
                    log.warning("the program is not asked for the arm: %s", found)
                self._take(replace(self.due or due, refused=found))
                self._not_before = now + LOOK_EVERY_S
            return None
        self._after(due, found)
        return found

    def _after(self, due: DueReplay, row: LedgerRow) -> None:
        """A replay that this machine or the network ended, and that needs no person, is due again at a later node."""
        schedule = self._monitor.configuration.schedule
        again = row.state in ENDED_EARLY and due.tries + 1 < schedule.tries and not self._store.stops.waiting()
        if not again:
            self._done()
            return
        ended = row.started_at_unix_s if row.ended_at_unix_s is None else row.ended_at_unix_s
        another = due.another_try(ended)
        another.keep(self._store)
        self._take(another)
        self._not_before = ended + schedule.try_again_after_s

    def _passed_by(self, why: Reason) -> None:
        if self.due is not None and self.due.passed_by != why:
            self._take(replace(self.due, passed_by=why))

    def _take(self, due: DueReplay | None) -> None:
        self.due = due
        self._monitor.note_due(due)

    def _give_up(self, due: DueReplay) -> None:
        self._monitor.skip(due.key_unix_s, due.reason, due.kind)
        self._done()

    def _done(self) -> None:
        forget(self._store)
        self._take(None)
