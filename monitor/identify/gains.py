"""Joint gains from a known payload: what one ampere is in newton metres, Gautier and Briot (2014).

Torque in amperes leaves the scale of all parameters open: an arm twice as heavy with gains twice as large draws the same current. A
known mass closes it. The noise is in the currents, and those multiply the gains: plain least squares would make every gain too
small. Total least squares moves the currents instead, Σ‖(gⱼ·iⱼ − torqueⱼ)/(gⱼ·σⱼ)‖² → min (the regressor is taken as exact), which is
least squares of the currents in b and 1/gⱼ, and with log gⱼ for gⱼ no gain can become negative.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.fit.jackknife import block_steps, jackknife_covariance
from monitor.identify.fit.least_squares import Factor, Rows, factors, residual_rms, solve
from monitor.identify.signals.checks import refuse_other_arm
from monitor.identify.signals.motion import Motion, SignalSettings, motion
from monitor.model.base import base_parameters
from monitor.model.friction import residual_law
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array, Recording

LOAD_ROUNDS = 3  # the load on the gears and the gains are found in turn; each round gains a digit or more
STEPS = 40  # of Gauss and Newton, at most: 6–10 do
HALVINGS = 12  # of a step that leads up
SETTLED = 1e-7  # relative change of the gains
PRIOR_STD = 1.5  # of log gain about the arm's typical one: keeps a joint that shows nothing from drifting to infinity, and no other
TELLING_STD = 0.5  # of log gain: a wider doubt than a factor 1.6 is no estimate
OVERLOAD = 2.0  # of the payload the manufacturer allows: more, and it was no payload
FARTHEST_M = 2.0
BLOCK_S = 0.8  # as in identify: residuals stay correlated for half a second


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gains:
    """What a payload pair says of the drives."""

    values: Array  # (J,) [N·m/A]; NaN where this pair says nothing
    std: Array  # (J,) honest for correlated residuals; infinite where the value is NaN
    covariance: Array  # (J, J) of values; a doubt about the payload's mass is common to all joints
    rms_a: Array  # (J,) residual of the currents [A]


class _Run(NamedTuple):
    """One recording's equations: g·i = Y·b + known."""

    moved: Motion
    current: Array  # (N, J) [A]
    rigid: int  # columns of Y, and parameters in b, that are the rigid arm's
    Y: Array  # (N, J, B')
    known_nm: Array  # (N, J) torque of the payload


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
    """Joint gains from one run without and one with a known mass at the flange; best the same trajectory.

    payload_com_m : in the flange's frame, DH frame J. payload_inertia_kg_m2 : (3, 3) about its centre of mass, or None for a point.
    The rigid arm is the same in both runs; friction is not, since a payload and the temperature change it. Raises BadInput where
    currents are missing or an argument is no payload, Unidentifiable where the two runs do not show it on any joint.
    """
    com = np.asarray(payload_com_m, dtype=float)
    if not (np.isfinite(payload_kg) and payload_kg > 0.0) or com.shape != (3,) or not np.all(np.isfinite(com)):
        raise BadInput(f"payload: {payload_kg!r} kg at {payload_com_m!r} m; expected a positive mass and three finite coordinates")
    if payload_kg > OVERLOAD * robot.payload_max_kg:
        raise BadInput(f"payload: {payload_kg:g} kg; a {robot.name} carries {robot.payload_max_kg:g} kg")
    if np.max(np.abs(com)) > FARTHEST_M:
        raise BadInput(f"payload: its centre {payload_com_m!r} m is farther than {FARTHEST_M:g} m from the flange")
    if not (np.isfinite(payload_std_kg) and payload_std_kg >= 0.0):
        raise BadInput(f"payload: standard deviation {payload_std_kg!r} kg; expected 0 or more")
    payload = _standard(payload_kg, com, np.zeros((3, 3)) if payload_inertia_kg_m2 is None else payload_inertia_kg_m2)
    moved = [_moved(recording, robot, settings or SignalSettings()) for recording in (unloaded, loaded)]
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
    textbook = np.sum(final.directions[:J] ** 2, axis=1)  # (J,) variance if residuals were independent, the prior included
    shown = final.excited[:J] & (np.sqrt(np.maximum(np.diag(log_covariance), textbook)) < TELLING_STD)
    if not np.any(shown):
        raise Unidentifiable("payload pair: the currents do not show the payload on any joint; expected one run without and one with it")
    log_covariance = log_covariance + (payload_std_kg / payload_kg) ** 2
    values = np.exp(x[:J])
    covariance = values[:, None] * log_covariance * values
    covariance[~np.logical_and.outer(shown, shown)] = 0.0
    covariance[~shown, ~shown] = np.inf
    return Gains(
        values=np.where(shown, values, np.nan),
        std=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        rms_a=residual_rms(_linearised(joints, x, J), x),
    )


