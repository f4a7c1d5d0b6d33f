"""What a fit shows of its recordings: joints that hardly moved, parameters that are not determined, and causes of a poor fit.

A joint whose residual is large has a warning of its own, `poor_fit`. Some causes also bend friction where the residual stays small: torque
that comes late against the motion looks viscous, and an offset looks like weight. These are fitted beside the law, on a part of the rows.
Each detector is a function of `Fitted`; `detectors` has the table. Joints that hardly move have a warning of their own and no other.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.signal

from monitor.identify.explanations import AS_WELL, OTHER_GAIN, OTHER_MOUNTING, OTHER_OFFSET, Explained, Explanations, unit_cause
from monitor.identify.fit.covariance import Causes
from monitor.identify.fit.fit import ONE_WAY_SHARE, Fit, FitProblem
from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.identify.fit.least_squares import Felt, Rows, best_condition, together
from monitor.identify.gain_check import GAIN_DOUBTFUL, gain_warnings
from monitor.identify.mounting import Upward, contradicting, mounting_warning
from monitor.identify.signals.filters import low_pass
from monitor.identify.signals.motion import Motion
from monitor.model.base import Base
from monitor.model.friction import smooth_sign
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason, Sentence, joints_by_number
from monitor.recording import Array, Indices, Mask

MOVING_SHARE = 0.2  # fraction of a recording's samples in which a joint moves: with less, its friction rests on a few seconds
USEFUL_SPEED_RAD_S = 0.2  # a joint that is always slower does not separate fc from fv
OUTLIER_WEIGHT = 0.2  # robust weight of a sample that is five standard deviations off
OUTLIER_SHARE = 0.01  # fraction of the samples with a lower weight; normal noise has none
SAMPLES_A_PARAMETER = 20  # fewer samples for each parameter are few
WORST_CONDITION = 1000.0  # an optimised excitation reaches 50–200: Raviola et al. (2021), table 3
MOST_RESIDUAL_RATIO = 1.02  # residual of the physically consistent fit over that of unconstrained least squares

NOISELESS = 0.008  # of the torque: the residual of real arms is 2–9 % of it on most joints, and on some joint always above 1 %
POOR = 0.15  # of the torque's RMS: the residual of real arms in motion is 2–9 % of it
LATE_S = 0.025  # real wrists grip before they slide, which looks like 10–22 ms; a filter or a slow clock delays by more
LATE_ALL_S = 0.017  # of the median joint; on real arms it is 5–12 ms
# faster changes [Hz] of the torque are those of reversals and of inertia, and so much of them must be there in the median joint; of real
# arms 0.75 to 1 and 0.63 to 1, as wrists grip before they slide; of a filter at 4 Hz 0.6 to 0.7 and 0.3
QUICK = ((1.5, 0.5), (3.5, 0.55))
# power of the drive's signal, logarithmic mean, at the second frequencies [Hz] beside that at the first: of real drives 0.05 to 0.6, as
# their noise has no end; after a filter at up to 10 Hz, or a mean over 80 ms, below 0.016
NOISE_HZ = ((5.0, 7.0), (14.0, 30.0))
NOISE_LEFT = 0.03
NOISE_WINDOW_S = 2.0
LEAST_RATE_HZ = 50.0  # that shows such noise
QUICK_SHARE = 0.02  # of the torque's RMS: with less, the motion has no quick changes
DRIFTS = 0.12  # of the torque, from the beginning of a recording to its end, in the median joint; of real arms 0.03 at most
LONGEST_S = 0.3  # delay that is tried
IMPROVED = 0.7  # of the residual may remain where a delay explains it
OFFSET = 0.15  # of the friction at 0.4 rad/s; on real arms it is below 0.1
SURE = 5.0  # standard deviations
ROWS = 1200  # of all recordings together, for causes that change slowly
# of the joint's largest torque, at 0.4 rad/s: of real arms 5–20 % by the motor's current; a sensor behind the gear sees none
FRICTION_SHARE = {"current": (0.012, 0.6), "torque": (-1.0, 0.6)}
WEIGHT_RATIO = (0.3, 4.0)  # of the manufacturer's arm; a payload near the limit doubles it on the joints that carry the arm
HEAVY = 0.08  # of the joint's largest torque: on a lighter joint a tool may weigh ten times as much as the arm outward of it
ALIKE = 0.9  # cosine at which the torques of the fitted arm and of the manufacturer's are the same but for their size
EXPLAINED = 0.5  # of the residual's square: another joint's motion explains it
REFERENCE_RAD_S = 0.4  # at which friction is compared: every joint in motion reaches it
# turns of a motor, by those of another joint
COUPLINGS = tuple(sign * quarter / 4.0 for quarter in range(1, 9) for sign in (1.0, -1.0))


LIKELY_CAUSE = Sentence(
    "likely_cause",
    "most likely {cause}{instead}: the joint that fits worst misses {left:.0%} of its torque then, and {share:.0%} as the recording is; "
    "nothing that was found of these joints is to be trusted",
)
OR_CAUSE = Sentence("or_cause", "; or {cause}")
NO_NOISE = Sentence(
    "no_noise",
    "the model misses {share:.1%} of the torque at most, on every joint, and no drive measures so well: "
    "these are what a controller wanted, or a simulation, and the friction is that of its model",
)
HARDLY_MOVES = Sentence(
    "joint_hardly_moves",
    "joint {joint} moves in {share:.0%} of the samples and never faster than {fastest_rad_s:.2g} rad/s: its friction is a guess",
)
ONE_DIRECTION = Sentence(
    "one_direction",
    "joint {joint} moves one way only: its Coulomb friction cannot be told from weight and from an offset of the drive; fv alone is quoted",
)
OUTLIERS = Sentence("outliers", "joint {joint}: {share:.1%} of the samples do not fit the rest and had next to no weight")
FEW_SAMPLES = Sentence("few_samples", "{samples} samples for {parameters} parameters; {enough} or more are better")
NOT_EXCITED = Sentence("not_excited", "this motion does not reveal {missing}: those values are the manufacturer's")
ILL_CONDITIONED = Sentence(
    "ill_conditioned", "the condition number of this motion is {condition:.3g}, in the best base; a designed excitation reaches 50–200"
)
UNPHYSICAL_FRICTION = Sentence(
    "unphysical_friction",
    "joint {joint}: fc = {fc_nm:.3g} N·m, fv = {fv_nm_s_per_rad:.3g} N·m·s/rad; friction cannot be negative: "
    "gains, model or motion are wrong",
)
FAR_FROM_PHYSICAL = Sentence(
    "far_from_physical",
    "the best arm that can exist leaves {more:.1%} more than the best that cannot: gains, mounting, robot or friction law are doubtful",
)
POOR_FIT = Sentence("poor_fit", "joint {joint}: the model misses {share:.0%} of the torque, on a sound recording below 10 %{also}")
COUPLED = Sentence(
    "coupled_friction",
    "; friction at the speed of joint {joint} {share:+.2g} × that of joint {other} explains most of it: coupled axes; "
    "expected the arm with its coupling, by --robot arm.toml or the transmissions of --urdf",
)
BY_OTHER_JOINT = Sentence("by_other_joint", "; the motion of joint {other} explains most of it: coupled axes, or exchanged columns")
ALL_JOINTS = Sentence("all_joints", "all joints")
TORQUE_DELAYED = Sentence(
    "torque_delayed",
    "current or torque of {joints} comes about {late_ms:.0f} ms {order:word} than the motion: "
    "this looks like viscous friction, and fv is not to be trusted",
)
TORQUE_SMOOTHED = Sentence(
    "torque_smoothed",
    "only {share:.0%} of what current or torque would change faster than {quick_hz:g} Hz is there: it was smoothed, "
    "and friction comes out too small",
)
NOISE_SMOOTHED = Sentence(
    "noise_smoothed",
    "current or torque has next to none of the noise that every drive has above {quick_hz:g} Hz: it was smoothed, and friction may come "
    "out some per cent too small",
)
TORQUE_DRIFTS = Sentence(
    "torque_drifts",
    "current or torque {change:word} by {share:.0%} beside the motion, from beginning to end: no friction does this in all joints at once",
)
TORQUE_OFFSET = Sentence(
    "torque_offset", "joint {joint}: current or torque has an offset of about {offset_nm:+.3g} N·m, which looks like weight"
)
FRICTION_SIZE = Sentence(
    "friction_size",
    "joint {joint}: friction of {friction_nm:.3g} N·m is {share:.2%} of the {most_nm:g} N·m that the joint can give: "
    "joint gains, or the unit of current or torque, are wrong",
)
UNIT_SIZE = Sentence(
    "unit_size",
    "{cause}: friction and weight are of sizes then that the joints can have, and as it is {count} of {of} joints have others",
)
WEIGHT_SIZE = Sentence(
    "weight_size",
    "joint {joint}: the arm seems to weigh {ratio:.2g} times what the manufacturer says: "
    "joint gains, their sign, or the robot's model are wrong",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Traces:
    """What was fitted beside the law, (J,) each."""

    late_s: Array  # the torque comes so much later than the motion
    late_std_s: Array
    offset_nm: Array
    offset_std_nm: Array


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what several detectors ask for is made once
class Fitted:
    """A fit, and what it was made of."""

    problem: FitProblem
    found: Fit
    causes: Causes
    robot: Robot
    mounting: Mounting
    base: Base
    moving: Sequence[Mask]  # (N, J) of each recording
    friction: Array  # (J, 2) fc [N·m] and fv [N·m·s/rad]; NaN where unknown
    relative_rms: Array  # (J,) residual over torque
    residual_ratio: float | None  # of the physically consistent arm; None: the method was another

    @cached_property
    def Y(self) -> Array:
        """`together` of the fit."""
        return together(self.found.joints)

    @property
    def fitted_base(self) -> Indices:
        """The base parameters that were fitted: all, or those of friction."""
        layout = self.problem.layout
        return np.flatnonzero(~layout.rigid) if layout.frozen else np.arange(self.base.count)

    @cached_property
    def seen(self) -> Mask:
        """(J,) the joints that move enough to tell something."""
        return moving_share([eq.used for eq in self.problem.equations]) > MOVING_SHARE

    @property
    def poor(self) -> Mask:
        """(J,) the joints whose residual is large."""
        return self.seen & (self.relative_rms > POOR)

    @property
    def friction_nm(self) -> Array:
        """(J,) friction at the reference speed; NaN for joints that hardly move."""
        return np.where(self.seen, self.friction @ [1.0, REFERENCE_RAD_S], np.nan)

    @cached_property
    def traces(self) -> _Traces:
        """Delay and offset of each joint's torque."""
        return _traces(self.problem, self.causes, self.found)

    @cached_property
    def upward(self) -> Upward | None:
        """Gravity in the data, where it has another direction than the mounting gives it."""
        equations = self.problem.equations
        return contradicting([eq.motion for eq in equations], [eq.torque_nm for eq in equations], self.robot, self.mounting)

    @cached_property
    def explained(self) -> list[Explained]:
        """What else the recordings may be, the likeliest first; none for sound recordings."""
        equations, up = self.problem.equations, self.upward
        motions, torques = [eq.motion for eq in equations], [eq.torque_nm for eq in equations]
        causes = Explanations(motions, torques, self.robot, self.mounting, None if up is None else up.mounting)
        return causes.likeliest() if up is not None or self.poor.any() or causes.doubtful else []

    @property
    def other(self) -> Explained | None:
        """The likeliest cause, where it is one that has no warning of its own: neither mounting nor offset, nor a gain of a sound fit."""
        best = self.explained[0] if self.explained else None
        if best is None or best.cause.code in (OTHER_MOUNTING.code, OTHER_OFFSET.code):
            return None
        if best.cause.code == OTHER_GAIN.code and not self.poor.any():
            return None
        return best if best.worst < POOR or not any(self.coupled.values()) else None

    @cached_property
    def coupled(self) -> dict[int, tuple[int, float] | None]:
        """What `_coupled` says of each joint (from 0) whose residual is large."""
        return {int(j): _coupled(self.problem, self.found, int(j)) for j in np.flatnonzero(self.poor)}

    @cached_property
    def wrong_sizes(self) -> list[Reason]:
        """What `sizes_doubtful` finds."""
        return list(_wrong_sizes(self))


