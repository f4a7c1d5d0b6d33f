"""Assessments with everything that follows from them: friction, the estimator's state, checkpoints, provenance. I/O."""

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import orjson

from monitor.errors import StoreError
from monitor.reason import Sentence
from monitor.store.history.database import Database, Document, State, json_text, packed, reason_column, set_note
from monitor.store.history.events import AlertEvent, insert_events
from monitor.store.history.maintenance import insert_maintenance

CHECKPOINT_EVERY = (
    30  # assessments between two checkpoints, where a recomputation may begin; 5 years have 240 checkpoints at four replays a day
)
SAMPLES = "samples "  # a note's name begins so; its value is the replay

DATED_IN_FUTURE = Sentence("dated_in_future", "dated in the future by a clock that was wrong")


class StoredAssessment(NamedTuple):
    """One past assessment, as it was stored."""

    ledger_id: int
    recorded_at_unix_s: float
    judged_at_unix_s: float
    document: Document
    made_with: str | None  # digest of the provenance; None: made before provenance was kept


class FrictionRow(NamedTuple):
    """Friction of one joint, as one replay found it."""

    replay: int
    joint: int  # from 1
    recorded_at_unix_s: float
    document: Document


class JudgedReplay(NamedTuple):
    """When a replay was made and judged, and with what; `Assessments.document` has what was said."""

    ledger_id: int
    recorded_at_unix_s: float
    judged_at_unix_s: float
    made_with: str | None  # digest of the provenance; None: made before provenance was kept
    assessed: bool = True  # False: it was rejected


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredState:
    """The estimator's present state, as the documents that `judge` made of it."""

    revision: int  # counts assessments
    belief: Document
    health: Document
    model: Document


