"""What differs from replay to replay and means nothing: laws of noise of log friction, each a value that draws (D, A, J)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from monitor.recording import Array

Shape = tuple[int, int, int]
"""D, A, J."""


class Noise(Protocol):
    """A law of noise."""

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Array:
        """(D, A, J) noise of log friction."""
        ...


def autoregressive(shocks: Array, rho: float | Array) -> Array:
    """x_d = ρ·x_(d−1) + √(1 − ρ²)·e_d along the first axis, stationary from the first day; unit shocks give unit variance."""
    driven = np.sqrt(1.0 - np.square(rho)) * shocks
    driven[0] = shocks[0]
    if isinstance(rho, float):
        result: Array = scipy.signal.lfilter([1.0], [1.0, -rho], driven, axis=0)
        return result
    for day in range(1, len(driven)):
        driven[day] += rho * driven[day - 1]
    return driven


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlated:
    """First-order autoregression, Gaussian or with Student's shocks; σ and ρ are one for all joints or differ from joint to joint."""

    std: float | tuple[float, float] = 0.02  # or the ends of a log-uniform distribution over joints
    rho: float | tuple[float, float] = 0.5  # or the ends of a uniform one
    common: bool = False  # to the joints of an arm
    degrees: float | None = None  # of freedom of Student's t, scaled to the same variance; None: Gaussian

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Array:
        """(D, A, J) noise of log friction."""
        low, high = self.std if isinstance(self.std, tuple) else (self.std, self.std)
        shape = (*shape[:2], 1) if self.common else shape
        std = np.exp(rng.uniform(np.log(low), np.log(high), shape[1:]))
        rho = rng.uniform(*self.rho, shape[1:]) if isinstance(self.rho, tuple) else self.rho
        if self.degrees is None:
            shocks = rng.normal(size=shape)
        else:
            shocks = rng.standard_t(self.degrees, size=shape) * np.sqrt((self.degrees - 2.0) / self.degrees)
        return std * autoregressive(shocks, rho)


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerLaw:
    """Noise whose spectrum falls like f^−exponent; `std` is its expected standard deviation about its mean over `over_days`."""

    std: float = 0.02
    exponent: float = 1.0
    over_days: float = 1095.0

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Array:
        """(D, A, J) noise of log friction."""
        length = scipy.fft.next_fast_len(int(4 * max(shape[0], self.over_days)))  # its period is far from what is used
        f = scipy.fft.rfftfreq(length)[1:]
        power = f**-self.exponent
        inside = np.sum(power * (1.0 - np.sinc(f * self.over_days) ** 2))  # of the variance, what is not the mean over the span
        amplitude = np.sqrt(power / inside) * self.std * length / 2.0
        spectrum = np.zeros((len(f) + 1, *shape[1:]), dtype=complex)
        spectrum[1:] = amplitude[:, None, None] * (rng.normal(size=(len(f), *shape[1:])) + 1j * rng.normal(size=(len(f), *shape[1:])))
        result: Array = scipy.fft.irfft(spectrum, length, axis=0)[: shape[0]]
        return result


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulated:
    """Another law of unit size under a standard deviation that changes with time: `std` gives (D, A, J) or what broadcasts to it."""

    std: Callable[[np.random.Generator, Shape], Array]
    rho: float = 0.5

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Array:
        """(D, A, J) noise of log friction."""
        return self.std(rng, shape) * autoregressive(rng.normal(size=shape), self.rho)


def seasonal_std(winter: float, summer: float) -> Callable[[np.random.Generator, Shape], Array]:
    """A standard deviation that swings between winter and summer; the arms begin at any time of the year."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        t = np.arange(shape[0])[:, None] - rng.uniform(0.0, 365.0, shape[1])
        result: Array = (0.5 * (winter + summer) + 0.5 * (winter - summer) * np.cos(2.0 * np.pi * t / 365.0))[..., None]
        return result

    return std


def stepping_std(low: float, high: float, mean_days: float) -> Callable[[np.random.Generator, Shape], Array]:
    """A standard deviation that jumps between two values, each kept for an exponentially distributed time, arm by arm."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        jumps = (rng.random(shape[:2]) < 1.0 / mean_days).cumsum(axis=0) + rng.integers(0, 2, shape[1])
        result: Array = np.where(jumps % 2 == 0, low, high)[..., None]
        return result

    return std


def swelling_std(mean: float, memory_days: float, spread: float) -> Callable[[np.random.Generator, Shape], Array]:
    """A standard deviation of each joint whose logarithm walks about a mean, forgotten within `memory_days`; `spread` is the walk's."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        size = np.exp(spread * autoregressive(rng.normal(size=shape), float(np.exp(-1.0 / memory_days))) - spread**2)
        result: Array = mean * size  # its mean square is mean²
        return result

    return std


@dataclass(frozen=True, slots=True, kw_only=True)
class Sum:
    """Several independent laws at once."""

    laws: tuple[Noise, ...]

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Array:
        """(D, A, J) noise of log friction."""
        total = np.zeros(shape)
        for law in self.laws:
            total += law(rng, shape)
        return total
