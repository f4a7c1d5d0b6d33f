"""The choice `auto` of a friction law: the simplest law that predicts data left out as well as the best does."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.felt import Felt
from monitor.identify.fit.fit import Fit, first_fit, fit
from monitor.identify.fit.least_squares import Factor, Rows, factors, joined, solve, triangle
from monitor.model.friction import PAPER, FrictionLaw, automatic_laws, law_of_every_term
from monitor.recording import Array, Indices

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
    # term after term: the columns of most laws are then the first ones, and their factor is a part of the factor of all
    B, own = len(prior), problem.layout.of_law(richest)[:, 2:]  # (J, E)
    order = np.concatenate([np.arange(B), own.T.ravel(), [-1]])
    folds = [_fold([_stretch(rec, k) for rec in rows], weights, order) for k in range(FOLDS)]
    others = factors_of_others([fold.R for fold in folds])
    errors = {}
    for law in laws:
        terms = [richest.extra_terms.index(term) for term in law.extra_terms]
        columns = np.concatenate([np.arange(B), *(B + len(own) * k + np.arange(len(own)) for k in terms), [-1]]).astype(np.intp)
        expected = np.append(prior, np.zeros(len(columns) - 1 - B))
        errors[law.name] = errors_left_out(folds, others, columns, expected)
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


def _fold(rows: Sequence[Rows], weights: Array, order: Indices) -> Factor:
    """One factor of all joints' rows, weighted, with its columns in this order."""
    joints = factors(rows)
    return Factor(
        triangle(np.concatenate([weight * factor.R[:, order] for weight, factor in zip(weights, joints, strict=True)])),
        sum(factor.samples for factor in joints),
    )


def factors_of_others(folds: Sequence[Array]) -> list[Array]:
    """Of each stretch the factor of all other stretches."""
    before = [folds[0][:0]]  # factor of all stretches before this one
    for R in folds[:-1]:
        before.append(joined(before[-1], R))
    after, others = folds[0][:0], []
    for R, earlier in zip(reversed(folds), reversed(before), strict=True):
        others.append(joined(earlier, after))
        after = joined(R, after)
    return others[::-1]


def errors_left_out(folds: Sequence[Factor], others: Sequence[Array], columns: Indices, expected: Array) -> Array:
    """(F,) mean square residual of each stretch after the fit of these columns to all other stretches; rows are weighted."""
    K = len(expected)
    first = np.array_equal(columns[:-1], np.arange(K))
    errors = []
    for fold, R in zip(folds, others, strict=True):
        # of the first columns, the later rows hold nothing but what no solution explains
        rest = R[: K + 1, columns] if first else triangle(R[:, columns])
        left = fold.R[:, columns] @ np.append(solve([Factor(rest, 1)], np.ones(1), expected).values, -1.0)
        errors.append(float(left @ left) / max(fold.samples, 1))
    return np.array(errors)
