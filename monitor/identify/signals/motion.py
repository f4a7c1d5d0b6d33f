"""A recording → a motion: cleaned in one pass, in the order layout, clock and units, rows, signals.

What the pass finds is kept in the motion as figures. `identify.detectors` makes the warnings of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.filters import despike, filtered, low_pass, refuse_uneven, uniform
from monitor.identify.signals.ripple import Unfiltered
from monitor.identify.signals.rows import HARMLESS, LIMITS, SoundRows, sound_rows
from monitor.identify.signals.temperature import temperatures_at
from monitor.identify.signals.units import Repaired, in_si, named
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.reason import joints_by_number
from monitor.recording import Array, Indices, Mask, Recording

OTHER_ACCELERATION = 0.5  # of the accelerations' size: a larger difference is noise, a sign or a unit
LEAST_ACCELERATION = 0.1  # [rad/s²]
ENOUGH_SAMPLES = 5.0  # times the filter's cutoff: half of it is the highest frequency, at which the filter leaves a thousandth
FEWEST_ROWS = 10  # fewer sound rows are no recording


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Filtered signals of N samples and J joints on an even clock; where the recording had a hole, `t_s` jumps."""

    repaired: Repaired  # the recording in SI units, with positions unwound
    rows: SoundRows  # those of it that were used
    t_s: Array  # (N,)
    q: Array  # (N, J) [rad]
    qd: Array  # (N, J) [rad/s]
    qdd: Array  # (N, J) [rad/s²]
    direction: Array  # (N, J) s(q̇) after the filter: a step of Coulomb friction is rounded in it as in the torque
    current: Array | None  # (N, J) [A]
    torque: Array | None  # (N, J) [N·m]; current, torque or both are there
    temperature_c: Array | None  # (N, J) [°C]
    rate_hz: float
    jumps: int = 0  # places at which the motion is not continued although no time is missing
    short_rows: int = 0  # rows between holes that are too near to each other for the filter
    low_pass: tuple[int, float] | None = None  # order and cutoff [Hz] of the filter; None: no filter
    spikes: int = 0  # readings of current or torque that were replaced
    accelerations_replaced: tuple[int, ...] = ()  # joints, numbered from 1, whose recorded q̈ is not the change of q̇
    unfiltered: Unfiltered | None = None  # the rows that were filtered, as they were measured; None without a current

    @property
    def recording(self) -> Recording:
        """The recording in SI units."""
        return self.repaired.recording

    @property
    def source(self) -> str:
        """The name of its file."""
        return self.recording.source

    @property
    def samples(self) -> int:
        """N."""
        return len(self.t_s)

    @property
    def duration_s(self) -> float:
        """Time from the first sound row to the last."""
        t_s = self.recording.t_s[self.rows.keep]
        return float(t_s[-1] - t_s[0])

    @property
    def rejected_why(self) -> dict[str, int]:
        """Number of rows left out, by reason."""
        return dict(self.rows.why) | ({"between_gaps": self.short_rows} if self.short_rows else {})

    @property
    def rejected_samples(self) -> int:
        """Number of rows left out for any reason."""
        return sum(self.rejected_why.values())

    def moving(self, threshold_rad_s: float = STANDSTILL_SPEED_RAD_S) -> Mask:
        """(N, J) where a joint is faster than the threshold."""
        return np.abs(self.qd) > threshold_rad_s

    def rounded(self, x: Array) -> Array:
        """The signal `x` (N, …) through the filter of the torque, stretch by stretch: its steps are rounded as those of the torque are."""
        if self.low_pass is None:
            return x
        smooth = low_pass(self.rate_hz, *self.low_pass)
        holes = self._holes
        return np.concatenate([smooth(stretch) for stretch in np.split(x, holes)]) if len(holes) else smooth(x)

    @property
    def redundancy(self) -> int:
        """One of so many samples says as much as all: the filter left nothing between them. 1 without a filter."""
        return 1 if self.low_pass is None else max(1, int(self.rate_hz / (ENOUGH_SAMPLES * self.low_pass[1])))

    @property
    def segments(self) -> Indices:
        """(N,) number of the stretch without a hole that each sample lies in."""
        begins = np.zeros(self.samples, dtype=np.intp)
        begins[self._holes] = 1
        return np.cumsum(begins)

    @property
    def _holes(self) -> Indices:
        """The samples before which the recording has a hole."""
        return np.flatnonzero(np.diff(self.t_s) > 1.5 / self.rate_hz) + 1

    def blocks(self, length_s: float) -> Indices:
        """(N,) number of the block of about `length_s` that each sample lies in; no block reaches over a hole."""
        numbers, following = [], 0
        for count in np.bincount(self.segments):
            blocks = max(1, round(count / self.rate_hz / length_s))
            numbers.append(following + np.arange(count) * blocks // count)
            following += blocks
        return np.concatenate(numbers)


def motion(recording: Recording, settings: SignalSettings | None = None) -> Motion:
    """The recording with its units and clock put right, without torn rows, on an even clock, filtered without delay, with q̈.

    Raises Unidentifiable with the reason where the recording cannot carry an identification.
    """
    settings = settings or SignalSettings()
    repaired = in_si(recording)
    _check_layout(repaired.recording)
    rows = _usable_rows(repaired.recording, settings)
    return _signals(_unwound(repaired, rows), rows, settings)


# --- Layout: what must be there before anything is put right ---------------------------------------------


def _check_layout(recording: Recording) -> None:
    """Raises Unidentifiable where signals are missing, or currents are of a size that no drive of an arm has."""
    name = named(recording)
    if not recording.samples:
        raise Unidentifiable(f"{name}: holds no rows; expected a recording")
    if recording.current is None and recording.torque is None:
        likely = "".join(f". {reason}" for reason in recording.told)
        raise Unidentifiable(f"{name}: holds neither current nor torque; expected actual_current or actual_torque for every joint{likely}")
    for key in LIMITS:
        value = getattr(recording, key)
        if value is None:
            continue
        missing = np.flatnonzero(~np.any(np.isfinite(value), axis=0))
        if len(missing):  # each row would count as torn
            joints = joints_by_number([int(j) + 1 for j in missing])
            raise Unidentifiable(f"{name}: {key} of {joints} holds no number in any row; expected every joint's")


# --- Rows: which are sound -------------------------------------------------------------------------------


def _usable_rows(recording: Recording, settings: SignalSettings) -> SoundRows:
    """`sound_rows` of the recording after its run-in.

    Raises Unidentifiable where too few rows are sound, the drives measured only zeros, or nothing is left after the run-in.
    """
    name, sound = named(recording), sound_rows(recording)
    keep, why = sound.keep, sound.why
    reasons = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in why.items())
    if len(keep) < FEWEST_ROWS:
        because = f" ({reasons})" if why else ""
        raise Unidentifiable(f"{name}: {len(keep)} of {recording.samples} rows are sound{because}; expected a recording")
    drive = recording.current if recording.torque is None else recording.torque
    if drive is not None and not np.any(drive[keep]):
        raise Unidentifiable(f"{name}: current or torque is zero throughout; expected what the drives measured")
    written = recording.samples - sum(why.get(reason, 0) for reason in HARMLESS)
    rejected = written - len(keep)
    if rejected > settings.max_rejected_share * written:
        raise Unidentifiable(
            f"{name}: {rejected} of {written} rows are torn ({reasons}); expected at most {settings.max_rejected_share:.0%}"
        )
    return sound if settings.run_in_s == 0.0 else _run_in_left_out(recording, sound, settings)


