"""Signals: one clock, no lag, q̈; torn rows found and counted.

What goes in is a Recording as the controller sent it; what comes out is a Motion that the regressor can be evaluated on. All
signals pass the same filter, forward and backward: a lag between current and speed would read as viscous friction.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval

from monitor.errors import Unidentifiable
from monitor.identify.signals.clean import Repair, cleaned
from monitor.model.friction import smooth_sign
from monitor.recording import Array, Indices, Mask, Recording

STANDSTILL_SPEED_RAD_S = 0.02  # slower than this Coulomb friction is stiction and holding torque is history
MAX_POSITION_RAD = 1000.0  # the last joint of some models turns without end, but not 160 turns in a row
MAX_SPEED_RAD_S = 20.0  # three times the fastest joint of any UR
MAX_ACCELERATION_RAD_S2 = 1000.0  # an emergency stop stays below 100
MAX_CURRENT_A = 200.0  # an order above what the drives can carry
MAX_TORQUE_NM = 5000.0  # an order above the largest joint's
MAX_TEMPERATURE_C = 200.0
SPIKE_WINDOW = 7  # samples: three spikes in a row are outvoted
SPIKE_STD = 8.0  # ripple and noise of a real drive stay below 6
SPIKE_FLOOR = 0.01  # of the largest reading: where there is no noise, a bend is no spike

_LIMITS = {"q": MAX_POSITION_RAD, "qd": MAX_SPEED_RAD_S, "qdd": MAX_ACCELERATION_RAD_S2, "current": MAX_CURRENT_A, "torque": MAX_TORQUE_NM}


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSettings:
    """How a recording becomes a motion."""

    cutoff_hz: Annotated[float, Interval(ge=0.5, le=50.0)] = (
        8.0  # above the excitation's harmonics, below the drives' ripple and the encoder's noise after d/dt
    )
    filter_order: Annotated[int, Interval(ge=1, le=6)] = 2  # once forward, once backward: 4 in effect
    trim_s: Annotated[float, Interval(ge=0.0, le=5.0)] = 0.2  # at each end, where filtfilt guesses the signal's continuation
    gap_s: Annotated[float, Interval(ge=1e-6, le=5.0)] = 0.25  # a longer hole is not bridged: the motion within it is unknown
    min_rate_hz: Annotated[float, Interval(ge=5.0, le=500.0)] = 10.0  # slower, q̈ from differences is fiction
    min_duration_s: Annotated[float, Interval(ge=2.0, le=600.0)] = 5.0  # half a period of the paper's excitation
    min_speed_rad_s: Annotated[float, Interval(ge=1e-6, le=1.0)] = 0.05  # a joint that never gets faster does not move
    min_moving_share: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.5  # of the joints
    despike: bool = False  # repair single readings of current and torque that stand out
    max_rejected_share: Annotated[float, Interval(ge=0.0, le=0.9)] = (
        0.2  # more torn rows than that, and the rest is not to be trusted either
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Filtered signals on a uniform clock; where the recording had a hole, `t_s` jumps."""

    source: str
    t_s: Array  # (N,)
    q: Array  # (N, J) [rad]
    qd: Array  # (N, J) [rad/s]
    qdd: Array  # (N, J) [rad/s²]
    direction: Array  # (N, J) s(q̇) through the filter of the torque: as round as the step that Coulomb friction left there
    current: Array | None  # (N, J) [A]
    torque: Array | None  # (N, J) [N·m]; one of current and torque is there
    temperature_c: Array | None  # (N, J)
    rate_hz: float
    duration_s: float  # of the recording
    recorded_samples: int  # before rejection, resampling and trimming
    rejected_why: Mapping[str, int]  # rows dropped, by reason
    current_is_target: bool  # bit for bit: no drive was there to be measured
    low_pass: tuple[int, float] | None = None  # order and cutoff [Hz] of the filter the signals passed; None: none
    repaired_samples: int = 0  # readings of current or torque that stood out alone and were replaced
    repairs: tuple[Repair, ...] = ()  # what was put right in the recording as a whole

    @property
    def samples(self) -> int:
        """N."""
        return len(self.t_s)

    @property
    def rejected_samples(self) -> int:
        """Rows dropped for any reason."""
        return sum(self.rejected_why.values())

    def moving(self, threshold_rad_s: float = STANDSTILL_SPEED_RAD_S) -> Mask:
        """(N, J) of bool: where a joint is faster than the threshold."""
        return np.abs(self.qd) > threshold_rad_s

    def rounded(self, x: Array) -> Array:
        """X (N, …) through the filter that the torque passed, stretch by stretch: as round as the steps there."""
        if self.low_pass is None:
            return x
        low_pass = _low_pass(self.rate_hz, *self.low_pass)
        stretches = np.split(x, np.flatnonzero(np.diff(self.segments)) + 1)
        return np.concatenate([low_pass(stretch) for stretch in stretches])

    @property
    def segments(self) -> Indices:
        """(N,) of int: number of the stretch without a hole that each sample lies in."""
        return np.cumsum(np.diff(self.t_s, prepend=self.t_s[:1]) > 1.5 / self.rate_hz)

    def blocks(self, length_s: float) -> Indices:
        """(N,) of int: number of the block of about `length_s` that each sample lies in; no block spans a hole."""
        numbers, following = [], 0
        for count in np.bincount(self.segments):
            blocks = max(1, round(count / self.rate_hz / length_s))
            numbers.append(following + np.arange(count) * blocks // count)
            following += blocks
        return np.concatenate(numbers)


def motion(recording: Recording, settings: SignalSettings | None = None) -> Motion:
    """The recording, cleaned, on one clock, filtered without lag, with q̈.

    Raises Unidentifiable, naming the reason, where the recording cannot carry an identification.
    """
    settings = settings or SignalSettings()
    name = recording.source or "recording"
    if recording.current is None and recording.torque is None:
        raise Unidentifiable(f"{name}: holds neither current nor torque; expected actual_current or actual_torque for every joint")
    recording, repairs = cleaned(recording)
    keep, why = _sound_rows(recording)
    if len(keep) < 10:
        told = f" ({_told(why)})" if why else ""
        raise Unidentifiable(f"{name}: {len(keep)} of {recording.samples} rows are sound{told}; expected a recording")
    drive = recording.current if recording.torque is None else recording.torque
    if drive is not None and not np.any(drive[keep]):
        raise Unidentifiable(f"{name}: current or torque is zero throughout; expected what the drives measured")
    rejected = recording.samples - len(keep)
    if rejected > settings.max_rejected_share * recording.samples:
        raise Unidentifiable(
            f"{name}: {rejected} of {recording.samples} rows are torn ({_told(why)}); expected at most {settings.max_rejected_share:.0%}"
        )
    t_s = recording.t_s[keep]
    rate_hz = _rate(t_s)
    duration_s = float(t_s[-1] - t_s[0])
    if rate_hz < settings.min_rate_hz * 0.99:  # a clock that is 1 % slow is still that clock
        raise Unidentifiable(f"{name}: sampled at {rate_hz:.3g} Hz; expected at least {settings.min_rate_hz:g} Hz, better 100 Hz")
    _refuse_standstill(name, recording, keep, t_s, settings)
    if duration_s < settings.min_duration_s:
        raise Unidentifiable(f"{name}: {duration_s:.3g} s long; expected at least {settings.min_duration_s:g} s of motion")

    measured = {key: value[keep] for key in _LIMITS if (value := getattr(recording, key)) is not None}
    cutoff_hz = min(settings.cutoff_hz, 0.35 * rate_hz)  # at low rates the cutoff gives way
    low_pass = _low_pass(rate_hz, settings.filter_order, cutoff_hz)
    repaired = _despiked(measured) if settings.despike else 0
    parts = []
    short = 0
    for segment in _segments(t_s, max(settings.gap_s, 3.0 / rate_hz)):
        part = _uniform(t_s[segment], {key: value[segment] for key, value in measured.items()}, rate_hz)
        if len(part["t_s"]) < 2 * settings.trim_s * rate_hz + 30:  # nothing is left between the filter's edges
            short += len(segment)
            continue
        parts.append(_filtered(part, rate_hz, low_pass, round(settings.trim_s * rate_hz)))
    if short:
        why["between_gaps"] = short
    usable_s = sum(len(part["t_s"]) for part in parts) / rate_hz
    if usable_s < 0.8 * settings.min_duration_s:  # the filter's edges may cost a fifth
        raise Unidentifiable(
            f"{name}: between its gaps {usable_s:.3g} s are usable; expected {settings.min_duration_s:g} s of unbroken rows"
        )
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    temperature_c = _temperature(recording, keep, joined["t_s"])
    return Motion(
        source=recording.source,
        t_s=joined["t_s"],
        q=joined["q"],
        qd=joined["qd"],
        qdd=joined["qdd"],
        direction=joined["direction"],
        current=joined.get("current"),
        torque=joined.get("torque"),
        temperature_c=temperature_c,
        rate_hz=rate_hz,
        duration_s=duration_s,
        recorded_samples=recording.samples,
        rejected_why=why,
        current_is_target=_same(recording.current, recording.target_current),
        low_pass=(settings.filter_order, cutoff_hz),
        repaired_samples=repaired,
        repairs=repairs,
    )


def _told(why: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in why.items()) or "no rows"


def _same(a: Array | None, b: Array | None) -> bool:
    return a is not None and b is not None and bool(np.array_equal(a, b)) and bool(np.any(a != 0.0))


def _sound_rows(recording: Recording) -> tuple[Indices, dict[str, int]]:
    """Indices of the rows to keep, and how many were dropped why. Columns that nobody reads may hold what they like."""
    read = {"t_s": recording.t_s} | {key: getattr(recording, key) for key in _LIMITS}
    rows = {key: value.reshape(len(value), -1) for key, value in read.items() if value is not None}
    finite = np.all([np.isfinite(value).all(axis=1) for value in rows.values()], axis=0)
    with np.errstate(invalid="ignore"):
        plausible = np.all([(np.abs(rows[key]) <= limit).all(axis=1) for key, limit in _LIMITS.items() if key in rows], axis=0)
    why = {"not_finite": int(np.sum(~finite)), "absurd_value": int(np.sum(finite & ~plausible))}
    keep = np.flatnonzero(finite & plausible)
    in_order = _longest_increasing(recording.t_s[keep])
    why["time_not_increasing"] = len(keep) - len(in_order)
    keep = keep[in_order]
    steady = ~_jumps(recording.t_s[keep], recording.q[keep])
    why["position_jump"] = int(np.sum(~steady))
    return keep[steady], {reason: count for reason, count in why.items() if count}


def _longest_increasing(t_s: Array) -> Indices:
    """Indices of the longest strictly increasing subsequence: one torn time, ahead or behind, costs one row and no more."""
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
    """(N,) of bool: rows whose position neither neighbour could have reached, while the neighbours reach each other."""
    jump = np.zeros(len(q), dtype=bool)
    if len(q) < 3:
        return jump
    dt = np.diff(t_s)[:, None]
    reach = 0.01 + MAX_SPEED_RAD_S * dt  # 0.01 rad of encoder and rounding
    far = np.abs(np.diff(q, axis=0)) > reach
    close = np.abs(q[2:] - q[:-2]) <= reach[1:] + reach[:-1]
    jump[1:-1] = np.any(far[:-1] & far[1:] & close, axis=1)
    jump[0], jump[-1] = np.any(far[0] & ~far[1]), np.any(far[-1] & ~far[-2])
    return jump


def _rate(t_s: Array) -> float:
    """Samples a second within unbroken stretches, so that jitter averages out and holes do not count [Hz]."""
    dt = np.diff(t_s)
    whole = dt < 1.9 * np.median(dt)
    rate: float = 1.0 / float(np.mean(dt[whole]))
    return rate


def _refuse_standstill(name: str, recording: Recording, keep: Indices, t_s: Array, settings: SignalSettings) -> None:
    """Raises Unidentifiable where most joints never move."""
    qd = recording.qd[keep] if recording.qd is not None else np.gradient(recording.q[keep], t_s, axis=0)
    fastest = np.percentile(np.abs(qd), 99.0, axis=0)  # (J,) not the maximum: one torn sample is no motion
    moving = int(np.sum(fastest >= settings.min_speed_rad_s))
    needed = int(np.ceil(settings.min_moving_share * recording.joints))
    if moving < needed:
        which = "the arm stands still" if moving == 0 else f"the joints that move are {moving} of {recording.joints}"
        raise Unidentifiable(
            f"{name}: {which} (fastest {fastest.max():.3g} rad/s); friction shows only in motion: "
            f"expected {settings.min_speed_rad_s:g} rad/s or more on at least {needed} joints"
        )


def _segments(t_s: Array, gap_s: float) -> list[Indices]:
    """Indices of each stretch without a hole longer than `gap_s`."""
    return np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(t_s) > gap_s) + 1)