# --- Motion, rows and solution ---------------------------------------------------------------------------


def likely_cause(fitted: Fitted) -> Iterator[Reason]:
    """What the recordings are, rather than what they were given as."""
    best = fitted.other
    if best is None:
        return
    others = [one for one in fitted.explained[1:] if one.drives == best.drives and one.score < best.score + AS_WELL]
    instead = OR_CAUSE(cause=others[0].cause) if others else ""
    worst = float(np.nanmax(fitted.relative_rms[fitted.seen]))
    yield LIKELY_CAUSE(cause=best.cause, instead=instead, share=worst, left=best.worst)


def mounting_contradiction(fitted: Fitted) -> Iterator[Reason]:
    """Gravity in the data has another direction than the mounting says, and nothing else explains the data better."""
    if fitted.upward is None or (fitted.explained and fitted.explained[0].cause.code != OTHER_MOUNTING.code):
        return
    equations = fitted.problem.equations
    motions, torques = [eq.motion for eq in equations], [eq.torque_nm for eq in equations]
    yield mounting_warning(fitted.upward, motions, torques, fitted.robot, fitted.mounting)


def no_noise(fitted: Fitted) -> Iterator[Reason]:
    """A fit without noise is none of a measurement."""
    if len(left := fitted.relative_rms[fitted.seen]) and float(np.max(left)) < NOISELESS:
        yield NO_NOISE(share=float(np.max(left)))


