"""The bytes of recordings where a worker finds them: in the history's folder, or in its archive. I/O."""

import hashlib
import time
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from monitor.errors import ArchiveConflict, ArchiveUnavailable, BadInput, StoreError
from monitor.store.archive.archive import Archive, split_address
from monitor.store.archive.places import ArchiveSettings
from monitor.studies.reassess.plan import Month, Stored

MOST_HELD = 64_000_000  # [byte] of recordings that are held from their digest to their identification; beyond it, a file is read again
WAITS_S = (1.0, 5.0, 20.0)  # between attempts where the archive does not answer
PRUNED = "no recording any more"  # the reason where neither history nor archive has it


class Files:
    """The recordings of one month, each read once as long as they are small together."""

    def __init__(self, month: Month) -> None:
        self.bytes_read = 0
        self.failed: list[str] = []  # recordings that the history knows by their SHA-256, and that could not be read
        self._archive = month.archive
        self._held: dict[int, bytes] = {}
        self._size = 0

    def digest(self, stored: Stored) -> str:
        """SHA-256 of a recording that the history does not know by it; empty where it cannot be read. Raises as `content`."""
        try:
            content = self._fetched(stored)
        except BadInput:
            return ""
        if self._size + len(content) <= MOST_HELD:
            self._held[stored.replay] = content
            self._size += len(content)
        return hashlib.sha256(content).hexdigest()

    def content(self, stored: Stored, digest: str) -> bytes:
        """The bytes of a recording.

        Raises BadInput where it cannot be read, ArchiveConflict where it is not the one of this digest; StoreError where this worker does
        not reach the history, ArchiveUnavailable or ArchiveRefused where it does not reach the archive.
        """
        content = self._held.pop(stored.replay, None)
        if content is not None:
            return content
        try:
            content = self._fetched(stored)
            if digest and hashlib.sha256(content).hexdigest() != digest:
                raise ArchiveConflict(f"{stored.path or stored.address}: is not the recording that was made: its SHA-256 is another")
        except (BadInput, ArchiveConflict) as wrong:
            if stored.sha256:
                self.failed.append(f"{stored.replay}: {wrong}")
            raise
        return content

    def _fetched(self, stored: Stored) -> bytes:
        """From the folder, else from the archive."""
        if stored.path:
            try:
                content = Path(stored.path).read_bytes()
            except FileNotFoundError:
                if not stored.address:
                    require_folder(Path(stored.path).parent)
                    raise BadInput(PRUNED) from None  # since the months were listed
            except OSError as wrong:
                raise BadInput(f"{stored.path}: cannot be read: {wrong.strerror or wrong}") from None
            else:
                self.bytes_read += len(content)
                return content
        if not stored.address:
            raise BadInput(PRUNED)
        content = self._archived(stored)
        self.bytes_read += len(content)
        return content

    def _archived(self, stored: Stored) -> bytes:
        root, key = split_address(stored.address)
        archive = _opened(replace(ArchiveSettings.from_document(self._archive or {"address": root}), address=root))
        for wait_s in WAITS_S:
            try:
                return archive.read(key, stored.sha256)
            except ArchiveUnavailable:
                time.sleep(wait_s)
        return archive.read(key, stored.sha256)


class ReadAhead:
    """The contents of a month's recordings in their order: each is fetched while the one before it is identified.

    A server far away answers after a tenth of a second, as long as an identification takes.
    """

    def __init__(self, files: Files, wanted: Iterable[tuple[Stored, str]]) -> None:
        self._files, self._wanted = files, iter(wanted)
        self._reader = ThreadPoolExecutor(max_workers=1)  # `Files` is for one thread
        self._coming = self._fetch()

    def __enter__(self) -> "ReadAhead":
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.shutdown(cancel_futures=True)

    def next(self) -> bytes:
        """The next recording's bytes; raises as `Files.content` for this one. To be called once for each recording."""
        this, self._coming = self._coming, self._fetch()
        assert this is not None
        return this.result()

    def _fetch(self) -> Future[bytes] | None:
        found = next(self._wanted, None)
        return None if found is None else self._reader.submit(self._files.content, *found)


def require_folder(folder: Path) -> None:
    """Raises StoreError where a folder of a history is not there for this process."""
    if not folder.is_dir():
        raise StoreError(f"{folder}: a worker does not find it; expected histories where all workers reach them under the same name")


@lru_cache(maxsize=8)
def _opened(settings: ArchiveSettings) -> Archive:
    """One connection a worker, not one a recording."""
    return Archive.open(settings)
