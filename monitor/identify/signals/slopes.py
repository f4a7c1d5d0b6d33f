"""The change of positions over windows of time, beside the median of the recorded speed in each window.

Over a window, ripple and noise average out, and a torn row has no influence on the median.
"""

import math
from typing import NamedTuple

import numpy as np

from monitor.identify.signals.order import median, window_medians, window_starts
from monitor.recording import Array

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
