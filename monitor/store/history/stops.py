"""Stored stops, after which a person must check the arm, and stored slow first passes. Both decide how the arm may move. I/O."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from monitor.store.history.database import Database, json_text, set_note

SERIAL = "arm_serial"  # name of the note with the serial number of the arm that this history belongs to
LEFT = "arm_left"  # name of the note that says how the last motion left the arm; there is none where it brought the arm back
ANOTHER_ARM = "another_arm"  # the cause of the stop that another serial number than the expected one is


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
    serial: str | None = None  # of another arm than expected; a person who allows motion accepts that arm

    @property
    def text(self) -> str:
        """As a sentence."""
        if self.cause in STANDING_BY_THEMSELVES:
            return self.reason
        which = "a replay by hand" if self.ledger_id is None else f"replay {self.ledger_id}"
        return f"{which} was ended by {self.cause}: {self.reason}"


# causes that no replay ended by: their reason is the whole sentence
WAY_BACK = "way_back"  # of the entry that a person made of a way back
STANDING_BY_THEMSELVES = frozenset({ANOTHER_ARM, WAY_BACK, "unknown_end", "history_restored"})


class Stops:
    """The stored stops, and the persons who allowed motion again."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def add(self, cause: str, reason: str, at_unix_s: float) -> None:
        """Store the stop of a replay by hand, which the ledger does not have, or what a person allows beyond a stop."""
        with self._db.transaction() as db:
            insert_stop(db, None, at_unix_s, cause, reason)

    def add_another_arm(self, serial: str, reason: str, at_unix_s: float) -> None:
        """Store that another arm than expected answers, once until a person allows it."""
        with self._db.transaction() as db:
            known = db.execute("SELECT 1 FROM stop WHERE serial = ? AND allowed_at_unix_s IS NULL", (serial,)).fetchone()
            if known is None:
                db.execute(
                    "INSERT INTO stop (at_unix_s, cause, reason, serial) VALUES (?, ?, ?, ?)",
                    (float(at_unix_s), ANOTHER_ARM, reason, serial),
                )

    def waiting(self) -> list[Stop]:
        """Stops that nobody has acknowledged, oldest first."""
        return [stop for stop in self.rows() if stop.allowed_at_unix_s is None]

    def rows(self) -> list[Stop]:
        """All stops, oldest first, each with the person who allowed motion again."""
        keys = ("id", "ledger_id", "at_unix_s", "cause", "reason", "allowed_at_unix_s", "allowed_by", "allowed_why", "serial")
        rows = self._db.rows(f"SELECT {', '.join(keys)} FROM stop ORDER BY id")  # noqa: S608 - fixed names
        return [Stop(**dict(zip(keys, row, strict=True))) for row in rows]

    def allow(self, by: str, why: str, at_unix_s: float) -> list[Stop]:
        """Allow motion again: stores the person and the reason with every waiting stop. Returns these stops.

        Where one of them is another arm than expected, that arm is expected from now on, and it must make its first pass slowly.
        """
        with self._db.transaction() as db:
            waiting = self.waiting()
            db.execute(
                "UPDATE stop SET allowed_at_unix_s = ?, allowed_by = ?, allowed_why = ? WHERE allowed_at_unix_s IS NULL",
                (float(at_unix_s), by, why),
            )
            others = [stop.serial for stop in waiting if stop.serial is not None]
            if others:
                db.execute("DELETE FROM note WHERE key = ?", (LEFT,))  # that was another arm
                set_note(db, SERIAL, others[-1])
                # a first pass of no provenance: the latest one is not of this arm, nor is the torque model of that time
                note = json_text({"another_arm": others[-1]})
                db.execute("INSERT INTO first_pass (at_unix_s, circumstances, document) VALUES (?, '', ?)", (float(at_unix_s), note))
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
    """Insert a stop inside a transaction, once for a window and a cause. The window's motions without an end thereby have one."""
    known = "SELECT 1 FROM stop WHERE ledger_id = ? AND cause = ? AND allowed_at_unix_s IS NULL"
    if db.execute(known, (ledger_id, cause)).fetchone() is None:
        values = (ledger_id, float(at_unix_s), cause, reason)
        db.execute("INSERT INTO stop (ledger_id, at_unix_s, cause, reason) VALUES (?, ?, ?, ?)", values)
    db.execute(
        "UPDATE motion SET ended_at_unix_s = ?, ending = ?, reason = ? WHERE ended_at_unix_s IS NULL AND ledger_id IS ?",
        (float(at_unix_s), cause, reason, ledger_id),
    )
