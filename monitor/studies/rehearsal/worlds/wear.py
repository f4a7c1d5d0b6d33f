"""Wear that is put into joints of a world, from its onset on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.recording import Array
from monitor.studies.rehearsal.worlds.change import Factors

DOUBLINGS = 4.0  # of the rate of a rise that grows ever faster, in one life

Path = Callable[[Array], Array]
"""Time since the onset, ≥ 0, in years or in lives, to the rise of friction as a fraction; at the onset itself it may jump."""


def step(size: float) -> Path:
    """A rise at once."""
    return lambda time: np.full_like(time, size)


def straight(rate: float) -> Path:
    """A constant rate."""
    return lambda time: rate * time


def exponential(limit: float) -> Path:
    """A rise that grows ever faster, in lives: it reaches `limit` after one life, and its rate doubles four times until then."""
    k = DOUBLINGS * np.log(2.0)
    return lambda time: limit * np.expm1(k * np.minimum(time, 1.5)) / np.expm1(k)


def power(limit: float, exponent: float) -> Path:
    """A rise like t^exponent, in lives, that reaches `limit` after one life."""
    return lambda time: limit * time**exponent


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
    life_years: tuple[float, float] | None = None  # between which an arm's life is drawn, which `path` counts in; None: it counts in years

    def factors(self, onset_day: Array, unit_days: Array, worn: np.ndarray, days: int) -> Factors:
        """The logarithms of the factors; onset_day, unit_days (of the path's time) : (A,), worn : (A, J)."""
        since = (np.arange(float(days))[:, None] - onset_day) / unit_days  # (D, A)
        rise = np.where(since >= 0.0, self.path(np.maximum(since, 0.0)), 0.0)[..., None] * worn
        return Factors(np.log1p(self.dry * rise), np.log1p(self.viscous * rise), residual=self.residual * rise)


STEP_5 = Wear(name="5 % step", path=step(0.05))
RATE_10 = Wear(name="10 %/year", path=straight(0.10))