def _uniform(t_s: Array, signals: dict[str, Array], rate_hz: float) -> dict[str, Array]:
    """The signals on an even clock. All by the same cubic, so that none is smoothed or shifted more than another."""
    even_s = t_s[0] + np.arange(int((t_s[-1] - t_s[0]) * rate_hz + 1e-6) + 1) / rate_hz
    if len(even_s) == len(t_s) and np.max(np.abs(even_s - t_s)) < 0.01 / rate_hz:
        return {"t_s": t_s, **signals}
    if len(t_s) < 4:
        return {"t_s": even_s[:0], **{key: value[:0] for key, value in signals.items()}}
    from scipy.interpolate import CubicSpline

    return {"t_s": even_s, **{key: np.asarray(CubicSpline(t_s, value)(even_s)) for key, value in signals.items()}}


def _low_pass(rate_hz: float, order: int, cutoff_hz: float) -> Callable[[Array], Array]:
    """Zero-phase Butterworth."""
    from scipy.signal import butter, sosfiltfilt  # 1 s: only where a recording is identified

    sos = butter(order, cutoff_hz, fs=rate_hz, output="sos")
    return lambda x: np.asarray(sosfiltfilt(sos, x, axis=0, padtype="odd", padlen=min(len(x) - 1, round(3 * rate_hz / cutoff_hz))))


