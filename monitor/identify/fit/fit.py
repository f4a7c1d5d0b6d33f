"""The fit: from equations of motion to parameters, for any friction law, with rigid parameters free or frozen.

Unknowns are the B base parameters, then for richer laws what each joint's friction has beyond fc and fv: x = [base; joint 1's; …].
The load of a gear is the torque of the rigid arm that the fit itself predicts, not the measured one: that one contains the friction, and
its noise would stand on both sides of the equation. So load and parameters are found in turn, and a prediction needs no measurement.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.least_squares import Factor, Projected, Rows, Solution, factors, residual_rms, residuals_of, solve
from monitor.identify.signals.motion import Indices, Mask, Motion
from monitor.model.friction import PAPER, FrictionLaw, residual_law
from monitor.model.regressor import ROTOR, friction_columns
from monitor.model.robot import PER_JOINT
from monitor.recording import Array

REWEIGHTINGS = 3  # the scales of the joints settle to 1 % in two
LOAD_ROUNDS = 3  # friction is a tenth of the torque and load a tenth of friction: each round gains two digits
ROBUST_ROUNDS = 20  # at most
ROBUST_SETTLED = 1e-3  # of each joint's residual
STUDENT_FREEDOM = 4.0  # Student's t: 94 % efficient where noise is normal, and blind to what is twenty deviations away
CORRELATED_S = 0.5  # residuals of real arms: 0.4–0.55 s
MAD = 1.4826  # median absolute deviation → standard deviation, if normal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equations:
    """One recording's rows in the paper's base parameters, ready for any law."""

    motion: Motion
    Y: Array  # (N, J, B) fc's column as round as the torque
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J)
    steps: Indices  # (N,)

    def load(self, values: Array, layout: "Layout") -> Array:
        """(N, J) torque through the gears [N·m] with base parameters `values` (B,)."""
        torque: Array = self.Y @ np.where(layout.load, values, 0.0)
        return torque

    def rows(self, law: FrictionLaw, values: Array, layout: "Layout", robust_weight: Array | None = None) -> Rows:
        """In the unknowns of the law, the load as predicted with base parameters `values` (B,)."""
        Y, torque = self.Y, self.torque_nm
        if layout.frozen:
            torque = torque - Y @ np.where(layout.rigid, values, 0.0)
            Y = np.where(layout.rigid, 0.0, Y)
        if law.extra_terms:
            Y = np.concatenate([Y, _own(self.beyond(law, values, layout))], axis=2)
        return Rows(Y, torque, self.used, self.steps, self.motion.segments, robust_weight)

    def beyond(self, law: FrictionLaw, values: Array, layout: "Layout") -> Array:
        """(N, J, E) each joint's columns of the law but fc's and fv's, as round as the torque."""
        return self.motion.rounded(law.columns(self.motion.qd, self.load(values, layout))[:, :, 2:])


class Layout(NamedTuple):
    """Where the unknowns lie."""

    rigid: Mask  # (B,) False for fc and fv
    load: Mask  # (B,) of the rigid ones, those whose torque passes through the gear
    friction: Indices  # (J, 2) places of fc, fv
    frozen: bool  # rigid parameters stay at the prior

    def of_law(self, law: FrictionLaw) -> Indices:
        """(J, K) places of each joint's friction parameters."""
        J, extras = len(self.friction), len(law.extra_terms)
        return np.concatenate([self.friction, len(self.rigid) + np.arange(J * extras).reshape(J, extras)], axis=1)


