"""What happens to healthy joints over the years: changes of friction that are no wear, each a value that draws its factors."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from monitor.recording import Array
from monitor.studies.rehearsal.worlds.noise import Shape, autoregressive

DAYS_A_YEAR = 365.0


class Factors(NamedTuple):
    """Logarithms of factors, each (D, A, J) or what broadcasts to it, and what an arm carries."""

    dry: Array | float = 0.0  # of dry friction
    viscous: Array | float = 0.0  # of viscous friction
    gain: Array | float = 0.0  # of what the firmware reports as torque
    residual: Array | float = 0.0  # of the RMS that the fit leaves
    sensor_k: Array | float = 0.0  # no factor: what a temperature sensor reads too much
    undeclared_kg: Array | float = 0.0  # no factor: a mass at the flange beyond what was declared at first, (D, A, 1) …
    declared: Array | float = 0.0  # … and 1 from the day on which a person declares it


class Change(Protocol):
    """A change of healthy joints."""

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The logarithms of the factors it causes."""
        ...


def days_of(shape: Shape) -> Array:
    """(D, 1, 1) days since the first replay."""
    return np.arange(float(shape[0]))[:, None, None]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningIn:
    """Friction falls by a share that differs from joint to joint, within a few months."""

    fall: tuple[float, float] = (0.05, 0.10)
    time_constant_days: tuple[float, float] = (20.0, 60.0)

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Dry and viscous friction fall alike."""
        fall, tau = rng.uniform(*self.fall, shape[1:]), rng.uniform(*self.time_constant_days, (shape[1], 1))
        log = np.log1p(-fall * (1.0 - np.exp(-days_of(shape) / tau)))
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Yearly:
    """A year's swing that is not temperature, as of humidity or supply: common to an arm's joints or of each joint."""

    amplitude: float = 0.02
    common: bool = True

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """A year's swing with a half-year's harmonic of a fifth of its size, and another size each year."""
        of = (shape[1], 1) if self.common else shape[1:]
        t = (days_of(shape) / DAYS_A_YEAR + rng.uniform(0.0, 1.0, of)) * 2.0 * np.pi
        swing = np.cos(t) + 0.2 * np.cos(2.0 * t + rng.uniform(0.0, 2.0 * np.pi, of))
        log = self.amplitude * np.exp(0.15 * rng.normal(size=of)) * swing
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wandering:
    """A slow walk about a mean: standard deviation `std`, forgotten within `memory_days`."""

    std: float = 0.02
    memory_days: float = 120.0
    common: bool = True
    dry: float = 1.0  # times the walk: dry friction, viscous friction, what the fit leaves
    viscous: float = 1.0
    residual: float = 0.0

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The walk since the first day."""
        of = (shape[1], 1) if self.common else shape[1:]
        log = self.std * autoregressive(rng.normal(size=(shape[0], *of)), float(np.exp(-1.0 / self.memory_days)))
        log = log - log[0]
        return Factors(self.dry * log, self.viscous * log, residual=self.residual * log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gain:
    """Another scale of current, as after an update of the firmware that nobody declared: all joints at once, for good."""

    factor: float = 1.03
    days: tuple[float, float] = (90.0, 500.0)

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The scale of torque, from a day drawn for each arm."""
        return Factors(gain=np.where(days_of(shape) >= rng.uniform(*self.days, (shape[1], 1)), np.log(self.factor), 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelJumps:
    """Friction jumps by a normal size and stays there until the next jump, some times a year: of all joints at once, or of each."""

    std: float = 0.02
    a_year: float = 3.0
    common: bool = True

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The sum of all jumps so far."""
        of = (shape[0], shape[1], 1 if self.common else shape[2])
        log: Array = self.std * np.cumsum(np.where(rng.random(of) < self.a_year / DAYS_A_YEAR, rng.normal(size=of), 0.0), axis=0)
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Telegraph:
    """Friction of each joint goes back and forth between two levels, each kept for an exponentially distributed time."""

    apart: float = 0.03
    mean_days: float = 20.0

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The level in force; arms begin at either."""
        jumps = (rng.random(shape) < 1.0 / self.mean_days).cumsum(axis=0) + rng.integers(0, 2, shape[1:])
        log = np.asarray(self.apart * ((jumps % 2) - 0.5), dtype=float)
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class BadDays:
    """On some days in a row one joint of an arm shows a friction that is far off, down or up, each day by another share; then as before."""

    share: tuple[float, float] = (0.05, 0.40)
    days: tuple[int, int] = (2, 5)
    a_year: float = 1.0

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Spells begin on any day, in any joint."""
        log = np.zeros(shape)
        for day, arm in zip(*np.nonzero(rng.random(shape[:2]) < self.a_year / DAYS_A_YEAR), strict=True):
            last = min(day + int(rng.integers(self.days[0], self.days[1] + 1)), shape[0])
            off = rng.choice([-1.0, 1.0]) * rng.uniform(*self.share, last - day)
            log[day:last, arm, rng.integers(shape[2])] = np.log1p(off)
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sawtooth:
    """A year's cycle that is no sine: friction of all joints rises for most of the year, as humidity does, and falls within weeks."""

    swing: float = 0.04  # from the lowest to the highest
    falls_share: float = 0.12  # of the year

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Years begin on any day."""
        year = (days_of(shape) / DAYS_A_YEAR + rng.uniform(0.0, 1.0, (shape[1], 1))) % 1.0
        rises = 1.0 - self.falls_share
        log: Array = self.swing * np.where(year < rises, year / rises, (1.0 - year) / self.falls_share)
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorShift:
    """The temperature sensor of one joint of each arm reads too much from a day on."""

    kelvin: float = 2.0
    days: tuple[float, float] = (90.0, 500.0)

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """The error, from a day drawn for each arm; friction is as before."""
        joint, start = rng.integers(0, shape[2], shape[1]), rng.uniform(*self.days, (shape[1], 1))
        here = np.arange(shape[2]) == joint[:, None]
        return Factors(sensor_k=np.where((days_of(shape) >= start) & here, self.kelvin, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSilence:
    """The temperature of one joint of each arm is unknown for weeks, once or several times: a broken wire, and the wait for the part."""

    weeks: tuple[float, float] = (4.0, 12.0)
    times: int = 3

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Where it is unknown, the sensor's error is; friction is as before."""
        arms, t = shape[1], days_of(shape)
        here = np.arange(shape[2]) == rng.integers(0, shape[2], arms)[:, None]
        silent = np.zeros((shape[0], arms, 1), dtype=bool)
        for _ in range(self.times):
            start = rng.uniform(60.0, max(shape[0] - 60.0, 61.0), (arms, 1))
            silent |= (t >= start) & (t < start + 7.0 * rng.uniform(*self.weeks, (arms, 1)))
        return Factors(sensor_k=np.where(silent & here, np.nan, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Payload:
    """An undeclared payload, by default of 0.3 kg: what the gears carry rises, and dry friction with it; most at shoulder and elbow.

    A person declares it some days or weeks later; nobody does where it is kept for a while only.
    """

    mass_kg: float = 0.3
    rise: tuple[float, ...] = (0.001, 0.014, 0.012, 0.005, 0.003, 0.0005)  # of friction at the reference speed, by joint
    days: tuple[float, float] = (90.0, 500.0)
    kept_days: float = np.inf
    declared_after_days: tuple[float, float] = (5.0, 30.0)

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Dry friction and what the arm carries, from a day drawn for each arm; arms hold it at other reaches."""
        start, t = rng.uniform(*self.days, (shape[1], 1)), days_of(shape)
        rise = np.array(self.rise) * rng.uniform(0.7, 1.3, (shape[1], 1))
        dry = np.log1p(2.0 * rise)  # dry friction is about half of it
        carried = (t >= start) & (t < start + self.kept_days)
        declared = t >= start + rng.uniform(*self.declared_after_days, (shape[1], 1))
        return Factors(
            dry=np.where(carried, dry, 0.0),
            undeclared_kg=np.where(carried, self.mass_kg, 0.0),
            declared=np.where(declared & np.isinf(self.kept_days), 1.0, 0.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Regrease:
    """Undeclared new grease in all joints: friction falls at once, and creeps back by a share of that."""

    fall: float = 0.10
    days: tuple[float, float] = (100.0, 200.0)
    creep: float = 0.0  # share of the fall that is lost again
    creep_days: float = 40.0

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Dry and viscous friction alike, from a day drawn for each arm."""
        since = days_of(shape) - rng.uniform(*self.days, (shape[1], 1))
        back = 1.0 - self.creep * (1.0 - np.exp(-np.maximum(since, 0.0) / self.creep_days))
        log = np.where(since >= 0.0, np.log1p(-self.fall) * back, 0.0)
        return Factors(log, log)


@dataclass(frozen=True, slots=True, kw_only=True)
class Weekday:
    """Friction is another on some days of the week, as after idle weekends, by a size drawn for each joint."""

    std: float = 0.02

    def __call__(self, rng: np.random.Generator, shape: Shape) -> Factors:
        """Mondays, and half of it on Tuesdays."""
        day = days_of(shape) % 7
        log = self.std * rng.normal(size=shape[1:]) * (1.0 * (day == 0) + 0.5 * (day == 1))
        return Factors(log, log)
