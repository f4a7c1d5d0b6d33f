"""Retention: the oldest recordings are pruned by age and by total size. I/O.

A recording that waits for its assessment and the last few stay. With an archive, only what that has is pruned.
"""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from monitor.errors import StoreError
from monitor.recording import DAY_S
from monitor.store.formats.recordings import RecordingFolder
from monitor.store.history.ledger import Ledger

LEAST_KEPT = 10  # recordings that stay whatever the limits: a person who searches for a cause needs some


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
