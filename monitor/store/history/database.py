"""The connection to one history, and its schema: tables, transactions, queries, notes. One connection serves several threads. I/O."""

import json
import sqlite3
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import OlderHistory, StoreError
from monitor.reason import Reason, reason_from, reason_of
from monitor.store.backup import HISTORY
from monitor.store.disk import refused_by

APPLICATION = 0x4A4D6F6E  # "JMon": marks the file as a history of joint-monitor 1.0 or later, whose versions count from 1
VERSION = 1
SCHEMA = """
CREATE TABLE ledger (                         -- one row a window
    id INTEGER PRIMARY KEY,
    window_unix_s REAL NOT NULL UNIQUE,       -- the window that the schedule named: never replayed twice
    kind TEXT NOT NULL CHECK (kind IN ('scheduled', 'requested', 'imported')),
    state TEXT NOT NULL CHECK (state IN ('started', 'recorded', 'assessed', 'rejected', 'aborted', 'skipped')),
    started_at_unix_s REAL NOT NULL,
    ended_at_unix_s REAL,
    reason TEXT,                              -- here and below: JSON of a Reason
    recording TEXT,                           -- file name below recordings/
    removed_at_unix_s REAL                    -- when retention removed the recording
) STRICT;
CREATE INDEX ledger_by_state ON ledger (state);
CREATE INDEX ledger_by_start ON ledger (started_at_unix_s);
CREATE TABLE try (                            -- a replay that ended early and was tried again in the same window
    ledger_id INTEGER NOT NULL REFERENCES ledger (id) ON DELETE CASCADE,
    number INTEGER NOT NULL CHECK (number >= 1),
    ended_at_unix_s REAL NOT NULL,
    cause TEXT NOT NULL,
    reason TEXT NOT NULL,
    PRIMARY KEY (ledger_id, number)
) STRICT;
CREATE TABLE borrow (                         -- a replay whose arm a running program lent
    ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id) ON DELETE CASCADE,
    due_since_unix_s REAL NOT NULL,
    taken_at_unix_s REAL NOT NULL,
    program TEXT,                             -- none: the controller reports no names
    waited_s REAL,                            -- from the taking until the program went on; none: it did not
    given_back INTEGER NOT NULL
) STRICT;
CREATE TABLE motion (                         -- one row a motion, written before the arm may move
    id INTEGER PRIMARY KEY,
    ledger_id INTEGER REFERENCES ledger (id) ON DELETE SET NULL,  -- none: `joint-monitor replay`, outside the schedule
    began_at_unix_s REAL NOT NULL,
    host TEXT NOT NULL,
    serial TEXT,                              -- as the controller reported it
    first_pass INTEGER NOT NULL DEFAULT 0,
    ended_at_unix_s REAL,                     -- none: it is under way, or its end is unknown
    ending TEXT,                              -- done, refused or a cause
    reason TEXT
) STRICT;
CREATE INDEX motion_unended ON motion (id) WHERE ended_at_unix_s IS NULL;
CREATE INDEX motion_of_window ON motion (ledger_id);
CREATE TABLE stop (                           -- a replay after which a person must check the arm
    id INTEGER PRIMARY KEY,
    ledger_id INTEGER REFERENCES ledger (id), -- none: `joint-monitor replay`, outside the schedule
    at_unix_s REAL NOT NULL,
    cause TEXT NOT NULL,
    reason TEXT NOT NULL,
    allowed_at_unix_s REAL,                   -- since when the arm may move again
    allowed_by TEXT,
    allowed_why TEXT,
    serial TEXT                               -- of another arm than expected: expected from the day on which a person allows it
) STRICT;
CREATE TABLE first_pass (                     -- a slow pass along the trajectory, with the setup in which it was made
    id INTEGER PRIMARY KEY,
    at_unix_s REAL NOT NULL,
    digest TEXT NOT NULL,
    document TEXT NOT NULL
) STRICT;
CREATE TABLE provenance (                     -- programs, processor and settings that verdicts were made with, each once
    digest TEXT PRIMARY KEY,
    document TEXT NOT NULL
) STRICT;
CREATE TABLE assessment (
    ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id),
    recorded_at_unix_s REAL NOT NULL,
    document TEXT NOT NULL,
    made_with TEXT REFERENCES provenance (digest)
) STRICT;
CREATE TABLE friction (
    ledger_id INTEGER NOT NULL REFERENCES ledger (id),
    joint INTEGER NOT NULL CHECK (joint >= 1),
    recorded_at_unix_s REAL NOT NULL,
    document TEXT NOT NULL,
    PRIMARY KEY (ledger_id, joint)
) STRICT;
CREATE INDEX friction_by_joint ON friction (joint, recorded_at_unix_s);
CREATE INDEX friction_of_joint ON friction (joint, ledger_id);
CREATE TABLE state (                          -- the estimator's present state
    id INTEGER PRIMARY KEY CHECK (id = 1),
    revision INTEGER NOT NULL,
    belief TEXT NOT NULL,
    health TEXT NOT NULL,
    model TEXT NOT NULL
) STRICT;
CREATE TABLE checkpoint (                     -- belief and health after this assessment: where a recomputation may begin
    ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id),
    belief BLOB NOT NULL,
    health BLOB NOT NULL
) STRICT;
CREATE TABLE event (                          -- transitions of alerts
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    ledger_id INTEGER REFERENCES ledger (id),
    at_unix_s REAL NOT NULL,
    document TEXT NOT NULL,
    published INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE change (                         -- which replay's rows were written or taken back, in the order in which that was done
    seq INTEGER PRIMARY KEY AUTOINCREMENT,    -- no number is given out twice
    ledger_id INTEGER NOT NULL,
    at_unix_s REAL NOT NULL
) STRICT;
CREATE INDEX change_of_replay ON change (ledger_id);
CREATE TRIGGER assessment_written AFTER INSERT ON assessment
    BEGIN INSERT INTO change (ledger_id, at_unix_s) VALUES (new.ledger_id, (julianday('now') - 2440587.5) * 86400.0); END;
CREATE TRIGGER assessment_taken_back AFTER DELETE ON assessment
    BEGIN INSERT INTO change (ledger_id, at_unix_s) VALUES (old.ledger_id, (julianday('now') - 2440587.5) * 86400.0); END;
CREATE TABLE maintenance (                    -- maintenance of a joint as it was declared, and its outcome
    id INTEGER PRIMARY KEY,
    ledger_id INTEGER REFERENCES ledger (id) ON DELETE SET NULL,  -- the replay whose context declared it; none: a person did
    joint INTEGER NOT NULL CHECK (joint >= 1),
    declared_at_unix_s REAL NOT NULL,
    document TEXT NOT NULL,
    undone_at_unix_s REAL,
    undone_by TEXT,
    undone_why TEXT,
    belief_before BLOB,                       -- the state to which taking it back returns
    health_before BLOB
) STRICT;
CREATE INDEX maintenance_of_joint ON maintenance (joint, id);
CREATE TABLE amendment (                      -- belief and health as a person changed them between two replays
    id INTEGER PRIMARY KEY,
    at_unix_s REAL NOT NULL,
    belief BLOB NOT NULL,
    health BLOB NOT NULL
) STRICT;
CREATE TABLE production_sums (                -- sums over the arm's production that are being gathered
    id INTEGER PRIMARY KEY CHECK (id = 1),
    at_unix_s REAL NOT NULL,
    document BLOB NOT NULL
) STRICT;
CREATE TABLE production_observation (         -- friction from production until the end of a day, as it was judged
    day INTEGER PRIMARY KEY,                  -- UTC, counted from 1970-01-01
    at_unix_s REAL NOT NULL,                  -- when it was judged
    document TEXT NOT NULL,
    context TEXT NOT NULL,                    -- as it was declared
    learnt TEXT NOT NULL,                     -- joints that were learned from
    made_with TEXT NOT NULL REFERENCES provenance (digest)
) STRICT;
CREATE TABLE archived (                       -- recordings whose copy in the archive was read back and compared
    ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id) ON DELETE CASCADE,
    address TEXT NOT NULL,                    -- the whole one: s3://BUCKET/PREFIX/site=…, or a path
    sha256 TEXT NOT NULL,
    bytes INTEGER NOT NULL,
    verified_at_unix_s REAL NOT NULL
) STRICT;
CREATE TABLE duty (                           -- operating hours of one day, as far as the arm was heard
    day INTEGER PRIMARY KEY,                  -- UTC, counted from 1970-01-01
    heard_s REAL NOT NULL,
    on_s REAL NOT NULL,
    moving_s REAL NOT NULL,
    stops INTEGER NOT NULL                    -- by the arm's safety system
) STRICT;
CREATE TABLE safety_stop (                    -- a stop that the arm's safety system made by itself
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at_unix_s REAL NOT NULL,
    kind TEXT NOT NULL,                       -- protective_stop, violation or fault
    ended_at_unix_s REAL,
    joint INTEGER,                            -- where the controller reported it
    code TEXT,
    during_replay INTEGER NOT NULL
) STRICT;
CREATE INDEX safety_stop_by_time ON safety_stop (at_unix_s);
CREATE TABLE inspection (                     -- a check that a person declared to have made
    id INTEGER PRIMARY KEY,
    item TEXT NOT NULL,
    done_at_unix_s REAL NOT NULL,
    declared_at_unix_s REAL NOT NULL,
    hours REAL,                               -- operating hours of then
    done_by TEXT NOT NULL,
    why TEXT NOT NULL,
    undone_at_unix_s REAL,
    undone_by TEXT,
    undone_why TEXT
) STRICT;
CREATE TABLE note (                           -- small facts that must survive a restart
    key TEXT PRIMARY KEY,
    value TEXT NOT NULL
) STRICT;
-- tells this history from every other one; a restored one gets another
INSERT INTO note (key, value) VALUES ('history_id', lower(hex(randomblob(8))));
"""

