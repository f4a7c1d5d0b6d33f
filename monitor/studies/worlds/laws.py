"""What differs from replay to replay and means nothing: laws of noise of log friction, each a function that draws (D, A, J)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy

from monitor.judge.drift.undeclared import MASS_PARAMETERS, RigidFit
from monitor.model.base import base_parameters
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, load_robot
from monitor.recording import Array

Shape = tuple[int, int, int]
"""D, A, J."""
Noise = Callable[[np.random.Generator, Shape], Array]
"""Draws (D, A, J) noise of log friction, or a standard deviation of it that broadcasts to that."""


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
    """First-order autoregression, Gaussian or with Student's shocks; a class, because an informed observer reads its σ and ρ."""

    std: float | tuple[float, float] = 0.02  # of all joints, or the ends of a log-uniform distribution over joints
    rho: float | tuple[float, float] = 0.5  # likewise, or the ends of a uniform one
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


def power_law(*, std: float = 0.02, exponent: float = 1.0, over_days: float = 1095.0) -> Noise:
    """Noise whose spectrum falls like f^−exponent; `std` is its expected standard deviation about its mean over `over_days`."""

    def draw(rng: np.random.Generator, shape: Shape) -> Array:
        length = scipy.fft.next_fast_len(int(4 * max(shape[0], over_days)))  # its period is far from what is used
        f = scipy.fft.rfftfreq(length)[1:]
        power = f**-exponent
        inside = np.sum(power * (1.0 - np.sinc(f * over_days) ** 2))  # of the variance, what is not the mean over the span
        amplitude = np.sqrt(power / inside) * std * length / 2.0
        spectrum = np.zeros((len(f) + 1, *shape[1:]), dtype=complex)
        spectrum[1:] = amplitude[:, None, None] * (rng.normal(size=(len(f), *shape[1:])) + 1j * rng.normal(size=(len(f), *shape[1:])))
        result: Array = scipy.fft.irfft(spectrum, length, axis=0)[: shape[0]]
        return result

    return draw


def modulated(std: Noise, *, rho: float = 0.5) -> Noise:
    """Noise of unit size under a standard deviation that changes with time."""
    return lambda rng, shape: std(rng, shape) * autoregressive(rng.normal(size=shape), rho)


def seasonal_std(winter: float, summer: float) -> Noise:
    """A standard deviation that swings between winter and summer; the arms begin at any time of the year."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        t = np.arange(shape[0])[:, None] - rng.uniform(0.0, 365.0, shape[1])
        result: Array = (0.5 * (winter + summer) + 0.5 * (winter - summer) * np.cos(2.0 * np.pi * t / 365.0))[..., None]
        return result

    return std


def stepping_std(low: float, high: float, mean_days: float) -> Noise:
    """A standard deviation that jumps between two values, each kept for an exponentially distributed time, arm by arm."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        jumps = (rng.random(shape[:2]) < 1.0 / mean_days).cumsum(axis=0) + rng.integers(0, 2, shape[1])
        result: Array = np.where(jumps % 2 == 0, low, high)[..., None]
        return result

    return std


def swelling_std(mean: float, memory_days: float, spread: float) -> Noise:
    """A standard deviation of each joint whose logarithm walks about a mean, forgotten within `memory_days`; `spread` is the walk's."""

    def std(rng: np.random.Generator, shape: Shape) -> Array:
        size = np.exp(spread * autoregressive(rng.normal(size=shape), float(np.exp(-1.0 / memory_days))) - spread**2)
        result: Array = mean * size  # its mean square is mean²
        return result

    return std


def together(*laws: Noise) -> Noise:
    """Several independent laws at once."""

    def draw(rng: np.random.Generator, shape: Shape) -> Array:
        total = np.zeros(shape)
        for law in laws:
            total += law(rng, shape)
        return total

    return draw


# --- What happens to healthy joints over the years: changes of friction that are no wear, each a function that draws its factors ---

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


Change = Callable[[np.random.Generator, Shape], Factors]
"""A change of healthy joints: the logarithms of the factors that it causes. Days are drawn for each arm."""


def days_of(shape: Shape) -> Array:
    """(D, 1, 1) days since the first replay."""
    return np.arange(float(shape[0]))[:, None, None]


