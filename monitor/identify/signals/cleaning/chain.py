"""The longest sequence of rows in which each row continues the motion of the row before it.

Between two rows a joint turns by the mean of its two speeds times the time between them. What is left of Δq then is noise, the curvature of
the motion, and the jitter of the clock, which acts on all joints at once in proportion to their speeds. Everything else is a torn row.
"""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from monitor.identify.signals.order import median, quantile, quantiles
from monitor.recording import Array, Indices, Mask

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
        self._tick = median(dt)
        if qd is None:
            speed = np.abs(_within_a_turn(np.diff(q, axis=0))) / dt[:, None]
            self._reach = np.minimum(MAX_SPEED_RAD_S, 3.0 * quantiles(speed, 0.95))  # (J,)
            return
        self._noise, self._acceleration, self._still = np.zeros((3, q.shape[1]))
        off, _ = self._next
        change = np.abs(np.diff(qd, axis=0)) / dt[:, None]
        for j in range(q.shape[1]):
            moving = np.abs(qd[1:, j]) > MOVING_RAD_S
            count = np.count_nonzero(moving)
            seen = off[moving, j] if count >= WINDOW_ROWS else off[:, j]
            self._noise[j] = 1.4826 * median(np.abs(seen))
            self._still[j] = STILL_RAD if count < HARDLY_MOVING * len(moving) else 0.0
            self._acceleration[j] = 2.0 * quantile(change[moving, j] if count else change[:, j], 0.8)

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
    median = np.take_along_axis(ratio, np.take_along_axis(order, middle[:, None], axis=1), axis=1)[:, 0]
    return np.where(moving, median, 0.0)


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
    reach = np.searchsorted(last, first - WINDOW_ROWS)
    for k in range(len(nodes)):
        total[k], before[k] = (top - BREAK_ROWS, top_at) if top > BREAK_ROWS else (0.0, -1)
        near = np.arange(reach[k], k)
        near = near[total[near] > total[k]]
        if len(near):
            near = near[steps.joined(last[near], np.full(len(near), first[k]))]
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


def _with_turns(steps: _Steps, rows: Indices, breaks: Indices) -> Chain:
    turns = steps.turns(rows[:-1], rows[1:])
    turns[breaks - 1] = 0.0  # beyond a jump, a turn has no meaning
    whole = np.zeros((len(rows), turns.shape[1]))
    if np.any(turns):  # seldom
        np.cumsum(-turns, axis=0, out=whole[1:])
    return Chain(rows, breaks, whole)
