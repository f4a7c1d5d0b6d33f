"""Joint gains from currents beside torques: an e-Series controller from software 5.23 on reports both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.fit.jackknife import block_steps, jackknife_covariance
from monitor.identify.fit.least_squares import Factor, Rows, factors, residual_rms, solve
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.arm import motion_of
from monitor.identify.signals.motion import Motion
from monitor.model.base import base_parameters
from monitor.model.friction import residual_law
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array, Mask, Recording

LARGEST_MISFIT = 0.01  # of the torque, RMS: beyond it the reported torque is no multiple of the current
LEAST_CURRENT_A = 1e-3  # RMS: a joint with less says nothing


def gains_from_torque(current_a: Array, torque_nm: Array) -> Array:
    """(J,) torque per ampere [N·m/A]; NaN for a joint whose torque is no multiple of its current.

    current_a, torque_nm : (N, J) of the same ticks. A controller may report a torque from which gravity has been taken away; that torque
    is no multiple of the current while the arm stands in different attitudes, and for it no gain is given.
    """
    square = np.mean(current_a**2, axis=0)  # (J,) [A²]
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = np.mean(current_a * torque_nm, axis=0) / square
        misfit = np.sqrt(np.mean((torque_nm - gains * current_a) ** 2, axis=0) / np.mean(torque_nm**2, axis=0))
    shown = (np.sqrt(square) > LEAST_CURRENT_A) & (gains > 0.0) & (misfit <= LARGEST_MISFIT)
    return np.where(shown, gains, np.nan)


# --- Joint gains from a known payload: the torque per ampere of each joint, Gautier and Briot (2014) ----

LOAD_ROUNDS = 3  # the load on the gears and the gains are found in turn; each round gains a digit or more
STEPS = 40  # of Gauss and Newton, at most; 6–10 are usual
HALVINGS = 12  # of a step that increases the cost, at most
SETTLED = 1e-7  # relative change of the gains at which the steps end
PRIOR_STD = 1.5  # of log gain about the arm's typical one: so wide that it only limits the gain of a joint without information
LARGEST_STD = 0.5  # of log gain: an uncertainty beyond a factor of 1.6 is no estimate
OVERLOAD = 2.0  # of the payload that the manufacturer allows: a larger mass is an input error
FARTHEST_M = 2.0  # from the flange to the payload's centre: a larger distance is an input error
BLOCK_S = 0.8  # jackknife block, as in `IdentifySettings`: residuals are correlated for half a second


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gains:
    """Torque per ampere of each joint, from a pair of runs without and with a payload."""

    values: Array  # (J,) [N·m/A]; NaN where the pair does not determine the gain
    std: Array  # (J,) by the jackknife, which accounts for correlated residuals; infinite where the value is NaN
    covariance: Array  # (J, J) of values; the uncertainty of the payload's mass is common to all joints
    rms_a: Array  # (J,) residual of the currents [A]


class _Run(NamedTuple):
    """One recording's equations: g·i = Y·b + known."""

    moved: Motion
    current: Array  # (N, J) [A]
    rigid: int  # number of columns of Y, and of parameters in b, of the rigid arm
    Y: Array  # (N, J, B')
    known_nm: Array  # (N, J) torque of the payload; 0 in the run without it


