"""What the reader of an identification is warned of: `DETECTORS`, one table with a row for each detector.

A detector is a function from what one step has made to the warnings that it finds, most often none. The steps are

    Together    the recordings that are fitted together
    Repaired    one recording with its clock and units put right
    Motion      its sound rows, filtered
    Fitted      the parameters and residuals of all recordings
    HeldOut     recordings that are predicted, beside those that are fitted
    Predicted   how well one of them is predicted

A new detector is a function, its sentence, and a row. Those of a fit stand in `diagnosis`, all others below the table.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from monitor.identify import diagnosis as fit
from monitor.identify.diagnosis import Fitted
from monitor.identify.gain_check import GAIN_DOUBTFUL
from monitor.identify.mounting import MOUNTING_CONTRADICTION
from monitor.identify.signals.motion import Motion
from monitor.identify.signals.temperature import plausible_temperatures
from monitor.identify.signals.units import DOUBTFUL, MOVING_RAD_S, Repaired, named
from monitor.identify.signals.usable import SIGNAL_CONSTANT, SIGNAL_EMPTY
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Indices, Mask, Recording

LOW_RATE_HZ = 50.0  # at a lower rate, reversals fall between samples
TEMPERATURE_DRIFT_K = 1.0  # over this change of temperature fv changes by about 2 %
LATE_S = 0.008  # by which speeds may lag; on real controllers they lag by less than 2 ms
STUCK_S = 0.2  # a drive's noise changes the current in every tick; of real arms two readings in a row are equal, never three
STUCK_ROWS = 8
STUCK_SHARE = 0.01  # fraction of the moving rows
HELD_S = 0.02  # mean time between changes: half of it is a delay
PILE_ROWS = 8  # so many readings at the very largest value …
PILE = 2.0  # … and so many times as many as within a fiftieth of the range below it: cut off there
NEAR = 0.02
SMOOTH = 0.02  # of the largest bends: between two readings an interpolated signal has none, and noise has
SELDOM_HZ = 1.0  # bends that are fewer are torn rows
MOSTLY = 0.6  # of the rows lie between two readings
DIGIT = 1e-9  # of the range: a smaller difference of two readings is none of their last digit
BENDS_AT_HZ = 125.0, 62.0  # rates at which bends are looked for beside that of the file: in quicker rows they drown in rounding
COLD_C = -20.0  # in which no arm works
APART_K = 35.0  # of one joint from the median joint: in warm-up curves of real arms 17 K
TWICE = 2.0  # times the residual of the fit, which another motion and another day may leave
HOT_C = 65.0  # all joints of a working arm are colder: 20–45 °C, which are 68–113 °F

MIXED_PAYLOAD = Sentence("mixed_payload", "the recordings differ in payload or tool: one set of parameters cannot fit them all")
CLOCK_UNCHECKED = Sentence(
    "clock_unchecked", "{source}: holds no speeds (actual_qd), so nothing checks its clock, and friction is wrong where the clock is"
)
CLOCK_JUMP = Sentence("clock_jump", "{source}: the clock was set {jumps} times; the time in between is unknown; put right")
CLOCK_RESTORED = Sentence("clock_restored", "{source}: times are written in steps of {step:.3g}, coarser than the ticks; put right")
CLOCK_OF_ARRIVALS = Sentence(
    "clock_of_arrivals", "{source}: times are those of arrival, {rows:.2g} rows at once in the mean; an even clock stands in their place"
)
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
REJECTED_ROWS = Sentence("rejected_rows", "{source}: {rejected} of {recorded} rows were left out: {why}")
TURNS_UNWOUND = Sentence("turns_unwound", "{source}: positions of joints {joints} jumped by whole turns; put right")
MOTION_JUMPS = Sentence(
    "motion_jumps", "{source}: the motion jumps {jumps} times, as where recordings are put together; each part is filtered alone"
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
INTERPOLATED = Sentence(
    "interpolated",
    "{source}: the {drive:word} was measured at {rate_hz:.2g} Hz and interpolated between: what is quicker is missing, "
    "and friction with it",
)
ACCELERATIONS_REPLACED = Sentence(
    "accelerations_replaced",
    "{source}: the accelerations of joints {joints} are not the change of the speeds: "
    "differences of the speeds stand in for all; put right",
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
REPAIRED_SPIKES = Sentence("repaired_spikes", "{source}: {count} readings of current or torque stood out alone and were repaired")
CURRENT_IS_TARGET = Sentence(
    "current_is_target", "{source}: the actual current equals the target's bit for bit: this is a simulator's, not an arm's"
)
LOW_RATE = Sentence("low_rate", "{source}: {rate_hz:.3g} Hz blurs reversals and accelerations; 100 Hz or more is better")
PAYLOAD = Sentence("payload", "{source}: a payload of {payload_kg:g} kg is part of the last link's parameters and of the load on friction")
TEMPERATURE_DRIFT = Sentence(
    "temperature_drift", "{source}: joint {joint} changed by {swing_k:.1f} K: viscous friction is that of the mean"
)
VALIDATED_ON_FITTED = Sentence("validated_on_fitted", "{source}: was fitted too, as {fitted}: its error says nothing about other motions")
FITTED_TOGETHER = Sentence(
    "fitted_together",
    "{fitted} are fitted together; held out of the fit: {held_out} (each held-out file has its own --validate)",
)


HELD_OUT_POOR = Sentence(
    "held_out_poor",
    "{source}: the model misses up to {share:.0%} of the torque (joints {joints}), and up to {fitted:.0%} where it was fitted{why}",
)
HELD_OUT_AT_REST = Sentence(
    "held_out_at_rest",
    "{source}: where joints {joints} stand still the model is off by {times:.0f} times their torque: the motion that was fitted does "
    "not tell what holds them; expected a motion that excites more, or --method consistent",
)
ON_ITS_OWN = Sentence("on_its_own", "; {why}")


class Together(NamedTuple):
    """Recordings that are fitted together."""

    recordings: Sequence[Recording]


class HeldOut(NamedTuple):
    """Recordings that are fitted, and others that are predicted."""

    fitted: Sequence[Recording]
    held_out: Sequence[Recording]


class Predicted(NamedTuple):
    """One held-out recording, and the model that predicts it; (J,) each."""

    source: str
    missed: Array  # of the torque
    missed_all: Array  # of that of all samples, those at rest too
    fitted: Array  # of the torque of the recordings that were fitted
    why: Reason | None  # what it is by itself, rather than what it was given as


class Detector(NamedTuple):
    """One function from a step's value to warnings, and their sentences."""

    looks_at: type
    sentences: tuple[Sentence, ...]
    find: Callable[[Any], Iterable[Reason]]


