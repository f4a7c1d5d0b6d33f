"""Friction from production: the sums that are being gathered, and every observation that was judged. I/O."""

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from monitor.errors import StoreError
from monitor.store.history.assessments import insert_provenance
from monitor.store.history.database import Database, Document, json_text, packed, unpacked
from monitor.store.history.events import AlertEvent, insert_events

_KEYS = ("day", "at_unix_s", "document", "context", "learnt", "made_with")

PINNED = "production_arm"  # name of the note with the replay whose model frees production from the arm's weight and inertia


@dataclass(frozen=True, slots=True, kw_only=True)
class DayOfProduction:
    """The observation of one UTC day, as it was judged."""

    day: int  # counted from 1970-01-01
    at_unix_s: float  # when it was judged
    document: Document  # of `judge.production_observation.ProductionObservation`
    context: Document  # of `recording.Context`
    learnt: tuple[int, ...]  # joints (from 1) that the judge learned from
    made_with: str  # digest of the provenance


class ProductionLog:
    """Observations from production, one a UTC day at most."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def information(self) -> Document | None:
        """The document of the sums as they were kept last; None where none were."""
        rows = self._db.rows("SELECT document FROM production_sums")
        return unpacked(rows[0][0]) if rows else None

    def keep_information(self, document: Mapping[str, Any], at_unix_s: float) -> None:
        """Keep the sums. Raises StoreError."""
        with self._db.transaction() as db:
            _keep(db, document, at_unix_s)

    def commit(
        self,
        row: DayOfProduction,
        *,
        information: Mapping[str, Any],
        belief: Mapping[str, Any],
        health: Mapping[str, Any],
        events: Sequence[Mapping[str, Any]],
        made_with: Mapping[str, Any],
    ) -> list[AlertEvent]:
        """Store one observation with the state after it and the transitions that follow, in one transaction.

        Raises StoreError where that day is judged already, before the first assessment, or where the disk refuses.
        """
        with self._db.transaction() as db:
            digest = insert_provenance(db, made_with)
            try:
                db.execute(
                    "INSERT INTO production_observation VALUES (?, ?, ?, ?, ?, ?)",
                    (row.day, row.at_unix_s, json_text(row.document), json_text(row.context), json.dumps(row.learnt), digest),
                )
            except sqlite3.IntegrityError:
                raise StoreError(f"production of day {row.day} is judged already") from None
            changed = db.execute(
                "UPDATE state SET revision = revision + 1, belief = ?, health = ?", (json_text(belief), json_text(health))
            ).rowcount
            if changed != 1:
                raise StoreError("production cannot be judged before the first replay was assessed")
            _keep(db, information, row.at_unix_s)
            return insert_events(db, None, row.at_unix_s, events)

    def newest_day(self, at_most: int) -> int | None:
        """The newest day that was judged, up to this one; None where none was."""
        day: int | None = self._db.rows("SELECT max(day) FROM production_observation WHERE day <= ?", (at_most,))[0][0]
        return day

    def rows(self, *, after_day: int = -1, limit: int | None = None) -> list[DayOfProduction]:
        """The newest `limit` observations of days after this one, oldest first."""
        rows = self._db.rows(
            f"SELECT {', '.join(_KEYS)} FROM production_observation WHERE day > ? ORDER BY day DESC LIMIT ?",  # noqa: S608 - fixed names
            (after_day, -1 if limit is None else limit),
        )
        return [
            DayOfProduction(
                day=day,
                at_unix_s=at,
                document=json.loads(document),
                context=json.loads(context),
                learnt=tuple(json.loads(learnt)),
                made_with=made_with,
            )
            for day, at, document, context, learnt, made_with in reversed(rows)
        ]


def _keep(db: sqlite3.Connection, document: Mapping[str, Any], at_unix_s: float) -> None:
    db.execute(
        "INSERT INTO production_sums VALUES (1, ?, ?) ON CONFLICT (id) DO UPDATE SET at_unix_s = excluded.at_unix_s, "
        "document = excluded.document",
        (float(at_unix_s), packed(document)),
    )