def _run_in_left_out(recording: Recording, sound: SoundRows, settings: SignalSettings) -> SoundRows:
    """The rows after `run_in_s` of motion, counted over the rows in which any joint moves. Raises Unidentifiable where none remain."""
    t_s, q = recording.t_s[sound.keep], recording.q[sound.keep] + sound.turns
    qd = np.gradient(q, t_s, axis=0) if recording.qd is None else recording.qd[sound.keep]
    dt = np.diff(t_s, prepend=t_s[:1])
    moving = np.any(np.abs(qd) > settings.min_speed_rad_s, axis=1) & (dt <= settings.gap_s)
    moved_s = np.cumsum(np.where(moving, dt, 0.0))
    first = int(np.searchsorted(moved_s, settings.run_in_s))
    if len(t_s) - first < FEWEST_ROWS:
        raise Unidentifiable(
            f"{named(recording)}: the arm moves for {moved_s[-1]:.3g} s, and the first {settings.run_in_s:g} s are left out as its run-in "
            f"(identify.signals.run_in_s); expected a longer motion: more repetitions, or a shorter run-in"
        )
    breaks = sound.breaks[sound.breaks > first] - first
    return sound._replace(keep=sound.keep[first:], breaks=breaks, turns=sound.turns[first:])


def _unwound(repaired: Repaired, rows: SoundRows) -> Repaired:
    """The recording with whole turns added to the positions of the sound rows, where they were wrapped into one turn."""
    if not np.any(rows.turns):
        return repaired
    q = repaired.recording.q.copy()
    q[rows.keep] += rows.turns
    return replace(repaired, recording=replace(repaired.recording, q=q))


# --- Signals: an even clock and one filter ---------------------------------------------------------------