def payload_gains(
    unloaded: Recording,
    loaded: Recording,
    robot: Robot,
    mounting: Mounting,
    payload_kg: float,
    payload_com_m: Sequence[float],
    *,
    payload_inertia_kg_m2: Array | None = None,
    payload_std_kg: float = 0.0,
    settings: SignalSettings | None = None,
) -> Gains:
    """Joint gains from one run without and one with a known mass at the flange. Both runs best follow the same trajectory.

    payload_com_m : (3,) in the flange's frame, DH frame J. payload_inertia_kg_m2 : (3, 3) about its centre of mass; None for a point
    mass. payload_std_kg : standard deviation of the mass. The rigid arm is the same in both runs. Friction differs, since the payload and
    the temperature change it. Raises BadInput where currents are missing or an argument is implausible, Unidentifiable where the two runs
    do not show the payload on any joint.
    """
    com = np.asarray(payload_com_m, dtype=float)
    _refuse_no_payload(payload_kg, com, payload_com_m, payload_std_kg, robot)
    payload = _standard(payload_kg, com, np.zeros((3, 3)) if payload_inertia_kg_m2 is None else payload_inertia_kg_m2)
    moved = [_moved(recording, robot, settings or SignalSettings()) for recording in (unloaded, loaded)]
    if unloaded.current is not None and loaded.current is not None and np.array_equal(unloaded.current, loaded.current):
        raise Unidentifiable("payload pair: both runs are the same recording; expected one run without the payload and one with it")
    runs = _equations(moved, robot, mounting, payload)
    J = robot.joints
    joints = _factors(runs)
    weights = 1.0 / np.maximum([_noise(factor) for factor in joints], 1e-12)
    start = _start(joints)
    typical = float(np.median(start))
    x = _settled(joints, weights, start, typical, J)
    for _ in range(LOAD_ROUNDS):
        with_load = [_with_load(run, x[J:]) for run in runs]
        joints = _factors(with_load)
        x = _settled(joints, weights, x[:J], typical, J)
        weights = 1.0 / np.maximum(residual_rms(_linearised(joints, x, J), x), 1e-12)
    at_end = [_linear_rows(run, x, J) for run in with_load]
    final = solve([*factors(at_end), _prior(typical, x, J)], np.append(weights, 1.0), x)
    log_covariance = jackknife_covariance(at_end, weights, final)[:J, :J]
    textbook = np.sum(final.directions[:J] ** 2, axis=1)  # (J,) variance for independent residuals, the prior included
    shown = final.excited[:J] & (np.sqrt(np.maximum(np.diag(log_covariance), textbook)) < LARGEST_STD)
    if not np.any(shown):
        raise Unidentifiable("payload pair: the currents do not show the payload on any joint; expected one run without and one with it")
    rms_a = residual_rms(_linearised(joints, x, J), x)
    return _gains(x[:J], log_covariance + (payload_std_kg / payload_kg) ** 2, shown, rms_a)


def _refuse_no_payload(payload_kg: float, com: Array, com_as_given: Sequence[float], payload_std_kg: float, robot: Robot) -> None:
    """Raises BadInput where mass, centre or standard deviation are no payload's, or the robot cannot carry the mass."""
    if not (np.isfinite(payload_kg) and payload_kg > 0.0) or com.shape != (3,) or not np.all(np.isfinite(com)):
        raise BadInput(f"payload: {payload_kg!r} kg at {com_as_given!r} m; expected a positive mass and three finite coordinates")
    if payload_kg > OVERLOAD * robot.payload_max_kg:
        raise BadInput(f"payload: {payload_kg:g} kg; a {robot.name} carries {robot.payload_max_kg:g} kg")
    if np.max(np.abs(com)) > FARTHEST_M:
        raise BadInput(f"payload: its centre {com_as_given!r} m is farther than {FARTHEST_M:g} m from the flange")
    if not (np.isfinite(payload_std_kg) and payload_std_kg >= 0.0):
        raise BadInput(f"payload: standard deviation {payload_std_kg!r} kg; expected 0 or more")


def _gains(log_gains: Array, log_covariance: Array, shown: Mask, rms_a: Array) -> Gains:
    """Gains from their logarithms (J,) with covariance (J, J). shown : (J,) the joints whose gain the pair determines."""
    values = np.exp(log_gains)
    covariance = values[:, None] * log_covariance * values
    covariance[~np.logical_and.outer(shown, shown)] = 0.0
    covariance[~shown, ~shown] = np.inf
    return Gains(values=np.where(shown, values, np.nan), std=np.sqrt(np.diag(covariance)), covariance=covariance, rms_a=rms_a)


def _standard(mass: float, com: Array, about_com: Array) -> Array:
    """(10,) inertial parameters about the flange's origin, from the tensor (3, 3) about the centre of mass [kg·m²]."""
    J = about_com + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]])


