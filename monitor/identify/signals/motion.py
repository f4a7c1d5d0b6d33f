"""Whether recordings and a robot belong together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.cleaning import (
    ACCELERATIONS_REPLACED,
    MOTION_JUMPS,
    TURNS_UNWOUND,
    check_drives,
    check_temperatures,
    cleaned,
    named,
    plausible_temperatures,
    refuse_other_unit,
)
from monitor.identify.signals.filters import despike, filtered, low_pass, uniform
from monitor.identify.signals.order import median, quantiles
from monitor.identify.signals.ripple import Unfiltered
from monitor.identify.signals.rows import HARMLESS, LIMITS, SoundRows, sound_rows, taken
from monitor.model.friction import STANDSTILL_SPEED_RAD_S
from monitor.model.robot import Robot
from monitor.reason import Reason
from monitor.recording import Array, Indices, Mask, Recording


def refuse_other_arm(recording: Recording, robot: Robot) -> None:
    """Raises BadInput where the recording names another robot model than the one given. A recording without a name passes."""
    made_by = recording.context.robot
    if made_by is not None and made_by != robot.name:
        raise BadInput(f"{recording.source or 'recording'}: recorded on a {made_by}; the robot given is {robot.name}")


def refuse_twice(recordings: Sequence[Recording]) -> None:
    """Raises BadInput where one recording is given twice: it would count as two independent measurements."""
    for number, one in enumerate(recordings):
        for other in recordings[:number]:
            if one.samples == other.samples and np.array_equal(one.t_s, other.t_s) and np.array_equal(one.q, other.q):
                raise BadInput(f"{one.source or 'recording'} is {other.source or 'recording'} once more: it says nothing new; give it once")


# --- Recordings of arms whose motors are coupled, in the positions of the motors ------------------------


def at_motors(recording: Recording, robot: Robot) -> Recording:
    """The recording with the positions of the motors, each in units of its own joint, where it holds those of coupled joints.

    Currents are those of the motors already. In these coordinates friction belongs to one motor alone, and so does its ripple.
    """
    if robot.coupling is None or robot.recorded_at_motors or recording.joints != robot.joints:
        return recording
    return recording.changed(("q", "qd", "qdd", "target_q", "target_qd", "target_qdd"), robot.motors_of)


# --- Motion: the signals of a recording on one even clock, filtered without delay, with q̈ --------------

OTHER_ACCELERATION = 0.5  # of the accelerations' size: a larger difference is noise, a sign or a unit
LEAST_ACCELERATION = 0.1  # [rad/s²]
ENOUGH_SAMPLES = 5.0  # times the filter's cutoff: half of it is the highest frequency, at which the filter leaves a thousandth
FEWEST_ROWS = 10  # fewer sound rows are no recording


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Filtered signals of N samples and J joints on an even clock; where the recording had a hole, `t_s` jumps."""

    source: str
    t_s: Array  # (N,)
    q: Array  # (N, J) [rad]
    qd: Array  # (N, J) [rad/s]
    qdd: Array  # (N, J) [rad/s²]
    direction: Array  # (N, J) s(q̇) after the filter: a step of Coulomb friction is rounded in it as in the torque
    current: Array | None  # (N, J) [A]
    torque: Array | None  # (N, J) [N·m]; current, torque or both are there
    temperature_c: Array | None  # (N, J) [°C]
    rate_hz: float
    duration_s: float  # of the recording
    recorded_samples: int  # before rejection, resampling and trimming
    rejected_why: Mapping[str, int]  # number of rows left out, by reason
    current_is_target: bool  # current and target current are equal bit for bit: a simulator, not a drive
    low_pass: tuple[int, float] | None = None  # order and cutoff [Hz] of the filter; None: no filter
    repaired_samples: int = 0  # spikes of current or torque that were replaced
    repairs: tuple[Reason, ...] = ()  # what was corrected in the recording as a whole
    unfiltered: Unfiltered | None = None  # the rows that were filtered, as they were measured; None without a current

    @property
    def samples(self) -> int:
        """N."""
        return len(self.t_s)

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
    """The recording with its units and clock corrected, without torn rows, on an even clock, filtered without delay, with q̈.

    Raises Unidentifiable with the reason where the recording cannot carry an identification.
    """
    settings = settings or SignalSettings()
    if not recording.samples:
        raise Unidentifiable(f"{named(recording)}: holds no rows; expected a recording")
    _drive(recording)  # refuses before anything is corrected
    refuse_other_unit(recording)
    recording, repairs = cleaned(recording)
    sound = _run_in_left_out(recording, _usable_rows(recording, settings), settings)
    keep, why = sound.keep, dict(sound.why)
    wound = np.flatnonzero(np.any(sound.turns != 0.0, axis=0))
    if len(wound):
        unwound = recording.q.copy()
        unwound[keep] += sound.turns
        recording = replace(recording, q=unwound)
        repairs = (*repairs, TURNS_UNWOUND(source=named(recording), joints=wound + 1))
    t_s = taken(recording.t_s, keep)
    jumps = int(np.sum(np.diff(t_s)[sound.breaks - 1] <= settings.gap_s))
    if jumps:
        repairs = (*repairs, MOTION_JUMPS(source=named(recording), jumps=jumps))
    rate_hz = _rate(t_s)
    _refuse_poor_motion(recording, keep, rate_hz, settings)

    repairs = (*repairs, *check_drives(recording, keep))
    measured = {key: taken(value, keep) for key in LIMITS if (value := getattr(recording, key)) is not None}
    cutoff_hz = min(settings.cutoff_hz, 0.35 * rate_hz)  # at low rates the cutoff must be lower
    stretches = _Stretches(t_s, sound.breaks)
    unfiltered = _unfiltered(measured, stretches, max(settings.gap_s, 3.0 / rate_hz))
    repaired = despike(measured) if settings.despike else 0
    joined = _joined(recording, stretches, measured, rate_hz, cutoff_hz, settings, why)
    if "qdd" in measured and (wrong := _other_acceleration(joined, rate_hz)):
        del measured["qdd"]
        joined = _joined(recording, stretches, measured, rate_hz, cutoff_hz, settings, why)
        repairs = (*repairs, ACCELERATIONS_REPLACED(source=named(recording), joints=wrong))
    temperature_c = _temperature(recording, keep, joined["t_s"])
    repairs = (*repairs, *check_temperatures(recording))
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
        duration_s=float(t_s[-1] - t_s[0]),
        recorded_samples=recording.samples,
        rejected_why=why,
        current_is_target=_same(recording.current, recording.target_current),
        low_pass=(settings.filter_order, cutoff_hz),
        repaired_samples=repaired,
        repairs=repairs,
        unfiltered=unfiltered,
    )


