"""What the paper would call fc and fv of a richer friction law, and how sure we are of them."""

from collections.abc import Sequence

import numpy as np

from monitor.identify.fit.fit import Equations, Fit, Layout
from monitor.recording import Array


def projection(equations: Sequence[Equations], loads: Sequence[Array], found: Fit, layout: Layout) -> Array:
    """(B, X) the paper's base parameters from the law's unknowns: of friction, the nearest line over the samples that were used."""
    B, places = len(layout.rigid), layout.of_law(found.law)
    M = np.eye(B, len(found.solution.values))
    for j, own in enumerate(places):
        columns = [
            found.law.columns(eq.motion.qd[eq.used[:, j], j], load[eq.used[:, j], j]) for eq, load in zip(equations, loads, strict=True)
        ]
        line = np.concatenate(columns)  # (n, K)
        if len(line):
            M[layout.friction[j, :, None], own] = np.linalg.lstsq(line[:, :2], line, rcond=None)[0]
    return M


def mapped(M: Array, covariance: Array) -> Array:
    """M C Mᵀ, in which only what depends on an unknown of NaN variance becomes NaN."""
    unknown = np.isnan(np.diag(covariance))
    mapped: Array = M @ np.where(unknown[:, None] | unknown, 0.0, covariance) @ M.T
    lost = np.any(M[:, unknown] != 0.0, axis=1)
    mapped[lost], mapped[:, lost] = np.nan, np.nan
    return mapped


def positive(covariance: Array) -> Array:
    """The nearest covariance without negative variances; NaN stays."""
    if not np.all(np.isfinite(covariance)):
        return covariance
    variances, axes = np.linalg.eigh(covariance)
    positive: Array = axes * np.maximum(variances, 0.0) @ axes.T
    return positive


def mean_load(equations: Sequence[Equations], loads: Sequence[Array]) -> Array:
    """(J,) mean |τ| through each gear over the samples used; 0 where there are none [N·m]."""
    total = np.sum([np.sum(np.abs(load) * eq.used, axis=0) for eq, load in zip(equations, loads, strict=True)], axis=0)
    mean: Array = total / np.maximum(np.sum([np.sum(eq.used, axis=0) for eq in equations], axis=0), 1)
    return mean
