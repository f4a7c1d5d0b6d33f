"""Whether the recorded speeds are those of the recorded positions, joint by joint and with their sign.

The median of a ratio over joints, which shows a wrong unit, is blind to one joint that is wrong, and to signs. Here the change of each
position over a window of time is set beside the median of its speed in this window.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.settings import QualitySettings
from monitor.identify.signals.order import Slopes, median, medians, quantile, slopes
from monitor.identify.signals.rows import restored_clock, taken, usual_size
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Indices, Mask, Recording

MOVING_RAD_S = 0.02  # a joint whose 90 % quantile of speed is lower does not move enough for a comparison
FEWEST_WINDOWS = 20  # fewer say nothing
USUAL = 0.75  # quantile of the speeds that stands for their size
WRONG = 0.35  # of the speed's size: a larger mismatch is another signal
DOUBTFUL = 0.08  # a smaller one is noise, or a motion that is fast for its rate
EXPLAINS = 0.5  # of the mismatch may remain where an exchange or a sign explains it
SURE = 4.0  # times the noise of a window's speed
LATE_S = 0.008  # by which speeds may lag; on real controllers they lag by less than 2 ms


def check_speeds(recording: Recording, seen: Slopes | None) -> Iterator[Reason]:
    """Why the speeds of joints are doubtful. seen : `slopes` of its positions.

    Raises Unidentifiable where the speeds of a joint are another signal, with the likely reason: exchanged columns, a sign, a unit.
    """
    windows = _windows(recording.t_s, recording.q, recording.qd, seen)
    if windows is None:
        return
    slope, speed, noise, lag = windows
    wrong = [_mismatch(slope[:, j], speed[:, j]) for j in range(slope.shape[1])]
    size = [_size(slope[:, j]) for j in range(slope.shape[1])]
    moves = [size[j] > MOVING_RAD_S or _size(speed[:, j]) > MOVING_RAD_S for j in range(len(size))]
    unsure = [SURE * noise[j] / max(size[j], MOVING_RAD_S) for j in range(len(size))]
    beyond = [moves[j] and wrong[j] > max(WRONG, unsure[j]) for j in range(len(size))]
    if any(beyond):
        raise Unidentifiable(f"{recording.source or 'recording'}: {_reason(recording, slope, speed, beyond)}: check the columns")
    for j, off in enumerate(wrong):
        if moves[j] and off > DOUBTFUL + unsure[j]:
            factor = float(slope[:, j] @ speed[:, j] / (slope[:, j] @ slope[:, j]))
            yield SPEED_DIFFERS(joint=j + 1, share=off, factor=factor)
        elif moves[j] and abs(lag[j]) > LATE_S:
            order = "later" if lag[j] > 0 else "earlier"
            yield SPEED_LATE(joint=j + 1, late_ms=1e3 * abs(lag[j]), order=order)


def _reason(recording: Recording, slope: Array, speed: Array, beyond: list[bool]) -> str:
    """The likeliest reason why the speeds of the joints `beyond` are not the change of their positions."""
    joints = [j for j, is_so in enumerate(beyond) if is_so]
    named = ", ".join(str(j + 1) for j in joints)
    of = f"joint{'s' if len(joints) > 1 else ''} {named}"
    if recording.qd is not None:
        turned = _windows(recording.t_s, recording.qd, recording.q, slopes(recording.t_s, recording.qd, recording.q))
        if turned is not None and all(_mismatch(turned[0][:, j], turned[1][:, j]) < WRONG for j in joints):
            return f"the positions of {of} are the change of their speeds: q and q̇ are exchanged"
    if all(_mismatch(-slope[:, j], speed[:, j]) < EXPLAINS for j in joints):
        return f"the speeds of {of} have the opposite sign of their positions' change"
    for j in joints:
        crossed = [max(_mismatch(slope[:, k], speed[:, j]), _mismatch(slope[:, j], speed[:, k])) for k in range(len(beyond))]
        other = [k for k in joints if k != j and crossed[k] < WRONG]
        if other:
            return f"the speeds of joints {j + 1} and {other[0] + 1} are exchanged"
    j = joints[0]
    fast = np.abs(speed[:, j]) > 0.5 * _size(speed[:, j])
    factor = median(slope[fast, j] / speed[fast, j]) if fast.any() and _size(speed[:, j]) > 0.0 else 0.0
    if _mismatch(slope[:, j], factor * speed[:, j]) < WRONG and factor > 0.0:
        return f"the positions of {of} change {factor:.3g} times as fast as their speeds say; expected 1 (or 57.3 for degrees)"
    return f"the speeds of {of} are not the change of their positions"


def _mismatch(slope: Array, speed: Array) -> float:
    """The size of speed − slope beside that of the larger of both, by medians over the windows with motion; 0 without motion.

    Half of the windows may hold a torn row.
    """
    larger = np.maximum(np.abs(slope), np.abs(speed))
    informative = larger > 0.3 * quantile(larger, USUAL)
    if np.sum(informative) < FEWEST_WINDOWS:
        return 0.0
    return median(np.abs(speed - slope)[informative]) / median(larger[informative])


def _size(x: Array) -> float:
    """The 75 % quantile of |x|: a joint may rest for most of the time, and a torn row moves a fifth of the windows at most."""
    return quantile(np.abs(x), USUAL)


def _ripple(x: Array) -> Array:
    """(J,) standard deviation of what changes from row to row in x (N, J), by the median of second differences."""
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
        found = medians(np.ascontiguousarray(change.T))
        if np.any(np.isnan(found)):
            found = np.nanmedian(change, axis=0)
        ripple: Array = 1.4826 * found / math.sqrt(6.0)
    return ripple


def _windows(t_s: Array, x: Array, rate: Array | None, seen: Slopes | None) -> tuple[Array, Array, Array, Array] | None:
    """Change of x a second (W, J), median of its rate (W, J), noise of both together (J,), sure part of the rate's lag (J,) [s].

    seen : `slopes` of x. None with few rows.
    """
    if rate is None or seen is None or len(t_s) < FEWEST_WINDOWS:
        return None
    tick, length, dt, slope, speed = seen
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        turn = 2.0 * math.pi / dt[:, None] * np.sign(slope)
        slope = np.where(np.abs(slope - turn - speed) < 0.1 * np.abs(slope - speed), slope - turn, slope)  # a turn is no motion
        sound = (dt > 0.0) & (dt < 1.5 * length * tick) & np.all(np.abs(slope) < 1e4, axis=1) & np.all(np.abs(speed) < 1e4, axis=1)
    if np.sum(sound) < FEWEST_WINDOWS:
        return None
    noise = np.hypot(_ripple(rate) * 1.25 / math.sqrt(length + 1), _ripple(x) * math.sqrt(2.0) / (length * tick))
    change = np.gradient(slope, axis=0) / (max(1, length // 2) * tick)  # acceleration
    lag = np.zeros(x.shape[1])
    inner = sound & np.concatenate([sound[-1:], sound[:-1]]) & np.concatenate([sound[1:], sound[:1]])
    for j in range(x.shape[1]):
        left, a = slope[inner, j] - speed[inner, j], change[inner, j]
        strong = np.abs(a) > quantile(np.abs(a), 0.5) if len(a) else np.zeros(0, dtype=bool)
        if np.sum(strong) >= FEWEST_WINDOWS // 2 and np.all(np.abs(a[strong]) > 0.0):
            each = left[strong] / a[strong]
            middle = median(each)
            doubt = SURE * 1.5 * median(np.abs(each - middle)) / math.sqrt(len(each))
            lag[j] = math.copysign(max(0.0, abs(middle) - doubt), middle)
    return slope[sound], speed[sound], noise, lag


# --- Quality check of a recording by the counts that its acquisition made. A disturbed motion would appear as friction ---


def quality_problem(quality: Mapping[str, Any], samples: int, settings: QualitySettings) -> str | None:
    """The reason why a recording of N `samples` is not used, as a clause; None where it passes. quality : counts by name."""

    def known(name: str) -> float | None:
        value = quality.get(name)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    missed, late, slipped, scaling = (known(name) for name in ("missed_ticks", "late_share", "slipped_s", "min_speed_scaling"))
    if missed is not None and missed > settings.max_missed_share * (samples + missed):
        share = 100.0 * missed / (samples + missed)
        return f"{share:.1f} % of the ticks are missing from the recording; at most {100.0 * settings.max_missed_share:g} %"
    if late is not None and late > settings.max_late_share:
        return f"{100.0 * late:.1f} % of the targets came late, which jerks the arm; at most {100.0 * settings.max_late_share:g} %"
    if slipped is not None and slipped > settings.max_slipped_s:
        return f"the motion fell {slipped:.2f} s behind its trajectory; at most {settings.max_slipped_s:g} s"
    if scaling is not None and scaling < settings.min_speed_scaling:
        return f"the speed slider went to {100.0 * scaling:.0f} %: it was another trajectory"
    return None


# --- Errors of a whole recording that can be corrected: wrong units, and a clock that was set while it ran ---

DEGREES = 180.0 / math.pi
ALIKE = 0.15  # relative distance at which a ratio counts as that of a unit; noise and differences change a ratio by a few per cent
CONTRADICTION = 1.2  # a ratio farther than this factor from 1 and from every unit: the speeds belong to other positions
SUSPICIOUS = (
    0.03  # relative distance from 1 beyond which a clock is suspicious: real controllers agree to 0.001, differences at 12 Hz to 0.02
)
BEYOND_RAD = 2.1 * math.pi  # no joint of an arm with cables turns farther; a joint without end stops may
BEYOND_RAD_S = 7.0  # the fastest joint of any UR turns at 2π
WELL_SAMPLED_HZ = 10.0  # at a lower rate, differences of positions are no speeds
SURE_STD = 5.0  # standard deviations of a ratio that are allowed before it counts as suspicious or wrong
RETURN_ROWS = 20  # a torn time is right again in the next row; a clock that is wrong for so many rows was set
FAR_S = 60.0  # a larger leap ahead is no hole in a recording of a replay
HOLE_S = 1.0  # the hole that stands for an unknown time between two rows: longer than any gap that a spline bridges


# Doubts (left as it is) and corrections ("put right") of a recording as a whole: the sentence of each code.
CLOCK_JUMP = Sentence("clock_jump", "{source}: the clock was set {jumps} times; the time in between is unknown; put right")
CLOCK_RESTORED = Sentence("clock_restored", "{source}: times are written in steps of {step:.3g}, coarser than the ticks; put right")
UNIT_REPAIRED = Sentence("unit_repaired", "{source}: {what:word}; put right")
CLOCK_DOUBTFUL = Sentence(
    "clock_doubtful",
    "{source}: positions change {factor:.3g} times as fast as the speeds say: clock or speeds are off, and friction with them",
)
SPEEDS_DOUBTFUL = Sentence("speeds_doubtful", "{source}: {what}")
SPEED_DIFFERS = Sentence(
    "speed_differs", "{share:.0%} of the speed of joint {joint} is not the change of its position (factor {factor:.3g})"
)
SPEED_LATE = Sentence("speed_late", "the speed of joint {joint} comes {late_ms:.0f} ms {order:word} than the change of its position")
TURNS_UNWOUND = Sentence("turns_unwound", "{source}: positions of joints {joints} jumped by whole turns; put right")
MOTION_JUMPS = Sentence(
    "motion_jumps", "{source}: the motion jumps {jumps} times, as where recordings are put together; each part is filtered alone"
)
ACCELERATIONS_REPLACED = Sentence(
    "accelerations_replaced",
    "{source}: the accelerations of joints {joints} are not the change of the speeds: "
    "differences of the speeds stand in for all; put right",
)
CURRENT_STUCK = Sentence(
    "current_stuck",
    "{source}: the {drive:word} of joint {joint} stays at {value:.4g} in {share:.0%} of the samples with motion: it was not measured there",
)
CURRENT_HELD = Sentence(
    "current_held",
    "{source}: the {drive:word} of joint {joint} changes every {every_ms:.0f} ms only (held or rounded): it comes late by half of that",
)
CURRENT_SATURATED = Sentence(
    "current_saturated",
    "{source}: the {drive:word} of joint {joint} is cut off at {value:.4g}: what was beyond is missing, and friction with it",
)
TEMPERATURE_TORN = Sentence("temperature_torn", "{source}: {count} readings of temperature are none of a joint; left out")
TEMPERATURE_DOUBTFUL = Sentence("temperature_doubtful", "{source}: {what}")
SILENT_SENSOR = Sentence("sensor_silent", "the temperature of joints {joints} is 0 throughout: it is taken as unknown")
FOREIGN_UNIT = Sentence(
    "sensor_unit",
    "{value:.0f} is no temperature of joint {joints} in °C: it is taken as unknown; if it is in kelvin, subtract 273.15",
)
ALL_HOT = Sentence(
    "sensors_hot",
    "every joint is hotter than {coldest_c:.0f} °C: if these are °F, convert them, for friction is compared by temperature",
)
SENSOR_APART = Sentence(
    "sensor_apart", "joint {joint} says {temperature_c:.0f} °C, the median joint {median_c:.0f} °C: check its sensor or unit"
)


def cleaned(recording: Recording) -> tuple[Recording, tuple[Reason, ...]]:
    """The recording in seconds and radians, with a clock that only increases, and the corrections that were made.

    Raises Unidentifiable where the speeds cannot be the derivative of the positions in any unit.
    """
    repairs: list[Reason] = []
    source = named(recording)
    t_s, jumps = _running_on(recording.t_s)
    if jumps:
        recording = replace(recording, t_s=t_s)
        repairs.append(CLOCK_JUMP(source=source, jumps=jumps))
    coarse = restored_clock(recording.t_s, recording.q)
    if coarse is not None:
        recording = replace(recording, t_s=coarse[0])
        repairs.append(CLOCK_RESTORED(source=source, step=coarse[1]))
    as_read, seen = recording, slopes(recording.t_s, recording.q, recording.qd)
    for field, factor, found in _units(recording, seen):
        if factor != 1.0:
            recording = replace(recording, **{field: getattr(recording, field) * factor})
        repairs.append(found)
    if recording is not as_read:
        seen = slopes(recording.t_s, recording.q, recording.qd)
    doubts = list(check_speeds(recording, seen))  # it raises where the speeds are another signal
    if not any(repair.code == CLOCK_DOUBTFUL.code for repair in repairs):  # which is the same doubt for all joints
        repairs += [SPEEDS_DOUBTFUL(source=source, what=doubt) for doubt in doubts]
    return recording, tuple(repairs)


def named(recording: Recording) -> str:
    """The name of a recording in sentences."""
    return recording.source or "recording"


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


def _units(recording: Recording, seen: Slopes | None) -> Iterator[tuple[str, float, Reason]]:
    """(field, factor to SI, what is said) of every unit that is not of the SI, and of a suspicious clock (factor 1).

    seen : `slopes` of its positions. Raises Unidentifiable where the speeds cannot be the derivative of the positions in any unit.
    """
    name = named(recording)
    t_s, q, qd, qdd = recording.t_s, recording.q, recording.qd, recording.qdd
    step = np.diff(t_s[np.isfinite(t_s)])
    tick = median(step[step > 0.0]) if np.any(step > 0.0) else math.nan
    found = _ratio(seen)
    speed_ratio, tolerance = (None, 0.0) if found is None else (found.value, SURE_STD * found.std)
    if speed_ratio is not None:
        for unit, per_second in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)):
            if _near(speed_ratio * per_second, 1.0) and tick * WELL_SAMPLED_HZ > 1.0:
                yield "t_s", 1.0 / per_second, UNIT_REPAIRED(source=name, what=f"time is in {unit}")
                tick, speed_ratio = tick / per_second, speed_ratio * per_second
    if not tick * WELL_SAMPLED_HZ <= 1.0:
        return
    if speed_ratio is None:
        if _in_degrees(q, BEYOND_RAD):
            speed = np.gradient(q, axis=0) / tick
            if qd is None and _in_degrees(speed, BEYOND_RAD_S):
                yield "q", 1.0 / DEGREES, UNIT_REPAIRED(source=name, what="positions are in degrees")
        return
    degrees_alone = _near(speed_ratio, DEGREES), _near(speed_ratio, 1.0 / DEGREES)
    both = _near(speed_ratio, 1.0) and _in_degrees(q, BEYOND_RAD) and _in_degrees(qd, BEYOND_RAD_S)
    if degrees_alone[0] or both:
        yield "q", 1.0 / DEGREES, UNIT_REPAIRED(source=name, what="positions are in degrees")
    if degrees_alone[1] or both:
        yield "qd", 1.0 / DEGREES, UNIT_REPAIRED(source=name, what="speeds are in degrees a second")
    alike = speed_ratio / (DEGREES if degrees_alone[0] else 1.0 / DEGREES if degrees_alone[1] else 1.0)
    farthest = CONTRADICTION * (1.0 + tolerance)
    if abs(alike - 1.0) > SUSPICIOUS + tolerance and 1.0 / farthest < alike < farthest:
        yield "t_s", 1.0, CLOCK_DOUBTFUL(source=name, factor=alike)
    if not 1.0 / farthest < alike < farthest:
        raise Unidentifiable(
            f"{name}: positions change {speed_ratio:.3g} times as fast as the speeds say; expected 1 (or 57.3 for degrees): "
            f"check the columns and the clock"
        )
    if qdd is not None and qd is not None:
        scaled = qd / DEGREES if degrees_alone[1] or both else qd
        acceleration_ratio = _ratio(slopes(t_s if tick < 1.0 else t_s * 1e-3, scaled, qdd))
        if acceleration_ratio is not None and _near(acceleration_ratio.value, 1.0 / DEGREES):
            yield "qdd", 1.0 / DEGREES, UNIT_REPAIRED(source=name, what="accelerations are in degrees a second squared")


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


# --- Currents and torques that are no measurement: stuck, cut off, held, or in another unit -------------

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


def check_drives(recording: Recording, rows: Indices) -> Iterator[Reason]:
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
        x, which = value[:, j], {"source": named(recording), "drive": what, "joint": j + 1}
        lengths, at = _runs(x, moving)
        long = lengths >= max(STUCK_ROWS, STUCK_S / tick)
        share = float(np.sum(lengths[long]) / count)
        if count >= STUCK_ROWS and np.all((stuck_at := x[moving]) == stuck_at[0]):
            yield CURRENT_STUCK(**which, value=stuck_at[0], share=1.0)
        elif np.sum(lengths) > 0.5 * count and _mean_run(lengths) * tick > HELD_S:
            yield CURRENT_HELD(**which, every_ms=1e3 * _mean_run(lengths) * tick)
        elif (cut := _cut_off(x)) is not None:
            yield CURRENT_SATURATED(**which, value=cut)
        elif share > STUCK_SHARE:
            stuck = x[at[long][int(np.argmax(lengths[long]))]]
            yield CURRENT_STUCK(**which, value=stuck, share=share)


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


# --- Which readings of the temperature sensors are readings ---------------------------------------------

MAX_TEMPERATURE_C = 200.0  # no reading of a joint's sensor
SWING_K = 25.0  # from the median of one recording: a joint warms by a kelvin a minute
COLD_C = -20.0  # in which no arm works
APART_K = 35.0  # of one joint from the median joint: in warm-up curves of real arms 17 K
HOT_C = 65.0  # all joints of a working arm are colder: 20–45 °C, which are 68–113 °F


def plausible_temperatures(temperature_c: Array) -> Mask:
    """(N, J) the readings (N, J) that may be of their joints' sensors. A sensor that says 0 throughout has none."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(temperature_c) & (np.abs(temperature_c) < MAX_TEMPERATURE_C)
        given = np.any(finite & (temperature_c != 0.0), axis=0)
        plausible: Mask = finite & given
        # what differs by less than the swing throughout is as near to its median
        swing = np.max(temperature_c, axis=0, initial=-np.inf) - np.min(temperature_c, axis=0, initial=np.inf)
        for j in np.flatnonzero(~(swing < SWING_K)):  # NaN too
            column = temperature_c[:, j]
            plausible[:, j] &= np.abs(column - median(column[finite[:, j]])) < SWING_K
    return plausible


