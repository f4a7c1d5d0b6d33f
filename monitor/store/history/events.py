"""Two numbered logs for whoever copies the history: the transitions of alerts, and the changes of replays. I/O.

Replays are not judged in the order of their numbers: a recording may wait, and a wrong clock's verdicts are taken back. Whoever copies the
history asks for the changes after a number, and misses nothing. Triggers of the database write that log, so no writer can forget it.
"""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from monitor.store.history.database import Database, Document, json_text, set_note

HISTORY_ID = "history_id"  # name of the note that tells this history from every other one
EARLY_ALERTS = "early_alerts"  # name of the note with the alerts from before the first assessment


class AlertEvent(NamedTuple):
    """One transition of an alert, numbered without gaps in the order in which they happened."""

    seq: int
    at_unix_s: float
    document: Document
    ledger_id: int | None = None  # the replay that caused it; None: a person or the monitor itself did


class Change(NamedTuple):
    """One replay whose rows were written or taken back."""

    seq: int
    ledger_id: int
    at_unix_s: float


class Events:
    """The log of transitions; each is marked once it has been published."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def revise(self, health: Mapping[str, Any], events: Sequence[Mapping[str, Any]], at_unix_s: float) -> list[AlertEvent]:
        """Store changed alerts without a replay, in one transaction: the health after the change and its transitions, which get numbers.

        Before the first assessment there is no state to keep them in: only the alerts are kept, see `early_alerts`.
        """
        with self._db.transaction() as db:
            if db.execute("UPDATE state SET health = ?", (json_text(health),)).rowcount != 1:
                set_note(db, EARLY_ALERTS, json.dumps(health["alerts"], allow_nan=False))
            return insert_events(db, None, at_unix_s, events)

    def early_alerts(self) -> list[Document]:
        """The alerts that were raised before the first assessment, as they were then."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (EARLY_ALERTS,))
        return json.loads(rows[0][0]) if rows else []

    def rows(self, *, unpublished: bool = False, after: int = 0, limit: int | None = None) -> list[AlertEvent]:
        """The newest `limit` transitions with numbers above `after`, in order. unpublished : only those that were never published."""
        rows = self._db.rows(
            "SELECT seq, at_unix_s, document, ledger_id FROM event WHERE published <= ? AND seq > ? ORDER BY seq DESC LIMIT ?",
            (0 if unpublished else 1, after, -1 if limit is None else limit),
        )
        return [AlertEvent(seq, at, json.loads(document), ledger_id) for seq, at, document, ledger_id in reversed(rows)]

    def page(self, after: int, limit: int) -> tuple[list[AlertEvent], int | None]:
        """The oldest `limit` transitions with numbers above `after`, and the number that the next page follows; None at the end."""
        rows = self._db.rows("SELECT seq, at_unix_s, document, ledger_id FROM event WHERE seq > ? ORDER BY seq LIMIT ?", (after, limit + 1))
        events = [AlertEvent(seq, at, json.loads(document), ledger_id) for seq, at, document, ledger_id in rows[:limit]]
        return events, events[-1].seq if len(rows) > limit else None

    def number_from(self, at_unix_s: float) -> None:
        """Continue the numbers above all that a damaged history may have given out since its backup: no number may mean two transitions.

        Transitions are rarer than one a minute, so the minutes since 1970 exceed every number given out.
        """
        with self._db.transaction() as db:
            ((newest,),) = db.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = 'event'").fetchall()
            db.execute("DELETE FROM sqlite_sequence WHERE name = 'event'")
            db.execute("INSERT INTO sqlite_sequence VALUES ('event', ?)", (max(newest or 0, int(at_unix_s / 60.0)),))

    def range(self) -> tuple[int, int] | None:
        """The numbers of the oldest and the newest stored transition; None where there is none."""
        ((oldest, newest),) = self._db.rows("SELECT min(seq), max(seq) FROM event")
        return None if oldest is None else (int(oldest), int(newest))

    def mark_published(self, seq: int) -> None:
        """Mark a transition as published on the bus."""
        with self._db.transaction() as db:
            db.execute("UPDATE event SET published = 1 WHERE seq = ?", (seq,))


class Changes:
    """The log of changes, and the identity of the history that it belongs to."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def history_id(self) -> str | None:
        """What tells this history from a restored or another one; None where nobody has given it one."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (HISTORY_ID,))
        return str(rows[0][0]) if rows else None

    def last(self) -> int:
        """The number of the newest change; 0 where there is none."""
        ((newest,),) = self._db.rows("SELECT max(seq) FROM change")
        return int(newest or 0)

    def after(self, seq: int, limit: int) -> tuple[list[Change], int | None]:
        """At most `limit` changes with numbers above `seq`, oldest first.

        The second value is the number that the next page follows; None at the end.
        """
        rows = self._db.rows("SELECT seq, ledger_id, at_unix_s FROM change WHERE seq > ? ORDER BY seq LIMIT ?", (seq, limit + 1))
        page = [Change(int(number), int(replay), float(at)) for number, replay, at in rows[:limit]]
        return page, page[-1].seq if len(rows) > limit else None

    def begin_another_history(self) -> None:
        """Give the history another identity: its newest entries may be lost, and their numbers may mean something else from now on."""
        with self._db.transaction() as db:
            ((another,),) = db.execute("SELECT lower(hex(randomblob(8)))").fetchall()
            set_note(db, HISTORY_ID, another)


def insert_events(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, events: Sequence[Mapping[str, Any]]) -> list[AlertEvent]:
    """Insert transitions inside a transaction; returns them with the numbers that they were given."""
    numbered = []
    for document in events:
        cursor = db.execute(
            "INSERT INTO event (ledger_id, at_unix_s, document) VALUES (?, ?, ?)", (ledger_id, float(at_unix_s), json_text(document))
        )
        numbered.append(AlertEvent(int(cursor.lastrowid or 0), float(at_unix_s), dict(document), ledger_id))
    return numbered
