"""The choice `auto` of a friction law: the simplest law that predicts data left out as well as the best does."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.felt import Felt
from monitor.identify.fit.fit import Fit, first_fit, fit
from monitor.identify.fit.least_squares import Factor, Rows, factors, solve, triangle
from monitor.model.friction import PAPER, FrictionLaw, automatic_laws, law_of_every_term
from monitor.recording import Array

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
    folds = [_fold([_stretch(rec, k) for rec in rows], weights) for k in range(FOLDS)]
    places = problem.layout.of_law(richest)  # (J, K)
    errors = {}
    for law in laws:
        own = places[:, [richest.terms.index(term) for term in law.extra_terms]].ravel()
        columns = np.concatenate([np.arange(len(prior)), own, [-1]]).astype(np.intp)
        expected = np.append(prior, np.zeros(len(own)))
        errors[law.name] = _left_out([Factor(triangle(fold.R[:, columns]), fold.samples) for fold in folds], expected)
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
    return Factor(
        triangle(np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])),
        sum(factor.samples for factor in joints),
    )


def _left_out(folds: Sequence[Factor], expected: Array) -> Array:
    """(F,) mean square residual of each stretch after the fit to all other stretches; rows are weighted."""
    before = [folds[0].R[:0]]  # factor of all stretches before this one
    for fold in folds[:-1]:
        before.append(triangle(np.concatenate([before[-1], fold.R])))
    after, errors = folds[0].R[:0], []
    for fold, earlier in zip(reversed(folds), reversed(before), strict=True):
        others = [Factor(np.concatenate([earlier, after]), 1)]
        left = fold.R @ np.append(solve(others, np.ones(1), expected).values, -1.0)
        errors.append(float(left @ left) / max(fold.samples, 1))
        after = triangle(np.concatenate([fold.R, after]))
    return np.array(errors[::-1])
