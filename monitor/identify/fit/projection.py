"""fc and fv of a friction law with more terms: the paper's line fc·sign(q̇) + fv·q̇ that fits the law best.

The fit is linear least squares over the samples used, so it is a constant matrix, and covariances pass through it.
"""

from collections.abc import Sequence

import numpy as np

from monitor.identify.fit.equations import FitProblem
from monitor.identify.fit.fit import Fit
from monitor.model.friction import PAPER
from monitor.recording import Array


def projection(problem: FitProblem, loads: Sequence[Array], found: Fit) -> Array:
    """(B, X) matrix from the law's unknowns to the paper's base parameters.

    Rigid parameters stay as they are. A joint's friction unknowns become fc and fv of the line fc·s(q̇) + fv·q̇ that is nearest to the law
    by least squares over the rows used; s is the law's sign function. loads : (N, J) torque through the gears of each
    recording [N·m].
    """
    layout = problem.layout
    if found.law == PAPER:
        return np.eye(len(layout.rigid))
    B, places = len(layout.rigid), layout.of_law(found.law)
    M = np.eye(B, len(found.solution.values))
    for j, own in enumerate(places):
        columns = [
            found.law.columns(eq.motion.qd[eq.used[:, j], j], load[eq.used[:, j], j])
            for eq, load in zip(problem.equations, loads, strict=True)
        ]
        line = np.concatenate(columns)  # (n, K)
        nearest, _, rank, _ = np.linalg.lstsq(line[:, :2], line, rcond=None)
        if rank == 2:  # else the joint's rows show no line, and fc and fv stay as unknown as they are
            M[layout.friction[j, :, None], own] = nearest
    return M


def mean_load(problem: FitProblem, loads: Sequence[Array]) -> Array:
    """(J,) mean |τ| through each gear over the rows used [N·m]; 0 where there are none. loads : as for `projection`."""
    equations = problem.equations
    total = np.sum([np.sum(np.abs(load) * eq.used, axis=0) for eq, load in zip(equations, loads, strict=True)], axis=0)
    mean: Array = total / np.maximum(np.sum([np.sum(eq.used, axis=0) for eq in equations], axis=0), 1)
    return mean
