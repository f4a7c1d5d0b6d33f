"""A fleet of simulated arms as arrays: years of daily replays in seconds, from a seed.

Friction and heat are the simulator's (concave in speed, load-dependent, exponential in the grease's temperature, two thermal nodes). The
monitor assumes none of these. A surrogate stands for `identify`: the law's torque at the reference speed, times the noise between replays,
times the noise within one. `tests/studies` compares its distribution with that of replays of the full physics.

Shapes: A arms, J joints per arm.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.undeclared import RigidFit
from monitor.judge.friction.observation import Observation
from monitor.model.robot import Robot, load_robot
from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw, default_law
from monitor.simulate.arm.thermal import ThermalModel, default_thermal

PRODUCTION_H, NIGHT_H = 10.0, 13.0  # [h] of a day
REPLAY_MIN, REPLAY_DUTY = 0.5, 0.8  # [min] a replay's length, and its duty
MISSED_REPLAYS = 0.01  # share of mornings without a replay
DAYS_A_YEAR = 365.0
SENSOR_STEP_K = 1.0 / 16.0  # [K] resolution of a UR's temperature sensor
WITHIN_SHARE = 0.7, 1.5  # of `within_std`: in the best replay and in the worst
MEAN_DUTY = 0.5 * 5.0 / 7.0  # share of the working hours in motion: 0.3 to 0.7 on five days of seven
REVOLUTIONS_PER_DUTY_DAY = 0.6 * 0.6 / (2.0 * np.pi) * 3600.0 * PRODUCTION_H  # moving for 0.6 of the time, at 0.6 rad/s
SCENARIOS = ("steady", "seasons", "cold_mornings", "warm_ups", "payload_swaps", "holidays", "wild_replays", "bad_sensors")
SAME_IN_ALL = ("stribeck_rad_s", "drag_nm")  # of friction laws: sound brakes do not drag
PAYLOADS = 3  # number that an arm carries in turn in the scenario `payload_swaps`


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """The fleet's size, its noise, and its scenarios."""

    arms: int = 100
    days: int = 425
    seed: int = 0
    robot: str = "ur5"
    between_std: float = 0.02  # of log F between replays
    autocorrelation: float = 0.5
    within_std: float = 0.005  # of log F within a replay
    reference_speed_rad_s: float = 0.4
    scenarios: tuple[str, ...] = SCENARIOS  # assigned to the arms in turn


Path = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wear:
    """True wear: one joint of each arm has a step and a constant rate from a day on; the others do not wear."""

    joint: Array  # (A,) index
    onset_day: Array  # (A,)
    step: Array  # (A,) fraction
    per_day: Array  # (A,) fraction
    path: Path | None = None  # what a fraction worn along the straight line is in truth; None: the same

    def at(self, day: float, joints: int, used_days: Array) -> Array:
        """(A, J) factor of friction on a day, after `used_days` (A,) mean days of work since the onset."""
        straight = self.per_day * used_days
        worn = np.where(day >= self.onset_day, self.step + (straight if self.path is None else self.path(straight)), 0.0)
        factor = np.ones((len(self.joint), joints))
        factor[np.arange(len(self.joint)), self.joint.astype(int)] += worn
        return factor


class Day(NamedTuple):
    """The replays of one morning."""

    replayed: np.ndarray  # (A,) whether the arm replayed
    slot: np.ndarray  # (A,) the arm's context: its payload
    opened: np.ndarray  # (A,) whether it replayed in this context for the first time
    seen: Observation  # (A·J,) each
    truth: Array  # (A, J) log of friction at the reference speed, without noise, at the true temperature
    worn: Array  # (A, J) log of the wear factor
    revolutions: Array  # (A, J) counted since the beginning
    used_days: Array  # (A,) mean days of work since the onset of wear
    rigid: tuple[RigidFit, ...] | None = None  # weights that each arm's replay identified; None: those of before


