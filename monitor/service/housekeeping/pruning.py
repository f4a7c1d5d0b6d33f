"""Local retention as it is configured, with the problem where the disk refuses. I/O."""

import logging
from collections.abc import Collection
from typing import Any

from monitor.config.schema import StoreSettings
from monitor.errors import StoreError
from monitor.service.problems import Problems
from monitor.service.production.production import PINNED
from monitor.store.store import Store

log = logging.getLogger(__name__)


def going(store: Store, settings: StoreSettings, now_unix_s: float, among: Collection[int]) -> list[int]:
    """The windows whose recordings `prune` would remove, oldest first. Raises StoreError."""
    limits = _limits(store, settings)
    return [each.ledger_id for each in store.retention.going(at_unix_s=now_unix_s, among=among, **limits)]


def prune(store: Store, settings: StoreSettings, problems: Problems, now_unix_s: float, among: Collection[int] | None = None) -> None:
    """Remove recordings that are too old or too many; of `among` alone, where given: the windows whose recordings the archive has."""
    try:
        gone = store.retention.prune(at_unix_s=now_unix_s, among=among, **_limits(store, settings))
        if gone:
            log.info("let go of %d recordings, %s to %s", len(gone), gone[0], gone[-1])
        problems.clear("retention")
    except StoreError as error:
        problems.report("retention", str(error))


def _limits(store: Store, settings: StoreSettings) -> dict[str, Any]:
    """What bounds the local recordings, by the names of `Retention`."""
    pinned = store.notes.get(PINNED)  # ordinary work is measured against this replay
    return {
        "days": settings.keep_local_days or settings.recordings_days,
        "most_bytes": 1e9 * settings.recordings_gb,
        "but": () if pinned is None else (int(pinned),),
    }
