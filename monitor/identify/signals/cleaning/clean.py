"""Errors of a whole recording that can be corrected: wrong units, and a clock that was set while it ran.

Nothing is left out here; `signals.rows` leaves out torn rows. A unit is changed only where the recording itself shows it: the speeds must
be the derivative of the positions, and no arm turns at a hundred radians a second.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.cleaning.clock import restored_clock
from monitor.identify.signals.cleaning.speeds import check_speeds
from monitor.identify.signals.order import median, quantile
from monitor.identify.signals.slopes import Slopes, slopes
from monitor.recording import Array, Recording

DEGREES = 180.0 / math.pi
ALIKE = 0.15  # relative distance at which a ratio counts as that of a unit; noise and differences change a ratio by a few per cent
CONTRADICTION = 1.2  # a ratio farther than this factor from 1 and from every unit: the speeds belong to other positions
SUSPICIOUS = (
    0.03  # relative distance from 1 beyond which a clock is suspicious: real controllers agree to 0.001, differences at 12 Hz to 0.02
)
BEYOND_RAD = 2.1 * math.pi  # no joint of an arm with cables turns farther; a joint without end stops may
BEYOND_RAD_S = 7.0  # the fastest joint of any UR turns at 2π
WELL_SAMPLED_HZ = 10.0  # at a lower rate, differences of positions are no speeds
MOVING_RAD_S = 0.02  # a joint whose 90 % quantile of speed is lower does not move enough for a ratio
FEWEST_WINDOWS = 20  # fewer give no ratio
SURE_STD = 5.0  # standard deviations of a ratio that are allowed before it counts as suspicious or wrong
RETURN_ROWS = 20  # a torn time is right again in the next row; a clock that is wrong for so many rows was set
FAR_S = 60.0  # a larger leap ahead is no hole in a recording of a replay
HOLE_S = 1.0  # the hole that stands for an unknown time between two rows: longer than any gap that a spline bridges


DOUBTS = (
    "clock_doubtful",
    "speeds_doubtful",
    "motion_jumps",
    "current_saturated",
    "current_held",
    "current_stuck",
    "temperature_doubtful",
    "temperature_torn",
)  # codes of what is told and left as it is


class Repair(NamedTuple):
    """One correction, or a doubt; `code` is for programs, `text` for people."""

    code: str
    text: str


def cleaned(recording: Recording) -> tuple[Recording, tuple[Repair, ...]]:
    """The recording in seconds and radians, with a clock that only increases, and the corrections that were made.

    Raises Unidentifiable where the speeds cannot be the derivative of the positions in any unit.
    """
    repairs = []
    t_s, jumps = _running_on(recording.t_s)
    if jumps:
        recording = replace(recording, t_s=t_s)
        repairs.append(Repair("clock_jump", f"the clock was set {jumps} time{'s' if jumps > 1 else ''}; the time in between is unknown"))
    coarse = restored_clock(recording.t_s, recording.q)
    if coarse is not None:
        recording = replace(recording, t_s=coarse[0])
        repairs.append(Repair("clock_restored", f"times are written in steps of {coarse[1]:.3g}, coarser than the ticks"))
    as_read, seen = recording, slopes(recording.t_s, recording.q, recording.qd)
    for field, factor, text in _units(recording, seen):
        if factor != 1.0:
            recording = replace(recording, **{field: getattr(recording, field) * factor})
        repairs.append(Repair("unit_repaired" if factor != 1.0 else "clock_doubtful", text))
    if recording is not as_read:
        seen = slopes(recording.t_s, recording.q, recording.qd)
    doubts = list(check_speeds(recording, seen))  # it raises where the speeds are another signal
    if not any(repair.code == "clock_doubtful" for repair in repairs):  # which is the same doubt for all joints
        repairs += [Repair("speeds_doubtful", doubt.text) for doubt in doubts]
    return recording, tuple(repairs)


def _running_on(t_s: Array) -> tuple[Array, int]:
    """The clock with a hole in the place of every lasting leap, back or far ahead; and the number of leaps."""
    finite = np.flatnonzero(np.isfinite(t_s))
    if len(finite) < 2 * RETURN_ROWS:
        return t_s, 0
    t = t_s[finite]
    step = np.diff(t)
    tick = median(step[step > 0.0]) if np.any(step > 0.0) else 0.0
    offset, jumps = np.zeros(len(t)), 0
    limit = max(FAR_S, 100.0 * tick)
    for i in np.flatnonzero((step < 0.0) | (step > limit)):
        before, after = t[max(0, i + 1 - RETURN_ROWS) : i + 1], t[i + 1 : i + 1 + RETURN_ROWS]
        if len(after) < RETURN_ROWS or len(before) < RETURN_ROWS:
            continue
        # a torn time is a single row; where the clock was set, all rows before and all rows after are apart from each other
        back = median(after) < np.min(before[-3:]) and np.max(after) < t[i] + limit and np.min(after) > t[i + 1] - limit
        ahead = np.min(after) > np.max(before) + limit
        if (step[i] < 0.0 and back and np.max(after) < np.max(before)) or (step[i] > limit and ahead):
            offset[i + 1 :] += t[i] + HOLE_S - t[i + 1]
            jumps += 1
    cleaned = t_s.copy()
    cleaned[finite] = t + offset
    return (cleaned, jumps) if jumps else (t_s, 0)


def _units(recording: Recording, seen: Slopes | None) -> Iterator[tuple[str, float, str]]:
    """(field, factor to SI, text) of every unit that is not of the SI, and of a suspicious clock (factor 1).

    seen : `slopes` of its positions. Raises Unidentifiable where the speeds cannot be the derivative of the positions in any unit.
    """
    name = recording.source or "recording"
    t_s, q, qd, qdd = recording.t_s, recording.q, recording.qd, recording.qdd
    step = np.diff(t_s[np.isfinite(t_s)])
    tick = median(step[step > 0.0]) if np.any(step > 0.0) else math.nan
    found = _ratio(seen)
    speed_ratio, tolerance = (None, 0.0) if found is None else (found.value, SURE_STD * found.std)
    if speed_ratio is not None:
        for unit, per_second in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
            if _near(speed_ratio * per_second, 1.0) and tick * WELL_SAMPLED_HZ > 1.0:
                yield "t_s", 1.0 / per_second, f"time is in {unit}"
                tick, speed_ratio = tick / per_second, speed_ratio * per_second
    if not tick * WELL_SAMPLED_HZ <= 1.0:
        return
    if speed_ratio is None:
        if _in_degrees(q, BEYOND_RAD):
            speed = np.gradient(q, axis=0) / tick
            if qd is None and _in_degrees(speed, BEYOND_RAD_S):
                yield "q", 1.0 / DEGREES, "positions are in degrees"
        return
    degrees_alone = _near(speed_ratio, DEGREES), _near(speed_ratio, 1.0 / DEGREES)
    both = _near(speed_ratio, 1.0) and _in_degrees(q, BEYOND_RAD) and _in_degrees(qd, BEYOND_RAD_S)
    if degrees_alone[0] or both:
        yield "q", 1.0 / DEGREES, "positions are in degrees"
    if degrees_alone[1] or both:
        yield "qd", 1.0 / DEGREES, "speeds are in degrees a second"
    alike = speed_ratio / (DEGREES if degrees_alone[0] else 1.0 / DEGREES if degrees_alone[1] else 1.0)
    farthest = CONTRADICTION * (1.0 + tolerance)
    if abs(alike - 1.0) > SUSPICIOUS + tolerance and 1.0 / farthest < alike < farthest:
        yield "t_s", 1.0, f"positions change {alike:.3g} times as fast as the speeds say: clock or speeds are off, and friction with them"
    if not 1.0 / farthest < alike < farthest:
        raise Unidentifiable(
            f"{name}: positions change {speed_ratio:.3g} times as fast as the speeds say; expected 1 (or 57.3 for degrees): "
            f"check the columns and the clock"
        )
    if qdd is not None and qd is not None:
        scaled = qd / DEGREES if degrees_alone[1] or both else qd
        acceleration_ratio = _ratio(slopes(t_s if tick < 1.0 else t_s * 1e-3, scaled, qdd))
        if acceleration_ratio is not None and _near(acceleration_ratio.value, 1.0 / DEGREES):
            yield "qdd", 1.0 / DEGREES, "accelerations are in degrees a second squared"


def _near(ratio: float, unit: float) -> bool:
    """Whether the ratio is that of the unit, within `ALIKE`."""
    return abs(ratio / unit - 1.0) < ALIKE


def _in_degrees(values: Array | None, beyond: float) -> bool:
    """Whether two joints or more are beyond what radians allow in more than a tenth of the samples. One joint may have no end stops."""
    if values is None:
        return False
    with np.errstate(invalid="ignore"):
        share = np.mean((np.abs(values) > beyond) & (np.abs(values) < 1e4), axis=0)  # (J,)
    return bool(np.sum(share > 0.1) >= min(2, values.shape[1]))


class _Ratio(NamedTuple):
    value: float
    std: float  # relative


def _ratio(seen: Slopes | None) -> _Ratio | None:
    """The change of a signal per time over its recorded rate, of the median joint; None with too little motion."""
    if seen is None:
        return None
    ratios = []
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        even = (seen.dt > 0.0) & (seen.dt < 1.5 * seen.length * seen.tick)
        for slope, middle in zip(seen.slope.T, seen.speed.T, strict=True):
            sound = even & (np.abs(slope) < 1e4) & (np.abs(middle) < 1e4)
            if np.sum(sound) < FEWEST_WINDOWS or not quantile(np.abs(middle[sound]), 0.9) > MOVING_RAD_S:
                continue
            # near a reversal both are about zero; rows are chosen by the slope, whose noise is small, since the ratio would be biased
            informative = sound & (np.abs(slope) > 0.3 * quantile(np.abs(slope[sound]), 0.75))  # torn rows move a fifth of them
            along = middle[informative] * np.sign(slope[informative])
            value = median(np.abs(slope[informative])) / median(along)
            spread = median(np.abs(along - np.abs(slope[informative]) / value)) / abs(median(along))
            if math.isfinite(value) and value > 0.0:
                ratios.append(_Ratio(value, float(2.0 * spread / math.sqrt(len(along)))))
    if not ratios:
        return None
    return sorted(ratios)[len(ratios) // 2]