class Assessments:
    """Past assessments, and the state of the estimator after the last one."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def commit(
        self,
        ledger_id: int,
        *,
        at_unix_s: float,
        recorded_at_unix_s: float,
        samples_digest: str | None = None,
        assessment: Mapping[str, Any],
        friction: Sequence[Mapping[str, Any]],
        belief: Mapping[str, Any],
        health: Mapping[str, Any],
        model: Mapping[str, Any],
        events: Sequence[Mapping[str, Any]],
        made_with: Mapping[str, Any] | None = None,
        maintenance: Sequence[Mapping[str, Any]] = (),
        identified: bytes | None = None,
    ) -> list[AlertEvent]:
        """Store one assessment with everything that follows from it, and its provenance, in one transaction.

        samples_digest : of the recording, by which `replay_of` knows it. identified : what the verdict was made of.
        Returns the events with their numbers. Raises StoreError where the replay does not wait for an assessment, or the disk refuses.
        """
        with self._db.transaction() as db:
            changed = db.execute(
                "UPDATE ledger SET state = 'assessed', ended_at_unix_s = ? WHERE id = ? AND state = 'recorded'",
                (float(at_unix_s), ledger_id),
            ).rowcount
            if changed != 1:
                raise StoreError(f"replay {ledger_id}: not waiting for an assessment")
            digest = None if made_with is None else insert_provenance(db, made_with)
            db.execute("INSERT INTO assessment VALUES (?, ?, ?, ?)", (ledger_id, float(recorded_at_unix_s), json_text(assessment), digest))
            for joint, document in enumerate(friction, start=1):
                db.execute("INSERT INTO friction VALUES (?, ?, ?, ?)", (ledger_id, joint, float(recorded_at_unix_s), json_text(document)))
            db.execute(
                "INSERT INTO state VALUES (1, 1, ?, ?, ?) ON CONFLICT (id) DO UPDATE "
                "SET revision = revision + 1, belief = excluded.belief, health = excluded.health, model = excluded.model",
                (json_text(belief), json_text(health), json_text(model)),
            )
            ((revision,),) = db.execute("SELECT revision FROM state").fetchall()
            if revision % CHECKPOINT_EVERY == 1:
                db.execute("INSERT INTO checkpoint VALUES (?, ?, ?)", (ledger_id, packed(belief), packed(health)))
            if identified is not None:
                db.execute("INSERT INTO identified VALUES (?, ?)", (ledger_id, identified))
            if samples_digest is not None:
                set_note(db, SAMPLES + samples_digest, str(ledger_id))
            insert_maintenance(db, ledger_id, maintenance)
            return insert_events(db, ledger_id, at_unix_s, events)

    def state(self) -> StoredState | None:
        """The estimator's present state; None before the first assessment."""
        rows = self._db.rows("SELECT revision, belief, health, model FROM state")
        if not rows:
            return None
        ((revision, belief, health, model),) = rows
        return StoredState(revision=revision, belief=json.loads(belief), health=json.loads(health), model=json.loads(model))

    def rows(self) -> list[StoredAssessment]:
        """Every past assessment, in the order of their recordings' times."""
        rows = self._db.rows(
            "SELECT ledger_id, recorded_at_unix_s, ended_at_unix_s, document, made_with FROM assessment JOIN ledger ON id = ledger_id "
            "ORDER BY recorded_at_unix_s, ledger_id"
        )
        return [
            StoredAssessment(ledger_id, at, judged_at, json.loads(text), made_with) for ledger_id, at, judged_at, text, made_with in rows
        ]

    def judged(self) -> list[JudgedReplay]:
        """Every past assessment without its document, in the order of their recordings' times: years of documents fill a memory."""
        rows = self._db.rows(
            "SELECT ledger_id, recorded_at_unix_s, ended_at_unix_s, made_with FROM assessment JOIN ledger ON id = ledger_id "
            "ORDER BY recorded_at_unix_s, ledger_id"
        )
        return [JudgedReplay(*row) for row in rows]

    def replay_of(self, samples_digest: str) -> JudgedReplay | None:
        """The assessment of a recording with these samples; None where there is none, or its samples were not noted."""
        rows = self._db.rows(
            "SELECT ledger_id, recorded_at_unix_s, ended_at_unix_s, made_with FROM note "
            "JOIN assessment ON ledger_id = CAST(value AS INTEGER) JOIN ledger ON id = ledger_id WHERE key = ?",
            (SAMPLES + samples_digest,),
        )
        return JudgedReplay(*rows[0]) if rows else None

    def document(self, ledger_id: int) -> Document:
        """What was said of one replay."""
        ((text,),) = self._db.rows("SELECT document FROM assessment WHERE ledger_id = ?", (ledger_id,))
        found: Document = json.loads(text)
        return found

    def provenance(self, digest: str) -> Document:
        """The provenance with this digest."""
        ((document,),) = self._db.rows("SELECT document FROM provenance WHERE digest = ?", (digest,))
        found: Document = json.loads(document)
        return found

    def identified(self, ledger_id: int) -> bytes | None:
        """What the verdict of a replay was made of; None where that was not kept."""
        rows = self._db.rows("SELECT document FROM identified WHERE ledger_id = ?", (ledger_id,)) if self._keeps_identified() else []
        return bytes(rows[0][0]) if rows else None

    def identified_replays(self) -> list[int]:
        """The replays of which that was kept."""
        rows = self._db.rows("SELECT ledger_id FROM identified ORDER BY ledger_id") if self._keeps_identified() else []
        return [int(number) for (number,) in rows]

    def _keeps_identified(self) -> bool:
        """Whether a release that keeps it has written here."""
        return bool(self._db.rows("SELECT 1 FROM sqlite_schema WHERE name = 'identified'"))

    def checkpoint(self, ledger_id: int) -> State | None:
        """Belief and health after this assessment; None where they were not kept."""
        rows = self._db.rows("SELECT belief, health FROM checkpoint WHERE ledger_id = ?", (ledger_id,))
        return State.unpacked(*rows[0]) if rows else None

    def friction(self, *, joint: int | None = None, limit: int | None = None) -> list[Document]:
        """Friction documents in the order of their replays, each with its `replay` (ledger id) and `joint`."""
        where, values = ("", ()) if joint is None else ("WHERE joint = ?", (joint,))
        rows = self._db.rows(
            f"SELECT ledger_id, joint, document FROM friction {where} ORDER BY ledger_id DESC, joint DESC LIMIT ?",  # noqa: S608
            (*values, -1 if limit is None else limit),
        )
        return [{"replay": replay, **json.loads(document), "joint": number} for replay, number, document in reversed(rows)]

    def history(
        self,
        *,
        joint: int | None = None,
        from_unix_s: float | None = None,
        to_unix_s: float | None = None,
        after: int = 0,
        limit: int = 1000,
    ) -> tuple[list[Document], int | None]:
        """Friction documents of recordings made in [from, to), oldest first, each with `replay`, `recorded_at_unix_s` and `joint`.

        A page holds whole replays with ids above `after`, and about `limit` rows at most. The second value is the next `after`; None
        at the end.
        """
        limits = {"ledger_id > ?": after, "joint = ?": joint, "recorded_at_unix_s >= ?": from_unix_s, "recorded_at_unix_s < ?": to_unix_s}
        conditions = {condition: value for condition, value in limits.items() if value is not None}
        rows = self._db.rows(
            "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction "  # noqa: S608 - fixed texts
            f"WHERE {' AND '.join(conditions)} ORDER BY ledger_id, joint LIMIT ?",
            (*conditions.values(), limit + 1),
        )
        more = len(rows) > limit
        if more:
            cut = rows[-1][0]  # this replay may have rows beyond the limit
            whole = [row for row in rows if row[0] != cut]
            rows = whole or self._db.rows(
                "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id = ?1 ORDER BY joint", (cut,)
            )
        # one text and one parse: several times faster than one a row, and five years of a joint have 7300 rows
        documents: list[Document] = orjson.loads(f"[{','.join([row[3] for row in rows])}]")
        for document, (replay, number, at, _) in zip(documents, rows, strict=True):
            document.update(replay=replay, recorded_at_unix_s=at, joint=number)
        return documents, (int(rows[-1][0]) if more else None)

    def replays(self) -> list[int]:
        """Ledger ids of all assessed replays, oldest first."""
        return [int(row[0]) for row in self._db.rows("SELECT ledger_id FROM assessment ORDER BY ledger_id")]

    def friction_of(self, replays: Sequence[int]) -> list[FrictionRow]:
        """The friction of these replays, oldest first."""
        rows = self._db.rows(
            "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id IN (SELECT value FROM json_each(?)) "
            "ORDER BY ledger_id, joint",
            (json.dumps(list(replays)),),
        )
        return [FrictionRow(int(replay), int(joint), float(at), json.loads(text)) for replay, joint, at, text in rows]

    def between(self, from_unix_s: float, to_unix_s: float) -> Iterator[tuple[int, float, Document]]:
        """(replay, when recorded, assessment's document) of recordings made in [from, to), oldest first, one at a time."""
        for replay in [
            row[0]
            for row in self._db.rows(
                "SELECT ledger_id FROM assessment WHERE recorded_at_unix_s >= ? AND recorded_at_unix_s < ? ORDER BY ledger_id",
                (from_unix_s, to_unix_s),
            )
        ]:
            ((at, text),) = self._db.rows("SELECT recorded_at_unix_s, document FROM assessment WHERE ledger_id = ?", (replay,))
            yield int(replay), float(at), json.loads(text)

    def roll_back(self, after_unix_s: float, documents: tuple[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]] | None) -> None:
        """Take back every assessment of a recording dated later than this: a wrong clock has dated it, and its replay becomes rejected.

        documents : those of belief, health and model without them; None where no assessment is left. Windows that were skipped then may
        open again when their time comes; a window in which an arm moved never does.
        """
        with self._db.transaction() as db:
            later = [row[0] for row in db.execute("SELECT ledger_id FROM assessment WHERE recorded_at_unix_s > ?", (after_unix_s,))]
            for ledger_id in later:
                for name in ("friction", "checkpoint", "identified", "assessment", "maintenance"):
                    db.execute(f"DELETE FROM {name} WHERE ledger_id = ?", (ledger_id,))  # noqa: S608 - fixed names
                db.execute("UPDATE ledger SET state = 'rejected', reason = ? WHERE id = ?", (reason_column(DATED_IN_FUTURE()), ledger_id))
            db.execute("DELETE FROM ledger WHERE state = 'skipped' AND window_unix_s > ?", (after_unix_s,))
            db.execute("DELETE FROM production_observation WHERE at_unix_s > ?", (after_unix_s,))
            if documents is None:
                db.execute("DELETE FROM state")
            else:
                db.execute("UPDATE state SET revision = revision + 1, belief = ?, health = ?, model = ?", tuple(map(json_text, documents)))


def insert_provenance(db: sqlite3.Connection, document: Mapping[str, Any]) -> str:
    """Insert what a verdict was made with, inside a transaction; returns its digest."""
    text = json.dumps(document, allow_nan=False, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    db.execute("INSERT OR IGNORE INTO provenance VALUES (?, ?)", (digest, text))
    return digest
