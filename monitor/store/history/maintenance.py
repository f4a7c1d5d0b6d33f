"""Maintenance of joints as it was declared, with its outcome; and the estimator's state as people amended it between two replays. I/O."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from monitor.errors import StoreError
from monitor.store.history.database import Database, Document, State, json_text, packed
from monitor.store.history.events import AlertEvent, insert_events

BeliefAndHealth = tuple[Mapping[str, Any], Mapping[str, Any]]  # their documents
_KEYS = ("id", "ledger_id", "joint", "declared_at_unix_s", "document", "undone_at_unix_s", "undone_by", "undone_why")


@dataclass(frozen=True, slots=True, kw_only=True)
class MaintenanceRow:
    """Maintenance of one joint."""

    id: int
    ledger_id: int | None  # the replay whose context declared it; None: a person did
    joint: int
    declared_at_unix_s: float
    document: Document  # of `judge.drift.maintenance.Maintenance`
    undone_at_unix_s: float | None
    undone_by: str | None
    undone_why: str | None

    @property
    def in_force(self) -> bool:
        """Whether nobody has taken it back."""
        return self.undone_at_unix_s is None


@dataclass(frozen=True, slots=True, kw_only=True)
class Amendment:
    """When the estimator's state was changed between two replays. `MaintenanceLog.amended` has the state after it."""

    id: int
    at_unix_s: float


class MaintenanceLog:
    """Maintenance of joints, in the order in which it was declared."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def rows(self, *, joint: int | None = None) -> list[MaintenanceRow]:
        """All maintenance, of one joint (from 1) or of all, the oldest declaration first; those that were taken back included."""
        where, values = ("", ()) if joint is None else ("WHERE joint = ?", (joint,))
        rows = self._db.rows(f"SELECT {', '.join(_KEYS)} FROM maintenance {where} ORDER BY id", values)  # noqa: S608 - fixed names
        return [MaintenanceRow(**dict(zip(_KEYS, row, strict=True)) | {"document": json.loads(row[4])}) for row in rows]

    def declare(
        self, act: Mapping[str, Any], before: BeliefAndHealth, after: BeliefAndHealth, events: Sequence[Mapping[str, Any]], at_unix_s: float
    ) -> list[AlertEvent]:
        """Store maintenance that a person declares, the state after it, and the transitions that follow, in one transaction.

        before : the state that taking it back returns to. Raises StoreError before the first assessment, or where the disk refuses.
        """
        with self._db.transaction() as db:
            values = (int(act["joint"]), float(at_unix_s), json_text(act), *map(packed, before))
            db.execute(
                "INSERT INTO maintenance (joint, declared_at_unix_s, document, belief_before, health_before) VALUES (?, ?, ?, ?, ?)", values
            )
            return _amend(db, after, events, at_unix_s)

    def undo(
        self, row: MaintenanceRow, by: str, why: str, after: BeliefAndHealth, events: Sequence[Mapping[str, Any]], at_unix_s: float
    ) -> list[AlertEvent]:
        """Take maintenance back: the state after that and the transitions that follow, in one transaction. Raises as `declare`."""
        with self._db.transaction() as db:
            db.execute(
                "UPDATE maintenance SET undone_at_unix_s = ?, undone_by = ?, undone_why = ?, belief_before = NULL, health_before = NULL "
                "WHERE id = ?",
                (float(at_unix_s), by, why, row.id),
            )
            return _amend(db, after, events, at_unix_s)

    def before(self, row: MaintenanceRow) -> State | None:
        """Belief and health before a person declared this maintenance; None where they are not kept."""
        ((belief, health),) = self._db.rows("SELECT belief_before, health_before FROM maintenance WHERE id = ?", (row.id,))
        return None if belief is None else State.unpacked(belief, health)

    def amendments(self) -> list[Amendment]:
        """All changes of the estimator's state between two replays, in order."""
        return [Amendment(id=key, at_unix_s=at) for key, at in self._db.rows("SELECT id, at_unix_s FROM amendment ORDER BY id")]

    def amended(self, amendment: Amendment) -> State:
        """Belief and health after an amendment."""
        ((belief, health),) = self._db.rows("SELECT belief, health FROM amendment WHERE id = ?", (amendment.id,))
        return State.unpacked(belief, health)


def insert_maintenance(db: sqlite3.Connection, ledger_id: int, maintenance: Sequence[Mapping[str, Any]]) -> None:
    """Inside the transaction of an assessment: maintenance that its context declares first, and outcomes that it judges."""
    for act in maintenance:
        known = "joint = ? AND declared_at_unix_s = ? AND undone_at_unix_s IS NULL"
        key = (int(act["joint"]), float(act["declared_at_unix_s"]))
        if db.execute(f"UPDATE maintenance SET document = ? WHERE {known}", (json_text(act), *key)).rowcount == 0:  # noqa: S608 - fixed text
            db.execute(
                "INSERT INTO maintenance (ledger_id, joint, declared_at_unix_s, document) VALUES (?, ?, ?, ?)",
                (ledger_id, *key, json_text(act)),
            )


def _amend(db: sqlite3.Connection, after: BeliefAndHealth, events: Sequence[Mapping[str, Any]], at_unix_s: float) -> list[AlertEvent]:
    belief, health = after
    if db.execute("UPDATE state SET belief = ?, health = ?", (json_text(belief), json_text(health))).rowcount != 1:
        raise StoreError("no replay has been assessed yet")
    db.execute("INSERT INTO amendment (at_unix_s, belief, health) VALUES (?, ?, ?)", (float(at_unix_s), packed(belief), packed(health)))
    return insert_events(db, None, at_unix_s, events)
