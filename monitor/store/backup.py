"""Backups of the history, and its restoration: a damaged file is set aside, never deleted, and the newest good backup replaces it. I/O."""

import os
import re
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from monitor.errors import StoreError
from monitor.reason import Reason, Sentence
from monitor.store.disk import DAMAGE, damaged, owner_of, refused_by

HISTORY = "history.sqlite"
_NAME = re.compile(r"history-(\d{8}T\d{6}Z)\.sqlite\Z")
_STAMP = "%Y%m%dT%H%M%SZ"

NEWEST_LOST = Sentence("history_newest_lost", "the history has lost its newest entries ({why}); those recordings are judged anew")
REPLACED = Sentence("history_replaced", "the history was damaged ({why}) and was replaced by the backup {backup}")
BEGUN_ANEW = Sentence(
    "history_begun_anew",
    "the history was damaged ({why}) and was replaced by nothing: there was no good backup; recordings on disk are judged anew",
)
SET_ASIDE = Sentence("history_set_aside", "{outcome}; it was kept as {file}")
NO_BACKUP = Sentence("backup_not_written", "the backup cannot be written: {why}")


class Restored(NamedTuple):
    """The outcome of restoring a damaged history."""

    why: str  # what was wrong with it
    set_aside: Path | None  # the damaged file; None: it was missing
    backup: Path | None  # what replaced it; None: there was no good backup, and a new history begins
    at_unix_s: float
    replaced: bool = True  # False: the file is sound and has lost its newest entries

    @property
    def reason(self) -> Reason:
        """The outcome as a sentence."""
        if not self.replaced:
            return NEWEST_LOST(why=self.why)
        outcome = BEGUN_ANEW(why=self.why) if self.backup is None else REPLACED(why=self.why, backup=self.backup.name)
        return outcome if self.set_aside is None else SET_ASIDE(outcome=outcome, file=self.set_aside.name)


def connected(path: Path, mode: str, **options: Any) -> sqlite3.Connection:
    """A connection to an existing database file. mode : ro or rw. The name may hold `#`, `?` and `%`, which a URI treats specially."""
    connection: sqlite3.Connection = sqlite3.connect(f"file:{quote(os.fsencode(path))}?mode={mode}", uri=True, **options)
    return connection


def present(directory: Path) -> bool:
    """Whether a directory holds a history. Raises StoreError where this user may not read it."""
    try:
        (directory / HISTORY).stat()
        os.listdir(directory)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except PermissionError:
        owner = owner_of(directory)
        raise StoreError(
            f"{directory}: may not be read by this user (uid {os.geteuid()}); "
            + (f"as the one whose it is: sudo -u {owner} joint-monitor …" if owner else "as root: sudo joint-monitor …")
        ) from None
    return (directory / HISTORY).is_file()


def hand_over(directory: Path) -> None:
    """Give files that root has made in the service's directory to the service's user, which could not write to them otherwise."""
    if os.geteuid() != 0:
        return
    whose = directory.stat()
    if whose.st_uid == 0:
        return
    for path in directory.rglob("*"):
        with suppress(OSError):  # removed in the meantime
            if path.lstat().st_uid == 0:
                os.chown(path, whose.st_uid, whose.st_gid, follow_symlinks=False)


def fault(path: Path) -> str | None:
    """The damage found in a database file; None where it is sound.

    Raises StoreError where it cannot be read for another reason: a lock, permissions, the disk.
    """
    try:
        # not read-only: after a power cut the write-ahead log may lack its index, which only a writer may create
        with closing(connected(path, "rw", isolation_level=None, timeout=2.0)) as connection:
            return checked(connection, path)
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF not in DAMAGE:
            raise refused_by(error, path) from None
        return str(error)


def checked(connection: sqlite3.Connection, path: Path) -> str | None:
    """The damage that SQLite finds; None: there is none. Raises sqlite3.Error, or StoreError where a page could not be read."""
    result = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    if (code := re.search(r"error code=(\d+)", result)) and int(code[1]) & 0xFF not in DAMAGE:
        wrong = sqlite3.OperationalError(result.splitlines()[-1])
        wrong.sqlite_errorcode = int(code[1])
        raise refused_by(wrong, path)
    # the first line only names the database: `*** in database main ***`
    return None if result == "ok" else next((line for line in result.splitlines() if not line.startswith("***")), "damaged")


