"""What is possible at all with few replays beside ordinary work: an observer who knows the world, given the judge's own observations.

The observer knows each joint's friction law, the grease's temperature, the laws and sizes of all noise, the wander of work, which replays
are wild, and how much the arm worked. It does not know the level of replays, the offset of work, and whether, when, how and how fast the
joint wears: it weighs a step and a constant rate from every day on against no change, each of a size with a prior (Shiryaev and Roberts).
A second one has to learn how friction depends on temperature too, as the judge has: slow wear and a season look alike. A third one is told
the levels and the rate: no judge can be sooner.

An observation without what temperature and level do is noise plus wear. The noise is Gaussian with a known covariance (long tails are
taken for Gaussian ones, and clipped), so its Cholesky factor turns it into white noise in the order of time.
"""

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import log_ndtr, logsumexp

from monitor.judge.friction.observation import Observation
from monitor.judge.settings import AssessSettings
from monitor.recording import Array
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.fleet import MEAN_DUTY, REVOLUTIONS_PER_DUTY_DAY, FleetSettings, Morning, Wear
from monitor.studies.rehearsal.play import COMPARABLE
from monitor.studies.rehearsal.rehearse import LATEST_ONSET, days_to_play, onsets

from . import at_least_one
from .production import (
    DAILY_UNTIL,
    PER_YEAR,
    PLANS,
    FleetInProduction,
    Judged,
    Plan,
    ProductionSettings,
    figures,
    observed_days,
)

OBSERVED = {name: plan for name, plan in PLANS.items() if "alone" not in name} | {"a replay a day, and work": Plan(production=True)}
EVERY_DAYS = 6  # between the days from which a change may be
RATE_STD, STEP_STD = 0.2 / DAYS_A_YEAR, 0.1  # of the priors: 20 % a year, and 10 %
LEVEL_STD = 1.0  # [log] of a level that is unknown
SLOPE_STD_PER_K, CURVE_STD_PER_K2 = 0.02, 1e-3  # of a dependence on temperature that is unknown, straight and square
MIDDLE_C = 30.0  # temperatures count from here
WILD = 0.1  # [log] of noise: five standard deviations; such a replay is an outlier, and the observer is told so
CLIPPED = 3.5  # [σ] with which one observation counts at most
USUAL = REVOLUTIONS_PER_DUTY_DAY * MEAN_DUTY  # [revolutions] of a mean day's work


class Seen(NamedTuple):
    """What was observed of N joints on D days, as noise and wear alone [log]; NaN: nothing."""

    replay: Array  # (D, N)
    replay_var: Array  # (D, N) within a replay
    production: Array  # (D, N)
    production_var: Array  # (N,) within a day's estimate
    replay_use: Array  # (D, N) mean days of work until then
    production_use: Array  # (D, N)
    replay_c: Array  # (D, N) grease
    production_c: Array  # (D, N)
    offset: Array  # (N,) of work


class KnownFleet(FleetInProduction):
    """A fleet at work that remembers what of each observation is noise and wear."""

    def __init__(self, settings: FleetSettings, wear: Wear | None, production: ProductionSettings) -> None:
        super().__init__(settings, wear, production)
        self.replayed = self.worked = self.production_used = self.replay_c = self.production_c = np.zeros((self.arms, self.joints))

    def _observe(self, morning: Morning, truth: Array, replayed: np.ndarray) -> Observation:
        seen = super()._observe(morning, truth, replayed)
        healthy = np.log(self.torque(morning.grease_c, np.ones_like(truth)))
        self.replay_c = morning.grease_c
        excess = seen.log_torque.reshape(truth.shape) - healthy
        self.replayed = np.where(np.abs(excess - (truth - healthy)) > WILD, np.nan, excess)
        return seen

    def _at_production(self, day: int, duty: Array) -> None:
        super()._at_production(day, duty)
        self.production_used = self._revolutions / USUAL

    def evening(self) -> tuple[np.ndarray, Observation]:
        """As ever."""
        worked, told = super().evening()
        assert self._shift is not None
        healthy = np.log(self.torque(self._shift.grease_c, np.ones_like(self._shift.grease_c)))
        self.production_c = self._shift.grease_c
        self.worked = told.log_torque.reshape(healthy.shape) - healthy
        return worked, told

    @property
    def offset(self) -> Array:
        """(N,) of work."""
        offset: Array = self._offset.ravel()
        return offset

    @property
    def production_var(self) -> Array:
        """(N,) of an estimate from a day, in truth."""
        var: Array = np.square(self.production.within_std * self._misstated).ravel()
        return var


