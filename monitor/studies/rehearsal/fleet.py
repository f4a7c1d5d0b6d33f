"""A fleet of simulated arms as arrays: years of daily replays in seconds, from a seed.

Friction and heat are the simulator's own (concave in speed, load-dependent, exponential in the grease's temperature, two thermal
nodes): the monitor assumes none of them. What `identify` would make of a replay is a surrogate: the law's torque at the reference
speed, times what differs from replay to replay, times the noise within one. `tests/studies` holds its distribution against that of
full-physics replays.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.judge.drift.observation import Observation
from monitor.model.robot import Robot, load_robot
from monitor.recording import Array
from monitor.simulate.arm.friction import FrictionLaw, default_law
from monitor.simulate.arm.thermal import ThermalModel, default_thermal

WORK_H, NIGHT_H = 10.0, 13.0
SENSOR_STEP_K = 1.0 / 16.0
WITHIN_SHARE = 0.7, 1.5  # of `within_std`: from the best replay to the worst
MEAN_DUTY = 0.5 * 5.0 / 7.0  # of a working day's hours: 0.3 to 0.7 on five days of seven
REVOLUTIONS_PER_DUTY_DAY = 0.6 * 0.6 / (2.0 * np.pi) * 3600.0 * WORK_H  # moving for 0.6 of the time, at 0.6 rad/s
SCENARIOS = ("steady", "seasons", "cold_mornings", "warm_ups", "payload_swaps", "holidays", "wild_replays", "bad_sensors")
PAYLOADS = 3  # different ones an arm carries in the scenario of that name


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """How many arms, how noisy, and what the reference speed is."""

    arms: int = 100
    days: int = 425
    seed: int = 0
    robot: str = "ur5"
    between_std: float = 0.02  # of log F between replays
    autocorrelation: float = 0.5
    within_std: float = 0.005  # of log F within a replay
    reference_speed_rad_s: float = 0.4
    scenarios: tuple[str, ...] = SCENARIOS  # dealt out in turn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wear:
    """True wear: per arm, one joint's step and pace from a day on; the others stay as new."""

    joint: Array  # (A,) index
    onset_day: Array  # (A,)
    step: Array  # (A,) fraction
    per_day: Array  # (A,) fraction

    def at(self, day: float, joints: int, used_days: Array) -> Array:
        """(A, J) factor of friction on a day, after `used_days` (A,) mean days of work since the onset."""
        worn = np.where(day >= self.onset_day, self.step + self.per_day * used_days, 0.0)
        factor = np.ones((len(self.joint), joints))
        factor[np.arange(len(self.joint)), self.joint.astype(int)] += worn
        return factor


class Day(NamedTuple):
    """One morning's replays of the fleet."""

    replayed: np.ndarray  # (A,) whether there was one
    slot: np.ndarray  # (A,) which of the arm's contexts it was in
    opened: np.ndarray  # (A,) for the first time
    seen: Observation  # (A·J,) each
    motor_c: Array  # (A, J) as measured
    grease_c: Array  # (A, J) true
    truth: Array  # (A, J) log of friction at the reference speed, without noise, at the true temperature
    worn: Array  # (A, J) log of the wear factor
    revolutions: Array  # (A, J) counted since the beginning
    used_days: Array  # (A,) mean days of work since the onset of wear


def unworn(arms: int) -> Wear:
    """Nothing wears."""
    zero = np.zeros(arms)
    return Wear(joint=zero, onset_day=zero + 1e9, step=zero, per_day=zero)


