"""Friction over joint temperature: one straight line for each joint, learned from replay to replay, and a curve where that is better.

Raviola et al. (2021), §4: fv falls linearly with the joint's temperature, and Coulomb friction does not depend on it. A line is a Bayesian
linear regression on running sums. Its level has no prior, and its slope has that of the robot family: one replay already gives a usable law
with a realistic uncertainty. Over a wide range another law may fit better, see `curves`.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Interval

from monitor.judge.bounds import check_bounds
from monitor.judge.document import plain
from monitor.judge.temperature.curves import LAWS, Curve, LawForm, choose_curve, no_bins, update_bins
from monitor.recording import Array

SUMS = 6  # n, Σt, Σt², Σy, Σty, Σy² of the regression
LEAST_LEFT = 0.05  # share of its intercept below which an extrapolated line does not fall: friction never drives


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSettings:
    """The prior of the temperature laws, and how far they may be extrapolated."""

    viscous_fall_per_k: Annotated[float, Interval(ge=0.0, le=0.1)] = (
        0.015  # UR3 and UR5: 0.8–2.2 %/K between 22 and 40 °C, Raviola et al. (2021), table 4
    )
    viscous_fall_std_per_k: Annotated[float, Interval(ge=1e-6, le=0.1)] = 0.007  # the published range is ± 1 σ
    coulomb_fall_std_per_k: Annotated[float, Interval(ge=1e-6, le=0.1)] = (
        0.003  # the paper observes none; a straight line through a concave law leaves some
    )
    scatter: Annotated[float, Interval(ge=1e-6, le=1.0)] = (
        0.05  # prior scatter between replays, as a fraction: fc and fv of one trajectory scatter by 4–10 %
    )
    scatter_replays: Annotated[float, Interval(ge=1e-6, le=1e4)] = 5.0  # [replays] weight of that prior
    margin_k: Annotated[float, Interval(gt=0.0, le=50.0)] = 3.0  # a law may be used so far beyond the coldest and the warmest replay

    def __post_init__(self) -> None:
        """Raises BadConfiguration naming the field that is out of its bounds."""
        check_bounds(self, "temperature")


class LawValue(NamedTuple):
    """The value of a law at a temperature, its standard deviation, and whether it is an extrapolation."""

    value: Array
    std: Array
    extrapolated: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """Sufficient statistics of one line for each joint. t = T − origin_c and y = value − origin_value, against cancellation."""

    origin_c: Annotated[Array, "J"]
    origin_value: Annotated[Array, "J"]  # first value; NaN before
    slope_prior: Annotated[Array, "J"]  # [unit/K]
    slope_prior_std: Annotated[Array, "J"]
    scatter_prior: Annotated[Array, "J"]  # [unit] between replays
    sums: Annotated[Array, "J 6"]
    range_c: Annotated[Array, "J 2"]  # coldest and warmest replay; NaN before the first
    bins: Annotated[Array, "J BINS 3"]  # the same values by temperature, see `curves`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A fitted law: value = intercept + slope·(T − reference_c), without wear; or the curve, where that has less error."""

    reference_c: Annotated[Array, "J"]
    intercept: Annotated[Array, "J"]  # at reference_c; NaN where the joint was never resolved
    slope: Annotated[Array, "J"]  # [unit/K]
    cov: Annotated[Array, "J 2 2"]  # of (intercept, slope)
    scatter: Annotated[Array, "J"]  # between replays
    range_c: Annotated[Array, "J 2"]
    margin_k: float
    curve: Curve | None = None

    @property
    def law(self) -> tuple[str, ...]:
        """(J,) linear, exponential or vogel: the law that `at` uses."""
        kinds = np.zeros(len(self.intercept)) if self.curve is None else self.curve.kind
        return tuple(LAWS[int(kind)] for kind in kinds)

    def at(self, temperature_c: Array) -> LawValue:
        """Value, standard deviation of the law, and whether it is an extrapolation, (…, J) each, at temperatures (…, J).

        An extrapolated line does not fall below 5 % of its intercept, because friction never drives.
        """
        value, var = self.form.at(temperature_c)
        return LawValue(value, np.sqrt(var), ~self.inside(temperature_c))

    @property
    def form(self) -> LawForm:
        """The line of each joint, or its curve where that was chosen, as one formula for all joints."""
        lines = LawForm(
            linear=np.ones(len(self.intercept), dtype=bool),
            of_pole=np.zeros(len(self.intercept), dtype=bool),
            pole_c=np.zeros(len(self.intercept)),
            origin=self.reference_c,
            level=self.intercept,
            slope=self.slope,
            least=LEAST_LEFT * np.abs(self.intercept),
            c00=self.cov[:, 0, 0],
            c01=self.cov[:, 0, 1],
            c11=self.cov[:, 1, 1],
        )
        if self.curve is None or not np.any(self.curve.kind > 0):
            return lines
        curved = self.curve.kind > 0
        return LawForm(*(np.where(curved, of_curve, of_line) for of_curve, of_line in zip(self.curve.form, lines, strict=True)))

    def inside(self, temperature_c: Array) -> np.ndarray:
        """(…, J) whether temperatures (…, J) lie in the learned range, widened by the margin; False where either is unknown."""
        return inside_range(self.range_c, temperature_c, self.margin_k)

    @property
    def change(self) -> Array:
        """(J,) relative change from the coldest to the warmest replay; Raviola et al. (2021), table 4."""
        cold = self.intercept + self.slope * (self.range_c[:, 0] - self.reference_c)
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction: Array = self.slope * (self.range_c[:, 1] - self.range_c[:, 0]) / cold
        return np.where(np.isfinite(fraction), fraction, np.nan)

    def as_document(self) -> dict[str, Any]:
        """The line as plain JSON; `judge.document.typed` is the inverse."""
        document: dict[str, Any] = plain(self)
        return document