def moving_share(moving: Sequence[Mask]) -> Array:
    """(J,) fraction of the samples in which a joint moves, of the recording in which it moves most. moving : (N, J) of each recording.

    Of the sweeps of single joints each moves one joint throughout, and in all together every joint moves in a sixth of the samples.
    """
    share: Array = np.max([np.mean(one, axis=0) for one in moving], axis=0)
    return share


def poorly_moved(fitted: Fitted) -> Iterator[Reason]:
    """Joints that hardly move, or in one direction only."""
    qd, on = np.concatenate([eq.motion.qd for eq in fitted.problem.equations]), np.concatenate(fitted.moving)
    for j, share in enumerate(moving_share(fitted.moving).tolist()):
        fastest = float(np.max(np.abs(qd[:, j])))
        forward = float(np.mean(qd[on[:, j], j] > 0.0)) if share else 0.0
        if share < MOVING_SHARE or fastest < USEFUL_SPEED_RAD_S:
            yield HARDLY_MOVES(joint=j + 1, share=share, fastest_rad_s=fastest)
        elif min(forward, 1.0 - forward) < ONE_WAY_SHARE:
            yield ONE_DIRECTION(joint=j + 1)


def outliers(fitted: Fitted) -> Iterator[Reason]:
    """Joints of which many samples lost their weight in a robust fit."""
    weighted = [(rec.used, rec.robust_weight) for rec in fitted.found.rows if rec.robust_weight is not None]
    for j in range(fitted.robot.joints if weighted else 0):
        weight = np.concatenate([weights[used[:, j], j] for used, weights in weighted])
        share = float(np.mean(weight < OUTLIER_WEIGHT)) if len(weight) else 0.0
        if share > OUTLIER_SHARE:
            yield OUTLIERS(joint=j + 1, share=share)