class Fleet:
    """Arms of one model, each with its own law, weather, work and luck."""

    def __init__(self, settings: FleetSettings, wear: Wear | None = None) -> None:
        """Everything is drawn from `settings.seed`."""
        self.settings = settings
        self.robot: Robot = load_robot(settings.robot)
        A, J = settings.arms, self.robot.joints
        self.joints, self.arms = J, A
        self.dice = np.random.default_rng(settings.seed)
        self.wear = wear or unworn(A)
        self.scenario = np.resize(np.array(settings.scenarios), A)
        self.law = various(default_law(self.robot), (A,), self.dice)
        self._heat = _Heat(default_thermal(self.robot), A)
        self._noise = self.dice.normal(size=(A, J)) * settings.between_std
        dice = self.dice
        self._season_k = np.where(self.scenario == "seasons", 9.0, dice.uniform(2.0, 5.0, A))
        self._phase = dice.uniform(0, 2 * np.pi, A)
        self._base_c = dice.uniform(18.0, 25.0, A)
        self._weather = dice.normal(size=A)
        self._load_nm = self.robot.max_torque_nm * 0.15 * dice.uniform(0.6, 1.4, (A, J))  # mean of |τ| through the gear in the replay
        self._payload_share = dice.uniform(0.0, 2.5, (A, PAYLOADS, J))  # of that load, by payload
        self._payload_share[:, 0] = 0.0
        self._payload = np.zeros(A, dtype=int)
        self._known = np.zeros((A, PAYLOADS), dtype=bool)
        self._holiday_until = np.zeros(A)
        self._revolutions = np.zeros((A, J))
        self._used_days = np.zeros(A)

    def morning(self, day: int) -> Day:
        """A night, a day's work, a morning's replay. To be called for every day in turn."""
        s, dice, A, J = self.settings, self.dice, self.arms, self.joints
        scenario = self.scenario
        self._weather = 0.7 * self._weather + np.sqrt(1 - 0.49) * dice.normal(size=A)
        room = self._base_c + self._season_k * np.sin(2 * np.pi * day / 365.0 + self._phase) + 1.2 * self._weather
        monday, weekend = day % 7 == 0, day % 7 in (5, 6)
        cold = np.where((scenario == "cold_mornings") & monday, -10.0, 0.0) + np.where(monday, -2.0, 0.0)
        starts = (scenario == "holidays") & (dice.random(A) < 1 / 60) & (day > self._holiday_until)
        self._holiday_until = np.where(starts, day + dice.integers(5, 25, A), self._holiday_until)
        away = (scenario == "holidays") & (day < self._holiday_until)

        duty = np.where(away | weekend, 0.0, dice.uniform(0.3, 0.7, A))
        self._heat.live(self, WORK_H, room + 2.0, duty)
        self._revolutions += duty[:, None] * REVOLUTIONS_PER_DUTY_DAY
        self._used_days += np.where(day > self.wear.onset_day, duty / MEAN_DUTY, 0.0)
        self._heat.live(self, NIGHT_H, room + cold, np.zeros(A))
        # how long and how hard it has worked before the replay: from a cold start to the middle of a warm-up
        warm = scenario == "warm_ups"
        warm_h = np.where(warm, dice.uniform(0.0, 0.5, A), dice.uniform(0.5, 1.0, A))
        warm_duty = np.where(warm, dice.uniform(0.3, 1.0, A), dice.choice([0.0, 0.15, 0.3], A))
        self._heat.live(self, warm_h, room + cold, warm_duty)
        before = self._heat.motor.copy()
        self._heat.live(self, 0.5 / 60.0, room + cold, np.full(A, 0.8))  # the replay itself: half a minute
        motor, grease = 0.5 * (before + self._heat.motor), self._heat.grease

        swaps = (scenario == "payload_swaps") & (dice.random(A) < 1 / 15)
        self._payload = np.where(swaps, dice.integers(0, PAYLOADS, A), self._payload)
        replayed = ~(away | (dice.random(A) < 0.01))
        arm = np.arange(A)
        opened = replayed & ~self._known[arm, self._payload]
        self._known[arm[replayed], self._payload[replayed]] = True

        factor = self.wear.at(day, J, self._used_days)
        truth = np.log(self.torque(grease, factor))
        rho = s.autocorrelation
        self._noise = rho * self._noise + np.sqrt(1 - rho**2) * s.between_std * dice.normal(size=(A, J))
        within = s.within_std * dice.uniform(*WITHIN_SHARE, (A, J))
        y = truth + self._noise + within * dice.normal(size=(A, J))
        wild = (scenario == "wild_replays") & (dice.random(A) < 0.03)
        y += np.where(wild[:, None] & (dice.random((A, J)) < 0.5), dice.normal(size=(A, J)) * 0.2, 0.0)
        lost = (dice.random((A, J)) < 0.02) & (scenario == "wild_replays")[:, None]
        lost |= ~replayed[:, None]
        measured = np.rint((motor + 0.005 * dice.normal(size=(A, J))) / SENSOR_STEP_K) * SENSOR_STEP_K
        warming = (self._heat.motor - before) / 0.5 + 0.03 * dice.normal(size=(A, J))  # [K/min], a line through half a minute of sixteenths
        blind = (scenario == "bad_sensors")[:, None] & (dice.random((A, 1)) < 0.02)
        measured = np.where(blind, np.nan, measured)
        warming = np.where(blind, np.nan, warming)
        viscous = self._viscous_share(grease)
        torque = np.exp(y)
        seen = Observation(
            log_torque=np.where(lost, np.nan, y).ravel(),
            variance=(within**2).ravel(),
            temperature_c=measured.ravel(),
            viscous_share=viscous.ravel(),
            warming_k_per_min=warming.ravel(),
            coulomb_nm=((1.0 - viscous) * torque).ravel(),
            viscous_nm_s_per_rad=(viscous * torque / s.reference_speed_rad_s).ravel(),
        )
        return Day(
            replayed=replayed,
            slot=self._payload.copy(),
            opened=opened,
            seen=seen,
            motor_c=measured,
            grease_c=grease.copy(),
            truth=truth,
            worn=np.log(factor),
            revolutions=self._revolutions.copy(),
            used_days=self._used_days.copy(),
        )

    def torque(self, grease_c: Array, factor: Array) -> Array:
        """(A, J) friction at the reference speed and a grease temperature, under the present payload [N·m]."""
        speed = np.full(grease_c.shape, self.settings.reference_speed_rad_s)
        load = self._load_nm * (1.0 + self._payload_share[np.arange(self.arms), self._payload])
        return self.law.torque(speed, load, grease_c, factor, factor)

    def _viscous_share(self, grease_c: Array) -> Array:
        """What `identify` calls viscous of it: the slope of the line through two speeds of the law."""
        ones = np.ones_like(grease_c)
        slow, fast = (self.law.torque(v * ones, self._load_nm, grease_c, ones, ones) for v in (0.2, 1.0))
        v = self.settings.reference_speed_rad_s
        slope = (fast - slow) / 0.8
        return np.clip(slope * v / (slow + slope * (v - 0.2)), 0.05, 0.95)


class _Heat:
    """Two thermal nodes a joint, stepped exactly under constant powers; the modes are computed once."""

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
        """Hours (A,) in a room (A,) with a duty (A,)."""
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


def various(law: FrictionLaw, arms: tuple[int, ...], dice: np.random.Generator) -> FrictionLaw:
    """The law of each arm, (*arms, J): as different as arms of one model are."""
    values = {}
    spread = {"exponent": 0.05, "viscous_per_k": 0.15, "coulomb_per_k": 0.5}
    for name in law.__dataclass_fields__:
        value = getattr(law, name)
        values[name] = value * np.exp(spread.get(name, 0.2) * dice.normal(size=(*arms, len(value))))
    return replace(law, **values)
