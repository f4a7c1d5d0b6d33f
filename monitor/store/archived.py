"""Which recordings of a history the archive has, and which wait for it. I/O."""

import json
from pathlib import Path
from typing import NamedTuple

from monitor.store.archive import Copy, RecordingCache
from monitor.store.archive_settings import ArchiveSettings
from monitor.store.database import Database, Notes
from monitor.store.recordings import RecordingFolder

PLACE = "archive"  # name of the note with the archive's settings: whoever has the history finds its recordings
_WAITING = (
    "FROM ledger LEFT JOIN archived ON ledger_id = id "
    "WHERE state IN ('assessed', 'rejected') AND recording IS NOT NULL AND removed_at_unix_s IS NULL AND ledger_id IS NULL"
)


class ArchivedRow(NamedTuple):
    """A recording of this history in the archive."""

    ledger_id: int
    address: str
    sha256: str
    size: int  # bytes
    verified_at_unix_s: float


class Waiting(NamedTuple):
    """A recording that the archive does not have yet."""

    ledger_id: int
    path: Path
    window_unix_s: float


class Archived:
    """The recordings of one history in its archive, and where a recording is now."""

    def __init__(self, database: Database, recordings: RecordingFolder) -> None:
        self._db, self._recordings = database, recordings
        self._notes = Notes(database)
        self.settings: ArchiveSettings | None = None  # of the configuration; None: as the history has noted them

    def waiting(self, limit: int, after: int = 0) -> list[Waiting]:
        """Recordings with an outcome that are not in the archive, oldest first, with ids above `after`."""
        rows = self._db.rows(f"SELECT id, recording, window_unix_s {_WAITING} AND id > ? ORDER BY id LIMIT ?", (after, limit))
        return [Waiting(int(number), self._recordings.directory / name, float(at)) for number, name, at in rows]

    def waits(self) -> tuple[int, float | None]:
        """How many recordings wait, and the start of the oldest one's window."""
        ((count, since),) = self._db.rows(f"SELECT count(*), min(started_at_unix_s) {_WAITING}")
        return int(count), since

    def add(self, ledger_id: int, copy: Copy, at_unix_s: float) -> None:
        """Note that the archive has this recording. What is noted once stays."""
        with self._db.transaction() as db:
            db.execute(
                "INSERT OR IGNORE INTO archived VALUES (?, ?, ?, ?, ?)", (ledger_id, copy.address, copy.sha256, copy.size, float(at_unix_s))
            )

    def remove(self, ledger_id: int) -> None:
        """Note that the archive does not have this recording any more: it is brought again."""
        with self._db.transaction() as db:
            db.execute("DELETE FROM archived WHERE ledger_id = ?", (ledger_id,))

    def of(self, ledger_id: int) -> ArchivedRow | None:
        """The recording of this window in the archive; None where that has none."""
        rows = self._db.rows("SELECT ledger_id, address, sha256, bytes, verified_at_unix_s FROM archived WHERE ledger_id = ?", (ledger_id,))
        return ArchivedRow(*rows[0]) if rows else None

    def rows(self) -> list[ArchivedRow]:
        """All recordings in the archive, by their windows."""
        query = "SELECT ledger_id, address, sha256, bytes, verified_at_unix_s FROM archived ORDER BY ledger_id"
        return [ArchivedRow(*row) for row in self._db.rows(query)]

    def count(self) -> int:
        """How many recordings the archive has of this history."""
        ((count,),) = self._db.rows("SELECT count(*) FROM archived")
        return int(count)

    def note_place(self, settings: ArchiveSettings) -> None:
        """Keep where the archive is, without keys."""
        text = json.dumps(settings.as_document(), sort_keys=True)
        if self._notes.get(PLACE) != text:
            self._notes.set(PLACE, text)

    def place(self) -> ArchiveSettings | None:
        """Where the archive is: as configured, else as the history has noted it; None where there never was one."""
        if self.settings is not None:
            return self.settings
        noted = self._notes.get(PLACE)
        return None if noted is None else ArchiveSettings.from_document(json.loads(noted))

    def path(self, ledger_id: int) -> Path:
        """The file of a window's recording: the local one, else one that is fetched from the archive and compared with the history.

        Where neither has it, the path of the local file that is not there. Raises ArchiveUnavailable, ArchiveRefused, ArchiveConflict.
        """
        local = self._recordings.path(ledger_id)
        if local.is_file():
            return local
        row, settings = self.of(ledger_id), self.place()
        if row is None or settings is None:
            return local
        return RecordingCache().fetched(settings, row.address, row.sha256)