def _moved(recording: Recording, robot: Robot, settings: SignalSettings) -> Motion:
    """The recording as a motion. Raises BadInput where it holds no currents or is of another arm, Unidentifiable as `motion`."""
    name = recording.source or "recording"
    if recording.current is None:
        raise BadInput(f"{name}: holds no currents; gains are what a current becomes: record actual_current")
    if recording.joints != robot.joints:
        raise BadInput(f"{name}: has {recording.joints} joints; {robot.name} has {robot.joints}")
    return motion_of(recording, robot, settings)


def _equations(moved: Sequence[Motion], robot: Robot, mounting: Mounting, payload: Array) -> list[_Run]:
    """Columns of the rigid base parameters, which both runs share, then each run's own friction by the terms without load.

    payload : (10,) as from `_standard`; its torque is known in the second run. The friction is that of the residual law: a line fitted
    to a concave law would change with the load, and the gains would absorb that change.
    """
    base = base_parameters(robot, mounting)
    J = robot.joints
    friction = set(np.concatenate(friction_columns(J)).tolist())
    rigid = [column for column in base.columns if column not in friction]
    last = slice(PER_JOINT * (J - 1), PER_JOINT * (J - 1) + INERTIAL)
    result = []
    for number, run in enumerate(moved):
        current = run.current
        if current is None:  # `_moved` refuses such a recording
            raise BadInput(f"{run.source}: holds no currents")
        Y = regressor(robot, mounting, run.q, run.qd, run.qdd)
        unloaded = np.zeros_like(run.qd)
        terms = [term for term in residual_law().terms if not term.loaded]
        own = np.concatenate([_by_joint(term.column(run.direction, run.qd, unloaded)) for term in terms], axis=2)
        other = np.zeros_like(own)
        columns = [Y[:, :, rigid], *((own, other) if number == 0 else (other, own))]
        known = Y[:, :, last] @ payload if number else np.zeros(run.q.shape)
        result.append(_Run(run, current, len(rigid), np.concatenate(columns, axis=2), known))
    return result


def _with_load(run: _Run, b: Array) -> _Run:
    """Friction terms that depend on the load, with parameters that both runs share. The load is predicted by b (B',).

    Without them the friction that the payload causes would count as its weight.
    """
    load = run.Y[:, :, : run.rigid] @ b[: run.rigid] + run.known_nm  # (N, J)
    terms = [term for term in residual_law().terms if term.loaded]
    shared = [_by_joint(term.column(run.moved.direction, run.moved.qd, load)) for term in terms]
    return run._replace(Y=np.concatenate([run.Y, *shared], axis=2))


def _by_joint(column: Array) -> Array:
    """(N, J) → (N, J, J): a parameter of one joint acts on no other joint."""
    J = column.shape[1]
    result = np.zeros((*column.shape, J))
    result[:, np.arange(J), np.arange(J)] = column
    return result


def _factors(runs: Sequence[_Run]) -> list[Factor]:
    """The factor of [Y, payload, current] of each joint. The steps need no rows, only these."""
    return factors([_rows(run, np.concatenate([run.Y, run.known_nm[:, :, None]], axis=2), run.current) for run in runs])


def _prior(typical: float, x: Array, J: int) -> Factor:
    """Rows that hold the log gains (first J of x) near the typical one, with the standard deviation `PRIOR_STD`."""
    return Factor(np.eye(J, len(x) + 1) / PRIOR_STD + np.eye(1, len(x) + 1, len(x)) * (typical / PRIOR_STD), J)


def _settled(joints: Sequence[Factor], weights: Array, log_gains: Array, typical: float, J: int) -> Array:
    """(J + B',) log gains and parameters at the minimum, from log gains (J,) on.

    Gauss–Newton in the gains; the parameters are solved exactly for each set of gains. Raises Unidentifiable without convergence.
    """
    x, cost = _best(joints, weights, log_gains, typical)
    for _ in range(STEPS):
        step = (solve([*_linearised(joints, x, J), _prior(typical, x, J)], np.append(weights, 1.0), x).values - x)[:J]
        step *= min(1.0, 1.0 / max(1e-12, float(np.max(np.abs(step)))))  # a gain changes by a factor e at most in one step
        for _ in range(HALVINGS):
            tried, its_cost = _best(joints, weights, x[:J] + step, typical)
            if its_cost <= cost:
                break
            step *= 0.5
        else:
            return x  # only rounding is left
        gained = cost - its_cost
        x, cost = tried, its_cost
        if np.max(np.abs(step)) < SETTLED or gained < 1e-9 * cost:
            return x
    raise Unidentifiable("payload pair: the gains do not settle; expected the same arm with and without the payload, well excited")


