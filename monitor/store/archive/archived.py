"""The recordings of one history: which are here, which the archive has, which wait for it, and which are pruned. I/O.

The oldest recordings are pruned by age and by total size. One that waits for its assessment and the last few stay; with an archive, only
what that has is pruned. `bring`, `listed`, `changed` and `copies` run in a process of their own: a daemon need not hold the archive's
libraries.
"""

import hashlib
import json
from collections.abc import Collection, Generator, Sequence
from pathlib import Path
from typing import NamedTuple

from monitor.errors import ArchiveConflict, StoreError
from monitor.recording import DAY_S
from monitor.store.archive.archive import DIGITS, Archive, ArchivedRecording, Copy, RecordingCache, key_of, split_address
from monitor.store.archive.places import ArchiveSettings
from monitor.store.history.database import Database, Notes
from monitor.store.history.ledger import Ledger, RecordingFolder

PLACE = "archive"  # name of the note with the archive's settings: whoever has the history finds its recordings
LEAST_KEPT = 10  # recordings that stay whatever the limits: a person who searches for a cause needs some
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


class Forgotten(NamedTuple):
    """A recording that is not here, and of which this history does not know that it ever was in the archive."""

    ledger_id: int
    times_unix_s: tuple[float, ...]  # that its name in the archive may hold
    from_unix_s: float  # between these it was made
    to_unix_s: float

    def may_be(self, recorded_at_unix_s: float) -> bool:
        """Whether a recording of the same number that was made at a time, in full seconds, is this one."""
        between = int(self.from_unix_s) <= recorded_at_unix_s <= self.to_unix_s
        return between or any(int(at) == recorded_at_unix_s for at in self.times_unix_s)


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

    def forgotten(self) -> list[Forgotten]:
        """Recordings with an outcome that are neither here nor, as far as this history knows, in the archive; by their windows.

        A history that was restored from an older backup does not know what was archived since.
        """
        rows = self._db.rows(
            "SELECT id, recording, window_unix_s, started_at_unix_s, ended_at_unix_s, a.recorded_at_unix_s "
            "FROM ledger LEFT JOIN archived r ON r.ledger_id = id LEFT JOIN assessment a ON a.ledger_id = id "
            "WHERE state IN ('assessed', 'rejected') AND recording IS NOT NULL AND r.ledger_id IS NULL ORDER BY id"
        )
        return [
            Forgotten(number, tuple(at for at in (window, judged) if at is not None), started, started if ended is None else ended)
            for number, name, window, started, ended, judged in rows
            if not (self._recordings.directory / name).is_file()
        ]

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
        """The file of a window's recording: the local one, else one that is fetched from the archive; each is compared with the history.

        Where neither has it, the path of the local file that is not there. Raises ArchiveUnavailable, ArchiveRefused, ArchiveConflict.
        """
        local, row = self._recordings.path(ledger_id), self.of(ledger_id)
        if local.is_file() and (row is None or _compared(local, row)):
            return local
        settings = self.place()
        if row is None or settings is None:
            return local
        return RecordingCache().fetched(settings, row.address, row.sha256)


class KeptRecording(NamedTuple):
    """A recording on disk that may be pruned."""

    ledger_id: int
    path: Path
    at_unix_s: float
    size: int  # bytes


def to_prune(kept: list[KeptRecording], *, days: float, most_bytes: float, now_unix_s: float) -> list[KeptRecording]:
    """The recordings beyond the limits, oldest first; 0 is no limit. kept : recordings with an outcome, oldest first."""
    may_go = kept[: max(0, len(kept) - LEAST_KEPT)]
    total = sum(each.size for each in kept)
    going = []
    for each in may_go:
        old = days > 0 and now_unix_s - each.at_unix_s > days * DAY_S
        if not old and not (most_bytes > 0 and total > most_bytes):
            continue
        going.append(each)
        total -= each.size
    return going


