"""The fit: from equations of motion to parameters, for any friction law, with rigid parameters free or frozen.

Load and parameters are found in turn: a fit predicts the torque through the gears, and with this load the next fit follows. A prediction
therefore needs no measured torque.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.felt import Felt
from monitor.identify.fit.jackknife import CORRELATED_S
from monitor.identify.fit.least_squares import (
    Beside,
    Factor,
    Rows,
    Solution,
    factors,
    residual_rms,
    residuals_beside,
    solve,
    triangle,
)
from monitor.model.friction import PAPER, FrictionLaw
from monitor.recording import Array

REWEIGHTINGS = 3  # the scales of the joints settle to 1 % in two
LOAD_ROUNDS = 3  # friction is a tenth of the torque, and the load's part a tenth of friction: each round gains two digits
ROBUST_ROUNDS = 20  # at most
ROBUST_SETTLED = 1e-3  # relative change of each joint's residual at which the rounds end
STUDENT_FREEDOM = 4.0  # Student's t: 94 % efficient for normal noise, and without regard for an outlier of twenty deviations
MAD = 1.4826  # median absolute deviation → standard deviation of normal noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Parameters of one law, and what they were found from."""

    law: FrictionLaw
    rows: list[Rows]  # of each recording
    joints: list[Factor]
    weights: Array  # (J,)
    solution: Solution

    @cached_property
    def torques(self) -> list[Array]:
        """(N, J) of each recording [N·m], as the parameters predict it."""
        return [Felt.of(rec.Y) @ self.solution.values for rec in self.rows]

    @cached_property
    def residuals(self) -> list[Array]:
        """(N, J) of each recording [N·m]."""
        return [rec.torque_nm - torque for rec, torque in zip(self.rows, self.torques, strict=True)]


def fit(problem: FitProblem, law: FrictionLaw, *, method: str, start: Fit | None = None, rounds: int = LOAD_ROUNDS) -> Fit:
    """Parameters of the law by `method`: ls, wls or robust. The fit of a richer law begins with the fit of the paper's.

    start : what `first_fit` found, for callers that fit several laws. rounds : in which load and parameters are found in turn, at most.
    """
    found = first_fit(problem, method) if start is None else start
    if law != PAPER:
        found = _richer(problem, law, found, method, rounds)
    return _robust(problem, found) if method == "robust" else found


def first_fit(problem: FitProblem, method: str) -> Fit:
    """The fit of the paper's law, before rows lose weight as outliers."""
    rows = [eq.rows(PAPER, problem.prior, problem.layout) for eq in problem.equations]
    joints = factors(rows)
    weights, solution = _weighted(problem, PAPER, joints, np.ones(len(joints)), method)
    return Fit(law=PAPER, rows=rows, joints=joints, weights=weights, solution=solution)


def refit(problem: FitProblem, paper: Fit, law: FrictionLaw) -> tuple[Solution, list[Array]]:
    """What `fit` makes of a richer law, to a hundredth of the residual, from a fit of the paper's law: solution and residuals (N, J) [N·m].

    Rows keep the robust weights of the given fit.
    """
    B = len(problem.prior)
    beside = Beside(paper.rows, paper.joints)
    values, weights = paper.solution.values[:B], paper.weights
    for _ in range(_load_rounds(problem, law)):
        columns = [eq.extra_columns(law, values, problem.layout) for eq in problem.equations]
        joints = beside.with_own(columns)
        solution = _solved(problem, law, joints, weights)
        values, weights = solution.values[:B], _weights(joints, solution)  # scales and load settle together
    return solution, residuals_beside(paper.rows, columns, solution.values)


def robust_inflation(found: Fit) -> float:
    """The factor Σw/Σψ′ by which the standard deviations of a robust fit exceed those of its weighted rows; 1 without robust weights.

    The variance of an M-estimator has Σψ′ in the place of Σw: Huber (1981), §7.6.
    """
    weight = slope = 0.0
    for rec, residual in zip(found.rows, found.residuals, strict=True):
        if rec.robust_weight is None:
            return 1.0
        u2 = (residual * found.weights) ** 2
        derivative = (STUDENT_FREEDOM + 1.0) * (STUDENT_FREEDOM - u2) / (STUDENT_FREEDOM + u2) ** 2
        weight += float(np.sum(rec.robust_weight[rec.used]))
        slope += float(np.sum(derivative[rec.used]))
    return max(1.0, weight / slope) if slope > 0.0 else 1.0


def _load_rounds(problem: FitProblem, law: FrictionLaw) -> int:
    """How often the law is fitted: the load changes with the rigid parameters, unless those are frozen."""
    return LOAD_ROUNDS if law.loaded and not problem.layout.frozen else 1


