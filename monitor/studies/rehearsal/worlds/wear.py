"""Wear that is put into joints of a world, from its onset on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.recording import Array
from monitor.studies.rehearsal.worlds.change import DAYS_A_YEAR, Factors

Path = Callable[[Array], Array]
"""Years since the onset, ≥ 0, to the rise of friction as a fraction; at the onset itself it may jump."""


def step(size: float) -> Path:
    """A rise at once."""
    return lambda years: np.full_like(years, size)


def straight(per_year: float) -> Path:
    """A constant rate."""
    return lambda years: per_year * years


def exponential(limit: float, life_years: float, doublings: float = 4.0) -> Path:
    """A rise that grows ever faster: it reaches `limit` at the end of life, and doubles so many times on the way."""
    k = doublings * np.log(2.0)
    return lambda years: limit * np.expm1(k * np.minimum(years / life_years, 1.5)) / np.expm1(k)


def root(limit: float, life_years: float) -> Path:
    """A rise that slows down like √t and reaches `limit` at the end of life."""
    return lambda years: limit * np.sqrt(years / life_years)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wear:
    """One kind of wear: which joints, and how friction rises in them."""

    name: str
    path: Path
    joints: int = 1  # of each arm, drawn
    dry: float = 1.0  # the rise of dry friction, as a multiple of `path`
    viscous: float = 1.0
    residual: float = 0.0  # log of the factor of the fit's RMS per rise of `path`
    earliest_day: float = 60.0  # of the onset
    latest_day: float = 425.0

    def factors(self, onset_day: Array, worn: np.ndarray, days: int) -> Factors:
        """The logarithms of the factors; onset_day : (A,), worn : (A, J)."""
        since = (np.arange(float(days))[:, None] - onset_day) / DAYS_A_YEAR  # (D, A)
        rise = np.where(since >= 0.0, self.path(np.maximum(since, 0.0)), 0.0)[..., None] * worn
        return Factors(np.log1p(self.dry * rise), np.log1p(self.viscous * rise), residual=self.residual * rise)


STEP_5 = Wear(name="5 % step", path=step(0.05))
RATE_10 = Wear(name="10 %/year", path=straight(0.10))