class Morning(NamedTuple):
    """The fleet after a morning's replay."""

    away: np.ndarray  # (A,) whether the arm is on holiday
    motor_c: Array  # (A, J) mean over the replay
    grease_c: Array  # (A, J) at its end
    warming_k_per_min: Array  # (A, J) of the motor during the replay


def unworn(arms: int) -> Wear:
    """The wear of arms that do not wear."""
    zero = np.zeros(arms)
    return Wear(joint=zero, onset_day=zero + 1e9, step=zero, per_day=zero)


class Fleet:
    """Arms of one model, each with its own friction law, weather, work and noise."""

    replays_a_day = 1

    def __init__(self, settings: FleetSettings, wear: Wear | None = None) -> None:
        """Every random number comes from `settings.seed`."""
        self.settings = settings
        self.robot: Robot = load_robot(settings.robot)
        A, J = settings.arms, self.robot.joints
        self.joints, self.arms = J, A
        self.rng = np.random.default_rng(settings.seed)
        self.wear = wear or unworn(A)
        self.scenario = np.resize(np.array(settings.scenarios), A)
        self.law = various(default_law(self.robot), (A,), self.rng)
        self._heat = _Heat(default_thermal(self.robot), A)
        self._noise = self.rng.normal(size=(A, J)) * settings.between_std
        rng = self.rng
        self._season_k = np.where(self.scenario == "seasons", 9.0, rng.uniform(2.0, 5.0, A))
        self._phase = rng.uniform(0, 2 * np.pi, A)
        self._base_c = rng.uniform(18.0, 25.0, A)
        self._weather = rng.normal(size=A)
        self._load_nm = self.robot.max_torque_nm * 0.15 * rng.uniform(0.6, 1.4, (A, J))  # mean of |τ| through the gear in the replay
        self._payload_share = rng.uniform(0.0, 2.5, (A, PAYLOADS, J))  # of that load, by payload
        self._payload_share[:, 0] = 0.0
        self._payload = np.zeros(A, dtype=int)
        self._known = np.zeros((A, PAYLOADS), dtype=bool)
        self._holiday_until = np.zeros(A)
        self._revolutions = np.zeros((A, J))
        self._used_days = np.zeros(A)
        self._worn = np.zeros((A, J))  # log of the wear factor

    def morning(self, day: int) -> Day:
        """A day's work, a night, and the replay of the next morning. To be called for every day in turn."""
        morning = self._live_a_day(day)
        replayed, opened = self._enter_contexts(morning.away)
        factor = self.wear.at(day, self.joints, self._used_days)
        self._worn = np.log(factor)
        truth = np.log(self.torque(morning.grease_c, factor))
        return Day(
            replayed=replayed,
            slot=self._payload.copy(),
            opened=opened,
            seen=self._observe(morning, truth, replayed),
            truth=truth,
            worn=self._worn,
            revolutions=self._revolutions.copy(),
            used_days=self._used_days.copy(),
        )

    def _live_a_day(self, day: int) -> "Morning":
        """Work and heat until after the morning's replay."""
        rng, A, scenario = self.rng, self.arms, self.scenario
        self._weather = 0.7 * self._weather + np.sqrt(1 - 0.49) * rng.normal(size=A)
        room = self._base_c + self._season_k * np.sin(2 * np.pi * day / DAYS_A_YEAR + self._phase) + 1.2 * self._weather
        monday, weekend = day % 7 == 0, day % 7 in (5, 6)
        cold = np.where((scenario == "cold_mornings") & monday, -10.0, 0.0) + np.where(monday, -2.0, 0.0)
        starts = (scenario == "holidays") & (rng.random(A) < 1 / 60) & (day > self._holiday_until)
        self._holiday_until = np.where(starts, day + rng.integers(5, 25, A), self._holiday_until)
        away = (scenario == "holidays") & (day < self._holiday_until)

        duty = np.where(away | weekend, 0.0, rng.uniform(0.3, 0.7, A))
        self._heat.live(self, PRODUCTION_H, room + 2.0, duty)
        self._at_production(day, duty)
        self._revolutions += duty[:, None] * REVOLUTIONS_PER_DUTY_DAY
        self._used_days += np.where(day > self.wear.onset_day, duty / MEAN_DUTY, 0.0)
        self._heat.live(self, NIGHT_H, room + cold, np.zeros(A))
        # work before the replay: from a cold start to the middle of a warm-up
        warm = scenario == "warm_ups"
        warm_h = np.where(warm, rng.uniform(0.0, 0.5, A), rng.uniform(0.5, 1.0, A))
        warm_duty = np.where(warm, rng.uniform(0.3, 1.0, A), rng.choice([0.0, 0.15, 0.3], A))
        self._heat.live(self, warm_h, room + cold, warm_duty)
        before = self._heat.motor.copy()
        self._heat.live(self, REPLAY_MIN / 60.0, room + cold, np.full(A, REPLAY_DUTY))
        after = self._heat.motor
        return Morning(away, 0.5 * (before + after), self._heat.grease, (after - before) / REPLAY_MIN)

    def _at_production(self, day: int, duty: Array) -> None:
        """The end of a day's work with a duty (A,); a fleet whose work is observed looks at it here."""

    def _enter_contexts(self, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which arms replay, and which of these for the first time with their payload, (A,) each."""
        rng, A = self.rng, self.arms
        swaps = (self.scenario == "payload_swaps") & (rng.random(A) < 1 / 15)
        self._payload = np.where(swaps, rng.integers(0, PAYLOADS, A), self._payload)
        replayed: np.ndarray = ~(away | (rng.random(A) < MISSED_REPLAYS))
        arm = np.arange(A)
        opened: np.ndarray = replayed & ~self._known[arm, self._payload]
        self._known[arm[replayed], self._payload[replayed]] = True
        return replayed, opened

    def _observe(self, morning: "Morning", truth: Array, replayed: np.ndarray) -> Observation:
        """What `identify` would make of the replays, by the surrogate, with lost values and outliers of their scenarios."""
        s, rng, shape, scenario = self.settings, self.rng, truth.shape, self.scenario
        rho = s.autocorrelation
        self._noise = rho * self._noise + np.sqrt(1 - rho**2) * s.between_std * rng.normal(size=shape)
        within = s.within_std * rng.uniform(*WITHIN_SHARE, shape)
        y = truth + self._noise + within * rng.normal(size=shape)
        outlier = (scenario == "wild_replays") & (rng.random(self.arms) < 0.03)
        y += np.where(outlier[:, None] & (rng.random(shape) < 0.5), rng.normal(size=shape) * 0.2, 0.0)
        lost = (rng.random(shape) < 0.02) & (scenario == "wild_replays")[:, None]
        lost |= ~replayed[:, None]
        measured = np.rint((morning.motor_c + 0.005 * rng.normal(size=shape)) / SENSOR_STEP_K) * SENSOR_STEP_K
        warming = morning.warming_k_per_min + 0.03 * rng.normal(size=shape)  # noise of a line through half a minute of the sensor's steps
        blind = (scenario == "bad_sensors")[:, None] & (rng.random((self.arms, 1)) < 0.02)
        viscous, torque = self._viscous_share(morning.grease_c), np.exp(y)
        return Observation(
            log_torque=np.where(lost, np.nan, y).ravel(),
            variance=(within**2).ravel(),
            temperature_c=np.where(blind, np.nan, measured).ravel(),
            viscous_share=viscous.ravel(),
            warming_k_per_min=np.where(blind, np.nan, warming).ravel(),
            coulomb_nm=((1.0 - viscous) * torque).ravel(),
            viscous_nm_s_per_rad=(viscous * torque / s.reference_speed_rad_s).ravel(),
        )

    def torque(self, grease_c: Array, factor: Array) -> Array:
        """(A, J) friction at the reference speed and a grease temperature, under the present payload [N·m]."""
        speed = np.full(grease_c.shape, self.settings.reference_speed_rad_s)
        load = self._load_nm * (1.0 + self._payload_share[np.arange(self.arms), self._payload])
        return self.law.torque(speed, load, grease_c, factor, factor)

    def log_torque_at(self, number: int, temperature_c: Array) -> Array:  # noqa: ARG002 - the newest morning's number
        """(A, J) true log friction at the reference speed at the newest morning and a temperature (A, J)."""
        result: Array = np.log(self.torque(temperature_c, np.exp(self._worn)))
        return result

    def _viscous_share(self, grease_c: Array) -> Array:
        """(A, J) share that `identify` finds viscous: by the slope of the line through the law at two speeds."""
        ones = np.ones_like(grease_c)
        slow, fast = (self.law.torque(v * ones, self._load_nm, grease_c, ones, ones) for v in (0.2, 1.0))
        v = self.settings.reference_speed_rad_s
        slope = (fast - slow) / 0.8
        return np.clip(slope * v / (slow + slope * (v - 0.2)), 0.05, 0.95)


class _Heat:
    """Two thermal nodes for each joint, stepped exactly under constant powers; the modes are computed once."""

    def __init__(self, model: ThermalModel, arms: int) -> None:
        self._model = model
        self.motor = np.full((arms, len(model.motor_j_per_k)), 25.0)
        self.grease = self.motor.copy()
        A = np.empty((len(model.motor_j_per_k), 2, 2))
        A[:, 0, 0] = -(model.motor_grease_w_per_k + model.motor_room_w_per_k) / model.motor_j_per_k
        A[:, 0, 1] = model.motor_grease_w_per_k / model.motor_j_per_k
        A[:, 1, 0] = model.motor_grease_w_per_k / model.grease_j_per_k
        A[:, 1, 1] = -model.motor_grease_w_per_k / model.grease_j_per_k
        rate, modes = np.linalg.eig(A)
        self._rate, self._modes, self._inverse = rate.real, modes.real, np.linalg.inv(modes.real)

    def live(self, fleet: Fleet, hours: Array | float, room_c: Array, duty: Array) -> None:
        """So many hours (A,) in a room of a temperature (A,) [°C] with a duty (A,)."""
        m = self._model
        gain = np.where(np.isnan(fleet.robot.drive_gain_nm_per_a), 12.0, fleet.robot.drive_gain_nm_per_a)
        load = 0.25 * fleet.robot.max_torque_nm
        ones = np.ones_like(self.motor)
        moving = 0.6 * duty[:, None]
        resisting = fleet.law.torque(0.6 * ones, load * ones, self.grease, ones, ones)
        motor_w = m.idle_w + moving * m.winding_ohm * ((load + resisting) / gain) ** 2
        grease_w = moving * resisting * 0.6
        steady_motor = room_c[:, None] + (motor_w + grease_w) / m.motor_room_w_per_k
        steady = np.stack([steady_motor, steady_motor + grease_w / m.motor_grease_w_per_k], axis=2)  # (A, J, 2)
        away = np.stack([self.motor, self.grease], axis=2) - steady
        dt = 3600.0 * np.broadcast_to(np.asarray(hours, dtype=float), duty.shape)
        share = np.einsum("jik,ajk->aji", self._inverse, away) * np.exp(self._rate * dt[:, None, None])
        now = steady + np.einsum("jik,ajk->aji", self._modes, share)
        self.motor, self.grease = now[..., 0], now[..., 1]


def various(law: FrictionLaw, arms: tuple[int, ...], rng: np.random.Generator) -> FrictionLaw:
    """The friction law of each arm, (*arms, J): they differ as arms of one model do."""
    values = {}
    spread = {"exponent": 0.05, "viscous_per_k": 0.15, "coulomb_per_k": 0.5}
    for name in (name for name in law.__dataclass_fields__ if name not in SAME_IN_ALL):
        value = getattr(law, name)
        values[name] = value * np.exp(spread.get(name, 0.2) * rng.normal(size=(*arms, len(value))))
    return replace(law, **values)