def _richer(problem: FitProblem, law: FrictionLaw, paper: Fit, method: str, rounds: int) -> Fit:
    """The fit of a law with more terms, each round with the load that the round before predicts. paper : by `first_fit`."""
    beside = Beside(paper.rows, paper.joints)
    weights, solution = paper.weights, paper.solution
    for _ in range(min(rounds, _load_rounds(problem, law))):
        columns = [eq.extra_columns(law, solution.values[: len(problem.prior)], problem.layout) for eq in problem.equations]
        joints = beside.with_own(columns)
        weights, solution = _weighted(problem, law, joints, weights, method)
    rows = [rec._replace(Y=Felt.of(rec.Y).with_own(own)) for rec, own in zip(paper.rows, columns, strict=True)]
    return Fit(law=law, rows=rows, joints=joints, weights=weights, solution=solution)


def _weighted(problem: FitProblem, law: FrictionLaw, joints: Sequence[Factor], weights: Array, method: str) -> tuple[Array, Solution]:
    """The joints' weights (J,) and the solution: by `ls` with the weights given, else with the weights found in turn."""
    solution = _solved(problem, law, joints, weights)
    if method != "ls":
        for _ in range(REWEIGHTINGS):
            weights = _weights(joints, solution)
            solution = _solved(problem, law, joints, weights)
    return weights, solution


def _weights(joints: Sequence[Factor], solution: Solution) -> Array:
    """(J,) one over each joint's residual [1/(N·m)]; finite for a perfect fit too."""
    size = np.array([np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.samples, 1)) for factor in joints])  # (J,) RMS of the torque
    weights: Array = 1.0 / np.maximum(residual_rms(joints, solution.values), 1e-9 * size + 1e-12)
    return weights


def _solved(problem: FitProblem, law: FrictionLaw, joints: Sequence[Factor], weights: Array) -> Solution:
    """The solution with the prior of the base parameters, and the prior that the law's terms carry."""
    J, extras = len(joints), len(law.extra_terms)
    expected = np.append(problem.prior, np.zeros(J * extras))
    if all(math.isinf(term.expected_std) for term in law.terms):
        return solve(joints, weights, expected)
    both = [Factor(triangle(np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])), 1)]
    free = solve(both, np.ones(1), expected)
    # residuals agree for half a second, so a prior weighs as much as the rows of that time
    rate_hz = np.mean([eq.motion.rate_hz for eq in problem.equations])
    noise = weights * residual_rms(joints, free.values) * np.sqrt(CORRELATED_S * rate_hz)  # (J,)
    penalty = np.zeros(len(expected))
    for place, term in zip(problem.layout.of_law(law).T, law.terms, strict=True):  # (J,)
        penalty[place] = noise / term.expected_std
    return solve(both, np.ones(1), expected, penalty)


def _robust(problem: FitProblem, start: Fit) -> Fit:
    """Iteratively reweighted least squares with Student's t; the scale of each joint is the median of its residuals."""
    found, before = start, np.zeros(len(start.weights))
    for _ in range(ROBUST_ROUNDS):
        residuals = found.residuals
        scale = _robust_scale(found.rows, residuals)
        robust_weights = [(STUDENT_FREEDOM + 1.0) / (STUDENT_FREEDOM + (residual / scale) ** 2) for residual in residuals]
        values = found.solution.values[: len(problem.prior)]
        rows = [eq.rows(found.law, values, problem.layout, weight) for eq, weight in zip(problem.equations, robust_weights, strict=True)]
        joints = factors(rows)
        weights = 1.0 / scale
        found = Fit(law=found.law, rows=rows, joints=joints, weights=weights, solution=_solved(problem, found.law, joints, weights))
        if np.all(np.abs(scale - before) <= ROBUST_SETTLED * scale):
            break
        before = scale
    return found


def _robust_scale(rows: Sequence[Rows], residuals: Sequence[Array]) -> Array:
    """(J,) standard deviation of each joint's residual over the rows used [N·m], by the median, on which outliers have no influence."""
    scales = []
    for j in range(residuals[0].shape[1]):
        e = np.concatenate([residual[rec.used[:, j], j] for rec, residual in zip(rows, residuals, strict=True)])
        size = np.concatenate([rec.torque_nm[:, j] for rec in rows])
        floor = 1e-9 * float(np.sqrt(np.mean(size**2))) + 1e-12
        scales.append(max(MAD * float(np.median(np.abs(e))) if len(e) else 1.0, floor))
    return np.array(scales)
