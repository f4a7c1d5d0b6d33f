"""Figures of studies with the one-sided 95 % bounds by which they are judged."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import beta, chi2, t

from monitor.recording import Array

SURE = 0.95  # one-sided
NINETY = 1.645  # standard deviations either side
MOVING_RAD_S = 0.05  # what a standing joint holds is no question of friction in motion


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Events in so many robot-years, and the upper bound of their rate (Garwood, 1936)."""

    events: int
    robot_years: float

    @property
    def per_year(self) -> float:
        """As seen."""
        return self.events / self.robot_years

    @property
    def at_most(self) -> float:
        """95 %."""
        return float(chi2.ppf(SURE, 2 * (self.events + 1))) / 2.0 / self.robot_years


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """How many of how many, and the bounds of the share (Clopper and Pearson, 1934)."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """As seen."""
        return self.hits / self.of if self.of else float("nan")

    @property
    def at_least(self) -> float:
        """95 %."""
        return float(beta.ppf(1.0 - SURE, self.hits, self.of - self.hits + 1)) if self.hits else 0.0

    @property
    def at_most(self) -> float:
        """95 %."""
        return float(beta.ppf(SURE, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0


class Figure(NamedTuple):
    """A figure of a fleet, and its bounds."""

    value: float
    at_least: float
    at_most: float


def over_arms(of: Callable[[Array], float], arms: Array) -> Figure:
    """`of` all the arms' rows (A, …), with bounds from leaving out one arm at a time: arms differ, what one arm says hangs together.

    The jackknife of Tukey (1958), with Student's t of A − 1 degrees of freedom; the bounds of one arm are NaN.
    """
    A = len(arms)
    value = float(of(arms))
    if A < 2:
        return Figure(value, float("nan"), float("nan"))
    without = np.array([of(np.delete(arms, a, axis=0)) for a in range(A)])
    std = float(np.sqrt((A - 1.0) / A * np.sum((without - without.mean()) ** 2)))
    reach = float(t.ppf(SURE, A - 1)) * std
    return Figure(value, value - reach, value + reach)
