"""The course of friction so far, compressed: sums over blocks of replays, from which the path of wear can be fitted at any time.

The filter's (wear, rate) has forgotten how friction came to where it is: whether its rate rises or falls. A block keeps the sums of log
torque and of the filter's rows, so that what was observed can be corrected with the temperature law and the levels of today. Blocks are
narrow where they are young and wide where they are old: their width is about a constant share of (age + `RECENT_DAYS`).

Shapes: N joints, B = BLOCKS blocks of each, youngest first, K = SUMS sums of each.
"""

import numpy as np

from monitor.recording import Array

BLOCKS = 48  # B: with 1000 days of history a block is 6 % of (age + 60 days) wide: 4 days now, 33 days half-way back
COUNT, PRODUCTION_AGE, AGE, SLOPE_SUM, CURVE_SUM, LAG_SUM, LEVELS_SUM = range(
    7
)  # the first sums of a block; then one for each slot, and log torque
RECENT_DAYS = 60.0  # [d] a younger past is kept about evenly
SEEDED = 6  # blocks before the onset, and as many since, in the history of a belief that has none
FULL = 4.0  # [replays] of the youngest block, after which a new one begins: correlated noise leaves nothing finer to see


def empty_history(joints: int, slots: int) -> Array:
    """(N, B, K) without any replay."""
    return np.zeros((joints, BLOCKS, LEVELS_SUM + slots + 1))


def age_history(history: Array, production: Array, days: Array) -> Array:
    """The history `days` (N,) later, after `work` (N,) usual days of usage."""
    older = history.copy()
    older[:, :, PRODUCTION_AGE] += history[:, :, COUNT] * production[:, None]
    older[:, :, AGE] += history[:, :, COUNT] * days[:, None]
    return older


def rescale_production(history: Array, factor: Array) -> Array:
    """The history after a usual day became `factor` (N,) times as much usage: the same usage took fewer usual days."""
    rescaled = history.copy()
    rescaled[:, :, PRODUCTION_AGE] /= factor[:, None]
    return rescaled


def add_replay(history: Array, row: Array, log_torque: Array, learnt: np.ndarray) -> Array:
    """The history with one replay more of the joints in `learnt` (N,).

    row : (N, 3 + slots) the entries of the filter's row of slope, curvature, lag and levels.
    """
    older = history.copy()
    full = np.flatnonzero(learnt & (history[:, 0, COUNT] >= FULL))
    if len(full):
        older[full] = _begin_block(history[full])
    older[learnt, 0, COUNT] += 1.0
    older[learnt, 0, SLOPE_SUM:-1] += row[learnt]
    older[learnt, 0, -1] += log_torque[learnt]
    return older


def move_level(history: Array, shared: Array) -> Array:
    """The history before the levels move by `shared` (N,), without wear: its replays move with them."""
    moved = history.copy()
    moved[:, :, -1] += history[:, :, COUNT] * shared[:, None]
    return moved


def settle_slot(history: Array, slot: Array, level: Array, opened: np.ndarray) -> Array:
    """The history before another context takes the slot (N,) of the joints in `opened` (N,).

    Its replays so far keep `level` (N,), as it was known.
    """
    settled = history.copy()
    n = np.flatnonzero(opened)
    at = LEVELS_SUM + slot[n]
    settled[n, :, -1] -= history[n, :, at] * level[n, None]
    settled[n, :, at] = 0.0
    return settled


def _begin_block(history: Array) -> Array:
    """The history with a new youngest block; the two neighbours that are nearest for their age become one."""
    B = history.shape[1]
    count = history[:, :, COUNT]
    age = history[:, :, AGE] / np.maximum(count, 1.0)
    gap = (age[:, 1:] - age[:, :-1]) / (0.5 * (age[:, 1:] + age[:, :-1]) + RECENT_DAYS)
    gap = np.where(count[:, 1:] > 0, gap, -1.0)  # an empty block costs nothing
    at = np.argmin(gap, axis=1)  # (n,) its place and the next become one
    places = np.arange(B)
    source = np.where(places <= at[:, None] + 1, np.maximum(places - 1, 0), places)
    begun = np.take_along_axis(history, source[:, :, None], axis=1)
    n = np.arange(len(history))
    begun[n, at + 1] += history[n, at + 1]
    begun[:, 0] = 0.0
    return begun


def history_of_posterior(level: Array, wear: Array, rate: Array, *, sure: np.ndarray, slot: Array, slots: int, days: Array) -> Array:
    """The history of joints whose replays nobody kept, as a belief of an older release has them: along a straight line to their wear.

    level, wear, rate : (N,) means of the filter: log torque without wear, w [log], and the rate per usual day. sure : (N,) whether the rate
    is surely positive; otherwise wear came in one step half-way. days : (N,) since the first replay.
    """
    N = len(level)
    history = empty_history(N, slots)
    known = np.flatnonzero(days > 0)
    age = np.arange(SEEDED)[None, :] + 0.5
    rising = np.where(sure, np.expm1(wear) / np.maximum(rate, 1e-9), 0.5 * days)  # [d] since the onset
    rising = np.clip(rising, 1.0, np.maximum(0.9 * days, 1.0))
    rises, before = rising[:, None] / SEEDED * age, (days - rising)[:, None] / SEEDED * age + rising[:, None]
    ages = np.concatenate([rises, before], axis=1)  # (N, 2·SEEDED), youngest first
    straight = np.log1p(np.expm1(wear)[:, None] * (1.0 - rises / rising[:, None]))
    worn = np.concatenate([np.where(sure[:, None], straight, wear[:, None]), np.zeros((N, SEEDED))], axis=1)
    # as many replays as there were, about: a straight line is what the filter has found
    count = np.maximum(np.repeat(np.stack([rising, days - rising], axis=1), SEEDED, axis=1) / SEEDED, FULL)
    seeded = history[:, : 2 * SEEDED]
    seeded[..., COUNT] = count
    seeded[..., PRODUCTION_AGE] = seeded[..., AGE] = count * ages
    seeded[np.arange(N), :, LEVELS_SUM + slot] = count
    seeded[..., -1] = count * (level[:, None] + worn)
    begun = empty_history(N, slots)
    begun[known] = history[known]
    return begun
