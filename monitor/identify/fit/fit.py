"""The equations of motion of recordings, and where each unknown of a fit lies.

The unknowns x are the B base parameters, then, for laws richer than the paper's, each joint's friction parameters after fc and fv:
x = [base; joint 1's; joint 2's; …], X in all. The load of a gear is the torque of the rigid arm that the fit itself predicts. The measured
torque would be a wrong load: it contains the friction, and its noise would then stand on both sides of the equation.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.jackknife import CORRELATED_S, block_steps
from monitor.identify.fit.least_squares import (
    Factor,
    Felt,
    Rows,
    Solution,
    factors,
    residual_rms,
    residuals_of,
    solve,
    triangle,
    with_own,
)
from monitor.identify.settings import IdentifySettings
from monitor.identify.signals.motion import Motion
from monitor.model.base import Base
from monitor.model.friction import PAPER, FrictionLaw, automatic_laws, law_of_every_term
from monitor.model.regressor import ROTOR, felt_columns, felt_regressor, friction_columns
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import Array, Indices, Mask

ONE_WAY_SHARE = 0.05  # fraction of the moving samples in one direction: with less, friction cannot be separated from weight


class Layout(NamedTuple):
    """Where the unknowns lie."""

    rigid: Mask  # (B,) False for fc and fv
    load: Mask  # (B,) the rigid parameters whose torque passes through the gear
    friction: Indices  # (J, 2) places of fc and fv
    frozen: bool  # True: rigid parameters stay at the prior

    def of_law(self, law: FrictionLaw) -> Indices:
        """(J, K) places of each joint's friction parameters, in the order of the law's terms."""
        J, extras = len(self.friction), len(law.extra_terms)
        return np.concatenate([self.friction, len(self.rigid) + np.arange(J * extras).reshape(J, extras)], axis=1)


def layout_of(columns: Sequence[int], joints: int, *, frozen: bool = False) -> Layout:
    """The layout for the columns (B,) of the regressor that the base parameters keep.

    A rotor's inertia loads the motor and not the gear. On the first joints the rotor has no column of its own, since no motion tells its
    inertia from that of the link. There it counts as load.
    """
    friction = np.searchsorted(columns, np.stack(friction_columns(joints), axis=1))  # (J, 2)
    rigid = np.ones(len(columns), dtype=bool)
    rigid[friction] = False
    return Layout(rigid, rigid & (np.asarray(columns) % PER_JOINT != ROTOR), friction, frozen)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equations:
    """One recording's rows in the paper's base parameters, from which the rows of any law are made."""

    motion: Motion
    Y: Felt  # (N, J, B) base regressor; the column of fc passed the filter of the torque
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J) the rows that are fitted
    steps: Indices  # (N,) as in `Rows`

    def load(self, values: Array, layout: Layout) -> Array:
        """(N, J) torque through the gears [N·m] by base parameters `values` (B,)."""
        torque: Array = self.Y @ np.where(layout.load, values, 0.0)
        return torque

    def rows(self, law: FrictionLaw, values: Array, layout: Layout, robust_weight: Array | None = None) -> Rows:
        """The rows in the unknowns of the law, with the load that base parameters `values` (B,) predict. robust_weight : as in `Rows`."""
        Y, torque = self.Y, self.torque_nm
        if layout.frozen:
            torque = torque - Y @ np.where(layout.rigid, values, 0.0)
            Y = Y.only(~layout.rigid)
        if law.extra_terms:
            Y = Y.with_own(self.extra_columns(law, values, layout))
        return Rows(Y, torque, self.used, self.steps, self.motion.segments, robust_weight)

    def extra_columns(self, law: FrictionLaw, values: Array, layout: Layout) -> Array:
        """(N, J, K − 2) each joint's columns of the law after fc's and fv's, filtered as the torque was."""
        return self.motion.rounded(law.columns(self.motion.qd, self.load(values, layout), first=len(PAPER.terms)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitProblem:
    """What a fit needs to know."""

    equations: Sequence[Equations]  # of each recording
    layout: Layout
    prior: Array  # (B,) of base parameters that the data do not determine, and of frozen rigid parameters

    @property
    def both_ways(self) -> Mask:
        """(J,) the joints that turn to and fro: of one that does not, an offset of the drive and its weight pass for Coulomb friction."""
        forward, used = (np.sum([np.sum(rows(eq), axis=0) for eq in self.equations], axis=0) for rows in (_forward, lambda eq: eq.used))
        both: Mask = np.minimum(forward, used - forward) >= ONE_WAY_SHARE * np.maximum(used, 1)
        return both

    @property
    def redundancy(self) -> int:
        """One of so many samples says as much as all: enough to choose a law and for a covariance, at a fraction of the time."""
        return min(eq.motion.redundancy for eq in self.equations)


def _forward(eq: Equations) -> Mask:
    """(N, J) the rows that are fitted in which a joint turns forward."""
    forward: Mask = eq.used & (eq.motion.qd > 0.0)
    return forward


def problem_of(
    motions: Sequence[Motion],
    torques: Sequence[Array],
    robot: Robot,
    mounting: Mounting,
    base: Base,
    settings: IdentifySettings,
    *,
    all_rows: bool = False,
    rigid: Array | None = None,
) -> FitProblem:
    """The equations of all motions with their prior.

    torques : (N, J) [N·m] of each motion. all_rows : as for `equations_of`. rigid : (B,) base parameters whose rigid part stays; None: the
    prior is the manufacturer's masses, which count only where the motion reveals nothing.
    """
    return FitProblem(
        equations=[
            equations_of(
                moved, torque, robot, mounting, base, all_rows=all_rows, moving_rad_s=settings.moving_rad_s, block_s=settings.block_s
            )
            for moved, torque in zip(motions, torques, strict=True)
        ],
        layout=layout_of(base.columns, robot.joints, frozen=rigid is not None),
        prior=base.combination @ robot.nominal_parameters() if rigid is None else rigid,
    )


def equations_of(
    moved: Motion, torque_nm: Array, robot: Robot, mounting: Mounting, base: Base, *, all_rows: bool, moving_rad_s: float, block_s: float
) -> Equations:
    """The equations of one motion with torque_nm (N, J).

    all_rows : fit the rows in which a joint is slower than `moving_rad_s` too. block_s : length of the jackknife's blocks.
    The measured torque passed a filter that rounds the step of Coulomb friction, so the column of fc passes the same filter. With a sharp
    step in the column, fc would be too small by several of its standard deviations, and fv too large.
    """
    felt = felt_columns(base.columns, robot.joints, robot.innermost)

    def make(at: slice | Indices) -> list[Array]:
        return felt_regressor(robot, mounting, felt, moved.q[at], moved.qd[at], moved.qdd[at], moved.direction[at])

    Y = Felt(moved.samples, base.count, felt.places, make)
    used = np.ones(torque_nm.shape, dtype=bool) if all_rows else moved.moving(moving_rad_s)
    used &= np.ptp(torque_nm, axis=0) > ROUNDING * np.max(np.abs(torque_nm), axis=0)  # what never changes was not measured
    return Equations(motion=moved, Y=Y, torque_nm=torque_nm, used=used, steps=block_steps(moved, block_s))


# --- The fit: from equations of motion to parameters, for any friction law, with rigid parameters free or frozen ---

REWEIGHTINGS = 3  # the scales of the joints settle to 1 % in two
LOAD_ROUNDS = 3  # friction is a tenth of the torque, and the load's part a tenth of friction: each round gains two digits
ROBUST_ROUNDS = 20  # at most
ROBUST_SETTLED = 1e-3  # relative change of each joint's residual at which the rounds end
STUDENT_FREEDOM = 4.0  # Student's t: 94 % efficient for normal noise, and without regard for an outlier of twenty deviations
ROUNDING = 1e-9  # that a filter adds to a constant
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
    values, weights = paper.solution.values[:B], paper.weights
    for _ in range(_load_rounds(problem, law)):
        columns = [eq.extra_columns(law, values, problem.layout) for eq in problem.equations]
        rows = with_own(paper.rows, columns)
        joints = factors(rows)
        solution = solved(problem, law, joints, weights)
        values, weights = solution.values[:B], _weights(joints, solution)  # scales and load settle together
    return solution, residuals_of(rows, solution.values)


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
    weights, solution = paper.weights, paper.solution
    for _ in range(min(rounds, _load_rounds(problem, law))):
        columns = [eq.extra_columns(law, solution.values[: len(problem.prior)], problem.layout) for eq in problem.equations]
        rows = with_own(paper.rows, columns)
        joints = factors(rows)
        weights, solution = _weighted(problem, law, joints, weights, method)
    return Fit(law=law, rows=rows, joints=joints, weights=weights, solution=solution)


def _weighted(problem: FitProblem, law: FrictionLaw, joints: Sequence[Factor], weights: Array, method: str) -> tuple[Array, Solution]:
    """The joints' weights (J,) and the solution: by `ls` with the weights given, else with the weights found in turn."""
    solution = solved(problem, law, joints, weights)
    if method != "ls":
        for _ in range(REWEIGHTINGS):
            weights = _weights(joints, solution)
            solution = solved(problem, law, joints, weights)
    return weights, solution


def _weights(joints: Sequence[Factor], solution: Solution) -> Array:
    """(J,) one over each joint's residual [1/(N·m)]; finite for a perfect fit too."""
    size = np.array([np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.samples, 1)) for factor in joints])  # (J,) RMS of the torque
    weights: Array = 1.0 / np.maximum(residual_rms(joints, solution.values), 1e-9 * size + 1e-12)
    return weights