def warnings_of(value: object) -> list[Reason]:
    """What the detectors of this kind of value find, in the order of the table."""
    return [warning for detector in DETECTORS if isinstance(value, detector.looks_at) for warning in detector.find(value)]


# --- Of recordings, and of their clocks and units --------------------------------------------------------


def mixed_payload(together: Together) -> Iterator[Reason]:
    """The recordings name different payloads or tools."""
    if len({(recording.context.payload_kg, recording.context.tool) for recording in together.recordings}) > 1:
        yield MIXED_PAYLOAD()


def told_by_reader(repaired: Repaired) -> Iterator[Reason]:
    """What the reader of the file had to say."""
    yield from repaired.recording.told


def signals_left_out(repaired: Repaired) -> Iterator[Reason]:
    """Signals that are there by name alone."""
    yield from repaired.left_out


def clock_unchecked(repaired: Repaired) -> Iterator[Reason]:
    """No speeds: a wrong clock goes unseen."""
    if repaired.recording.qd is None:
        yield CLOCK_UNCHECKED(source=named(repaired.recording))


def clock_jump(repaired: Repaired) -> Iterator[Reason]:
    """The clock was set while it ran."""
    if repaired.clock_jumps:
        yield CLOCK_JUMP(source=named(repaired.recording), jumps=repaired.clock_jumps)


def clock_restored(repaired: Repaired) -> Iterator[Reason]:
    """Times were written too coarsely, or are those of arrival."""
    if repaired.clock is None:
        return
    source, rows = named(repaired.recording), repaired.clock.rows
    if rows is None:
        yield CLOCK_RESTORED(source=source, step=repaired.clock.step)
    else:
        yield CLOCK_OF_ARRIVALS(source=source, rows=rows)


