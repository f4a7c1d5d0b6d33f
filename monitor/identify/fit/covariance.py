"""How sure a fit is: the covariance by noise alone, and by noise and misfit of the friction law together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.causes import REPEATABLE, Causes
from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.fit import Fit, robust_inflation
from monitor.identify.fit.jackknife import jackknife_covariances
from monitor.identify.fit.least_squares import Solution
from monitor.identify.fit.projection import mean_load
from monitor.model.friction import residual_law
from monitor.recording import Array


class Covariances(NamedTuple):
    """Covariances (X, X) of the unknowns of a fit, and the friction that its causes leave."""

    noise: Array  # how far the same motion scatters
    with_misfit: Array
    lasting: Array  # by the whole residual in blocks of seconds: what depends on place, load or the time since rest does not average out
    upright: Solution  # the fit beside its causes, as `Causes.beside` gives it


def covariances(problem: FitProblem, found: Fit, free: Solution, causes: Causes) -> Covariances:
    """How sure the unknowns are.

    found : the fit, perhaps moved to a physically consistent arm. free : its solution before that move. causes : of `found`.
    The error of a law returns at every replay at the same places, so it is no noise, although it fills the residual. The residual also does
    not show how far that error moves the parameters: least squares has fitted the parameters to a part of it.
    A law that lacks something moves the rigid parameters in the same way at every replay, so this difference is added for them. The
    friction parameters need no such term: they mean the best description by this law. Raises Unidentifiable as `jackknife_covariance`.
    """
    every = causes.every
    upright, noise = causes.beside(REPEATABLE)
    rows, residuals = [rec.thinned(every) for rec in found.rows], [left[::every] for left in found.residuals]
    weights = np.sqrt(every) * found.weights
    (alone, together), (_, lasting) = jackknife_covariances(rows, weights, found.solution, [noise, residuals])
    inflation = robust_inflation(found) ** 2
    leaning, B = np.zeros(len(free.values)), len(problem.prior)
    leaning[:B] = np.where(problem.layout.rigid & upright.excited[:B], free.values[:B] - upright.values[:B], 0.0)
    return Covariances(alone * inflation, together * inflation + np.outer(leaning, leaning), lasting * inflation, upright)


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
