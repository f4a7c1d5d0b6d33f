"""Which recordings are let go of: the oldest, by age and by size; never one that waits, never the last few."""

from pathlib import Path
from typing import NamedTuple

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
