"""Store: the history in SQLite, the recordings as Parquet beside it, one process at a time.

Order of durability of one replay: ledger row `started` → recording (temporary file, fsync, rename) → ledger row
`recorded` → assessment, belief, health and events in one transaction → publication. `Store.open` says what a crash
between two of these left behind; nothing that moved the arm is ever started again.
"""

import fcntl
import json
import os
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import StoreError

SCHEMA_VERSION = 2
_MIGRATIONS: dict[int, str] = {
    1: """
    CREATE TABLE ledger (
        id INTEGER PRIMARY KEY,
        window_unix_s REAL NOT NULL UNIQUE,       -- the window that the schedule named: never replayed twice
        kind TEXT NOT NULL CHECK (kind IN ('scheduled', 'requested', 'imported')),
        state TEXT NOT NULL CHECK (state IN ('started', 'recorded', 'assessed', 'rejected', 'aborted', 'skipped')),
        started_at_unix_s REAL NOT NULL,
        ended_at_unix_s REAL,
        reason TEXT,
        recording TEXT                            -- file name below recordings/
    ) STRICT;
    CREATE TABLE assessment (
        ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id),
        recorded_at_unix_s REAL NOT NULL,
        document TEXT NOT NULL
    ) STRICT;
    CREATE TABLE friction (
        ledger_id INTEGER NOT NULL REFERENCES ledger (id),
        joint INTEGER NOT NULL CHECK (joint >= 1),
        recorded_at_unix_s REAL NOT NULL,
        document TEXT NOT NULL,
        PRIMARY KEY (ledger_id, joint)
    ) STRICT;
    CREATE INDEX friction_by_joint ON friction (joint, recorded_at_unix_s);
    CREATE TABLE state (
        id INTEGER PRIMARY KEY CHECK (id = 1),
        revision INTEGER NOT NULL,
        belief TEXT NOT NULL,
        health TEXT NOT NULL,
        model TEXT NOT NULL
    ) STRICT;
    CREATE TABLE event (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        ledger_id INTEGER REFERENCES ledger (id),
        at_unix_s REAL NOT NULL,
        document TEXT NOT NULL,
        published INTEGER NOT NULL DEFAULT 0
    ) STRICT;
    """,
    2: """
    CREATE TABLE stop (                           -- a replay that ended in a way that a person must look at
        id INTEGER PRIMARY KEY,
        ledger_id INTEGER REFERENCES ledger (id), -- none: `joint-monitor replay`, beside the schedule
        at_unix_s REAL NOT NULL,
        cause TEXT NOT NULL,
        reason TEXT NOT NULL,
        allowed_at_unix_s REAL,                   -- since when the arm may move again
        allowed_by TEXT,
        allowed_why TEXT
    ) STRICT;
    CREATE TABLE first_pass (                     -- which arm, in which circumstances, has been along its trajectory slowly
        id INTEGER PRIMARY KEY,
        at_unix_s REAL NOT NULL,
        circumstances TEXT NOT NULL,              -- digest
        document TEXT NOT NULL
    ) STRICT;
    """,
}


