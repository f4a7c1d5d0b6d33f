"""When each arm of a fleet needs a replay, by the daemon's own decision: `[schedule] replay = "when_needed"`.

What the daemon reads in its history is kept here as arrays: when a replay was learnt from, when each joint was told of last, and of which
joints work has found wear, or makes it likely, or the last replays a change. Nobody acknowledges an alert: once raised, it stays active.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.acquire.schedule.needed import SUSPECTED_DAYS, Told, need
from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.alerts.evidence import raised_by_production, weigh_evidence
from monitor.judge.drift.step import DriftState, Replay, StepResult, initial_state, step
from monitor.judge.friction.figures import suspected_rise
from monitor.judge.friction.observation import Observation
from monitor.judge.settings import AssessSettings
from monitor.recording import DAY_S, Array, known_or_none
from monitor.service.history.needed import PRODUCTION_TELLS_DAYS
from monitor.studies.figures import DAYS_A_YEAR, Rate
from monitor.studies.rehearsal.fleet import REPLAY_MIN, Day, Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import COMPARABLE, interval_holds
from monitor.studies.rehearsal.rehearse import LATEST_ONSET, days_to_play, onsets

from . import at_least_one

WINDOW_DAY = 0.125  # [d] a window opens at 3 o'clock, and the day before was judged at midnight


class Needs:
    """What replays and work have told of A arms with J joints so far. Days count from the first window."""

    def __init__(self, arms: int, joints: int) -> None:
        self._replayed = np.full(arms, np.nan)  # [d] the last replay that was learned from
        self._joints = np.full((arms, joints), -np.inf)  # [d] when each joint was told of last
        self._asks, self._suspects = np.zeros((arms, joints), dtype=bool), np.zeros((arms, joints), dtype=bool)
        self._doubted = np.zeros((arms, joints), dtype=bool)
        self._active = np.full((arms, joints), -1.0)  # tier of each joint's alert, −1: none

    def asked(self, day: int) -> np.ndarray:
        """(A,) arms of which work asks for a replay on the morning of a day: of a suspicion on every second one."""
        again = ~(day - self._replayed < SUSPECTED_DAYS - 0.5)
        asked: np.ndarray = np.any(self._asks, axis=1) | (np.any(self._suspects, axis=1) & again)
        return asked

    def at(self, day: int, schedule: ScheduleSettings) -> np.ndarray:
        """(A,) arms that replay in the window of a day."""
        closes = DAY_S * (day + WINDOW_DAY) + schedule.grace_s
        return np.array([need(schedule, self._told(arm)).at(closes) for arm in range(len(self._replayed))])

    def replayed(self, day: float, learnt: np.ndarray, tier: Array, doubted: np.ndarray) -> None:
        """After replays. learnt : (A, J) joints that learned from one; tier : (A, J) to which alerts may be raised, −1: none.

        doubted : (A, J) of which replays alone tell, and make a rise likely.
        """
        here: np.ndarray = np.any(learnt, axis=1)
        self._replayed = np.where(here, day, self._replayed)
        self._asks &= ~here[:, None]
        self._suspects &= ~here[:, None]
        self._doubted = doubted
        self._heard(day, learnt, tier)

    def worked(self, day: float, learnt: np.ndarray, tier: Array, wanted: Array, suspected: np.ndarray) -> None:
        """After days of work, as `assess_work` does it. wanted : (A, J) the tier that replays would have raised; suspected : (A, J)."""
        self._heard(day, learnt, tier)
        heard: np.ndarray = np.any(learnt, axis=1)
        asks = learnt & (wanted > self._active)
        self._asks = asks | (self._asks & ~learnt)
        self._suspects = np.where(heard[:, None], suspected & learnt & ~self._asks, self._suspects)

    def _heard(self, day: float, learnt: np.ndarray, tier: Array) -> None:
        self._joints = np.where(learnt, day, self._joints)
        self._active = np.maximum(self._active, tier)

    def _told(self, arm: int) -> Told:
        replayed = self._replayed[arm]
        return Told(
            began_unix_s=0.0,
            replayed_unix_s=None if np.isnan(replayed) else DAY_S * float(replayed),
            joints_unix_s=tuple((DAY_S * self._joints[arm]).tolist()),
            asks=_numbers(self._asks[arm]),
            suspects=_numbers(self._suspects[arm]),
            doubted=_numbers(self._doubted[arm]),
        )


def _numbers(joints: np.ndarray) -> tuple[int, ...]:
    return tuple(int(j) + 1 for j in np.flatnonzero(joints))


# --- A fleet whose ordinary work is observed too: few replays and much work, against daily replays, and against few replays alone ---

DAILY_UNTIL = 60  # [day] while the arm is learnt, every plan replays daily
NEVER = np.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionSettings:
    """What an estimate from a day's work is like, in truth."""

    offset_std: float = 0.1  # [log] between the level of work and that of the excitation, of each joint
    std: float = 0.015  # [log] from day to day: hours of work average more than half a minute of replay
    autocorrelation: float = 0.6  # of a day and the next
    common_share: float = 0.3  # of the variance that the joints of an arm share
    degrees: float = 5.0  # of freedom of Student's t, in place of Gaussian noise
    wander_std: float = 0.006  # [log] of the offset over months …
    wander_days: float = 90.0  # … with this correlation time
    within_std: float = 0.01  # [log] stated, and in truth up to twice or half of it
    seldom: float = 0.3  # share of days on which a joint is excited that is excited seldom: one in each arm
    blind_joints: int = 1  # in each arm that work never excites


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """When an arm is observed."""

    every_days: int = 1  # between replays, once the arm is learnt
    production: bool = False  # whether its work is observed; wear that only work has found, or suspects, then asks for one
    schedule: ScheduleSettings | None = None  # by which the daemon decides, on every morning, whether a replay is needed; None: as above


