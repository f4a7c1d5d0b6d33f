"""Why a fit is poor: the causes that leave a trace in the residual, joint by joint.

A joint whose residual is large has a warning of its own, `poor_fit`. Some causes also bend friction where the residual stays small: torque
that comes late against the motion looks viscous, and an offset looks like weight. These are fitted beside the law, on a part of the rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from monitor.identify.fit.covariance import Causes
from monitor.identify.fit.fit import Fit, FitProblem
from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.identify.fit.least_squares import Felt, Rows
from monitor.identify.gain_check import GAIN_DOUBTFUL
from monitor.identify.signals.filters import low_pass
from monitor.identify.signals.order import median
from monitor.identify.warnings import MOVING_SHARE, moving_share
from monitor.model.friction import smooth_sign
from monitor.model.robot import Robot
from monitor.reason import Reason, Sentence, joints_by_number
from monitor.recording import Array, Mask

POOR = 0.15  # of the torque's RMS: the residual of real arms in motion is 2–9 % of it
LATE_S = 0.025  # real wrists grip before they slide, which looks like 10–22 ms; a filter or a slow clock delays by more
LATE_ALL_S = 0.017  # of the median joint; on real arms it is 5–12 ms
QUICK_HZ = 1.5  # faster changes of the torque are those of reversals and of inertia
SMOOTHED = 0.5  # of them may be missing in the median joint; of real arms 0.17–0.34, as wrists grip before they slide
QUICK_SHARE = 0.02  # of the torque's RMS: with less, the motion has no quick changes
DRIFTS = 0.12  # of the torque, from the beginning of a recording to its end, in the median joint; of real arms 0.03 at most
LONGEST_S = 0.3  # delay that is tried
IMPROVED = 0.7  # of the residual may remain where a delay explains it
OFFSET = 0.15  # of the friction at 0.4 rad/s; on real arms it is below 0.1
SURE = 5.0  # standard deviations
ROWS = 1200  # of all recordings together, for causes that change slowly
# of the joint's largest torque, at 0.4 rad/s: of real arms 5–20 % by the motor's current, and 0.5 % or more by sensors behind the gear
FRICTION_SHARE = {"current": (0.012, 0.6), "torque": (0.002, 0.6)}
WEIGHT_RATIO = (0.3, 4.0)  # of the manufacturer's arm; a payload near the limit doubles it on the joints that carry the arm
HEAVY = 0.08  # of the joint's largest torque: on a lighter joint a tool may weigh ten times as much as the arm outward of it
ALIKE = 0.9  # cosine at which the torques of the fitted arm and of the manufacturer's are the same but for their size
EXPLAINED = 0.5  # of the residual's square: another joint's motion explains it
REFERENCE_RAD_S = 0.4  # at which friction is compared: every joint in motion reaches it
# turns of a motor, by those of another joint
COUPLINGS = tuple(sign * quarter / 4.0 for quarter in range(1, 9) for sign in (1.0, -1.0))

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


def diagnose(
    problem: FitProblem, found: Fit, causes: Causes, robot: Robot, *, nominal: Array, friction_nm: Array, relative_rms: Array
) -> Iterator[Reason]:
    """Warnings about fits that are poor, and about causes that bend friction without a large residual.

    causes : of the fit. nominal : (B,) the manufacturer's base parameters. friction_nm : (J,) at 0.4 rad/s.
    relative_rms : (J,) residual over torque.
    Joints that hardly move have a warning of their own and none of these.
    """
    seen = moving_share([eq.used for eq in problem.equations]) > MOVING_SHARE  # (J,)
    friction_nm = np.where(seen, friction_nm, np.nan)
    traces = _traces(problem, causes, found)
    poor = seen & (relative_rms > POOR)
    yield from _late(_shifted(problem, found, traces, poor) if poor.any() else traces, seen)
    yield from _offsets(traces, friction_nm)
    yield from _shapes(found, causes, problem.equations[0].motion.rate_hz, seen & ~poor)
    yield from _gains(problem, robot, nominal, found.solution.values[: len(problem.prior)], friction_nm)
    relative_rms = np.where(seen, relative_rms, np.nan)
    for j in np.flatnonzero(relative_rms > POOR):
        also: Reason | str = ""
        if (coupled := _coupled(problem, found, int(j))) is not None:
            other, share = coupled
            also = COUPLED(joint=j + 1, share=share, other=other + 1)
        elif (cause := _explained_by(found, int(j), len(relative_rms))) is not None:
            also = BY_OTHER_JOINT(other=cause + 1)
        yield POOR_FIT(joint=j + 1, share=relative_rms[j], also=also)


def _late(traces: _Traces, seen: Mask) -> Iterator[Reason]:
    if not seen.any():
        return
    late, std = traces.late_s, traces.late_std_s
    sure = seen & (np.abs(late) > SURE * std)
    middle = median(late[seen])
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


def _shapes(found: Fit, causes: Causes, rate_hz: float, well: Mask) -> Iterator[Reason]:
    """Torque that was smoothed, or whose size drifts, in the joints that the model describes `well` (J,).

    The torque of the fit is compared with the measured one above `QUICK_HZ`, and between the beginning and the end of each recording.
    """
    if np.sum(well) < 0.5 * len(well):
        return
    smooth = low_pass(rate_hz / causes.every, 2, min(QUICK_HZ, 0.2 * rate_hz / causes.every))
    both, quick, size, drift, drifted = np.zeros((5, len(well)))  # sums of squares and products
    for rec, torque in zip(causes.rows, found.torques, strict=True):
        measured, fitted = both_torques = rec.torque_nm, torque[:: causes.every]
        slow = np.split(smooth(np.concatenate(both_torques, axis=1)), 2, axis=1)
        fast, expected = (np.where(rec.used, signal - rest, 0.0) for signal, rest in zip(both_torques, slow, strict=True))
        both, quick, size = both + np.sum(fast * expected, axis=0), quick + np.sum(expected**2, axis=0), size + np.sum(fitted**2, axis=0)
        aged = np.where(rec.used, np.linspace(-0.5, 0.5, len(fitted))[:, None] * fitted, 0.0)
        drift, drifted = drift + np.sum(aged * (measured - fitted), axis=0), drifted + np.sum(aged**2, axis=0)
    shown = well & (quick > QUICK_SHARE**2 * size)
    if np.sum(shown) >= 0.5 * len(well) and (left := median(both[shown] / quick[shown])) < SMOOTHED:
        yield TORQUE_SMOOTHED(share=max(left, 0.0), quick_hz=QUICK_HZ)
    grown = median(drift[well] / np.maximum(drifted[well], 1e-300))
    if abs(grown) > DRIFTS:
        yield TORQUE_DRIFTS(change="grows" if grown > 0.0 else "falls", share=abs(grown))


def _offsets(traces: _Traces, friction_nm: Array) -> Iterator[Reason]:
    sure = np.abs(traces.offset_nm) > np.maximum(SURE * traces.offset_std_nm, OFFSET * np.abs(friction_nm))
    for j in np.flatnonzero(sure):
        yield TORQUE_OFFSET(joint=j + 1, offset_nm=traces.offset_nm[j])


def _gains(problem: FitProblem, robot: Robot, nominal: Array, values: Array, friction_nm: Array) -> Iterator[Reason]:
    """Friction or weight of a size that the joint cannot have."""
    weight = [0.0] * robot.joints, [0.0] * robot.joints, [0.0] * robot.joints
    for eq in problem.equations:
        part = eq.Y.thinned(max(1, len(eq.Y) // ROWS), len(values))
        fitted, given = part @ np.where(problem.layout.load, values, 0.0), part @ np.where(problem.layout.load, nominal, 0.0)
        for total, product in zip(weight, (fitted * given, given * given, fitted * fitted), strict=True):
            total[:] = [sum(pair) for pair in zip(total, np.mean(product, axis=0), strict=True)]
    cross, own, theirs = (np.array(total) for total in weight)
    least, largest = FRICTION_SHARE["torque" if any(eq.motion.torque is not None for eq in problem.equations) else "current"]
    for j in range(robot.joints):
        most = float(robot.max_torque_nm[j])
        share = abs(float(friction_nm[j])) / most
        if not (np.isfinite(most) and np.isfinite(share)):
            continue
        if not least < share < largest:
            yield GAIN_DOUBTFUL(why=FRICTION_SIZE(joint=j + 1, friction_nm=friction_nm[j], share=share, most_nm=most))
        elif np.sqrt(own[j]) > HEAVY * most and abs(cross[j]) > ALIKE * np.sqrt(own[j] * theirs[j]):
            ratio = float(cross[j] / own[j])
            if not WEIGHT_RATIO[0] < ratio < WEIGHT_RATIO[1]:
                yield GAIN_DOUBTFUL(why=WEIGHT_SIZE(joint=j + 1, ratio=ratio))


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