class Event(NamedTuple):
    """One transition of an alert, numbered without gaps in the order in which they happened."""

    seq: int
    at_unix_s: float
    document: dict[str, Any]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A replay that was ended by something a person must look at before the arm moves again."""

    id: int
    ledger_id: int | None
    at_unix_s: float
    cause: str
    reason: str

    @property
    def told(self) -> str:
        """In words."""
        which = "a replay by hand" if self.ledger_id is None else f"replay {self.ledger_id}"
        return f"{which} was ended by {self.cause}: {self.reason}"


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """What is held true now, as the documents that the rooms wrote."""

    revision: int  # counts assessments
    belief: dict[str, Any]
    health: dict[str, Any]
    model: dict[str, Any]


class Store:
    """One robot's history below one directory.

    Made by `Store.open` (the daemon: locked, migrated) or `Store.reader` (commands: beside a running daemon).
    """

    def __init__(self, directory: Path, connection: sqlite3.Connection, lock: int | None) -> None:
        self.directory = directory
        self.recordings = directory / "recordings"
        self._db = connection
        self._file_lock = lock
        self._turn = threading.RLock()  # one connection, several threads: a transaction must not open inside another's

    @classmethod
    @contextmanager
    def open(cls, directory: Path) -> Iterator["Store"]:
        """The store for its one writer.

        Raises StoreError where the directory cannot be written, another process has it, or the file is damaged or newer.
        """
        try:
            (directory / "recordings").mkdir(parents=True, exist_ok=True)
            lock = os.open(directory / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise StoreError(f"{directory}: cannot be written: {error.strerror}") from None
        connection: sqlite3.Connection | None = None
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise StoreError(f"{directory}: in use by another joint-monitor; one daemon per robot and state directory") from None
            try:
                connection = sqlite3.connect(directory / "history.sqlite", isolation_level=None, check_same_thread=False)
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")  # 0.3 ms a commit, a few a replay: durability costs nothing here
                connection.execute("PRAGMA foreign_keys = ON")
                check = connection.execute("PRAGMA quick_check").fetchone()[0]
                if check != "ok":
                    raise StoreError(f"{directory / 'history.sqlite'}: damaged ({check}); restore a backup or move the file away")
                _migrate(connection, directory)
            except sqlite3.DatabaseError as error:
                raise StoreError(f"{directory / 'history.sqlite'}: {error}") from None
            yield cls(directory, connection, lock)
        finally:
            if connection is not None:
                connection.close()
            os.close(lock)

    @classmethod
    @contextmanager
    def reader(cls, directory: Path) -> Iterator["Store"]:
        """The store for reading, also while the daemon writes.

        Raises StoreError where there is no history yet.
        """
        path = directory / "history.sqlite"
        if not path.is_file():
            raise StoreError(f"{path}: no history yet; it is made by the first `joint-monitor run` with this configuration")
        connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True, isolation_level=None)
        try:
            _check_version(connection, directory)
            yield cls(directory, connection, None)
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{path}: {error}") from None
        finally:
            connection.close()

    @classmethod
    @contextmanager
    def beside(cls, directory: Path) -> Iterator["Store"]:
        """The store for one short note beside a daemon that may run: stops and first passes, nothing of the ledger.

        Raises StoreError where the directory cannot be written, or the file is damaged or newer.
        """
        path = directory / "history.sqlite"
        try:
            (directory / "recordings").mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(path, isolation_level=None, timeout=5.0)
        except (OSError, sqlite3.OperationalError) as error:
            raise StoreError(f"{directory}: cannot be written: {error}") from None
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            _migrate(connection, directory)
            yield cls(directory, connection, None)
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{path}: {error}") from None
        finally:
            connection.close()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._turn:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")

    def _rows(self, query: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._turn:
            return self._db.execute(query, values).fetchall()

    # --- the ledger -------------------------------------------------------------------------

    def claim(self, window_unix_s: float, kind: str, at_unix_s: float) -> int | None:
        """Enter a window as started, before anything moves; None where it is in the ledger already."""
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT OR IGNORE INTO ledger (window_unix_s, kind, state, started_at_unix_s) VALUES (?, ?, 'started', ?)",
                (float(window_unix_s), kind, float(at_unix_s)),
            )
            return int(cursor.lastrowid or 0) if cursor.rowcount else None

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
            "SELECT id, window_unix_s, kind, state, started_at_unix_s, ended_at_unix_s, reason, recording "  # noqa: S608 - placeholders only
            f"FROM ledger {where} ORDER BY id DESC LIMIT ?",
            (*states, -1 if limit is None else limit),
        )
        keys = ("id", "window_unix_s", "kind", "state", "started_at_unix_s", "ended_at_unix_s", "reason", "recording")
        return [LedgerRow(**dict(zip(keys, row, strict=True))) for row in reversed(rows)]

    def repair(self, at_unix_s: float) -> list[LedgerRow]:
        """What a crash left half-way: `started` with its complete recording on disk becomes `recorded`, without it `aborted`.

        Returns the rows that wait for their assessment, oldest first.
        """
        for leftover in self.recordings.glob(".*.tmp*"):
            leftover.unlink()  # never renamed, so never promised
        for row in self.ledger(states=("started",)):
            if self.recording_path(row.id).is_file():
                self.recorded(row.id)
            else:
                self.end(row.id, "aborted", "the monitor ended during this replay", at_unix_s)
        return self.ledger(states=("recorded",))

    # --- stops that wait for a person, and first passes ---------------------------------------

    def stopped(self, cause: str, reason: str, at_unix_s: float) -> None:
        """A replay beside the schedule was ended by something that a person must look at."""
        with self._transaction() as db:
            _note_stop(db, None, at_unix_s, cause, reason)

    def waiting_stops(self) -> list[Stop]:
        """Stops that nobody has acknowledged, oldest first."""
        rows = self._rows("SELECT id, ledger_id, at_unix_s, cause, reason FROM stop WHERE allowed_at_unix_s IS NULL ORDER BY id")
        return [Stop(id=id_, ledger_id=ledger, at_unix_s=at, cause=cause, reason=reason) for id_, ledger, at, cause, reason in rows]

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
    ) -> list[Event]:
        """One assessment with all that follows from it, in one transaction.

        Returns the events with the sequence numbers that they were given.
        """
        with self._transaction() as db:
            changed = db.execute(
                "UPDATE ledger SET state = 'assessed', ended_at_unix_s = ? WHERE id = ? AND state = 'recorded'",
                (float(at_unix_s), ledger_id),
            ).rowcount
            if changed != 1:
                raise StoreError(f"replay {ledger_id}: not waiting for an assessment")
            db.execute("INSERT INTO assessment VALUES (?, ?, ?)", (ledger_id, float(recorded_at_unix_s), _text(assessment)))
            for joint, document in enumerate(friction, start=1):
                db.execute("INSERT INTO friction VALUES (?, ?, ?, ?)", (ledger_id, joint, float(recorded_at_unix_s), _text(document)))
            db.execute(
                "INSERT INTO state VALUES (1, 1, ?, ?, ?) ON CONFLICT (id) DO UPDATE "
                "SET revision = revision + 1, belief = excluded.belief, health = excluded.health, model = excluded.model",
                (_text(belief), _text(health), _text(model)),
            )
            return _numbered(db, ledger_id, at_unix_s, events)

    def state(self) -> State | None:
        """What is held true now; None before the first assessment."""
        rows = self._rows("SELECT revision, belief, health, model FROM state")
        if not rows:
            return None
        ((revision, belief, health, model),) = rows
        return State(revision=revision, belief=json.loads(belief), health=json.loads(health), model=json.loads(model))

    def friction(self, *, joint: int | None = None, limit: int | None = None) -> list[dict[str, Any]]:
        """Friction documents in the order of their replays, each with its `replay` (ledger id) and `joint`."""
        rows = self._rows(
            "SELECT ledger_id, joint, document FROM friction WHERE ?1 IS NULL OR joint = ?1 ORDER BY ledger_id DESC, joint DESC LIMIT ?2",
            (joint, -1 if limit is None else limit),
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
        rows = self._rows(
            "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id > ?1 AND (?2 IS NULL OR joint = ?2) "
            "AND (?3 IS NULL OR recorded_at_unix_s >= ?3) AND (?4 IS NULL OR recorded_at_unix_s < ?4) ORDER BY ledger_id, joint LIMIT ?5",
            (after, joint, from_unix_s, to_unix_s, limit + 1),
        )
        more = len(rows) > limit
        if more:
            cut = rows[-1][0]  # this replay may go on beyond the limit
            whole = [row for row in rows if row[0] != cut]
            rows = whole or self._rows(
                "SELECT ledger_id, joint, recorded_at_unix_s, document FROM friction WHERE ledger_id = ?1 ORDER BY joint", (cut,)
            )
        told = [{**json.loads(text), "replay": replay, "recorded_at_unix_s": at, "joint": number} for replay, number, at, text in rows]
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

    def revise(self, health: Mapping[str, Any], events: Sequence[Mapping[str, Any]], at_unix_s: float) -> list[Event]:
        """What a person did to alerts, in one transaction: the health that follows, and the transitions with their numbers."""
        with self._transaction() as db:
            if db.execute("UPDATE state SET health = ?", (_text(health),)).rowcount != 1:
                raise StoreError("no replay has been assessed yet")
            return _numbered(db, None, at_unix_s, events)

    def events(self, *, unpublished: bool = False, after: int = 0, limit: int | None = None) -> list[Event]:
        """The newest `limit` transitions after number `after`, in order; only those that were never published where asked."""
        rows = self._rows(
            "SELECT seq, at_unix_s, document FROM event WHERE published <= ? AND seq > ? ORDER BY seq DESC LIMIT ?",
            (0 if unpublished else 1, after, -1 if limit is None else limit),
        )
        return [Event(seq, at, json.loads(document)) for seq, at, document in reversed(rows)]

    def event_range(self) -> tuple[int, int] | None:
        """Numbers of the oldest and of the newest transition kept; None where there is none."""
        ((oldest, newest),) = self._rows("SELECT min(seq), max(seq) FROM event")
        return None if oldest is None else (int(oldest), int(newest))

    def published(self, seq: int) -> None:
        """The event is on the bus."""
        with self._transaction() as db:
            db.execute("UPDATE event SET published = 1 WHERE seq = ?", (seq,))


def _numbered(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, events: Sequence[Mapping[str, Any]]) -> list[Event]:
    numbered = []
    for document in events:
        cursor = db.execute(
            "INSERT INTO event (ledger_id, at_unix_s, document) VALUES (?, ?, ?)", (ledger_id, float(at_unix_s), _text(document))
        )
        numbered.append(Event(int(cursor.lastrowid or 0), float(at_unix_s), dict(document)))
    return numbered


def _note_stop(db: sqlite3.Connection, ledger_id: int | None, at_unix_s: float, cause: str, reason: str) -> None:
    values = (ledger_id, float(at_unix_s), cause, reason)
    db.execute("INSERT INTO stop (ledger_id, at_unix_s, cause, reason) VALUES (?, ?, ?, ?)", values)


def _text(document: Mapping[str, Any]) -> str:
    # NaN would be stored as a word that no other JSON reader knows: refuse it here, where the culprit is still on the stack
    return json.dumps(document, allow_nan=False, separators=(",", ":"))


def _check_version(connection: sqlite3.Connection, directory: Path) -> None:
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version < SCHEMA_VERSION:
        raise StoreError(f"{directory}: written by an older joint-monitor (schema {version}); start `joint-monitor run` once to renew it")


def _migrate(connection: sqlite3.Connection, directory: Path) -> None:
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > SCHEMA_VERSION:
        raise StoreError(f"{directory}: written by a newer joint-monitor (schema {version}; this one knows {SCHEMA_VERSION})")
    for step in range(version + 1, SCHEMA_VERSION + 1):
        # executescript commits what is open, so the transaction is part of the script
        connection.executescript(f"BEGIN;{_MIGRATIONS[step]};PRAGMA user_version = {step};COMMIT;")
