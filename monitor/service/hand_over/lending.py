"""Windows where a program lends the arm: each makes a replay due, and the arm is taken at the first node at which every condition holds.

A window of the clock, or somebody's request, is due until the arm was had, or for `replay.hand_over_wait_h`: a cell that stands still over
the weekend lends its arm on Monday. Windows that open meanwhile join it. A cold start and evidence from production are over with their
window.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from monitor.acquire.schedule.windows import Window, blackouts
from monitor.config.schema import Configuration
from monitor.publish.timestamps import rfc3339
from monitor.service.hand_over.due import DueReplay, forget
from monitor.store.history.ledger import LedgerRow
from monitor.store.store import Store

log = logging.getLogger(__name__)

TRIGGERED = frozenset({"cold start", "evidence"})  # what such a window wants to see is gone when it closes
ENDED_EARLY = frozenset({"aborted", "skipped"})  # a window that the arm was taken for, and that taught nothing
LOOK_EVERY_S = 10.0  # between two looks whether the arm may be asked for again


class Lender(Protocol):
    """What replays at a node: the replay cycle."""

    @property
    def configuration(self) -> Configuration:
        """The settings in force."""

    def borrow(self, due: DueReplay, waits: Callable[[], bool], passed: Callable[[str], None]) -> LedgerRow | str:
        """Replay at the program's next node: the row of that; or why the arm was not taken, where it was not while `waits`.

        passed : takes why a node was passed by.
        """

    def note_due(self, due: DueReplay | None) -> None:
        """Take which replay waits for the program's node."""

    def skip(self, window_unix_s: float, reason: str, kind: str = "scheduled") -> None:
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
            monitor.skip(kept.key_unix_s, "hand_over: due once, and not any longer after the restart", kept.kind)
            forget(store)
            return
        self._take(kept)

    @property
    def lent(self) -> bool:
        """Whether a program lends the arm."""
        return self._monitor.configuration.replay.lent is not None

    def open(self, window: Window, kind: str = "scheduled") -> None:
        """A window has opened, or somebody asks: a replay is due from now on. One that is due already serves both."""
        lent = self._monitor.configuration.replay.lent
        assert lent is not None
        if self.due is not None and window.opens_unix_s >= self.due.until_unix_s:
            self._give_up(self.due)
        if self.due is None or self.due.why in TRIGGERED:
            until = window.closes_unix_s if window.why in TRIGGERED else window.opens_unix_s + lent.wait_s
            due = DueReplay(key_unix_s=window.key_unix_s, since_unix_s=window.opens_unix_s, until_unix_s=until, kind=kind, why=window.why)
            if self.due is not None:
                self._monitor.skip(self.due.key_unix_s, serves(window.key_unix_s), self.due.kind)
            due.keep(self._store)
            self._take(due)
            log.info("a replay is %s", due.since_text())
        elif kind == "scheduled":
            self._monitor.skip(window.key_unix_s, serves(self.due.key_unix_s))
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
        self._monitor.skip(window.key_unix_s, serves(self.due.key_unix_s))
        return True

    def hindered(self, now: float) -> str | None:
        """Why nothing is replayed on this day; None where nothing speaks against it."""
        dark = any(begin <= now < end for begin, end in blackouts(self._monitor.configuration.schedule))
        return "blackout: nothing is replayed today" if dark else None

    def at_a_node(self, now: float, hindered: str | None, waits: Callable[[], bool]) -> LedgerRow | None:
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
        self._take(replace(due, refused=""))
        asked_to_yield = False

        def still() -> bool:
            nonlocal asked_to_yield
            asked_to_yield = asked_to_yield or not waits() or self.due is None or self.due.key_unix_s != due.key_unix_s
            return not asked_to_yield

        found = self._monitor.borrow(due, still, self._passed_by)
        if isinstance(found, str):
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

    def _passed_by(self, why: str) -> None:
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


def serves(key_unix_s: float) -> str:
    """Why a window has no replay of its own: that of another one is enough."""
    return f"one replay serves this window and that of {rfc3339(key_unix_s)}"