def inside_range(range_c: Array, temperature_c: Array, margin_k: float) -> np.ndarray:
    """(…, J) whether temperatures (…, J) lie in ranges (J, 2), widened by a margin; False where either is unknown."""
    within: np.ndarray = (temperature_c >= range_c[:, 0] - margin_k) & (temperature_c <= range_c[:, 1] + margin_k)
    return within


def initial_law(origin_c: Array, value: Array, *, fall_per_k: float, fall_std_per_k: float, scatter: float) -> Law:
    """A law before its first replay. The priors of slope and scatter are fractions of a first value (J,), NaN where it is unknown."""
    size = np.where(np.isfinite(value), np.maximum(np.abs(value), 1e-3), 1.0)  # a value of 0 would make the prior certain
    J = len(origin_c)
    return Law(
        origin_c=origin_c,
        origin_value=np.full(J, np.nan),
        slope_prior=-fall_per_k * size,
        slope_prior_std=fall_std_per_k * size,
        scatter_prior=scatter * size,
        sums=np.zeros((J, SUMS)),
        range_c=np.full((J, 2), np.nan),
        bins=no_bins(J),
    )


def update_law(law: Law, temperature_c: Array, value: Array) -> Law:
    """The law after one more replay, (J,) each. A joint with NaN in `value` keeps its law.

    An unknown temperature counts as the origin as long as none was known: the level is learned from it, and the range stays. Later it
    teaches nothing: a warm joint would be taken for a cold one of less friction.
    """
    seen = np.isfinite(value) & (np.isfinite(temperature_c) | ~(law.bins[..., 0] > 0).any(axis=-1))
    origin_value = np.where(np.isnan(law.origin_value), value, law.origin_value)
    t = np.where(np.isfinite(temperature_c), temperature_c - law.origin_c, 0.0)
    y = np.where(seen, value - origin_value, 0.0)
    more = np.stack([np.ones_like(t), t, t * t, y, t * y, y * y], axis=1)  # (J, 6)
    bins = update_bins(law.bins, temperature_c, value)
    shown = np.where(seen, temperature_c, np.nan)
    range_c = np.stack([np.fmin(law.range_c[:, 0], shown), np.fmax(law.range_c[:, 1], shown)], axis=1)
    return replace(law, origin_value=origin_value, sums=law.sums + np.where(seen[:, None], more, 0.0), range_c=range_c, bins=bins)


