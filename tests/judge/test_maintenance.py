"""Work on a joint: an honest repair clears its alert, and a repair that did not help does not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, History

from monitor.judge.alerts.health import Transition
from monitor.judge.alerts.life_cycle import declare
from monitor.judge.alerts.rules import why_not_alerting
from monitor.judge.belief import belief_from_document
from monitor.judge.drift.maintenance import GREASED, NEW_JOINT, NEW_REFERENCE, OVERHAULED, REPLACED, STILL_WORN, Maintenance
from monitor.judge.maintenance import begin_maintenance, with_new_joints

SERIALS = ("a", "b", "c", "d", "e", "f")
WORN_DAY, PRODUCTION_DAY = 20, 40


def lived(joint: int, worn: float, *, context=CONTEXT, until: int = PRODUCTION_DAY) -> History:
    """An arm of which one joint wore by a fraction at once on day 20."""
    history = History()
    wear = np.zeros(6)
    for day in range(until):
        wear[joint - 1] = worn if day >= WORN_DAY else 0.0
        history.add(day, Arm(seed=day).replay(30.0, wear), context)
    return history


def serviced(history: History, joint: int, kind: str, day: float) -> list[Transition]:
    """Work declared between two replays, as the command does it."""
    at = START_S + day * DAY_S
    act = Maintenance(joint, kind, at, at, "Ada", "it was noisy")
    belief, maintenance = begin_maintenance(history.last.belief, (act,), history.settings)
    belief = with_new_joints(belief, maintenance, history.settings)
    health, transitions = declare(history.health, maintenance, at)
    belief = belief_from_document(json.loads(json.dumps(belief.as_document())))
    history.last, history.health = replace(history.last, belief=belief, health=health), health
    return list(transitions)


def after(history: History, joint: int, worn: float, days: range, context=CONTEXT) -> dict[int, list]:
    """Replays after the work; returns the works that they declared or judged, by day."""
    wear, maintenance = np.zeros(6), {}
    wear[joint - 1] = worn
    for day in days:
        verdict = history.add(day, Arm(seed=1000 + day).replay(30.0, wear), context)
        if verdict.maintenance:
            maintenance[day] = list(verdict.maintenance)
    return maintenance


def rises(history: History, joint: int) -> list:
    """Active alerts of the joint's friction."""
    return [alert for alert in history.health.active_alerts if alert.joint == joint]


def test_a_replaced_joint_has_no_alert_at_once_and_everything_is_learnt_anew():
    """J3 at +50 %, FAILURE, renewed: the alert clears with its evidence, the joint is normal, and its new level, 10 % lower, is no fall."""
    history = lived(3, 0.5)
    [alert] = rises(history, 3)
    assert history.health.joints[2].state == "FAILURE"
    [cleared] = serviced(history, 3, REPLACED, 39.5)
    assert (cleared.kind, cleared.alert.serviced_by) == ("cleared", "Ada")
    assert cleared.alert.cleared_why.text.startswith("serviced")
    assert cleared.alert.gravest.tier == "limit"
    assert cleared.alert.gravest.text == alert.gravest.text
    assert history.health.state == "NORMAL"
    assert history.last.belief.maintenance[0].outcome == NEW_JOINT
    assert history.last.belief.learnt_replays[2] == 0
    before = history.last.belief.wear[[0, 1, 3, 4, 5]]
    after(history, 3, -0.1, range(40, 70))
    assert not rises(history, 3)
    assert abs(history.last.friction[2].wear) < 0.03
    assert np.allclose(history.last.belief.wear[[0, 1, 3, 4, 5]], before, atol=0.03)
    assert not [each for each in history.transitions if each[0] >= 40]


@pytest.mark.parametrize("kind", [OVERHAULED, pytest.param(GREASED, marks=pytest.mark.soak)])
@pytest.mark.slow
def test_a_serviced_joint_waits_for_its_proof_and_is_normal_once_replays_have_shown_it(kind):
    """J2 at +29.6 % is overhauled and falls to 3 % below what it was: three replays later its alert clears, and friction counts anew."""
    history = lived(2, 0.296)
    [waiting] = serviced(history, 2, kind, 39.5)
    assert (waiting.kind, waiting.alert.active, waiting.alert.awaiting_proof) == ("serviced", True, True)
    assert history.health.joints[1].state == "CHECK_FUNCTION"
    [why] = why_not_alerting(history.health, history.last.belief, 2, history.settings)
    assert "The next replays show what it did" in why.text
    maintenance = after(history, 2, -0.03, range(40, 70))
    assert list(maintenance) == [42]
    assert maintenance[42][0].outcome == NEW_REFERENCE
    assert maintenance[42][0].change == pytest.approx(0.97 / 1.296 - 1.0, abs=0.05)
    assert not rises(history, 2)
    [cleared] = [alert for alert in history.health.alerts if alert.joint == 2]
    assert cleared.cleared_why.text.startswith("serviced: Shoulder (joint 2) was " + kind)
    assert cleared.gravest.change > 0.25
    assert history.health.joints[1].state == "NORMAL"
    assert f"since it was {kind} on 2025-07-25" in history.health.joints[1].why.text
    assert abs(history.last.friction[1].wear) < 0.03
    assert {each[1:4] for each in history.transitions if each[0] >= 40} == {("cleared", 2, "sudden_step")}


