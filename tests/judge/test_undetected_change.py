"""Undetected changes: their uncertainty grows with the evidence, and ends with the detection."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm

from monitor.judge.alerts.states import unseen_steps
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import STEP
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.learn import begin, learn
from monitor.judge.temperature.laws import TemperatureSettings

DRIFT, LAWS = DriftSettings(), TemperatureSettings()


def lived(wear_per_day: float, days: int, onset: int = 60) -> list[Belief]:
    """The belief of every day; joint 3 wears from `onset` on."""
    arm = Arm(seed=1, autocorrelation=0.5)
    belief, beliefs = None, []
    for day in range(days):
        worn = np.array([0.0, 0.0, wear_per_day * max(day - onset, 0), 0.0, 0.0, 0.0])
        replay, at = arm.replay(30.0, worn), START_S + day * DAY_S
        belief = belief or begin("ur5", CONTEXT, replay, at, settings=DRIFT, laws=LAWS)
        belief = learn(belief, replay, CONTEXT, at, settings=DRIFT, laws=LAWS).belief
        beliefs.append(belief)
    return beliefs


@pytest.mark.slow
def test_the_uncertainty_of_wear_grows_before_a_detection_and_is_the_filters_after_it():
    """0.1 % a day in joint 3: before the detection the published wear is less certain and nearer to the truth; after it both are equal."""
    beliefs = lived(0.001, 130)
    found = next(day for day, belief in enumerate(beliefs) if day > 60 and belief.event[2] == STEP)
    before, after = beliefs[found - 1], beliefs[found]
    mean, std = before.wear_with_undetected(DRIFT)
    truth = np.log1p(0.001 * (found - 1 - 60))
    assert std[2] > 1.5 * before.wear_std[2]
    assert abs(mean[2] - truth) < abs(before.wear[2] - truth)
    assert abs(mean[2] - truth) < 1.645 * std[2]
    mean, std = after.wear_with_undetected(DRIFT)
    assert np.allclose([mean[2], std[2]], [after.wear[2], after.wear_std[2]], rtol=1e-9)


@pytest.mark.slow
def test_a_healthy_joint_has_the_uncertainty_of_one_that_may_wear():
    """Less than 2 % after 90 days, where the filter alone has 0.14 %; with a prior rate of 0 onsets, exactly the filter's."""
    belief = lived(0.0, 90)[-1]
    mean, std = belief.wear_with_undetected(DRIFT)
    assert np.all(std >= belief.wear_std)
    assert np.all(std < 0.02)
    assert np.all(np.abs(mean) < 2.5 * std)
    mean, std = belief.wear_with_undetected(replace(DRIFT, onsets_per_year=0.0))
    assert np.allclose(mean, belief.wear, rtol=0, atol=1e-15)  # rounding
    assert np.allclose(std, belief.wear_std, rtol=1e-12)


def observation(y: np.ndarray) -> Observation:
    """A replay at 30 °C with the log torques y (N,)."""
    N, torque = len(y), np.exp(y)
    return Observation(y, np.full(N, 1e-5), np.full(N, 30.0), np.full(N, 0.4), np.zeros(N), 0.6 * torque, torque)


def test_nothing_is_told_of_a_fresh_step_before_ten_days():
    """Nor, in the words of all joints, where documents of an older release lack the figure."""
    belief = lived(0.0, 8)[-1]
    assert np.isnan(belief.unseen_step(DRIFT).log_rise).all()
    assert unseen_steps([{"joint": 1}, {"joint": 2, "unseen_step": None}]) is None
    told = unseen_steps([{"joint": 1, "unseen_step": 0.042, "unseen_step_days": 10.0}])
    assert "one of the last 10 days may be unseen up to Base 4%" in told.text
