"""A simulated fleet's life, judged day by day by the daemon's own functions: the filter step and the tiers of alerts.

The learning days at the beginning are left out of every figure but `Played.early`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from monitor.judge.alerts.evidence import Evidence, nothing_counted, wear_of_state, weigh_evidence
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.slots import SLOTS
from monitor.judge.drift.step import DriftState, Replay, StepResult, initial_state, step
from monitor.judge.drift.undeclared import Weights, declares_level, weigh
from monitor.judge.drift.undetected_change import undetected_change
from monitor.judge.settings import AssessSettings, HealthSettings
from monitor.recording import DAY_S, Array
from monitor.studies.figures import NINETY
from monitor.studies.rehearsal.fleet import SCENARIOS, Day, Fleet, FleetSettings, Wear

LEARNING_DAYS = 60
COMPARABLE = tuple(name for name in SCENARIOS if name not in {"holidays", "payload_swaps"})
"""Scenarios with a replay on every day against one baseline: there, a delay in days is a delay in replays."""
TIERS = 3  # advisory, wear, limit


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
    alerts, accuracy = _AlertDays(fleet), _Accuracy(fleet, assess.drift)
    for day, _, now, result, evidence, _ in judged_days(fleet, settings.days, assess):
        state = result.state
        if day < learning:
            early |= np.concatenate([(evidence.raises >= 0) | evidence.falls, evidence.together])
        else:
            alerts.add(day, evidence)
            accuracy.add(now, result, undetected=np.isnan(alerts.tier[:, 0]))
        if watch:
            watch(day, now, state)
    assert state is not None
    return Played(
        fleet=fleet,
        days=settings.days - learning,
        tier_day=alerts.tier.reshape(A, J, TIERS),
        falling_day=alerts.falling.reshape(A, J),
        common_day=alerts.common,
        early=int(early.sum()),
        covered=accuracy.covered(),
        covered_worn=accuracy.covered_worn(),
        covered_undetected=accuracy.covered_undetected(),
        slope_error_per_k=accuracy.slope_per_k(),
        state=state,
    )


def judged_days(fleet: LivingFleet, days: int, assess: AssessSettings, *, count_use: bool = True) -> Iterator[JudgedDay]:
    """A fleet's days, judged by the daemon's own functions in turn. count_use : whether revolutions are counted."""
    A, J = fleet.arms, fleet.joints
    state: DriftState | None = None
    counts, last, weighed = nothing_counted(A * J, A), np.zeros(A), _Weighed(A)
    for number in range(days * fleet.replays_a_day):
        day, now = number / fleet.replays_a_day, fleet.morning(number)
        if state is None:
            state = initial_state(now.seen, J, assess.drift, assess.temperature)
        weights = weighed.weigh(now, day, assess.health)
        replay = Replay(
            observation=now.seen,
            days=day - last,
            replayed=now.replayed,
            slot=weights.slot,
            opened=weights.opened & (day > 0),  # the initial state knows no level yet
            undeclared=weights.withheld,
            same_mass=weights.same_mass,
            revolutions=now.revolutions.ravel() if count_use else None,
        )
        last = np.where(now.replayed, day, last)
        result = step(state, replay, assess.drift, assess.temperature)
        state = result.state
        usable = state.filter_state.learnt_from & result.inside_range
        evidence = weigh_evidence(wear_of_state(state.filter_state, usable, math.floor(day)), counts, J, assess.health)
        counts = evidence.counts
        yield JudgedDay(number, day, now, result, evidence, weights.contradicted)


class _WeighedDay(NamedTuple):
    """What the weights of a morning's replays lead to, (A,) each."""

    contradicted: np.ndarray  # whether they contradict the declared context
    withheld: np.ndarray  # whether nothing is learnt of the replay
    slot: np.ndarray  # of the level that the replay belongs to
    opened: np.ndarray  # whether that level begins
    same_mass: np.ndarray  # whether they exclude a mass that friction shows


class _Weighed:
    """The weights of each arm, compared and learnt as `learn` does it: an undeclared level is kept in the slots after the declared ones."""

    def __init__(self, arms: int) -> None:
        self._weights = [Weights()] * arms
        self._slots = np.tile(np.arange(SLOTS), (arms, 1))  # of each declared context, as the fleet counts them

    def weigh(self, now: Day, day: float, health: HealthSettings) -> _WeighedDay:
        """What the weights of a morning's replays contradict, and the level that each replay belongs to."""
        A, sigma, mass_kg = len(now.replayed), health.contradiction_sigma, health.contradiction_kg
        contradicted, withheld, same_mass = np.zeros((3, A), dtype=bool)
        opened = now.opened.copy()
        if now.rigid is None:
            return _WeighedDay(contradicted, withheld, now.slot, opened, same_mass)
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
            contradicted[arm], withheld[arm], same_mass[arm] = found.condition is not None, found.withheld, found.same_mass
            if found.own_level:
                slot[arm], opened[arm] = own, found.begins
        return _WeighedDay(contradicted, withheld, slot, opened, same_mass)


