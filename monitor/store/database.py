"""Store: the history in SQLite, the recordings as Parquet beside it, one process at a time.

Order of durability of one replay: ledger row `started` → recording (temporary file, fsync, rename) → ledger row
`recorded` → assessment, belief, health and events in one transaction → publication. `Store.open` says what a crash
between two of these left behind; nothing that moved the arm is ever started again.
"""

import fcntl
import hashlib
import json
import os
import sqlite3
import threading
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import orjson

from monitor.errors import StoreError
from monitor.store.backup import HISTORY, Restored, back_up, connected, hand_over, lost, present, refused_by, restore
from monitor.store.retention import KeptRecording, to_prune
from monitor.store.schema import SCHEMA_VERSION, check_version, migrate, schema_of

_LEDGER_KEYS = ("id", "window_unix_s", "kind", "state", "started_at_unix_s", "ended_at_unix_s", "reason", "recording")
RESTORED = "restored_untold"  # note: what became of a damaged history, until an alert has said so
MOST_BACKUPS = 365  # days: none is let go of where nobody has said how many
CHECKPOINT_EVERY = 30  # assessments; a recomputation need not go further back, and 5 years are 240 of them


class AlertEvent(NamedTuple):
    """One transition of an alert, numbered without gaps in the order in which they happened."""

    seq: int
    at_unix_s: float
    document: dict[str, Any]
    ledger_id: int | None = None  # the replay that brought it about; None: a person, or the monitor itself


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerRow:
    """One window: what was attempted in it and how that ended."""

    id: int
    window_unix_s: float
    kind: str
    state: str
    started_at_unix_s: float
    ended_at_unix_s: float | None
    reason: str | None
    recording: str | None
    removed_at_unix_s: float | None = None  # when retention let go of the recording


