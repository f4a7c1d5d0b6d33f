"""Learn the profile of one trajectory's torque from earlier replays of the same arm with the same load. Values only."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.acquire.rows import COLUMN, WIDTH
from monitor.acquire.safety.band.basis import BandBasis
from monitor.acquire.safety.band.profile import STEP_S, TorqueProfile
from monitor.acquire.safety.band.torque_band import Reading, TorqueBand
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array, Recording

MOST_TICKS = 2.0  # the stream of targets advances along its path by at most so many ticks a row: `ur.stream`
MARGIN = 1.5  # what earlier replays needed at a place is allowed with this factor
BESIDE = 3  # steps of the profile on either side of a place that count as the same place: 0.12 s
LEAST_SHARE = 0.9  # of a profile's steps must have rows: less is no replay of this trajectory


def phases(t_s: Array, rate_hz: float, pass_s: float) -> Array:
    """(N,) time since the beginning of the repetition, as the stream of targets counted it from the controller's times (N,) [s]."""
    advance_s = np.minimum(np.diff(t_s, prepend=t_s[0]), MOST_TICKS / rate_hz)
    phase_s: Array = np.cumsum(advance_s) % pass_s
    return phase_s


def recorded_rows(recording: Recording) -> Array:
    """Rows (N, WIDTH) with what the band reads; NaN elsewhere, and where the recording does not have it."""
    rows = np.full((recording.samples, WIDTH), np.nan)
    rows[:, COLUMN["timestamp"]] = recording.t_s[:, None]
    for name, values in (
        ("actual_q", recording.q),
        ("actual_qd", recording.qd),
        ("target_qdd", recording.target_qdd),
        ("actual_current", recording.current),
        ("joint_temperatures", recording.temperature_c),
    ):
        if values is not None:
            rows[:, COLUMN[name]] = values
    return rows


def learn_profile(
    recordings: Sequence[Recording],
    robot: Robot,
    excitation: Excitation,
    settings: ReplaySettings,
    installation: Installation,
    basis: BandBasis,
) -> TorqueProfile | None:
    """The profile of these replays of the excitation, with the model of `basis`; None where there are none, or too little of them."""
    if not recordings:
        return None
    pass_s, count = excitation.pass_s, max(round(excitation.pass_s / STEP_S), 1)
    tables = [recorded_rows(recording) for recording in recordings]
    at = [phases(recording.t_s, settings.rate_hz, pass_s) for recording in recordings]
    places = [np.minimum((phase_s / STEP_S).astype(int), count - 1) for phase_s in at]
    plain = replace(basis, profile=None)
    sums, rows = np.zeros((count, robot.joints)), np.zeros(count)
    for table, place in zip(tables, places, strict=True):
        band = TorqueBand(robot, excitation.mounting, settings, installation, plain)
        excess = np.array([band.read(row).excess for row in table])
        known = np.all(np.isfinite(excess), axis=1)
        there = place[band.seen(len(table))][known]
        np.add.at(sums, there, excess[known])
        np.add.at(rows, there, 1.0)
    if np.mean(rows > 0) < LEAST_SHARE:
        return None
    filled = np.flatnonzero(rows)
    means = sums[filled] / rows[filled, None]
    mean = np.stack([np.interp(np.arange(count), filled, means[:, j], period=count) for j in range(robot.joints)], axis=1)
    first = TorqueProfile(replays=len(recordings), pass_s=pass_s, mean_nm=mean, spread_nm=np.zeros_like(mean))
    needed = np.zeros_like(mean)
    for table, phase_s, place in zip(tables, at, places, strict=True):
        band = TorqueBand(robot, excitation.mounting, settings, installation, replace(plain, profile=first))
        readings = [band.read(row, float(phase)) for row, phase in zip(table, phase_s, strict=True)]
        np.maximum.at(needed, place[band.seen(len(table))], _needed(readings, band.rows_outside))
    beside = np.stack([np.roll(needed, shift, axis=0) for shift in range(-BESIDE, BESIDE + 1)])
    return replace(first, spread_nm=MARGIN * beside.max(axis=0))


def _needed(readings: list[Reading], rows: int) -> Array:
    """(N, J) how much of `share` each row would have needed for so many successive rows, on the side where it needed more [N·m]."""
    surprise, rest = (np.array(values) for values in zip(*((r.surprise, r.narrow - r.share) for r in readings), strict=True))
    sides = np.nan_to_num(np.array([-surprise, surprise])) - np.nan_to_num(rest)  # (2, N, J)
    lasting = np.lib.stride_tricks.sliding_window_view(sides, rows, axis=1).min(axis=-1).max(axis=0)  # (N − rows + 1, J)
    found = np.zeros_like(surprise)
    found[rows - 1 :] = np.maximum(lasting, 0.0)
    return found
