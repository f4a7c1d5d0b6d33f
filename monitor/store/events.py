"""Transitions of alerts, numbered without gaps."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from monitor.errors import StoreError
from monitor.store.database import Database, json_text


class AlertEvent(NamedTuple):
    """One transition of an alert, numbered without gaps in the order in which they happened."""

    seq: int
    at_unix_s: float
    document: dict[str, Any]
    ledger_id: int | None = None  # the replay that brought it about; None: a person, or the monitor itself


class Events:
    """The log of transitions; each is marked once it has been published."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def revise(self, health: Mapping[str, Any], events: Sequence[Mapping[str, Any]], at_unix_s: float) -> list[AlertEvent]:
        """What a person did to alerts, in one transaction: the health that follows, and the transitions with their numbers."""
        with self._db.transaction() as db:
            if db.execute("UPDATE state SET health = ?", (json_text(health),)).rowcount != 1:
                raise StoreError("no replay has been assessed yet")
            return insert_events(db, None, at_unix_s, events)

    def rows(self, *, unpublished: bool = False, after: int = 0, limit: int | None = None) -> list[AlertEvent]:
        """The newest `limit` transitions after number `after`, in order; only those that were never published where asked."""
        rows = self._db.rows(
            "SELECT seq, at_unix_s, document, ledger_id FROM event WHERE published <= ? AND seq > ? ORDER BY seq DESC LIMIT ?",
            (0 if unpublished else 1, after, -1 if limit is None else limit),
        )
        return [AlertEvent(seq, at, json.loads(document), ledger_id) for seq, at, document, ledger_id in reversed(rows)]

    def number_from(self, at_unix_s: float) -> None:
        """The numbers that a damaged history gave out since its backup are not known, and must not mean something else to who heard them.

        Transitions are rarer than one a minute: the minutes since 1970 are a number that none of them had.
        """
        with self._db.transaction() as db:
            ((newest,),) = db.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = 'event'").fetchall()
            db.execute("DELETE FROM sqlite_sequence WHERE name = 'event'")
            db.execute("INSERT INTO sqlite_sequence VALUES ('event', ?)", (max(newest or 0, int(at_unix_s / 60.0)),))

    def range(self) -> tuple[int, int] | None:
        """Numbers of the oldest and of the newest transition kept; None where there is none."""
        ((oldest, newest),) = self._db.rows("SELECT min(seq), max(seq) FROM event")
        return None if oldest is None else (int(oldest), int(newest))

    def mark_published(self, seq: int) -> None:
        """The event is on the bus."""
        with self._db.transaction() as db:
            db.execute("UPDATE event SET published = 1 WHERE seq = ?", (seq,))


def insert_events(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, events: Sequence[Mapping[str, Any]]) -> list[AlertEvent]:
    """Insert transitions inside a transaction; returns them with the numbers that they were given."""
    numbered = []
    for document in events:
        cursor = db.execute(
            "INSERT INTO event (ledger_id, at_unix_s, document) VALUES (?, ?, ?)", (ledger_id, float(at_unix_s), json_text(document))
        )
        numbered.append(AlertEvent(int(cursor.lastrowid or 0), float(at_unix_s), dict(document), ledger_id))
    return numbered
