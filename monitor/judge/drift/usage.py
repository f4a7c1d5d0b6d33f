"""How much a joint has worked: revolutions, as whoever listens counts them, and what is usual for it on a day.

Wear comes from work, not from waiting. Where nobody counts, every day is a usual one.
"""

from typing import Any, NamedTuple

import numpy as np

from monitor.judge.document import arrays
from monitor.recording import Array

MEMORY_DAYS = 60.0  # what is usual follows a change of work within about two months
MOST_DAYS = 20.0  # of usual work on one day: more is a counter that is wrong
STILL_REV_PER_DAY = 0.5  # less work than this is none, and no measure of wear


class Usage(NamedTuple):
    """What is known of the work of N joints; NaN where nobody counts."""

    revolutions: Array  # (N,) counted at the last replay
    per_day: Array  # (N,) usual
    days: Array  # (N,) over which that was learnt


class UsageUpdate(NamedTuple):
    """What a joint has done since the last replay."""

    usage: Usage
    usual_days: Array  # (N,) of work
    factor: Array  # (N,) by which what is usual has changed


def no_usage(joints: int) -> Usage:
    """Before anything was counted."""
    return Usage(np.full(joints, np.nan), np.full(joints, np.nan), np.zeros(joints))


def update_usage(usage: Usage, revolutions: Array, days: Array) -> UsageUpdate:
    """After `days` (N,), at a count of `revolutions` (N,). A counter that is missing or ran backwards counts as usual work."""
    done = revolutions - usage.revolutions
    known = np.isfinite(done) & (done >= 0) & (days > 0)
    done, span = np.where(known, done, 0.0), np.where(known, days, 1.0)
    n = np.where(known, np.minimum(usage.days + days, MEMORY_DAYS), usage.days)
    share = np.where(known, np.minimum(span / np.maximum(n, 1e-9), 1.0), 0.0)
    before = np.where(np.isfinite(usage.per_day), usage.per_day, done / span)
    per_day = np.where(known, before + (done / span - before) * share, usage.per_day)
    measured = known & (per_day > STILL_REV_PER_DAY) & (before > STILL_REV_PER_DAY)
    factor = np.where(measured, per_day / np.maximum(before, STILL_REV_PER_DAY), 1.0)
    usual = np.where(measured, np.minimum(done / np.maximum(per_day, STILL_REV_PER_DAY), MOST_DAYS * span), days)
    counted = np.where(np.isfinite(revolutions), revolutions, usage.revolutions)
    return UsageUpdate(Usage(counted, per_day, n), usual, factor)


def usage_from_document(document: Any, joints: int) -> Usage:
    """Usage from its document. Raises BadInput naming the key."""
    return Usage(**arrays(document, Usage._fields, (joints,), where="belief: usage"))