class _Shift(NamedTuple):
    """The end of a day's work, (A, J) each unless stated."""

    worked: np.ndarray  # (A,)
    motor_c: Array
    grease_c: Array
    factor: Array  # of wear


class FleetInProduction(Fleet):
    """A fleet, with an estimate of friction from each day's work. Its random numbers for that are its own: replays are as without it."""

    def __init__(self, settings: FleetSettings, wear: Wear | None, production: ProductionSettings) -> None:
        super().__init__(settings, wear)
        self.production = production
        self.production_rng = rng = np.random.default_rng([settings.seed, 77])
        shape = (self.arms, self.joints)
        self._offset = production.offset_std * rng.normal(size=shape)
        self._production_noise, self._wander = production.std * rng.normal(size=shape), production.wander_std * rng.normal(size=shape)
        order = np.argsort(rng.random(shape), axis=1)  # which joints are blind, and which are seldom excited
        self._chance = np.select([order < production.blind_joints, order < production.blind_joints + 1], [0.0, production.seldom], 0.95)
        self._misstated = np.exp(rng.uniform(-math.log(2.0), math.log(2.0), shape))
        self._shift: _Shift | None = None

    @property
    def seen_at_work(self) -> np.ndarray:
        """(A, J) joints that work ever excites."""
        excited: np.ndarray = self._chance > 0
        return excited

    def _at_production(self, day: int, duty: Array) -> None:
        factor = self.wear.at(day, self.joints, self._used_days)
        self._shift = _Shift(duty > 0, self._heat.motor.copy(), self._heat.grease.copy(), factor)

    def evening(self) -> tuple[np.ndarray, Observation]:
        """Which arms worked, (A,), and what their work tells; after `morning` of the same day."""
        assert self._shift is not None
        shift, w, rng = self._shift, self.production, self.production_rng
        shape, rho, fades = shift.motor_c.shape, w.autocorrelation, math.exp(-1.0 / w.wander_days)
        own, common = rng.standard_t(w.degrees, shape), rng.standard_t(w.degrees, (shape[0], 1))
        fresh = (math.sqrt(1.0 - w.common_share) * own + math.sqrt(w.common_share) * common) * math.sqrt((w.degrees - 2.0) / w.degrees)
        self._production_noise = rho * self._production_noise + math.sqrt(1.0 - rho**2) * w.std * fresh
        self._wander = fades * self._wander + math.sqrt(1.0 - fades**2) * w.wander_std * rng.normal(size=shape)
        truth = np.log(self.torque(shift.grease_c, shift.factor))
        within = w.within_std * self._misstated
        y = truth + self._offset + self._wander + self._production_noise + within * rng.normal(size=shape)
        told = (rng.random(shape) < self._chance) & shift.worked[:, None]
        viscous, torque = self._viscous_share(shift.grease_c), np.exp(y)
        v = self.settings.reference_speed_rad_s
        return shift.worked, Observation(
            log_torque=np.where(told, y, np.nan).ravel(),
            variance=np.full(y.size, w.within_std**2),
            temperature_c=(shift.motor_c + 0.3 * rng.normal(size=shape)).ravel(),  # a mean over the day's segments
            viscous_share=viscous.ravel(),
            warming_k_per_min=np.full(y.size, np.nan),
            coulomb_nm=((1.0 - viscous) * torque).ravel(),
            viscous_nm_s_per_rad=(viscous * torque / v).ravel(),
        )