def units_repaired(repaired: Repaired) -> Iterator[Reason]:
    """Units were not SI."""
    return (UNIT_REPAIRED(source=named(repaired.recording), what=what) for what in repaired.units)


def clock_doubtful(repaired: Repaired) -> Iterator[Reason]:
    """All positions change at another rate than the speeds say, by a factor of no unit."""
    if repaired.clock_factor is not None:
        yield CLOCK_DOUBTFUL(source=named(repaired.recording), factor=repaired.clock_factor)


def speeds_doubtful(repaired: Repaired) -> Iterator[Reason]:
    """The speed of single joints is not the change of their positions, or comes late; a doubtful clock is the same doubt for all joints."""
    seen, source = repaired.speeds, named(repaired.recording)
    if seen is None or repaired.clock_factor is not None:
        return
    for j in np.flatnonzero(seen.moves):
        if seen.mismatch[j] > DOUBTFUL + seen.unsure[j]:
            yield SPEEDS_DOUBTFUL(source=source, what=SPEED_DIFFERS(joint=j + 1, share=seen.mismatch[j], factor=seen.factor[j]))
        elif abs(seen.late_s[j]) > LATE_S:
            order = "later" if seen.late_s[j] > 0 else "earlier"
            yield SPEEDS_DOUBTFUL(source=source, what=SPEED_LATE(joint=j + 1, late_ms=1e3 * abs(seen.late_s[j]), order=order))


# --- Of rows and signals ---------------------------------------------------------------------------------


def rejected_rows(motion: Motion) -> Iterator[Reason]:
    """Rows that were left out, by reason."""
    if motion.rejected_why:
        why = tuple(f"{count} {reason}" for reason, count in motion.rejected_why.items())
        recorded = motion.recording.samples
        yield REJECTED_ROWS(source=named(motion.recording), rejected=motion.rejected_samples, recorded=recorded, why=why)


def turns_unwound(motion: Motion) -> Iterator[Reason]:
    """Positions that were wrapped into one turn."""
    wound = np.flatnonzero(np.any(motion.rows.turns != 0.0, axis=0))
    if len(wound):
        yield TURNS_UNWOUND(source=named(motion.recording), joints=wound + 1)


def motion_jumps(motion: Motion) -> Iterator[Reason]:
    """Places at which the motion is not continued although no time is missing."""
    if motion.jumps:
        yield MOTION_JUMPS(source=named(motion.recording), jumps=motion.jumps)


def drives_unmeasured(motion: Motion) -> Iterator[Reason]:
    """Joints whose current or torque is no measurement in a part of the rows, or in all."""
    recording, keep = motion.recording, motion.rows.keep
    drive = recording.current if recording.current is not None else recording.torque
    if drive is None:
        return
    t_s, values = recording.t_s[keep], drive[keep]
    tick = float(np.median(np.diff(t_s)))
    speed = recording.qd[keep] if recording.qd is not None else np.gradient(recording.q[keep], t_s, axis=0)
    for j, x in enumerate(values.T):
        moving = np.abs(speed[:, j]) > MOVING_RAD_S
        count = np.count_nonzero(moving)
        if not count:
            continue
        which = {"source": named(recording), "drive": "torque" if recording.current is None else "current", "joint": j + 1}
        lengths, at = _runs(x, moving)
        long = lengths >= max(STUCK_ROWS, STUCK_S / tick)
        share = float(np.sum(lengths[long]) / count)
        every_s = float(np.mean(lengths)) * tick if len(lengths) else 0.0
        if count >= STUCK_ROWS and np.ptp(x[moving]) == 0.0:
            yield CURRENT_STUCK(**which, value=x[moving][0] + 0.0, share=1.0)  # no −0
        elif np.sum(lengths) > 0.5 * count and every_s > HELD_S:
            yield CURRENT_HELD(**which, every_ms=1e3 * every_s)
        elif (cut := _cut_off(x)) is not None:
            yield CURRENT_SATURATED(**which, value=cut)
        elif share > STUCK_SHARE:
            yield CURRENT_STUCK(**which, value=x[at[long][int(np.argmax(lengths[long]))]], share=share)


