"""The law that friction follows over the range of observed temperatures: a straight line, an exponential, or Vogel's law.

    linear       value = a + b·(T − T0)
    exponential  value = exp(a + b·(T − T0))
    vogel        value = exp(a + b·(1/(T − Tv) − 1/(T0 − Tv)))      Vogel (1921), as oils and greases follow it

A joint's values are stored as means in bins of temperature. Each law is fitted with a quarter of the range left out, and its error is
measured there. The law with the least error is chosen, and the line where no other is clearly better.

Shapes: J joints, B bins, L laws with Vogel's counted once for each pole.
"""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from monitor.recording import Array

LAWS = ("linear", "exponential", "vogel")
VOGEL = LAWS.index("vogel")
NEAREST_POLE_K = 5.0  # [K] closer to its pole Vogel's law has no physical meaning
LARGEST_LOG = 50.0  # keeps exponentials finite
POLES_C = (-60.0, -80.0, -100.0, -130.0, -170.0)  # Tv of oils: from just below their pour point to where Vogel's law equals an exponential
BIN_K, COLDEST_C, BINS = 2.0, -20.0, 50  # width of a bin, lower end of the first, number: −20 to 80 °C
PER_BIN = 3  # n, ΣT, Σvalue
PARTS = 4  # of the range; each is left out once
FEWEST_BINS, FEWEST_REPLAYS = 5, 15  # with less, every joint keeps its line
BETTER = 0.95  # a law must have less than this share of the line's error
VOGEL_BETTER = 0.8  # and Vogel's less than this share of the exponential's: its third parameter follows noise beyond the range


class LawForm(NamedTuple):
    """The law of each joint in one formula, (…, J) each: level + slope·x or, where not `linear`, its exponential.

    x = T − origin, or 1/(T − pole_c) − origin where `of_pole`.
    """

    linear: np.ndarray
    of_pole: np.ndarray
    pole_c: Array
    origin: Array  # [°C], or [1/K] where `of_pole`
    level: Array
    slope: Array
    least: Array  # value below which a straight line does not fall
    c00: Array  # covariance of (level, slope)
    c01: Array
    c11: Array

    def at(self, temperature_c: Any, ops: Any = np) -> tuple[Any, Any]:
        """Value and variance at temperatures (…, J) [°C]; of plain numbers with the functions of `ops`."""
        x = ops.where(self.of_pole, 1.0 / ops.maximum(temperature_c - self.pole_c, NEAREST_POLE_K), temperature_c) - self.origin
        value = self.level + self.slope * x
        var = ops.maximum(self.c00 + (2.0 * self.c01 + self.c11 * x) * x, 0.0)
        factor = ops.where(self.linear, 1.0, ops.exp(ops.minimum(ops.maximum(value, -LARGEST_LOG), LARGEST_LOG)))
        return ops.where(self.linear, ops.maximum(value, self.least), factor), var * factor * factor


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """The law chosen for each joint, (J,) each. `kind` is an index of LAWS; a joint of kind 0 uses its line."""

    kind: Annotated[Array, "J"]
    a: Annotated[Array, "J"]
    b: Annotated[Array, "J"]
    pole_c: Annotated[Array, "J"]
    reference_c: Annotated[Array, "J"]
    cov: Annotated[Array, "J 2 2"]  # of (a, b)
    held_out: Annotated[
        Array, "J 3"
    ]  # RMS error of each law on what was left out, in the value's unit; NaN before there is enough to choose

    def __post_init__(self) -> None:
        """Raises ValueError for a kind that is none, and where the law of a joint that is no line is unknown."""
        if not np.isin(self.kind, range(len(LAWS))).all():
            raise ValueError(f"kind is {self.kind.tolist()}; expected 0, 1 or 2 of every joint: {', '.join(LAWS)}")
        for name in ("a", "b", "pole_c", "reference_c"):
            if not np.isfinite(getattr(self, name)[self.kind > 0]).all():
                raise ValueError(f"{name} is unknown of a joint whose kind is not 0; expected numbers")

    @property
    def form(self) -> LawForm:
        """The curves as formulas; those of joints of kind 0 mean nothing."""
        of_pole = self.kind == VOGEL
        origin = np.where(of_pole, 1.0 / np.maximum(self.reference_c - self.pole_c, NEAREST_POLE_K), self.reference_c)
        linear = self.kind == 0
        covariance = self.cov[:, 0, 0], self.cov[:, 0, 1], self.cov[:, 1, 1]
        return LawForm(linear, of_pole, self.pole_c, origin, self.a, self.b, np.zeros_like(self.a), *covariance)


def no_bins(joints: int) -> Array:
    """(J, BINS, 3) empty bins, as before the first replay."""
    return np.zeros((joints, BINS, PER_BIN))


