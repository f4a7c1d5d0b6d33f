"""The choice `auto` of a friction law: the simplest law that predicts data left out as well as the best does."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.fit import fit
from monitor.identify.fit.least_squares import Factor, Rows, factors, residual_rms, solve
from monitor.model.friction import PAPER, FrictionLaw, automatic_laws, law_of_every_term
from monitor.recording import Array

FOLDS = 10  # stretches of time, each far longer than the time over which residuals are correlated (0.5 s)


class Choice(NamedTuple):
    """A law, and the RMS residual of every law on data to which it was not fitted, in units of the residual of the paper's law."""

    law: FrictionLaw
    held_out: Mapping[str, float]


def choose_law(problem: FitProblem, method: str) -> Choice:
    """Cross-validation over stretches of time within the recordings.

    Every law is fitted to the other stretches and tested on this one. A richer law replaces a simpler one only where its error is smaller
    by more than the standard error of the difference over the stretches.
    """
    prior, richest, laws = problem.prior, law_of_every_term(), automatic_laws()
    rows = fit(problem, richest, method=method).rows
    weights = fit(problem, PAPER, method=method).weights  # (J,) one scale, so that all laws are compared alike
    folds = [factors([_stretch(rec, k) for rec in rows]) for k in range(FOLDS)]
    places = problem.layout.of_law(richest)  # (J, K)
    errors = {}
    for law in laws:
        own = places[:, [richest.terms.index(term) for term in law.extra_terms]].ravel()
        columns = np.concatenate([np.arange(len(prior)), own, [-1]]).astype(np.intp)
        expected = np.append(prior, np.zeros(len(own)))
        errors[law.name] = _left_out([[Factor(f.R[:, columns], f.samples) for f in fold] for fold in folds], weights, expected)
    best = PAPER
    for law in laws[1:]:
        gain = errors[best.name] - errors[law.name]  # (F,) mean squares
        if np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(FOLDS):
            best = law
    return Choice(best, {name: float(np.sqrt(np.mean(error))) for name, error in errors.items()})


def _stretch(rec: Rows, k: int) -> Rows:
    """The k-th of FOLDS parts of a recording."""
    on = np.arange(len(rec.steps)) * FOLDS // len(rec.steps) == k
    robust_weight = None if rec.robust_weight is None else rec.robust_weight[on]
    return Rows(rec.Y[on], rec.torque_nm[on], rec.used[on], rec.steps[on], rec.segments[on], robust_weight)


def _left_out(folds: Sequence[Sequence[Factor]], weights: Array, expected: Array) -> Array:
    """(F,) mean square residual of each stretch, in units of the weights, after the fit to all other stretches."""
    errors = []
    for k, fold in enumerate(folds):
        others = [other for i, other in enumerate(folds) if i != k]
        joints = [
            Factor(np.concatenate([other[j].R for other in others]), sum(other[j].samples for other in others)) for j in range(len(weights))
        ]
        left = residual_rms(fold, solve(joints, weights, expected).values)  # (J,)
        samples = np.array([factor.samples for factor in fold])
        errors.append(float(np.sum(samples * (weights * left) ** 2) / max(np.sum(samples), 1)))
    return np.array(errors)
