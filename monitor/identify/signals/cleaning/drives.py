"""Currents and torques that are no measurement: stuck, cut off, held, or in another unit."""

from collections.abc import Iterator

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.cleaning.clean import Repair
from monitor.identify.signals.cleaning.rows import taken, usual_size
from monitor.identify.signals.order import median
from monitor.recording import Array, Indices, Mask, Recording

MOVING_RAD_S = 0.02  # at rest, a current may keep its value
STUCK_S = 0.2  # a drive's noise changes the current in every tick; of real arms two readings in a row are equal, never three
STUCK_ROWS = 8
STUCK_SHARE = 0.01  # fraction of the moving rows
HELD_S = 0.02  # mean time between changes: half of it is a delay
PILE_ROWS = 8  # so many readings at the very largest value …
PILE = 2.0  # … and so many times as many as within a fiftieth of the range below it: cut off there
NEAR = 0.02
MOST_A = 200.0  # ten times what the drives of a UR can carry, five times those of arms for 300 kg


def refuse_other_unit(recording: Recording) -> None:
    """Raises Unidentifiable where currents are of a size that no drive of an arm has, throughout."""
    if recording.current is None or recording.torque is not None:
        return
    if np.max(np.abs(recording.current), initial=0.0) <= MOST_A:
        return
    largest = np.max(usual_size(recording.current), initial=0.0)
    if largest > MOST_A:
        raise Unidentifiable(
            f"{recording.source or 'recording'}: currents of {largest:.4g} are no amperes: "
            f"expected [A]; if they are in mA, divide them by 1000"
        )


def check_drives(recording: Recording, rows: Indices) -> Iterator[Repair]:
    """The joints whose current or torque is no measurement in a part of these rows (N,), or in all."""
    drive = recording.current if recording.current is not None else recording.torque
    if drive is None or len(rows) < STUCK_ROWS:
        return
    what = "current" if recording.current is not None else "torque"
    t_s, value = taken(recording.t_s, rows), taken(drive, rows)
    tick = median(np.diff(t_s))
    speed = taken(recording.qd, rows) if recording.qd is not None else np.gradient(recording.q[rows], t_s, axis=0)
    for j in range(value.shape[1]):
        moving = np.abs(speed[:, j]) > MOVING_RAD_S
        count = np.count_nonzero(moving)
        if not count:
            continue
        x, name = value[:, j], f"the {what} of joint {j + 1}"
        lengths, at = _runs(x, moving)
        long = lengths >= max(STUCK_ROWS, STUCK_S / tick)
        share = float(np.sum(lengths[long]) / count)
        if count >= STUCK_ROWS and np.all((stuck_at := x[moving]) == stuck_at[0]):
            yield Repair("current_stuck", f"{name} stays at {stuck_at[0]:.4g} in all samples with motion: it was not measured there")
        elif np.sum(lengths) > 0.5 * count and _mean_run(lengths) * tick > HELD_S:
            yield Repair(
                "current_held",
                f"{name} changes every {1e3 * _mean_run(lengths) * tick:.0f} ms only (held or rounded): it comes late by half of that",
            )
        elif (cut := _cut_off(x)) is not None:
            yield Repair("current_saturated", f"{name} is cut off at {cut:.4g}: what was beyond is missing, and friction with it")
        elif share > STUCK_SHARE:
            stuck = x[at[long][int(np.argmax(lengths[long]))]]
            yield Repair(
                "current_stuck", f"{name} stays at {stuck:.4g} in {share:.0%} of the samples with motion: it was not measured there"
            )


def _runs(x: Array, moving: Mask) -> tuple[Array, Indices]:
    """Length and first row of each run of two or more equal readings in moving rows."""
    equal = np.concatenate([[False], (x[1:] == x[:-1]) & moving[1:], [False]])
    edges = np.flatnonzero(equal[1:] != equal[:-1])
    return (edges[1::2] - edges[::2] + 1).astype(float), edges[::2]


def _mean_run(lengths: Array) -> float:
    return float(np.mean(lengths)) if len(lengths) else 0.0


def _cut_off(x: Array) -> float | None:
    """The largest or smallest value where many readings pile up on it; None where neither has a pile."""
    width = NEAR * float(np.ptp(x))
    for end in (float(np.max(x)), float(np.min(x))):
        pile = np.count_nonzero(x == end)
        if pile >= PILE_ROWS and pile > PILE * np.count_nonzero((np.abs(x - end) <= width) & (x != end)):
            return end
    return None
