"""The fit once more beside every repeatable cause that has a name.

The causes are the law of the residual friction, a delay between torque and motion, the warming during the recording, and an offset of the
torque. All are fitted on a part of the rows, which says as much as all of them, and each question takes the causes that it needs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.fit import Fit, FitProblem, mean_load, robust_inflation, solved
from monitor.identify.fit.jackknife import jackknife_covariances
from monitor.identify.fit.least_squares import Factor, Felt, Rows, Solution, factors, residuals_of, solve, with_own
from monitor.model.friction import residual_law
from monitor.recording import Array

OTHER_CAUSES = ("delay", "warming_fc", "warming_fv", "offset")  # columns of each joint behind those of the law
REPEATABLE = ("delay", "warming_fc", "warming_fv")  # causes that are no noise


class Causes:
    """The equations of a fit and the columns of the causes, of one of `every` samples."""

    def __init__(self, problem: FitProblem, found: Fit, every: int) -> None:
        """Of a fit, perhaps moved to a physically consistent arm."""
        law, B = residual_law(), len(problem.prior)
        self._found, self._prior, self._terms = found, problem.prior, len(law.extra_terms)
        self.every, self.rows, self._columns = every, list[Rows](), list[Array]()
        for eq, before, torque in zip(problem.equations, found.rows, found.torques, strict=True):
            moved = eq.motion
            self.rows.append(before.thinned(every, B))
            own = law.columns(moved.qd, eq.load(found.solution.values[:B], problem.layout))  # (N, J, K), fc's and fv's first
            own[:, :, :2] *= (moved.t_s - np.mean(moved.t_s))[:, None, None]  # they become those of the warming
            own, E = moved.rounded(own)[::every], self._terms
            columns = np.empty((len(self.rows[-1].torque_nm), torque.shape[1], E + len(OTHER_CAUSES)), order="F")
            columns[:, :, :E], columns[:, :, E + 1 : E + 3] = own[:, :, 2:], own[:, :, :2]
            columns[:, :, E] = -moved.rate_hz * np.gradient(torque, axis=0)[::every]  # of a torque that comes later
            columns[:, :, E + 3] = 1.0
            self._columns.append(columns)
        self._joints = factors(with_own(self.rows, self._columns))
        self._solutions: dict[tuple[str, ...], Solution] = {}

    def beside(self, others: Sequence[str]) -> tuple[Solution, list[Array]]:
        """The fit beside the law of the residual friction and these of `OTHER_CAUSES`: solution and residuals (n, J) [N·m].

        The solution's unknowns are those of the law, then each joint's share of the other causes in the order of `OTHER_CAUSES`.
        """
        J, B = len(self._joints), len(self._prior)
        chosen, solution = self._chosen(others), self._solved(others)
        residuals = residuals_of(with_own(self.rows, [columns[:, :, chosen] for columns in self._columns]), solution.values)
        own = B + np.arange(J * len(chosen)).reshape(J, -1)  # (J, E) places of each joint's own columns
        order = np.concatenate([np.arange(B), own[:, : self._terms].ravel(), own[:, self._terms :].ravel()])
        return Solution(values=solution.values[order], directions=solution.directions[order], excited=solution.excited[order]), residuals

    def gains(self) -> tuple[Array, Array, int]:
        """What is left of a gain of each joint (r, J), and of the torque (r,), beside the fit and `REPEATABLE`; and the number of rows.

        A gain scales the torque of the fitted arm in the rows of one joint. That joint's friction is its own and beside it anyway, so only
        the links that joints share tell of the gain. A direction of the unknowns that the motion leaves open takes nothing.
        """
        B, solution = len(self._prior), self._solved(REPEATABLE)
        factors = [weight * factor.R for weight, factor in zip(self._found.weights, self._factors(REPEATABLE), strict=True)]
        A = np.concatenate(factors)  # (r, X + 1)
        gains, first = np.zeros((len(A), len(factors))), 0
        for j, R in enumerate(factors):  # the torque of the fit lies in the span of its columns: no pass over the rows
            gains[first : first + len(R), j] = R[:, :B] @ self._found.solution.values[:B]
            first += len(R)
        unknowns, W = A[:, :-1], solution.directions  # unknowns · W is orthonormal
        left = gains - unknowns @ (W @ (W.T @ (unknowns.T @ gains)))
        return left, A[:, -1] - unknowns @ solution.values, sum(factor.samples for factor in self._joints)

    def _solved(self, others: Sequence[str]) -> Solution:
        """The fit beside these causes, joint after joint in the order of `_factors`; solved once, as several questions ask for the same."""
        key = tuple(others)
        if key not in self._solutions:
            unknowns = len(self._prior) + len(self._joints) * len(self._chosen(others))
            prior = np.append(self._prior, np.zeros(unknowns - len(self._prior)))
            self._solutions[key] = solve(self._factors(others), self._found.weights, prior)
        return self._solutions[key]

    def _factors(self, others: Sequence[str]) -> list[Factor]:
        """The factors with the columns of the law and of these causes alone."""
        B, E = len(self._prior), self._terms + len(OTHER_CAUSES)
        own = B + E * np.arange(len(self._joints))[:, None] + self._chosen(others)
        places = np.concatenate([np.arange(B), own.ravel(), [-1]])
        return [Factor(factor.R[:, places], factor.samples) for factor in self._joints]

    def _chosen(self, others: Sequence[str]) -> list[int]:
        """Numbers, among a joint's own columns, of those of the law and of these others."""
        return [*range(self._terms), *(self._terms + k for k, name in enumerate(OTHER_CAUSES) if name in others)]


