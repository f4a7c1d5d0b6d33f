"""A fleet whose ordinary work is observed: few replays and much work find a step about as soon as daily replays do."""

import numpy as np
import pytest

from evidence.production import PLANS, Plan, ProductionSettings, played
from monitor.judge.settings import AssessSettings
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import COMPARABLE
from monitor.studies.rehearsal.rehearse import onsets

ARMS, DAYS, SEED = 8, 150, 3
NEW = 407  # a seed by which no setting was chosen


def found(plan: Plan, **fleet):
    wear = onsets(ARMS, SEED, step=0.08, latest=100)
    return played(
        FleetSettings(arms=ARMS, days=DAYS, seed=SEED, scenarios=COMPARABLE), wear, ProductionSettings(**fleet), plan, AssessSettings()
    )


@pytest.mark.soak
def test_a_replay_a_week_beside_production_finds_a_step_long_before_a_replay_a_week_alone():
    excited = {"blind_joints": 0, "seldom": 0.95}
    alone, beside = found(Plan(every_days=7), **excited), found(Plan(every_days=7, production=True), **excited)
    assert alone["arms"] == beside["arms"] == ARMS
    assert beside["median_days"] <= 14.0
    assert (alone["median_days"] or np.inf) >= 2.0 * beside["median_days"]
    assert beside["interval_90"] > 0.85


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("plan", "step_days", "replays_a_year"),
    [
        pytest.param("a replay a week, and work", 12.0, 102.0, id="weekly"),
        pytest.param("a replay a month, and work", 16.0, 62.0, id="monthly"),
        pytest.param("`when_needed`, `unobserved_days = 30`", 16.0, 45.0, id="when_needed"),
    ],
)
def test_few_replays_beside_production_warn_as_early_as_daily_ones_and_no_more_often(plan, step_days, replays_a_year):
    """300 robot-years without wear, and 200 arms with a step of 5 %; work that the judge's noise is not.

    A healthy arm has no more replays a year than the plan and fifty that work asks for; where the daemon decides, on an eighth of the days.
    """
    assess = AssessSettings()
    quiet = played(FleetSettings(arms=300, days=425, seed=NEW, scenarios=COMPARABLE), None, ProductionSettings(), PLANS[plan], assess)
    wear = onsets(200, NEW, step=0.05, latest=200)
    step = played(FleetSettings(arms=200, days=280, seed=NEW, scenarios=COMPARABLE), wear, ProductionSettings(), PLANS[plan], assess)
    assert quiet["per_year"] <= 0.15
    assert quiet["replays_a_year"] <= replays_a_year
    assert 0.85 <= quiet["interval_90"] <= 0.98
    assert step["median_days_where_production_tells"] <= step_days