def few_samples(fitted: Fitted) -> Iterator[Reason]:
    """Few samples for so many parameters."""
    samples, enough = sum(len(eq.torque_nm) for eq in fitted.problem.equations), SAMPLES_A_PARAMETER * fitted.base.count
    if samples < enough:
        yield FEW_SAMPLES(samples=samples, parameters=fitted.base.count, enough=enough)


def poorly_excited(fitted: Fitted) -> Iterator[Reason]:
    """Parameters that the motion does not determine, or a motion that hardly tells them apart."""
    layout, base = fitted.problem.layout, fitted.base
    excited = fitted.found.solution.excited[: base.count] | (layout.rigid & layout.frozen)
    if not np.all(excited):
        yield NOT_EXCITED(missing="; ".join(name for name, known in zip(base.names, excited, strict=True) if not known))
    elif (condition := best_condition(fitted.Y, base.combination, fitted.fitted_base)) > WORST_CONDITION:
        yield ILL_CONDITIONED(condition=condition)


def negative_friction(fitted: Fitted) -> Iterator[Reason]:
    """Friction that would drive a joint."""
    for j, (fc, fv) in enumerate(fitted.friction):
        if np.minimum(fc, fv) < 0.0 and fitted.other is None:
            yield UNPHYSICAL_FRICTION(joint=j + 1, fc_nm=fc, fv_nm_s_per_rad=fv)