def _despiked(measured: dict[str, Array]) -> int:
    """Replace, in place, readings of current and torque that stand out alone by the median of the seven around; returns how many.

    The linear filter would smear each over its neighbours, where no weighting finds it any more. A step is not touched: a running
    median follows it.
    """
    from scipy.ndimage import median_filter

    repaired = 0
    for key in measured.keys() & {"current", "torque"}:
        value = measured[key]
        middle = median_filter(value, size=(SPIKE_WINDOW, 1), mode="nearest")  # (N, J)
        off = np.abs(value - middle)
        # (J,) by the upper tenth, not the median: on a steep stretch a reading is itself the median, and half of them are 0
        spread = np.quantile(off, 0.9, axis=0) / 1.645
        spikes = off > SPIKE_STD * np.maximum(spread, SPIKE_FLOOR * np.max(np.abs(middle), axis=0))
        measured[key] = np.where(spikes, middle, value)
        repaired += int(np.sum(spikes))
    return repaired


def _filtered(part: dict[str, Array], rate_hz: float, low_pass: Callable[[Array], Array], trim: int) -> dict[str, Array]:
    """Every signal filtered alike; q̇ and q̈ by central differences where they were not recorded."""
    smooth = {key: low_pass(value) for key, value in part.items() if key != "t_s"}
    if "qd" not in smooth:
        smooth["qd"] = np.gradient(smooth["q"], 1.0 / rate_hz, axis=0)
    if "qdd" not in smooth:
        smooth["qdd"] = np.gradient(smooth["qd"], 1.0 / rate_hz, axis=0)
    smooth["direction"] = low_pass(smooth_sign(smooth["qd"]))
    # one more sample each end for the one-sided differences there
    inner = slice(trim + 1, len(part["t_s"]) - trim - 1)
    return {"t_s": part["t_s"][inner], **{key: value[inner] for key, value in smooth.items()}}


def _temperature(recording: Recording, keep: Indices, t_s: Array) -> Array | None:
    """(N, J) the measured temperatures at the motion's times; a joint that nothing sensible was read from is NaN."""
    if recording.temperature_c is None:
        return None
    columns = []
    for column in recording.temperature_c[keep].T:
        sensible = np.isfinite(column) & (np.abs(column) < MAX_TEMPERATURE_C)
        columns.append(np.interp(t_s, recording.t_s[keep][sensible], column[sensible]) if sensible.any() else np.full(len(t_s), np.nan))
    return np.stack(columns, axis=1)