class Judged(NamedTuple):
    """What the judge made of one observation of a fleet."""

    day: int
    from_production: bool
    result: StepResult
    tier: Array  # (N,) to which friction's alerts may be raised, −1: none
    falls: np.ndarray  # (N,)
    together: np.ndarray  # (A,)
    wanted: Array  # (N,) to which a replay with this evidence might raise them; more than any where work alone has found a rise
    now: Day


def observed_days(fleet: FleetInProduction, days: int, plan: Plan, assess: AssessSettings) -> Iterator[Judged]:
    """A fleet's days by a plan, judged by the daemon's own functions in turn. The arms of a fleet replay on different days."""
    A, J = fleet.arms, fleet.joints
    state: DriftState | None = None
    last, needs, at_work = np.zeros(A), Needs(A, J), np.full(A * J, -np.inf)  # [d] when work told of each joint last
    turn = np.arange(A) % plan.every_days
    for day in range(days):
        now = fleet.morning(day)  # the day's work comes before its replay, in the next morning
        worked, told = fleet.evening()
        if state is None:
            state = initial_state(now.seen, J, assess)
        elif plan.production:
            replay = Replay(observation=told, days=np.where(worked, day - 0.6 - last, 0.0), replayed=worked, from_production=True)
            result = step(state, replay, assess, in_place=True)
            last = np.where(worked, day - 0.6, last)
            judged, state = _weigh(result, day, assess, now, from_production=True), result.state
            at_work = np.where(_learnt(result), day - 0.6, at_work)
            suspected = suspected_rise(state.friction, assess.friction)
            needs.worked(day - 0.6, *(each.reshape(A, J) for each in (_learnt(result), judged.tier, judged.wanted, suspected)))
            yield judged
        if plan.schedule is None:
            due = now.replayed & ((day < DAILY_UNTIL) | (day % plan.every_days == turn) | needs.asked(day))
        else:
            due = now.replayed & needs.at(day, plan.schedule)
        replay = Replay(
            observation=now.seen,
            days=np.where(due, day - last, 0.0),
            replayed=due,
            slot=now.slot,
            opened=now.opened & (day > 0),
            revolutions=now.revolutions.ravel(),
        )
        last = np.where(due, day, last)
        result = step(state, replay, assess, in_place=True)
        judged, state = _weigh(result, day, assess, now, from_production=False), result.state
        doubted = suspected_rise(state.friction, assess.friction) & (day - at_work > PRODUCTION_TELLS_DAYS)
        needs.replayed(day, *(each.reshape(A, J) for each in (_learnt(result), judged.tier, doubted)))
        yield judged


def _learnt(result: StepResult) -> np.ndarray:
    """(N,) joints that learned from the observation."""
    learnt: np.ndarray = np.isfinite(result.observation.log_torque) & result.state.learnt_from
    return learnt