def running_in(*, fall: tuple[float, float] = (0.05, 0.10), time_constant_days: tuple[float, float] = (20.0, 60.0)) -> Change:
    """Friction falls by a share that differs from joint to joint, within a few months; dry and viscous friction alike."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        share, tau = rng.uniform(*fall, shape[1:]), rng.uniform(*time_constant_days, (shape[1], 1))
        log = np.log1p(-share * (1.0 - np.exp(-days_of(shape) / tau)))
        return Factors(log, log)

    return draw


def yearly(*, amplitude: float = 0.02, common: bool = True) -> Change:
    """A year's swing that is not temperature, as of humidity or supply: common to an arm's joints or of each joint.

    It has a half-year's harmonic of a fifth of its size, and another size each year.
    """

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        of = (shape[1], 1) if common else shape[1:]
        t = (days_of(shape) / DAYS_A_YEAR + rng.uniform(0.0, 1.0, of)) * 2.0 * np.pi
        swing = np.cos(t) + 0.2 * np.cos(2.0 * t + rng.uniform(0.0, 2.0 * np.pi, of))
        log = amplitude * np.exp(0.15 * rng.normal(size=of)) * swing
        return Factors(log, log)

    return draw


def wandering(
    *, std: float = 0.02, memory_days: float = 120.0, common: bool = True, dry: float = 1.0, viscous: float = 1.0, residual: float = 0.0
) -> Change:
    """A slow walk about a mean, forgotten within `memory_days`. dry, viscous, residual : multiples of the walk."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        of = (shape[1], 1) if common else shape[1:]
        log = std * autoregressive(rng.normal(size=(shape[0], *of)), float(np.exp(-1.0 / memory_days)))
        log = log - log[0]
        return Factors(dry * log, viscous * log, residual=residual * log)

    return draw


def gain(*, factor: float = 1.03, days: tuple[float, float] = (90.0, 500.0)) -> Change:
    """Another scale of current, as after an update of the firmware that nobody declared: all joints at once, for good."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        return Factors(gain=np.where(days_of(shape) >= rng.uniform(*days, (shape[1], 1)), np.log(factor), 0.0))

    return draw


def level_jumps(*, std: float = 0.02, a_year: float = 3.0, common: bool = True) -> Change:
    """Friction jumps by a normal size and stays there until the next jump, some times a year: of all joints at once, or of each."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        of = (shape[0], shape[1], 1 if common else shape[2])
        log: Array = std * np.cumsum(np.where(rng.random(of) < a_year / DAYS_A_YEAR, rng.normal(size=of), 0.0), axis=0)
        return Factors(log, log)

    return draw


def telegraph(*, apart: float = 0.03, mean_days: float = 20.0) -> Change:
    """Friction of each joint goes back and forth between two levels, each kept for an exponentially distributed time."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        jumps = (rng.random(shape) < 1.0 / mean_days).cumsum(axis=0) + rng.integers(0, 2, shape[1:])
        log = np.asarray(apart * ((jumps % 2) - 0.5), dtype=float)
        return Factors(log, log)

    return draw


def bad_days(*, share: tuple[float, float] = (0.05, 0.40), days: tuple[int, int] = (2, 5), a_year: float = 1.0) -> Change:
    """On some days in a row one joint of an arm shows a friction that is far off, down or up, each day by another share; then as before."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        log = np.zeros(shape)
        for day, arm in zip(*np.nonzero(rng.random(shape[:2]) < a_year / DAYS_A_YEAR), strict=True):
            last = min(day + int(rng.integers(days[0], days[1] + 1)), shape[0])
            off = rng.choice([-1.0, 1.0]) * rng.uniform(*share, last - day)
            log[day:last, arm, rng.integers(shape[2])] = np.log1p(off)
        return Factors(log, log)

    return draw


def sawtooth(*, swing: float = 0.04, falls_share: float = 0.12) -> Change:
    """A year's cycle that is no sine: friction of all joints rises for most of the year, as humidity does, and falls within weeks.

    swing : from the lowest to the highest. falls_share : of the year. Years begin on any day.
    """

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        year = (days_of(shape) / DAYS_A_YEAR + rng.uniform(0.0, 1.0, (shape[1], 1))) % 1.0
        rises = 1.0 - falls_share
        log: Array = swing * np.where(year < rises, year / rises, (1.0 - year) / falls_share)
        return Factors(log, log)

    return draw