class StoredAssessment(NamedTuple):
    """One past assessment, as it was stored."""

    ledger_id: int
    recorded_at_unix_s: float
    judged_at_unix_s: float
    document: dict[str, Any]
    made_with: str | None  # digest of the circumstances; None: made before they were kept


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A replay that was ended by something a person must look at before the arm moves again."""

    id: int
    ledger_id: int | None
    at_unix_s: float
    cause: str
    reason: str
    allowed_at_unix_s: float | None = None  # None: nobody has yet
    allowed_by: str | None = None
    allowed_why: str | None = None

    @property
    def told(self) -> str:
        """In words."""
        which = "a replay by hand" if self.ledger_id is None else f"replay {self.ledger_id}"
        return f"{which} was ended by {self.cause}: {self.reason}"


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredState:
    """What is held true now, as the documents that the rooms wrote."""

    revision: int  # counts assessments
    belief: dict[str, Any]
    health: dict[str, Any]
    model: dict[str, Any]


class Store:
    """One robot's history below one directory.

    Made by `Store.open` (the daemon: locked, migrated) or `Store.reader` (commands: beside a running daemon).
    """

    def __init__(self, directory: Path, connection: sqlite3.Connection, lock: int | None, restored: Restored | None = None) -> None:
        self.directory = directory
        self.restored = restored  # the history was damaged, and this became of it
        self.recordings = directory / "recordings"
        self._db = connection
        self._file_lock = lock
        self._turn = threading.RLock()  # one connection, several threads: a transaction must not open inside another's

    @classmethod
    @contextmanager
    def open(cls, directory: Path) -> Iterator["Store"]:
        """The store for its one writer. A damaged history is set aside and replaced by its newest good backup: see `restored`.

        Raises StoreError where the directory cannot be written, another process has it, or the file is newer.
        """
        try:
            (directory / "recordings").mkdir(parents=True, exist_ok=True)
            lock = os.open(directory / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise refused_by(error, directory) from None
        connection: sqlite3.Connection | None = None
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise StoreError(f"{directory}: in use by another joint-monitor; one daemon per robot and state directory") from None
            wrong = lost(directory)
            restored = restore(directory, wrong) if wrong is not None else None
            try:
                connection = sqlite3.connect(directory / HISTORY, isolation_level=None, check_same_thread=False)
                # before anything is changed in it, as it is for whoever must go back to the older program
                if 0 < schema_of(connection, directory) < SCHEMA_VERSION:
                    back_up(directory, MOST_BACKUPS)
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")  # 0.3 ms a commit, a few a replay: durability costs nothing here
                connection.execute("PRAGMA foreign_keys = ON")
                migrate(connection, directory)
            except sqlite3.DatabaseError as error:
                raise refused_by(error, directory / HISTORY) from None
            store = cls(directory, connection, lock, restored)
            if restored is None and (orphans := store.orphans()):  # a torn log ends at its last sound page, and says nothing
                why = f"{len(orphans)} recordings from replay {orphans[0][0]} on are not in it"
                store.restored = Restored(why, None, None, time.time(), replaced=False)
            if store.restored is not None:
                store._number_events_from(store.restored.at_unix_s)
                store.set_note(RESTORED, store.restored.told)
            yield store
        finally:
            if connection is not None:
                connection.close()
            hand_over(directory)
            os.close(lock)

    @classmethod
    @contextmanager
    def reader(cls, directory: Path) -> Iterator["Store"]:
        """The store for reading, also while the daemon writes.

        Raises StoreError where there is no history yet.
        """
        path = directory / HISTORY
        if not present(directory):
            raise StoreError(f"{path}: no history yet; it is made by the first `joint-monitor run` with this configuration")
        connection = connected(path, "ro", isolation_level=None)
        try:
            check_version(connection, directory)
            yield cls(directory, connection, None)
        except sqlite3.DatabaseError as error:
            raise refused_by(error, path) from None
        finally:
            connection.close()

    @classmethod
    @contextmanager
    def beside(cls, directory: Path) -> Iterator["Store"]:
        """The store for one short note beside a daemon that may run: stops and first passes, nothing of the ledger.

        Raises StoreError where the directory cannot be written, or the file is damaged or newer.
        """
        path = directory / HISTORY
        try:
            (directory / "recordings").mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(path, isolation_level=None, timeout=5.0)
        except (OSError, sqlite3.OperationalError) as error:
            raise refused_by(error, directory) from None
        try:
            schema_of(connection, directory)
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            migrate(connection, directory)
            yield cls(directory, connection, None)
        except sqlite3.DatabaseError as error:
            raise refused_by(error, path) from None
        finally:
            connection.close()
            hand_over(directory)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._turn:
            try:
                self._db.execute("BEGIN IMMEDIATE")
                try:
                    yield self._db
                except BaseException:
                    if self._db.in_transaction:  # a full disk has rolled back already
                        self._db.execute("ROLLBACK")
                    raise
                self._db.execute("COMMIT")
            except sqlite3.Error as error:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise refused_by(error, self.directory / HISTORY) from error

    def _rows(self, query: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._turn:
            try:
                return self._db.execute(query, values).fetchall()
            except sqlite3.Error as error:
                raise refused_by(error, self.directory / HISTORY) from error

    # --- the ledger -------------------------------------------------------------------------

    def claim(self, window_unix_s: float, kind: str, at_unix_s: float) -> int | None:
        """Enter a window as started, before anything moves; None where it is in the ledger already."""
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT OR IGNORE INTO ledger (window_unix_s, kind, state, started_at_unix_s) VALUES (?, ?, 'started', ?)",
                (float(window_unix_s), kind, float(at_unix_s)),
            )
            return int(cursor.lastrowid or 0) if cursor.rowcount else None

    def claim_import(self, recorded_at_unix_s: float, at_unix_s: float) -> int | None:
        """Enter a recording made elsewhere as started, under the time when it was made; None where the ledger knows that time already.

        An import that was cut short is taken up again.
        """
        with self._transaction() as db:
            again = db.execute(
                "UPDATE ledger SET state = 'started', reason = NULL, ended_at_unix_s = NULL "
                "WHERE window_unix_s = ? AND kind = 'imported' AND state = 'aborted' RETURNING id",
                (float(recorded_at_unix_s),),
            ).fetchone()
            if again is not None:
                return int(again[0])
        return self.claim(recorded_at_unix_s, "imported", at_unix_s)

    def recording_path(self, ledger_id: int) -> Path:
        """Where the recording of a window belongs; the name alone leads back to the ledger."""
        return self.recordings / f"replay-{ledger_id:06d}.parquet"

    def recorded(self, ledger_id: int) -> None:
        """The recording is safe on disk under `recording_path`."""
        name = self.recording_path(ledger_id).name
        with self._transaction() as db:
            db.execute("UPDATE ledger SET state = 'recorded', recording = ? WHERE id = ? AND state = 'started'", (name, ledger_id))

    def end(self, ledger_id: int, state: str, reason: str, at_unix_s: float, *, stop: str | None = None) -> None:
        """A window ended without an assessment: rejected, aborted or skipped, and why. `stop`: the cause that a person must look at."""
        with self._transaction() as db:
            db.execute(
                "UPDATE ledger SET state = ?, reason = ?, ended_at_unix_s = ? WHERE id = ? AND state IN ('started', 'recorded')",
                (state, reason, float(at_unix_s), ledger_id),
            )
            if stop is not None:
                _note_stop(db, ledger_id, at_unix_s, stop, reason)

    def ledger(self, *, limit: int | None = None, states: Sequence[str] = ()) -> list[LedgerRow]:
        """Windows, oldest first; the last `limit` of them, only those in `states` where given."""
        where = f"WHERE state IN ({', '.join('?' * len(states))})" if states else ""
        rows = self._rows(
            "SELECT id, window_unix_s, kind, state, started_at_unix_s, ended_at_unix_s, reason, recording, removed_at_unix_s "  # noqa: S608
            f"FROM ledger {where} ORDER BY id DESC LIMIT ?",
            (*states, -1 if limit is None else limit),
        )
        keys = (*_LEDGER_KEYS, "removed_at_unix_s")
        return [LedgerRow(**dict(zip(keys, row, strict=True))) for row in reversed(rows)]

    def row(self, ledger_id: int) -> LedgerRow:
        """One window."""
        found = self._rows(f"SELECT {', '.join(_LEDGER_KEYS)} FROM ledger WHERE id = ?", (ledger_id,))  # noqa: S608 - fixed names
        return LedgerRow(**dict(zip(_LEDGER_KEYS, found[0], strict=True)))

    def repair(self, at_unix_s: float, but: int | None = None) -> list[LedgerRow]:
        """What a crash left half-way: `started` with its complete recording on disk becomes `recorded`, without it `aborted`.

        `but`: the one that is under way. Returns the rows that wait for their assessment, oldest first.
        """
        for leftover in self.recordings.glob(".*.tmp*"):
            leftover.unlink()  # never renamed, so never promised
        for row in self.ledger(states=("started",)):
            if row.id == but:
                continue
            if self.recording_path(row.id).is_file():
                self.recorded(row.id)
            else:
                self.end(row.id, "aborted", "the monitor ended during this replay", at_unix_s)
        return self.ledger(states=("recorded",))

    def windows(self, from_unix_s: float, to_unix_s: float) -> set[float]:
        """The windows in [from, to] that the ledger has, however they ended."""
        return {
            row[0] for row in self._rows("SELECT window_unix_s FROM ledger WHERE window_unix_s BETWEEN ? AND ?", (from_unix_s, to_unix_s))
        }

    def newest_unix_s(self) -> float | None:
        """The latest time at which something was entered that is, or may become, part of what is held true."""
        ((at,),) = self._rows("SELECT max(started_at_unix_s) FROM ledger WHERE state IN ('started', 'recorded', 'assessed')")
        return None if at is None else float(at)

    def began_unix_s(self) -> float | None:
        """When this history's first window was entered; None before."""
        ((at,),) = self._rows("SELECT min(started_at_unix_s) FROM ledger WHERE kind <> 'imported'")
        return None if at is None else float(at)

    def unfinished(self) -> bool:
        """Windows that are entered, and neither judged nor ended."""
        return bool(self._rows("SELECT 1 FROM ledger WHERE state IN ('started', 'recorded') LIMIT 1"))

    def orphans(self) -> list[tuple[int, Path]]:
        """Recordings whose window the ledger does not know, as after a restored backup; oldest first."""
        known = {row[0] for row in self._rows("SELECT id FROM ledger")}
        found = {int(path.stem.removeprefix("replay-")): path for path in self.recordings.glob("replay-" + "[0-9]" * 6 + ".parquet")}
        return [(number, found[number]) for number in sorted(found) if number not in known]

    def adopt(self, ledger_id: int, window_unix_s: float, at_unix_s: float) -> None:
        """Enter an orphan under the number that its name says; it waits for its assessment."""
        with self._transaction() as db:
            db.execute(
                "INSERT INTO ledger (id, window_unix_s, kind, state, started_at_unix_s, reason, recording) "
                "VALUES (?, ?, 'scheduled', 'recorded', ?, 'found on disk after the history was restored', ?)",
                (ledger_id, float(window_unix_s), float(at_unix_s), self.recording_path(ledger_id).name),
            )

    # --- stops that wait for a person, and first passes ---------------------------------------

    def stopped(self, cause: str, reason: str, at_unix_s: float) -> None:
        """A replay beside the schedule was ended by something that a person must look at."""
        with self._transaction() as db:
            _note_stop(db, None, at_unix_s, cause, reason)

    def waiting_stops(self) -> list[Stop]:
        """Stops that nobody has acknowledged, oldest first."""
        return [stop for stop in self.stops() if stop.allowed_at_unix_s is None]

    def stops(self) -> list[Stop]:
        """All of them, oldest first, each with who said that the arm may move again."""
        keys = ("id", "ledger_id", "at_unix_s", "cause", "reason", "allowed_at_unix_s", "allowed_by", "allowed_why")
        rows = self._rows(f"SELECT {', '.join(keys)} FROM stop ORDER BY id")  # noqa: S608 - fixed names
        return [Stop(**dict(zip(keys, row, strict=True))) for row in rows]

    def allow(self, by: str, why: str, at_unix_s: float) -> list[Stop]:
        """A person has looked: the arm may move again. Returns the stops that were waiting, and keeps by whom and why with them."""
        with self._transaction() as db:
            waiting = self.waiting_stops()
            db.execute(
                "UPDATE stop SET allowed_at_unix_s = ?, allowed_by = ?, allowed_why = ? WHERE allowed_at_unix_s IS NULL",
                (float(at_unix_s), by, why),
            )
        return waiting

    def first_passed(self, circumstances: str) -> bool:
        """Was the latest first pass made in these circumstances?"""
        rows = self._rows("SELECT circumstances FROM first_pass ORDER BY id DESC LIMIT 1")
        return bool(rows) and rows[0][0] == circumstances

    def latest_first_pass(self) -> dict[str, Any] | None:
        """Its document."""
        rows = self._rows("SELECT document FROM first_pass ORDER BY id DESC LIMIT 1")
        return json.loads(rows[0][0]) if rows else None

    def first_pass_path(self, ledger_id: int) -> Path:
        """Where the recording of a window's first pass belongs."""
        return self.recordings / f"replay-{ledger_id:06d}-first-pass.parquet"

    def first_pass(self, circumstances: str, document: Mapping[str, Any], at_unix_s: float) -> None:
        """The arm has been along its trajectory slowly, in these circumstances."""
        with self._transaction() as db:
            db.execute(
                "INSERT INTO first_pass (at_unix_s, circumstances, document) VALUES (?, ?, ?)",
                (float(at_unix_s), circumstances, _text(document)),
            )

    # --- assessments ------------------------------------------------------------------------

    def commit(
        self,
        ledger_id: int,
        *,
        at_unix_s: float,
        recorded_at_unix_s: float,
        assessment: Mapping[str, Any],
        friction: Sequence[Mapping[str, Any]],
        belief: Mapping[str, Any],
        health: Mapping[str, Any],
        model: Mapping[str, Any],
        events: Sequence[Mapping[str, Any]],
        made_with: Mapping[str, Any] | None = None,
    ) -> list[AlertEvent]:
        """One assessment with all that follows from it, and what it was made with, in one transaction.

        Returns the events with the sequence numbers that they were given.
        """
        with self._transaction() as db:
            changed = db.execute(
                "UPDATE ledger SET state = 'assessed', ended_at_unix_s = ? WHERE id = ? AND state = 'recorded'",
                (float(at_unix_s), ledger_id),
            ).rowcount
            if changed != 1:
                raise StoreError(f"replay {ledger_id}: not waiting for an assessment")
            digest = None if made_with is None else _kept_once(db, made_with)
            db.execute("INSERT INTO assessment VALUES (?, ?, ?, ?)", (ledger_id, float(recorded_at_unix_s), _text(assessment), digest))
            for joint, document in enumerate(friction, start=1):
                db.execute("INSERT INTO friction VALUES (?, ?, ?, ?)", (ledger_id, joint, float(recorded_at_unix_s), _text(document)))
            db.execute(
                "INSERT INTO state VALUES (1, 1, ?, ?, ?) ON CONFLICT (id) DO UPDATE "
                "SET revision = revision + 1, belief = excluded.belief, health = excluded.health, model = excluded.model",
                (_text(belief), _text(health), _text(model)),
            )
            ((revision,),) = db.execute("SELECT revision FROM state").fetchall()
            if revision % CHECKPOINT_EVERY == 1:
                db.execute("INSERT INTO checkpoint VALUES (?, ?, ?)", (ledger_id, _packed(belief), _packed(health)))
            return _numbered(db, ledger_id, at_unix_s, events)

    def state(self) -> StoredState | None:
        """What is held true now; None before the first assessment."""
        rows = self._rows("SELECT revision, belief, health, model FROM state")
        if not rows:
            return None
        ((revision, belief, health, model),) = rows
        return StoredState(revision=revision, belief=json.loads(belief), health=json.loads(health), model=json.loads(model))

    def verdicts(self) -> list[StoredAssessment]:
        """Every past assessment in the order in which they were made."""
        rows = self._rows(
            "SELECT ledger_id, recorded_at_unix_s, ended_at_unix_s, document, made_with FROM assessment JOIN ledger ON id = ledger_id "
            "ORDER BY recorded_at_unix_s, ledger_id"
        )
        return [
            StoredAssessment(ledger_id, at, judged_at, json.loads(text), made_with) for ledger_id, at, judged_at, text, made_with in rows
        ]

    def made_with(self, digest: str) -> dict[str, Any]:
        """The circumstances of that digest."""
        ((document,),) = self._rows("SELECT document FROM circumstance WHERE digest = ?", (digest,))
        told: dict[str, Any] = json.loads(document)
        return told

    def checkpoint(self, ledger_id: int) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Belief and health after this assessment, where they were kept."""
        rows = self._rows("SELECT belief, health FROM checkpoint WHERE ledger_id = ?", (ledger_id,))
        return (json.loads(zlib.decompress(rows[0][0])), json.loads(zlib.decompress(rows[0][1]))) if rows else None

    def friction(self, *, joint: int | None = None, limit: int | None = None) -> list[dict[str, Any]]:
        """Friction documents in the order of their replays, each with its `replay` (ledger id) and `joint`."""
        where, values = ("", ()) if joint is None else ("WHERE joint = ?", (joint,))
        rows = self._rows(
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
    ) -> tuple[list[dict[str, Any]], int | None]:
        """Friction documents of recordings made in [from, to), oldest first, each with `replay`, `recorded_at_unix_s` and `joint`.

        A page holds whole replays, those after the replay `after`, and at most about `limit` rows; with it comes the `after` of the next
        page, None at the end.
        """
        asked = {"ledger_id > ?": after, "joint = ?": joint, "recorded_at_unix_s >= ?": from_unix_s, "recorded_at_unix_s < ?": to_unix_s}
        conditions = {condition: value for condition, value in asked.items() if value is not None}
        rows = self._rows(
            "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction "  # noqa: S608 - fixed texts
            f"WHERE {' AND '.join(conditions)} ORDER BY ledger_id, joint LIMIT ?",
            (*conditions.values(), limit + 1),
        )
        more = len(rows) > limit
        if more:
            cut = rows[-1][0]  # this replay may go on beyond the limit
            whole = [row for row in rows if row[0] != cut]
            rows = whole or self._rows(
                "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id = ?1 ORDER BY joint", (cut,)
            )
        # one text and one parse: several times faster than one a row, and five years of a joint are 7300
        told: list[dict[str, Any]] = orjson.loads(f"[{','.join([row[3] for row in rows])}]")
        for document, (replay, number, at, _) in zip(told, rows, strict=True):
            document.update(replay=replay, recorded_at_unix_s=at, joint=number)
        return told, (int(rows[-1][0]) if more else None)

    def assessed(self) -> list[int]:
        """Ledger ids of all assessed replays, oldest first."""
        return [int(row[0]) for row in self._rows("SELECT ledger_id FROM assessment ORDER BY ledger_id")]

    def friction_of(self, replays: Sequence[int]) -> list[tuple[int, int, float, dict[str, Any]]]:
        """(replay, joint, when recorded, friction document) of these replays, oldest first."""
        rows = self._rows(
            "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id IN (SELECT value FROM json_each(?)) "
            "ORDER BY ledger_id, joint",
            (json.dumps(list(replays)),),
        )
        return [(int(replay), int(joint), float(at), json.loads(text)) for replay, joint, at, text in rows]

    def assessments(self, from_unix_s: float, to_unix_s: float) -> Iterator[tuple[int, float, dict[str, Any]]]:
        """(replay, when recorded, assessment's document) of recordings made in [from, to), oldest first, one at a time."""
        for replay in [
            row[0]
            for row in self._rows(
                "SELECT ledger_id FROM assessment WHERE recorded_at_unix_s >= ? AND recorded_at_unix_s < ? ORDER BY ledger_id",
                (from_unix_s, to_unix_s),
            )
        ]:
            ((at, text),) = self._rows("SELECT recorded_at_unix_s, document FROM assessment WHERE ledger_id = ?", (replay,))
            yield int(replay), float(at), json.loads(text)

    # --- events -----------------------------------------------------------------------------

    def revise(self, health: Mapping[str, Any], events: Sequence[Mapping[str, Any]], at_unix_s: float) -> list[AlertEvent]:
        """What a person did to alerts, in one transaction: the health that follows, and the transitions with their numbers."""
        with self._transaction() as db:
            if db.execute("UPDATE state SET health = ?", (_text(health),)).rowcount != 1:
                raise StoreError("no replay has been assessed yet")
            return _numbered(db, None, at_unix_s, events)

    def events(self, *, unpublished: bool = False, after: int = 0, limit: int | None = None) -> list[AlertEvent]:
        """The newest `limit` transitions after number `after`, in order; only those that were never published where asked."""
        rows = self._rows(
            "SELECT seq, at_unix_s, document, ledger_id FROM event WHERE published <= ? AND seq > ? ORDER BY seq DESC LIMIT ?",
            (0 if unpublished else 1, after, -1 if limit is None else limit),
        )
        return [AlertEvent(seq, at, json.loads(document), ledger_id) for seq, at, document, ledger_id in reversed(rows)]

    def _number_events_from(self, at_unix_s: float) -> None:
        """The numbers that a damaged history gave out since its backup are not known, and must not mean something else to who heard them.

        Transitions are rarer than one a minute: the minutes since 1970 are a number that none of them had.
        """
        with self._transaction() as db:
            ((newest,),) = db.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = 'event'").fetchall()
            db.execute("DELETE FROM sqlite_sequence WHERE name = 'event'")
            db.execute("INSERT INTO sqlite_sequence VALUES ('event', ?)", (max(newest or 0, int(at_unix_s / 60.0)),))

    def event_range(self) -> tuple[int, int] | None:
        """Numbers of the oldest and of the newest transition kept; None where there is none."""
        ((oldest, newest),) = self._rows("SELECT min(seq), max(seq) FROM event")
        return None if oldest is None else (int(oldest), int(newest))

    def published(self, seq: int) -> None:
        """The event is on the bus."""
        with self._transaction() as db:
            db.execute("UPDATE event SET published = 1 WHERE seq = ?", (seq,))

    def take_back(self, after_unix_s: float, held: tuple[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]] | None) -> None:
        """Replays dated later were dated by a wrong clock: rejected, their verdicts removed; belief, health and model as they are without.

        Windows that were skipped then may open once more when their time comes; one in which an arm moved never does.
        """
        reason = "dated in the future by a clock that was wrong"
        with self._transaction() as db:
            later = [row[0] for row in db.execute("SELECT ledger_id FROM assessment WHERE recorded_at_unix_s > ?", (after_unix_s,))]
            for ledger_id in later:
                for name in ("friction", "checkpoint", "assessment"):
                    db.execute(f"DELETE FROM {name} WHERE ledger_id = ?", (ledger_id,))  # noqa: S608 - fixed names
                db.execute("UPDATE ledger SET state = 'rejected', reason = ? WHERE id = ?", (reason, ledger_id))
            db.execute("DELETE FROM ledger WHERE state = 'skipped' AND window_unix_s > ?", (after_unix_s,))
            if held is None:
                db.execute("DELETE FROM state")
            else:
                db.execute("UPDATE state SET revision = revision + 1, belief = ?, health = ?, model = ?", tuple(map(_text, held)))

    # --- upkeep -----------------------------------------------------------------------------

    def note(self, key: str) -> str | None:
        """A small fact that was noted."""
        rows = self._rows("SELECT value FROM note WHERE key = ?", (key,))
        return str(rows[0][0]) if rows else None

    def set_note(self, key: str, value: str) -> None:
        """Note it, in place of what was noted before."""
        with self._transaction() as db:
            db.execute("INSERT INTO note VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = excluded.value", (key, value))

    def back_up(self, keep: int) -> Path:
        """A backup now, beside whoever writes; of each of the newest `keep` days the newest stays. Raises StoreError."""
        return back_up(self.directory, keep)

    def prune(self, *, days: float, most_bytes: float, at_unix_s: float) -> list[str]:
        """Remove the recordings beyond these limits (0: none), and note it with their windows. Returns their names.

        Raises StoreError where one cannot be removed.
        """
        kept = []
        for row in self.ledger(states=("assessed", "rejected")):
            if row.recording is None or row.removed_at_unix_s is not None:
                continue
            path = self.recordings / row.recording
            try:
                kept.append(KeptRecording(row.id, path, row.started_at_unix_s, path.stat().st_size))
            except FileNotFoundError:
                self._note_removed(row.id, at_unix_s)  # a person took it, or a crash came between removing and noting
        going = to_prune(kept, days=days, most_bytes=most_bytes, now_unix_s=at_unix_s)
        for each in going:
            try:
                each.path.unlink(missing_ok=True)
                self.first_pass_path(each.ledger_id).unlink(missing_ok=True)
            except OSError as error:
                raise StoreError(f"{each.path}: cannot be removed: {error.strerror}") from None
            self._note_removed(each.ledger_id, at_unix_s)
        return [each.path.name for each in going]

    def _note_removed(self, ledger_id: int, at_unix_s: float) -> None:
        with self._transaction() as db:
            db.execute("UPDATE ledger SET removed_at_unix_s = ? WHERE id = ?", (float(at_unix_s), ledger_id))


