"""A simulated fleet's life, judged day by day by the daemon's own functions: the filter step and the tiers of alerts.

The learning days at the beginning are left out of every figure but `Played.early`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from monitor.judge.alerts.evidence import Evidence, weigh_evidence
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.step import DriftState, Replay, StepResult, initial_state, step
from monitor.judge.drift.undeclared import Weights, declares_level, weigh
from monitor.judge.friction.figures import expected, expected_row
from monitor.judge.friction.step import FrictionModel
from monitor.judge.settings import AssessSettings, HealthSettings
from monitor.recording import DAY_S, Array
from monitor.studies.rehearsal.fleet import SCENARIOS, Day, Fleet, FleetSettings, Wear

LEARNING_DAYS = 60
COVERAGE_EVERY = 5  # replays: an interval takes longer than a step; and no weekday is always left out
COMPARABLE = tuple(name for name in SCENARIOS if name not in {"holidays", "payload_swaps"})
"""Scenarios with a replay on every day against one baseline: there, a delay in days is a delay in replays."""
TIERS = 3  # advisory, wear, limit
CLEAR_DAYS = 30  # so long without it, and an advisory counts as cleared: the next one is a new one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """What the monitor reported of a fleet. Days count from the first replay; NaN is never."""

    fleet: Fleet
    days: int  # after learning
    tier_day: Array  # (A, J, 3) of the first rise to each tier after learning
    falling_day: Array  # (A, J) of the first alert of falling friction
    common_day: Array  # (A,) of the first alert of all joints together
    early: int  # alerts while learning: first rises to any tier, of joints and of arms
    covered: Array  # (A,) share of days and joints whose 90 % interval of friction at T0 contained the truth
    covered_worn: float  # the same of joints that wear, after the onset; NaN where none does
    covered_undetected: float  # the same until the joint's first tier; NaN where there is no such day
    slope_error_per_k: Array  # (A, J) [1/K] dependence on temperature that the temperature law leaves in friction
    state: DriftState  # after the last day


class LivingFleet(Protocol):
    """Arms that replay day by day: `Fleet`, or a fleet in a world of its own."""

    @property
    def arms(self) -> int:
        """A."""
        ...

    @property
    def joints(self) -> int:
        """J, per arm."""
        ...

    @property
    def replays_a_day(self) -> int:
        """Of every arm, evenly spread."""
        ...

    def morning(self, number: int) -> Day:
        """The replays of that number, or of that day where there is one a day; called for every number in turn."""
        ...

    def log_torque_at(self, number: int, temperature_c: Array) -> Array:
        """(A, J) true log friction at the reference speed at the newest morning, which has that number, and a temperature (A, J)."""
        ...


class JudgedDay(NamedTuple):
    """A day's replays, or a part's of it, and what the judge made of them."""

    number: int  # of the replay
    day: float
    now: Day
    result: StepResult
    evidence: Evidence
    undeclared: np.ndarray  # (A,) whether the weights of the arm's replay contradict the declared context


Watcher = Callable[[int, Day, DriftState], None]
"""Called after each day's replays with the day, what happened in it, and the state of all joints."""


def play(
    settings: FleetSettings,
    assess: AssessSettings,
    wear: Wear | None = None,
    *,
    watch: Watcher | None = None,
    learning: int = LEARNING_DAYS,
) -> Played:
    """A fleet's life, judged day by day.

    wear : of the fleet; None: nothing wears. learning : days that are left out of the figures.
    """
    fleet = Fleet(settings, wear)
    A, J = fleet.arms, fleet.joints
    state: DriftState | None = None
    early = np.zeros(A * J + A, dtype=bool)
    tiers, falling, common = [Episodes(A * J) for _ in range(TIERS)], Episodes(A * J), Episodes(A)
    coverage, slope = Coverage(fleet, assess.friction), _Slope(fleet, assess.friction)
    for judged in judged_days(fleet, settings.days, assess):
        day, now, evidence, state = judged.number, judged.now, judged.evidence, judged.result.state
        if day < learning:
            early |= np.concatenate([(evidence.raises >= 0) | evidence.falls, evidence.together])
        else:
            for k, tier in enumerate(tiers):
                tier.add(day, evidence.raises >= k, learning)
            falling.add(day, evidence.falls, learning)
            common.add(day, evidence.together, learning)
            coverage.add(judged, np.isinf(tiers[0].first_on).reshape(A, J))
            slope.add(now, judged.result)
        if watch:
            watch(day, now, state)
    assert state is not None
    return Played(
        fleet=fleet,
        days=settings.days - learning,
        tier_day=np.stack([_or_nan(tier.first_on) for tier in tiers], axis=1).reshape(A, J, TIERS),
        falling_day=_or_nan(falling.first_on).reshape(A, J),
        common_day=_or_nan(common.first_on),
        early=int(early.sum()),
        covered=coverage.held[:, :2].sum(axis=1) / np.maximum(coverage.of[:, :2].sum(axis=1), 1.0),
        covered_worn=share_or_nan(coverage.share(1)),
        covered_undetected=share_or_nan(coverage.share(2)),
        slope_error_per_k=slope.per_k(),
        state=state,
    )


