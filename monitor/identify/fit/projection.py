"""fc and fv of a richer friction law: the line of the paper that is nearest to it."""

from collections.abc import Sequence

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.fit import Fit
from monitor.recording import Array


def projection(problem: FitProblem, loads: Sequence[Array], found: Fit) -> Array:
    """(B, X) matrix from the law's unknowns to the paper's base parameters.

    For friction it is the least-squares line fc·s(q̇) + fv·q̇ over the rows used. loads : (N, J) torque through the gears of each
    recording [N·m].
    """
    layout = problem.layout
    B, places = len(layout.rigid), layout.of_law(found.law)
    M = np.eye(B, len(found.solution.values))
    for j, own in enumerate(places):
        columns = [
            found.law.columns(eq.motion.qd[eq.used[:, j], j], load[eq.used[:, j], j])
            for eq, load in zip(problem.equations, loads, strict=True)
        ]
        line = np.concatenate(columns)  # (n, K)
        if len(line):
            M[layout.friction[j, :, None], own] = np.linalg.lstsq(line[:, :2], line, rcond=None)[0]
    return M


def mean_load(problem: FitProblem, loads: Sequence[Array]) -> Array:
    """(J,) mean |τ| through each gear over the rows used [N·m]; 0 where there are none. loads : as for `projection`."""
    equations = problem.equations
    total = np.sum([np.sum(np.abs(load) * eq.used, axis=0) for eq, load in zip(equations, loads, strict=True)], axis=0)
    mean: Array = total / np.maximum(np.sum([np.sum(eq.used, axis=0) for eq in equations], axis=0), 1)
    return mean
