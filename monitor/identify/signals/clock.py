"""Clocks of whole recordings that can be put right: one that was set while it ran, one that was written too coarsely, one of arrivals."""

import math
from typing import NamedTuple

import numpy as np

from monitor.recording import Array, Indices, Mask

RETURN_ROWS = 20  # a torn time is right again in the next row; a clock that is wrong for so many rows was set
FAR_S = 60.0  # a larger leap ahead is no hole in a recording of a replay
HOLE_S = 1.0  # the hole that stands for an unknown time between two rows: longer than any gap that a spline bridges

COARSE = 0.35  # of a tick: a finer resolution does no harm
SHARE_EQUAL = 0.02  # of the rows repeat the time before them; with less it is not the clock
EXPLAINED = 1.05  # of the resolution: the even clock stays this near to the written times
FEWEST_ROWS = 50  # of an unbroken stretch
MEAN_ROWS = 25  # over which the times of an uneven clock are averaged: short beside what changes a clock, long beside its rounding
HOLE_STEPS = 2.5  # ticks and resolutions together; a longer step is a hole, at which the even clock begins anew

SHORT = 0.5  # of the mean time between rows: a row that comes sooner did not wait for its tick
SHARE_SHORT = 0.1  # of the rows come so soon; with less it is the jitter of a host, which a spline bridges
SMOOTHER = 0.7  # of the roughness of the motion remains on an even clock, where the rows were measured on one
BURSTS = 5.0  # over so many bursts, at least, the times of an uneven clock are averaged


class Clock(NamedTuple):
    """Times of the rows on a clock that was put right."""

    t_s: Array  # (N,)
    step: float  # in which times were written, or between two bursts of rows, in the unit of the file
    rows: float | None = None  # that came at once, in the mean; None: a coarse clock


def running_on(t_s: Array) -> tuple[Array, int]:
    """The clock (N,) with a hole in the place of every lasting leap, back or far ahead; and the number of leaps."""
    finite = np.flatnonzero(np.isfinite(t_s))
    if len(finite) < 2 * RETURN_ROWS:
        return t_s, 0
    t = t_s[finite]
    step = np.diff(t)
    tick = np.median(step[step > 0.0]) if np.any(step > 0.0) else 0.0
    leap, jumps = np.zeros(len(t)), 0
    limit = max(FAR_S, 100.0 * tick)
    for i in np.flatnonzero((step < 0.0) | (step > limit)):
        before, after = t[max(0, i + 1 - RETURN_ROWS) : i + 1], t[i + 1 : i + 1 + RETURN_ROWS]
        if len(after) < RETURN_ROWS or len(before) < RETURN_ROWS:
            continue
        # a torn time is a single row; where the clock was set, all rows before and all rows after are apart from each other
        back = np.median(after) < np.min(before[-3:]) and np.max(after) < t[i] + limit and np.min(after) > t[i + 1] - limit
        ahead = np.min(after) > np.max(before) + limit
        if (step[i] < 0.0 and back and np.max(after) < np.max(before)) or (step[i] > limit and ahead):
            leap[i + 1] = t[i] + HOLE_S - t[i + 1]
            jumps += 1
    if not jumps:
        return t_s, 0
    even = t_s.copy()
    even[finite] = t + np.cumsum(leap)
    return even, jumps


def restored_clock(t_s: Array, q: Array) -> Clock | None:
    """The times (N,) on an even clock; None where the clock is neither coarse nor of arrivals, or no even clock explains it.

    A coarse clock gives many rows one time. A clock of arrivals tells when a host received rows, several at once after a pause, which the
    controller had measured evenly. Rows without a finite time keep it. Rows that repeat the positions too were written twice and are no
    evidence.
    """
    finite = np.flatnonzero(np.isfinite(t_s))
    if len(finite) < FEWEST_ROWS:
        return None
    t, x = t_s[finite], q[finite]
    moved = np.any(x[1:] != x[:-1], axis=1)
    found = _coarse(t, moved) or _of_arrivals(t, x, moved)
    if found is None:
        return None
    restored = t_s.copy()
    restored[finite] = found.t_s
    return found._replace(t_s=restored)


