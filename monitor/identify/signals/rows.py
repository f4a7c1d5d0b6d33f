"""Which rows of a recording are sound, and why the others are left out."""

from collections.abc import Mapping

import numpy as np

from monitor.recording import Array, Indices, Mask, Recording

MAX_SPEED_RAD_S = 20.0  # three times the fastest joint of any UR
# a larger size of a signal is a torn row
LIMITS: Mapping[str, float] = {
    "q": 1000.0,  # [rad] the last joint of some models turns without end, but not 160 turns in one direction
    "qd": MAX_SPEED_RAD_S,
    "qdd": 1000.0,  # [rad/s²] an emergency stop stays below 100
    "current": 200.0,  # [A] ten times what the drives can carry
    "torque": 5000.0,  # [N·m] ten times the largest joint's
}


def sound_rows(recording: Recording) -> tuple[Indices, dict[str, int]]:
    """Indices of the sound rows, and the number of the other rows by reason.

    A row is sound where time and all signals of `LIMITS` are finite and within their limits, the clock increases, and the position is
    one that the joint can reach from the rows around it. Other columns do not count.
    """
    read = {"t_s": recording.t_s} | {key: getattr(recording, key) for key in LIMITS}
    rows = {key: value.reshape(len(value), -1) for key, value in read.items() if value is not None}
    finite = np.all([np.isfinite(value).all(axis=1) for value in rows.values()], axis=0)
    with np.errstate(invalid="ignore"):
        plausible = np.all([(np.abs(rows[key]) <= limit).all(axis=1) for key, limit in LIMITS.items() if key in rows], axis=0)
    why = {"not_finite": int(np.sum(~finite)), "absurd_value": int(np.sum(finite & ~plausible))}
    keep = np.flatnonzero(finite & plausible)
    in_order = _longest_increasing(recording.t_s[keep])
    why["time_not_increasing"] = len(keep) - len(in_order)
    keep = keep[in_order]
    steady = ~_jumps(recording.t_s[keep], recording.q[keep])
    why["position_jump"] = int(np.sum(~steady))
    return keep[steady], {reason: count for reason, count in why.items() if count}


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


def _jumps(t_s: Array, q: Array) -> Mask:
    """(N,) rows whose position the joint cannot reach from either neighbour, while it can pass between the neighbours."""
    jump = np.zeros(len(q), dtype=bool)
    if len(q) < 3:
        return jump
    dt = np.diff(t_s)[:, None]
    reach = 0.01 + MAX_SPEED_RAD_S * dt  # 0.01 rad: encoder and rounding
    far = np.abs(np.diff(q, axis=0)) > reach
    close = np.abs(q[2:] - q[:-2]) <= reach[1:] + reach[:-1]
    jump[1:-1] = np.any(far[:-1] & far[1:] & close, axis=1)
    jump[0], jump[-1] = np.any(far[0] & ~far[1]), np.any(far[-1] & ~far[-2])
    return jump
