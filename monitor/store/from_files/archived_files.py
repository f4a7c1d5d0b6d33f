"""A recording that a command names and that is in the archive alone: by its former place in a history, or by its address. I/O."""

import re
from pathlib import Path

from monitor.store.archive.archive import RecordingCache, split_address
from monitor.store.archive.places import ArchiveSettings
from monitor.store.backup import HISTORY
from monitor.store.store import Store

_REPLAY = re.compile(r"replay-(\d{6,})\.parquet")
_ADDRESS = re.compile(r"s3:/+(?=[^/])")  # a path has lost one of the two slashes


def local_file(path: Path) -> Path:
    """The file that a command names, or a copy of it from the archive: of a history's pruned recording, or of an address s3://….

    Any other path comes back as it is. Raises as `Archived.path`, and BadInput for an address that is none.
    """
    if _ADDRESS.match(str(path)):
        address = _ADDRESS.sub("s3://", str(path))
        return RecordingCache().fetched(ArchiveSettings(address=split_address(address)[0]), address)
    match, directory = _REPLAY.fullmatch(path.name), path.absolute().parent.parent
    if match is None or path.exists() or path.absolute().parent.name != "recordings" or not (directory / HISTORY).is_file():
        return path
    with Store.reader(directory) as store:
        found = store.archived.path(int(match[1]))
    return found if found.exists() else path
