"""A world as a value, and a fleet that lives in it: years of daily replays as arrays, from a seed."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from monitor.judge.friction.observation import FAST_RAD_S, SLOW_RAD_S, Observation
from monitor.recording import Array
from monitor.studies.rehearsal.fleet import Day
from monitor.studies.worlds.laws import (
    DAYS_A_YEAR,
    RATE_10,
    REFERENCE_RAD_S,
    SENSOR_STEP_K,
    SIZE_NM,
    STEP_5,
    Change,
    Correlated,
    Factors,
    Friction,
    Heat,
    Noise,
    Shape,
    Temperatures,
    Wear,
    Weights,
    autoregressive,
)

JOINTS = len(SIZE_NM)
WITHIN_STD = 0.003, 0.008  # of log F within a replay, drawn for each
SHARE_STD, SHARE_RHO = (0.03, 0.08), 0.5  # of log fv between replays at the same F: one fit cannot part the two well; drawn for each joint
SPEED_STD = 0.004  # of log F at the slow and the fast speed, beside what follows from F at the reference speed and from fv
MISFIT, FLOOR = 0.06, 0.02  # what the fit leaves: of viscous friction, whose curve it misses, and of the joint's size
RESIDUAL_STD, RESIDUAL_RHO = 0.08, 0.5  # of the logarithm of what it leaves


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """What the judge should reach in a world."""

    false: float = 0.1  # false advisories a robot-year of healthy arms, of the kinds that are counted …
    counted: tuple[str, ...] = ("rising", "falling", "common")  # … others are the right word for what happens there
    within_days: tuple[tuple[str, float], ...] = ()  # of wear, by name: the median of days to detection
    nine_of_ten_days: tuple[tuple[str, float], ...] = ()  # likewise, nine of ten arms
    interval: tuple[float, float] | None = None  # share of 90 % intervals of healthy joints that hold the truth


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """What differs from replay to replay, what happens to healthy joints, and which wear is to be found."""

    name: str
    sentence: str
    noise: Noise = field(default_factory=Correlated)
    changes: tuple[Change, ...] = ()
    heat: Heat = field(default_factory=Heat)
    wear: tuple[Wear, ...] = (STEP_5, RATE_10)
    replays_a_day: int = 1
    missed: float = 0.01  # share of mornings without a replay
    gap: tuple[float, int] = (0.0, 0)  # gaps a year and arm, and their length [days]
    channels: bool = True  # whether the optional fields of `Observation` are given
    goal: Goal = field(default_factory=Goal)
    listed: bool = True  # whether goals were set for it before anybody had played it


class WorldFleet:
    """Arms of one world: first the healthy ones, then a group for each kind of wear. It has what `judged_days` asks of a fleet."""

    def __init__(self, world: World, *, healthy: int, worn: int, days: int, seed: int) -> None:
        """Every random number comes from the seed; what one kind of law draws does not depend on the others.

        healthy : arms without wear, worn : arms with each kind of wear.
        """
        self.world, self.days, self.joints, self.replays_a_day = world, days, JOINTS, world.replays_a_day
        self.arms = healthy + worn * len(world.wear)
        self.group = np.concatenate([np.full(healthy, -1), np.repeat(np.arange(len(world.wear)), worn)])  # (A,) −1: healthy
        self._seed = seed
        shape, every = (days, self.arms, JOINTS), world.replays_a_day
        replays: Shape = (days * every, self.arms, JOINTS)
        rng = self._rng
        self.law = Friction.drawn(rng(0), self.arms)
        self.heat: Temperatures = world.heat.at_replays(rng(1), replays, every)
        self._noise = np.broadcast_to(world.noise(rng(2), replays), replays)
        self.onset_day, self.unit_days, self.worn = self._onsets(rng(3))
        changes = [change(rng(4, k), shape) for k, change in enumerate(world.changes)]
        changes += [
            wear.factors(self.onset_day, self.unit_days, self.worn & (self.group == k)[:, None], days) if worn else Factors()
            for k, wear in enumerate(world.wear)
        ]
        daily = (sum_to(shape, [getattr(each, name) for each in changes]) for name in Factors._fields)
        each_replay = (np.repeat(each, every, axis=0) if every > 1 else each for each in daily)
        self._dry, self._viscous, self._gain, self._misfit, self._sensor_k, carried, declared = each_replay
        self._replayed = np.repeat(self._presence(rng(5)), every, axis=0)
        self._observe(rng(6))
        self._slot, self._opened = _contexts(declared[:, :, 0] > 0.0, self._replayed)
        self.undeclared = (carried[:, :, 0] != 0.0) & (self._slot == 0)  # (R, A) whether an arm carries what nobody declared
        self._weights = Weights(rng(7), carried[:, :, 0], self.heat.motor_c) if self.undeclared.any() else None

    def _rng(self, *key: int) -> np.random.Generator:
        return np.random.default_rng((self._seed, *key))

    def _onsets(self, rng: np.random.Generator) -> tuple[Array, Array, np.ndarray]:
        """The day on which wear begins, (A,), infinite in healthy arms, the unit of its path, (A,), and the joints that wear, (A, J)."""
        onset, unit, worn = np.full(self.arms, np.inf), np.full(self.arms, DAYS_A_YEAR), np.zeros((self.arms, JOINTS), dtype=bool)
        rank = rng.random((self.arms, JOINTS)).argsort(axis=1).argsort(axis=1)
        drawn, lives = rng.random(self.arms), rng.random(self.arms)
        for k, wear in enumerate(self.world.wear):
            here = self.group == k
            latest = min(wear.latest_day, max(self.days - 60.0, wear.earliest_day + 1.0))
            onset[here] = np.floor(wear.earliest_day + drawn[here] * (latest - wear.earliest_day))
            worn[here] = rank[here] < wear.joints
            if wear.life_years is not None:
                short, long = np.log(wear.life_years)
                unit[here] = np.exp(short + lives[here] * (long - short)) * DAYS_A_YEAR
        return onset, unit, worn

    def _presence(self, rng: np.random.Generator) -> np.ndarray:
        """(D, A) whether the arm replays."""
        replayed: np.ndarray = rng.random((self.days, self.arms)) >= self.world.missed
        per_year, length = self.world.gap
        if per_year > 0:
            begins = rng.random((self.days, self.arms)) < per_year / 365.0
            begun = np.cumsum(begins, axis=0)
            before = np.zeros_like(begun)
            before[length:] = begun[: self.days - length]
            replayed &= begun == before
        replayed[0] = True
        return replayed

    def _observe(self, rng: np.random.Generator) -> None:
        """What `identify` makes of every replay, from the law's straight line; (R, A, J) each."""
        grease, shape = self.heat.grease_c, self._noise.shape
        dry, viscous = np.exp(self._dry), np.exp(self._viscous)
        fc, fv = self.law.line(grease, dry, viscous)
        self._truth = np.log(self.law.torque(REFERENCE_RAD_S, grease, dry, viscous)) + self._gain
        within = rng.uniform(*WITHIN_STD, shape)
        self._variance = within**2
        self._y = self._truth + self._noise + within * rng.normal(size=shape)
        share = fv * REFERENCE_RAD_S / (fc + fv * REFERENCE_RAD_S)
        error = rng.uniform(*SHARE_STD, shape[1:]) * autoregressive(rng.normal(size=shape), SHARE_RHO)
        self._share = np.clip(share * np.exp(error), 0.05, 0.95)
        self._slow, self._fast = (self._at_speed(v, fv * error, rng) for v in (SLOW_RAD_S, FAST_RAD_S))
        missed = MISFIT * viscous * self.law.parts(REFERENCE_RAD_S, grease)[1]
        scatter = RESIDUAL_STD * autoregressive(rng.normal(size=shape), RESIDUAL_RHO)
        self._residual = np.hypot(missed, FLOOR * SIZE_NM) * np.exp(self._misfit + self._gain + scatter)  # [N·m]
        self._measured = np.rint((self.heat.motor_c + self._sensor_k + 0.01 * rng.normal(size=shape)) / SENSOR_STEP_K) * SENSOR_STEP_K
        self._warming = self.heat.warming_k_per_min + 0.03 * rng.normal(size=shape)

    def _at_speed(self, speed_rad_s: float, error_nm_s_per_rad: Array, rng: np.random.Generator) -> Array:
        """(R, A, J) log F that the fit finds at another speed, whose error turns the line about the reference speed."""
        torque = self.law.torque(speed_rad_s, self.heat.grease_c, np.exp(self._dry), np.exp(self._viscous))
        turned = error_nm_s_per_rad * (speed_rad_s - REFERENCE_RAD_S) / torque
        own = SPEED_STD * rng.normal(size=torque.shape)
        result: Array = np.log(torque) + self._gain + (self._y - self._truth) + turned + own
        return result

    @cached_property
    def _nothing_turned(self) -> Array:
        return np.zeros((self.arms, JOINTS))

    def morning(self, number: int) -> Day:
        """The replays of that number, in any order."""
        r, day = number, number / self.replays_a_day
        torque, share, here = np.exp(self._y[r]), self._share[r], self._replayed[r]
        since = np.where(np.isfinite(self.onset_day), np.maximum(day - self.onset_day, 0.0), 0.0)
        return Day(
            replayed=here,
            slot=self._slot[r],
            opened=self._opened[r],
            seen=Observation(
                log_torque=np.where(here[:, None], self._y[r], np.nan).ravel(),
                variance=self._variance[r].ravel(),
                temperature_c=self._measured[r].ravel(),
                viscous_share=share.ravel(),
                warming_k_per_min=self._warming[r].ravel(),
                coulomb_nm=((1.0 - share) * torque).ravel(),
                viscous_nm_s_per_rad=(share * torque / REFERENCE_RAD_S).ravel(),
                **(self._channels(r) if self.world.channels else {}),
            ),
            truth=self._truth[r],
            worn=self.worn * (day >= self.onset_day)[:, None].astype(float),
            revolutions=self._nothing_turned,
            used_days=since,
            rigid=None if self._weights is None else self._weights.fits(r),
        )

    def _channels(self, number: int) -> dict[str, Array]:
        """The optional fields of an observation."""
        fields = {"residual_rms_nm": self._residual, "log_torque_slow": self._slow, "log_torque_fast": self._fast}
        return {name: np.where(self._replayed[number][:, None], each[number], np.nan).ravel() for name, each in fields.items()}

    def log_torque_at(self, number: int, temperature_c: Array) -> Array:
        """(A, J) true log friction at the reference speed at the replay of that number, were motor and grease of one temperature (A, J)."""
        torque = self.law.torque(REFERENCE_RAD_S, temperature_c, np.exp(self._dry[number]), np.exp(self._viscous[number]))
        result: Array = np.log(torque) + self._gain[number]
        return result


def _contexts(declared: np.ndarray, replayed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R, A) the slot of every replay's context, and whether it is the first replay in it; declared, replayed : (R, A)."""
    first = declared & replayed & (np.cumsum(declared & replayed, axis=0) == 1)
    return declared.astype(int), first


def sum_to(shape: Shape, parts: list[Array | float]) -> Array:
    """The sum of factors' logarithms, broadcast to that shape without a copy where nothing varies."""
    total: Array | float = 0.0
    for part in parts:
        total = total + part
    return np.broadcast_to(np.asarray(total, dtype=float), shape)
