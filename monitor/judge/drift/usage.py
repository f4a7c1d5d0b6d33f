"""How much a joint is used: its revolutions, as the bus listener counts them, and the usual usage of a day.

Wear comes from usage and not from waiting. Where nobody counts, every day is a usual one.
"""

from typing import Annotated, NamedTuple

import numpy as np

from monitor.recording import Array

MEMORY_DAYS = 60.0  # [day] the usual usage follows a change within about two months
MOST_DAYS = 20.0  # usual days of usage on one day: a count beyond it is wrong
STILL_REV_PER_DAY = 0.5  # less usage than this is none, and no measure of wear


class Usage(NamedTuple):
    """What is known of the usage of N joints, (N,) each; NaN where nobody counts."""

    revolutions: Annotated[Array, "N"]  # total count at the last replay
    per_day: Annotated[Array, "N"]  # usual revolutions per day
    days: Annotated[Array, "N"]  # over which `per_day` was learned


class UsageUpdate(NamedTuple):
    """What a joint has done since the last replay, (N,) each."""

    usage: Usage
    usual_days: Array  # usage so far, in usual days
    factor: Array  # new usual usage of a day over the one before


def no_usage(joints: int) -> Usage:
    """The usage of N joints before anything was counted."""
    return Usage(np.full(joints, np.nan), np.full(joints, np.nan), np.zeros(joints))


def update_usage(usage: Usage, revolutions: Array, days: Array) -> UsageUpdate:
    """The usage after `days` (N,), at a total count of `revolutions` (N,).

    A counter that is missing or ran backwards means the usual usage.
    """
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