class Retention:
    """Removes recordings beyond the configured limits."""

    def __init__(self, ledger: Ledger, recordings: RecordingFolder) -> None:
        self._ledger = ledger
        self._recordings = recordings

    def prune(
        self, *, days: float, most_bytes: float, at_unix_s: float, among: Collection[int] | None = None, but: Collection[int] = ()
    ) -> list[str]:
        """Remove the recordings beyond these limits (0: no limit), and note it with their windows. Returns the removed files' names.

        among : the windows whose recordings the archive has; all others stay, whatever the limits. but : windows whose recordings stay.
        Raises StoreError where one cannot be removed.
        """
        going = self.going(days=days, most_bytes=most_bytes, at_unix_s=at_unix_s, among=among, but=but)
        for each in going:
            try:
                each.path.unlink(missing_ok=True)
                if among is None:  # the archive has no first passes
                    self._recordings.first_pass_path(each.ledger_id).unlink(missing_ok=True)
            except OSError as error:
                raise StoreError(f"{each.path}: cannot be removed: {error.strerror}") from None
            self._ledger.mark_removed(each.ledger_id, at_unix_s)
        return [each.path.name for each in going]

    def going(
        self, *, days: float, most_bytes: float, at_unix_s: float, among: Collection[int] | None = None, but: Collection[int] = ()
    ) -> list[KeptRecording]:
        """The recordings that `prune` would remove, oldest first; those that somebody else has removed are noted."""
        kept = []
        for row in self._ledger.rows(states=("assessed", "rejected")):
            if row.recording is None or row.removed_at_unix_s is not None:
                continue
            path = self._recordings.directory / row.recording
            try:
                kept.append(KeptRecording(row.id, path, row.started_at_unix_s, path.stat().st_size))
            except FileNotFoundError:
                self._ledger.mark_removed(row.id, at_unix_s)  # a person removed it, or a crash came between removing and noting
        going = to_prune(kept, days=days, most_bytes=most_bytes, now_unix_s=at_unix_s)
        return [each for each in going if each.ledger_id not in but and (among is None or each.ledger_id in among)]


def bring(
    settings: ArchiveSettings, site: str, robot: str, waiting: Sequence[Waiting]
) -> Generator[tuple[int, Copy | str | None], None, None]:
    """Bring recordings, in order: the window of each, and its copy; a text where another content has its name; None where it has no file.

    Raises ArchiveUnavailable, ArchiveRefused, and StoreError where a local file cannot be read.
    """
    from monitor.store.formats.recordings import recorded_at_unix_s  # only a process that brings reads recordings

    archive = Archive.open(settings)
    for each in waiting:
        try:
            content = each.path.read_bytes()
        except FileNotFoundError:  # a person removed it; retention notes that
            yield each.ledger_id, None
            continue
        except OSError as error:
            raise StoreError(f"{each.path}: cannot be read for the archive: {error.strerror}") from None
        at = recorded_at_unix_s(content)
        key = key_of(site, robot, each.window_unix_s if at is None else at, each.ledger_id, content)
        try:
            yield each.ledger_id, archive.put(content, key)
        except ArchiveConflict as conflict:
            yield each.ledger_id, str(conflict)


def listed(settings: ArchiveSettings, arms: Sequence[tuple[str, str]]) -> dict[str, ArchivedRecording]:
    """Every recording of some arms, (site, robot), by its address. Raises ArchiveUnavailable, ArchiveRefused."""
    archive = Archive.open(settings)
    return {archive.address(each.key): each for site, robot in arms for each in archive.recordings(site, robot)}


def changed(settings: ArchiveSettings, rows: Sequence[ArchivedRow]) -> Generator[tuple[int, str | None], None, None]:
    """Read recordings back, in order: the window of each, and what is wrong with its content, or None. Raises as `listed`."""
    archive = Archive.open(settings)
    for row in rows:
        try:
            archive.read(split_address(row.address)[1], row.sha256)
            yield row.ledger_id, None
        except ArchiveConflict as conflict:
            yield row.ledger_id, str(conflict)


def copies(settings: ArchiveSettings, there: Sequence[tuple[int, ArchivedRecording]]) -> Generator[tuple[int, Copy | str], None, None]:
    """Read recordings of windows that forgot them: the copy that each is, or what is wrong with it. Raises as `listed`."""
    archive = Archive.open(settings)
    for ledger_id, each in there:
        try:
            content = archive.read(each.key, each.digest)
            yield ledger_id, Copy(archive.address(each.key), hashlib.sha256(content).hexdigest(), len(content), was_there=True)
        except ArchiveConflict as conflict:
            yield ledger_id, str(conflict)


def _compared(local: Path, row: ArchivedRow) -> bool:
    """True: the local file is what was archived. False: it is not there any more, since retention goes on while somebody reads.

    Raises ArchiveConflict where it is another, StoreError where it cannot be read.
    """
    try:
        with local.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return False
    except OSError as error:
        raise StoreError(f"{local}: cannot be read: {error.strerror}") from None
    if found != row.sha256:
        raise ArchiveConflict(
            f"{local}: is not the recording that was made: its SHA-256 begins with {found[:DIGITS]}, expected {row.sha256[:DIGITS]}; "
            f"move it away: {row.address} is taken in its place"
        )
    return True