def layout_of(columns: Sequence[int], joints: int, *, frozen: bool = False) -> Layout:
    """For the kept columns (B,) of the regressor.

    A rotor's inertia loads the motor and not the gear. Where it cannot be told from the link's (the first joints, where no column of its
    own was kept) it counts as load all the same.
    """
    friction = np.searchsorted(columns, np.stack(friction_columns(joints), axis=1))  # (J, 2)
    rigid = np.ones(len(columns), dtype=bool)
    rigid[friction] = False
    return Layout(rigid, rigid & (np.asarray(columns) % PER_JOINT != ROTOR), friction, frozen)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Parameters of one law, and what they were found from."""

    law: FrictionLaw
    rows: list[Rows]
    joints: list[Factor]
    weights: Array  # (J,)
    solution: Solution

    @property
    def residuals(self) -> list[Array]:
        """(N, J) of each recording [N·m]."""
        return residuals_of(self.rows, self.solution.values)


def fit(equations: Sequence[Equations], law: FrictionLaw, layout: Layout, prior: Array, *, method: str) -> Fit:
    """Parameters by `method`: ls, wls or robust. prior : (B,) of what the data leave open, and of frozen rigid parameters.

    Richer laws start from the paper's.
    """
    found = _weighted(equations, PAPER, layout, prior, prior, method)
    rounds = (LOAD_ROUNDS if law.loaded and not layout.frozen else 1) if law != PAPER else 0
    for _ in range(rounds):
        found = _weighted(equations, law, layout, prior, found.solution.values[: len(prior)], method, found.weights)
    return _robust(equations, found, layout, prior) if method == "robust" else found


def refit(equations: Sequence[Equations], paper: Fit, law: FrictionLaw, layout: Layout, prior: Array) -> tuple[Solution, list[Array]]:
    """What `fit` makes of a richer law, to a hundredth of what it leaves: solution and residuals (N, J), from a fit of the paper's.

    Only each joint's own columns change from round to round, so the rest is triangulated once. Rows keep the robust weights of that fit.
    """
    B, J = len(prior), len(paper.weights)
    own = [Projected(paper.rows, j) for j in range(J)]
    values, weights = paper.solution.values[:B], paper.weights
    for _ in range(LOAD_ROUNDS if law.loaded and not layout.frozen else 1):
        columns = [eq.beyond(law, values, layout) for eq in equations]
        joints = [each.with_own([part[:, j] for part in columns], J) for j, each in enumerate(own)]
        solution = _solved(equations, joints, weights, law, layout, prior)
        values, weights = solution.values[:B], _weights(joints, solution)  # scales and load settle together
    beyond = solution.values[B:].reshape(J, -1)  # (J, E)
    left = [rec.torque_nm - rec.Y @ values - np.einsum("nje,je->nj", part, beyond) for rec, part in zip(paper.rows, columns, strict=True)]
    return solution, left


def with_causes(equations: Sequence[Equations], found: Fit, layout: Layout, prior: Array) -> tuple[Solution, list[Array]]:
    """The fit once more beside every repeatable cause that we can name: solution, base parameters first, and residuals (N, J) [N·m].

    Named are the richest law, warming during the recording, and a delay of a fraction of a sample between torque and motion.
    What is wrong with a law comes back at every replay, at the same places: it is no noise, though it fills the residual. Nor does the
    residual show how far it moves the parameters, of which least squares takes as much as they can explain.
    """
    law = residual_law()
    rows = []
    for eq, before in zip(equations, found.rows, strict=True):
        values = found.solution.values[: len(prior)]
        rec = eq.rows(law, values, layout, before.robust_weight)
        qd, middle = eq.motion.qd, eq.motion.t_s - np.mean(eq.motion.t_s)
        delay = np.gradient(before.Y @ found.solution.values, axis=0)  # (N, J) torque of the fit, by sample
        warming = middle[:, None, None] * PAPER.columns(qd)  # (N, J, 2)
        causes = np.concatenate([delay[:, :, None], eq.motion.rounded(warming)], axis=2)
        rows.append(rec._replace(Y=np.concatenate([rec.Y, _own(causes)], axis=2)))
    unknowns = rows[0].Y.shape[2]
    solution = solve(factors(rows), found.weights, np.append(prior, np.zeros(unknowns - len(prior))))
    return solution, residuals_of(rows, solution.values)


def _own(columns: Array) -> Array:
    """(N, J, E), each joint's own, as columns (N, J, J·E) of the regressor."""
    N, J, E = columns.shape
    own = np.zeros((N, J, J, E))
    own[:, np.arange(J), np.arange(J)] = columns
    return own.reshape(N, J, J * E)


