"""An arm's history where a worker opens it: a folder that all of them reach, or a plant's copy, kept among the results. I/O."""

import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from monitor.errors import StoreError
from monitor.store.backup import HISTORY
from monitor.store.store import Store
from monitor.studies.from_plant import Copy
from monitor.studies.reassess.identify_month import Results
from monitor.studies.reassess.plan import Arm, require_folder

KIND = "history"  # of results


def keep_history(copy: Copy, results: Results) -> str:
    """Keep a plant's copy for the workers, which need not reach its database; the address of the result. Raises ResultsRefused."""
    if not results.has(KIND, copy.digest):
        results.write(KIND, copy.digest, zlib.compress((copy.folder / HISTORY).read_bytes(), level=1))
    return copy.digest


@contextmanager
def opened(arm: Arm, results: Results) -> Iterator[Store]:
    """The history of an arm, to be read. Raises StoreError where this process does not find it, ResultsRefused."""
    if not arm.kept:
        require_folder(Path(arm.history))
        with Store.reader(Path(arm.history)) as store:
            yield store
        return
    content = results.read(KIND, arm.kept)
    if content is None:
        raise StoreError(f"{results.place}: the result {KIND}/{arm.kept} is not there any more: call again")
    with tempfile.TemporaryDirectory(prefix="joint-monitor-history-") as folder:
        (Path(folder) / HISTORY).write_bytes(zlib.decompress(content))
        with Store.reader(Path(folder)) as store:
            yield store
