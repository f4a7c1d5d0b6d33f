"""What stays of an alert: the evidence of its gravest moment, everyone who acknowledged it, and its condition while data are missing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, Arm, History
from test_rules import SETTINGS, belief_on, judged

from monitor.errors import BadInput
from monitor.judge.alerts.health import alert_document, alert_from_document, health_from_document
from monitor.judge.alerts.life_cycle import acknowledge, shelve, unacknowledge, unshelve
from monitor.judge.alerts.rules import judge
from monitor.judge.drift.step import UNRESOLVED

SERIALS = ("a", "b", "c", "d", "e", "f")


def unheard(day: float, joint: int):
    """A belief after a replay that did not resolve this joint, whose wear estimate is meanwhile 0."""
    belief = belief_on(day)
    event = belief.event.copy()
    event[joint - 1] = UNRESOLVED
    return replace(belief, event=event)


def test_the_gravest_moment_stays_with_its_figures_date_and_sentence():
    """Friction rises to 40 % and recedes to 8 %: the alert of today still has the evidence of the day at the limit."""
    worn = [belief_on(day, {3: 0.12}) for day in range(3)] + [belief_on(day, {3: 0.40}) for day in range(3, 6)]
    health, _ = judged(worn)
    [at_limit] = health.active_alerts
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="", at_unix_s=worn[-1].at_unix_s)
    health, _ = judged([belief_on(6, {3: 0.08})], health)
    [now] = health.active_alerts
    assert now.tier == "wear"
    assert now.change == pytest.approx(0.08)
    assert now.gravest is not None
    assert now.gravest.tier == "limit"
    assert now.gravest.change == pytest.approx(0.40)
    assert now.gravest.at_unix_s == at_limit.updated_at_unix_s
    assert now.gravest.text == at_limit.text
    again = health_from_document(json.loads(json.dumps(health.as_document())))
    assert again.active_alerts == health.active_alerts


def test_a_new_serial_number_attributes_nothing_to_the_context():
    """After a change of serial numbers no figure is the absolute logarithm of a torque: +1124 % was log 12.24."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0, 0.5 * (day >= 15), 0, 0, 0])), replace(CONTEXT, joint_serials=SERIALS))
    assert [alert.joint for alert in history.health.active_alerts] == [3]
    renewed = replace(CONTEXT, joint_serials=("a", "b", "NEW", "d", "e", "f"))
    for day in range(40, 46):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0, -0.1, 0, 0, 0])), renewed)
        for alert in history.health.alerts:
            if alert.attribution is not None:
                assert all(abs(part) < 1.0 for part in alert.attribution), alert
            assert "1124" not in alert.text.text


def test_the_first_acknowledgement_stays_and_later_ones_are_appended():
    """Ada acknowledged first; Bob's acknowledgement is kept beside hers."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="grease is ordered", at_unix_s=1.0)
    health = acknowledge(health, 3, "wear_rising", by="Bob", why="seen too", at_unix_s=2.0)
    [alert] = health.active_alerts
    assert (alert.acknowledged_by, alert.acknowledged_why, alert.acknowledged_at_unix_s) == ("Ada", "grease is ordered", 1.0)
    assert [(one.by, one.why) for one in alert.acknowledgements] == [("Ada", "grease is ordered"), ("Bob", "seen too")]
    assert alert_from_document(json.loads(json.dumps(alert_document(alert)))) == alert


def test_an_acknowledgement_and_a_shelving_can_be_taken_back():
    """Afterwards the alert waits for a person again and does not clear by itself; who acknowledged it and who took it back stays."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    with pytest.raises(BadInput, match=r"^j3/wear_rising is not acknowledged"):
        unacknowledge(health, 3, "wear_rising", by="Ada", why="", at_unix_s=1.0)
    with pytest.raises(BadInput, match=r"^j3/wear_rising is not shelved"):
        unshelve(health, 3, "wear_rising", by="Ada", at_unix_s=1.0)
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="wrong joint", at_unix_s=1.0)
    health = shelve(health, 3, "wear_rising", by="Ada", why="", until_unix_s=1e12, at_unix_s=1.5)
    health = unacknowledge(health, 3, "wear_rising", by="Bob", why="it was joint 4", at_unix_s=2.0)
    health = unshelve(health, 3, "wear_rising", by="Bob", at_unix_s=2.0)
    [alert] = health.active_alerts
    assert alert.acknowledged_at_unix_s is None
    assert alert.acknowledged_by is None
    assert alert.shelved_until_unix_s is None
    [one] = alert.acknowledgements
    assert (one.by, one.undone_by, one.undone_why, one.undone_at_unix_s) == ("Ada", "Bob", "it was joint 4", 2.0)
    health, _ = judged([belief_on(3)], health)
    assert health.active_alerts, "latched: nobody has acknowledged it"


def test_a_replay_without_data_of_the_joint_does_not_clear_its_acknowledged_alert():
    """The replay resolves every joint but the third: its alert stays. The next replay that has data clears it."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="", at_unix_s=belief_on(3).at_unix_s)
    after = judge(health, unheard(3, 3), SETTINGS)
    assert [alert.key for alert in after.health.active_alerts] == [(3, "wear_rising")]
    assert not judge(after.health, belief_on(4), SETTINGS).health.active_alerts


def test_a_replay_without_temperature_ends_no_condition_of_the_temperature():
    """`outside_range` is raised in the cold; a replay without a temperature says nothing about it; a warm replay ends it."""
    cold = {"inside_range": np.zeros(6), "temperature_c": np.full(6, 8.0)}
    unknown = {"inside_range": np.zeros(6), "temperature_c": np.full(6, np.nan)}
    health, _ = judged([belief_on(day, **cold) for day in range(3)])
    for alert in health.active_alerts:
        health = acknowledge(health, alert.joint, alert.condition, by="Ada", why="", at_unix_s=1.0)
    held, _ = judged([belief_on(3, **unknown)], health)
    assert {alert.condition for alert in held.active_alerts} == {"outside_range"}
    assert not [alert for alert in judged([belief_on(4)], held)[0].active_alerts if alert.condition == "outside_range"]


def test_an_arm_with_a_notice_does_not_say_that_all_is_as_at_the_beginning():
    """A rise of 3 % needs no action, but the arm's sentence names the joint."""
    health, _ = judged([belief_on(day, {3: 0.03}) for day in range(4)])
    [alert] = health.active_alerts
    assert (alert.tier, health.state) == ("advisory", "NORMAL")
    assert health.why.text.startswith("no action is needed; Elbow (joint 3): friction +3.0%")
