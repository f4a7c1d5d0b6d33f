"""The history's schema: one step a version, each applied once, in one transaction."""

import sqlite3
from pathlib import Path

from monitor.errors import StoreError

HISTORY_SCHEMA = 6
MIGRATIONS: dict[int, str] = {
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
    3: """
    ALTER TABLE ledger ADD COLUMN removed_at_unix_s REAL;      -- when retention let go of the recording
    CREATE TABLE circumstance (                   -- programs, processor and settings that verdicts were made with, each once
        digest TEXT PRIMARY KEY,
        document TEXT NOT NULL
    ) STRICT;
    ALTER TABLE assessment ADD COLUMN made_with TEXT REFERENCES circumstance (digest);
    CREATE TABLE checkpoint (                     -- belief and health after this assessment: where a recomputation may begin
        ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id),
        belief BLOB NOT NULL,
        health BLOB NOT NULL
    ) STRICT;
    CREATE TABLE note (                           -- small facts that must survive a restart
        key TEXT PRIMARY KEY,
        value TEXT NOT NULL
    ) STRICT;
    CREATE INDEX friction_of_joint ON friction (joint, ledger_id);
    CREATE INDEX ledger_by_state ON ledger (state);
    CREATE INDEX ledger_by_start ON ledger (started_at_unix_s);
    """,
    4: """
    CREATE TABLE motion (                         -- one row a motion, written before the arm may move
        id INTEGER PRIMARY KEY,
        ledger_id INTEGER REFERENCES ledger (id) ON DELETE SET NULL,  -- none: `joint-monitor replay`, beside the schedule
        began_at_unix_s REAL NOT NULL,
        host TEXT NOT NULL,
        serial TEXT,                              -- as the controller said; none: it said none
        first_pass INTEGER NOT NULL DEFAULT 0,
        ended_at_unix_s REAL,                     -- none: it is under way, or nobody knows how it ended
        ending TEXT,                              -- done, refused, a cause, or `stop`: a person must look
        reason TEXT
    ) STRICT;
    CREATE INDEX motion_unended ON motion (id) WHERE ended_at_unix_s IS NULL;
    CREATE INDEX motion_of_window ON motion (ledger_id);
    CREATE TABLE try (                            -- a replay that ended early and was tried again in the same window
        ledger_id INTEGER NOT NULL REFERENCES ledger (id) ON DELETE CASCADE,
        number INTEGER NOT NULL CHECK (number >= 1),
        ended_at_unix_s REAL NOT NULL,
        cause TEXT NOT NULL,
        reason TEXT NOT NULL,
        PRIMARY KEY (ledger_id, number)
    ) STRICT;
    ALTER TABLE stop ADD COLUMN serial TEXT;      -- of another arm than expected: expected from the day on which a person allows it
    -- an older program left this window half-way: whether the arm moved, and how that ended, is not known
    INSERT INTO motion (ledger_id, began_at_unix_s, host)
        SELECT id, started_at_unix_s, '' FROM ledger WHERE state = 'started' AND kind <> 'imported';
    -- the arm that an older program learnt from is the one that is expected
    INSERT OR IGNORE INTO note (key, value)
        SELECT 'arm_serial', json_extract(belief, '$.context.serial') FROM state WHERE json_extract(belief, '$.context.serial') IS NOT NULL;
    """,
    5: """
    CREATE TABLE work (                           -- what was done to a joint, as somebody declared it, and its outcome
        id INTEGER PRIMARY KEY,
        ledger_id INTEGER REFERENCES ledger (id) ON DELETE SET NULL,  -- the replay whose context declared it; none: a person did
        joint INTEGER NOT NULL CHECK (joint >= 1),
        declared_at_unix_s REAL NOT NULL,
        document TEXT NOT NULL,
        undone_at_unix_s REAL,
        undone_by TEXT,
        undone_why TEXT,
        belief_before BLOB,                       -- what taking it back returns to
        health_before BLOB
    ) STRICT;
    CREATE INDEX work_of_joint ON work (joint, id);
    CREATE TABLE amendment (                      -- belief and health as a person changed them between two replays
        id INTEGER PRIMARY KEY,
        at_unix_s REAL NOT NULL,
        belief BLOB NOT NULL,
        health BLOB NOT NULL
    ) STRICT;
    """,
    6: """
    CREATE TABLE borrow (                         -- a replay whose arm a running program lent
        ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id) ON DELETE CASCADE,
        due_since_unix_s REAL NOT NULL,
        taken_at_unix_s REAL NOT NULL,
        program TEXT,                             -- none: the controller tells no names
        waited_s REAL,                            -- from the taking until the program went on; none: it did not
        given_back INTEGER NOT NULL
    ) STRICT;
    """,
}


def renewed_copy(connection: sqlite3.Connection, directory: Path) -> sqlite3.Connection:
    """A copy in memory of an older file's tables, migrated: a reader must not change the file, and reads it all the same."""
    copy = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    connection.backup(copy)
    migrate(copy, directory)
    return copy


def migrate(connection: sqlite3.Connection, directory: Path) -> None:
    """Migrate a file of any earlier version to this one. Raises StoreError where it is newer or another program's."""
    version = schema_of(connection, directory)
    for step in range(version + 1, HISTORY_SCHEMA + 1):
        # executescript commits what is open, so the transaction is part of the script
        connection.executescript(f"BEGIN;{MIGRATIONS[step]};PRAGMA user_version = {step};COMMIT;")


def schema_of(connection: sqlite3.Connection, directory: Path) -> int:
    """The version of the file's schema; 0 of an empty file. Raises StoreError where it is newer or another program's."""
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version > HISTORY_SCHEMA:
        raise StoreError(f"{directory}: written by a newer joint-monitor (schema {version}; this one knows {HISTORY_SCHEMA})")
    tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table'")}
    if (tables and (version == 0 or "ledger" not in tables)) or (version and not tables):
        raise StoreError(f"{directory}: its history.sqlite is another program's; expected one of joint-monitor's, or none")
    return version