def solved(problem: FitProblem, law: FrictionLaw, joints: Sequence[Factor], weights: Array, every: int = 1) -> Solution:
    """The solution with the prior of the base parameters, and the prior that the law's terms carry. joints : of one of `every` rows."""
    J, extras = len(joints), len(law.extra_terms)
    expected = np.append(problem.prior, np.zeros(J * extras))
    if all(math.isinf(term.expected_std) for term in law.terms):
        return solve(joints, weights, expected)
    both = [Factor(triangle(np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])), 1)]
    free = solve(both, np.ones(1), expected)
    # residuals agree for half a second, so a prior weighs as much as the rows of that time
    rate_hz = np.mean([eq.motion.rate_hz for eq in problem.equations]) / every
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
        found = Fit(law=found.law, rows=rows, joints=joints, weights=weights, solution=solved(problem, found.law, joints, weights))
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


# --- fc and fv of a friction law with more terms: the paper's line fc·sign(q̇) + fv·q̇ that fits the law best ---


def projection(problem: FitProblem, loads: Sequence[Array], found: Fit) -> Array:
    """(B, X) matrix from the law's unknowns to the paper's base parameters.

    Rigid parameters stay as they are. A joint's friction unknowns become fc and fv of the line fc·s(q̇) + fv·q̇ that is nearest to the law
    by least squares over the rows used; s is the law's sign function. loads : (N, J) torque through the gears of each
    recording [N·m].
    """
    layout = problem.layout
    if found.law == PAPER:
        return np.eye(len(layout.rigid))
    B, places = len(layout.rigid), layout.of_law(found.law)
    M = np.eye(B, len(found.solution.values))
    for j, own in enumerate(places):
        columns = [
            found.law.columns(eq.motion.qd[eq.used[:, j], j], load[eq.used[:, j], j])
            for eq, load in zip(problem.equations, loads, strict=True)
        ]
        line = np.concatenate(columns)  # (n, K)
        nearest, _, rank, _ = np.linalg.lstsq(line[:, :2], line, rcond=None)
        if rank == 2:  # else the joint's rows show no line, and fc and fv stay as unknown as they are
            M[layout.friction[j, :, None], own] = nearest
    return M


