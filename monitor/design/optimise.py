"""Search for the curve that tells most: CMA-ES with restarts (Hansen and Ostermeier (2001); library `cma`), or the paper's GA.

Reproducible: the dice come from the seed alone, and the budget counts evaluations. A best is a best only when its whole path was
shown to keep its margins.
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
FIRST_STEP = 0.5  # in units of the speed limit: smaller ones end in poorer optima, though more of the first curves are allowed
DRAWS = 2000  # evaluations for a validation trajectory
SHRINK, SMALLEST = 0.8, 0.25  # a random curve below a quarter of its size is drawn again


class Progress(NamedTuple):
    """Where a search is, for a display and for whoever may stop it."""

    evaluations: int
    budget: int
    best: float  # inf while nothing allowed was found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """The best of a search."""

    u: Array  # (dimension,)
    value: float  # of the objective, on the search's grid
    evaluations: int
    stopped: bool  # before the budget was spent


class Search:
    """Counts evaluations, keeps the best, and remembers whether it was asked to stop."""

    def __init__(self, problem: Problem, budget: int, on_progress: Callable[[Progress], bool] | None) -> None:
        self.problem, self.budget, self.on_progress = problem, budget, on_progress
        self.evaluations = 0
        self.best, self.best_u = np.inf, np.zeros(problem.family.dimension)
        self.asked_to_stop = False
        self.least_broken, self.least_broken_u = np.inf, self.best_u

    def over(self) -> bool:
        """Spent or stopped."""
        return self.asked_to_stop or self.evaluations >= self.budget

    def __call__(self, u: Array) -> float:
        """The cost of u; a new best must first pass the look between its samples."""
        self.evaluations += 1
        cost = self.problem.cost(u)
        if cost < self.best and cost < FORBIDDEN and not self.problem.allowed(self.problem.family.excitation(u)):
            cost = FORBIDDEN  # just beside the allowed
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
) -> Found:
    """The best curve within a budget of evaluations; the same arguments find the same one.

    `on_progress` is called after each evaluation; once it answers False, the best so far is returned. Raises Infeasible where nothing
    allowed was found, BadInput for an unknown optimiser or a budget below 1.
    """
    if optimiser not in OPTIMISERS:
        raise BadInput(f"optimiser {optimiser!r} is not known; known are {', '.join(OPTIMISERS)}")
    if evaluations < 1:
        raise BadInput(f"evaluations = {evaluations}; expected 1 or more")
    search = Search(problem, evaluations, on_progress)
    rng = np.random.default_rng(seed)
    first = _any_allowed(search, rng)  # so that there is something to keep from the beginning
    if optimiser == "ga":
        generations(search, first, rng, search.over)
    else:
        _cma(search, first, rng)
    if not search.best < FORBIDDEN:
        raise Infeasible(_why_none(search))
    return Found(u=search.best_u, value=search.best, evaluations=search.evaluations, stopped=search.asked_to_stop)


def random_curve(problem: Problem, seed: int) -> Found:
    """Pseudo-random coefficients under the same constraints, for validation: not fitted to any objective, Raviola et al. (2021), §5.

    A curve that breaks a margin is shrunk towards its offset; below a quarter of its size it is drawn again. Raises Infeasible
    where none of many fits.
    """
    search = Search(problem, DRAWS, None)
    u = _any_allowed(search, np.random.default_rng(seed))
    if not search.best < FORBIDDEN:
        raise Infeasible(_why_none(search))
    return Found(u=u, value=search.best, evaluations=search.evaluations, stopped=False)


def _any_allowed(search: Search, rng: np.random.Generator) -> Array:
    """The first random curve that keeps its limits; the last that was tried where none does before the search is over."""
    while True:
        # coefficients of a third of the limits: most curves reach a limit in some joint, few in all
        size, u = 1.0, rng.standard_normal(search.problem.family.dimension) / 3.0
        while size > SMALLEST:
            if search(size * u) < FORBIDDEN or search.over():
                return size * u
            size *= SHRINK


def _cma(search: Search, first: Array, rng: np.random.Generator) -> None:
    """Restarts from another point with twice the population whenever it has settled: Auger and Hansen (2005)."""
    import cma  # 0.2 s, and only here

    dimension = len(first)
    population = 4 + int(3 * np.log(dimension))
    start = first
    while not search.over():
        options = {
            "popsize": population,
            "seed": np.nan,  # leave numpy's global dice alone: these are ours
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
    """What binds at the least broken curve that was seen."""
    problem = search.problem
    excitation = problem.family.excitation(search.least_broken_u)
    state = excitation.at(np.linspace(0.0, excitation.period_s, 500))
    broken = problem.broken(state)
    what = broken or "its path comes too near between the samples, or it does not excite every parameter"
    return f"no allowed curve in {search.evaluations} evaluations; of the one that breaks least, {what}"
