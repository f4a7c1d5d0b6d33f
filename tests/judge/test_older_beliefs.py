"""A belief that an earlier version stored after a year is read, and goes on without an alert that nothing caused."""

import json
import lzma
from pathlib import Path

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm

from monitor.judge.alerts.documents import health_from_document
from monitor.judge.alerts.rules import judge
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.belief import belief_from_document
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.learn import learn
from monitor.judge.temperature.laws import TemperatureSettings

STORED = Path(__file__).parent / "stored" / "2026-11-22-year-with-a-worn-joint.json.xz"  # joint 3 stepped by 12 % on day 250, and was told
YEAR = 365


def goes_on(wear_of_day, days):
    """Transitions of further days after the stored year: (day, kind, joint, condition, tier), and the last belief."""
    stored = json.loads(lzma.decompress(STORED.read_bytes()))
    belief, health = belief_from_document(stored["belief"]), health_from_document(stored["health"])
    arm, transitions = Arm(seed=42, noise=0.02, autocorrelation=0.5), []
    settings, laws, limits = DriftSettings(), TemperatureSettings(), HealthSettings()
    for day in range(YEAR, YEAR + days):
        T = 30.0 + 8.0 * np.sin(2 * np.pi * day / 365) + 1.5 * np.sin(day * 1.7) + np.arange(6) * 0.5
        seen = arm.replay(T, wear_of_day(day))
        result = learn(belief, seen, CONTEXT, START_S + day * DAY_S, settings=settings, laws=laws, health=limits)
        belief = result.belief
        judgement = judge(health, belief, limits, result.undeclared, drift=settings)
        health = judgement.health
        transitions += [(day, t.kind, t.alert.joint, t.alert.condition, t.alert.tier) for t in judgement.transitions]
    return transitions, belief


def test_a_year_of_an_earlier_version_goes_on_for_months_without_a_new_alert():
    """The joint that was worn stays worn, and the alert that stood goes on standing."""
    transitions, belief = goes_on(lambda _: np.array([0, 0, 0.12, 0, 0, 0]), 150)
    assert [each for each in transitions if each[1] != "updated"] == []
    assert belief.wear[2] == pytest.approx(np.log(1.12), abs=0.04)


def test_after_a_year_of_an_earlier_version_another_joint_that_wears_is_found_as_soon_as_ever():
    transitions, _ = goes_on(lambda day: np.array([0, 0, 0.12, 0, 0.20 if day >= YEAR + 40 else 0.0, 0]), 60)
    raised = [(day, joint) for day, kind, joint, *_ in transitions if kind == "raised"]
    assert len(raised) == 1
    assert raised[0][1] == 5
    assert raised[0][0] <= YEAR + 40 + 6
