"""The longest sequence of rows in which each row continues the motion of the row before it.

Between two rows a joint turns by the mean of its two speeds times the time between them. What is left of Δq then is noise, the curvature of
the motion, and the jitter of the clock, which acts on all joints at once in proportion to their speeds. Everything else is a torn row.
"""

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.recording import Array, Indices, Mask, Recording

MAX_SPEED_RAD_S = 20.0  # three times the fastest joint of any UR
NOISE_STD = 10.0  # standard deviations of |Δq − q̇·Δt|; on sound recordings of real arms 99.9 % are below 6
ROUNDING_RAD = 5e-4  # half of the last digit of a log with three decimals
STILL_RAD = 2e-3  # by which a joint that hardly moves may be shaken by the others
HARDLY_MOVING = 0.2  # fraction of the rows in which such a joint moves, at most
SPEED_LAG_S = 0.005  # by which a drive's speed may lag behind its position
JITTER = 0.5  # of a tick, by which a row's time may be off
SHARED_JOINTS = 3  # so many joints must move for the jitter of a clock to be told from a torn row
MOVING_RAD_S = 0.02  # slower joints say nothing of the clock
WINDOW_ROWS = 60  # over so many torn rows the motion before and after can still be joined
BREAK_ROWS = 20.0  # so many rows are left out rather than that the motion is cut in two
AT_ONCE = 500  # pieces of which each is compared with some sixty others: a few megabytes
EDGE_ROWS = 2  # at the end of a run that may belong to the torn rows beside it
HOLE_S = 0.25  # over a longer hole nothing is compared


class Chain(NamedTuple):
    """Rows that follow each other."""

    rows: Indices  # (n,) ascending
    breaks: Indices  # places in `rows` before which the motion jumps
    turns: Array  # (n, J) whole turns to be added to q [rad]


def longest_chain(t_s: Array, q: Array, qd: Array | None) -> Chain:
    """The longest chain of rows; a break counts as `BREAK_ROWS` rows. t_s : (N,) increasing. q, qd : (N, J)."""
    N = len(t_s)
    if N < 3:
        return Chain(np.arange(N), np.zeros(0, dtype=np.intp), np.zeros(q.shape))
    steps = _Steps(t_s, q, qd)
    joined = steps.joined_to_next()
    if joined.all():
        return _with_turns(steps, np.arange(N), np.zeros(0, dtype=np.intp))
    nodes = _nodes(joined)
    chosen = _best(steps, nodes)
    rows = np.concatenate([np.arange(nodes[k, 0], nodes[k, 1] + 1) for k in chosen])
    ends, starts = rows[:-1], rows[1:]
    return _with_turns(steps, rows, np.flatnonzero(~steps.joined(ends, starts)) + 1)


class _Steps:
    """Whether one row continues another, with the tolerance that the recording itself has."""

    def __init__(self, t_s: Array, q: Array, qd: Array | None) -> None:
        self._t, self._q, self._qd = t_s, q, qd
        dt = np.diff(t_s)
        self._tick = float(np.median(dt))
        if qd is None:
            speed = np.abs(_within_a_turn(np.diff(q, axis=0))) / dt[:, None]
            self._reach = np.minimum(MAX_SPEED_RAD_S, 3.0 * np.quantile(speed, 0.95, axis=0))  # (J,)
            return
        self._noise, self._acceleration, self._still = np.zeros((3, q.shape[1]))
        off, _ = self._next
        change = np.abs(np.diff(qd, axis=0)) / dt[:, None]
        for j in range(q.shape[1]):
            moving = np.abs(qd[1:, j]) > MOVING_RAD_S
            count = np.count_nonzero(moving)
            seen = off[moving, j] if count >= WINDOW_ROWS else off[:, j]
            self._noise[j] = 1.4826 * np.median(np.abs(seen))
            self._still[j] = STILL_RAD if count < HARDLY_MOVING * len(moving) else 0.0
            self._acceleration[j] = 2.0 * np.quantile(change[moving, j] if count else change[:, j], 0.8)

    def joined(self, before: Indices, after: Indices) -> Mask:
        """(n,) whether the rows `after` (n,) continue the rows `before` (n,)."""
        return self._judged(before, after, self._off(before, after)[0])

    def joined_to_next(self) -> Mask:
        """(N − 1,) whether the row after each row continues it."""
        rows = np.arange(len(self._t))
        return self._judged(rows[:-1], rows[1:], self._next[0])

    def _judged(self, before: Indices, after: Indices, off: Array) -> Mask:
        """`joined`, of rows that are `off` (n, J) [rad]."""
        dt = (self._t[after] - self._t[before])[:, None]
        near = dt[:, 0] <= max(HOLE_S, 3.0 * self._tick)
        if self._qd is None:
            joined: Mask = near & np.all(np.abs(off) <= 0.01 + self._reach * dt, axis=1)
            return joined
        limit = NOISE_STD * self._noise * np.sqrt(dt / self._tick) + ROUNDING_RAD + self._still
        limit = limit + self._acceleration * (dt**2 / 4.0 + SPEED_LAG_S * dt)
        joined = near & np.all(np.abs(off) <= limit, axis=1)
        doubtful = np.flatnonzero(near & ~joined)
        if len(doubtful):
            speed = 0.5 * (self._qd[before[doubtful]] + self._qd[after[doubtful]])
            jitter = np.clip(_shared(off[doubtful], speed), -JITTER * self._tick, JITTER * self._tick)
            joined[doubtful] = np.all(np.abs(off[doubtful] - jitter[:, None] * speed) <= limit[doubtful], axis=1)
        return joined

    def turns(self, before: Indices, after: Indices) -> Array:
        """(n, J) whole turns by which a position went on too far [rad]."""
        return self._next[1] if len(after) == len(self._t) - 1 else self._off(before, after)[1]

    def _off(self, before: Indices | slice, after: Indices | slice) -> tuple[Array, Array]:
        """(n, J) Δq − q̇·Δt without whole turns, and those turns [rad]."""
        off = self._q[after] - self._q[before]
        if self._qd is not None:
            off = off - 0.5 * (self._qd[after] + self._qd[before]) * (self._t[after] - self._t[before])[:, None]
        left = _within_a_turn(off)
        return left, off - left

    @cached_property
    def _next(self) -> tuple[Array, Array]:
        """`_off` of each row and the row after it."""
        return self._off(slice(None, -1), slice(1, None))