def _signals(repaired: Repaired, rows: SoundRows, settings: SignalSettings) -> Motion:
    """The sound rows through the filter. Raises Unidentifiable where they are too sparse, too short, or hold too little motion."""
    recording = repaired.recording
    t_s = recording.t_s[rows.keep]
    measured = {key: value[rows.keep] for key in LIMITS if (value := getattr(recording, key)) is not None}
    qd = measured["qd"] if "qd" in measured else np.gradient(measured["q"], t_s, axis=0)
    dt = np.diff(t_s)
    rate_hz = 1.0 / float(np.mean(dt[dt < 1.9 * np.median(dt)]))  # jitter averages out, and holes do not count
    _refuse_poor_motion(named(recording), t_s, qd, rate_hz, settings)
    stretches = _stretches(t_s, rows.breaks, max(settings.gap_s, 3.0 / rate_hz))
    refuse_uneven(named(recording), t_s, [(part.start, part.stop) for part in stretches], rate_hz)
    unfiltered = Unfiltered(t_s, measured["q"], qd, measured["current"], stretches) if "current" in measured else None
    spikes = despike(measured) if settings.despike else 0
    order, cutoff_hz = settings.filter_order, min(settings.cutoff_hz, 0.35 * rate_hz)  # at low rates the cutoff must be lower

    def joined() -> tuple[dict[str, Array], int]:
        return _joined(t_s, measured, stretches, rate_hz, (order, cutoff_hz), settings.trim_s)

    found, short_rows = joined()
    replaced: tuple[int, ...] = ()
    if "qdd" in measured and len(found["t_s"]) and (replaced := _other_acceleration(found, rate_hz)):
        del measured["qdd"]
        found, short_rows = joined()
    usable_s = len(found["t_s"]) / rate_hz
    if usable_s < 0.8 * settings.min_duration_s:  # the filter's edges may take a fifth
        raise Unidentifiable(
            f"{named(recording)}: between its gaps {usable_s:.3g} s are usable; expected {settings.min_duration_s:g} s of unbroken rows"
        )
    temperature_c = recording.temperature_c
    return Motion(
        repaired=repaired,
        rows=rows,
        t_s=found["t_s"],
        q=found["q"],
        qd=found["qd"],
        qdd=found["qdd"],
        direction=found["direction"],
        current=found.get("current"),
        torque=found.get("torque"),
        temperature_c=None if temperature_c is None else temperatures_at(found["t_s"], t_s, temperature_c[rows.keep]),
        rate_hz=rate_hz,
        jumps=int(np.sum(dt[rows.breaks - 1] <= settings.gap_s)),
        short_rows=short_rows,
        low_pass=(order, cutoff_hz),
        spikes=spikes,
        accelerations_replaced=replaced,
        unfiltered=unfiltered,
    )


def _refuse_poor_motion(name: str, t_s: Array, qd: Array, rate_hz: float, settings: SignalSettings) -> None:
    """Raises Unidentifiable where the rate is too low, most joints stand still, or the recording is too short."""
    if rate_hz < settings.min_rate_hz * 0.99:  # a clock may be wrong by 1 %
        raise Unidentifiable(f"{name}: sampled at {rate_hz:.3g} Hz; expected at least {settings.min_rate_hz:g} Hz, better 100 Hz")
    fastest = np.quantile(np.abs(qd), 0.99, axis=0)  # (J,) not the maximum, which may be a torn sample
    moving = int(np.sum(fastest >= settings.min_speed_rad_s))
    needed = int(np.ceil(settings.min_moving_share * len(fastest)))
    if moving < needed:
        which = "the arm stands still" if moving == 0 else f"the joints that move are {moving} of {len(fastest)}"
        raise Unidentifiable(
            f"{name}: {which} (fastest {fastest.max():.3g} rad/s); friction shows only in motion: "
            f"expected {settings.min_speed_rad_s:g} rad/s or more on at least {needed} joints"
        )
    duration_s = float(t_s[-1] - t_s[0])
    if duration_s < settings.min_duration_s:
        raise Unidentifiable(f"{name}: {duration_s:.3g} s long; expected at least {settings.min_duration_s:g} s of motion")


def _stretches(t_s: Array, breaks: Indices, gap_s: float) -> list[slice]:
    """The rows of each stretch without a hole longer than `gap_s`, and without a jump of the motion at the places `breaks`."""
    edges = [0, *np.union1d(np.flatnonzero(np.diff(t_s) > gap_s) + 1, breaks).tolist(), len(t_s)]
    return [slice(first, last) for first, last in pairwise(edges)]


def _joined(
    t_s: Array, measured: Mapping[str, Array], stretches: list[slice], rate_hz: float, filter_of: tuple[int, float], trim_s: float
) -> tuple[dict[str, Array], int]:
    """The stretches, each resampled and filtered, one after the other; and the number of rows of those too short for the filter.

    filter_of : order and cutoff [Hz].
    """
    smooth, parts, short = low_pass(rate_hz, *filter_of), [], 0
    for stretch in stretches:
        part = uniform(t_s[stretch], {key: value[stretch] for key, value in measured.items()}, rate_hz)
        if len(part["t_s"]) < 2 * trim_s * rate_hz + 30:  # nothing remains between the filter's edges
            short += stretch.stop - stretch.start
            continue
        parts.append(filtered(part, rate_hz, smooth, round(trim_s * rate_hz)))
    if not parts:
        return {"t_s": t_s[:0]}, short
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}, short


def _other_acceleration(joined: Mapping[str, Array], rate_hz: float) -> tuple[int, ...]:
    """The joints, numbered from 1, whose recorded accelerations are not the change of their speeds."""
    change = np.gradient(joined["qd"], 1.0 / rate_hz, axis=0)
    size = np.quantile(np.maximum(np.abs(change), np.abs(joined["qdd"])), 0.75, axis=0)  # (J,)
    off = np.quantile(np.abs(joined["qdd"] - change), 0.75, axis=0)
    return tuple(int(j) + 1 for j in np.flatnonzero((off > OTHER_ACCELERATION * size) & (size > LEAST_ACCELERATION)))
