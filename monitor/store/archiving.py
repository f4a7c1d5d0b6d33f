"""What a process of its own does for the archive, because a daemon need not hold its libraries: bring recordings, list them. I/O."""

from collections.abc import Generator, Sequence

from monitor.errors import ArchiveConflict, StoreError
from monitor.store.archive import Archive, Copy, key_of
from monitor.store.archive_settings import ArchiveSettings
from monitor.store.archived import Waiting
from monitor.store.recordings import recorded_at_unix_s


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


def sizes(settings: ArchiveSettings, arms: Sequence[tuple[str, str]]) -> dict[str, int]:
    """Address and size of every recording of some arms, (site, robot). Raises ArchiveUnavailable, ArchiveRefused."""
    archive = Archive.open(settings)
    return {archive.address(each.key): each.size for site, robot in arms for each in archive.recordings(site, robot)}