def check_temperatures(recording: Recording) -> Iterator[Reason]:
    """Doubts about the temperatures of a recording as a whole, and single readings that are left out."""
    if recording.temperature_c is None:
        return
    source = named(recording)
    columns, sound = recording.temperature_c.T, plausible_temperatures(recording.temperature_c).T
    coldest, hottest = np.min(columns, initial=np.inf), np.max(columns, initial=-np.inf)
    if sound.all() and coldest >= COLD_C and hottest <= min(HOT_C, coldest + APART_K):
        return  # most often: no joint's median can then be doubtful
    usual = [median(column[on]) for column, on in zip(columns, sound, strict=True)]  # NaN where no reading is sound
    numbers = [column[np.isfinite(column)] for column in columns]
    silent = [j + 1 for j, given in enumerate(numbers) if not np.any(given)]
    if silent:
        yield TEMPERATURE_DOUBTFUL(source=source, what=SILENT_SENSOR(joints=silent))
    foreign = [j for j, given in enumerate(numbers) if np.any(given) and np.isnan(usual[j])]
    if foreign:
        what = FOREIGN_UNIT(value=median(numbers[foreign[0]]), joints=[j + 1 for j in foreign])
        yield TEMPERATURE_DOUBTFUL(source=source, what=what)
    known = [value for value in usual if np.isfinite(value)]
    yield from (TEMPERATURE_DOUBTFUL(source=source, what=apart) for apart in _apart(usual, known))
    if known and min(known) > HOT_C:
        yield TEMPERATURE_DOUBTFUL(source=source, what=ALL_HOT(coldest_c=min(known)))
    torn = sum(int(np.sum(np.isfinite(column) & ~on)) for column, on in zip(columns, sound, strict=True) if on.any())
    if torn:
        yield TEMPERATURE_TORN(source=source, count=torn)


def _apart(usual: Sequence[float], known: Sequence[float]) -> Iterator[Reason]:
    """Doubts about single joints, by each joint's median [°C], NaN where it is unknown, and those that are known."""
    middle = median(np.array(known))
    for j, value in enumerate(usual):
        if value < COLD_C or (len(known) > 2 and abs(value - middle) > APART_K):
            yield SENSOR_APART(joint=j + 1, temperature_c=value, median_c=middle)