def _or_nan(day: Array) -> Array:
    """Days with NaN for never."""
    return np.where(np.isinf(day), np.nan, day)


def share_or_nan(share: float | None) -> float:
    """A share, NaN where there is none."""
    return float("nan") if share is None else share


def judged_days(fleet: LivingFleet, days: int, assess: AssessSettings, *, count_use: bool = True) -> Iterator[JudgedDay]:
    """A fleet's days, judged by the daemon's own functions in turn. count_use : whether revolutions are counted."""
    A, J = fleet.arms, fleet.joints
    state: DriftState | None = None
    last, weighed = np.zeros(A), Weighed(A)
    for number in range(days * fleet.replays_a_day):
        day, now = number / fleet.replays_a_day, fleet.morning(number)
        if state is None:
            state = initial_state(now.seen, J, assess)
        weights = weighed.weigh(now, day, assess.health)
        replay = Replay(
            observation=now.seen,
            days=day - last,
            replayed=now.replayed,
            slot=weights.slot,
            opened=weights.opened & (day > 0),  # the initial state knows no level yet
            undeclared=weights.withheld,
            revolutions=now.revolutions.ravel() if count_use else None,
        )
        last = np.where(now.replayed, day, last)
        result = step(state, replay, assess, in_place=True)
        state = result.state
        yield JudgedDay(number, day, now, result, weigh_evidence(state, assess.health), weights.contradicted)


class _WeighedDay(NamedTuple):
    """What the weights of a morning's replays lead to, (A,) each."""

    contradicted: np.ndarray  # whether they contradict the declared context
    withheld: np.ndarray  # whether nothing is learnt of the replay
    slot: np.ndarray  # of the level that the replay belongs to
    opened: np.ndarray  # whether that level begins


class Weighed:
    """The weights of each arm, compared and learnt as `learn` does it: an undeclared level is kept in the slots after the declared ones."""

    def __init__(self, arms: int) -> None:
        self._weights = [Weights()] * arms
        self._slots = np.tile(np.arange(SLOTS), (arms, 1))  # of each declared context, as the fleet counts them

    def weigh(self, now: Day, day: float, health: HealthSettings) -> _WeighedDay:
        """What the weights of a morning's replays contradict, and the level that each replay belongs to."""
        A, sigma, mass_kg = len(now.replayed), health.contradiction_sigma, health.contradiction_kg
        contradicted, withheld = np.zeros((2, A), dtype=bool)
        opened = now.opened.copy()
        if now.rigid is None:
            return _WeighedDay(contradicted, withheld, now.slot, opened)
        slot = self._slots[np.arange(A), now.slot]
        for arm in np.flatnonzero(now.replayed).tolist():
            fit, weights, own = now.rigid[arm], self._weights[arm], SLOTS - 1 - now.slot[arm]
            if now.opened[arm]:
                level = weights.level
                same = level is not None and declares_level(weights, fit, sigma=sigma, mass_kg=mass_kg)
                if same:  # the level of the context before
                    self._slots[arm, now.slot[arm]] = slot[arm] = own + 1
                opened[arm] = not same
                weights = Weights(level.estimate) if same and level is not None else Weights()
            self._weights[arm], found = weigh(weights, fit, day * DAY_S, sigma=sigma, mass_kg=mass_kg)
            contradicted[arm], withheld[arm] = found.condition is not None, found.withheld
            if found.own_level:
                slot[arm], opened[arm] = own, found.begins
        return _WeighedDay(contradicted, withheld, slot, opened)


