"""The archive of recordings: immutable Parquet in a bucket or a folder, under `site=…/robot=…/year=…/`. I/O; it knows no daemon.

The name of a recording holds its time, the number of its replay and the beginning of its SHA-256: the same recording always has the same
name, and two recordings never share one. What is there is never overwritten. `monitor.store.archive.places` speaks with the places.
"""

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from monitor.errors import ArchiveConflict, ArchiveLost, ArchiveRefused, BadInput
from monitor.store.archive.places import ArchiveSettings, Place, open_place

DIGITS = 16  # of the SHA-256 in a name: two recordings of one replay and one second that share them do not occur
CACHE_BYTES = 2_000_000_000  # of fetched recordings on this machine
_STAMP = "%Y%m%dT%H%M%SZ"
_KEY = re.compile(
    r"site=(?P<site>[^/]+)/robot=(?P<robot>[^/]+)/year=(?P<year>\d{4})/"
    r"(?P<at>\d{8}T\d{6}Z)-replay-(?P<replay>\d+)-(?P<digest>[0-9a-f]{16})\.parquet"
)


class ArchivedRecording(NamedTuple):
    """One recording in the archive, as its name says it."""

    key: str  # below the archive's address
    site: str
    robot: str
    year: int
    recorded_at_unix_s: float
    replay: int  # in the arm's history
    digest: str  # the first DIGITS digits of its SHA-256
    size: int  # bytes


class Copy(NamedTuple):
    """A copy whose content was read back and compared."""

    address: str
    sha256: str
    size: int  # bytes
    was_there: bool  # an earlier attempt had brought it


class Archive:
    """One archive. Every method raises ArchiveUnavailable where it may be tried again, ArchiveRefused where a person must act."""

    def __init__(self, settings: ArchiveSettings, place: Place) -> None:
        self.settings, self._place = settings, place

    @classmethod
    def open(cls, settings: ArchiveSettings) -> "Archive":
        """The archive at an address; nothing is sent yet. Raises BadInput for an address that is none."""
        return cls(settings, open_place(settings))

    def address(self, key: str) -> str:
        """The whole address of a recording."""
        return f"{self._place.address}/{key}"

    def look(self) -> None:
        """See whether the archive is there and lets us in; changes nothing."""
        self._place.look()

    def recordings(self, site: str | None = None, robot: str | None = None, year: int | None = None) -> Iterator[ArchivedRecording]:
        """The recordings of a site, a robot, a year, or all; each robot's in the order of their times. Other files are left out."""
        wanted = {"site": site, "robot": robot, "year": None if year is None else str(year)}
        folder = ""
        for name, value in wanted.items():
            if value is None:
                break
            folder += f"{name}={value}/"
        for key, size in self._place.listed(folder):
            match = _KEY.fullmatch(key)
            if match is not None and not any(value is not None and match[name] != value for name, value in wanted.items()):
                yield _recording(match, size)

    def read(self, key: str, digest: str = "") -> bytes:
        """The content of a recording, compared with the SHA-256 that its name and `digest` (its beginning, or all of it) say.

        Raises ArchiveLost where it is not there, ArchiveConflict where it has another content.
        """
        content = self._place.read(key)
        if content is None:
            raise ArchiveLost(f"{self.address(key)}: is not there: somebody has removed it, or it lies elsewhere now")
        found = hashlib.sha256(content).hexdigest()
        named = match["digest"] if (match := _KEY.fullmatch(key)) else ""
        if not found.startswith(digest) or not found.startswith(named):
            raise ArchiveConflict(
                f"{self.address(key)}: holds another content than was recorded: its SHA-256 begins with {found[:DIGITS]}, "
                f"expected {(digest or named)[:DIGITS]}; it is left as it is, restore it from a copy"
            )
        return content

    def put(self, content: bytes, key: str) -> Copy:
        """Bring a recording, and read it back. One that is there with this content is done; another content is never overwritten.

        Raises ArchiveConflict where another content has this name.
        """
        sha256 = hashlib.sha256(content).hexdigest()
        was_there = self._place.has(key)
        if not was_there:
            self._place.write(key, content)
        self.read(key, sha256)
        return Copy(self.address(key), sha256, len(content), was_there)