def _name(recording: Recording) -> str:
    return recording.source or "recording"


def _drive(recording: Recording) -> Array:
    """What the drives measured: torque, else current. Raises Unidentifiable where the recording has neither."""
    drive = recording.current if recording.torque is None else recording.torque
    if drive is None:
        raise Unidentifiable(
            f"{named(recording)}: holds neither current nor torque; expected actual_current or actual_torque for every joint"
        )
    return drive


class _Stretches(NamedTuple):
    """The clock of the rows that are used, and the places before which the motion jumps."""

    t_s: Array  # (N,)
    breaks: Indices

    def longer_than(self, gap_s: float) -> list[slice]:
        """The rows of each stretch without a jump and without a hole longer than `gap_s`."""
        holes = np.flatnonzero(np.diff(self.t_s) > gap_s) + 1
        edges = [0, *np.union1d(holes, self.breaks).tolist(), len(self.t_s)]
        return [slice(first, last) for first, last in pairwise(edges)]


def _usable_rows(recording: Recording, settings: SignalSettings) -> SoundRows:
    """`sound_rows` of the recording. Raises Unidentifiable where too few rows are sound, or the drives measured only zeros."""
    name = named(recording)
    _refuse_missing(recording)
    sound = sound_rows(recording)
    keep, why = sound.keep, sound.why
    if len(keep) < FEWEST_ROWS:
        reasons = f" ({_reasons(why)})" if why else ""
        raise Unidentifiable(f"{name}: {len(keep)} of {recording.samples} rows are sound{reasons}; expected a recording")
    if not np.any(taken(_drive(recording), keep)):
        raise Unidentifiable(f"{name}: current or torque is zero throughout; expected what the drives measured")
    written = recording.samples - sum(why.get(reason, 0) for reason in HARMLESS)
    rejected = written - len(keep)
    if rejected > settings.max_rejected_share * written:
        raise Unidentifiable(
            f"{name}: {rejected} of {written} rows are torn ({_reasons(why)}); expected at most {settings.max_rejected_share:.0%}"
        )
    return sound


def _run_in_left_out(recording: Recording, sound: SoundRows, settings: SignalSettings) -> SoundRows:
    """The rows after `run_in_s` of motion, counted over the rows in which any joint moves. Raises Unidentifiable where none remain."""
    if settings.run_in_s == 0.0:
        return sound
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