def test_production_that_did_not_bring_friction_back_leaves_the_alert_and_says_so():
    """J2 is greased and stays at +30 %: after three replays its alert is what it was, with its wear, and asks to look again."""
    history = lived(2, 0.30)
    serviced(history, 2, GREASED, 39.5)
    maintenance = after(history, 2, 0.30, range(40, 43))
    assert maintenance[42][0].outcome == STILL_WORN
    [alert] = rises(history, 2)
    assert not alert.awaiting_proof
    assert "not brought its friction back" in alert.text.text
    assert "Look at this joint again" in alert.action.text
    after(history, 2, 0.30, range(43, 50))
    [alert] = rises(history, 2)
    assert "greased on 2025-07-25 by Ada" in alert.text.text
    assert history.last.friction[1].wear == pytest.approx(0.30, abs=0.05)
    assert history.health.joints[1].state == ("FAILURE" if alert.tier == "limit" else "MAINTENANCE_REQUIRED")


@pytest.mark.slow
def test_a_healthy_joint_that_is_greased_has_a_new_level_and_no_alert():
    """New grease lowers friction by 15 %: no fall is told, and wear of 20 % from there is found as such."""
    history = lived(3, 0.0)
    assert serviced(history, 3, GREASED, 39.5) == []
    after(history, 3, -0.15, range(40, 70))
    assert not history.health.active_alerts
    assert not history.transitions
    after(history, 3, -0.15 + 0.2 * 0.85, range(70, 90))
    [alert] = rises(history, 3)
    assert alert.change == pytest.approx(0.2, abs=0.05)


def test_serial_numbers_declared_first_after_a_repair_clear_the_alert_by_what_replays_show():
    """J3 at +50 %, renewed, `joint_serials` declared for the first time: the failure ends. A serial alone proves nothing of joint 2."""
    history = History()
    for day in range(PRODUCTION_DAY):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0.2, 0.5, 0, 0, 0]) * (day >= WORN_DAY)))
    assert sorted(alert.joint for alert in history.health.active_alerts) == [2, 3]
    declared = replace(CONTEXT, joint_serials=SERIALS)
    for day in range(PRODUCTION_DAY, PRODUCTION_DAY + 20):
        history.add(day, Arm(seed=1000 + day).replay(30.0, np.array([0, 0.2, -0.05, 0, 0, 0])), declared)
        if day == PRODUCTION_DAY:
            assert history.health.joints[2].state == "CHECK_FUNCTION"
    assert [alert.joint for alert in history.health.active_alerts] == [2]
    assert history.health.joints[2].state == "NORMAL"
    assert history.last.friction[1].wear == pytest.approx(0.2, abs=0.04)


def test_production_declared_by_maintenance_clears_the_alert_of_the_joint_that_it_helped():
    """J2 at +29.6 % is overhauled and declared by `maintenance` alone: its alert clears; J5, worn by 10 % as before, keeps its own."""
    history = History()
    for day in range(PRODUCTION_DAY):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0.296, 0, 0, 0.1, 0]) * (day >= WORN_DAY)))
    declared = replace(CONTEXT, maintenance="2025-07-26 joint 2 overhauled")
    for day in range(PRODUCTION_DAY, PRODUCTION_DAY + 20):
        verdict = history.add(day, Arm(seed=1000 + day).replay(30.0, np.array([0, 0.02, 0, 0, 0.1, 0])), declared)
        if day == PRODUCTION_DAY:
            assert any("work may have moved friction either way" in warning.text for warning in verdict.warnings)
    assert [alert.joint for alert in history.health.active_alerts] == [5]
    assert history.health.joints[1].state == "NORMAL"
    assert len(history.last.belief.contexts) == 1


def test_a_new_serial_number_clears_the_alerts_of_that_joint_alone():
    """Joints 2 and 5 have worn by 20 %, joint 2 is another one: its alert clears with the replay that declares it."""
    history = History()
    context = replace(CONTEXT, joint_serials=SERIALS)
    for day in range(PRODUCTION_DAY):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0.2, 0, 0, 0.2, 0]) * (day >= WORN_DAY)), context)
    renewed = replace(CONTEXT, joint_serials=("a", "B2", "c", "d", "e", "f"))
    verdict = history.add(PRODUCTION_DAY, Arm(seed=999).replay(30.0, np.array([0, -0.1, 0, 0, 0.2, 0])), renewed)
    assert [(each.kind, each.alert.joint) for each in verdict.transitions] == [("cleared", 2)]
    assert "is of the old one" in verdict.transitions[0].alert.text.text
    assert [alert.joint for alert in history.health.active_alerts] == [5]