def lost(directory: Path) -> str | None:
    """Why the history in a directory is unusable: it is damaged, or missing though there was one. None where it is sound or new.

    Raises StoreError as `fault`.
    """
    path = directory / HISTORY
    is_there = path.exists()
    if not is_there or path.stat().st_size == 0:
        left = "backups of it" if backups(directory) else "recordings" if any((directory / "recordings").glob("replay-*.parquet")) else ""
        if left:
            return f"the file is {'empty' if is_there else 'gone'}, though there are {left}"
    return fault(path) if is_there else None


def back_up(directory: Path, keep: int) -> Path:
    """Make a checked copy of the history as it is at one moment, and keep the newest backup of each of the newest `keep` days.

    Writers are not blocked. Raises StoreError where the disk refuses, or where the copy is damaged, as the history then is.
    """
    folder = directory / "backups"
    target = folder / f"history-{datetime.now(UTC).strftime(_STAMP)}.sqlite"
    temporary = folder / f".{target.name}.tmp"
    try:
        folder.mkdir(exist_ok=True)
        for leftover in folder.glob(".*.tmp*"):
            leftover.unlink()
        with (
            closing(connected(directory / HISTORY, "ro")) as source,
            closing(sqlite3.connect(temporary)) as copy,
        ):
            source.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, readable where nothing can be written
        wrong = fault(temporary)
        if wrong is not None:
            raise StoreError(damaged(directory / HISTORY, f"its backup says {wrong}"))
        settle(temporary, target)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(NO_BACKUP(why=refused_by(error, target).reason)) from None
    finally:
        with suppress(OSError):  # a renamed file is no longer here; another error is reported by its own exception
            temporary.unlink()
    _prune(folder, keep)
    return target


def backups(directory: Path) -> list[Path]:
    """The backups, newest first."""
    folder = directory / "backups"
    return sorted((path for path in folder.glob("history-*.sqlite") if _NAME.match(path.name)), reverse=True) if folder.is_dir() else []


def made_at_unix_s(backup: Path) -> float:
    """When a backup was made, from its name."""
    match = _NAME.match(backup.name)
    return datetime.strptime(match[1], _STAMP).replace(tzinfo=UTC).timestamp() if match else 0.0


def restore(directory: Path, why: str) -> Restored:
    """Set the damaged history aside and put the newest good backup in its place.

    Raises StoreError where the disk refuses.
    """
    at = time.time()
    stamp = datetime.fromtimestamp(at, tz=UTC).strftime(_STAMP)
    aside = directory / f"damaged-{stamp}.sqlite"
    good = next((path for path in backups(directory) if fault(path) is None), None)
    try:
        for suffix in ("-wal", "-shm"):  # they belong to the damaged file
            with suppress(FileNotFoundError):
                os.replace(directory / f"{HISTORY}{suffix}", f"{aside}{suffix}")
        is_there = (directory / HISTORY).exists()
        if is_there:
            os.replace(directory / HISTORY, aside)
        if good is not None:
            temporary = directory / f".{HISTORY}.tmp"
            temporary.write_bytes(good.read_bytes())
            settle(temporary, directory / HISTORY)
    except OSError as error:
        raise refused_by(error, directory / f"{HISTORY} is damaged ({why}), and its backup") from None
    return Restored(why, aside if is_there else None, good, at)


def settle(temporary: Path, target: Path) -> None:
    """Give a complete file its name so that it survives a power cut: fsync, rename, fsync of the folder."""
    _fsync(temporary)
    os.replace(temporary, target)
    _fsync(target.parent)


def _fsync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _prune(folder: Path, keep: int) -> None:
    days: set[str] = set()
    for path in _newest_first(folder):
        day = path.name[8:16]
        if day in days or len(days) >= keep:
            with suppress(OSError):  # the next backup tries again
                path.unlink()
        days.add(day)


def _newest_first(folder: Path) -> Iterator[Path]:
    yield from sorted(folder.glob("history-*.sqlite"), reverse=True)
