"""The course of friction so far, compressed: sums over blocks of replays, from which the path of wear can be fitted at any time. Pure.

The filters have forgotten how friction came to where it is: whether its rate rises or falls. A block keeps the sums of log friction and of
the rows of the law, so that what was observed can be corrected with the law and the levels of today. Blocks are narrow where they are young
and wide where they are old: their width is about a constant share of (age + `RECENT_DAYS`).

Shapes: N channels, B = BLOCKS blocks of each, youngest first, K sums of each: `COUNT` … `DAYS`, one for each of `law_states`, and y.
"""

import numpy as np

from monitor.judge.friction.states import LEVEL, SETTLING, SLOPE
from monitor.recording import Array

BLOCKS = 48  # B: with 1000 days of history a block is 6 % of (age + 60 days) wide: 4 days now, 33 days half-way back
COUNT, USE, DAYS, LAW_SUM = range(4)  # the first sums of a block: replays, their use and their days since the channel began
RECENT_DAYS = 60.0  # [d] a younger past is kept about evenly
LEVEL_AT = SETTLING + 1 - SLOPE  # of `law_states`: the first level
FULL = 4.0  # [replays] of the youngest block, after which a new one begins: correlated noise leaves nothing finer to see


def law_states(levels: int) -> np.ndarray:
    """(K − 4,) states of which a block keeps the rows: what temperature, warming and running-in do, then the levels."""
    return np.array([*range(SLOPE, SETTLING + 1), *range(LEVEL, LEVEL + levels)])


def empty_course(channels: int, levels: int | None) -> Array:
    """(N, B, K) without any replay. levels : of contexts; None: nothing will be kept."""
    return np.zeros((channels, 0 if levels is None else BLOCKS, LAW_SUM + len(law_states(levels or 0)) + 1))


def remember(course: Array, y: Array, H: Array, days: Array, use: Array, shown: np.ndarray) -> None:
    """A replay of the channels `shown` (N,), in place. y : (N,) log friction; H : (D, N) rows of the states; days, use : (N,) so far."""
    if not course.shape[1]:
        return
    full = np.flatnonzero(shown & (course[:, 0, COUNT] >= FULL))
    if full.size:
        course[full] = _begin_block(course[full], days[full])
    course[:, 0, COUNT] += shown
    course[:, 0, USE] += use * shown
    course[:, 0, DAYS] += days * shown
    course[:, 0, LAW_SUM:-1] += (H[law_states(len(H) - LEVEL)] * shown).T
    course[:, 0, -1] += np.where(shown, y, 0.0)


def rescale_course(course: Array, use: Array, factor: Array) -> Array:
    """The course after a usual day became `factor` (N,) times as much use: the same use took fewer usual days. use : (N,) so far."""
    rescaled = course.copy()
    counted = course[:, :, COUNT] * use[:, None]
    rescaled[:, :, USE] = counted - (counted - course[:, :, USE]) / factor[:, None]
    return rescaled


def forget_course(course: Array, n: np.ndarray) -> Array:
    """The course of the channels n begins anew."""
    forgotten = course.copy()
    forgotten[n] = 0.0
    return forgotten


def move_course(course: Array, shared: Array) -> Array:
    """The course before levels move by `shared` (N,) without wear: its replays move with them."""
    moved = course.copy()
    moved[:, :, -1] += course[:, :, COUNT] * shared[:, None]
    return moved


def settle_level(course: Array, n: np.ndarray, slot: np.ndarray, level: Array) -> Array:
    """The course before another context takes a slot: replays of the channels n so far keep its level, as it was known. (M,) each."""
    settled = course.copy()
    at = LAW_SUM + LEVEL_AT + slot
    settled[n, :, -1] -= course[n, :, at] * level[:, None]
    settled[n, :, at] = 0.0
    return settled


def _begin_block(course: Array, days: Array) -> Array:
    """The course with a new youngest block; the two neighbours that are nearest for their age become one."""
    count = course[:, :, COUNT]
    age = days[:, None] - course[:, :, DAYS] / np.maximum(count, 1.0)
    gap = (age[:, 1:] - age[:, :-1]) / (0.5 * (age[:, 1:] + age[:, :-1]) + RECENT_DAYS)
    gap = np.where(count[:, 1:] > 0, gap, -1.0)  # an empty block costs nothing
    at = np.argmin(gap, axis=1)  # (n,) its place and the next become one
    places, n = np.arange(course.shape[1]), np.arange(len(course))
    source = np.where(places <= at[:, None] + 1, np.maximum(places - 1, 0), places)
    begun = np.take_along_axis(course, source[:, :, None], axis=1)
    begun[n, at + 1] += course[n, at + 1]
    begun[:, 0] = 0.0
    return begun
