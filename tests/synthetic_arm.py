"""An arm as a stream of identifications: friction laws that the monitor does not assume, weather, noise and wear, from a seed.

F(v, T) = fc + fv·e^(−k(T−25)) v, both times the wear; the noise of successive replays may be autocorrelated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache

import numpy as np

from monitor.identify.identification import Identification
from monitor.judge.assess import judge_identification
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.decision import Crossing
from monitor.judge.friction.observation import Observation, observe
from monitor.judge.friction.step import FrictionState
from monitor.judge.learn import begin
from monitor.judge.settings import AssessSettings
from monitor.model.base import base_parameters
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context

DAY_S = 86_400.0
START_S = 1_750_032_000.0  # 2025-06-16 00:00 UTC, a Monday
CONTEXT = Context(robot="ur5", serial="2015350000", mounting_rad=(0.0, 0.0, 0.0), payload_kg=0.0, trajectory_digest="0123456789abcdef")
COULOMB_NM = np.array([8.0, 9.0, 7.0, 1.6, 1.5, 1.4])
VISCOUS = np.array([11.0, 12.0, 9.0, 1.7, 1.6, 1.5])


@dataclass(kw_only=True)
class Arm:
    """One UR5; `replay` gives what identify would say of it at a time, temperature and wear."""

    seed: int = 0
    noise: float = 0.02  # between replays, of F(v*), one σ
    autocorrelation: float = 0.0
    within: float = 0.004
    fall_per_k: float = 0.015
    viscous: np.ndarray = field(default_factory=lambda: VISCOUS)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.shared = self.rng.normal(size=6) * self.noise

    def replay(self, temperature_c: np.ndarray | float, wear: np.ndarray | float = 0.0) -> Identification:
        """Wear is a fraction of friction, (6,) or one for all."""
        rho = self.autocorrelation
        self.shared = rho * self.shared + np.sqrt(1 - rho**2) * self.rng.normal(size=6) * self.noise
        T = np.broadcast_to(np.asarray(temperature_c, dtype=float), 6)
        factor = (1.0 + np.asarray(wear)) * np.exp(self.shared)
        # within a replay fc and fv trade off: their sum at 0.4 rad/s is known far better than either
        trade = self.rng.normal(size=6) * 0.03
        fv_true = self.viscous * np.exp(-self.fall_per_k * (T - 25.0))
        fc, fv = factor * (COULOMB_NM - trade * fv_true * 0.4), factor * fv_true * (1.0 + trade)
        total = fc + 0.4 * fv
        var_fv, var_f = (0.03 * fv) ** 2, (self.within * total) ** 2
        cov = np.empty((6, 2, 2))
        cov[:, 1, 1] = var_fv
        cov[:, 0, 1] = cov[:, 1, 0] = -0.4 * var_fv  # so that Var(fc + 0.4 fv) = var_f
        cov[:, 0, 0] = var_f + 0.16 * var_fv
        return identification(fc, fv, cov, T)


@cache
def _nominal() -> np.ndarray:
    """The manufacturer's rigid parameters: the same for every replay."""
    return load_robot("ur5").nominal_parameters()


def identification(fc: np.ndarray, fv: np.ndarray, cov: np.ndarray, temperature_c: np.ndarray | None) -> Identification:
    """What identify returns for a UR5 on the ground, with the manufacturer's rigid parameters and this friction."""
    ground = Mounting()
    base, standard = base_parameters(load_robot("ur5"), ground), _nominal().copy()
    standard[10::13], standard[11::13] = fc, fv
    B = len(base.columns)
    return Identification(
        robot="ur5",
        mounting=ground,
        method="wls",
        names=base.names,
        combination=base.combination,
        columns=base.columns,
        values=base.combination @ standard,
        covariance=np.eye(B) * 1e-6,
        condition_number=100.0,
        coulomb_nm=np.asarray(fc),
        viscous_nm_s_per_rad=np.asarray(fv),
        friction_cov=cov,
        temperature_c=temperature_c,
        max_speed_rad_s=np.full(6, 2.0),
        rms_nm=np.full(6, 0.5),
        relative_rms=np.full(6, 0.05),
        rms_all_nm=np.full(6, 0.5),
        normalised_error_nm=0.01,
        samples=3750,
    )


def fresh(settings: AssessSettings | None = None, temperature_c: float = 30.0) -> Belief:
    """The belief of a UR5 before its first replay."""
    return begin("ur5", CONTEXT, Arm().replay(temperature_c), START_S, settings or AssessSettings())


def lived_together(lives: Sequence[Sequence[Identification]]) -> list[DriftState]:
    """The state of several arms after each day, one replay a day: by the daemon's own filter step, and in one arm's time.

    lives : the replays of each arm, all of as many days.
    """
    settings = AssessSettings()
    states: list[DriftState] = []
    for day, together in enumerate(zip(*lives, strict=True)):
        seen = Observation(*map(np.concatenate, zip(*(observe(replay, settings.drift) for replay in together), strict=True)))
        state = states[-1] if states else initial_state(seen, 6, settings)
        states.append(step(state, Replay(observation=seen, days=np.full(len(lives), float(day > 0))), settings).state)
    return states


def of_arm(state: FrictionState, k: int) -> FrictionState:
    """The part of one arm in a state of many."""
    J, N = state.joints_per_arm, len(state.replays)
    n = np.arange(k * (J + 1), (k + 1) * (J + 1))
    channels_first = {"known", "usual_c", "course"}

    def part(value, name=""):
        if isinstance(value, Crossing):
            return Crossing(value.rises[n], value.falls[n], value.common[:, [k]])
        if is_dataclass(value):
            return replace(value, **{f.name: part(getattr(value, f.name), f.name) for f in fields(value)})
        if not isinstance(value, np.ndarray) or name == "born":
            return value
        assert value.shape[0 if name in channels_first else -1] == N, name
        return value[n] if name in channels_first else value[..., n]

    return part(state)


class History:
    """Replays judged one after the other, as the daemon would; keeps the last assessment and every transition."""

    def __init__(self, settings: AssessSettings | None = None) -> None:
        self.settings = settings or AssessSettings()
        self.last: Assessment | None = None
        self.transitions: list[tuple[float, str, int | None, str, str]] = []  # day, kind, joint, condition, tier
        self.health = None

    def add(self, day: float, seen: Identification, context: Context = CONTEXT) -> Assessment:
        """One replay so many days after the first Monday, midnight."""
        at = replace(context, recorded_at_unix_s=START_S + day * DAY_S)
        belief = self.last.belief if self.last else None
        verdict = judge_identification(seen, at, belief=belief, health=self.health, settings=self.settings)
        assert isinstance(verdict, Assessment), verdict
        self.last, self.health = verdict, verdict.health
        self.transitions += [(day, kind, alert.joint, alert.condition, alert.tier) for kind, alert in verdict.transitions]
        return verdict

    def first(
        self, *, tiers: tuple[str, ...] = ("wear", "limit"), condition: str | tuple[str, ...] = ("wear_rising", "sudden_step")
    ) -> dict[int | None, float]:
        """Joint → first day on which an alert of one of these tiers stood."""
        days: dict[int | None, float] = {}
        for day, kind, joint, what, tier in self.transitions:
            if kind != "cleared" and what in condition and tier in tiers:
                days.setdefault(joint, day)
        return days


def weather(day: float, rng: np.random.Generator) -> float:
    """Joint temperature of a daily replay: the year's swing, the day's, and how long the arm had worked before."""
    return float(31.0 + 6.0 * np.sin(2 * np.pi * day / 365.0) + rng.normal() * 2.0)