def mean_load(problem: FitProblem, loads: Sequence[Array]) -> Array:
    """(J,) mean |τ| through each gear over the rows used [N·m]; 0 where there are none. loads : as for `projection`."""
    equations = problem.equations
    total = np.sum([np.sum(np.abs(load) * eq.used, axis=0) for eq, load in zip(equations, loads, strict=True)], axis=0)
    mean: Array = total / np.maximum(np.sum([np.sum(eq.used, axis=0) for eq in equations], axis=0), 1)
    return mean


# --- The choice `auto` of a friction law: the simplest law that predicts data left out as well as the best does ---

FOLDS = 10  # stretches of time, each far longer than the time over which residuals are correlated (0.5 s)


class Choice(NamedTuple):
    """A law, and the RMS residual of every law on data to which it was not fitted, in units of the residual of the paper's law."""

    law: FrictionLaw
    held_out: Mapping[str, float]


def choose_law(problem: FitProblem, method: str, start: Fit | None = None) -> Choice:
    """Cross-validation over stretches of time within the recordings.

    Every law is fitted to the other stretches and tested on this one. A richer law replaces a simpler one only where its error is smaller
    by more than the standard error of the difference over the stretches. start : as for `fit`.
    """
    prior, richest, laws = problem.prior, law_of_every_term(), automatic_laws()
    start = first_fit(problem, method) if start is None else start
    every = problem.redundancy
    # one round: the load is then right to a hundredth, for all laws alike
    rows = [rec.thinned(every) for rec in fit(problem, richest, method=method, start=start, rounds=1).rows]
    weights = fit(problem, PAPER, method=method, start=start).weights  # (J,) one scale, so that all laws are compared alike
    B, own = len(prior), problem.layout.of_law(richest)[:, 2:]  # (J, E)
    folds = [_fold([_stretch(rec, k) for rec in rows], weights) for k in range(FOLDS)]
    errors = {}
    for law in laws:
        terms = [richest.extra_terms.index(term) for term in law.extra_terms]
        columns = np.concatenate([np.arange(B), own[:, terms].ravel(), [-1]]).astype(np.intp)
        errors[law.name] = errors_left_out(folds, columns, np.append(prior, np.zeros(len(columns) - 1 - B)))
    best = PAPER
    for law in laws[1:]:
        gain = errors[best.name] - errors[law.name]  # (F,) mean squares
        if np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(FOLDS):
            best = law
    return Choice(best, {name: float(np.sqrt(np.mean(error))) for name, error in errors.items()})