def _within_a_turn(x: Array) -> Array:
    """What remains of x without the nearest whole turns [rad]."""
    left: Array = x - 2.0 * math.pi * np.round(x / (2.0 * math.pi))
    return left


def _shared(off: Array, speed: Array) -> Array:
    """(n,) the time by which most of the motion is off [s]: the median of off/speed over the joints, by speed; 0 with few joints moving."""
    weight = np.abs(speed)
    moving = np.sum(weight > MOVING_RAD_S, axis=1) >= SHARED_JOINTS
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(weight > 0.0, off / np.where(weight > 0.0, speed, 1.0), 0.0)
    order = np.argsort(ratio, axis=1)
    heavy = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    middle = np.argmax(heavy >= 0.5 * heavy[:, -1:], axis=1)
    lasting = np.take_along_axis(ratio, np.take_along_axis(order, middle[:, None], axis=1), axis=1)[:, 0]
    return np.where(moving, lasting, 0.0)


def _nodes(joined: Mask) -> Indices:
    """(K, 2) first and last row of each piece: runs of joined rows, whose outermost rows are pieces of their own."""
    starts = np.concatenate([[0], np.flatnonzero(~joined) + 1])
    ends = np.append(starts[1:] - 1, len(joined))
    pieces = []
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        edge = min(EDGE_ROWS, (last - first) // 2)
        pieces += [(first + k, first + k) for k in range(edge)]
        pieces.append((first + edge, last - edge))
        pieces += [(last - k, last - k) for k in reversed(range(edge))]
    return np.array(pieces, dtype=np.intp)


def _best(steps: _Steps, nodes: Indices) -> list[int]:
    """The pieces of the longest chain, by dynamic programming."""
    first, last = nodes[:, 0], nodes[:, 1]
    length = (last - first + 1).astype(float)
    total, before = np.zeros(len(nodes)), np.full(len(nodes), -1)
    top, top_at = 0.0, -1  # the best chain so far
    for k, joined in enumerate(_joined_before(steps, nodes)):
        total[k], before[k] = (top - BREAK_ROWS, top_at) if top > BREAK_ROWS else (0.0, -1)
        near = joined[total[joined] > total[k]]
        if len(near):
            best = near[int(np.argmax(total[near]))]
            total[k], before[k] = total[best], best
        total[k] += length[k]
        if total[k] > top:
            top, top_at = total[k], k
    chain = []
    at = top_at
    while at >= 0:
        chain.append(at)
        at = int(before[at])
    return chain[::-1]


def _joined_before(steps: _Steps, nodes: Indices) -> Iterator[Indices]:
    """For each piece the pieces before it that it continues, within the window; many at once, since each call costs as much as many."""
    first, last = nodes[:, 0], nodes[:, 1]
    reach = np.searchsorted(last, first - WINDOW_ROWS)
    for begin in range(0, len(nodes), AT_ONCE):
        own = np.arange(begin, min(begin + AT_ONCE, len(nodes)))
        ends = np.cumsum(own - reach[own])
        after = np.repeat(own, own - reach[own])
        before = (after - (np.repeat(ends, own - reach[own]) - np.arange(len(after)))).astype(np.intp)
        follows = steps.joined(last[before], first[after])
        for begins, stops in pairwise([0, *ends.tolist()]):
            yield before[begins:stops][follows[begins:stops]]


def _with_turns(steps: _Steps, rows: Indices, breaks: Indices) -> Chain:
    turns = steps.turns(rows[:-1], rows[1:])
    turns[breaks - 1] = 0.0  # beyond a jump, a turn has no meaning
    whole = np.zeros((len(rows), turns.shape[1]))
    if np.any(turns):  # seldom
        np.cumsum(-turns, axis=0, out=whole[1:])
    return Chain(rows, breaks, whole)


# --- Which rows of a recording are sound, and why the others are left out -------------------------------

# a larger size of a signal is a torn row, unless the recording is of this size throughout
LIMITS: Mapping[str, float] = {
    "q": 1000.0,  # [rad] the last joint of some models turns without end, but not 160 turns in one direction
    "qd": MAX_SPEED_RAD_S,
    "qdd": 1000.0,  # [rad/s²] an emergency stop stays below 100
    "current": 200.0,  # [A] ten times what the drives can carry
    "torque": 5000.0,  # [N·m] ten times a UR's largest joint; arms for 300 kg have more
}
OF_DRIVES = ("current", "torque")
OWN_SIZE = 10.0  # times the 90 % quantile of a current or torque: no motion of a sound recording has more
HELD_SPEED_RAD_S = 0.02  # of a joint that cannot stay where it is from one row to the next
MOSTLY_HELD = 0.4  # of the rows of the motion: a log at twice the rate of its signals repeats half of them
HARMLESS = ("doubled", "held")  # reasons for which nothing is lost that was measured


class SoundRows(NamedTuple):
    """The rows that are used."""

    keep: Indices  # (N,) of the recording
    why: Mapping[str, int]  # number of rows left out, by reason
    breaks: Indices  # places in `keep` before which the motion is not that of the row before
    turns: Array  # (N, J) whole turns to be added to q [rad], where positions were wrapped into one turn


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
    in_order = _longest_increasing(recording.t_s[keep])
    why["time_not_increasing"] = len(keep) - len(in_order)
    keep = keep[in_order]
    held = _held(rows, keep)
    why["held"] = int(np.sum(held))
    keep = keep[~held]
    qd = None if recording.qd is None else recording.qd[keep]
    chain = longest_chain(recording.t_s[keep], recording.q[keep], qd)
    why["position_jump"] = len(keep) - len(chain.rows)
    return SoundRows(keep[chain.rows], {reason: count for reason, count in why.items() if count}, chain.breaks, chain.turns)


def _limit(key: str, values: Array) -> Array | float:
    """The largest plausible size of a signal (N, J): that of `LIMITS`, of a drive more where the whole recording is larger."""
    if key not in OF_DRIVES:
        return LIMITS[key]
    limit: Array = np.maximum(LIMITS[key], OWN_SIZE * usual_size(values))
    return limit


def usual_size(values: Array) -> Array:
    """(J,) the 90 % quantile of the size of each column (N, J); 0 where no reading is finite."""
    columns = (column[np.isfinite(column)] for column in values.T)
    return np.array([np.quantile(np.abs(column), 0.9) if len(column) else 0.0 for column in columns])


def _doubled(rows: Mapping[str, Array], keep: Indices) -> Mask:
    """(N,) rows that repeat the row before them number for number, time included: written twice, and measured once."""
    return _repeats([rows["t_s"], *rows.values()], keep)


def _held(rows: Mapping[str, Array], keep: Indices) -> Mask:
    """(N,) rows that repeat the signals of the row before them at a later time, although the arm moved on: a tick was missed.

    Where most rows of the motion do so, the log is quicker than the signals, and those at rest that repeat are no readings either.
    """
    held: Mask = np.zeros(len(keep), dtype=bool)
    if len(keep) and "qd" in rows:
        again = _repeats([value for key, value in rows.items() if key != "t_s"], keep)
        moving = np.any(np.abs(rows["qd"][keep]) > HELD_SPEED_RAD_S, axis=1)
        held = again if np.count_nonzero(again & moving) > MOSTLY_HELD * np.count_nonzero(moving) else again & moving
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
        k = bisect_left(values, value) if values and value <= values[-1] else len(values)
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
