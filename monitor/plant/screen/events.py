"""The newest transitions of all arms, for streams: read once a second while somebody listens, kept for those who come back. I/O."""

import secrets
import threading
import time
from collections import deque
from typing import Any, NamedTuple

import sqlalchemy as sa

from monitor.plant.database import Database
from monitor.plant.tables import arm, history, transition

KEPT = 10_000  # transitions that somebody who was cut off can still have
PERIOD_S = 1.0
MOST = 1000  # transitions of one arm that are read at once; the others are read the next time


class Transition(NamedTuple):
    """One transition of an alert, as the arm's history holds it."""

    site: str
    robot: str
    history: int
    seq: int
    at_unix_s: float
    kind: str
    joint: int | None
    condition: str
    tier: str
    by: str | None
    document: dict[str, Any]


class Feed:
    """Numbers transitions in the order in which the plant copied them. Several threads may use it."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._kept: deque[Transition] = deque(maxlen=KEPT)
        self._newest = 0  # number of the newest one that is kept
        self._known: dict[int, tuple[int, int]] | None = None  # by arm: its history, and the newest transition of it that was taken
        self._began_unix_s, self._read_at = 0.0, 0.0
        self._run = secrets.token_hex(4)  # numbers of another run of the plant mean nothing

    def here(self) -> str:
        """The place of whoever has everything until now. Raises StoreError."""
        with self._lock:
            self._take()
            return f"{self._run}-{self._newest}"

    def after(self, place: str) -> list[tuple[str, Transition]] | None:
        """What has come since a place, each with the place behind it; None where that is not known any more. Raises StoreError."""
        with self._lock:
            self._take()
            run, _, text = place.partition("-")
            number = int(text) if text.isascii() and text.isdigit() and len(text) < 18 else -1
            oldest = self._newest - len(self._kept)
            if run != self._run or not oldest <= number <= self._newest:
                return None
            new = list(self._kept)[number - oldest :] if number < self._newest else []
            return [(f"{self._run}-{number + k}", each) for k, each in enumerate(new, start=1)]

    def _take(self) -> None:
        """Read what was copied since the last time."""
        if self._known is not None and time.monotonic() - self._read_at < PERIOD_S:
            return
        with self._database.read() as connection:
            present = (history.c.arm == arm.c.id) & (history.c.number == arm.c.history)
            wanted = sa.select(arm.c.id, arm.c.site, arm.c.robot, history.c.number, history.c.event_cursor)
            rows = connection.execute(wanted.join(history, present)).all()
            if self._known is None:
                self._known, self._began_unix_s = {row.id: (row.number, row.event_cursor) for row in rows}, time.time()
            found: list[Transition] = []
            taken: dict[int, tuple[int, int]] = {}
            for row in rows:
                number, seq = self._known.get(row.id, (row.number, 0))
                seq = seq if number == row.number else 0
                if row.event_cursor <= seq:
                    continue
                of = (transition.c.arm == row.id, transition.c.history == row.number, transition.c.seq > seq)
                # a history that begins anew holds old transitions as well
                newer = () if (row.id in self._known and number == row.number) else (transition.c.at >= self._began_unix_s,)
                some = connection.execute(sa.select(transition).where(*of, *newer).order_by(transition.c.seq).limit(MOST)).all()
                taken[row.id] = row.number, some[-1].seq if len(some) == MOST else row.event_cursor
                found += [
                    Transition(
                        row.site, row.robot, row.number, each.seq, each.at, each.kind, each.joint, each.condition, each.tier, each.by,
                        each.document,
                    )
                    for each in some
                ]  # fmt: skip
        self._known |= taken  # only once all of it is read
        found.sort(key=lambda each: each.at_unix_s)
        self._kept.extend(found)
        self._newest += len(found)
        self._read_at = time.monotonic()