def _stretch(rec: Rows, k: int) -> Rows:
    """The k-th of FOLDS parts of a recording."""
    N = len(rec.steps)
    first, last = -(-k * N // FOLDS), -(-(k + 1) * N // FOLDS)
    on = slice(first, last)
    robust_weight = None if rec.robust_weight is None else rec.robust_weight[on]
    return Rows(Felt.of(rec.Y).part(first, last), rec.torque_nm[on], rec.used[on], rec.steps[on], rec.segments[on], robust_weight)


def _fold(rows: Sequence[Rows], weights: Array) -> Factor:
    """One factor of all joints' rows, weighted."""
    joints = factors(rows)
    weighted = [weight * factor.R for weight, factor in zip(weights, joints, strict=True)]
    return Factor(triangle(np.concatenate(weighted)), sum(factor.samples for factor in joints))


def errors_left_out(folds: Sequence[Factor], columns: Indices, expected: Array) -> Array:
    """(F,) mean square residual of each stretch after the fit of these columns to all other stretches; rows are weighted."""
    errors = []
    for k, fold in enumerate(folds):
        others = triangle(np.concatenate([other.R[:, columns] for other in (*folds[:k], *folds[k + 1 :])]))
        left = fold.R[:, columns] @ np.append(solve([Factor(others, 1)], np.ones(1), expected).values, -1.0)
        errors.append(float(left @ left) / max(fold.samples, 1))
    return np.array(errors)