def sensor_shift(*, kelvin: float = 2.0, days: tuple[float, float] = (90.0, 500.0)) -> Change:
    """The temperature sensor of one joint of each arm reads too much from a day on; friction is as before."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        joint, start = rng.integers(0, shape[2], shape[1]), rng.uniform(*days, (shape[1], 1))
        here = np.arange(shape[2]) == joint[:, None]
        return Factors(sensor_k=np.where((days_of(shape) >= start) & here, kelvin, 0.0))

    return draw


def sensor_silence(*, weeks: tuple[float, float] = (4.0, 12.0), times: int = 3) -> Change:
    """The temperature of one joint of each arm is unknown for weeks, once or several times: a broken wire, and the wait for the part."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        arms, t = shape[1], days_of(shape)
        here = np.arange(shape[2]) == rng.integers(0, shape[2], arms)[:, None]
        silent = np.zeros((shape[0], arms, 1), dtype=bool)
        for _ in range(times):
            start = rng.uniform(60.0, max(shape[0] - 60.0, 61.0), (arms, 1))
            silent |= (t >= start) & (t < start + 7.0 * rng.uniform(*weeks, (arms, 1)))
        return Factors(sensor_k=np.where(silent & here, np.nan, 0.0))

    return draw


def payload(
    *,
    mass_kg: float = 0.3,
    rise: tuple[float, ...] = (0.001, 0.014, 0.012, 0.005, 0.003, 0.0005),
    days: tuple[float, float] = (90.0, 500.0),
    kept_days: float = np.inf,
    declared_after_days: tuple[float, float] = (5.0, 30.0),
) -> Change:
    """An undeclared payload: what the gears carry rises, and dry friction with it; most at shoulder and elbow.

    A person declares it some days or weeks later; nobody does where it is kept for a while only. rise : of friction at the reference
    speed, by joint.
    """

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        start, t = rng.uniform(*days, (shape[1], 1)), days_of(shape)
        rises = np.array(rise) * rng.uniform(0.7, 1.3, (shape[1], 1))  # arms hold it at other reaches
        dry = np.log1p(2.0 * rises)  # dry friction is about half of it
        carried = (t >= start) & (t < start + kept_days)
        declared = t >= start + rng.uniform(*declared_after_days, (shape[1], 1))
        return Factors(
            dry=np.where(carried, dry, 0.0),
            undeclared_kg=np.where(carried, mass_kg, 0.0),
            declared=np.where(declared & np.isinf(kept_days), 1.0, 0.0),
        )

    return draw


