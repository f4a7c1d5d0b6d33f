"""By how much friction from work differs, as the arm itself shows: from path to path, and from day to day.

What the rows alone promise is an assumption: that what the model errs by is alike for half a second, and independent beyond. What paths
differ by shows how far that holds of this arm and program, and what days differ by shows how well its friction repeats. Both are weighed
against what is usual, by as many paths and days as there are: after one day the usual figure counts, after a week the arm's own.

Shapes: J joints, A = 2·J unknowns, D days.
"""

from typing import NamedTuple

import numpy as np

from monitor.identify.production.information import Sums
from monitor.recording import Array, Mask

USUAL_SCALE, SCALE_WEIGHT = 1.0, 1.0  # of the variance that the rows promise, and its weight in joints
MOST_SCALE = 4.0  # one joint says no more of the others: a few paths may agree or differ by chance
OWN_WEIGHT = 1.0  # of a joint's own paths beside what all joints show: what is carried, and where, is felt by some joints alone
DAYS_WEIGHT = 2.0  # of the usual scatter between days, in degrees of freedom of all joints together …
JOINTS_WEIGHT = 4.0  # … and of what all joints show in that of one: weights and speeds differ, grease and room are common
# change of log F(v*) with temperature: from −0.2 to −1 % a kelvin on arms with strain wave gears
FALL_PER_K, FALL_STD_PER_K = -0.006, 0.004


class Days(NamedTuple):
    """Friction by the work of each day, (D, J)."""

    friction_nm: Array  # NaN where that day does not tell
    temperature_c: Array  # NaN where unknown


def between_paths(sums: Sums) -> tuple[Array, Mask]:
    """The scatter of XᵀWe between paths (A, A), and the joints (J,) that have enough paths for one."""
    J = sums.path_gram.shape[1]
    score = sums.paths.reshape(len(sums.paths), J, 2).copy()  # (PATHS, J, 2)
    total = np.sum(sums.path_gram, axis=0)  # (J, 2, 2)
    ridge = 1e-9 * np.trace(total, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-12 * np.eye(2)
    change = np.linalg.solve(total + ridge, np.sum(score, axis=0)[:, :, None])[:, :, 0]  # (J, 2)
    left = score - np.einsum("kjab,jb->kja", sums.path_gram, change)
    used = np.trace(sums.path_gram, axis1=2, axis2=3) > 0.02 * np.trace(total, axis1=1, axis2=2) / len(score)  # (PATHS, J)
    count = np.sum(used, axis=0)  # (J,)
    inflated = left * np.sqrt(count / np.maximum(count - 2.0, 0.5))[None, :, None]
    flat = inflated.reshape(len(score), 2 * J)
    return flat.T @ flat, count > 2


def noise_scale(promised_var: Array, paths_var: Array, enough: Mask) -> Array:
    """(J,) by which the variance that the rows promise (J,) is multiplied, as paths differ (J,) in the joints that have `enough` (J,)."""
    known = enough & (promised_var > 0.0) & np.isfinite(paths_var)
    ratio = np.where(known, paths_var / np.where(known, promised_var, 1.0), 0.0)
    together = (SCALE_WEIGHT * USUAL_SCALE + np.sum(np.minimum(ratio, MOST_SCALE))) / (SCALE_WEIGHT + np.sum(known))
    scale: Array = np.where(known, (together + OWN_WEIGHT * ratio) / (1.0 + OWN_WEIGHT), together)
    return scale


def between_days(days: Days, usual: float) -> Array:
    """(J,) one standard deviation of friction from day to day, as a fraction of it, with temperature taken out.

    usual : the same of real arms, which counts where there is one day alone.
    """
    told = np.isfinite(days.friction_nm) & (days.friction_nm > 0.0)
    count = np.sum(told, axis=0)  # (J,)
    y = _centred(np.log(np.where(told, days.friction_nm, 1.0)), told)
    warmer = _centred(np.nan_to_num(days.temperature_c), told & np.isfinite(days.temperature_c))
    least = max(usual, 1e-4)
    slope = (FALL_PER_K / FALL_STD_PER_K**2 + np.sum(warmer * y) / least**2) / (FALL_STD_PER_K**-2 + np.sum(warmer**2) / least**2)
    squares = np.sum((y - slope * warmer) ** 2, axis=0)  # (J,)
    free = np.maximum(count - 1.0, 0.0)
    together = (DAYS_WEIGHT * usual**2 + np.sum(squares)) / (DAYS_WEIGHT + np.sum(free))
    scatter: Array = np.sqrt((JOINTS_WEIGHT * together + squares) / (JOINTS_WEIGHT + free))
    return scatter


def _centred(values: Array, known: Mask) -> Array:
    """(D, J) the values less their mean over the days that are known; 0 on the others."""
    count = np.maximum(np.sum(known, axis=0), 1)
    mean = np.sum(np.where(known, values, 0.0), axis=0) / count
    centred: Array = np.where(known, values - mean, 0.0)
    return centred