def update_bins(bins: Array, temperature_c: Array, value: Array) -> Array:
    """The bins after one more value of each joint, (J,) each. A joint with NaN in either keeps its bins."""
    seen = np.isfinite(temperature_c) & np.isfinite(value)
    n = np.flatnonzero(seen)
    at = np.clip((temperature_c[n] - COLDEST_C) // BIN_K, 0, BINS - 1).astype(int)
    more = bins.copy()
    more[n, at] += np.stack([np.ones(len(n)), temperature_c[n], value[n]], axis=1)
    return more


def choose_curve(bins: Array, reference_c: Array, scatter: Array) -> Curve:
    """The law of each joint with the least error on the parts of the range that were left out of its fit.

    bins : (J, BINS, 3); reference_c : (J,) T0; scatter : (J,) standard deviation of one value between replays, in the value's unit.
    """
    J = len(bins)
    bins = bins[:, np.any(bins[..., 0] > 0, axis=0)]  # (J, B, 3): most arms use a few of the fifty
    n = bins[..., 0]  # (J, B)
    filled = n > 0
    full = filled.sum(axis=1)  # (J,)
    T = np.divide(bins[..., 1], n, out=np.zeros_like(n), where=filled)
    v = np.divide(bins[..., 2], n, out=np.ones_like(n), where=filled)
    enough = np.all(v > 0, axis=1) & (full >= FEWEST_BINS) & (n.sum(axis=1) >= FEWEST_REPLAYS)
    if not enough.any():
        return _lines(reference_c)
    v = np.where(v > 0, v, 1.0)
    t = T - reference_c[:, None]
    poles = np.array(POLES_C)[:, None, None]
    x = np.concatenate([[t, t], _of_vogel(T, reference_c[:, None], poles)])  # (L, J, B): line, exponential, and Vogel's by pole
    y = np.concatenate([[v], np.broadcast_to(np.log(v), (len(x) - 1, *v.shape))])
    weight = np.concatenate([[n], np.broadcast_to(n * v**2, (len(x) - 1, *v.shape))])  # an error of log v is the error of v over v

    order = np.cumsum(filled, axis=1) - 1  # position of a filled bin among the filled ones
    part = (PARTS * order) // np.maximum(full, 1)[:, None]
    out = np.stack([part == k for k in range(PARTS)] + [np.zeros_like(filled)])[
        :, None
    ]  # (PARTS + 1, 1, J, B); the last one leaves out nothing
    a, b, cov = _fitted(x, y, np.where(out, 0.0, weight))  # (PARTS + 1, L, J)
    fits = _error(x, v, np.where(out, 0.0, n), a, b)
    left_out = _error(x, v, np.where(out, n, 0.0), a, b)[:PARTS]
    j, best = np.arange(J), 2 + np.argmin(fits[:, 2:], axis=1)  # the pole with the least error on what was fitted
    of_vogel = np.take_along_axis(left_out, best[:PARTS, None], axis=1)[:, 0]
    squares = np.stack([left_out[:, 0].sum(axis=0), left_out[:, 1].sum(axis=0), of_vogel.sum(axis=0)], axis=1)  # (J, 3)
    held_out = np.sqrt(squares / np.maximum(n.sum(axis=1), 1.0)[:, None])
    kind = np.where(enough, np.argmin(held_out * np.array([BETTER, 1.0, 1.0 / VOGEL_BETTER]), axis=1), 0)
    row = np.where(kind == VOGEL, best[PARTS], kind)
    # the standard deviation comes from the scatter, or from the misfit to the bins' means where that is larger
    misfit = np.sqrt(fits[PARTS, row, j] / np.maximum(full - 2.0, 1.0))
    curved = kind > 0
    return Curve(
        kind=kind.astype(float),
        a=np.where(curved, a[PARTS, row, j], 0.0),
        b=np.where(curved, b[PARTS, row, j], 0.0),
        pole_c=np.where(kind == VOGEL, np.array(POLES_C)[np.maximum(row - 2, 0)], 0.0),
        reference_c=reference_c,
        cov=np.where(curved[:, None, None], cov[PARTS, row, j] * np.maximum(scatter, misfit)[:, None, None] ** 2, 0.0),
        held_out=np.where(enough[:, None] & np.isfinite(held_out), held_out, np.nan),
    )


def _lines(reference_c: Array) -> Curve:
    """A Curve in which every joint keeps its line."""
    J = len(reference_c)
    zero = np.zeros(J)
    return Curve(zero, zero, zero, zero, reference_c, np.zeros((J, 2, 2)), np.full((J, len(LAWS)), np.nan))


def _of_vogel(T: Array, reference_c: Array, pole_c: Array) -> Array:
    """The regressor of Vogel's law, in which the logarithm is linear: 1/(T − Tv) − 1/(T0 − Tv)."""
    x: Array = 1.0 / np.maximum(T - pole_c, NEAREST_POLE_K) - 1.0 / np.maximum(reference_c - pole_c, NEAREST_POLE_K)
    return x


def _fitted(x: Array, y: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Weighted straight lines y = a + b·x along the last axis, and their covariance for a scatter of 1; NaN where they are undetermined."""
    S0, Sx, Sy = weight.sum(-1), (weight * x).sum(-1), (weight * y).sum(-1)
    Sxx, Sxy = (weight * x * x).sum(-1), (weight * x * y).sum(-1)
    det = S0 * Sxx - Sx**2
    with np.errstate(invalid="ignore", divide="ignore"):
        b = np.where(det > 1e-12 * S0 * Sxx, (S0 * Sxy - Sx * Sy) / det, np.nan)
        a = (Sy - b * Sx) / S0
        cov = np.stack([np.stack([Sxx, -Sx], -1), np.stack([-Sx, S0], -1)], -2) / det[..., None, None]
    return a, b, cov


def _error(x: Array, v: Array, n: Array, a: Array, b: Array) -> Array:
    """(…, L, J) Σ n·(v − law)² over bins; infinite where a law is undetermined."""
    eta = a[..., None] + b[..., None] * x
    eta[..., 1:, :, :] = np.exp(np.clip(eta[..., 1:, :, :], -LARGEST_LOG, LARGEST_LOG))
    squares: Array = np.where(n > 0, n * (v - eta) ** 2, 0.0).sum(-1)
    return np.where(np.isfinite(squares), squares, np.inf)
