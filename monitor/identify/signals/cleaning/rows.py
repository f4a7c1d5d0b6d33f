"""Which rows of a recording are sound, and why the others are left out.

A recording says its motion twice, by positions and by speeds. A row that was torn contradicts the rows beside it in one of them, however
plausible its numbers are: |Δq − q̇·Δt| of a sound row is a fraction of a millirad.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.signals.cleaning.chain import MAX_SPEED_RAD_S, longest_chain
from monitor.identify.signals.order import quantile
from monitor.recording import Array, Indices, Mask, Recording

# a larger size of a signal is a torn row, unless the recording is of this size throughout
LIMITS: Mapping[str, float] = {
    "q": 1000.0,  # [rad] the last joint of some models turns without end, but not 160 turns in one direction
    "qd": MAX_SPEED_RAD_S,
    "qdd": 1000.0,  # [rad/s²] an emergency stop stays below 100
    "current": 200.0,  # [A] ten times what the drives can carry
    "torque": 5000.0,  # [N·m] ten times a UR's largest joint; arms for 300 kg have more
}
OWN_SIZE = 10.0  # times the 90 % quantile of a torque: no motion of a sound recording has more
HELD_SPEED_RAD_S = 0.02  # of a joint that cannot stay where it is from one row to the next
HARMLESS = ("doubled", "held")  # reasons for which nothing is lost that was measured


class SoundRows(NamedTuple):
    """The rows that are used."""

    keep: Indices  # (N,) of the recording
    why: Mapping[str, int]  # number of rows left out, by reason
    breaks: Indices  # places in `keep` before which the motion is not that of the row before
    turns: Array  # (N, J) whole turns to be added to q [rad], where positions were wrapped into one turn


def along_samples(recording: Recording) -> Recording:
    """The recording with memory that runs along the samples: the checks go joint by joint, ten times as fast as across the joints."""
    return recording.changed(("q", "qd", "qdd", "current", "torque", "temperature_c"), np.asfortranarray)


def taken(x: Array, rows: Indices) -> Array:
    """The rows of x (N, …) at these ascending places; x itself where they are all, which is the usual case."""
    return x if len(rows) == len(x) else x[rows]


def sound_rows(recording: Recording) -> SoundRows:
    """The sound rows, and the number of the other rows by reason.

    A row is sound where time and all signals of `LIMITS` are finite and within their limits, the clock increases, and its positions and
    speeds continue those of the rows around it. Other columns do not count.
    """
    read = {"t_s": recording.t_s} | {key: getattr(recording, key) for key in LIMITS}
    rows = {key: value.reshape(len(value), -1) for key, value in read.items() if value is not None}
    finite = np.all([np.isfinite(value).all(axis=1) for value in rows.values()], axis=0)
    with np.errstate(invalid="ignore"):
        plausible = np.all([(np.abs(rows[key]) <= _limit(key, rows[key])).all(axis=1) for key in LIMITS if key in rows], axis=0)
    why = {"not_finite": int(np.sum(~finite)), "absurd_value": int(np.sum(finite & ~plausible))}
    keep = np.flatnonzero(finite & plausible)
    again = _doubled(rows, keep)
    why["doubled"] = int(np.sum(again))
    keep = keep[~again]
    in_order = _longest_increasing(taken(recording.t_s, keep))
    why["time_not_increasing"] = len(keep) - len(in_order)
    keep = keep[in_order]
    held = _held(rows, keep)
    why["held"] = int(np.sum(held))
    keep = keep[~held]
    qd = None if recording.qd is None else taken(recording.qd, keep)
    chain = longest_chain(taken(recording.t_s, keep), taken(recording.q, keep), qd)
    why["position_jump"] = len(keep) - len(chain.rows)
    return SoundRows(keep[chain.rows], {reason: count for reason, count in why.items() if count}, chain.breaks, chain.turns)


def _limit(key: str, values: Array) -> Array | float:
    """The largest plausible size of a signal (N, J): that of `LIMITS`, and for torque more where the whole recording is larger."""
    if key != "torque":
        return LIMITS[key]
    limit: Array = np.maximum(LIMITS[key], OWN_SIZE * usual_size(values))
    return limit


def usual_size(values: Array) -> Array:
    """(J,) the 90 % quantile of the size of each column (N, J); 0 where no reading is finite."""
    columns = (column[np.isfinite(column)] for column in values.T)
    return np.array([quantile(np.abs(column), 0.9) if len(column) else 0.0 for column in columns])


def _doubled(rows: Mapping[str, Array], keep: Indices) -> Mask:
    """(N,) rows that repeat the row before them number for number, time included: written twice, and measured once."""
    return _repeats([rows["t_s"], *rows.values()], keep)


def _held(rows: Mapping[str, Array], keep: Indices) -> Mask:
    """(N,) rows that repeat the signals of the row before them at a later time, although the arm moved on: a tick was missed."""
    held = np.zeros(len(keep), dtype=bool)
    if len(keep) and "qd" in rows:
        again = np.flatnonzero(_repeats([value for key, value in rows.items() if key != "t_s"], keep))
        held[again] = np.any(np.abs(rows["qd"][keep[again]]) > HELD_SPEED_RAD_S, axis=1)
    return held


def _repeats(signals: Sequence[Array], keep: Indices) -> Mask:
    """(N,) rows that repeat the row before them in all signals; few do so in the first column of the first, and only these are compared."""
    repeats = np.zeros(len(keep), dtype=bool)
    first = signals[0][keep, 0]
    again = np.flatnonzero(first[1:] == first[:-1]) + 1
    repeats[again] = np.all([np.all(value[keep[again]] == value[keep[again - 1]], axis=1) for value in signals], axis=0)
    return repeats


def _longest_increasing(t_s: Array) -> Indices:
    """Indices of the longest strictly increasing subsequence: one torn time, too early or too late, costs one row."""
    if np.all(np.diff(t_s) > 0):
        return np.arange(len(t_s))
    ends: list[int] = []  # ends[k]: index of the smallest time that ends an increasing run of k + 1
    values: list[float] = []
    before = np.full(len(t_s), -1)
    for i, value in enumerate(t_s.tolist()):
        k = int(np.searchsorted(values, value)) if values and value <= values[-1] else len(values)
        before[i] = ends[k - 1] if k else -1
        if k == len(values):
            values.append(value)
            ends.append(i)
        else:
            values[k] = value
            ends[k] = i
    chain = []
    i = ends[-1]
    while i >= 0:
        chain.append(i)
        i = int(before[i])
    return np.array(chain[::-1])