def _standard(mass: float, com: Array, about_com: Array) -> Array:
    """(10,) inertial parameters about the flange's origin."""
    J = about_com + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]])


def _moved(recording: Recording, robot: Robot, settings: SignalSettings) -> Motion:
    name = recording.source or "recording"
    if recording.current is None:
        raise BadInput(f"{name}: holds no currents; gains are what a current becomes: record actual_current")
    refuse_other_arm(recording, robot)
    if recording.joints != robot.joints:
        raise BadInput(f"{name}: has {recording.joints} joints; {robot.name} has {robot.joints}")
    return motion(recording, settings)


def _equations(moved: Sequence[Motion], robot: Robot, mounting: Mounting, payload: Array) -> list[_Run]:
    """Shared rigid base parameters, then each run's own friction (fc, fv and a concave term); the payload's torque in the second run."""
    base = base_parameters(robot, mounting)
    J = robot.joints
    friction = set(np.concatenate(friction_columns(J)).tolist())
    rigid = [column for column in base.columns if column not in friction]
    last = slice(PER_JOINT * (J - 1), PER_JOINT * (J - 1) + INERTIAL)
    result = []
    for number, run in enumerate(moved):
        current = run.current
        if current is None:  # _moved has seen to it
            raise BadInput(f"{run.source}: holds no currents")
        Y = regressor(robot, mounting, run.q, run.qd, run.qdd)
        # a concave law seems to bend with the load where it is fitted by a line, and the gains would pay for it
        unloaded = np.zeros_like(run.qd)
        terms = [term for term in residual_law().terms if not term.loaded]
        own = np.concatenate([_by_joint(term.column(run.direction, run.qd, unloaded)) for term in terms], axis=2)
        other = np.zeros_like(own)
        columns = [Y[:, :, rigid], *((own, other) if number == 0 else (other, own))]
        known = Y[:, :, last] @ payload if number else np.zeros(run.q.shape)
        result.append(_Run(run, current, len(rigid), np.concatenate(columns, axis=2), known))
    return result


def _with_load(run: _Run, b: Array) -> _Run:
    """One friction parameter a joint more, the same in both runs: a share of what the gear passes on, as b (B',) predicts it.

    Without it a payload's friction would be taken for its weight.
    """
    load = run.Y[:, :, : run.rigid] @ b[: run.rigid] + run.known_nm  # (N, J)
    terms = [term for term in residual_law().terms if term.loaded]
    shared = [_by_joint(term.column(run.moved.direction, run.moved.qd, load)) for term in terms]
    return run._replace(Y=np.concatenate([run.Y, *shared], axis=2))


def _by_joint(column: Array) -> Array:
    """(N, J) → (N, J, J): a parameter of each joint that no other joint feels."""
    J = column.shape[1]
    result = np.zeros((*column.shape, J))
    result[:, np.arange(J), np.arange(J)] = column
    return result


def _factors(runs: Sequence[_Run]) -> list[Factor]:
    """[Y, payload, current] of each joint, reduced once."""
    return factors([_rows(run, np.concatenate([run.Y, run.known_nm[:, :, None]], axis=2), run.current) for run in runs])


