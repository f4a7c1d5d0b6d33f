"""The rows of a history for whoever copies it: a third numbered log, and a history made of such rows. I/O.

Triggers of the database write the log, so no writer can forget it. It names each row once, under the number of its last change: who asks
for what follows a number gets every row as it is now, or learns that it is gone.
"""

import base64
import sqlite3
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import orjson

from monitor.errors import StoreError
from monitor.store.archive.archived import PLACE
from monitor.store.backup import HISTORY
from monitor.store.history.database import Database, begin_history

COPIED = {  # tables that a copy holds, and by which column their rows are known; friction stands in the assessment
    "ledger": "id",
    "provenance": "digest",
    "assessment": "ledger_id",
    "identified": "ledger_id",
    "state": "id",
    "checkpoint": "ledger_id",
    "event": "seq",
    "maintenance": "id",
    "amendment": "id",
    "production_observation": "day",
    "archived": "ledger_id",
    "note": "key",
}
WHERE = {"note": f"key = '{PLACE}'"}  # of the notes: the place of the archive
NO_UPDATE = ("event",)  # whether it was published is nobody else's
PAGE_BYTES = 1_000_000  # of a page, about: a row has some ten thousand
TABLES = """
CREATE TABLE IF NOT EXISTS identified (       -- what an assessment was made of: enough for another one where the recording is gone
    ledger_id INTEGER PRIMARY KEY REFERENCES ledger (id),
    document BLOB NOT NULL
) STRICT;
CREATE TABLE stored (                         -- which row was written or taken away last
    seq INTEGER PRIMARY KEY AUTOINCREMENT,    -- no number is given out twice
    of_table TEXT NOT NULL,
    row TEXT NOT NULL,
    UNIQUE (of_table, row)
) STRICT;
"""


def keep_log(connection: sqlite3.Connection) -> None:
    """Give a history the tables that came later, where it lacks them; an older program goes on with it, and the log with that one."""
    if connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'stored'").fetchone() is not None:
        return
    script = TABLES
    for table, key in COPIED.items():
        for act, row in (("INSERT", "new"), ("UPDATE", "new"), ("DELETE", "old")):
            if act == "UPDATE" and table in NO_UPDATE:
                continue
            only = f" WHEN {row}.{WHERE[table]}" if table in WHERE else ""
            name, value = f"{table}_stored_{act.lower()}", f"CAST({row}.{key} AS TEXT)"
            # taken away and inserted: inside a trigger, the conflict clause of the statement outside would hold
            forget = f"DELETE FROM stored WHERE of_table = '{table}' AND row = {value};"  # noqa: S608 - fixed names, here and below
            note = f"INSERT INTO stored (of_table, row) VALUES ('{table}', {value});"  # noqa: S608
            script += f"CREATE TRIGGER {name} AFTER {act} ON {table}{only} BEGIN {forget} {note} END;\n"
        only = f" WHERE {WHERE[table]}" if table in WHERE else ""
        script += f"INSERT INTO stored (of_table, row) SELECT '{table}', CAST({key} AS TEXT) FROM {table}{only};\n"  # noqa: S608
    connection.executescript(f"BEGIN IMMEDIATE;{script}COMMIT;")


class StoredRow(NamedTuple):
    """One row of a history, or that it is gone."""

    seq: int
    table: str
    row: str
    content: bytes | None  # None: it is gone


class StoredLog:
    """The log of rows."""

    def __init__(self, database: Database) -> None:
        self._db = database

    def after(self, seq: int, limit: int) -> tuple[list[StoredRow], int | None]:
        """Rows with numbers above `seq`, oldest first: `limit` at most, and about `PAGE_BYTES`.

        The second value is the number that the next page follows; None at the end.
        """
        page: list[StoredRow] = []
        size, columns = 0, dict[str, list[str]]()
        found = self._db.rows("SELECT seq, of_table, row FROM stored WHERE seq > ? ORDER BY seq LIMIT ?", (seq, limit + 1))
        for number, table, row in found[:limit]:
            if size > PAGE_BYTES:
                break
            if table not in columns:
                columns[table] = [name for _, name, *_ in self._db.rows(f"PRAGMA table_info({table})")]
            page.append(StoredRow(int(number), table, row, self._content(table, row, columns[table])))
            size += len(page[-1].content or b"")
        return page, page[-1].seq if len(page) < len(found) else None

    def _content(self, table: str, row: str, columns: list[str]) -> bytes | None:
        found = self._db.rows(f"SELECT * FROM {table} WHERE {COPIED[table]} = ?", (row,))  # noqa: S608 - fixed names; the column's type converts
        return packed_row(dict(zip(columns, found[0], strict=True))) if found else None


def packed_row(values: Mapping[str, Any]) -> bytes:
    """A row by its columns, as it travels and as a plant keeps it: JSON, bytes in base64, compressed."""
    plain = {name: {"base64": base64.b64encode(value).decode()} if isinstance(value, bytes) else value for name, value in values.items()}
    return zlib.compress(orjson.dumps(plain))


def unpacked_row(content: bytes) -> dict[str, Any]:
    """The row that was packed. Raises StoreError where it is none."""
    try:
        plain = orjson.loads(zlib.decompress(content))
        return {name: base64.b64decode(value["base64"]) if isinstance(value, dict) else value for name, value in plain.items()}
    except (zlib.error, ValueError, KeyError, AttributeError) as wrong:
        raise StoreError(f"a copied row of a history cannot be read: {wrong}") from None


def write_history(directory: Path, rows: Iterable[tuple[str, bytes]]) -> None:
    """Make a history of copied rows, (table, content) each, in an empty folder: what was judged, with what, and what people did since.

    Motions, stops and operating hours are not copied. Raises StoreError where a row is of another version's table.
    """
    connection = sqlite3.connect(directory / HISTORY, isolation_level=None)
    try:
        connection.execute("PRAGMA synchronous = OFF")
        begin_history(connection, directory)
        connection.executescript(f"BEGIN;{TABLES}COMMIT;")
        connection.execute("BEGIN")
        for table, content in rows:
            _insert(connection, table, unpacked_row(content))
        connection.execute("COMMIT")
    except sqlite3.Error as wrong:
        raise StoreError(f"a copied history does not fit this version's tables: {wrong}") from None
    finally:
        connection.close()


def _insert(connection: sqlite3.Connection, table: str, row: Mapping[str, Any]) -> None:
    if table not in COPIED:  # of a later version
        return
    columns, marks = ", ".join(row), ", ".join("?" * len(row))
    connection.execute(f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", tuple(row.values()))  # noqa: S608
    if table == "assessment":
        for joint, document in enumerate(orjson.loads(row["document"]).get("friction", ()), start=1):
            values = (row["ledger_id"], joint, row["recorded_at_unix_s"], orjson.dumps(document).decode())
            connection.execute("INSERT INTO friction VALUES (?, ?, ?, ?)", values)