def recorded(fleet: KnownFleet, days: Iterator[Judged], seen: Seen) -> Iterator[Judged]:
    """The days, while what the plan observed is written into `seen`."""
    for one in days:
        resolved = np.isfinite(one.result.observation.log_torque)
        if one.from_production:
            seen.production[one.day] = np.where(resolved, fleet.worked.ravel(), np.nan)
            seen.production_use[one.day], seen.production_c[one.day] = fleet.production_used.ravel(), fleet.production_c.ravel()
        else:
            seen.replay[one.day] = np.where(resolved, fleet.replayed.ravel(), np.nan)
            seen.replay_var[one.day] = one.result.observation.variance
            seen.replay_use[one.day], seen.replay_c[one.day] = one.now.revolutions.ravel() / USUAL, fleet.replay_c.ravel()
        yield one


def by_calendar(fleet: KnownFleet, days: int, plan: Plan) -> Seen:
    """What is observed where nobody judges, and so nobody asks for a replay."""
    seen, turn = nothing_seen(fleet, days), np.arange(fleet.arms) % plan.every_days
    for day in range(days):
        now = fleet.morning(day)
        fleet.evening()
        if plan.production and day > 0:
            seen.production[day] = fleet.worked.ravel()
        due = now.replayed & ((day < DAILY_UNTIL) | (day % plan.every_days == turn))
        seen.production_use[day], seen.production_c[day] = fleet.production_used.ravel(), fleet.production_c.ravel()
        seen.replay[day] = np.where(due[:, None], fleet.replayed, np.nan).ravel()
        seen.replay_var[day] = now.seen.variance
        seen.replay_use[day], seen.replay_c[day] = now.revolutions.ravel() / USUAL, fleet.replay_c.ravel()
    return seen


def nothing_seen(fleet: KnownFleet, days: int) -> Seen:
    """Before the first day."""
    shape = (days, fleet.arms * fleet.joints)
    replay_var, replay_use, production_use, replay_c, production_c = np.zeros((5, *shape))
    return Seen(
        replay=np.full(shape, np.nan),
        replay_var=replay_var,
        production=np.full(shape, np.nan),
        production_var=fleet.production_var,
        replay_use=replay_use,
        production_use=production_use,
        replay_c=replay_c,
        production_c=production_c,
        offset=fleet.offset,
    )


class Evidence(NamedTuple):
    """Logarithm of the Shiryaev–Roberts statistic on each day, (D,)."""

    levels: Array  # of the observer who learns the levels, and knows neither kind nor size of the change
    temperature: Array  # of the one who learns the dependence on temperature as well
    told: Array  # of the one who is told levels and rate


def covariance(
    replay_days: Array,
    replay_var: Array,
    production_days: Array,
    production_var: float,
    fleet: FleetSettings,
    production: ProductionSettings,
) -> Array:
    """Of the noise of one joint: replays first, then work. The levels are not in it."""
    between, apart = (np.abs(np.subtract.outer(days, days)) for days in (replay_days, production_days))
    R = fleet.between_std**2 * fleet.autocorrelation**between + np.diag(replay_var)
    W = production.std**2 * production.autocorrelation**apart + production.wander_std**2 * np.exp(-apart / production.wander_days)
    n = len(replay_days)
    both = np.zeros((n + len(production_days),) * 2)
    both[:n, :n], both[n:, n:] = R, W + production_var * np.eye(len(production_days))
    return both


