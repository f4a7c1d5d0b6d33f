"""Search for the most informative curve: CMA-ES with restarts (Hansen and Ostermeier (2001); library `cma`), or the paper's GA.

The search is reproducible: random numbers depend on the seed alone, and the budget counts evaluations. A curve becomes the best only after
its whole path was shown to keep its margins.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.design.genetic import generations
from monitor.design.problem import FORBIDDEN, Infeasible, Problem
from monitor.errors import BadInput
from monitor.recording import Array

OPTIMISERS = ("cma", "ga")
FIRST_STEP = 0.5  # in units of the speed limit: smaller first steps end in poorer optima, although more of their curves are allowed
DRAWS = 2000  # evaluations in the search for a validation trajectory, which needs to be allowed and no optimum
SHRINK, SMALLEST = 0.8, 0.25  # a random curve is reduced by the first factor; below the second size another one is drawn


class Progress(NamedTuple):
    """The state of a search, for a display and for a function that may stop it."""

    evaluations: int
    budget: int
    best: float  # infinite as long as no allowed curve was found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchResult:
    """The best curve of a search."""

    u: Array  # (dimension,) its free coordinates
    value: float  # of the objective, on the search's grid of samples
    evaluations: int
    stopped: bool  # the search was stopped before its budget was used


class Search:
    """Counts evaluations, keeps the best curve, and remembers whether the search was asked to stop."""

    def __init__(self, problem: Problem, budget: int, on_progress: Callable[[Progress], bool] | None) -> None:
        self.problem, self.budget, self.on_progress = problem, budget, on_progress
        self.evaluations = 0
        self.best, self.best_u = np.inf, np.zeros(problem.family.dimension)
        self.asked_to_stop = False
        self.least_broken, self.least_broken_u = np.inf, self.best_u

    def over(self) -> bool:
        """Whether the budget is used or the search was asked to stop."""
        return self.asked_to_stop or self.evaluations >= self.budget

    def __call__(self, u: Array) -> float:
        """The cost of the free coordinates u. A new best must first keep its margins between the samples too."""
        self.evaluations += 1
        cost = self.problem.cost(u)
        if cost < self.best and cost < FORBIDDEN and not self.problem.allowed(self.problem.family.excitation(u)):
            cost = FORBIDDEN  # just above every allowed cost
        if cost >= FORBIDDEN and cost < self.least_broken:
            self.least_broken, self.least_broken_u = cost, u.copy()
        if cost < min(self.best, FORBIDDEN):
            self.best, self.best_u = cost, u.copy()
        if self.on_progress is not None and not self.asked_to_stop:
            self.asked_to_stop = not self.on_progress(Progress(self.evaluations, self.budget, self.best))
        return cost


def optimise(
    problem: Problem,
    *,
    evaluations: int,
    seed: int,
    optimiser: str = "cma",
    on_progress: Callable[[Progress], bool] | None = None,
) -> SearchResult:
    """The best curve within a budget of evaluations. The same arguments give the same curve.

    on_progress : is called after each evaluation; when it returns False, the search ends with the best curve so far.
    Raises Infeasible where no allowed curve was found, BadInput for an unknown optimiser or a budget below 1.
    """
    if optimiser not in OPTIMISERS:
        raise BadInput(f"optimiser {optimiser!r} is not known; known are {', '.join(OPTIMISERS)}")
    if evaluations < 1:
        raise BadInput(f"evaluations = {evaluations}; expected 1 or more")
    search = Search(problem, evaluations, on_progress)
    rng = np.random.default_rng(seed)
    first = _any_allowed(search, rng)  # so that there is a result from the beginning
    if optimiser == "ga":
        generations(search, first, rng, search.over)
    else:
        _cma(search, first, rng)
    if not search.best < FORBIDDEN:
        raise Infeasible(_why_none(search))
    return SearchResult(u=search.best_u, value=search.best, evaluations=search.evaluations, stopped=search.asked_to_stop)


def random_curve(problem: Problem, seed: int) -> SearchResult:
    """A curve with pseudo-random coefficients under the same constraints, for validation: Raviola et al. (2021), §5.

    A curve that breaks a margin is reduced towards its offset; below a quarter of its size another one is drawn. Raises Infeasible where
    none of many is allowed.
    """
    search = Search(problem, DRAWS, None)
    u = _any_allowed(search, np.random.default_rng(seed))
    if not search.best < FORBIDDEN:
        raise Infeasible(_why_none(search))
    return SearchResult(u=u, value=search.best, evaluations=search.evaluations, stopped=False)


def _any_allowed(search: Search, rng: np.random.Generator) -> Array:
    """The first random curve that keeps its limits; the last one tried where the search ends before."""
    while True:
        # coefficients of a third of the limits: most curves reach a limit in some joint, few in all joints
        size, u = 1.0, rng.standard_normal(search.problem.family.dimension) / 3.0
        while size > SMALLEST:
            if search(size * u) < FORBIDDEN or search.over():
                return size * u
            size *= SHRINK


def _cma(search: Search, first: Array, rng: np.random.Generator) -> None:
    """CMA-ES that restarts from another point with twice the population when it has converged: Auger and Hansen (2005)."""
    import cma  # takes 0.2 s: only where a search runs

    dimension = len(first)
    population = 4 + int(3 * np.log(dimension))
    start = first
    while not search.over():
        options = {
            "popsize": population,
            "seed": np.nan,  # the library must not change numpy's global random state
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -9,
            "verb_log": 0,
            "CMA_stds": np.ones(dimension),
            "tolfun": 1e-4,
            "tolfunhist": 1e-5,
        }
        strategy = cma.CMAEvolutionStrategy(start, FIRST_STEP, options)
        while not search.over() and not strategy.stop():
            asked = strategy.ask()
            costs = []
            for u in asked:
                if search.over():
                    return
                costs.append(search(np.asarray(u)))
            strategy.tell(asked, costs)
        population *= 2
        start = FIRST_STEP * rng.standard_normal(dimension)


def _why_none(search: Search) -> str:
    """A text that names the limit that binds at the curve with the smallest violation."""
    problem = search.problem
    excitation = problem.family.excitation(search.least_broken_u)
    state = excitation.at(np.linspace(0.0, excitation.period_s, 500))
    broken = problem.broken(state)
    what = broken or "its path comes too near between the samples, or it does not excite every parameter"
    return f"no allowed curve in {search.evaluations} evaluations; of the one that breaks least, {what}"