def interval_holds(truth: Array, state: DriftState, drift: DriftSettings) -> np.ndarray:
    """(N,) whether the 90 % interval of log friction at T0 holds the truth (N,); undetected changes belong to the interval."""
    joints, T0, slot = state.filter_state, state.reference_temperature_c, state.slot
    mean, std = joints.reference(T0, slot)
    more, more_var = undetected_change(joints, joints.reference_row(T0, slot), drift)
    inside: np.ndarray = np.abs(truth - mean - more) < NINETY * np.sqrt(std**2 + more_var)
    return inside


class _AlertDays:
    """The first day of every alert; NaN before it came."""

    def __init__(self, fleet: Fleet) -> None:
        N = fleet.arms * fleet.joints
        self.tier = np.full((N, TIERS), np.nan)
        self.falling = np.full(N, np.nan)
        self.common = np.full(fleet.arms, np.nan)

    def add(self, day: int, evidence: Evidence) -> None:
        """One more day of a fleet."""
        for k in range(TIERS):
            self.tier[(evidence.raises >= k) & np.isnan(self.tier[:, k]), k] = day
        self.falling[evidence.falls & np.isnan(self.falling)] = day
        self.common[evidence.together & np.isnan(self.common)] = day


class _Accuracy:
    """How close the estimated friction is to the fleet's true friction, summed over days."""

    def __init__(self, fleet: Fleet, drift: DriftSettings) -> None:
        N = fleet.arms * fleet.joints
        self._fleet, self._drift = fleet, drift
        self._covered, self._replays = np.zeros(N), np.zeros(N)
        self._worn_covered, self._worn_replays = 0.0, 0.0
        self._undetected_covered, self._undetected_replays = 0.0, 0.0
        self._sums = np.zeros((N, 5))  # n, Σx, Σy, Σx², Σxy of the regression of friction left over on temperature

    def add(self, now: Day, result: StepResult, *, undetected: np.ndarray) -> None:
        """One more day: whether the 90 % interval at T0 contains the truth, and what the temperature law leaves.

        undetected : (N,) joints without a tier so far.
        """
        fleet, state, joints = self._fleet, result.state, result.state.filter_state
        here = np.repeat(now.replayed, fleet.joints)
        T, T0, slot = now.seen.temperature_c, state.reference_temperature_c, state.slot
        truth = np.log(fleet.torque(T0.reshape(fleet.arms, fleet.joints), np.exp(now.worn))).ravel()
        inside = interval_holds(truth, state, self._drift)
        self._covered, self._replays = self._covered + (inside & here), self._replays + here
        worn = (now.worn.ravel() > 0) & here
        self._worn_covered += float((inside & worn).sum())
        self._worn_replays += float(worn.sum())
        self._undetected_covered += float((inside & worn & undetected).sum())
        self._undetected_replays += float((worn & undetected).sum())
        # truth at the true temperature, less what the filter expects at the measured one, without its noise
        left = now.truth.ravel() - joints.reference(np.where(np.isfinite(T), T, joints.origin_c), slot)[0]
        use = joints.learnt_from & np.isfinite(T) & result.inside_range & here
        x, y = np.where(use, T - T0, 0.0), np.where(use, left, 0.0)
        self._sums += np.stack([use, x, y, x * x, x * y], axis=1)

    def covered(self) -> Array:
        """(A,) share of replays and joints whose interval contained the truth."""
        covered, replays = (each.reshape(self._fleet.arms, self._fleet.joints).sum(axis=1) for each in (self._covered, self._replays))
        share: Array = covered / np.maximum(replays, 1.0)
        return share

    def covered_worn(self) -> float:
        """The same of all joints that wear; NaN where there is none."""
        return self._worn_covered / self._worn_replays if self._worn_replays else float("nan")

    def covered_undetected(self) -> float:
        """The same until their first tier; NaN where there is no such day."""
        return self._undetected_covered / self._undetected_replays if self._undetected_replays else float("nan")

    def slope_per_k(self) -> Array:
        """(A, J) [1/K] slope of the friction left over, by least squares; NaN where temperature did not vary."""
        n, sx, sy, sxx, sxy = self._sums.T
        with np.errstate(invalid="ignore", divide="ignore"):
            slope: Array = (n * sxy - sx * sy) / (n * sxx - sx * sx)
        return slope.reshape(self._fleet.arms, self._fleet.joints)
