"""Stored stops, after which a person must check the arm, and stored slow first passes. Both decide how the arm may move. I/O."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from monitor.store.database import Database, json_text


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A replay that ended in a stop: a person must check the arm before it moves again."""

    id: int
    ledger_id: int | None
    at_unix_s: float
    cause: str
    reason: str
    allowed_at_unix_s: float | None = None  # None: nobody has allowed it yet
    allowed_by: str | None = None
    allowed_why: str | None = None

    @property
    def text(self) -> str:
        """As a sentence."""
        which = "a replay by hand" if self.ledger_id is None else f"replay {self.ledger_id}"
        return f"{which} was ended by {self.cause}: {self.reason}"


class Stops:
    """The stored stops, and the persons who allowed motion again."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def add(self, cause: str, reason: str, at_unix_s: float) -> None:
        """Store the stop of a replay by hand, which the ledger does not have."""
        with self._db.transaction() as db:
            insert_stop(db, None, at_unix_s, cause, reason)

    def waiting(self) -> list[Stop]:
        """Stops that nobody has acknowledged, oldest first."""
        return [stop for stop in self.rows() if stop.allowed_at_unix_s is None]

    def rows(self) -> list[Stop]:
        """All stops, oldest first, each with the person who allowed motion again."""
        keys = ("id", "ledger_id", "at_unix_s", "cause", "reason", "allowed_at_unix_s", "allowed_by", "allowed_why")
        rows = self._db.rows(f"SELECT {', '.join(keys)} FROM stop ORDER BY id")  # noqa: S608 - fixed names
        return [Stop(**dict(zip(keys, row, strict=True))) for row in rows]

    def allow(self, by: str, why: str, at_unix_s: float) -> list[Stop]:
        """Allow motion again: stores the person and the reason with every waiting stop. Returns these stops."""
        with self._db.transaction() as db:
            waiting = self.waiting()
            db.execute(
                "UPDATE stop SET allowed_at_unix_s = ?, allowed_by = ?, allowed_why = ? WHERE allowed_at_unix_s IS NULL",
                (float(at_unix_s), by, why),
            )
        return waiting


class FirstPasses:
    """Slow first passes along a trajectory, each with the digest of its provenance."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def is_latest(self, digest: str) -> bool:
        """Whether the latest first pass has the provenance of this digest."""
        rows = self._db.rows("SELECT circumstances FROM first_pass ORDER BY id DESC LIMIT 1")
        return bool(rows) and rows[0][0] == digest

    def latest(self) -> dict[str, Any] | None:
        """The document of the latest first pass; None before the first."""
        rows = self._db.rows("SELECT document FROM first_pass ORDER BY id DESC LIMIT 1")
        return json.loads(rows[0][0]) if rows else None

    def add(self, digest: str, document: Mapping[str, Any], at_unix_s: float) -> None:
        """Store a first pass: the arm has moved slowly along its trajectory.

        digest : of its provenance.
        """
        with self._db.transaction() as db:
            db.execute(
                "INSERT INTO first_pass (at_unix_s, circumstances, document) VALUES (?, ?, ?)",
                (float(at_unix_s), digest, json_text(document)),
            )


def insert_stop(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, cause: str, reason: str) -> None:
    """Insert a stop inside a transaction."""
    values = (ledger_id, float(at_unix_s), cause, reason)
    db.execute("INSERT INTO stop (ledger_id, at_unix_s, cause, reason) VALUES (?, ?, ?, ?)", values)
