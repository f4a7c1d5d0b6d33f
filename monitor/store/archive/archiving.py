"""What a process of its own does for the archive, whose libraries a daemon need not hold: bring recordings, list, read back. I/O."""

import hashlib
from collections.abc import Generator, Sequence

from monitor.errors import ArchiveConflict, StoreError
from monitor.store.archive.archive import Archive, ArchivedRecording, Copy, key_of, split_address
from monitor.store.archive.archived import ArchivedRow, Waiting
from monitor.store.archive.settings import ArchiveSettings
from monitor.store.formats.recordings import recorded_at_unix_s


def bring(
    settings: ArchiveSettings, site: str, robot: str, waiting: Sequence[Waiting]
) -> Generator[tuple[int, Copy | str | None], None, None]:
    """Bring recordings, in order: the window of each, and its copy; a text where another content has its name; None where it has no file.

    Raises ArchiveUnavailable, ArchiveRefused, and StoreError where a local file cannot be read.
    """
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
