"""Friction and heat of the worlds' joints: laws that neither the monitor nor its simulator uses.

τ_f = w_d·Fc·(1 + s·e^(−|q̇|/v_s))·(1 − κ(T − 25)) + w_v·Fv·g(T)·|q̇|^p   at q̇ > 0, T the temperature of the grease [°C],
g(T) = exp(B/(T − T_∞) − B/(25 − T_∞)): Vogel's law of viscosity (1921). The Stribeck effect decays exponentially and reaches into the
speeds of a replay. What `identify` would make of it is the straight line fc + fv·q̇ of least squares through the speeds of a replay.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.studies.rehearsal.worlds.noise import autoregressive

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
