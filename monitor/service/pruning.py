"""Local retention as it is configured, with the problem where the disk refuses. I/O."""

import logging
from collections.abc import Collection

from monitor.config.schema import StoreSettings
from monitor.errors import StoreError
from monitor.service.ordinary_work import PINNED
from monitor.service.problems import Problems
from monitor.store.store import Store

log = logging.getLogger(__name__)


def prune(store: Store, settings: StoreSettings, problems: Problems, now_unix_s: float, among: Collection[int] | None = None) -> None:
    """Remove recordings that are too old or too many; of `among` alone, where given: the windows whose recordings the archive has."""
    try:
        pinned = store.notes.get(PINNED)  # ordinary work is measured against this replay
        gone = store.retention.prune(
            days=settings.keep_local_days or settings.recordings_days,
            most_bytes=1e9 * settings.recordings_gb,
            at_unix_s=now_unix_s,
            among=among,
            but=() if pinned is None else (int(pinned),),
        )
        if gone:
            log.info("let go of %d recordings, %s to %s", len(gone), gone[0], gone[-1])
        problems.clear("retention")
    except StoreError as error:
        problems.report("retention", str(error))
