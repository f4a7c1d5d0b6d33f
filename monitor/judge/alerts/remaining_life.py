"""When will friction reach its limit? First passage of a Wiener process with drift, mixed over what we believe of its rate.

For one rate ν the time to rise by d is inverse Gaussian (Chhikara & Folks, 1989); the posterior of (wear, rate) enters by
a fixed lattice, so the answer is the same every time. It says when a friction threshold is crossed, not when a gear breaks.
"""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Interval
from scipy.special import log_ndtr, ndtr, ndtri

from monitor.judge.bounds import check_bounds
from monitor.recording import Array

DAYS = np.geomspace(0.05, 20_000.0, 48)  # the distribution is tabulated here, then finely where it rises; 54 years end foresight
FINE = 96
# a golden-ratio lattice over (rate, wear given the rate), equally likely points: with few Gauss nodes the mixture of nearly
# sharp passages would be a staircase, and its quantiles the steps
NODES = 199
RATE_NODES = ndtri((np.arange(NODES) + 0.5) / NODES)  # (M,)
WEAR_NODES = ndtri((np.arange(NODES) * (math.sqrt(5.0) - 1.0) / 2.0 + 0.5) % 1.0)  # (M,)


@dataclass(frozen=True, slots=True, kw_only=True)
class PrognosisSettings:
    """Which limit, and when a trend is one."""

    limit_rise: Annotated[float, Interval(ge=1e-6, le=10.0)] = 0.30  # friction above its beginning, fraction
    service_days: Annotated[float, Interval(ge=1.0, le=3650.0)] = 90.0  # to the next service: how likely is the limit met before it?
    trend_sure: Annotated[float, Interval(gt=0.5, lt=1.0)] = 0.95  # below this P(rate > 0), no date is given

    def __post_init__(self) -> None:
        """Raises BadConfiguration where a figure is out of its bounds."""
        check_bounds(self, "prognosis")


class RemainingLife(NamedTuple):
    """Days until the limit. None: not within 20 000 days, or, all three, no trend."""

    trend_probability: float  # P(wear rate > 0)
    p10_days: float | None
    p50_days: float | None
    p90_days: float | None
    verdict: str  # "trend" | "no_trend" | "reached"
    before_service_probability: float = 0.0  # that the limit is met within `service_days`


def remaining_life(mean: Array, cov: Array, *, wear_walk_per_sqrt_day: float, settings: PrognosisSettings) -> RemainingLife:
    """From the belief on wear, in the logarithm of friction torque, and on its rate, a fraction a day: mean (2,) and cov (2, 2).

    The same wear every day is the same rise every day, not the same factor: the limit is approached along a straight line.
    """
    mean, cov = straight(mean, cov)
    trend = float(ndtr(mean[1] / max(math.sqrt(cov[1, 1]), 1e-300)))
    if mean[0] >= settings.limit_rise:
        return RemainingLife(trend, 0.0, 0.0, 0.0, "reached", 1.0)
    service = float(_mixture(mean, cov, np.array([settings.service_days]), wear_walk_per_sqrt_day, settings)[0])
    if trend < settings.trend_sure:
        return RemainingLife(trend, None, None, None, "no_trend", service)
    coarse = _mixture(mean, cov, DAYS, wear_walk_per_sqrt_day, settings)
    first, last = np.searchsorted(coarse, [0.1, 0.9])  # P10 and P90 lie between these and the points before
    days = np.geomspace(DAYS[max(first - 1, 0)], DAYS[min(last, len(DAYS) - 1)], FINE)
    reached = _mixture(mean, cov, days, wear_walk_per_sqrt_day, settings)
    p10, p50, p90 = (_quantile(days, reached, p) for p in (0.1, 0.5, 0.9))
    return RemainingLife(trend, p10, p50, p90, "trend", service)


def straight(mean: Array, cov: Array) -> tuple[Array, Array]:
    """Mean and covariance of (rise, rise per day) as fractions, from (log rise, rise per day), to first order."""
    grown = math.exp(mean[0])
    M = np.diag([grown, 1.0])
    return np.array([grown - 1.0, mean[1]]), M @ cov @ M.T


def probability_within(days: float, mean: Array, cov: Array, *, wear_walk_per_sqrt_day: float, settings: PrognosisSettings) -> float:
    """That the limit is crossed within so many days, e.g. before the next service. Arguments as in `remaining_life`."""
    mean, cov = straight(mean, cov)
    if mean[0] >= settings.limit_rise:
        return 1.0
    return float(_mixture(mean, cov, np.array([days]), wear_walk_per_sqrt_day, settings)[0])


def first_passage(days: Array, rise: Array, rate: Array, walk: float) -> Array:
    """P(a Wiener process with drift has risen by `rise` within `days`), broadcast; a rise already made is certain.

    Φ((νt−d)/(σ√t)) + exp(2νd/σ²)·Φ(−(d+νt)/(σ√t)), the second term in logarithms since the exponential overflows.
    """
    spread = walk * np.sqrt(days)
    second = 2.0 * rate * rise / walk**2 + log_ndtr(-(rise + rate * days) / spread)
    passed: Array = np.where(rise <= 0, 1.0, ndtr((rate * days - rise) / spread) + np.exp(np.minimum(second, 0.0)))
    return np.minimum(passed, 1.0)


def _mixture(mean: Array, cov: Array, days: Array, walk: float, settings: PrognosisSettings) -> Array:
    """P(limit crossed within days) (D,), over the posterior of rate and of wear given the rate."""
    rate_std = math.sqrt(max(cov[1, 1], 1e-300))
    tilt = cov[0, 1] / rate_std
    rest_std = math.sqrt(max(cov[0, 0] - tilt**2, 0.0))
    rate = mean[1] + rate_std * RATE_NODES  # (M,)
    wear = mean[0] + tilt * RATE_NODES + rest_std * WEAR_NODES  # (M,)
    rise = settings.limit_rise - wear
    mixed: Array = np.mean(first_passage(days[:, None], rise, rate, walk), axis=1)  # (D, M) → (D,)
    return mixed


def _quantile(days: Array, reached: Array, p: float) -> float | None:
    """Days at which the tabulated distribution passes p, linear in log days; None where it never does."""
    if reached[-1] < p:
        return None
    i = int(np.searchsorted(reached, p))
    if i == 0:
        return float(days[0])
    part = (p - reached[i - 1]) / (reached[i] - reached[i - 1])
    return float(np.exp(np.log(days[i - 1]) + part * np.log(days[i] / days[i - 1])))
