"""The connection to one history: transactions, queries, notes. One connection serves several threads."""

import json
import sqlite3
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from monitor.store.backup import HISTORY, refused_by


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


def unpacked(blob: bytes) -> dict[str, Any]:
    """The document that was `packed`."""
    document: dict[str, Any] = json.loads(zlib.decompress(blob))
    return document