def regrease(*, fall: float = 0.10, days: tuple[float, float] = (100.0, 200.0), creep: float = 0.0, creep_days: float = 40.0) -> Change:
    """Undeclared new grease in all joints: friction falls at once, and creeps back by the share `creep` of that."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        since = days_of(shape) - rng.uniform(*days, (shape[1], 1))
        back = 1.0 - creep * (1.0 - np.exp(-np.maximum(since, 0.0) / creep_days))
        log = np.where(since >= 0.0, np.log1p(-fall) * back, 0.0)
        return Factors(log, log)

    return draw


def weekday(*, std: float = 0.02) -> Change:
    """Friction is another on Mondays, and half of it on Tuesdays, as after idle weekends, by a size drawn for each joint."""

    def draw(rng: np.random.Generator, shape: Shape) -> Factors:
        day = days_of(shape) % 7
        log = std * rng.normal(size=shape[1:]) * (1.0 * (day == 0) + 0.5 * (day == 1))
        return Factors(log, log)

    return draw


# --- Wear that is put into joints of a world, from its onset on -----------------------------------------

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


# --- Friction and heat of the worlds' joints: laws that neither the monitor nor its simulator uses ------

REFERENCE_RAD_S = 0.4  # the friction torque at this speed is what the judge follows
SIZE_NM = np.array([11.0, 14.0, 9.0, 2.3, 2.0, 2.2])  # friction of the six joints at 0.4 rad/s and 25 °C, as a UR5's
VOGEL_C = -110.0  # T_∞ of the grease
REPLAY_SPEEDS_RAD_S = 1.5 * np.sin(np.linspace(0.05, 1.52, 24))  # a joint that swings: most samples are fast
WEATHER_RHO = 0.75  # from day to day
SENSOR_STEP_K = 1.0 / 16.0  # resolution of the temperature sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Friction:
    """The parameters of the law, (A, J) each."""

    dry_nm: Array  # Fc
    stribeck: Array  # s
    stribeck_rad_s: Array  # v_s
    dry_per_k: Array  # κ [1/K]
    viscous_nm: Array  # Fv, at 1 rad/s
    vogel_k: Array  # B
    exponent: Array  # p

    @classmethod
    def drawn(cls, rng: np.random.Generator, arms: int) -> "Friction":
        """Arms that differ as arms of one model do."""
        shape = (arms, len(SIZE_NM))
        size = SIZE_NM * np.exp(0.15 * rng.normal(size=shape))
        share = rng.uniform(0.48, 0.58, shape)  # viscous, of the torque at the reference speed
        exponent, per_k = rng.uniform(0.50, 0.75, shape), rng.uniform(0.010, 0.022, shape)
        return cls(
            dry_nm=size * (1.0 - share),
            stribeck=rng.uniform(0.05, 0.20, shape),
            stribeck_rad_s=rng.uniform(0.03, 0.12, shape),
            dry_per_k=rng.uniform(0.0, 0.002, shape),
            viscous_nm=size * share / REFERENCE_RAD_S**exponent,
            vogel_k=per_k * (25.0 - VOGEL_C) ** 2,  # d log g / dT at 25 °C is −B/(25 − T_∞)²
            exponent=exponent,
        )

    def parts(self, speed: Array | float, grease_c: Array) -> tuple[Array, Array]:
        """(…, A, J) dry and viscous friction torque without wear [N·m], at a speed > 0."""
        dry = self.dry_nm * (1.0 + self.stribeck * np.exp(-speed / self.stribeck_rad_s)) * (1.0 - self.dry_per_k * (grease_c - 25.0))
        thin = np.exp(self.vogel_k / (grease_c - VOGEL_C) - self.vogel_k / (25.0 - VOGEL_C))
        return dry, self.viscous_nm * thin * speed**self.exponent

    def torque(self, speed: float, grease_c: Array, dry: Array | float = 1.0, viscous: Array | float = 1.0) -> Array:
        """(…, A, J) friction torque [N·m] under factors of dry and viscous friction."""
        own = self.parts(speed, grease_c)
        result: Array = dry * own[0] + viscous * own[1]
        return result

    def line(self, grease_c: Array, dry: Array | float, viscous: Array | float) -> tuple[Array, Array]:
        """Intercept fc [N·m] and slope fv [N·m·s/rad] of the least-squares line through the speeds of a replay, (…, A, J) each."""
        v = REPLAY_SPEEDS_RAD_S - REPLAY_SPEEDS_RAD_S.mean()
        slope = np.zeros(np.broadcast_shapes(grease_c.shape, np.shape(dry)))
        mean = slope.copy()
        for speed, weight in zip(REPLAY_SPEEDS_RAD_S, v / np.sum(v * v), strict=True):
            at = self.torque(float(speed), grease_c, dry, viscous)
            slope, mean = slope + weight * at, mean + at / len(v)
        return mean - slope * REPLAY_SPEEDS_RAD_S.mean(), slope


class Temperatures(NamedTuple):
    """Temperatures at the replays, (R, A, J) each."""

    grease_c: Array
    motor_c: Array
    warming_k_per_min: Array  # of the motor


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat:
    """The room's seasons, and the hour before the replay: the motor warms like 1 − e^(−t/τ), the grease follows with a lag.

    The defaults are a heated hall and a replay at the same time of every morning.
    """

    season_k: float = 4.0  # amplitude of the year in the room
    sharpness: float = 0.0  # of the seasons: 0 a sine, 3 half a year each with some weeks between
    coldest_day: float | None = None  # of the first year; None: arms begin at any time of the year
    weather_k: float = 1.2  # standard deviation of the daily weather, correlated over about four days
    lag_min: tuple[float, float] = (3.0, 6.0)  # of the grease behind the motor, drawn for each joint
    started_min: tuple[float, float] = (35.0, 45.0)  # the replay comes so long after the arm's start
    warm_up_k: tuple[float, float] = (4.0, 10.0)  # steady rise by the work before the replay, drawn for each day
    warm_up_min: float = 40.0  # τ of the motor

    def at_replays(self, rng: np.random.Generator, shape: tuple[int, int, int], replays_a_day: int = 1) -> Temperatures:
        """The temperatures (R, A, J) at all replays."""
        replays, arms, joints = shape
        t = np.arange(replays)[:, None] / replays_a_day
        phase = rng.uniform(0.0, 365.0, arms) if self.coldest_day is None else np.full(arms, self.coldest_day)
        weather = autoregressive(rng.normal(size=(replays, arms)), WEATHER_RHO ** (1.0 / replays_a_day))
        season = np.cos(2.0 * np.pi * (t - phase) / 365.0)
        if self.sharpness > 0:
            season = np.tanh(self.sharpness * season) / np.tanh(self.sharpness)
        room = rng.uniform(18.0, 24.0, arms) - self.season_k * season + self.weather_k * weather
        monday = np.where(np.floor(t) % 7 == 0, -2.0, 0.0)
        base = (room + monday)[..., None] + 3.0 + rng.normal(size=(arms, joints))
        since = rng.uniform(*self.started_min, (replays, arms))[..., None]
        rise = rng.uniform(*self.warm_up_k, (replays, arms))[..., None] * rng.uniform(0.7, 1.3, (arms, joints))
        tau, lag = self.warm_up_min, rng.uniform(*self.lag_min, (arms, joints))
        left = np.exp(-since / tau)
        # lag·Ṫ_g = T_m − T_g from equal temperatures at the start
        grease = base + rise * (1.0 - (tau * left - lag * np.exp(-since / lag)) / (tau - lag))
        return Temperatures(grease, base + rise * (1.0 - left), rise / tau * left)


# --- The weights that every replay identifies beside friction, where an arm carries more than anybody declared ---

STD = np.array([
    0.039, 0.22, 0.054, 0.005, 0.067, 0.032, 0.011, 0.015, 0.13, 0.045, 0.0035, 0.034,
    0.031, 0.012, 0.014, 0.0054, 0.0015, 0.013, 0.0054, 0.0055, 0.0094, 0.0062, 0.0019, 0.00097,
    0.0045, 0.0019, 0.0018, 0.004, 0.0031, 0.0012, 0.00096, 0.002, 0.0011, 0.0012, 0.0014, 0.0025,
])  # fmt: skip
"""[kg, kg·m, kg·m²] of a UR5's 36 rigid base parameters on the ground."""
MAGNETS_PER_K = 0.001  # by which all weights seem lighter in a warmer motor
CENTRE_M = (0.0, 0.0, 0.05)  # of the mass, from the last joint's frame …
CENTRE_STD_M = 0.03  # … and how it differs from arm to arm