def _refuse_missing(recording: Recording) -> None:
    """Raises Unidentifiable where a signal of some joints holds no number at all: each row would count as torn."""
    for key in LIMITS:
        value = getattr(recording, key)
        if value is None:
            continue
        missing = np.flatnonzero(~np.any(np.isfinite(value), axis=0))
        if 0 < len(missing) < recording.joints:
            joints = f"joint{'s' if len(missing) > 1 else ''} {', '.join(str(j + 1) for j in missing)}"
            raise Unidentifiable(f"{named(recording)}: {key} of {joints} holds no number in any row; expected every joint's")


def _refuse_poor_motion(recording: Recording, keep: Indices, rate_hz: float, settings: SignalSettings) -> None:
    """Raises Unidentifiable where the rate is too low, most joints stand still, or the recording is too short."""
    name, t_s = named(recording), taken(recording.t_s, keep)
    if rate_hz < settings.min_rate_hz * 0.99:  # a clock may be wrong by 1 %
        raise Unidentifiable(f"{name}: sampled at {rate_hz:.3g} Hz; expected at least {settings.min_rate_hz:g} Hz, better 100 Hz")
    qd = taken(recording.qd, keep) if recording.qd is not None else np.gradient(recording.q[keep], t_s, axis=0)
    fastest = quantiles(np.abs(qd), 0.99)  # (J,) not the maximum, which may be a torn sample
    moving = int(np.sum(fastest >= settings.min_speed_rad_s))
    needed = int(np.ceil(settings.min_moving_share * recording.joints))
    if moving < needed:
        which = "the arm stands still" if moving == 0 else f"the joints that move are {moving} of {recording.joints}"
        raise Unidentifiable(
            f"{name}: {which} (fastest {fastest.max():.3g} rad/s); friction shows only in motion: "
            f"expected {settings.min_speed_rad_s:g} rad/s or more on at least {needed} joints"
        )
    duration_s = float(t_s[-1] - t_s[0])
    if duration_s < settings.min_duration_s:
        raise Unidentifiable(f"{name}: {duration_s:.3g} s long; expected at least {settings.min_duration_s:g} s of motion")


def _joined(
    recording: Recording,
    stretches: _Stretches,
    measured: dict[str, Array],
    rate_hz: float,
    cutoff_hz: float,
    settings: SignalSettings,
    why: dict[str, int],
) -> dict[str, Array]:
    """The unbroken stretches, each resampled and filtered, one after the other.

    The rows of stretches that are too short for the filter are counted in `why`. Raises Unidentifiable where too little remains.
    """
    smooth = low_pass(rate_hz, settings.filter_order, cutoff_hz)
    parts = []
    short = 0
    for segment in stretches.longer_than(max(settings.gap_s, 3.0 / rate_hz)):
        part = uniform(stretches.t_s[segment], {key: value[segment] for key, value in measured.items()}, rate_hz)
        if len(part["t_s"]) < 2 * settings.trim_s * rate_hz + 30:  # nothing remains between the filter's edges
            short += segment.stop - segment.start
            continue
        parts.append(filtered(part, rate_hz, smooth, round(settings.trim_s * rate_hz)))
    if short:
        why["between_gaps"] = short
    usable_s = sum(len(part["t_s"]) for part in parts) / rate_hz
    if usable_s < 0.8 * settings.min_duration_s:  # the filter's edges may take a fifth
        raise Unidentifiable(
            f"{named(recording)}: between its gaps {usable_s:.3g} s are usable; expected {settings.min_duration_s:g} s of unbroken rows"
        )
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _unfiltered(measured: Mapping[str, Array], stretches: _Stretches, gap_s: float) -> Unfiltered | None:
    """The sound rows as they were measured; None without a current."""
    if "current" not in measured:
        return None
    q, qd = measured["q"], measured.get("qd")
    qd = np.gradient(q, stretches.t_s, axis=0) if qd is None else qd
    return Unfiltered(stretches.t_s, q, qd, measured["current"], stretches.longer_than(gap_s))


def _reasons(why: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in why.items()) or "no rows"


def _same(a: Array | None, b: Array | None) -> bool:
    """Whether both signals are there, equal bit for bit, and not all zero."""
    return a is not None and b is not None and bool(np.array_equal(a, b)) and bool(np.any(a != 0.0))


def _rate(t_s: Array) -> float:
    """Mean samples a second within unbroken stretches [Hz]: jitter averages out, and holes do not count."""
    dt = np.diff(t_s)
    whole = dt < 1.9 * median(dt)
    rate: float = 1.0 / float(np.mean(dt[whole]))
    return rate


