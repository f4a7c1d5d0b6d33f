"""Which recordings are let go of: the oldest, by age and by size; never one that waits, never the last few."""

from pathlib import Path
from typing import NamedTuple

from monitor.errors import StoreError
from monitor.store.ledger import Ledger
from monitor.store.recordings import RecordingFolder

LEAST_KEPT = 10  # whatever the limits say: a person who looks for a reason wants to see some


class KeptRecording(NamedTuple):
    """A recording on disk."""

    ledger_id: int
    path: Path
    at_unix_s: float
    size: int  # bytes


def to_prune(kept: list[KeptRecording], *, days: float, most_bytes: float, now_unix_s: float) -> list[KeptRecording]:
    """Those beyond the limits, oldest first; 0 is no limit. `kept` holds only what has been judged, oldest first."""
    may_go = kept[: max(0, len(kept) - LEAST_KEPT)]
    total = sum(each.size for each in kept)
    going = []
    for each in may_go:
        old = days > 0 and now_unix_s - each.at_unix_s > days * 86_400.0
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

    def prune(self, *, days: float, most_bytes: float, at_unix_s: float) -> list[str]:
        """Remove the recordings beyond these limits (0: none), and note it with their windows. Returns their names.

        Raises StoreError where one cannot be removed.
        """
        kept = []
        for row in self._ledger.rows(states=("assessed", "rejected")):
            if row.recording is None or row.removed_at_unix_s is not None:
                continue
            path = self._recordings.directory / row.recording
            try:
                kept.append(KeptRecording(row.id, path, row.started_at_unix_s, path.stat().st_size))
            except FileNotFoundError:
                self._ledger.mark_removed(row.id, at_unix_s)  # a person took it, or a crash came between removing and noting
        going = to_prune(kept, days=days, most_bytes=most_bytes, now_unix_s=at_unix_s)
        for each in going:
            try:
                each.path.unlink(missing_ok=True)
                self._recordings.first_pass_path(each.ledger_id).unlink(missing_ok=True)
            except OSError as error:
                raise StoreError(f"{each.path}: cannot be removed: {error.strerror}") from None
            self._ledger.mark_removed(each.ledger_id, at_unix_s)
        return [each.path.name for each in going]
