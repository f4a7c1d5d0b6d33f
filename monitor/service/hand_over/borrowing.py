"""The window of a replay whose arm a program lends: entered in the ledger when the arm is taken, and noted with what the program lent."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from threading import Lock

from monitor.acquire.driver import Driver
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.service.hand_over.due import DueReplay
from monitor.store.history.ledger import Borrow
from monitor.store.store import Store


class BorrowedWindow:
    """A context manager. While it is entered nothing else is replayed; before that nothing is held, because days may pass."""

    def __init__(
        self,
        store: Store,
        replaying: Lock,
        due: DueReplay,
        now: Callable[[], float],
        passed_by: Callable[[str], None] = lambda _: None,
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
                    raise MotionRefused("hand_over: the history has this window already")
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
