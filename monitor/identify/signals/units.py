"""A recording in seconds and radians: its clock, its units, and whether each joint's speeds are those of its positions.

The change of each position over a window of time stands beside the median of its recorded speed in this window. The ratio of the median
joint shows a wrong unit or clock; the difference joint by joint shows one joint that is wrong, and signs.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.clock import Clock, restored_clock, running_on
from monitor.identify.signals.usable import usable
from monitor.reason import Reason, joints_by_number
from monitor.recording import DAY_S, Array, Indices, Mask, Recording

WINDOW_S = 0.13  # time over which a difference is taken: short beside the motion, long beside ripple
WINDOW_ROWS = 16  # from the first row of such a window to its last one, at most
FEWEST_ROWS = 10  # fewer have no windows
FEWEST_WINDOWS = 20  # fewer say nothing
COARSE = 0.1  # values beside rows: with fewer, the signal is written in steps
RESOLVED = 5.0  # steps: slower, a speed is that of its rounding
MOVING_RAD_S = 0.02  # a joint whose 90 % quantile of speed is lower does not move enough for a comparison

DEGREES = 180.0 / math.pi
MINUTE_S = 60.0
ALIKE = 0.15  # relative distance at which a ratio counts as that of a unit; noise and differences change a ratio by a few per cent
CONTRADICTION = 1.2  # a ratio farther than this factor from 1 and from every unit: the speeds belong to other positions
SUSPICIOUS = (
    0.03  # relative distance from 1 beyond which a clock is suspicious: real controllers agree to 0.001, differences at 12 Hz to 0.02
)
BEYOND_RAD = 2.1 * math.pi  # no joint of an arm with cables turns farther; a joint without end stops may
BEYOND_RAD_S = 7.0  # the fastest joint of any UR turns at 2π
WELL_SAMPLED_HZ = 10.0  # at a lower rate, differences of positions are no speeds
SURE_STD = 5.0  # standard deviations of a ratio that are allowed before it counts as suspicious or wrong

UNITS_OF_TIME = {  # in a second
    "milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9, "units of 100 ns": 1e7,
    "days": 1.0 / DAY_S, "hours": 1.0 / 3600.0, "minutes": 1.0 / MINUTE_S,
}  # fmt: skip
MINUTE_OR_DEGREES = math.sqrt(MINUTE_S * DEGREES)  # a ratio below it is one of degrees
LOGGED_HZ = 10.0, 2000.0  # rates at which arms are logged
NO_RATE_HZ = 2e4  # at which no arm is logged

USUAL = 0.75  # quantile of the speeds that stands for their size
WRONG = 0.35  # of the speed's size: a larger mismatch is another signal
DOUBTFUL = 0.08  # a smaller one is noise, or a motion that is fast for its rate
EXPLAINS = 0.5  # of the mismatch may remain where an exchange or a sign explains it
SURE = 4.0  # times the noise of a window's speed


class SpeedCheck(NamedTuple):
    """How far the recorded speeds of each joint differ from the change of its positions, (J,) each."""

    moves: Mask
    mismatch: Array  # of the speed's size
    unsure: Array  # of the speed's size: what noise may explain
    factor: Array  # speed over the change of position
    late_s: Array  # what is sure of the speed's delay


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repaired:
    """A recording in seconds and radians, on a clock that only runs forward, and what was put right."""

    recording: Recording
    clock_jumps: int = 0  # times at which the clock was set while it ran
    clock: Clock | None = None  # an even one, in the place of a coarse one or of one of arrivals
    units: tuple[str, ...] = ()  # units that were not SI, in words
    clock_factor: float | None = None  # positions change so many times as fast as the speeds say, where that is suspicious
    speeds: SpeedCheck | None = None  # None: no speeds, or too few rows
    left_out: tuple[Reason, ...] = ()  # signals that are there by name alone


def in_si(recording: Recording) -> Repaired:
    """The recording with its clock and its units put right.

    Raises Unidentifiable where the speeds cannot be the derivative of the positions in any unit, with the likely reason.
    """
    recording, left_out = usable(recording)
    t_s, jumps = running_on(recording.t_s)
    clock = restored_clock(t_s, recording.q)
    t_s = t_s if clock is None else clock.t_s
    if t_s is not recording.t_s:
        recording = replace(recording, t_s=t_s)
    seen = windows(recording.t_s, recording.q, recording.qd)
    found = _units(recording, seen)
    if found.factors:
        recording = replace(recording, **{name: getattr(recording, name) * factor for name, factor in found.factors.items()})
        seen = windows(recording.t_s, recording.q, recording.qd)
    return Repaired(
        recording=recording,
        clock_jumps=jumps,
        clock=clock,
        units=found.said,
        clock_factor=found.clock_factor,
        speeds=_checked_speeds(recording, seen),
        left_out=left_out,
    )


def named(recording: Recording) -> str:
    """The name of a recording in sentences."""
    return recording.source or "recording"


# --- Windows: the change of a signal beside its recorded rate --------------------------------------------


class Windows(NamedTuple):
    """W windows of J signals. Each begins half a window after the one before it."""

    tick: float  # time between two rows
    length: int  # rows from the first of a window to its last
    dt: Array  # (W,) time from the first row to the last
    slope: Array  # (W, J) change of the signal a second
    rate: Array  # (W, J) median of its recorded rate
    step: Array  # (J,) in which the rate is written, where that is coarse; else 0


def windows(t_s: Array, x: Array, rate: Array | None) -> Windows | None:
    """The windows of x (N, J), whose recorded rate is (N, J), at times (N,); None without a rate, or with few rows."""
    if rate is None or len(t_s) < FEWEST_ROWS:
        return None
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        step = np.diff(t_s)
        tick = float(np.median(step[step > 0.0])) if np.any(step > 0.0) else math.inf
        length = int(np.clip(WINDOW_S / tick, 2, WINDOW_ROWS))
        every = max(1, length // 2)
        first: Indices = np.arange(0, len(t_s) - length, every)
        dt = t_s[first + length] - t_s[first]
        middle = np.empty((0, x.shape[1]))
        if len(first):
            middle = np.median(np.lib.stride_tricks.sliding_window_view(rate, length + 1, axis=0)[::every], axis=-1)
        return Windows(
            tick, length, dt, (x[first + length] - x[first]) / dt[:, None], middle, np.array([_step(column) for column in rate.T])
        )


def _step(rate: Array) -> float:
    """The step in which a signal (N,) is written, by the usual distance of its values; 0 where most rows have a value of their own."""
    values = np.unique(rate[np.isfinite(rate)])
    return float(np.median(np.diff(values))) if 1 < len(values) < COARSE * len(rate) else 0.0


# --- Units, by the ratio of the median joint -------------------------------------------------------------


class _Units(NamedTuple):
    factors: dict[str, float]  # field → factor to SI
    said: tuple[str, ...]
    clock_factor: float | None


def _units(recording: Recording, seen: Windows | None) -> _Units:
    """Units that are not SI, and a suspicious clock. Raises Unidentifiable where no unit makes speeds of the positions' change."""
    factors: dict[str, float] = {}
    said: list[str] = []
    clock_factor = None

    def put_right(name: str, factor: float, what: str) -> None:
        factors[name] = factor
        said.append(what)

    t_s, q, qd, qdd = recording.t_s, recording.q, recording.qd, recording.qdd
    step = np.diff(t_s[np.isfinite(t_s)])
    tick = float(np.median(step[step > 0.0])) if np.any(step > 0.0) else math.nan
    found = _ratio(seen)
    if found is not None:
        for unit, per_second in UNITS_OF_TIME.items():
            if unit == "minutes" and (found.value < MINUTE_OR_DEGREES or _in_degrees(q, BEYOND_RAD)):
                continue
            if _near(found.value * per_second, 1.0) and (tick * WELL_SAMPLED_HZ > 1.0) == (per_second > 1.0):
                put_right("t_s", 1.0 / per_second, f"time is in {unit}")
                tick, found = tick / per_second, found._replace(value=found.value * per_second)
                break
    elif (likely := _unit_of_time(q, tick, longest=max(float(np.quantile(step, 0.9)), tick) if len(step) else tick)) is not None:
        put_right("t_s", 1.0 / UNITS_OF_TIME[likely], f"time is in {likely}")
        tick /= UNITS_OF_TIME[likely]
    if len(step) and not said and np.all(step == 1.0):
        raise Unidentifiable(
            f"{named(recording)}: sampled at 1 Hz; expected at least 10 Hz, better 100 Hz. Where the times count the rows, leave them out "
            f"and say the rows a second: --columns timestamp= --rate 125"
        )
    if not tick * WELL_SAMPLED_HZ <= 1.0:
        return _Units(factors, tuple(said), None)
    if found is None:
        if qd is None and _in_degrees(q, BEYOND_RAD) and _in_degrees(np.gradient(q, axis=0) / tick, BEYOND_RAD_S):
            put_right("q", 1.0 / DEGREES, "positions are in degrees")
        return _Units(factors, tuple(said), None)
    both = _near(found.value, 1.0) and _in_degrees(q, BEYOND_RAD) and _in_degrees(qd, BEYOND_RAD_S)
    of_q, of_qd = _near(found.value, DEGREES), _near(found.value, 1.0 / DEGREES)
    if of_q or both:
        put_right("q", 1.0 / DEGREES, "positions are in degrees")
    if of_qd or both:
        put_right("qd", 1.0 / DEGREES, "speeds are in degrees a second")
    alike = found.value / (DEGREES if of_q else 1.0 / DEGREES if of_qd else 1.0)
    tolerance = SURE_STD * found.std
    farthest = CONTRADICTION * (1.0 + tolerance)
    if not 1.0 / farthest < alike < farthest:
        raise Unidentifiable(
            f"{named(recording)}: positions change {found.value:.3g} times as fast as the speeds say; expected 1 (or 57.3 for degrees): "
            f"check the columns and the clock"
        )
    if abs(alike - 1.0) > SUSPICIOUS + tolerance:
        clock_factor = alike
    if qdd is not None and qd is not None:
        acceleration = _ratio(windows(t_s * factors.get("t_s", 1.0), qd * factors.get("qd", 1.0), qdd))
        if acceleration is not None and _near(acceleration.value, 1.0 / DEGREES):
            put_right("qdd", 1.0 / DEGREES, "accelerations are in degrees a second squared")
    return _Units(factors, tuple(said), clock_factor)


