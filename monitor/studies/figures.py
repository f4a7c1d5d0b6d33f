"""Figures of studies, with the one-sided 95 % bounds by which they are judged."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # whose statistics are loaded by their first use: they take half a second, and most studies need the constants alone

from monitor.recording import Array, known_or_none

SURE = 0.95  # one-sided confidence of every bound
NINETY = 1.645  # standard deviations on either side of a 90 % interval
LEAST_OF_MEDIAN = 5  # values: 1/2⁵ < 0.05
SLIDING_RAD_S = 0.05  # slower joints hold rather than slide, and are left out of questions of friction in motion
DAYS_A_YEAR = 365.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Events in a number of robot-years, and the upper bound of their rate (Garwood, 1936)."""

    events: int
    robot_years: float

    @property
    def per_year(self) -> float:
        """The observed rate."""
        return self.events / self.robot_years

    @property
    def at_most(self) -> float:
        """Its upper bound."""
        return float(scipy.stats.chi2.ppf(SURE, 2 * (self.events + 1))) / 2.0 / self.robot_years


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Hits among a number of trials, and the bounds of their share (Clopper and Pearson, 1934)."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The observed share; NaN without trials."""
        return self.hits / self.of if self.of else float("nan")

    @property
    def at_least(self) -> float:
        """Its lower bound."""
        return float(scipy.stats.beta.ppf(1.0 - SURE, self.hits, self.of - self.hits + 1)) if self.hits else 0.0

    @property
    def at_most(self) -> float:
        """Its upper bound."""
        return float(scipy.stats.beta.ppf(SURE, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0


def median_bounds(values: Array) -> tuple[float, float]:
    """The lower and the upper bound of the median, by order statistics; infinite values may be among them.

    Of fewer than five values not even the outermost bound it.
    """
    ordered, n = np.sort(values), len(values)
    if n < LEAST_OF_MEDIAN:
        return -np.inf, np.inf
    rank = int(np.ceil(n / 2 + NINETY * np.sqrt(n) / 2))
    return float(ordered[max(n - 1 - rank, 0)]), float(ordered[min(rank, n - 1)])


class Figure(NamedTuple):
    """A figure of a fleet, and its bounds."""

    value: float
    at_least: float
    at_most: float


def over_arms(of: Callable[[Array], float], arms: Array) -> Figure:
    """`of` the rows (A, …) of all arms, with bounds from leaving out one arm at a time: values of one arm are not independent.

    The jackknife of Tukey (1958), with Student's t of A − 1 degrees of freedom; the bounds of one arm are NaN.
    """
    A = len(arms)
    value = float(of(arms))
    if A < 2:
        return Figure(value, float("nan"), float("nan"))
    without = np.array([of(np.delete(arms, a, axis=0)) for a in range(A)])
    std = float(np.sqrt((A - 1.0) / A * np.sum((without - without.mean()) ** 2)))
    reach = float(scipy.stats.t.ppf(SURE, A - 1)) * std
    return Figure(value, value - reach, value + reach)


def share_document(share: Share) -> dict[str, float | None]:
    """A share and its bounds, as JSON."""
    return {
        "hits": share.hits,
        "of": share.of,
        "share": known_or_none(share.value),
        "at_least": share.at_least,
        "at_most": share.at_most,
    }
