"""The history's schema: one step a version, each applied once, in one transaction."""

import sqlite3
from pathlib import Path

from monitor.errors import StoreError

HISTORY_SCHEMA = 10
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
    7: """
    CREATE TABLE change (                         -- which replay's rows were written or taken back, in the order in which that was done
        seq INTEGER PRIMARY KEY AUTOINCREMENT,    -- no number is given out twice
        ledger_id INTEGER NOT NULL,
        at_unix_s REAL NOT NULL
    ) STRICT;
    CREATE INDEX change_of_replay ON change (ledger_id);
    INSERT INTO change (ledger_id, at_unix_s)
        SELECT ledger_id, coalesce(ended_at_unix_s, recorded_at_unix_s) FROM assessment JOIN ledger ON id = ledger_id ORDER BY ledger_id;
    CREATE TRIGGER assessment_written AFTER INSERT ON assessment
        BEGIN INSERT INTO change (ledger_id, at_unix_s) VALUES (new.ledger_id, (julianday('now') - 2440587.5) * 86400.0); END;
    CREATE TRIGGER assessment_taken_back AFTER DELETE ON assessment
        BEGIN INSERT INTO change (ledger_id, at_unix_s) VALUES (old.ledger_id, (julianday('now') - 2440587.5) * 86400.0); END;
    -- tells this history from every other one; a restored one gets another
    INSERT OR IGNORE INTO note (key, value) VALUES ('history_id', lower(hex(randomblob(8))));
    """,
    8: """
    CREATE TABLE work_information (               -- sums over the arm's ordinary work that are being gathered
        id INTEGER PRIMARY KEY CHECK (id = 1),
        at_unix_s REAL NOT NULL,
        document BLOB NOT NULL
    ) STRICT;
    CREATE TABLE work_observation (               -- what the work until the end of a day told, as it was judged
        day INTEGER PRIMARY KEY,                  -- UTC, counted from 1970-01-01
        at_unix_s REAL NOT NULL,                  -- when it was judged
        document TEXT NOT NULL,
        context TEXT NOT NULL,                    -- as it was declared
        learnt TEXT NOT NULL,                     -- joints that were learned from
        made_with TEXT NOT NULL REFERENCES circumstance (digest)
    ) STRICT;
    """,
    9: """
    CREATE TABLE archived (                       -- recordings whose copy in the archive was read back and compared
        ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id) ON DELETE CASCADE,
        address TEXT NOT NULL,                    -- the whole one: s3://BUCKET/PREFIX/site=…, or a path
        sha256 TEXT NOT NULL,
        bytes INTEGER NOT NULL,
        verified_at_unix_s REAL NOT NULL
    ) STRICT;
    """,
    10: """
    CREATE TABLE duty (                           -- what the arm did on one day, as far as it was heard
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
        joint INTEGER,                            -- where the controller told it
        code TEXT,
        during_replay INTEGER NOT NULL
    ) STRICT;
    CREATE INDEX safety_stop_by_time ON safety_stop (at_unix_s);
    CREATE TABLE inspection (                     -- a check that somebody says was made
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
