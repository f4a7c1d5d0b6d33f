"""Rows of production → unbroken segments of motion on an even clock, and the seconds that are left out, by cause.

Here only what the controller itself says is used: modes, the program's state, the payload's register. What the torque says comes after.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.production.arm import LOADS, ProductionArm, ProductionRows
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.arm import at_motors, drive_torque
from monitor.identify.signals.filters import filtered, low_pass, refuse_uneven, uniform
from monitor.identify.signals.motion import ENOUGH_SAMPLES
from monitor.identify.signals.rows import HARMLESS, sound_rows
from monitor.model.friction import smooth_sign
from monitor.recording import Array, Indices, Mask, Recording

STILL_RAD_S = 0.01  # the arm stands where no joint is faster
SHORTEST_S, LONGEST_S = 0.3, 5.0  # of a segment: below it nothing is told, above it is cut, so that a load is asked for anew
CHANGE_S = 0.4  # before and after a change of payload or tool the hand is gripping
FEWEST_ROWS = 12  # with fewer, friction and the four figures of a load explain whatever was measured
LEAST_RATE_HZ = 7.9  # a log at 8 Hz is still taken, although its clock is uneven
# below it rows are taken as they are, with the planned acceleration: differences of speeds and the filter would round what happens
WELL_SAMPLED_HZ = 50.0
WORKING, REDUCED, PROTECTIVE = 1, 2, 3  # safety modes
RUNNING, BACKDRIVE = 7, 6  # robot modes
PLAYING = 2  # runtime state
TEACH_BUTTON = 4  # bit 2 of the robot's status
POSSIBLE_C = (-20.0, 100.0)
# what is left out, most important cause first; the names are published
CAUSES: Mapping[str, str] = {
    "torn": "rows that are torn or do not continue the motion",
    "protective_stop": "a protective stop",
    "safety_stop": "another safety stop, or a safety mode that is no work",
    "not_running": "the arm's power or brakes are off",
    "hand_guiding": "moved by hand: freedrive, or without a running program",
    "force_control": "the program controls force",
    "payload_changed": "the payload or the tool is being changed",
    "payload_unknown": "something else is in the hand than was declared",
    "contact": "contact with something",
    "disturbed": "a torque that the model cannot explain",
    "standstill": "no joint moves",
    "too_short": "a motion too short to tell anything",
    "gap": "rows are missing",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cut:
    """Rows of motion on an even clock, thinned to what is independent of the filter. n rows, S segments."""

    rate_hz: float  # of these rows
    t_s: Array  # (n,) since the first row of the window
    q: Array  # (n, J)
    qd: Array
    qdd: Array
    direction: Array  # s(q̇) through the filter
    torque_nm: Array  # (n, J) measured
    temperature_c: Array  # (n, J) NaN where unknown
    load: Array  # (n, 4) what is declared at the flange beyond the load of the replay: m, mx, my, mz
    centred: bool  # the centre of what is declared is known
    tcp_force_n: Array | None  # (n, 3)
    segment: Indices  # (n,) number of the segment, from 0, ascending

    @property
    def starts(self) -> Indices:
        """(S,) first row of each segment."""
        return np.flatnonzero(np.diff(self.segment, prepend=-1))

    def chosen(self, rows: Mask) -> "Cut":
        """Some of the rows; segments are numbered anew."""
        number = np.cumsum(np.diff(self.segment[rows], prepend=-1) != 0) - 1
        names = ("t_s", "q", "qd", "qdd", "direction", "torque_nm", "temperature_c", "load")
        force = None if self.tcp_force_n is None else self.tcp_force_n[rows]
        arrays = {name: getattr(self, name)[rows] for name in names}
        return Cut(rate_hz=self.rate_hz, centred=self.centred, tcp_force_n=force, segment=number, **arrays)


def cut(rows: ProductionRows, arm: ProductionArm) -> tuple[Cut | None, dict[str, float]]:
    """The segments of motion of a window, None where there are none, and the seconds left out by cause.

    Raises BadInput where the rows are of another number of joints, or as `drive_torque`.
    """
    recording = rows.recording
    if recording.joints != arm.joints:
        raise BadInput(f"{recording.source or 'rows of production'}: {recording.joints} joints; {arm.robot.name} has {arm.joints}")
    rows = replace(rows, recording=at_motors(recording, arm.robot))
    recording = rows.recording
    drive = drive_torque(recording.source or "rows of production", recording.torque, recording.current, arm.robot, arm.gains)
    left_out: dict[str, float] = {}
    if recording.samples < FEWEST_ROWS:
        return None, left_out
    sound = sound_rows(recording)
    keep = sound.keep
    step = np.diff(recording.t_s[keep])
    if len(keep) < FEWEST_ROWS or not np.median(step) > 0.0:
        return None, {"torn": recording.samples / 10.0}
    tick = float(np.median(step))
    rate_hz = 1.0 / float(np.mean(step[step < 1.9 * tick]))
    if rate_hz < LEAST_RATE_HZ:
        raise Unidentifiable(
            f"{recording.source or 'rows of production'}: {rate_hz:.3g} rows a second; expected 10 or more: with fewer, motion is unknown"
        )
    lost = sum(count for reason, count in sound.why.items() if reason not in HARMLESS)  # a row written again is no time
    left_out["torn"] = lost * tick
    cause = _causes(rows, keep)
    parts, holes = [], np.flatnonzero(step > max(0.25, 3.0 * tick)) + 1
    left_out["gap"] = float(np.sum(step[holes - 1] - tick))
    edges = [0, *np.union1d(holes, sound.breaks).tolist(), len(keep)]
    refuse_uneven(recording.source or "rows of production", recording.t_s[keep], list(pairwise(edges)), rate_hz)
    for stretch in np.split(np.arange(len(keep)), edges[1:-1]):
        part = _stretch(rows, arm, keep[stretch], cause[stretch], drive, rate_hz, sound.turns[stretch])
        if part is None:
            left_out["gap"] += len(stretch) * tick
        else:
            parts.append(part)
    if not parts:
        return None, {name: seconds for name, seconds in left_out.items() if seconds > 0.0}
    return _segments(parts, rate_hz, left_out, centred=rows.payload_com_m is not None)


_NAMES = tuple(CAUSES)


def _causes(rows: ProductionRows, keep: Indices) -> Indices:
    """(n,) number of the cause for which each row does not count, len(CAUSES) where it does."""
    recording, none = rows.recording, len(_NAMES)
    cause = np.full(len(keep), none)

    def mark(name: str, where: Mask) -> None:
        cause[where] = np.minimum(cause[where], _NAMES.index(name))

    def column(values: Array | None) -> Array:
        return np.full(len(keep), np.nan) if values is None else values[keep]

    t_s = recording.t_s[keep]
    qd = recording.qd[keep] if recording.qd is not None else np.gradient(recording.q[keep], t_s, axis=0)
    moving = np.any(np.abs(qd) > STILL_RAD_S, axis=1)
    safety, mode, runtime = (column(each) for each in (recording.safety_mode, recording.robot_mode, recording.runtime_state))
    mark("protective_stop", safety == PROTECTIVE)
    mark("safety_stop", np.isfinite(safety) & ~np.isin(safety, [0, WORKING, REDUCED, PROTECTIVE]))
    mark("hand_guiding", mode == BACKDRIVE)
    mark("not_running", np.isfinite(mode) & ~np.isin(mode, [RUNNING, BACKDRIVE]))
    mark("hand_guiding", moving & np.isfinite(runtime) & (runtime != PLAYING))
    status = np.nan_to_num(column(rows.status_bits)).astype(np.int64)
    mark("hand_guiding", status & TEACH_BUTTON > 0)
    mark("force_control", np.nan_to_num(column(rows.force_mode)) != 0.0)
    for changing in (rows.payload_kg, rows.tool, *(() if rows.payload_com_m is None else rows.payload_com_m.T)):
        if changing is not None:
            mark("payload_changed", _near_change(t_s, changing[keep]))
    if rows.payload_kg is not None:
        mark("payload_unknown", ~np.isfinite(rows.payload_kg[keep]))
    mark("standstill", ~moving)
    return cause


def _near_change(t_s: Array, values: Array) -> Mask:
    """(n,) the rows near a change of the value."""
    known = np.where(np.isfinite(values), values, -1.0)
    near = np.zeros(len(t_s), dtype=bool)
    for at in np.flatnonzero(np.abs(np.diff(known)) > 1e-6):
        near |= (t_s >= t_s[at] - CHANGE_S) & (t_s <= t_s[at + 1] + CHANGE_S)
    return near


def _stretch(
    rows: ProductionRows, arm: ProductionArm, at: Indices, cause: Indices, drive: Array, rate_hz: float, turns: Array
) -> dict[str, Array] | None:
    """The signals of unbroken rows, filtered on an even clock where they are well sampled; None where they are too few."""
    recording, settings = rows.recording, SignalSettings()
    if len(at) < FEWEST_ROWS:
        return None
    t_s = recording.t_s[at]
    signals = {"t_s": t_s, "q": recording.q[at] + turns, "torque": drive[at]}
    if recording.qd is not None:
        signals["qd"] = recording.qd[at]
    planned = recording.target_qdd
    if rate_hz < WELL_SAMPLED_HZ and "qd" in signals and planned is not None and np.all(np.isfinite(planned[at])):
        part = signals | {"qdd": planned[at], "direction": smooth_sign(signals["qd"])}
    else:
        if recording.qdd is not None:
            signals["qdd"] = recording.qdd[at]
        even = uniform(t_s, {name: value for name, value in signals.items() if name != "t_s"}, rate_hz)
        trim = max(1, round(settings.trim_s * rate_hz))
        if len(even["t_s"]) < 2 * trim + FEWEST_ROWS:
            return None
        part = filtered(even, rate_hz, low_pass(rate_hz, settings.filter_order, min(settings.cutoff_hz, 0.35 * rate_hz)), trim)
    nearest = np.clip(np.searchsorted(t_s, part["t_s"] - 0.5 / rate_hz), 0, len(at) - 1)
    part["t_s"] = part["t_s"] - recording.t_s[0]
    part["cause"] = cause[nearest].astype(float)
    part["temperature"] = _temperature(recording, at[nearest])
    part["load"] = _load(rows, arm, at[nearest])
    if rows.tcp_force is not None:
        part["tcp_force"] = rows.tcp_force[at[nearest], :3]
    return part


def _temperature(recording: Recording, at: Indices) -> Array:
    """(n, J) temperatures [°C]; NaN where there is none, or no joint has such a one."""
    if recording.temperature_c is None:
        return np.full((len(at), recording.joints), np.nan)
    read = recording.temperature_c[at]
    with np.errstate(invalid="ignore"):
        possible = (read > POSSIBLE_C[0]) & (read < POSSIBLE_C[1]) & (read != 0.0)
    return np.where(possible, read, np.nan)


def _load(rows: ProductionRows, arm: ProductionArm, at: Indices) -> Array:
    """(n, 4) m and m·c of what is declared beyond the replay's load."""
    load = np.zeros((len(at), LOADS))
    before = 0.0 if arm.payload_kg is None else arm.payload_kg
    if rows.payload_kg is not None:
        mass = np.nan_to_num(rows.payload_kg[at], nan=before)
    else:
        declared = rows.recording.context.payload_kg
        mass = np.full(len(at), before if declared is None else declared)
    centre = np.zeros((len(at), 3)) if rows.payload_com_m is None else np.nan_to_num(rows.payload_com_m[at])
    centre_before = centre if arm.payload_com_m is None else np.broadcast_to(np.array(arm.payload_com_m), centre.shape)
    load[:, 0] = mass - before
    load[:, 1:] = mass[:, None] * centre - before * centre_before
    same = np.abs(load[:, 0]) < 0.01  # the same tool, whose centre was perhaps not written down alike
    load[same & (arm.payload_com_m is None)] = 0.0
    return load