def _prior(typical: float, x: Array, J: int) -> Factor:
    """Rows that hold log gains near the typical one."""
    return Factor(np.eye(J, len(x) + 1) / PRIOR_STD + np.eye(1, len(x) + 1, len(x)) * (typical / PRIOR_STD), J)


def _settled(joints: Sequence[Factor], weights: Array, log_gains: Array, typical: float, J: int) -> Array:
    """(J + B',) from log gains (J,) on: Gauss and Newton in the gains, the parameters solved exactly for each.

    Raises Unidentifiable where they wander.
    """
    x, cost = _best(joints, weights, log_gains, typical)
    for _ in range(STEPS):
        step = (solve([*_linearised(joints, x, J), _prior(typical, x, J)], np.append(weights, 1.0), x).values - x)[:J]
        step *= min(1.0, 1.0 / max(1e-12, float(np.max(np.abs(step)))))  # a gain changes at most e-fold at once
        for _ in range(HALVINGS):
            tried, its_cost = _best(joints, weights, x[:J] + step, typical)
            if its_cost <= cost:
                break
            step *= 0.5
        else:
            return x  # no way leads down but rounding
        gained = cost - its_cost
        x, cost = tried, its_cost
        if np.max(np.abs(step)) < SETTLED or gained < 1e-9 * cost:
            return x
    raise Unidentifiable("payload pair: the gains do not settle; expected the same arm with and without the payload, well excited")


def _best(joints: Sequence[Factor], weights: Array, log_gains: Array, typical: float) -> tuple[Array, float]:
    """(J + B',) log gains as given and the parameters that fit them best; the sum of squares, the prior's included."""
    gains = np.exp(log_gains)
    # b given the gains: current·g − payload = Y b
    at_joint = [Factor(np.column_stack([f.R[:, :-2], g * f.R[:, -1] - f.R[:, -2]]), f.samples) for f, g in zip(joints, gains, strict=True)]
    b = solve(at_joint, weights / gains, np.zeros(joints[0].R.shape[1] - 2)).values
    misfit = [weight / g * np.linalg.norm(f.R @ np.append(b, -1.0)) for f, g, weight in zip(at_joint, gains, weights, strict=True)]
    return np.append(log_gains, b), float(np.sum(np.square(misfit)) + np.sum((log_gains - typical) ** 2) / PRIOR_STD**2)


def _rows(run: _Run, Y: Array, right: Array) -> Rows:
    return Rows(Y, right, run.moved.moving(), block_steps(run.moved, BLOCK_S), run.moved.segments)


def _noise(factor: Factor) -> float:
    """σ of one joint's current: what no parameters of its own could explain [A]."""
    A, b = factor.R[:, :-1], factor.R[:, -1]
    rest = b - A @ np.linalg.lstsq(A, b, rcond=1e-9)[0]
    return float(np.linalg.norm(rest)) / math.sqrt(max(1, factor.samples))


def _start(joints: Sequence[Factor]) -> Array:
    """(J,) log gains, each by its own joint where the payload shows there."""
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
    """Factors of the current in [log g, b] about x, as if it were linear."""
    return [Factor(_about(f.R[:, :-2], f.R[:, -2], f.R[:, -1], x, j, J), f.samples) for j, f in enumerate(joints)]


def _about(Y: Array, known: Array, current: Array, x: Array, j: int, J: int) -> Array:
    """(n, J + B' + 1) of joint j: derivative of its model current by x, and the current that x + δ must explain."""
    per_nm = np.exp(-x[j])
    model = (Y @ x[J:] + known) * per_nm
    derivative = np.zeros((len(Y), len(x)))
    derivative[:, j] = -model
    derivative[:, J:] = Y * per_nm
    return np.column_stack([derivative, current - model + derivative @ x])


def _linear_rows(run: _Run, x: Array, J: int) -> Rows:
    """The same from every sample."""
    by_joint = [_about(run.Y[:, j], run.known_nm[:, j], run.current[:, j], x, j, J) for j in range(J)]
    stacked = np.stack(by_joint, axis=1)  # (N, J, J + B' + 1)
    return _rows(run, stacked[:, :, :-1], stacked[:, :, -1])