def evidence(seen: Seen, n: int, fleet: FleetSettings, production: ProductionSettings, per_day: float) -> Evidence:
    """Of joint n."""
    days = len(seen.replay)
    replay_days, production_days = (np.flatnonzero(np.isfinite(each[:, n])) for each in (seen.replay, seen.production))
    order = np.argsort(np.concatenate([replay_days, production_days - 0.6]))
    y = np.concatenate([seen.replay[replay_days, n], seen.production[production_days, n]])[order]
    use = np.concatenate([seen.replay_use[replay_days, n], seen.production_use[production_days, n]])[order]
    at = np.concatenate([replay_days, production_days])[order]
    C = covariance(
        replay_days.astype(float),
        seen.replay_var[replay_days, n],
        production_days.astype(float),
        float(seen.production_var[n]),
        fleet,
        production,
    )
    of_production = np.repeat([0.0, 1.0], [len(replay_days), len(production_days)])
    level = LEVEL_STD**2 + production.offset_std**2 * np.outer(of_production, of_production)
    starts = np.arange(0, days, EVERY_DAYS)
    began = np.interp(starts, np.arange(days), seen.replay_use[:, n])
    worn = np.maximum(use[:, None] - began, 0.0)  # (T, K) mean days of work since each start
    stepped = (at[:, None] >= starts).astype(float)
    t = np.concatenate([seen.replay_c[replay_days, n], seen.production_c[production_days, n]]) - MIDDLE_C
    thermal = SLOPE_STD_PER_K**2 * np.outer(t, t) + CURVE_STD_PER_K2**2 * np.outer(t * t, t * t)
    columns, learning = np.column_stack([y, worn, stepped]), []
    for unknown in (level, level + thermal):
        score, information = _sums(_white(C + unknown, order, columns))
        rates, steps = (slice(0, len(starts)), slice(len(starts), None))
        of_rates = _sizes_unknown(score[:, rates], information[:, rates], RATE_STD)
        learning.append(np.logaddexp(of_rates, _sizes_unknown(score[:, steps], information[:, steps], STEP_STD)))
    known = y - float(seen.offset[n]) * of_production[order]
    score, information = _sums(_white(C, order, np.column_stack([known, np.log1p(per_day * worn)])))
    told = logsumexp(np.where(information > 0, score - 0.5 * information, -np.inf), axis=1)
    return Evidence(*(_by_day(each, at, days) for each in (*learning, told)))


def _white(covariance: Array, order: np.ndarray, columns: Array) -> Array:
    """The columns where the noise of the first one is white, in the order of time; observations far out count less."""
    factor = cholesky(covariance[np.ix_(order, order)], lower=True)
    white: Array = solve_triangular(factor, columns, lower=True)
    white[1:, 0] = np.clip(white[1:, 0], -CLIPPED, CLIPPED)  # the first one is the level
    return white


def _sums(white: Array) -> tuple[Array, Array]:
    """Σ g·z and Σ g² of each change until each observation, (T, K)."""
    z, g = white[:, :1], white[:, 1:]
    return np.cumsum(g * z, axis=0), np.cumsum(g * g, axis=0)


def _sizes_unknown(score: Array, information: Array, std: float) -> Array:
    """(T,) log Σ over the starts of the Bayes factor of a change whose size is positive, a priori half of a Gaussian."""
    precision = information + std**-2.0
    factor = 0.5 * score**2 / precision - 0.5 * np.log(std**2 * precision) + np.log(2.0) + log_ndtr(score / np.sqrt(precision))
    together: Array = logsumexp(np.where(information > 0, factor, -np.inf), axis=1)
    return together


def _by_day(statistic: Array, at: Array, days: int) -> Array:
    """(D,) the statistic after each day's observations; that of before where there were none."""
    found = np.full(days, -np.inf)
    last = np.searchsorted(at, np.arange(days), side="right") - 1
    found[last >= 0] = statistic[last[last >= 0]]
    return found


class Observed(NamedTuple):
    """Arms of one kind by one plan."""

    judge: dict[str, Any] | None  # its figures; None: nobody judged
    evidence: list[Evidence]  # of the joints that matter: every one of healthy arms, and that which wears
    onset: Array  # (A,) day
    robot_years: float


