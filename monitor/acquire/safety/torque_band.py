"""The torque band of a moving arm: measured torque that leaves it means that something is in the way of the arm.

Every row of every phase that moves passes it, in the process that streams the targets, before the next target is sent. The middle of
the band is torque that is expected: of the temperature-compensated model where one exists for this load, else of the manufacturer's
parameters with the payload and typical friction; and along the trajectory also what earlier replays needed beyond it at the same place.

Friction may grow by wear and cold to a multiple and must be recorded then; a collision is a torque that comes within a fraction of a
second. So the band has two parts. The wide one bounds the whole difference, by what friction can ever need. The narrow one follows the
arm: a Kalman filter of each joint estimates today's excess of Coulomb and viscous friction, of inertia, and a slowly moving offset, and
what the filter did not expect must stay within a few per cent of the joint's largest torque.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.acquire.rows import layout, layout_of
from monitor.acquire.safety.expected_torque import ExpectedTorque, JointInertia, expected_torque
from monitor.acquire.safety.torque_basis import STEP_S, BandBasis, TorqueProfile
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.errors import DOES_NOT_HOLD, MotionRefused
from monitor.judge.torque.model import model_from_document
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array, Context, Indices, Recording

OUTSIDE_S = 0.04  # torque must be outside for so long on one side, five rows at 125 Hz: a spike of the measured current is no collision
ACCELERATION_S = 0.016  # on either side of a row is the speed whose difference is its acceleration, two rows at 125 Hz
LAG_S = 0.032  # measured torque may be early or late by so much against the expected: the servo's lag, and rows that are a tick apart
FIRST_STEP_S = 0.008  # what the first row is taken to last
LONGEST_STEP_S = 0.1  # between two rows; the stream ends at longer gaps
STILL_RAD_S = 0.02  # below this speed static friction may hold a joint in either direction, and nothing is learnt from its torque
SIGN_RAD_S = 0.02  # friction's direction is sure above this speed
BREAKAWAY = 1.5  # static friction over friction at STILL_RAD_S; measured values of harmonic drives are 1.1 to 1.3

# shares of a joint's largest torque
NARROW = 0.04  # what the narrow part allows beyond the filter's own uncertainty: torque ripple, and friction that no law describes
NARROW_UNKNOWN = 0.06  # the same without a model: masses and centres of mass of the manufacturer are not those of this arm
NARROW_LEARNT, NARROW_MOST = 0.02, 0.08  # the least and the most along a trajectory that was replayed before
UNMODELLED = 0.01  # standard deviation of the difference that the filter takes for chance,
UNMODELLED_S = 0.05  # which keeps its value for about so long
OFFSET_S = 0.5  # the filter follows a slow offset within this time
FRICTION_WALK = 0.004  # per √s: friction's excess changes so fast while an arm warms
PRIOR_MODEL = (0.05, 0.05, 0.02, 0.001)  # standard deviations of the excess: Coulomb, viscous at 1 rad/s, offset, inertia at 1 rad/s²
PRIOR_UNKNOWN = (0.05, 0.06, 0.06, 0.005)
SIGMAS = 3.0  # of the filter's uncertainty
NOISE_SIGMAS = 2.0  # of a single measured torque: five rows in succession are required
NOISE_S = 0.3  # the noise of the current is measured over this time
NOISE_CLIP = 16.0  # a single difference counts for at most so many times the variance: a collision is no noise
JOLT_TICKS, JOLT_S, JOLT = 2.5, 0.2, 1.5  # after a gap of so many ticks a late target jolts the arm: the narrow part is so much wider
QUIET = 0.03  # a row whose jolt is more than this share of the largest torque teaches less
PRIOR_SIGMAS = 2.5  # friction and inertia differ from the expected by at most so many of their standard deviations
CLIP_SIGMAS = 1.5  # a larger surprise moves the filter no farther: a collision must not be learnt

# the wide part
WIDE_MODEL = 0.10  # share of the largest torque
FRICTION_GROWTH = 2.5  # friction of the model may grow by this multiple: doubled by wear and by a cold morning, with room
FRICTION_LOSS = 1.0  # or vanish
WIDE_STILL, WIDE_MOVING = 0.7, 0.8  # without a model: of `first_pass_band` at rest, and more at 1 rad/s; together 1 at 0.25 rad/s


class Reading(NamedTuple):
    """One row seen by the band, (J,) each [N·m]."""

    measured: Array
    expected: Array
    surprise: Array  # how far measured torque is from what was expected within LAG_S
    narrow: Array  # how far it may be
    share: Array  # the part of `narrow` that is a share of the largest torque, or was learnt
    excess: Array  # measured torque beyond the model's or the manufacturer's and what earlier replays needed
    wide: Array  # (2, J) how far that may be, downwards and upwards


GAIN_NOT_KNOWN = Sentence("gain_not_known", "the torque per ampere of a joint is not known: a collision would go unnoticed")


TORQUE_OUTSIDE = Sentence(
    "torque_outside", "{joint:joint} needs {measured_nm:.1f} N·m where {expected_nm:.1f} ± {allowed_nm:.1f} were expected ({basis})"
)


class TorqueBand:
    """Compares measured with expected torque, row by row. It remembers what it has seen: one band for one replay."""

    def __init__(
        self,
        robot: Robot,
        mounting: Mounting,
        settings: ReplaySettings,
        installation: Installation,
        basis: BandBasis,
        *,
        payload_kg: float = 0.0,
        payload_com_m: tuple[float, float, float] | None = None,
    ) -> None:
        """Prepare the comparison; `installation` gives the gains, `basis` is what was learnt of this arm.

        Raises MotionRefused where a drive gain is not known, BadInput where the model is none.
        """
        gains = installation.drive_gains(robot)
        if gains is None:
            raise MotionRefused(DOES_NOT_HOLD(condition="drive_gains", why=GAIN_NOT_KNOWN()))
        J, most = robot.joints, robot.max_torque_nm
        self._basis, self._column = basis, layout(J).column
        self._most, self._gains, self._profile = most, gains, basis.profile
        self._of: ExpectedTorque = expected_torque(
            robot,
            mounting,
            None if basis.model is None else model_from_document(basis.model),
            payload_kg=payload_kg,
            payload_com_m=payload_com_m,
            payload_error_kg=settings.max_payload_error_kg,
        )
        self._inertia = JointInertia(robot, mounting)
        self._known, self._share = basis.model is not None, settings.first_pass_band
        self.rows_outside = max(2, round(OUTSIDE_S * settings.rate_hz))
        self._lag_rows = max(1, round(LAG_S * settings.rate_hz))
        self._waiting: deque[tuple[Array, float | None]] = deque(maxlen=2 * max(1, round(ACCELERATION_S * settings.rate_hz)) + 1)
        self._recent: deque[Array] = deque(maxlen=self._lag_rows + 1)  # torque that was expected
        prior = np.array(PRIOR_MODEL if self._known else PRIOR_UNKNOWN)
        self._theta = np.zeros((J, 4))
        self._most_theta = PRIOR_SIGMAS * prior * most[:, None]  # (J, 4)
        self._most_theta[:, 2] = np.inf  # the offset is bounded by the wide part
        self._cov = np.zeros((J, 4, 4))
        self._cov[:, range(4), range(4)] = (prior * most[:, None]) ** 2
        self._cov[:, 2, 2] += self._of.payload_nm**2
        chance = UNMODELLED_S * (UNMODELLED * most) ** 2  # [N²m²·s]
        self._chance, self._walk = chance, np.zeros((J, 4, 4))  # [N²m²/s]
        self._walk[:, 0, 0] = self._walk[:, 1, 1] = (FRICTION_WALK * most) ** 2
        self._walk[:, 2, 2] = chance / OFFSET_S**2
        self._used: deque[Array] = deque(maxlen=self.rows_outside)  # (2, J) differences downwards and upwards, as shares of what is allowed
        self._noise_var = (0.5 * UNMODELLED * most) ** 2
        self._measured: Array | None = None
        self._timestamp_s, self._tick_s = np.nan, 1.0 / settings.rate_hz
        self._jolted_s = 0.0  # time for which the jolt of a late target counts yet
        self.largest_share = 0.0  # largest difference so far that lasted OUTSIDE_S, as a share of what is allowed

    @property
    def description(self) -> str:
        """What the band is made of, for a message."""
        return self._basis.description

    def outside(self, row: Array, phase_s: float | None = None) -> tuple[str, Reason] | None:
        """Cause and text where torque has been outside the band for OUTSIDE_S; else None. Call it with every row (WIDTH,) in turn.

        phase_s : time since the beginning of the trajectory's repetition [s]; None on the way to its start and back.
        """
        reading = self.read(row, phase_s)
        with np.errstate(invalid="ignore"):
            narrow, wide = reading.surprise / reading.narrow, np.array([-reading.excess, reading.excess]) / reading.wide
            used = np.maximum(np.array([-narrow, narrow]), wide)  # (2, J)
        self._used.append(np.where(np.isnan(used), np.inf, used))  # what is not a number counts as outside
        if len(self._used) < self.rows_outside:
            return None
        held = np.minimum.reduce(list(self._used))  # (2, J) what every one of the last rows needed
        self.largest_share = max(self.largest_share, float(held.max()))
        side, j = np.unravel_index(int(np.argmax(held)), held.shape)
        if held[side, j] <= 1.0:
            return None
        expected, allowed = reading.expected[j], reading.narrow[j]
        if abs(narrow[j]) <= 1.0:
            expected, allowed = reading.measured[j] - reading.excess[j], reading.wide[side, j]
        needs = {"measured_nm": reading.measured[j], "expected_nm": expected, "allowed_nm": allowed}
        return "torque_band", TORQUE_OUTSIDE(joint=int(j) + 1, **needs, basis=self.description)

    def seen(self, rows: int) -> Indices:
        """Which row each of the first so many calls of `read` was about: its own, and once acceleration is known the one before."""
        calls, whole = np.arange(rows), self._waiting.maxlen or 1
        return np.where(calls < whole - 1, calls, calls - whole // 2)

    def read(self, row: Array, phase_s: float | None = None) -> Reading:
        """What the band expects and allows ACCELERATION_S before this row; the filter learns from it. Arguments as of `outside`.

        Acceleration is the difference of measured speeds on both sides, for which the rows wait: it is smooth, and true of an arm that is
        held. Where targets came late the arm is jolted faster than that difference can show, and the controller's target acceleration
        shows it: torque between what both of them need is expected.
        """
        self._waiting.append((row, phase_s))
        qdd = np.zeros(len(self._most))  # the first rows are those of a standing arm
        if len(self._waiting) == self._waiting.maxlen:
            (first, _), (last, _) = self._waiting[0], self._waiting[-1]
            elapsed_s = last[self._column["timestamp"]] - first[self._column["timestamp"]]
            if elapsed_s[0] > 0.0:
                qdd = (last[self._column["actual_qd"]] - first[self._column["actual_qd"]]) / elapsed_s
            row, phase_s = self._waiting[len(self._waiting) // 2]
        qd = row[self._column["actual_qd"]]
        timestamp_s = float(row[self._column["timestamp"]][0])
        dt = timestamp_s - self._timestamp_s
        dt = min(max(dt, 1e-3), LONGEST_STEP_S) if np.isfinite(dt) else FIRST_STEP_S
        self._timestamp_s = timestamp_s
        self._jolted_s = JOLT_S if dt > JOLT_TICKS * self._tick_s else max(self._jolted_s - dt, 0.0)
        measured = row[self._column["actual_current"]] * self._gains
        at = self._of.at(row[self._column["actual_q"]], qd, qdd, row[self._column["joint_temperatures"]])
        middle, share = at.torque, NARROW * self._most if self._known else NARROW_UNKNOWN * self._most + self._of.payload_nm
        if self._profile is not None and phase_s is not None:
            mean, spread = self._profile.at(phase_s)
            middle = middle + mean
            share = np.minimum(np.maximum(NARROW_LEARNT * self._most, spread), NARROW_MOST * self._most)
        speed = np.abs(qd)
        sign = np.tanh(qd / SIGN_RAD_S)
        H = np.ones((len(qd), 4))
        H[:, 0], H[:, 1], H[:, 3] = sign, np.sign(qd) * speed ** (2.0 / 3.0), qdd
        H = _finite(H)
        usual = middle + np.einsum("jk,jk->j", H, self._theta)
        jolt = _finite(self._inertia.at(_finite(row[self._column["actual_q"]])) @ (row[self._column["target_qdd"]] - qdd))  # (J,)
        self._recent.append(np.array([usual, usual + jolt]))
        earlier = np.concatenate(self._recent)  # (2n, J)
        surprise = measured - np.minimum(np.maximum(measured, np.fmin.reduce(earlier)), np.fmax.reduce(earlier))
        PH = np.einsum("jkl,jl->jk", self._cov, H)
        own_var = np.einsum("jk,jk->j", H, PH)
        self._measure_noise(measured, dt)
        dry = np.abs(at.coulomb_nm + self._theta[:, 0])
        held = BREAKAWAY * dry * (1.0 - np.abs(sign))
        narrow = share + SIGMAS * np.sqrt(own_var) + NOISE_SIGMAS * np.sqrt(self._noise_var) + held
        if self._jolted_s > 0.0:
            narrow = JOLT * narrow
        excess = measured - np.minimum(np.maximum(measured, middle + np.minimum(jolt, 0.0)), middle + np.maximum(jolt, 0.0))
        self._learn(measured - usual, speed, PH, own_var + np.maximum(np.abs(jolt) - QUIET * self._most, 0.0) ** 2, dt)
        return Reading(measured, usual, surprise, narrow, share, excess, self._wide(at.friction, qd, speed, held))

    def _wide(self, friction: Array, qd: Array, speed: Array, held: Array) -> Array:
        """(2, J) what the excess may be downwards and upwards [N·m]."""
        if not self._known:
            allowed = self._share * self._most * (WIDE_STILL + WIDE_MOVING * speed ** (2.0 / 3.0)) + self._of.payload_nm + held
            return np.array([allowed, allowed])
        always = WIDE_MODEL * self._most + self._of.payload_nm + held
        grown, lost = always + FRICTION_GROWTH * np.abs(friction), always + FRICTION_LOSS * np.abs(friction)
        forwards = qd >= 0.0
        return np.array([np.where(forwards, lost, grown), np.where(forwards, grown, lost)])

    def _measure_noise(self, measured: Array, dt: float) -> None:
        """Follow the variance of a single measured torque by the difference of successive rows."""
        if self._measured is not None:
            var = 0.5 * _finite(measured - self._measured) ** 2
            share = min(dt / NOISE_S, 1.0)
            self._noise_var = self._noise_var + share * (np.minimum(var, NOISE_CLIP * self._noise_var) - self._noise_var)
        self._measured = measured

    def _learn(self, surprise: Array, speed: Array, PH: Array, own_var: Array, dt: float) -> None:
        """One step of the filter; a joint that stands teaches nothing. Särkkä (2013), ch. 4."""
        S = own_var + self._chance / dt + self._noise_var
        clip = CLIP_SIGMAS * np.sqrt(S)
        surprise = np.minimum(np.maximum(surprise, -clip), clip)
        moves = (speed > STILL_RAD_S) & np.isfinite(surprise)
        gain = np.where(moves, 1.0 / S, 0.0)[:, None] * PH  # (J, 4)
        theta = self._theta + gain * np.where(moves, surprise, 0.0)[:, None]
        self._theta = np.minimum(np.maximum(theta, -self._most_theta), self._most_theta)
        self._cov -= gain[:, :, None] * PH[:, None, :]
        self._cov += dt * self._walk


def _finite(values: Array) -> Array:
    """The same as `np.nan_to_num`, which is slow, and nearly always there is nothing to do."""
    return values if math.isfinite(float(values.sum())) else np.nan_to_num(values)


def band_for(
    row: Array,
    *,
    robot: Robot,
    excitation: Excitation,
    settings: ReplaySettings,
    context: Context,
    installation: Installation,
    basis: BandBasis,
) -> TorqueBand:
    """The torque band of a motion that is about to begin; `row` (WIDTH,) is what the controller reports before it.

    Payload and centre of mass are the configured ones, else the reported ones, with which the controller computes.
    Raises MotionRefused where a drive gain is not known.
    """
    column = layout_of(len(row)).column
    payload_kg = context.payload_kg if context.payload_kg is not None else float(np.nan_to_num(row[column["payload"]][0]))
    if basis.payload_kg is not None and abs(payload_kg - basis.payload_kg) > settings.max_payload_error_kg:
        basis = BandBasis()  # the payload is not configured, and the controller was told of another one than that of the model
    com_m: Sequence[float] = installation.payload_cog_m or row[column["payload_cog"]].tolist()
    known = all(math.isfinite(metres) for metres in com_m) and any(com_m)  # a controller that was never told says 0
    x, y, z = com_m
    return TorqueBand(
        robot,
        excitation.mounting,
        settings,
        installation,
        basis,
        payload_kg=payload_kg,
        payload_com_m=(x, y, z) if known else None,
    )


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
    column, width = layout(recording.q.shape[1])
    rows = np.full((recording.samples, width), np.nan)
    rows[:, column["timestamp"]] = recording.t_s[:, None]
    for name, values in (
        ("actual_q", recording.q),
        ("actual_qd", recording.qd),
        ("target_qdd", recording.target_qdd),
        ("actual_current", recording.current),
        ("joint_temperatures", recording.temperature_c),
    ):
        if values is not None:
            rows[:, column[name]] = values
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