def fit_law(law: Law, reference_c: Array, settings: TemperatureSettings) -> Line:
    """The line by all replays so far and the prior, referred to a temperature (J,), and the curve where that has less error."""
    line = fit_line(law, reference_c, settings)
    return replace(line, curve=choose_curve(law.bins, reference_c, line.scatter))


def fit_line(law: Law, reference_c: Array, settings: TemperatureSettings) -> Line:
    """The straight line alone, as in `fit_law`."""
    n, St, Stt, Sy, Sty, Syy = law.sums.T  # (J,) each
    scatter = law.scatter_prior
    level, slope, cov = _posterior(law, scatter)
    # the residuals determine the scatter; without its prior, a line through two replays would be certain
    rss = Syy - 2.0 * (level * Sy + slope * Sty) + level**2 * n + 2.0 * level * slope * St + slope**2 * Stt
    freedom = settings.scatter_replays
    scatter = np.sqrt((freedom * law.scatter_prior**2 + np.maximum(rss, 0.0)) / (freedom + np.maximum(n - 1.0, 0.0)))
    level, slope, cov = _posterior(law, scatter)

    shift = reference_c - law.origin_c
    M = np.tile(np.eye(2), (len(shift), 1, 1))
    M[:, 0, 1] = shift
    return Line(
        reference_c=reference_c,
        intercept=law.origin_value + level + slope * shift,
        slope=slope,
        cov=M @ cov @ np.swapaxes(M, 1, 2),  # (J, 2, 2)
        scatter=scatter,
        range_c=law.range_c,
        margin_k=settings.margin_k,
    )


def reopen_law(law: Law, moved: np.ndarray, settings: TemperatureSettings) -> Law:
    """The law after the joints in `moved` (J,) entered another context: their level is unknown, their slope is a less certain prior."""
    line = fit_line(law, law.origin_c, settings)
    less_certain = np.hypot(np.sqrt(line.cov[:, 1, 1]), 0.25 * np.abs(line.slope))  # another load shifts the share of viscous friction
    return replace(
        law,
        origin_value=np.where(moved, np.nan, law.origin_value),
        slope_prior=np.where(moved, line.slope, law.slope_prior),
        slope_prior_std=np.where(moved, less_certain, law.slope_prior_std),
        sums=np.where(moved[:, None], 0.0, law.sums),
        bins=np.where(moved[:, None, None], 0.0, law.bins),
    )


def _posterior(law: Law, scatter: Array) -> tuple[Array, Array, Array]:
    """Level and slope (J,) about the origin and their covariance (J, 2, 2), for a given scatter."""
    n, St, Stt, Sy, Sty, _ = law.sums.T
    weight = 1.0 / scatter**2
    # a joint without replays has no level: a tiny precision instead of 0 keeps the algebra regular, and its intercept is NaN
    A00 = np.where(n > 0, n, 1e-9) * weight
    A01 = St * weight
    A11 = Stt * weight + 1.0 / law.slope_prior_std**2
    b0, b1 = Sy * weight, Sty * weight + law.slope_prior / law.slope_prior_std**2
    det = A00 * A11 - A01**2
    cov = np.stack([np.stack([A11, -A01], axis=1), np.stack([-A01, A00], axis=1)], axis=1) / det[:, None, None]  # (J, 2, 2)
    return (A11 * b0 - A01 * b1) / det, (A00 * b1 - A01 * b0) / det, cov