def observe(name: str, kind: str, arms: int, seed: int, *, judged: bool) -> Observed:
    """Arms without wear ("quiet") or with 10 % a year ("slow") by a plan. judged : beside the judge, with the replays that it asks for."""
    plan, assess, production = OBSERVED[name], AssessSettings(), ProductionSettings()
    per_day = PER_YEAR / DAYS_A_YEAR
    days = LATEST_ONSET if kind == "quiet" else days_to_play(0.0, PER_YEAR)
    wear = None if kind == "quiet" else onsets(arms, seed, per_day=per_day)
    settings = FleetSettings(arms=arms, days=days, seed=seed, scenarios=COMPARABLE)
    fleet, found = KnownFleet(settings, wear, production), None
    if judged:
        seen = nothing_seen(fleet, days)
        found = figures(fleet, wear, recorded(fleet, observed_days(fleet, days, plan, assess), seen), assess)
    else:
        seen = by_calendar(fleet, days, plan)
    joints = np.arange(arms * fleet.joints) if wear is None else np.arange(arms) * fleet.joints + wear.joint.astype(int)
    return Observed(
        judge=found,
        evidence=[evidence(seen, int(n), settings, production, per_day) for n in joints],
        onset=np.zeros(arms) if wear is None else wear.onset_day,
        robot_years=arms * (days - DAILY_UNTIL) / DAYS_A_YEAR,
    )


def threshold(statistics: Array, crossings: int) -> float:
    """Which value so many of the healthy joints exceed on any day after the learning days. statistics : (N, D)."""
    highest = np.sort(np.max(statistics[:, DAILY_UNTIL:], axis=1))[::-1]
    return float(highest[min(crossings, len(highest) - 1)])


def median_delay(statistics: Array, above: float, onset: Array) -> float:
    """Median of the days from the onset, in arms (A, D) that were not found before."""
    found = statistics > above
    found[:, :DAILY_UNTIL] = False
    first = np.where(found.any(axis=1), np.argmax(found, axis=1), np.inf)
    late = first - onset + 1.0
    return float(np.median(late[late >= 1]))


HEAD = (
    "| plan | judge: replays a year, healthy; false a robot-year; median days to 10 % a year "
    "| observer | who learns temperature | who is told levels and rate |\n|---|---|---|---|---|\n"
)


def row(name: str, quiet: Observed, slow: Observed, false_a_year: float) -> str:
    """One plan as a line of the table."""
    judge, delays = "–", []
    if quiet.judge is not None and slow.judge is not None:
        judge = f"{quiet.judge['replays_a_year']:.0f}; {quiet.judge['per_year']:.2f}; {slow.judge['median_days']:.0f}"
    for k in range(len(Evidence._fields)):
        above = threshold(np.array([each[k] for each in quiet.evidence]), round(false_a_year * quiet.robot_years))
        delays.append(f"{median_delay(np.array([each[k] for each in slow.evidence]), above, slow.onset):.0f}")
    return f"| {name} | {judge} | {' | '.join(delays)} |\n"


def main() -> None:
    """`python -m tests.evidence.production_observer [--alone] [--seed S] [--quiet N] [--slow N] [--false F]`."""
    parser = argparse.ArgumentParser(prog="python -m tests.evidence.production_observer", description=__doc__)
    parser.add_argument("--seed", type=int, default=611)
    parser.add_argument("--quiet", type=at_least_one, default=100, help="arms without wear")
    parser.add_argument("--slow", type=at_least_one, default=100, help="arms of which one joint wears by 10 %% a year")
    parser.add_argument("--false", type=float, default=0.07, help="alerts a robot-year that the observers cause in arms without wear")
    parser.add_argument("--plans", nargs="*", default=list(OBSERVED), choices=list(OBSERVED))
    parser.add_argument("--alone", action="store_true", help="nobody judges, so nobody asks for replays: minutes instead of an hour")
    parser.add_argument("--workers", type=int, default=None, help="processes; as many as there are cores")
    arguments = parser.parse_args()
    plans = [name for name in arguments.plans if not (arguments.alone and OBSERVED[name].schedule)]
    sys.stdout.write(HEAD)
    with ProcessPoolExecutor(arguments.workers) as pool:
        kinds = (("quiet", arguments.quiet, 0), ("slow", arguments.slow, 2))  # the arms of `work_plans`
        runs = [
            [pool.submit(observe, name, kind, arms, arguments.seed + k, judged=not arguments.alone) for kind, arms, k in kinds]
            for name in plans
        ]
        for name, (quiet, slow) in zip(plans, runs, strict=True):
            sys.stdout.write(row(name, quiet.result(), slow.result(), arguments.false))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
