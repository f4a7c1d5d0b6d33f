"""Backups of the plant's database, their restoration, and its rebuilding from the arms. I/O.

A backup is one SQLite file with the same tables, whichever database it is made of: so it moves a plant from one to the other as well.
"""

import os
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from monitor.errors import BadInput, StoreError
from monitor.plant.database import Database
from monitor.plant.ingest import add_audit
from monitor.plant.tables import EVERY_TABLE, FROM_ARMS, NUMBERED, PARTITIONED, arm, audit, delivery
from monitor.store.disk import DAMAGE, refused_by

ROWS = 5000  # copied at once
SQLITE = b"SQLite format 3\0"
_LINE = (audit.c.at, audit.c.who, audit.c.act, audit.c.robot, audit.c.text)  # of the audit, without its number


def back_up(database: Database, target: Path) -> int:
    """Write everything into a new file, as it is at one moment; the plant may go on. Returns the number of rows.

    Raises BadInput where the file cannot be written, StoreError.
    """
    target = target.absolute()
    if not target.parent.is_dir():
        raise BadInput(f"{target.parent}: is no folder; nothing was done")
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    os.close(handle)
    try:
        with _embedded(Path(name), target.name) as copy:
            rows = _copy(database, copy)
        with closing(sqlite3.connect(name)) as connection:
            connection.execute("PRAGMA journal_mode = DELETE")  # one file
            if (wrong := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise StoreError(f"{target}: the backup is damaged: {wrong}")
        _sync(Path(name))
        os.replace(name, target)
        _sync(target.parent)
    finally:
        for suffix in ("", "-wal", "-shm"):
            with suppress(FileNotFoundError):
                os.unlink(f"{name}{suffix}")
    return rows


def restore(database: Database, source: Path, *, force: bool, who: str) -> int:
    """Put a backup into the database, in one transaction; what the arms have said since then is copied from them. Returns its rows.

    Raises BadInput where the file is no backup, or the database is not empty and nobody asked for it to be replaced; StoreError.
    """
    with tempfile.TemporaryDirectory(prefix="joint-monitor-plant-") as scratch:
        copied = Path(scratch) / "backup.sqlite"
        _copy_checked(source, copied)
        with _embedded(copied, source.name) as backup:  # an older one is brought up to date here
            for table, column in PARTITIONED.items():
                with backup.read() as connection:
                    of_table = next(each for each in EVERY_TABLE if each.name == table)
                    times = connection.execute(sa.select(of_table.c[column]).distinct()).scalars()
                    database.make_partitions(table, (float(at) for at in times), patience_s=0)
            return _copy(backup, database, replace=True, force=force, who=who, name=source.name)


def rebuild(database: Database, *, who: str) -> int:
    """Forget everything that the arms know, and keep the audit; a plant that runs copies it anew. Returns the number of arms forgotten."""
    with database.write() as connection:
        arms = int(connection.execute(sa.select(sa.func.count()).select_from(arm)).scalar_one())
        for table in FROM_ARMS:
            connection.execute(sa.delete(table))
        add_audit(connection, time.time(), who, "rebuild", None, f"{arms} arms are copied anew from their own histories")
    database.drop_empty_partitions()
    return arms


def forget(database: Database, name: str, *, who: str) -> None:
    """Take everything of an arm away, for one that is no more; the audit stays. One that is there comes back.

    name : SITE/ROBOT. Raises BadInput where there is no such arm.
    """
    site, _, robot = name.partition("/")
    with database.write() as connection:
        number = connection.execute(sa.select(arm.c.id).where(arm.c.site == site, arm.c.robot == robot)).scalar_one_or_none()
        if number is None:
            raise BadInput(f"{name}: is no arm of this plant; expected SITE/ROBOT as `joint-monitor plant status --all` shows it")
        for table in FROM_ARMS:
            connection.execute(sa.delete(table).where((table.c.id if table is arm else table.c.arm) == number))
        add_audit(connection, time.time(), who, "forget", name, "its copied history is taken away")
    database.drop_empty_partitions()


def _copy_checked(source: Path, copied: Path) -> None:
    """Copy a backup, as it is. Raises BadInput where it is none, or is damaged: half of one would take away more than it brings."""
    nothing = "nothing was done"
    try:
        with source.open("rb") as file:
            if file.read(len(SQLITE)) != SQLITE:
                raise BadInput(f"{source}: is no backup of a plant; expected a file that `joint-monitor plant backup` wrote")
    except OSError as error:
        raise BadInput(f"{source}: cannot be read: {error.strerror}") from None
    here = f"{source.absolute().as_uri()}?mode=ro"
    try:
        with closing(sqlite3.connect(here, uri=True)) as original, closing(sqlite3.connect(copied)) as copy:
            original.backup(copy)
            wrong = copy.execute("PRAGMA quick_check(1)").fetchone()[0]
            tables = {name for (name,) in copy.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF not in DAMAGE:
            raise BadInput(f"{refused_by(error, source)}; {nothing}") from None
        raise BadInput(f"{source}: is damaged: {error}; {nothing}. Expected a whole copy of the backup") from None
    if wrong != "ok":
        raise BadInput(f"{source}: is damaged: {' '.join(str(wrong).split())}; {nothing}. Expected a whole copy of the backup")
    if not {arm.name, audit.name, "alembic_version"} <= tables:
        raise BadInput(f"{source}: is the database of another program; expected a file that `joint-monitor plant backup` wrote; {nothing}")


@contextmanager
def _embedded(path: Path, shown: str | None = None) -> Iterator[Database]:
    """A file as a plant's database. shown : its name in messages."""
    database = Database(path)
    database.name = shown or database.name
    try:
        database.migrate()
        yield database
    finally:
        database.close()


def _copy(source: Database, target: Database, *, replace: bool = False, force: bool = False, who: str = "", name: str = "") -> int:
    """Copy every row of every table, in one transaction of each database.

    Audit and deliveries are never taken away: what they lack is added. So nothing is delivered twice because of a restoration.
    """
    count = 0
    with source.read() as read, target.write() as write:
        before: list[dict[str, Any]] = []  # the audit of what is replaced
        owed: set[str] = set()
        if replace:
            if not force and write.execute(sa.select(arm.c.id).limit(1)).first() is not None:
                raise BadInput(f"{target.name}: is not empty; nothing was done. --force puts the backup in its place, and keeps the audit")
            before = [dict(row._mapping) for row in write.execute(sa.select(*_LINE).order_by(audit.c.id))]
            owed = set(write.execute(sa.select(delivery.c.key)).scalars())
            for table in (*FROM_ARMS, EVERY_TABLE[-1]):
                write.execute(sa.delete(table))
        for table in EVERY_TABLE:
            if replace and table is audit:
                count += _merge_audit(before, [dict(row._mapping) for row in read.execute(sa.select(*_LINE).order_by(audit.c.id))], write)
                continue
            columns = [column for column in table.c if not (replace and table is delivery and column is table.c.id)]
            found = read.execute(sa.select(*columns).execution_options(yield_per=ROWS))
            for part in found.partitions(ROWS):
                rows = [row for row in (dict(each._mapping) for each in part) if not (table is delivery and row["key"] in owed)]
                if rows:
                    write.execute(sa.insert(table), rows)
                count += len(rows)
        if target.postgresql:  # numbers were given, and the sequence has not seen them
            for table in NUMBERED:
                newest = sa.select(sa.func.coalesce(sa.func.max(table.c.id), 0) + 1).scalar_subquery()
                write.execute(sa.select(sa.func.setval(sa.func.pg_get_serial_sequence(table.name, "id"), newest, sa.false())))
        if replace:
            add_audit(write, time.time(), who, "restore", None, f"{count} rows of the backup {name}")
    return count


def _merge_audit(before: list[dict[str, Any]], of_backup: list[dict[str, Any]], write: sa.Connection) -> int:
    """Add the lines that only the backup has, each at its time: their numbers are their order. Returns how many they are."""
    there = {tuple(line.values()) for line in before}
    lacking = [line for line in of_backup if tuple(line.values()) not in there]
    if lacking:
        write.execute(sa.delete(audit))
        lines = sorted([*lacking, *before], key=lambda line: float(line["at"]))
        for first in range(0, len(lines), ROWS):
            write.execute(sa.insert(audit), lines[first : first + ROWS])
    return len(lacking)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