def _segments(
    parts: list[dict[str, Array]], rate_hz: float, left_out: dict[str, float], *, centred: bool
) -> tuple[Cut | None, dict[str, float]]:
    """The stretches thinned, joined and cut into segments."""
    settings = SignalSettings()
    every = max(1, int(rate_hz / (ENOUGH_SAMPLES * min(settings.cutoff_hz, 0.35 * rate_hz))))
    parts = [{name: value[::every] for name, value in part.items()} for part in parts]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    cause, tick = joined.pop("cause").astype(int), every / rate_hz
    stretch = np.repeat(np.arange(len(parts)), [len(part["t_s"]) for part in parts])
    begins = np.diff(stretch, prepend=-1) != 0
    begins[1:] |= np.diff(cause) != 0
    run = np.cumsum(begins) - 1
    since = np.arange(len(run)) - np.flatnonzero(begins)[run]
    piece = since // max(1, round(LONGEST_S / tick))
    begins[1:] |= np.diff(piece) > 0
    number = np.cumsum(begins) - 1
    length_s = np.bincount(number)[number] * tick
    free = cause == len(_NAMES)
    cause[free & (length_s < SHORTEST_S)] = _NAMES.index("too_short")
    free &= length_s >= SHORTEST_S
    for k, count in enumerate(np.bincount(cause, minlength=len(_NAMES))[: len(_NAMES)]):
        left_out[_NAMES[k]] = left_out.get(_NAMES[k], 0.0) + count * tick
    left_out = {name: float(seconds) for name, seconds in left_out.items() if seconds > 0.0}
    if not free.any():
        return None, left_out
    whole = Cut(
        rate_hz=1.0 / tick,
        t_s=joined["t_s"],
        q=joined["q"],
        qd=joined["qd"],
        qdd=joined["qdd"],
        direction=joined["direction"],
        torque_nm=joined["torque"],
        temperature_c=joined["temperature"],
        load=joined["load"],
        centred=centred,
        tcp_force_n=joined.get("tcp_force"),
        segment=number,
    )
    return whole.chosen(free), left_out