Document = dict[str, Any]  # JSON of another room, which reads and writes it; the store keeps it as it is


class State(NamedTuple):
    """The estimator's state at one moment, as the documents that `judge` made of it."""

    belief: Mapping[str, Any]
    health: Mapping[str, Any]

    @classmethod
    def unpacked(cls, belief: bytes, health: bytes) -> "State":
        """From its two columns."""
        return cls(unpacked(belief), unpacked(health))


def begin_history(connection: sqlite3.Connection, directory: Path) -> None:
    """Make the tables where the file is empty. Raises as `version_of`."""
    if version_of(connection, directory) == 0:
        # executescript commits what is open, so the transaction is part of the script
        connection.executescript(f"BEGIN;{SCHEMA};PRAGMA application_id = {APPLICATION};PRAGMA user_version = {VERSION};COMMIT;")


def version_of(connection: sqlite3.Connection, directory: Path) -> int:
    """The version of the file's schema; 0 of an empty file.

    Raises OlderHistory where a joint-monitor before 1.0 wrote it, StoreError where a newer one or another program did.
    """
    ((version,),) = connection.execute("PRAGMA user_version").fetchall()
    ((application,),) = connection.execute("PRAGMA application_id").fetchall()
    tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    if application == APPLICATION:
        if version > VERSION:
            raise StoreError(f"{directory}: written by a newer joint-monitor (schema {version}; this one knows {VERSION})")
        return int(version)
    if "ledger" in tables and version:
        raise OlderHistory(
            f"{directory}: its history was written by a joint-monitor before 1.0 (schema {version}), which this one does not read; keep "
            "the folder, name another one in [store] directory, and take its recordings over with "
            f"`joint-monitor import {directory}/recordings/*.parquet`"
        )
    if tables or version or application:
        raise StoreError(f"{directory}: its history.sqlite is another program's; expected one of joint-monitor's, or none")
    return 0