def _runs(x: Array, moving: Mask) -> tuple[Array, Indices]:
    """Length and first row of each run of two or more equal readings in moving rows."""
    equal = np.concatenate([[False], (x[1:] == x[:-1]) & moving[1:], [False]])
    edges = np.flatnonzero(equal[1:] != equal[:-1])
    return (edges[1::2] - edges[::2] + 1).astype(float), edges[::2]


def _cut_off(x: Array) -> float | None:
    """The largest or smallest value where many readings pile up on it; None where neither has a pile."""
    width = NEAR * float(np.ptp(x))
    for end in (float(np.max(x)), float(np.min(x))):
        pile = np.count_nonzero(x == end)
        if pile >= PILE_ROWS and pile > PILE * np.count_nonzero((np.abs(x - end) <= width) & (x != end)):
            return end
    return None


def interpolated(repaired: Repaired) -> Iterator[Reason]:
    """Currents or torques of most moving joints that were measured seldom, and interpolated between."""
    recording = repaired.recording
    drive = recording.current if recording.current is not None else recording.torque
    if drive is None:
        return
    rows = np.flatnonzero(np.isfinite(recording.t_s) & np.isfinite(drive).all(axis=1) & np.isfinite(recording.q).all(axis=1))
    t_s, q, drive = recording.t_s[rows], recording.q[rows], drive[rows]
    new = np.concatenate([[True], (np.diff(t_s) > 0.0) & np.any(drive[1:] != drive[:-1], axis=1)])[: len(rows)]  # held rows are no readings
    t_s, q, drive = t_s[new], q[new], drive[new]
    if len(t_s) < STUCK_ROWS:
        return
    rate_hz, moving = 1.0 / float(np.median(np.diff(t_s))), np.ptp(q, axis=0) > 0.0
    rates = [_measured_hz(t_s, x, rate_hz) for x in drive[:, moving].T]
    seldom = [rate for rate in rates if rate is not None]
    if 2 * len(seldom) > len(rates) and SELDOM_HZ <= (measured_hz := float(np.median(seldom))) < LOW_RATE_HZ:
        yield INTERPOLATED(source=named(recording), drive="torque" if recording.current is None else "current", rate_hz=measured_hz)


def _measured_hz(t_s: Array, x: Array, rate_hz: float) -> float | None:
    """The rate [Hz] of the readings between which x (N,) is interpolated, linearly or by cubic pieces; None where each row is a reading."""
    values = np.unique(x)
    digit = float(np.min(np.diff(values), initial=np.inf, where=np.diff(values) > DIGIT * np.ptp(x)))
    for every in sorted({max(1, round(rate_hz / at_hz)) for at_hz in (rate_hz, *BENDS_AT_HZ)}):
        t, y = t_s[::every], x[::every]
        if len(y) < STUCK_ROWS:
            break
        share = np.diff(t)[:-1] / (t[2:] - t[:-2])
        straight = np.abs(y[1:-1] - y[:-2] * (1.0 - share) - y[2:] * share)  # from the line between the readings around it
        for bend, rounded in ((straight, digit), (np.abs(np.diff(y, 4)), 8.0 * digit)):
            most = float(np.quantile(bend, 0.99))
            between = bend <= max(SMOOTH * most, 1.01 * rounded)
            lengths, _ = _runs(np.zeros(len(bend)), between)
            if most > 5.0 * rounded and np.mean(between) > MOSTLY and len(lengths):
                return rate_hz / every * len(lengths) / len(bend)  # one reading between two runs without a bend
    return None


def accelerations_replaced(motion: Motion) -> Iterator[Reason]:
    """Recorded accelerations that are not the change of the speeds."""
    if motion.accelerations_replaced:
        yield ACCELERATIONS_REPLACED(source=named(motion.recording), joints=motion.accelerations_replaced)


