"""Medians and quantiles of a few hundred numbers: what numpy's give, number for number, in a tenth of their time."""

import math
from typing import NamedTuple

import numpy as np

from monitor.recording import Array, Indices

NAN = np.float64(math.nan)  # numpy's: a division by it raises nothing
SHORT = 512  # numbers: up to so many, sorting all is faster than parting them at two places


def median(x: Array) -> float:
    """The median of x (n,); NaN where x is empty or holds NaN."""
    n = len(x)
    if not n:
        return NAN
    ordered = _ordered(x, (n - 1) // 2, n // 2)
    found: float = (ordered[(n - 1) // 2] + ordered[n // 2]) / 2.0
    return NAN if ordered[-1] != ordered[-1] else found


def medians(x: Array) -> Array:
    """(…) medians along the last axis of x (…, n), n > 0; NaN where a row holds NaN."""
    n = x.shape[-1]
    ordered = _ordered(x, (n - 1) // 2, n // 2)
    middle: Array = (ordered[..., (n - 1) // 2] + ordered[..., n // 2]) / 2.0
    return np.where(np.isnan(ordered[..., -1]), np.nan, middle)


def quantile(x: Array, share: float) -> float:
    """The quantile of x (n,), with linear interpolation; NaN where x is empty or holds NaN."""
    n = len(x)
    if not n:
        return NAN
    place = share * (n - 1)
    low = math.floor(place)
    high, part = min(low + 1, n - 1), place - low
    ordered = _ordered(x, low, high)
    a, b = ordered[low], ordered[high]
    found: float = b - (b - a) * (1.0 - part) if part >= 0.5 else a + (b - a) * part
    return NAN if ordered[-1] != ordered[-1] else found


def _ordered(x: Array, low: int, high: int) -> Array:
    """The numbers of x (…, n), of which two places and the last one hold what sorting the last axis puts there. NaN stands last."""
    n = x.shape[-1]
    return np.sort(x, axis=-1) if n <= SHORT else np.partition(x, sorted({low, high, n - 1}), axis=-1)


def quantiles(x: Array, share: float) -> Array:
    """(J,) `quantile` of each column of x (N, J)."""
    return np.array([quantile(np.ascontiguousarray(column), share) for column in x.T])


def window_starts(rows: int, length: int) -> Indices:
    """(W,) first rows of the windows of `length` + 1 rows, each of which begins half a window after the one before it."""
    return np.arange(0, rows - length, max(1, length // 2))


def window_medians(x: Array, length: int) -> Array:
    """(W, J) medians of x (N, J) over the windows of `window_starts`; W is 0 where x is shorter than a window."""
    if len(x) <= length:
        return np.empty((0, x.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(x, length + 1, axis=0)  # (N − length, J, length + 1)
    return medians(windows[:: max(1, length // 2)])


# --- The change of positions over windows of time, beside the median of the recorded speed in each window ---

WINDOW_S = 0.13  # time over which a difference is taken: short beside the motion, long beside ripple
WINDOW_ROWS = 16  # from the first row of such a window to its last one, at most
FEWEST_ROWS = 10  # fewer have no windows


class Slopes(NamedTuple):
    """W windows of J signals."""

    tick: float  # time between two rows
    length: int  # rows from the first of a window to its last
    dt: Array  # (W,) time from the first row to the last
    slope: Array  # (W, J) change of the signal a second
    speed: Array  # (W, J) median of its recorded rate


def slopes(t_s: Array, x: Array, rate: Array | None) -> Slopes | None:
    """The windows of x (N, J), whose recorded rate is (N, J), at times (N,); None without a rate, or with few rows."""
    if rate is None or len(t_s) < FEWEST_ROWS:
        return None
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        step = np.diff(t_s)
        tick = median(step[step > 0.0]) if np.any(step > 0.0) else math.inf
        length = int(np.clip(WINDOW_S / tick, 2, WINDOW_ROWS))
        first = window_starts(len(t_s), length)
        dt = t_s[first + length] - t_s[first]
        return Slopes(tick, length, dt, (x[first + length] - x[first]) / dt[:, None], window_medians(rate, length))