def far_from_physical(fitted: Fitted) -> Iterator[Reason]:
    """The best arm that can exist fits much worse than the best that cannot."""
    if fitted.residual_ratio is not None and fitted.residual_ratio > MOST_RESIDUAL_RATIO:
        yield FAR_FROM_PHYSICAL(more=fitted.residual_ratio - 1.0)


# --- Causes of a poor fit, and causes that bend friction without a large residual ------------------------


def torque_delayed(fitted: Fitted) -> Iterator[Reason]:
    """Torque that comes late or early, in all joints or in some."""
    seen = fitted.seen
    if fitted.other is not None or not seen.any():
        return
    traces = _shifted(fitted.problem, fitted.found, fitted.traces, fitted.poor) if fitted.poor.any() else fitted.traces
    late, std = traces.late_s, traces.late_std_s
    sure = seen & (np.abs(late) > SURE * std)
    middle = float(np.median(late[seen]))
    # grip and wear of the gears make each joint's delay unsure; one clock delays all joints alike, and together they are sure
    certainty = np.where(seen, 1.0 / np.maximum(std, 1e-6) ** 2, 0.0)
    mean, mean_std = float(certainty @ np.nan_to_num(late) / np.sum(certainty)), float(1.0 / np.sqrt(np.sum(certainty)))
    if min(abs(middle), abs(mean)) > LATE_ALL_S and middle * mean > 0.0 and abs(mean) > SURE * mean_std:
        joints, size = ALL_JOINTS(), middle
    else:
        beyond = np.flatnonzero(sure & (np.abs(late - middle) > LATE_S))
        if not len(beyond):
            return
        joints, size = joints_by_number([int(j) + 1 for j in beyond]), float(late[beyond[0]])
    yield TORQUE_DELAYED(joints=joints, late_ms=1e3 * abs(size), order="later" if size > 0.0 else "earlier")