def _coarse(t: Array, moved: Mask) -> Clock | None:
    """The even clock of times that are written in steps coarser than the ticks."""
    step = np.diff(t)
    if np.mean((step == 0.0) & moved) < SHARE_EQUAL or not np.any(step > 0.0):
        return None
    resolution = float(np.quantile(step[step > 0.0], 0.05))
    rounding = 1e-3 + 1e-15 * float(np.max(np.abs(t))) / resolution
    whole = np.abs(step / resolution - np.round(step / resolution)) < rounding
    if np.mean(whole) < 0.99:
        return None
    tick = _tick(t, step, resolution)
    if not tick > 0.0 or resolution < COARSE * tick:
        return None
    new = _on_even(t, step, tick, resolution)
    return None if new is None else Clock(new, resolution)


def _of_arrivals(t: Array, q: Array, moved: Mask) -> Clock | None:
    """The even clock of rows that came in bursts, where the motion is smoother on it than at the times of arrival."""
    step = np.diff(t)
    ahead = np.sort(step[step > 0.0])
    if not len(ahead):
        return None
    pause = float(ahead[np.searchsorted(np.cumsum(ahead), 0.5 * np.sum(ahead))])  # the step in which half of the time has passed
    tick = float(np.mean(step[(step >= 0.0) & (step <= HOLE_STEPS * pause)]))
    if np.mean((step >= 0.0) & (step < SHORT * tick) & moved) < SHARE_SHORT:
        return None
    new, rows = _on_even(t, step, tick, pause), math.ceil(pause / tick)
    if new is None or 4 * rows > len(t) or not _roughness(new, q, rows) < SMOOTHER * _roughness(t, q, rows):
        return None
    return Clock(new, pause, max(pause / tick, 1.0))


def _roughness(t: Array, q: Array, rows: int) -> float:
    """By how much each change of the positions (N, J) is off the mean speed of so many rows around it: the median, beside the changes."""
    change = np.diff(q, axis=0)[rows : len(t) - 1 - rows]
    first, last = slice(None, len(change)), slice(2 * rows + 1, None)
    off = np.abs(change - (q[last] - q[first]) / (t[last] - t[first])[:, None] * np.diff(t)[rows : len(t) - 1 - rows, None])
    usual = np.median(np.abs(change), axis=0)
    moving = usual > 0.0
    return float(np.sum(np.median(off[:, moving], axis=0) / usual[moving]))


def _on_even(t: Array, step: Array, tick: float, resolution: float) -> Array | None:
    """The times on an even clock, stretch by stretch; None where one has none within the resolution."""
    new = t.copy()
    for part in _stretches(step, tick, resolution, new):
        even = _even(t[part], tick, resolution)
        if even is None:
            return None
        new[part] = even
    return None if np.any(np.diff(new) <= 0.0) and np.all(step >= 0.0) else new


def _tick(t: Array, step: Array, resolution: float) -> float:
    """The mean time between rows of unbroken stretches [s]."""
    usual: Mask = (step >= 0.0) & (step <= 2.0 * max(resolution, float(np.median(step))) + 1e-9)
    return float(np.mean(step[usual])) if usual.any() and len(t) > 1 else math.nan


def _stretches(step: Array, tick: float, resolution: float, t: Array) -> list[Indices]:
    holes = np.flatnonzero((step > HOLE_STEPS * max(tick, resolution)) | (step < 0.0)) + 1
    return [part for part in np.split(np.arange(len(t)), holes) if len(part)]


def _even(t: Array, tick: float, resolution: float) -> Array | None:
    """A clock that, rounded to the resolution, gives the times t: an even one, or one whose ticks change slowly; None where there is none.

    Whether the writer rounded or cut off is unknown and of no importance: all signals move by the same fraction of a tick.
    """
    rows = np.arange(float(len(t)))
    if len(t) < FEWEST_ROWS:
        return np.asarray(float(np.mean(t - tick * rows)) + tick * rows)
    slope, start = np.polyfit(rows, t - t[0], 1)
    off = t - t[0] - (start + slope * rows)
    even: Array = t[0] + start + slope * rows
    if float(np.ptp(off)) <= EXPLAINED * resolution:
        return even
    from scipy.ndimage import uniform_filter1d

    rows_averaged = max(MEAN_ROWS, round(BURSTS * resolution / tick))
    slow = np.asarray(uniform_filter1d(off, min(rows_averaged, len(t)), mode="reflect"))
    return even + slow if float(np.max(np.abs(off - slow))) <= EXPLAINED * resolution and np.min(np.diff(slow)) > -slope else None