def _other_acceleration(joined: dict[str, Array], rate_hz: float) -> list[int]:
    """The joints, numbered from 1, whose recorded accelerations are not the change of their speeds."""
    change = np.gradient(joined["qd"], 1.0 / rate_hz, axis=0)
    size = quantiles(np.maximum(np.abs(change), np.abs(joined["qdd"])), 0.75)  # (J,)
    off = quantiles(np.abs(joined["qdd"] - change), 0.75)
    return [int(j) + 1 for j in np.flatnonzero((off > OTHER_ACCELERATION * size) & (size > LEAST_ACCELERATION))]


def _temperature(recording: Recording, keep: Indices, t_s: Array) -> Array | None:
    """(N, J) measured temperatures at the times t_s (N,) [°C]; NaN for a joint without a plausible reading; None without any."""
    if recording.temperature_c is None:
        return None
    measured_s, measured = taken(recording.t_s, keep), taken(recording.temperature_c, keep)
    temperature_c = np.empty((len(t_s), measured.shape[1]), order="F")
    for j, sensible in enumerate(plausible_temperatures(measured).T):
        sound_s, sound = (measured_s, measured[:, j]) if sensible.all() else (measured_s[sensible], measured[sensible, j])
        temperature_c[:, j] = np.interp(t_s, sound_s, sound) if len(sound) else np.nan
    return temperature_c


# --- Joint torque, as the drives report it --------------------------------------------------------------

GAIN_NM_PER_A = (1e-3, 1e4)  # plausible torque per ampere: from a small servo to ten times the largest joint of any arm


def joint_torque(motion: Motion, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m] of a motion. Raises BadInput as `drive_torque`, and where the robot has another number of joints."""
    name = motion.source or "recording"
    if motion.q.shape[1] != robot.joints:
        raise BadInput(f"{name}: has {motion.q.shape[1]} joints; {robot.name} has {robot.joints}")
    return drive_torque(name, motion.torque, motion.current, robot, gains)


def drive_torque(name: str, torque: Array | None, current: Array | None, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m]: the measured torque where there is one, else current × gain.

    gains : (J,) torque per ampere at the joint [N·m/A]; None for the published torque constant × gear ratio, Raviola et al. (2021),
    table 2. Raises BadInput where there is neither torque nor current, or gains are missing or implausible.
    """
    if gains is not None and (gains.shape != (robot.joints,) or not np.all((gains >= GAIN_NM_PER_A[0]) & (gains <= GAIN_NM_PER_A[1]))):
        least, most = GAIN_NM_PER_A
        given = np.array2string(np.asarray(gains), separator=",")
        raise BadInput(f"--gains: {given}; expected {robot.joints} numbers between {least:g} and {most:g} [N·m/A]")
    if torque is not None and (gains is None or current is None):
        return torque
    if current is None:
        raise BadInput(f"{name}: holds neither current nor torque; expected actual_current or actual_torque for every joint")
    if gains is None:
        gains = robot.drive_gain_nm_per_a
        if not np.all(np.isfinite(gains)):
            raise BadInput(
                f"{robot.name}: the torque constants of this model are not published; give the joint gains "
                f"as --gains with {robot.joints} numbers [N·m/A], in a configuration as robot.gains_nm_per_a, or record torque"
            )
    driven: Array = current * gains
    return driven


# --- The joints' temperatures over whole recordings -----------------------------------------------------


def mean_temperature(motions: Sequence[Motion]) -> Array | None:
    """(J,) mean over all samples of all motions [°C]; None where one of them has no temperatures."""
    measured = [moved.temperature_c for moved in motions if moved.temperature_c is not None]
    if len(measured) < len(motions):
        return None
    mean: Array = np.mean(np.concatenate(measured), axis=0)
    return mean


def warming(recordings: Sequence[Recording]) -> Array | None:
    """(J,) slope of temperature over time [K/min], the mean over the recordings; None where one of them does not determine it."""
    slopes = []
    for recording in recordings:
        if recording.temperature_c is None:
            return None
        good = plausible_temperatures(recording.temperature_c) & np.isfinite(recording.t_s)[:, None]
        if good.all():  # most often
            slope = _slopes(recording.t_s, recording.temperature_c)
        else:
            each = zip(recording.temperature_c.T, good.T, strict=True)
            slope = np.concatenate([_slopes(recording.t_s[on], column[on, None]) for column, on in each])
        if np.any(np.isnan(slope)):
            return None
        slopes.append(slope)
    mean: Array = np.mean(slopes, axis=0)
    return mean


def _slopes(t_s: Array, temperature_c: Array) -> Array:
    """(J,) slope of each column (N, J) over time [K/min]; NaN where no time passes."""
    if len(t_s) < 2 or not np.ptp(t_s) > 0.0:
        return np.full(temperature_c.shape[1], np.nan)
    t = t_s - np.mean(t_s)
    slopes: Array = 60.0 * (t @ temperature_c) / (t @ t)
    return slopes