def _best(joints: Sequence[Factor], weights: Array, log_gains: Array, typical: float) -> tuple[Array, float]:
    """(J + B',) the given log gains with the parameters that fit them best, and the sum of squares with that of the prior."""
    gains = np.exp(log_gains)
    # b given the gains: current·g − payload = Y b
    at_joint = [Factor(np.column_stack([f.R[:, :-2], g * f.R[:, -1] - f.R[:, -2]]), f.samples) for f, g in zip(joints, gains, strict=True)]
    b = solve(at_joint, weights / gains, np.zeros(joints[0].R.shape[1] - 2)).values
    misfit = [weight / g * np.linalg.norm(f.R @ np.append(b, -1.0)) for f, g, weight in zip(at_joint, gains, weights, strict=True)]
    return np.append(log_gains, b), float(np.sum(np.square(misfit)) + np.sum((log_gains - typical) ** 2) / PRIOR_STD**2)


def _rows(run: _Run, Y: Array, right: Array) -> Rows:
    """The equations with these columns Y and right side (N, J), of the samples in which a joint moves."""
    return Rows(Y, right, run.moved.moving(), block_steps(run.moved, BLOCK_S), run.moved.segments)


def _noise(factor: Factor) -> float:
    """Standard deviation of one joint's current [A] about the best fit with parameters of this joint alone."""
    A, b = factor.R[:, :-1], factor.R[:, -1]
    rest = b - A @ np.linalg.lstsq(A, b, rcond=1e-9)[0]
    return float(np.linalg.norm(rest)) / math.sqrt(max(1, factor.samples))


def _start(joints: Sequence[Factor]) -> Array:
    """(J,) first log gains: each joint's own estimate, and the median of the others where a joint gives none.

    Raises Unidentifiable where no joint gives one.
    """
    gains = np.full(len(joints), np.nan)
    for j, factor in enumerate(joints):
        per_nm = np.linalg.lstsq(factor.R[:, :-1], factor.R[:, -1], rcond=1e-9)[0][-1]
        if per_nm > 0.0:
            gains[j] = 1.0 / per_nm
    if np.all(np.isnan(gains)):
        raise Unidentifiable("payload pair: the currents do not show the payload on any joint; expected one run without and one with it")
    middle = float(np.nanmedian(gains))
    log_gains: Array = np.log(np.clip(np.where(np.isnan(gains), middle, gains), 0.2 * middle, 5.0 * middle))
    return log_gains


def _linearised(joints: Sequence[Factor], x: Array, J: int) -> list[Factor]:
    """The factors of `linearised_current` about x, one of each joint."""
    return [Factor(linearised_current(f.R[:, :-2], f.R[:, -2], f.R[:, -1], x, j, J), f.samples) for j, f in enumerate(joints)]


def linearised_current(Y: Array, known_nm: Array, current: Array, x: Array, j: int, J: int) -> Array:
    """The model current of joint j, i = (Y·b + known)/g, linearised about x = [log g; b]: (n, J + B' + 1).

    Y : (n, B'). known_nm : (n,) torque of the payload. current : (n,) [A]. The first J + B' columns are the derivative by x. The last
    column is the current that the derivative times (x + δ) must equal.
    """
    per_nm = np.exp(-x[j])
    model = (Y @ x[J:] + known_nm) * per_nm
    derivative = np.zeros((len(Y), len(x)))
    derivative[:, j] = -model
    derivative[:, J:] = Y * per_nm
    return np.column_stack([derivative, current - model + derivative @ x])


def _linear_rows(run: _Run, x: Array, J: int) -> Rows:
    """The linearised equations of every sample, for the jackknife."""
    by_joint = [linearised_current(run.Y[:, j], run.known_nm[:, j], run.current[:, j], x, j, J) for j in range(J)]
    stacked = np.stack(by_joint, axis=1)  # (N, J, J + B' + 1)
    return _rows(run, stacked[:, :, :-1], stacked[:, :, -1])
