"""How the joints of a fleet wear once they do: along which paths, and how fast. Pure."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from monitor.judge.alerts.wear_paths import FAMILIES, FAMILY_PRIOR, GROWTHS, OTHERS, POWERS, RISE_STD, WearPaths, elasticity, wear_paths
from monitor.judge.drift.filter_state import RATE, SURE_SIGMAS, FilterState
from monitor.judge.drift.prior import LIFE_RISE, OF_WEAR, SHARES, WearPrior
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array
from monitor.studies.fleet_prior.pool import FAMILY_ARMS

LEAST_RISE = 0.02  # [log] healthy joints are found within it, and a detected one is above
FAMILY_SPREAD = 0.7  # [log] of the lives of any joints that wear: half to twice the median
LEAST_WORN = 10  # joints; fewer say nothing that a new joint should be held to
ROUNDS = 100  # of expectation and maximisation; three digits are reached after some thirty


class Joint(NamedTuple):
    """One joint that surely rises."""

    state: FilterState  # of its arm
    n: int
    slot: int  # of the context in force


def rising(state: FilterState) -> np.ndarray:
    """(J,) whether a joint's friction surely rises, and has risen by more than chance makes of a healthy joint."""
    rate, std = state.mean[:, RATE], np.sqrt(np.maximum(state.cov[:, RATE, RATE], 0.0))
    sure: np.ndarray = (rate > SURE_SIGMAS * std) & (state.wear > LEAST_RISE)
    return sure


def worn(state: FilterState) -> np.ndarray:
    """(J,) whether a joint's wear has begun: its friction surely rises, or has stepped up."""
    begun: np.ndarray = rising(state) | (state.stepped > LEAST_RISE)
    return begun


def learn_wear(joints: Sequence[Joint], drift: DriftSettings) -> WearPrior | None:
    """What the joints of a fleet that wear say of the next one; None where fewer than `LEAST_WORN` show a path.

    Each joint's course has a mixture of paths, each with a life: the usual days from its onset to a rise by LIFE_RISE. The shares of the
    families of paths, and mean and spread of the lives' logarithms, are those under which all courses together are likeliest (empirical
    Bayes, by expectation and maximisation), with `FAMILY_ARMS` joints for what holds without a fleet. As in `wear_paths`, a joint may be
    none of the fleet: one that broke moves the fleet's figures little.
    """
    alone = replace(drift, prior=None)  # what the joints say themselves, and not what an earlier prior of theirs has said
    found = [wear_paths(state, n, slot, state.joints, alone) for state, n, slot in joints]
    courses = [_course(each) for each in found if each is not None]
    if len(courses) < LEAST_WORN:
        return None
    family = float(np.log(LIFE_RISE / drift.unseen_pace_std_per_day))
    usual = np.array(FAMILY_PRIOR)
    shares, mean, var, of_fleet = usual, family, FAMILY_SPREAD**2, 0.0
    for _ in range(ROUNDS):
        told = sum((_told(course, np.log(shares / usual), mean, var) for course in courses), np.zeros(5))
        of_fleet = float(told[:3].sum())
        shares = (told[:3] + FAMILY_ARMS * usual) / (of_fleet + FAMILY_ARMS)
        mean = float((told[3] / var + family / FAMILY_SPREAD**2) / (of_fleet / var + FAMILY_SPREAD**-2.0))
        about_mean = told[4] - 2.0 * mean * told[3] + mean**2 * of_fleet
        var = float((about_mean + FAMILY_ARMS * FAMILY_SPREAD**2) / (of_fleet + FAMILY_ARMS))
    spread = np.sqrt(var + var / max(of_fleet, 1.0))
    figures = dict(zip(SHARES, shares, strict=True)) | {"life_days": np.exp(mean), "life_spread": spread}
    return WearPrior(joints=len(courses), **{name: float(np.clip(value, *OF_WEAR[name])) for name, value in figures.items()})


class _Course(NamedTuple):
    """The mixture of one joint's paths, (M,) each."""

    log_weight: Array  # of the likelihood: without what was expected of the rise
    family: np.ndarray  # index of FAMILIES
    life: Array  # log of the usual days from the onset to LIFE_RISE
    var: Array


def _course(paths: WearPaths) -> _Course:
    rise, shape = np.maximum(paths.mean[:, 2], 1e-4), paths.shape
    growth, ratio = GROWTHS[shape], LIFE_RISE / rise
    power = ratio ** (1.0 / POWERS[shape])
    accelerating = np.log1p(ratio * np.expm1(growth)) / np.maximum(growth, 1e-9)
    life = paths.since * np.where(growth > 0, accelerating, power)
    slope = elasticity(shape, paths.since, life)
    # the density that was expected of the logarithm of this life, by that of the rise
    expected = -0.5 * (rise / RISE_STD) ** 2 + np.log(2.0 / RISE_STD * slope * rise)
    family = np.argmax(np.stack([of[shape] for of in FAMILIES]), axis=0)
    return _Course(np.log(paths.weight) - expected, family, np.log(life), paths.cov[:, 2, 2] / (slope * rise) ** 2)


def _told(course: _Course, log_odds: Array, mean: float, var: float) -> Array:
    """(5,) of one joint: the probability that it is one of the fleet and wears along each family, and its expected x and x² of the life."""
    spread = course.var + var
    log = course.log_weight + log_odds[course.family] - 0.5 * np.log(spread) - 0.5 * (course.life - mean) ** 2 / spread
    most = float(log.max())
    weight = np.exp(log - most)
    fleet = (1.0 - OTHERS) * weight.sum() * np.exp(min(most, 500.0))
    weight *= fleet / (fleet + OTHERS) / weight.sum()
    life, rest = (course.life * var + mean * course.var) / spread, course.var * var / spread
    families = np.bincount(course.family, weights=weight, minlength=3)
    return np.array([*families, weight @ life, weight @ (life**2 + rest)])