def temperatures_doubtful(motion: Motion) -> Iterator[Reason]:
    """Temperature sensors that are silent, of another unit, or apart from the others; and single readings that are left out."""
    recording = motion.recording
    if recording.temperature_c is None:
        return
    source, columns, sound = named(recording), recording.temperature_c.T, plausible_temperatures(recording.temperature_c).T
    finite = [column[np.isfinite(column)] for column in columns]
    usual = [float(np.median(column[on])) if on.any() else np.nan for column, on in zip(columns, sound, strict=True)]
    silent = [j + 1 for j, readings in enumerate(finite) if not np.any(readings)]
    foreign = [j for j, readings in enumerate(finite) if np.any(readings) and np.isnan(usual[j])]
    known = [value for value in usual if np.isfinite(value)]
    doubts = [SILENT_SENSOR(joints=silent)] if silent else []
    if foreign:
        doubts.append(FOREIGN_UNIT(value=np.median(finite[foreign[0]]), joints=[j + 1 for j in foreign]))
    if known:
        middle = float(np.median(known))
        for j, value in enumerate(usual):
            if value < COLD_C or (len(known) > 2 and abs(value - middle) > APART_K):
                doubts.append(SENSOR_APART(joint=j + 1, temperature_c=value, median_c=middle))
        if min(known) > HOT_C:
            doubts.append(ALL_HOT(coldest_c=min(known)))
    yield from (TEMPERATURE_DOUBTFUL(source=source, what=doubt) for doubt in doubts)
    torn = sum(len(readings) - np.count_nonzero(on) for readings, on in zip(finite, sound, strict=True) if on.any())
    if torn:
        yield TEMPERATURE_TORN(source=source, count=torn)


def repaired_spikes(motion: Motion) -> Iterator[Reason]:
    """Single readings of current or torque that were replaced."""
    if motion.spikes:
        yield REPAIRED_SPIKES(source=named(motion.recording), count=motion.spikes)


def current_is_target(motion: Motion) -> Iterator[Reason]:
    """The measured current is the controller's own number."""
    if of_simulator(motion.recording):
        yield CURRENT_IS_TARGET(source=named(motion.recording))


def of_simulator(recording: Recording) -> bool:
    """Whether current and target current are both there, equal bit for bit, and not all zero."""
    current, target = recording.current, recording.target_current
    return current is not None and target is not None and bool(np.any(current)) and np.array_equal(current, target)


def low_rate(motion: Motion) -> Iterator[Reason]:
    """Too few samples a second for reversals and accelerations."""
    if motion.rate_hz < LOW_RATE_HZ:
        yield LOW_RATE(source=named(motion.recording), rate_hz=motion.rate_hz)


def payload(motion: Motion) -> Iterator[Reason]:
    """The recording names a payload."""
    if motion.recording.context.payload_kg:
        yield PAYLOAD(source=named(motion.recording), payload_kg=motion.recording.context.payload_kg)


def temperature_drift(motion: Motion) -> Iterator[Reason]:
    """Joints that warmed or cooled during the recording."""
    if motion.temperature_c is not None:
        swing = np.ptp(motion.temperature_c, axis=0)  # (J,)
        for j in np.flatnonzero(swing > TEMPERATURE_DRIFT_K):
            yield TEMPERATURE_DRIFT(source=named(motion.recording), joint=j + 1, swing_k=swing[j])


# --- Of what is fitted and what is held out --------------------------------------------------------------


def validated_on_fitted(files: HeldOut) -> Iterator[Reason]:
    """A held-out recording that was fitted too."""
    fitted = {one.samples_digest: one.source for one in files.fitted} if files.held_out else {}
    for held in files.held_out:
        if (source := fitted.get(held.samples_digest)) is not None:
            yield VALIDATED_ON_FITTED(source=held.source, fitted=source)


def fitted_together(files: HeldOut) -> Iterator[Reason]:
    """Several files are fitted beside held-out ones, where a reader may have meant otherwise."""
    if files.held_out and len(files.fitted) > 1:
        yield FITTED_TOGETHER(fitted=[one.source for one in files.fitted], held_out=[held.source for held in files.held_out])


def held_out_poor(predicted: Predicted) -> Iterator[Reason]:
    """A held-out recording that does not fit, although those that were fitted do."""
    with np.errstate(invalid="ignore"):
        poor = (predicted.missed > fit.POOR) & ~(predicted.missed < TWICE * predicted.fitted)
    if poor.any():
        yield HELD_OUT_POOR(
            source=predicted.source,
            share=np.max(predicted.missed[poor]),
            joints=np.flatnonzero(poor) + 1,
            fitted=np.nanmax(predicted.fitted),
            why="" if predicted.why is None else ON_ITS_OWN(why=predicted.why),
        )