# --- How sure a fit is: the covariance by noise alone, and by noise and misfit of the friction law together ---


class Covariances(NamedTuple):
    """Covariances (X, X) of the unknowns of a fit, and the friction that its causes leave."""

    noise: Array  # how far the same motion scatters; NaN for what the motion did not excite
    leaning: Array  # of the rigid parameters, by what the fit misses of friction and filter; 0 for friction, which means what fits best
    lasting: Array  # by the whole residual in blocks of seconds: what depends on place, load or the time since rest does not average out
    upright: Solution  # the fit beside its causes, as `Causes.beside` gives it


def covariances(problem: FitProblem, found: Fit, causes: Causes) -> Covariances:
    """How sure the unknowns are.

    found : the fit, perhaps moved to a physically consistent arm. causes : of `found`.
    The error of a law returns at every replay at the same places, so it is no noise, although it fills the residual. The residual also does
    not show how far that error moves the parameters: least squares has fitted the parameters to a part of it.
    So what the fit beside its causes finds and the law misses is a torque of each joint, and each joint's moves the rigid parameters. That
    of one joint says nothing of that of another: a sandwich whose clusters are the joints, as those of noise are blocks of time. Their sum
    alone would be one direction, which is sure where it happens to cancel.
    Raises Unidentifiable as `jackknife_covariance`.
    """
    every = causes.every
    upright, noise = causes.beside(REPEATABLE)
    rows = [rec.thinned(every) for rec in found.rows]
    # the fit of these rows, not of all: where no other stretch replaces one, what differs would count a thousandfold
    solution = solved(problem, found.law, factors(rows), found.weights, every)
    residuals = residuals_of(rows, solution.values)
    (alone, _), (_, lasting) = jackknife_covariances(rows, found.weights, solution, [noise, residuals])
    inflation = robust_inflation(found) ** 2
    unknown = ~(found.solution.excited & solution.excited)
    alone[unknown], alone[:, unknown] = np.nan, np.nan
    B = len(problem.prior)
    missed = [rec.torque_nm - left - Felt.of(bare.Y) @ upright.values[:B] for rec, bare, left in zip(rows, causes.rows, noise, strict=True)]
    leaning = _moved_by(missed, rows, found.weights, solution)
    leaning[:, ~np.append(problem.layout.rigid & upright.excited[:B], np.zeros(leaning.shape[1] - B, dtype=bool))] = 0.0
    return Covariances(alone * inflation, leaning.T @ leaning, lasting * inflation, upright)


def _moved_by(missed: Sequence[Array], rows: Sequence[Rows], weights: Array, solution: Solution) -> Array:
    """(J, X) how far the torque (N, J) that is missed at each joint, in each recording, moves the solution."""
    scores = np.zeros((len(weights), len(solution.values)))
    for rec, torque in zip(rows, missed, strict=True):
        Y, weighted = Felt.of(rec.Y), torque * (rec.root_weight * weights) ** 2
        for piece, blocks in Y.pieces():
            for j, block in enumerate(blocks):
                scores[j, Y.places[j]] += weighted[piece, j] @ block
    moved: Array = scores @ solution.directions @ solution.directions.T
    return moved


def law_doubt(problem: FitProblem, upright: Solution, line: Array, speeds: Sequence[float]) -> Array:
    """(J,) how far the line fc + fv·v is off the curve of the residual friction, at the worst of these speeds [N·m].

    The curve is that of the fit beside its causes, at the mean load. No law is the arm's: what separates a line from a curve that fits
    better is of the size by which another motion, with other speeds, finds another line. upright : of `covariances`. line : (J, 2).
    """
    law, B = residual_law(), len(problem.prior)
    places = problem.layout.of_law(law)  # (J, K)
    load_nm = mean_load(problem, [eq.load(upright.values[:B], problem.layout) for eq in problem.equations])
    known = np.all(upright.excited[places], axis=1)
    fastest = np.max([np.max(np.abs(eq.motion.qd), axis=0) for eq in problem.equations], axis=0)  # (J,)
    v = np.minimum(np.array(speeds)[:, None], fastest)  # (V, J)
    curve = np.einsum("vjk,jk->vj", law.columns(v, np.broadcast_to(load_nm, v.shape)), upright.values[places])
    off = np.max(np.abs(line[:, 0] + line[:, 1] * v - curve), axis=0)
    return np.where(known, off, 0.0)


def mapped(M: Array, covariance: Array) -> Array:
    """M C Mᵀ. Entries become NaN only where they depend on an unknown whose variance is NaN."""
    unknown = np.isnan(np.diag(covariance))
    mapped: Array = M @ np.where(unknown[:, None] | unknown, 0.0, covariance) @ M.T
    lost = np.any(M[:, unknown] != 0.0, axis=1)
    mapped[lost], mapped[:, lost] = np.nan, np.nan
    return mapped


def positive(covariances: Array) -> Array:
    """The nearest covariances (n, B, B) without negative variances. A matrix that holds NaN is returned as it is."""
    finite = np.all(np.isfinite(covariances), axis=(1, 2))
    positive = covariances.copy()
    variances, axes = np.linalg.eigh(covariances[finite])
    positive[finite] = axes * np.maximum(variances, 0.0)[:, None] @ np.swapaxes(axes, 1, 2)
    return positive
