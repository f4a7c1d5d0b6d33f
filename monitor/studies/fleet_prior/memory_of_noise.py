"""The memory of a fleet's noise: how far chance alone moves the mean of so many replays. Pure.

A new arm's monitor does not know whether noise averages out, and needs two months of replays to see it. Until then it takes chance for
larger than it mostly is. Arms of its model have seen it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.judge.drift.filter_state import FilterState
from monitor.judge.drift.noise.chance import AGES, GROUPS, KINDS
from monitor.judge.drift.prior import CHANCE_BOUNDS, OF_CHANCE
from monitor.recording import Array
from monitor.studies.fleet_prior.pool import FAMILY_ARMS, digits
from monitor.studies.fleet_prior.wear import worn

WEIGHT_REPLAYS = 12.0  # most: enough for a step in the first weeks, and an arm with longer memory than its fleet soon speaks for itself
MOST = 2.5  # times the median of the arms that one arm counts for at most: one with other noise does not speak for all


def learn_memory(states: Sequence[FilterState]) -> dict[str, Any]:
    """The part `chance` of a model's document: mean χ² by kind of change and age, and its weight, which few arms have little of."""
    arms = np.array([_of_arm(state) for state in states])  # (A, 2, G)
    most = np.nanmedian(np.where(np.isnan(arms).all(axis=0), 1.0, arms), axis=0) * MOST
    known = ~np.isnan(arms)
    number = known.sum(axis=0)
    mean = np.sum(np.where(known, np.minimum(arms, most), 0.0), axis=0) / np.maximum(number, 1)
    for age in range(1, GROUPS):  # no arm is as old as that: as the oldest age that some have seen
        mean[:, age] = np.where(number[:, age] > 0, mean[:, age], mean[:, age - 1])
    mean = np.clip(np.where(mean > 0, mean, 1.0), *CHANCE_BOUNDS)
    figures = {kind: [digits(value) for value in row] for kind, row in zip(OF_CHANCE, mean, strict=True)}
    return {"replays": digits(WEIGHT_REPLAYS * len(states) / (len(states) + FAMILY_ARMS)), **figures}


def _of_arm(state: FilterState) -> Array:
    """(2, G) mean of the arm's joints; NaN at ages that it has not lived. Of a joint that changed, falls count twice."""
    sides = state.chance.mean  # (J, 2, 2, G)
    each = np.where(worn(state)[:, None, None], 2.0 * sides[:, :, 0], sides.sum(axis=2))
    enough = state.chance.replays > np.maximum(AGES, 1.0)  # (J, G)
    weight = np.repeat(np.where(enough, state.chance.replays, 0.0)[:, None], KINDS, axis=1)
    total = weight.sum(axis=0)
    mean: Array = np.where(total > 0, (weight * each).sum(axis=0) / np.maximum(total, 1e-9), np.nan)
    return mean