def interval_holds(truth: Array, state: DriftState, model: FrictionModel) -> np.ndarray:
    """(N,) whether the 90 % interval of log friction at T0 holds the truth (N,): quantiles of the mixture, unfound changes among it."""
    friction, J = state.friction, state.joints_per_arm
    channels = np.zeros((len(truth) // J, J + 1))
    channels[:, :J] = truth.reshape(-1, J)
    below = friction.of_joints(friction.friction(friction.reference_c, model).below(channels.ravel()))
    inside: np.ndarray = (below > 0.05) & (below < 0.95)
    return inside


class Episodes:
    """First days and number of episodes of a condition, for joints or arms; infinite is never."""

    def __init__(self, size: int) -> None:
        self.first_on = np.full(size, np.inf)  # after learning, also where it was on before
        self.first = np.full(size, np.inf)  # of an episode that began after learning
        self.count = np.zeros(size, dtype=int)  # of these
        self._last = np.full(size, -np.inf)

    def add(self, day: float, on: np.ndarray, learning: int) -> None:
        """One more day; what was on while learning and never went off is no new episode."""
        if day >= learning:
            new = on & (day - self._last > CLEAR_DAYS)
            self.first_on[on & np.isinf(self.first_on)] = day
            self.first[new & np.isinf(self.first)] = day
            self.count += new
        self._last[on] = day


class Coverage:
    """How many replays of each arm had a 90 % interval that held the truth: of healthy joints, of worn ones, of these until detected."""

    def __init__(self, fleet: LivingFleet, model: FrictionModel) -> None:
        self._fleet, self._model = fleet, model
        self.held, self.of = np.zeros((2, fleet.arms, 3))

    def add(self, judged: JudgedDay, undetected: np.ndarray) -> None:
        """One more day. undetected : (A, J) or (A, 1) joints whose wear was not found so far."""
        if judged.number % COVERAGE_EVERY:
            return
        shape, state = (self._fleet.arms, self._fleet.joints), judged.result.state
        truth = self._fleet.log_torque_at(judged.number, state.reference_temperature_c.reshape(shape))
        holds, worn = interval_holds(truth.ravel(), state, self._model).reshape(shape), judged.now.worn > 0
        for k, mask in enumerate((~worn, worn, worn & undetected)):
            counted = mask & judged.now.replayed[:, None]
            self.held[:, k] += (holds & counted).sum(axis=1)
            self.of[:, k] += counted.sum(axis=1)

    def share(self, k: int, arms: np.ndarray | None = None) -> float | None:
        """The share of the k-th kind, of all arms or of some; None without any."""
        here = slice(None) if arms is None else arms
        of = float(self.of[here, k].sum())
        return float(self.held[here, k].sum()) / of if of else None


class _Slope:
    """What the temperature law leaves of the dependence on temperature: sums of a regression of friction left over on temperature."""

    def __init__(self, fleet: Fleet, model: FrictionModel) -> None:
        self._fleet, self._model, self._sums = fleet, model, np.zeros((fleet.arms * fleet.joints, 5))  # n, Σx, Σy, Σx², Σxy

    def add(self, now: Day, result: StepResult) -> None:
        """One more day."""
        state, friction, T = result.state, result.state.friction, now.seen.temperature_c
        # truth at the true temperature, less what is expected at the measured one, without noise
        H = expected_row(friction, np.where(np.isfinite(T), T, state.reference_temperature_c), np.zeros(len(T)), self._model)
        left = now.truth.ravel() - expected(friction, H)[0]
        use = state.learnt_from & np.isfinite(T) & result.inside_range & np.repeat(now.replayed, self._fleet.joints)
        x, y = np.where(use, T - state.reference_temperature_c, 0.0), np.where(use, left, 0.0)
        self._sums += np.stack([use, x, y, x * x, x * y], axis=1)

    def per_k(self) -> Array:
        """(A, J) [1/K] slope by least squares; NaN where temperature did not vary."""
        n, sx, sy, sxx, sxy = self._sums.T
        with np.errstate(invalid="ignore", divide="ignore"):
            slope: Array = (n * sxy - sx * sy) / (n * sxx - sx * sx)
        return slope.reshape(self._fleet.arms, self._fleet.joints)