def _shifted(problem: FitProblem, found: Fit, traces: _Traces, poor: Mask) -> _Traces:
    """The delays, with those of the poor joints by trial: a delay of several samples is no small change of the torque any more."""
    late, std = traces.late_s.copy(), traces.late_std_s.copy()
    rate_hz = problem.equations[0].motion.rate_hz
    most = round(LONGEST_S * rate_hz)
    step = max(1, sum(len(rec.Y) for rec in found.rows) // ROWS)
    for j in np.flatnonzero(poor):
        columns, torques = [], []
        for rec in found.rows:
            at = np.arange(most, len(rec.Y) - most, step)
            at = at[rec.used[at, j] & (rec.segments[at - most] == rec.segments[at + most])]
            columns.append(rec.Y[at, j])
            torques.append(rec.torque_nm[at[:, None] + np.arange(-most, most + 1), j])
        A, b = np.concatenate(columns), np.concatenate(torques)  # (n, X), (n, S)
        if len(A) <= A.shape[1]:
            continue
        Q = np.linalg.qr(A[:, np.any(A != 0.0, axis=0)])[0]
        left = np.linalg.norm(b - Q @ (Q.T @ b), axis=0)  # (S,)
        best = int(np.argmin(left))
        if left[best] < IMPROVED * left[most]:
            late[j], std[j] = (best - most) / rate_hz, 0.0
    return replace(traces, late_s=late, late_std_s=std)


def _well_described(fitted: Fitted) -> Mask | None:
    """(J,) the joints that the model describes well; None where they are fewer than half, or the recording is another one."""
    well = fitted.seen & ~fitted.poor
    return well if fitted.other is None and np.sum(well) >= 0.5 * len(well) else None


def torque_smoothed(fitted: Fitted) -> Iterator[Reason]:
    """Torque without the quick changes that the fit has, or without the noise that a drive has."""
    well, causes = _well_described(fitted), fitted.causes
    if well is None:
        return
    rate_hz = fitted.problem.equations[0].motion.rate_hz / causes.every
    for quick_hz, least in QUICK:
        smooth = low_pass(rate_hz, 2, min(quick_hz, 0.2 * rate_hz))
        both, quick, size = np.zeros((3, len(well)))  # sums of squares and products
        for rec, torque in zip(causes.rows, fitted.found.torques, strict=True):
            expected_nm = torque[:: causes.every]
            fast, expected = (np.where(rec.used, signal - smooth(signal), 0.0) for signal in (rec.torque_nm, expected_nm))
            both += np.sum(fast * expected, axis=0)
            quick += np.sum(expected**2, axis=0)
            size += np.sum(expected_nm**2, axis=0)
        shown = well & (quick > QUICK_SHARE**2 * size)
        if np.sum(shown) >= 0.5 * len(well) and (left := float(np.median(both[shown] / quick[shown]))) < least:
            yield TORQUE_SMOOTHED(share=max(left, 0.0), quick_hz=quick_hz)
            return
    noise = [share for eq in fitted.problem.equations if (share := _noise_left(eq.motion)) is not None]
    if noise and max(noise) < NOISE_LEFT:
        yield NOISE_SMOOTHED(quick_hz=NOISE_HZ[1][0])


def _noise_left(motion: Motion) -> float | None:
    """The power of the drives' signals at the quicker of `NOISE_HZ` beside that at the slower, of the median joint that moves.

    None at rates that do not show it.
    """
    recording, keep = motion.recording, motion.rows.keep
    drive = recording.torque if recording.current is None else recording.current
    t_s = recording.t_s[keep]
    rate_hz = 1.0 / float(np.median(np.diff(t_s)))
    if drive is None or rate_hz < LEAST_RATE_HZ or t_s[-1] - t_s[0] < 2.0 * NOISE_WINDOW_S:
        return None
    even_s = np.arange(t_s[0], t_s[-1], 1.0 / rate_hz)
    moves = np.quantile(np.abs(motion.qd), 0.9, axis=0) > USEFUL_SPEED_RAD_S / 4.0
    even = np.array([np.interp(even_s, t_s, signal) for signal in drive[keep].T[moves]])
    if not len(even):
        return None
    at_hz, power = scipy.signal.welch(even, rate_hz, nperseg=round(NOISE_WINDOW_S * rate_hz))
    size = np.log(np.maximum(power, 1e-300))
    slow, quick = (np.mean(size[:, (at_hz >= low) & (at_hz < min(high, 0.45 * rate_hz))], axis=1) for low, high in NOISE_HZ)
    return math.exp(float(np.median(quick - slow)))


def torque_drifts(fitted: Fitted) -> Iterator[Reason]:
    """Torque whose size changes beside the motion, from the beginning of each recording to its end."""
    well, causes = _well_described(fitted), fitted.causes
    if well is None:
        return
    drift, drifted = np.zeros((2, len(well)))
    for rec, torque in zip(causes.rows, fitted.found.torques, strict=True):
        expected_nm = torque[:: causes.every]
        aged = np.where(rec.used, np.linspace(-0.5, 0.5, len(expected_nm))[:, None] * expected_nm, 0.0)
        drift += np.sum(aged * (rec.torque_nm - expected_nm), axis=0)
        drifted += np.sum(aged**2, axis=0)
    grown = float(np.median(drift[well] / np.maximum(drifted[well], 1e-300)))
    if abs(grown) > DRIFTS:
        yield TORQUE_DRIFTS(change="grows" if grown > 0.0 else "falls", share=abs(grown))


def torque_offset(fitted: Fitted) -> Iterator[Reason]:
    """Torque with an offset, which looks like weight."""
    if fitted.other is not None:
        return
    traces = fitted.traces
    sure = np.abs(traces.offset_nm) > np.maximum(SURE * traces.offset_std_nm, OFFSET * np.abs(fitted.friction_nm))
    for j in np.flatnonzero(sure):
        yield TORQUE_OFFSET(joint=j + 1, offset_nm=traces.offset_nm[j])


def poor_fit(fitted: Fitted) -> Iterator[Reason]:
    """Joints whose residual is large, and what explains it."""
    for j in np.flatnonzero(fitted.poor).tolist():
        also: Reason | str = ""
        if fitted.other is not None:
            pass  # it explains these joints too
        elif (coupled := fitted.coupled[j]) is not None:
            other, share = coupled
            also = COUPLED(joint=j + 1, share=share, other=other + 1)
        elif (cause := _explained_by(fitted.found, j, fitted.robot.joints)) is not None:
            also = BY_OTHER_JOINT(other=cause + 1)
        yield POOR_FIT(joint=j + 1, share=fitted.relative_rms[j], also=also)


def gains_doubtful(fitted: Fitted) -> Iterator[Reason]:
    """Gains that contradict each other or the arm's weight, where the fit is otherwise sound."""
    if fitted.other is None and not fitted.poor.any() and not fitted.wrong_sizes:
        yield from gain_warnings(fitted.problem, fitted.found, fitted.causes, fitted.robot, fitted.mounting, fitted.base)


def sizes_doubtful(fitted: Fitted) -> Iterator[Reason]:
    """Friction or weight of a size that the joint cannot have."""
    if fitted.other is None or fitted.other.cause.code == OTHER_GAIN.code:
        yield from fitted.wrong_sizes


def _wrong_sizes(fitted: Fitted) -> Iterator[Reason]:
    problem, robot, friction_nm = fitted.problem, fitted.robot, fitted.friction_nm
    nominal, values = fitted.base.combination @ robot.nominal_parameters(), fitted.found.solution.values[: fitted.base.count]
    cross, own, theirs = np.zeros((3, robot.joints))
    for eq in problem.equations:
        part = eq.Y.thinned(max(1, len(eq.Y) // ROWS), len(values))
        found_nm, given_nm = (part @ np.where(problem.layout.load, parameters, 0.0) for parameters in (values, nominal))
        cross += np.mean(found_nm * given_nm, axis=0)
        own += np.mean(given_nm**2, axis=0)
        theirs += np.mean(found_nm**2, axis=0)
    measured = any(eq.motion.current is None for eq in problem.equations)
    least, largest = FRICTION_SHARE["torque" if measured else "current"]
    most = np.where(np.isfinite(robot.max_torque_nm), robot.max_torque_nm, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        share, ratio = np.abs(friction_nm) / most, cross / own
        weighs = (np.sqrt(own) > HEAVY * most) & (np.abs(cross) > ALIKE * np.sqrt(own * theirs))

    def wrong(share: Array, ratio: Array) -> tuple[Mask, Mask]:
        """(J,) the joints whose friction, and those whose weight, is of another size than they can have; NaN is of none."""
        rubs = np.isfinite(share) & ~((share > least) & (share < largest))
        return rubs, np.isfinite(share) & ~rubs & weighs & ~((ratio > WEIGHT_RATIO[0]) & (ratio < WEIGHT_RATIO[1]))

    rubs, heavy = wrong(share, ratio)
    count, of = int(np.sum(rubs | heavy)), int(np.sum(np.isfinite(share)))
    cause, factor = unit_cause(robot, measured=measured)
    enough = 1 if measured else (of + 1) // 2  # an arm that is larger than the model says has some joints that rub too much
    if count >= max(enough, 1) and np.all(np.isfinite(factor)) and not np.any(wrong(share * factor, ratio * factor)):
        yield GAIN_DOUBTFUL(why=UNIT_SIZE(cause=cause, count=count, of=of))
        return
    for j in np.flatnonzero(rubs | heavy).tolist():
        if rubs[j]:
            yield GAIN_DOUBTFUL(why=FRICTION_SIZE(joint=j + 1, friction_nm=friction_nm[j], share=share[j], most_nm=most[j]))
        else:
            yield GAIN_DOUBTFUL(why=WEIGHT_SIZE(joint=j + 1, ratio=ratio[j]))


def _traces(problem: FitProblem, causes: Causes, found: Fit) -> _Traces:
    """Delay and offset of each joint's torque, fitted beside the law of the residual friction on a part of the rows."""
    solution, left = causes.beside(("delay", "offset"))
    scale = found.weights * np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))  # (J,) of the residual in units of the weights
    # residuals agree for half a second
    alike = np.sqrt(max(1.0, CORRELATED_S * problem.equations[0].motion.rate_hz / causes.every))
    J = len(scale)
    own = slice(len(solution.values) - 2 * J, None)  # each joint's delay and offset
    std = alike * scale[:, None] * np.linalg.norm(solution.directions[own], axis=1).reshape(J, 2)
    late, offset = np.where(solution.excited[own], solution.values[own], 0.0).reshape(J, 2).T
    return _Traces(late_s=late, late_std_s=std[:, 0], offset_nm=offset, offset_std_nm=std[:, 1])


def _explained_by(found: Fit, j: int, joints: int) -> int | None:
    """The other joint (from 0) whose motion explains the residual of joint j, None where none does."""
    residual = np.concatenate([left[rec.used[:, j], j] for rec, left in zip(found.rows, found.residuals, strict=True)])
    best, share = None, EXPLAINED
    for k in range(joints):
        if k == j:
            continue
        columns = np.concatenate([_own_motion(rec, k)[rec.used[:, j]] for rec in found.rows])
        fitted = columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        explained = float(fitted @ fitted / max(residual @ residual, 1e-300))
        if explained > share:
            best, share = k, explained
    return best


def _coupled(problem: FitProblem, found: Fit, j: int) -> tuple[int, float] | None:
    """The other joint (from 0), and the share of its speed, with which a motor turns that joint j's friction is of; None where none is."""
    step = max(1, sum(len(rec.Y) for rec in found.rows) // ROWS)
    residuals, speeds = [], []
    for eq, rec, left in zip(problem.equations, found.rows, found.residuals, strict=True):
        at = np.flatnonzero(rec.used[:, j])[::step]
        residuals.append(left[at, j])
        speeds.append(eq.motion.qd[at])
    residual, qd = np.concatenate(residuals), np.concatenate(speeds)  # (n,), (n, J)
    own = [smooth_sign(qd[:, j]), qd[:, j]]
    size, best, chosen = float(residual @ residual), EXPLAINED, None
    for k in range(qd.shape[1]):
        for share in COUPLINGS if k != j else ():
            turns = qd[:, j] + share * qd[:, k]
            columns = np.stack([*own, smooth_sign(turns), turns], axis=1)
            fitted = columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
            explained = float(fitted @ fitted) / max(size, 1e-300)
            if explained > best:
                best, chosen = explained, (k, share)
    return chosen


def _own_motion(rec: Rows, k: int) -> Array:
    """(n, E) what moves with joint k alone: the columns that joint k feels and no other joint does, friction among them.

    The arm decides which they are, not the recording, so that recordings of different motions agree.
    """
    Y = Felt.of(rec.Y)
    others = np.concatenate([places for j, places in enumerate(Y.places) if j != k])
    own = ~np.isin(Y.places[k], others)
    return np.concatenate([blocks[k][:, own] for _, blocks in Y.pieces()])