def key_of(site: str, robot: str, recorded_at_unix_s: float, replay: int, content: bytes) -> str:
    """The name of a recording below the archive's address."""
    at = datetime.fromtimestamp(recorded_at_unix_s, UTC)
    digest = hashlib.sha256(content).hexdigest()[:DIGITS]
    return f"site={site}/robot={robot}/year={at:%Y}/{at.strftime(_STAMP)}-replay-{replay:06d}-{digest}.parquet"


def split_address(address: str) -> tuple[str, str]:
    """The archive's address and the key of a recording's whole address. Raises BadInput for another text."""
    root, found, rest = address.rpartition("/site=")
    if not found or _KEY.fullmatch(f"site={rest}") is None:
        raise BadInput(f"{address}: is no recording of an archive; expected …/site=…/robot=…/year=…/TIME-replay-NUMBER-DIGEST.parquet")
    return root, f"site={rest}"


def recording_in(key: str) -> ArchivedRecording:
    """The recording that a key names; its size is not known."""
    match = _KEY.fullmatch(key)
    assert match is not None
    return _recording(match, 0)


def _recording(match: re.Match[str], size: int) -> ArchivedRecording:
    at = datetime.strptime(match["at"], _STAMP).replace(tzinfo=UTC).timestamp()
    return ArchivedRecording(match[0], match["site"], match["robot"], int(match["year"]), at, int(match["replay"]), match["digest"], size)


class RecordingCache:
    """Recordings fetched from archives, by their SHA-256; the ones read longest ago go first. Several processes may share the folder."""

    def __init__(self, directory: Path | None = None, most_bytes: int = CACHE_BYTES) -> None:
        self._directory, self._most_bytes = directory or _cache_folder(), most_bytes

    def fetched(self, settings: ArchiveSettings, address: str, sha256: str = "") -> Path:
        """The file with the content of a recording's whole address; it is fetched where it is not here.

        settings : of its archive; one at another address is asked with the same keys. sha256 : as the history has it, or empty.
        Raises as `Archive.read`, and ArchiveRefused where the folder cannot be written.
        """
        root, key = split_address(address)
        digest = sha256 or str(key.rpartition("-")[2].removesuffix(".parquet"))
        path = self._directory / f"{digest}.parquet"
        with suppress(OSError):
            if hashlib.sha256(path.read_bytes()).hexdigest().startswith(digest):
                os.utime(path)
                return path
        content = Archive.open(replace(settings, address=root)).read(key, digest)
        temporary = None
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            self._make_room(len(content))
            handle, temporary = tempfile.mkstemp(prefix=".", suffix=".tmp", dir=self._directory)
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, path)
        except OSError as wrong:
            if temporary is not None:  # half a recording fills the disk that refused it
                with suppress(OSError):
                    os.unlink(temporary)
            raise ArchiveRefused(f"{self._directory}: fetched recordings cannot be written: {wrong.strerror or wrong}") from None
        return path

    def _make_room(self, size: int) -> None:
        """Remove what was read longest ago, and what was left half-written, until `size` more bytes fit."""
        kept = []
        for path in self._directory.iterdir():
            with suppress(OSError):  # another process removes as well
                kept.append((path.stat().st_mtime, path.stat().st_size, path))
        total = size + sum(each[1] for each in kept)
        for _, bytes_there, path in sorted(kept):
            if total <= self._most_bytes:
                break
            with suppress(OSError):
                path.unlink()
            total -= bytes_there


def _cache_folder() -> Path:
    """The user's folder for what can be fetched again; a temporary one where there is none."""
    base = os.environ.get("CACHE_DIRECTORY", "").split(":")[0] or os.environ.get("XDG_CACHE_HOME", "")
    if not base:
        home = os.environ.get("HOME", "")
        base = f"{home}/.cache" if home and os.access(home, os.W_OK) else f"{tempfile.gettempdir()}/joint-monitor-{os.getuid()}"
    return Path(base) / "joint-monitor" / "recordings"