def held_out_at_rest(predicted: Predicted) -> Iterator[Reason]:
    """Joints whose torque is predicted well in motion, and at rest worse than by nothing: friction holds them by less than their torque."""
    with np.errstate(invalid="ignore"):
        absurd = (predicted.missed_all > TWICE) & ~(predicted.missed > 1.0)
    if absurd.any():
        yield HELD_OUT_AT_REST(source=predicted.source, joints=np.flatnonzero(absurd) + 1, times=np.max(predicted.missed_all[absurd]))


DETECTORS = (
    Detector(Together, (MIXED_PAYLOAD,), mixed_payload),
    Detector(Repaired, (), told_by_reader),
    Detector(Repaired, (SIGNAL_EMPTY, SIGNAL_CONSTANT), signals_left_out),
    Detector(Repaired, (CLOCK_JUMP,), clock_jump),
    Detector(Repaired, (CLOCK_RESTORED, CLOCK_OF_ARRIVALS), clock_restored),
    Detector(Repaired, (UNIT_REPAIRED,), units_repaired),
    Detector(Repaired, (CLOCK_DOUBTFUL,), clock_doubtful),
    Detector(Repaired, (SPEEDS_DOUBTFUL,), speeds_doubtful),
    Detector(Repaired, (INTERPOLATED,), interpolated),
    Detector(Repaired, (CLOCK_UNCHECKED,), clock_unchecked),
    Detector(Motion, (REJECTED_ROWS,), rejected_rows),
    Detector(Motion, (TURNS_UNWOUND,), turns_unwound),
    Detector(Motion, (MOTION_JUMPS,), motion_jumps),
    Detector(Motion, (CURRENT_STUCK, CURRENT_HELD, CURRENT_SATURATED), drives_unmeasured),
    Detector(Motion, (ACCELERATIONS_REPLACED,), accelerations_replaced),
    Detector(Motion, (TEMPERATURE_DOUBTFUL, TEMPERATURE_TORN), temperatures_doubtful),
    Detector(Motion, (REPAIRED_SPIKES,), repaired_spikes),
    Detector(Motion, (CURRENT_IS_TARGET,), current_is_target),
    Detector(Motion, (LOW_RATE,), low_rate),
    Detector(Motion, (PAYLOAD,), payload),
    Detector(Motion, (TEMPERATURE_DRIFT,), temperature_drift),
    Detector(Fitted, (fit.LIKELY_CAUSE,), fit.likely_cause),
    Detector(Fitted, (fit.NO_NOISE,), fit.no_noise),
    Detector(Fitted, (MOUNTING_CONTRADICTION,), fit.mounting_contradiction),
    Detector(Fitted, (fit.HARDLY_MOVES, fit.ONE_DIRECTION), fit.poorly_moved),
    Detector(Fitted, (fit.OUTLIERS,), fit.outliers),
    Detector(Fitted, (fit.FEW_SAMPLES,), fit.few_samples),
    Detector(Fitted, (fit.NOT_EXCITED, fit.ILL_CONDITIONED), fit.poorly_excited),
    Detector(Fitted, (fit.UNPHYSICAL_FRICTION,), fit.negative_friction),
    Detector(Fitted, (fit.TORQUE_DELAYED,), fit.torque_delayed),
    Detector(Fitted, (fit.TORQUE_OFFSET,), fit.torque_offset),
    Detector(Fitted, (fit.TORQUE_SMOOTHED, fit.NOISE_SMOOTHED), fit.torque_smoothed),
    Detector(Fitted, (fit.TORQUE_DRIFTS,), fit.torque_drifts),
    Detector(Fitted, (GAIN_DOUBTFUL,), fit.sizes_doubtful),
    Detector(Fitted, (fit.POOR_FIT,), fit.poor_fit),
    Detector(Fitted, (GAIN_DOUBTFUL,), fit.gains_doubtful),
    Detector(Fitted, (fit.FAR_FROM_PHYSICAL,), fit.far_from_physical),
    Detector(HeldOut, (VALIDATED_ON_FITTED,), validated_on_fitted),
    Detector(HeldOut, (FITTED_TOGETHER,), fitted_together),
    Detector(Predicted, (HELD_OUT_POOR,), held_out_poor),
    Detector(Predicted, (HELD_OUT_AT_REST,), held_out_at_rest),
)