def _weigh(result: StepResult, day: int, assess: AssessSettings, now: Day, *, from_production: bool) -> Judged:
    """The tiers after an observation, which changes no alert of a joint that it says nothing of."""
    here, evidence = _learnt(result), weigh_evidence(result.state, assess.health)
    raises = np.where(here, evidence.raises, -1)
    if not from_production:
        return Judged(day, from_production, result, raises, evidence.falls & here, evidence.together, raises, now)
    friction = result.state.friction
    wanted = np.where(here & friction.of_joints(friction.unconfirmed), len(assess.health.rises), raises)
    nothing = np.zeros_like(evidence.falls), np.zeros_like(evidence.together)
    return Judged(day, from_production, result, raised_by_production(raises), *nothing, wanted, now)


def played(
    settings: FleetSettings, wear: Wear | None, production: ProductionSettings, plan: Plan, assess: AssessSettings
) -> dict[str, Any]:
    """First alerts of a fleet by a plan, and how often 90 % intervals of friction held the truth, as a document."""
    fleet = FleetInProduction(settings, wear, production)
    return figures(fleet, wear, observed_days(fleet, settings.days, plan, assess), assess)


def figures(fleet: FleetInProduction, wear: Wear | None, days: Iterable[Judged], assess: AssessSettings) -> dict[str, Any]:
    """The same of a fleet that lives its days while they are iterated over.

    Days until the worn joint's first tier are counted in the arms without an earlier alert of it.
    """
    settings, N, A = fleet.settings, fleet.arms * fleet.joints, fleet.arms
    first, of_wear, falling, together = np.full(N, np.inf), np.full(N, np.inf), np.full(N, np.inf), np.full(A, np.inf)
    replays, held = 0, [0, 0]
    for one in days:
        if one.day < DAILY_UNTIL:
            continue
        if not one.from_production:
            replays += int(np.isfinite(one.result.observation.log_torque).reshape(A, -1).any(axis=1).sum())
        first = np.where((one.tier >= 0) & np.isinf(first), one.day, first)
        of_wear = np.where((one.tier >= 1) & np.isinf(of_wear), one.day, of_wear)
        falling = np.where(one.falls & np.isinf(falling), one.day, falling)
        together = np.where(one.together & np.isinf(together), one.day, together)
        if one.day % 10 == 0:
            T0 = one.result.state.reference_temperature_c.reshape(A, -1)
            truth = np.log(fleet.torque(T0, np.exp(one.now.worn))).ravel()
            inside = interval_holds(truth, one.result.state, assess.friction)
            held = [held[0] + int(inside.sum()), held[1] + N]
    years = A * (settings.days - DAILY_UNTIL) / DAYS_A_YEAR
    found: dict[str, Any] = {"replays_a_year": replays / years, "interval_90": held[0] / max(held[1], 1)}
    if wear is None:
        kinds = {"rises": first, "falls": falling, "common": together}
        of_kind = {name: int(np.isfinite(days).sum()) for name, days in kinds.items()}
        events = sum(of_kind.values())
        rate = Rate(events=events, robot_years=years)
        return {**found, "false": events, **of_kind, "robot_years": years, "per_year": rate.per_year, "at_most": rate.at_most}
    worn = np.arange(A) * fleet.joints + wear.joint.astype(int)
    late, late_wear = first[worn] - wear.onset_day + 1.0, of_wear[worn] - wear.onset_day + 1.0
    clean = ~(late < 1)
    moves = fleet.seen_at_work.ravel()[worn]
    return {
        **found,
        "arms": int(clean.sum()),
        "median_days": _median(late[clean]),
        "median_days_where_production_tells": _median(late[clean & moves]),
        "median_days_where_it_never_does": _median(late[clean & ~moves]),
        "p90_days": known_or_none(float(np.quantile(late[clean], 0.9, method="higher"))),
        "wear_tier_median_days": _median(late_wear[clean]),
    }


def _median(days: Array) -> float | None:
    return known_or_none(float(np.median(days))) if len(days) else None


# --- The table of `docs/production.md`: what few replays beside ordinary work are worth, and what they cost, beside daily replays ---