class Database:
    """One SQLite connection to the history in `directory`. A thread waits where another one has a transaction or a query open."""

    def __init__(self, directory: Path, connection: sqlite3.Connection) -> None:
        self.directory = directory
        self.connection = connection
        self._turn = threading.RLock()  # one connection, several threads: a transaction must not open inside another's

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """All statements inside are committed together, or none of them. Raises StoreError where the disk or the file refuses."""
        with self._turn:
            try:
                self.connection.execute("BEGIN IMMEDIATE")
                try:
                    yield self.connection
                except BaseException:
                    if self.connection.in_transaction:  # a full disk has rolled back already
                        self.connection.execute("ROLLBACK")
                    raise
                self.connection.execute("COMMIT")
            except sqlite3.Error as error:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                raise refused_by(error, self.directory / HISTORY) from error

    def rows(self, query: str, values: Sequence[Any] = ()) -> list[Any]:
        """All rows of a query. Raises StoreError where the file cannot be read."""
        with self._turn:
            try:
                return self.connection.execute(query, values).fetchall()
            except sqlite3.Error as error:
                raise refused_by(error, self.directory / HISTORY) from error


class Notes:
    """Small facts that must survive a restart, by name."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def get(self, key: str) -> str | None:
        """The value of a note; None where there is none."""
        rows = self._db.rows("SELECT value FROM note WHERE key = ?", (key,))
        return str(rows[0][0]) if rows else None

    def set(self, key: str, value: str) -> None:
        """Write a note; it replaces an earlier one of this name."""
        with self._db.transaction() as db:
            set_note(db, key, value)


def set_note(db: sqlite3.Connection, key: str, value: str) -> None:
    """Inside a transaction: write a note; it replaces an earlier one of this name."""
    db.execute("INSERT INTO note VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = excluded.value", (key, value))


def json_text(document: Mapping[str, Any]) -> str:
    """A document as it is stored: JSON without white space. Raises ValueError where a figure is not finite."""
    # NaN would be stored as a word that other JSON readers refuse: raise here, where the stack still shows who passed it
    return json.dumps(document, allow_nan=False, separators=(",", ":"))


def packed(document: Mapping[str, Any]) -> bytes:
    """A document as it is stored where it is large and seldom read."""
    return zlib.compress(json_text(document).encode())


def unpacked(blob: bytes) -> Document:
    """The document that was `packed`."""
    document: Document = json.loads(zlib.decompress(blob))
    return document


def reason_column(reason: str | Reason | None) -> str | None:
    """A reason as it is stored. A stop must be stored in any case: of one with a figure that is not finite, the text is kept."""
    if reason is None:
        return None
    try:
        return json_text(reason_of(reason).document())
    except ValueError:
        return json_text(reason_of(str(reason)).document())


def stored_reason(text: str | None) -> Reason | None:
    """The reason of a column; None where it holds none."""
    return None if text is None else reason_from(json.loads(text))
