"""The store of one robot's history: SQLite, with the recordings as Parquet files. One process writes at a time. I/O.

Order of durability of one replay: ledger row `started` → motion under way → its end → recording (temporary file, fsync, rename) →
ledger row `recorded` → assessment, belief, health and events in one transaction → publication. `Ledger.repair` settles what a crash
between two of these left behind; a window in which the arm moved is never started again. A motion without an end becomes a stop.
"""

import fcntl
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from monitor.errors import StoreError, StoreInUse
from monitor.reason import Sentence
from monitor.store.archive.archived import Archived, Retention
from monitor.store.archive.places import ArchiveSettings
from monitor.store.backup import HISTORY, Restored, back_up, connected, hand_over, lost, present, restore
from monitor.store.disk import refuse_network, refused_by
from monitor.store.history.assessments import Assessments
from monitor.store.history.database import Database, Notes, begin_history, version_of
from monitor.store.history.duties import Duties
from monitor.store.history.events import Changes, Events
from monitor.store.history.ledger import Borrows, Ledger, RecordingFolder
from monitor.store.history.maintenance import MaintenanceLog
from monitor.store.history.motions import HISTORY_RESTORED, FirstPasses, Motions, Stops
from monitor.store.history.production import ProductionLog
from monitor.store.stored import StoredLog, keep_log

RESTORED = "restored_unreported"  # name of the note with the outcome of a restoration, until an alert reports it
STOPS_LOST = Sentence(HISTORY_RESTORED, "{restored}; a stop that waited for a person, or a motion under way, may be lost with it")


def expect_history(directory: Path) -> None:
    """Raises StoreError where there is no history yet."""
    if not present(directory):
        raise StoreError(f"{directory / HISTORY}: no history yet; it is made by the first `joint-monitor run` with this configuration")


class Store:
    """One robot's history below one directory, put together from its parts over one connection.

    Made by `Store.open` (the daemon: locked), `Store.reader` (commands, also while a daemon runs) or `Store.shared`.
    """

    def __init__(self, directory: Path, connection: sqlite3.Connection, restored: Restored | None = None) -> None:
        self.directory = directory
        self.restored = restored  # the outcome, where the history was damaged
        self.database = Database(directory, connection)
        self.recordings = RecordingFolder(directory / "recordings")
        self.ledger = Ledger(self.database, self.recordings)
        self.stops = Stops(self.database)
        self.motions = Motions(self.database)
        self.borrows = Borrows(self.database)
        self.first_passes = FirstPasses(self.database)
        self.assessments = Assessments(self.database)
        self.events = Events(self.database)
        self.changes = Changes(self.database)
        self.stored = StoredLog(self.database)
        self.maintenance = MaintenanceLog(self.database)
        self.production = ProductionLog(self.database)
        self.duties = Duties(self.database)
        self.notes = Notes(self.database)
        self.archived = Archived(self.database, self.recordings)
        self.retention = Retention(self.ledger, self.recordings)

    @classmethod
    @contextmanager
    def open(cls, directory: Path) -> Iterator["Store"]:
        """Open the store for its one writer. A damaged history is set aside and replaced by its newest good backup: see `restored`.

        Raises StoreError where the directory is on a network or cannot be written, another process has it, or the file is newer, older or
        another program's.
        """
        refuse_network(directory)
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
                raise StoreInUse(f"{directory}: in use by another joint-monitor; one daemon per robot and state directory") from None
            wrong = lost(directory)
            restored = restore(directory, wrong) if wrong is not None else None
            try:
                connection = sqlite3.connect(directory / HISTORY, isolation_level=None, check_same_thread=False)
                version_of(connection, directory)  # before anything is written
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = FULL")  # 0.3 ms a commit and a few commits a replay: full durability is cheap
                connection.execute("PRAGMA foreign_keys = ON")
                begin_history(connection, directory)
                keep_log(connection)
            except sqlite3.DatabaseError as error:
                raise refused_by(error, directory / HISTORY) from None
            store = cls(directory, connection, restored)
            if restored is None and (orphans := store.ledger.orphans()):  # SQLite silently drops a torn log after its last sound page
                why = f"{len(orphans)} recordings from replay {orphans[0][0]} on are not in it"
                store.restored = Restored(why, None, None, time.time(), replaced=False)
            if store.restored is not None:
                store.events.number_from(store.restored.at_unix_s)
                store.changes.begin_another_history()
                store.notes.set(RESTORED, store.restored.reason.text)
                store.stops.add(HISTORY_RESTORED, STOPS_LOST(restored=store.restored.reason), store.restored.at_unix_s)
            yield store
        finally:
            if connection is not None:
                connection.close()
            hand_over(directory)
            os.close(lock)

    @classmethod
    @contextmanager
    def reader(cls, directory: Path, archive: ArchiveSettings | None = None) -> Iterator["Store"]:
        """Open the store for reading, also while the daemon writes.

        archive : where recordings that are no longer here are fetched from; None: as the history has noted it.
        Raises StoreError where there is no history yet, or the file is newer, older or another program's.
        """
        expect_history(directory)
        path = directory / HISTORY
        connection = connected(path, "ro", isolation_level=None)
        try:
            version_of(connection, directory)
            store = cls(directory, connection)
            store.archived.settings = archive
            yield store
        except sqlite3.DatabaseError as error:
            raise refused_by(error, path) from None
        finally:
            connection.close()

    @classmethod
    @contextmanager
    def shared(cls, directory: Path) -> Iterator["Store"]:
        """Open the store to write stops and first passes while a daemon may run; the ledger stays untouched.

        Raises StoreError where the directory cannot be written, or the file is damaged, newer or older.
        """
        path = directory / HISTORY
        refuse_network(directory)
        try:
            (directory / "recordings").mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(path, isolation_level=None, timeout=5.0)
        except (OSError, sqlite3.OperationalError) as error:
            raise refused_by(error, directory) from None
        try:
            version_of(connection, directory)
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            begin_history(connection, directory)
            yield cls(directory, connection)
        except sqlite3.DatabaseError as error:
            raise refused_by(error, path) from None
        finally:
            connection.close()
            hand_over(directory)

    def back_up(self, keep: int) -> Path:
        """Make a backup now, as `backup.back_up`; writers are not blocked. Raises StoreError."""
        return back_up(self.directory, keep)