STEP, PER_YEAR = 0.05, 0.10


def when_needed(**settings: Any) -> Plan:
    """The daemon's own decision; replays are daily in as many days as with the other plans."""
    return Plan(production=True, schedule=ScheduleSettings(replay="when_needed", learning_days=DAILY_UNTIL, **settings))


PLANS = {
    "a replay a day": Plan(),
    "a replay a week, and work": Plan(every_days=7, production=True),
    "a replay a month, and work": Plan(every_days=30, production=True),
    "`when_needed`": when_needed(),
    "`when_needed`, `unobserved_days = 30`": when_needed(unobserved_days=30.0),
    "a replay a week alone": Plan(every_days=7),
}


class Fleets(NamedTuple):
    """How many arms of each kind a plan plays."""

    quiet: int = 150
    step: int = 120
    slow: int = 60


def play_plan(plan: Plan, kind: str, arms: int, seed: int) -> dict[str, Any]:
    """What was found of the arms of one kind ("quiet", "step", "slow") by a plan."""
    assess, production = AssessSettings(), ProductionSettings()
    step, per_year = {"quiet": (0.0, 0.0), "step": (STEP, 0.0), "slow": (0.0, PER_YEAR)}[kind]
    days = LATEST_ONSET if kind == "quiet" else days_to_play(step, per_year)
    wear = None if kind == "quiet" else onsets(arms, seed, step=step, per_day=per_year / DAYS_A_YEAR)
    return played(FleetSettings(arms=arms, days=days, seed=seed, scenarios=COMPARABLE), wear, production, plan, assess)


def row(name: str, quiet: dict[str, Any], step: dict[str, Any], slow: dict[str, Any], daily_a_year: float) -> str:
    """One plan as a line of the table."""
    replays = quiet["replays_a_year"]
    delays = "; ".join(_days(step[key]) for key in ("median_days", "median_days_where_production_tells", "median_days_where_it_never_does"))
    share = f"{100.0 * replays / daily_a_year:.0f} %"
    minutes = f"{replays / 12.0 * REPLAY_MIN:.1f}"
    false = f"{quiet['per_year']:.2f} ({quiet['at_most']:.2f})"
    return f"| {name} | {replays:.0f} ({share}) | {minutes} | {delays} | {_days(slow['median_days'])} | {false} |\n"


HEAD = (
    "| after the learning days | replays a year of a healthy arm | minutes a month | median days to a 5 % step: all joints; "
    "those that work moves; those that it never does | to 10 % a year | false alerts a robot-year (95 % bound) |\n"
    "|---|---|---|---|---|---|\n"
)


def table(fleets: Fleets, seed: int, plans: Sequence[str], workers: int | None) -> Iterator[str]:
    """The Markdown table of these plans, line by line; the first plan is that with which robot time is compared."""
    yield HEAD
    with ProcessPoolExecutor(workers) as pool:
        runs = {
            name: [pool.submit(play_plan, PLANS[name], kind, arms, seed + k) for k, (kind, arms) in enumerate(fleets._asdict().items())]
            for name in plans
        }
        daily_a_year = runs[plans[0]][0].result()["replays_a_year"]
        for name, of_plan in runs.items():
            quiet, step, slow = (each.result() for each in of_plan)
            yield row(name, quiet, step, slow, daily_a_year)


def _days(days: float | None) -> str:
    return "–" if days is None else f"{days:.0f}"


def main() -> None:
    """`python -m tests.evidence.production [--seed S] [--quiet N] [--step N] [--slow N]`."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.production", description=__doc__)
    parser.add_argument("--seed", type=int, default=611)
    for kind, arms in Fleets()._asdict().items():
        parser.add_argument(f"--{kind}", type=at_least_one, default=arms, help="arms of this kind that each plan plays")
    parser.add_argument("--workers", type=int, default=None, help="processes; as many as there are cores")
    arguments = parser.parse_args()
    fleets = Fleets(arguments.quiet, arguments.step, arguments.slow)
    for line in table(fleets, arguments.seed, list(PLANS), arguments.workers):
        sys.stdout.write(line)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
