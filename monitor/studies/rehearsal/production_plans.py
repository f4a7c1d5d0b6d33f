"""The table of `docs/production.md`: what few replays beside ordinary work are worth, and what they cost, beside daily replays.

Every plan plays the same arms: those of one seed, once without wear, once with a step of 5 %, once with 10 % a year. Wear begins on any day
from the end of the learning days to the day 425, as on the performance card.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.assess import AssessSettings
from monitor.studies.figures import DAYS_A_YEAR, at_least_one
from monitor.studies.rehearsal.detection import LATEST_ONSET, days_to_play, onsets
from monitor.studies.rehearsal.fleet import REPLAY_MIN, FleetSettings
from monitor.studies.rehearsal.in_production import DAILY_UNTIL, Plan, ProductionSettings, played
from monitor.studies.rehearsal.play import COMPARABLE

STEP, PER_YEAR = 0.05, 0.10


def when_needed(**settings: Any) -> Plan:
    """The daemon's own decision; replays are daily in as many days as with the other plans."""
    return Plan(production=True, schedule=ScheduleSettings(replay="when_needed", learning_days=DAILY_UNTIL, **settings))


PLANS = {
    "a replay a day": Plan(),
    "a replay a week, and work": Plan(every_days=7, production=True),
    "a replay a month, and work": Plan(every_days=30, production=True),
    "`when_needed`": when_needed(),
    "`when_needed`, `untold_days = 30`": when_needed(untold_days=30.0),
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
    """`python -m monitor.studies.rehearsal.work_plans [--seed S] [--quiet N] [--step N] [--slow N]`."""
    parser = argparse.ArgumentParser(prog="python -m monitor.studies.rehearsal.work_plans", description=__doc__)
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
