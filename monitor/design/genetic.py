"""The paper's optimiser, as a baseline: a genetic algorithm with a population of 300, Raviola et al. (2021), §2.3.

The paper gives the population and the tool. The rest are that tool's defaults for continuous problems: fitness by rank, stochastic
universal selection, 5 % elite, 80 % scattered crossover, Gaussian mutation that decreases over the generations.
"""

from collections.abc import Callable

import numpy as np

from monitor.recording import Array

POPULATION = 300
ELITE = 0.05
CROSSOVER = 0.8
FIRST_SPREAD = 0.3  # standard deviation of the first generation, as the first step of CMA-ES
MUTATION = 0.5  # first mutation, as a fraction of the first spread
GENERATIONS = 100  # over which the mutation decreases to a hundredth; later generations keep that


def generations(cost: Callable[[Array], float], first: Array, rng: np.random.Generator, over: Callable[[], bool]) -> None:
    """Evaluate one generation after the other until `over`. The caller keeps the best. The first generation contains the given curve."""
    dimension = len(first)
    people = FIRST_SPREAD * rng.standard_normal((POPULATION, dimension))
    people[0] = first
    costs = _all(cost, people, over)
    elite, children = round(ELITE * POPULATION), round(CROSSOVER * (POPULATION - round(ELITE * POPULATION)))
    generation = 0
    while not over():
        order = np.argsort(costs, kind="stable")
        fitness = np.empty(POPULATION)
        fitness[order] = 1.0 / np.sqrt(np.arange(1, POPULATION + 1))
        mutants = POPULATION - elite - children
        parents = _stochastic_universal(fitness, 2 * children + mutants, rng)
        mothers, fathers = people[parents[:children]], people[parents[children : 2 * children]]
        crossed = np.where(rng.random((children, dimension)) < 0.5, mothers, fathers)
        spread = FIRST_SPREAD * MUTATION * max(0.01, 1.0 - generation / GENERATIONS)
        mutated = people[parents[2 * children :]] + spread * rng.standard_normal((mutants, dimension))
        new = np.vstack([crossed, mutated])
        new_costs = _all(cost, new, over)
        people, costs = np.vstack([people[order[:elite]], new]), np.concatenate([costs[order[:elite]], new_costs])
        generation += 1


def _all(cost: Callable[[Array], float], people: Array, over: Callable[[], bool]) -> Array:
    """(n,) the cost of each individual (n, dimension); infinite for those after the search was over."""
    return np.array([np.inf if over() else cost(u) for u in people])


def _stochastic_universal(fitness: Array, count: int, rng: np.random.Generator) -> Array:
    """(count,) indices drawn in proportion to fitness with equally spaced pointers, in random order: Baker (1987)."""
    wheel = np.cumsum(fitness) / np.sum(fitness)
    pointers = (rng.random() + np.arange(count)) / count
    chosen: Array = rng.permutation(np.minimum(np.searchsorted(wheel, pointers), len(fitness) - 1))
    return chosen