def _unit_of_time(q: Array, tick: float, *, longest: float) -> str | None:
    """The unit in which the times have a rate at which arms are logged, and the positions change as fast as arms move; None: seconds.

    tick : of the rows, and longest of nine steps in ten, in the unit of the file; 1 may be a count. For recordings without speeds, which
    would tell the unit.
    """
    if not tick > 0.0 or tick == 1.0 or LOGGED_HZ[0] <= 1.0 / tick <= LOGGED_HZ[1]:
        return None
    fastest = BEYOND_RAD_S * (DEGREES if _in_degrees(q, BEYOND_RAD) else 1.0)
    with np.errstate(invalid="ignore"):
        change = np.nanquantile(np.abs(np.diff(q, axis=0)), 0.9, axis=0)  # (J,) a tenth may be torn
    if LOGGED_HZ[0] <= 1.0 / tick <= NO_RATE_HZ and np.all(change / tick < fastest):
        return None
    for unit, per_second in UNITS_OF_TIME.items():
        logged = LOGGED_HZ[0] <= per_second / tick <= LOGGED_HZ[1] and per_second / longest >= LOGGED_HZ[0]
        if logged and np.all(change / tick * per_second < fastest):
            return unit
    return None


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


def _ratio(seen: Windows | None) -> _Ratio | None:
    """The change of a signal per time over its recorded rate, of the median joint; None with too little motion."""
    if seen is None:
        return None
    ratios = []
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        even = (seen.dt > 0.0) & (seen.dt < 1.5 * seen.length * seen.tick)
        for slope, middle, step in zip(seen.slope.T, seen.rate.T, seen.step.tolist(), strict=True):
            sound = even & (np.abs(slope) < 1e4) & (np.abs(middle) < 1e4)
            if np.sum(sound) < FEWEST_WINDOWS or not np.quantile(np.abs(middle[sound]), 0.9) > MOVING_RAD_S:
                continue
            # near a reversal both are about zero; rows are chosen by the slope, whose noise is small, since the ratio would be biased
            least = max(0.3 * np.quantile(np.abs(slope[sound]), 0.75), RESOLVED * step)  # torn rows move a fifth of them
            informative = sound & (np.abs(slope) > least)
            if np.sum(informative) < (FEWEST_WINDOWS if step else 1):
                continue
            along = middle[informative] * np.sign(slope[informative])
            value = np.median(np.abs(slope[informative])) / np.median(along)
            spread = np.median(np.abs(along - np.abs(slope[informative]) / value)) / abs(np.median(along))
            if np.isfinite(value) and value > 0.0:
                ratios.append(_Ratio(float(value), float(2.0 * spread / math.sqrt(len(along)))))
    if not ratios:
        return None
    return sorted(ratios)[len(ratios) // 2]


# --- Each joint's speeds beside the change of its positions ----------------------------------------------


def _checked_speeds(recording: Recording, seen: Windows | None) -> SpeedCheck | None:
    """Raises Unidentifiable where the speeds of a joint are another signal: exchanged columns, a sign, a unit."""
    found = _compared(recording.q, recording.qd, seen)
    if found is None:
        return None
    slope, speed, noise, late_s = found
    steps = np.zeros(recording.joints) if seen is None else seen.step
    mismatch = np.array([_mismatch(own, of, step) for own, of, step in zip(slope.T, speed.T, steps.tolist(), strict=True)])
    size, of_speed = _size(slope), _size(speed)
    moves = (size > MOVING_RAD_S) | (of_speed > MOVING_RAD_S)
    unsure = SURE * noise / np.maximum(size, MOVING_RAD_S)
    wrong = moves & (mismatch > np.maximum(WRONG, unsure))
    if wrong.any():
        raise Unidentifiable(f"{named(recording)}: {_likely_reason(recording, slope, speed, wrong)}: check the columns")
    square = np.sum(slope**2, axis=0)
    factor = np.sum(slope * speed, axis=0) / np.where(square > 0.0, square, np.inf)
    return SpeedCheck(moves, mismatch, unsure, factor, late_s)


def _likely_reason(recording: Recording, slope: Array, speed: Array, wrong: Mask) -> str:
    """The likeliest reason why the speeds of the joints that are `wrong` (J,) are not the change of their positions."""
    joints = [int(j) for j in np.flatnonzero(wrong)]
    of = joints_by_number([j + 1 for j in joints])
    if recording.qd is not None:
        turned = _compared(recording.qd, recording.q, windows(recording.t_s, recording.qd, recording.q))
        if turned is not None and all(_mismatch(turned[0][:, j], turned[1][:, j]) < WRONG for j in joints):
            return f"the positions of {of} are the change of their speeds: q and q̇ are exchanged"
    if all(_mismatch(-slope[:, j], speed[:, j]) < EXPLAINS for j in joints):
        return f"the speeds of {of} have the opposite sign of their positions' change"
    for j in joints:
        crossed = [max(_mismatch(slope[:, k], speed[:, j]), _mismatch(slope[:, j], speed[:, k])) for k in range(len(wrong))]
        other = [k for k in joints if k != j and crossed[k] < WRONG]
        if other:
            return f"the speeds of joints {j + 1} and {other[0] + 1} are exchanged"
    j = joints[0]
    size = _size(speed)[j]
    fast = np.abs(speed[:, j]) > 0.5 * size
    factor = np.median(slope[fast, j] / speed[fast, j]) if fast.any() and size > 0.0 else 0.0
    if _mismatch(slope[:, j], factor * speed[:, j]) < WRONG and factor > 0.0:
        return f"the positions of {of} change {factor:.3g} times as fast as their speeds say; expected 1 (or 57.3 for degrees)"
    return f"the speeds of {of} are not the change of their positions"


def _mismatch(slope: Array, speed: Array, step: float = 0.0) -> float:
    """The size of speed − slope beside that of the larger of both, by medians over the windows with motion; 0 without motion.

    Half of the windows may hold a torn row. step : in which the speed is written.
    """
    larger = np.maximum(np.abs(slope), np.abs(speed))
    informative = larger > max(0.3 * np.quantile(larger, USUAL), RESOLVED * step)
    if np.sum(informative) < FEWEST_WINDOWS:
        return 0.0
    return float(np.median(np.abs(speed - slope)[informative]) / np.median(larger[informative]))


def _size(x: Array) -> Array:
    """(J,) the 75 % quantile of |x|: a joint may rest for most of the time, and a torn row moves a fifth of the windows at most."""
    size: Array = np.quantile(np.abs(x), USUAL, axis=0)
    return size


def _ripple(x: Array) -> Array:
    """(J,) standard deviation of what changes from row to row in x (N, J), by the median of second differences."""
    with np.errstate(invalid="ignore", over="ignore"):
        ripple: Array = 1.4826 * np.nanmedian(np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2]), axis=0) / math.sqrt(6.0)
    return ripple


def _compared(x: Array, rate: Array | None, seen: Windows | None) -> tuple[Array, Array, Array, Array] | None:
    """Change of x a second (W, J), median of its rate (W, J), noise of both together (J,), sure part of the rate's lag (J,) [s].

    None with few sound windows.
    """
    if rate is None or seen is None:
        return None
    tick, length, dt, slope, speed, _ = seen
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
    for j in range(x.shape[1] if inner.any() else 0):
        left, a = slope[inner, j] - speed[inner, j], change[inner, j]
        strong = np.abs(a) > np.median(np.abs(a))
        if np.sum(strong) >= FEWEST_WINDOWS // 2 and np.all(np.abs(a[strong]) > 0.0):
            each = left[strong] / a[strong]
            middle = float(np.median(each))
            doubt = SURE * 1.5 * float(np.median(np.abs(each - middle))) / math.sqrt(len(each))
            lag[j] = math.copysign(max(0.0, abs(middle) - doubt), middle)
    return slope[sound], speed[sound], noise, lag