class Weights:
    """Rigid base parameters of every arm and replay; they are drawn as the replays come."""

    def __init__(self, rng: np.random.Generator, carried_kg: Array, motor_c: Array) -> None:
        """carried_kg : (R, A) beyond what is declared at first, motor_c : (R, A, J)."""
        self._columns, self._names, self._of_mass, nominal = _arm()
        self._values = nominal * (1.0 + 0.03 * rng.normal(size=(carried_kg.shape[1], len(nominal))))  # (A, R)
        centre_m = np.array(CENTRE_M) + CENTRE_STD_M * rng.normal(size=(carried_kg.shape[1], 3))
        self._load = np.concatenate([np.ones((len(centre_m), 1)), centre_m], axis=1) @ self._of_mass.T  # (A, R) of one kilogram
        self._carried_kg = carried_kg
        self._scale = np.exp(-MAGNETS_PER_K * (motor_c.mean(axis=2) - 25.0))
        self._seed = int(rng.integers(2**31))

    def fits(self, number: int) -> tuple[RigidFit, ...]:
        """What the replays of that number identify, of each arm."""
        true = (self._values + self._carried_kg[number][:, None] * self._load) * self._scale[number][:, None]
        seen = true + STD * np.random.default_rng((self._seed, number)).normal(size=true.shape)
        return tuple(RigidFit(self._columns, self._names, values, np.diag(STD**2), self._of_mass) for values in seen)


@cache
def _arm() -> tuple[Array, tuple[str, ...], Array, Array]:
    """Columns and names of a UR5's rigid base parameters, what a mass at the flange adds to them, and the manufacturer's values."""
    robot = load_robot("ur5")
    base = base_parameters(robot, Mounting())
    rigid = np.array(base.columns) % PER_JOINT < INERTIAL
    last = PER_JOINT * (robot.joints - 1)
    names = tuple(np.array(base.names)[rigid].tolist())
    values = (base.combination @ robot.nominal_parameters())[rigid]
    return np.array(base.columns, dtype=float)[rigid], names, base.combination[rigid][:, last : last + MASS_PARAMETERS], values