def _kept_once(db: sqlite3.Connection, document: Mapping[str, Any]) -> str:
    text = json.dumps(document, allow_nan=False, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    db.execute("INSERT OR IGNORE INTO circumstance VALUES (?, ?)", (digest, text))
    return digest


def _packed(document: Mapping[str, Any]) -> bytes:
    return zlib.compress(_text(document).encode())


def _numbered(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, events: Sequence[Mapping[str, Any]]) -> list[AlertEvent]:
    numbered = []
    for document in events:
        cursor = db.execute(
            "INSERT INTO event (ledger_id, at_unix_s, document) VALUES (?, ?, ?)", (ledger_id, float(at_unix_s), _text(document))
        )
        numbered.append(AlertEvent(int(cursor.lastrowid or 0), float(at_unix_s), dict(document), ledger_id))
    return numbered


def _note_stop(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, cause: str, reason: str) -> None:
    values = (ledger_id, float(at_unix_s), cause, reason)
    db.execute("INSERT INTO stop (ledger_id, at_unix_s, cause, reason) VALUES (?, ?, ?, ?)", values)


def _text(document: Mapping[str, Any]) -> str:
    # NaN would be stored as a word that no other JSON reader knows: refuse it here, where the culprit is still on the stack
    return json.dumps(document, allow_nan=False, separators=(",", ":"))