def _weighted(
    equations: Sequence[Equations], law: FrictionLaw, layout: Layout, prior: Array, values: Array, method: str, weights: Array | None = None
) -> Fit:
    rows = [eq.rows(law, values, layout) for eq in equations]
    joints = factors(rows)
    weights = np.ones(len(joints)) if weights is None else weights
    solution = _solved(equations, joints, weights, law, layout, prior)
    if method != "ls":
        for _ in range(REWEIGHTINGS):
            weights = _weights(joints, solution)
            solution = _solved(equations, joints, weights, law, layout, prior)
    return Fit(law=law, rows=rows, joints=joints, weights=weights, solution=solution)


def _weights(joints: Sequence[Factor], solution: Solution) -> Array:
    """(J,) one over what is left of each joint; a perfect fit is no infinite weight."""
    size = np.array([np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.samples, 1)) for factor in joints])  # (J,) RMS of the torque
    weights: Array = 1.0 / np.maximum(residual_rms(joints, solution.values), 1e-9 * size + 1e-12)
    return weights


def _solved(
    equations: Sequence[Equations], joints: Sequence[Factor], weights: Array, law: FrictionLaw, layout: Layout, prior: Array
) -> Solution:
    J, extras = len(joints), len(law.extra_terms)
    expected = np.append(prior, np.zeros(J * extras))
    free = solve(joints, weights, expected)
    if all(math.isinf(term.expected_std) for term in law.terms):
        return free
    # rows whose residuals agree for half a second say as much as one, so an opinion weighs as the rows of that time
    noise = weights * residual_rms(joints, free.values) * np.sqrt(CORRELATED_S * np.mean([eq.motion.rate_hz for eq in equations]))  # (J,)
    penalty = np.zeros(len(expected))
    for place, term in zip(layout.of_law(law).T, law.terms, strict=True):  # (J,)
        penalty[place] = noise / term.expected_std
    return solve(joints, weights, expected, penalty)


def _robust(equations: Sequence[Equations], start: Fit, layout: Layout, prior: Array) -> Fit:
    """Iteratively reweighted: Student's t, the scale of each joint from the median of its residuals."""
    found, before = start, np.zeros(len(start.weights))
    for _ in range(ROBUST_ROUNDS):
        residuals = found.residuals
        scale = robust_scale(found.rows, residuals)
        robust_weights = [(STUDENT_FREEDOM + 1.0) / (STUDENT_FREEDOM + (residual / scale) ** 2) for residual in residuals]
        values = found.solution.values[: len(prior)]
        rows = [eq.rows(found.law, values, layout, t) for eq, t in zip(equations, robust_weights, strict=True)]
        joints = factors(rows)
        weights = 1.0 / scale
        found = Fit(
            law=found.law,
            rows=rows,
            joints=joints,
            weights=weights,
            solution=_solved(equations, joints, weights, found.law, layout, prior),
        )
        if np.all(np.abs(scale - before) <= ROBUST_SETTLED * scale):
            break
        before = scale
    return found


def robust_scale(rows: Sequence[Rows], residuals: Sequence[Array]) -> Array:
    """(J,) standard deviation of each joint's residual over the rows used, by its median: outliers have no say."""
    scales = []
    for j in range(residuals[0].shape[1]):
        e = np.concatenate([residual[rec.used[:, j], j] for rec, residual in zip(rows, residuals, strict=True)])
        size = np.concatenate([rec.torque_nm[:, j] for rec in rows])
        floor = 1e-9 * float(np.sqrt(np.mean(size**2))) + 1e-12
        scales.append(max(MAD * float(np.median(np.abs(e))) if len(e) else 1.0, floor))
    return np.array(scales)


def robust_inflation(found: Fit) -> float:
    """By how much Σw exceeds Σψ′, which the variance of an M-estimator has in its place (Huber (1981), §7.6); 1 without robust weights."""
    weight = slope = 0.0
    for rec, residual in zip(found.rows, found.residuals, strict=True):
        if rec.robust_weight is None:
            return 1.0
        u2 = (residual * found.weights) ** 2
        derivative = (STUDENT_FREEDOM + 1.0) * (STUDENT_FREEDOM - u2) / (STUDENT_FREEDOM + u2) ** 2
        weight += float(np.sum(rec.robust_weight[rec.used]))
        slope += float(np.sum(derivative[rec.used]))
    return max(1.0, weight / slope) if slope > 0.0 else 1.0
