"""When a fleet's arms need replays: the study reads the daemon's own decision."""

import numpy as np
import pytest

from evidence.production import DAILY_UNTIL, PLANS, Needs, Plan, ProductionSettings, played, row
from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.judge.settings import AssessSettings
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import COMPARABLE

SCHEDULE = ScheduleSettings(replay="when_needed", learning_days=14.0, unobserved_days=7.0, at_most_days=30.0)
ALL, NONE, FIRST = np.ones((1, 2), dtype=bool), np.zeros((1, 2), dtype=bool), np.array([[True, False]])
QUIET = np.full((1, 2), -1.0)


@pytest.fixture
def learnt():
    """One arm with two joints after its learning days, the last replay on day 20."""
    needs = Needs(1, 2)
    assert needs.at(0, SCHEDULE).all()
    needs.replayed(20, ALL, QUIET, NONE)
    return needs


def test_a_joint_that_production_never_moves_is_replayed_after_unobserved_days_and_one_that_it_does_after_at_most_days(learnt):
    moved = Needs(1, 2)
    moved.replayed(20, ALL, QUIET, NONE)
    for day in range(21, 50):
        assert learnt.at(day, SCHEDULE).all() == (day >= 27)
        assert not moved.at(day, SCHEDULE).any()
        learnt.worked(day + 0.4, FIRST, QUIET, QUIET, NONE)
        moved.worked(day + 0.4, ALL, QUIET, QUIET, NONE)
    assert moved.at(50, SCHEDULE).all()


def test_what_production_suspects_or_finds_asks_until_a_replay_and_an_alert_that_is_raised_asks_no_more(learnt):
    learnt.worked(20.4, ALL, QUIET, QUIET, FIRST)
    assert not learnt.at(21, SCHEDULE).any()  # the last replay was yesterday
    assert learnt.at(22, SCHEDULE).all()
    learnt.worked(22.4, NONE, QUIET, QUIET, NONE)  # a day without work ends no suspicion
    assert learnt.asked(23).all()
    learnt.replayed(23, ALL, QUIET, NONE)
    assert not learnt.at(24, SCHEDULE).any()
    wanted = np.where(FIRST, 0.0, -1.0)
    learnt.worked(24.4, ALL, QUIET, wanted, NONE)
    assert learnt.at(25, SCHEDULE).all()
    learnt.replayed(25, ALL, wanted, NONE)
    learnt.worked(25.4, ALL, QUIET, wanted, NONE)
    assert not learnt.at(26, SCHEDULE).any()


def test_a_suspicion_that_lasts_asks_on_every_second_day(learnt):
    """Each replay ends it, and the work of the day after makes wear likely again."""
    replayed, asked = [], []
    for day in range(21, 31):
        learnt.worked(day - 0.6, ALL, QUIET, QUIET, FIRST)
        if learnt.asked(day).all():
            asked.append(day)
        if learnt.at(day, SCHEDULE).all():
            learnt.replayed(day, ALL, QUIET, NONE)
            replayed.append(day)
    assert replayed == asked == [22, 24, 26, 28, 30]


def test_a_replay_in_doubt_asks_for_the_next_one_and_that_one_ends_the_doubt_or_goes_on(learnt):
    learnt.replayed(21, ALL, QUIET, FIRST)
    assert learnt.at(22, SCHEDULE).all()
    learnt.worked(21.4, ALL, QUIET, QUIET, NONE)  # work tells nothing of the joint in doubt
    assert learnt.at(22, SCHEDULE).all()
    learnt.replayed(22, ALL, QUIET, NONE)
    assert not learnt.at(23, SCHEDULE).any()


def test_an_arm_whose_production_tells_of_every_joint_replays_seldom_once_it_is_learnt():
    """Two arms and a month: at most 12 replays each, of 30."""
    schedule = ScheduleSettings(replay="when_needed", learning_days=DAILY_UNTIL)
    production = ProductionSettings(blind_joints=0, seldom=0.95)
    fleet = FleetSettings(arms=2, days=DAILY_UNTIL + 31, seed=5, scenarios=COMPARABLE)
    found = played(fleet, None, production, Plan(production=True, schedule=schedule), AssessSettings())
    assert 1.0 <= found["replays_a_year"] * 31.0 / 365.0 <= 12.0


def test_the_table_says_replays_minutes_and_delays():
    quiet = {"replays_a_year": 36.0, "per_year": 0.1, "at_most": 0.16}
    step = {"median_days": 9.0, "median_days_where_production_tells": 8.5, "median_days_where_it_never_does": None}
    text = row("few", quiet, step, {"median_days": 140.0}, 360.0)
    assert text == "| few | 36 (10 %) | 1.5 | 9; 8; – | 140 | 0.10 (0.16) |\n"
    assert next(iter(PLANS.values())) == Plan()  # robot time is compared with daily replays
