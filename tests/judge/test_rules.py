"""From belief to states and alerts: when an alert is raised, kept, updated and cleared."""

import json
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import DAY_S, START_S, Arm, fresh

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.alerts.health import Health, health_from_document
from monitor.judge.alerts.life_cycle import acknowledge, shelve
from monitor.judge.alerts.rules import judge, why_not_alerting
from monitor.judge.alerts.states import stale_joints
from monitor.judge.belief import Belief
from monitor.judge.drift.step import ORDINARY
from monitor.judge.friction.states import WEAR
from monitor.judge.settings import AssessSettings, HealthSettings

SETTINGS = AssessSettings()


def belief_on(
    day: float, wear: dict[int, float] | None = None, std: float = 0.005, *, together: float = 0.0, found: bool = True, **changes: object
) -> Belief:
    """A belief of that day. wear : joint → change as a fraction, 0 for joints that are not given; std : of it [log].

    together : what most joints changed together, as a fraction; found : whether the rises were found as changes.
    """
    first = fresh()
    state = deepcopy(first.friction)
    state.replays[:] = 50.0
    for n, fraction in {**{joint - 1: of for joint, of in (wear or {}).items()}, 6: together}.items():
        if fraction < 0.0:  # a fall is of the level: wear counts from there
            state.moved[n], state.moved_var[n], state.fell[n] = np.log1p(fraction), std**2, True
        elif fraction:
            state.x[:, WEAR, n], state.P[:, WEAR, WEAR, n] = np.log1p(fraction), std**2
            state.risen[n] = found and fraction >= SETTINGS.health.advisory_rise
            state.found.odds[n], state.found.needed[n], state.found.began_days[n] = 20_000.0, 11_356.0, 9.0
    standing = {"friction": state, "event": np.full(6, float(ORDINARY)), "inside_range": np.ones(6), "replays": 50}
    return replace(first, at_unix_s=START_S + day * DAY_S, **{**standing, "temperature_c": np.full(6, 30.0), **changes})


def judged(days: list[Belief], health: Health | None = None) -> tuple[Health, list[tuple[int, str, int | None, str, str]]]:
    """Health after these replays, and (replay, kind, joint, condition, tier) of every transition."""
    steps = []
    for i, belief in enumerate(days):
        health, transitions = judge(health, belief, SETTINGS)
        steps += [(i, kind, alert.joint, alert.condition, alert.tier) for kind, alert in transitions]
    assert health is not None
    return health, steps


def test_a_rise_that_was_found_is_told_at_once_by_its_size():
    """12 % ± 0.5 % is of the wear tier, and says how it was found."""
    health, steps = judged([belief_on(0, {3: 0.12})])
    assert steps == [(0, "raised", 3, "wear_rising", "wear")]
    [alert] = health.active_alerts
    assert alert.change == pytest.approx(0.12)
    assert alert.probability > 0.99
    assert "Elbow (joint 3)" in alert.text.text
    assert "+12.0%" in alert.text.text
    assert (
        "chance alone shows as much in a sound joint once in 20000 days at most (11356 are asked for); it had begun 9 ± 0 days before"
        in alert.text.text
    )
    assert alert.action
    assert health.state == health.joints[2].state == "MAINTENANCE_REQUIRED"
    assert [joint.state for joint in health.joints if joint.joint != 3] == ["NORMAL"] * 5


def test_a_joint_outside_the_learnt_temperatures_is_off_spec():
    """Once enough replays are known; its wear is told all the same, since the model knows how unsure its law is there."""
    cold = {"inside_range": np.zeros(6), "temperature_c": np.full(6, 8.0)}
    health, steps = judged([belief_on(0), *[belief_on(day, **cold) for day in (1, 2, 3)]])
    assert {condition for _, _, _, condition, _ in steps} == {"outside_range"}
    assert health.joints[0].state == "OFF_SPEC"
    assert "8.0 °C" in health.joints[0].why.text


def test_a_rise_that_was_not_found_raises_no_alert_however_large_it_looks():
    _, steps = judged([belief_on(day, {3: 0.12}, found=False) for day in range(20)])
    assert steps == []


def test_a_higher_tier_must_be_acknowledged_again():
    """3 % is an advisory, 10 % the wear tier, 40 % the limit. Each step is a transition and removes the earlier acknowledgement."""
    health, steps = judged([belief_on(day, {3: 0.03}) for day in range(3)])
    assert health.joints[2].state == "NORMAL"  # worth knowing, nothing to do
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="seen", at_unix_s=START_S + 3 * DAY_S)
    health, more = judged([belief_on(day, {3: 0.10}) for day in range(4, 7)], health)
    assert health.active_alerts[0].acknowledged_by is None
    health, most = judged([belief_on(day, {3: 0.40}) for day in range(7, 10)], health)
    tiers = [(kind, tier) for _, kind, _, _, tier in steps + more + most]
    assert tiers[0] == ("raised", "advisory")
    assert tiers[-1] == ("updated", "limit")
    assert ("updated", "wear") in tiers
    assert health.state == "FAILURE"


def test_an_alert_clears_once_it_is_acknowledged_and_its_condition_is_gone():
    """Without an acknowledgement it stays active although the wear is gone. Acknowledged, it clears with the next replay."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health, steps = judged([belief_on(day) for day in range(3, 30)], health)
    assert [kind for _, kind, *_ in steps] == ["updated"]  # the change of its figure, once; it is not cleared
    assert health.active_alerts
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="greased", at_unix_s=START_S + 30 * DAY_S)
    assert health.active_alerts
    health, steps = judged([belief_on(31)], health)
    assert [(kind, joint) for _, kind, joint, *_ in steps] == [("cleared", 3)]
    assert not health.active_alerts
    [gone] = health.alerts
    assert gone.cleared_at_unix_s == START_S + 31 * DAY_S
    assert gone.acknowledged_why == "greased"
    assert health.state == "NORMAL"


def test_an_acknowledged_alert_does_not_flap():
    """Wear that alternates between 1.5 % and 2.5 %, about the advisory level of 2 %, causes no transition."""
    health, _ = judged([belief_on(day, {3: 0.025}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="seen", at_unix_s=START_S + 3 * DAY_S)
    health, steps = judged([belief_on(4 + i, {3: 0.015 if i % 2 else 0.025}) for i in range(40)], health)
    assert steps == []
    assert len(health.active_alerts) == 1


def test_an_acknowledged_alert_steps_down_when_wear_recedes():
    """From 12 % to 2 %: the alert falls from the wear tier to an advisory, and the state follows."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="greased", at_unix_s=START_S + 3 * DAY_S)
    health, steps = judged([belief_on(4, {3: 0.02})], health)
    assert steps == [(0, "updated", 3, "wear_rising", "advisory")]
    assert health.state == "NORMAL"


def test_a_cleared_alert_may_come_again():
    """It is not acknowledged."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="greased", at_unix_s=START_S + 3 * DAY_S)
    health, _ = judged([belief_on(4)], health)
    health, steps = judged([belief_on(day, {3: 0.12}) for day in range(5, 8)], health)
    assert steps == [(0, "raised", 3, "wear_rising", "wear")]
    assert health.active_alerts[0].acknowledged_by is None


def test_all_joints_rising_together_is_not_wear():
    """One alert of the arm and no alert of a joint."""
    health, steps = judged([belief_on(day, together=0.05) for day in range(5)])
    assert steps == [(0, "raised", None, "common_mode", "advisory")]
    assert health.state == "CHECK_FUNCTION"
    assert health.active_alerts[0].probability > 0.9


def test_all_joints_falling_together_is_one_alert_of_the_arm():
    """The supply or the gains have changed. A joint that fell by itself has an alert of its own."""
    health, steps = judged([belief_on(day, together=-0.08) for day in range(4)])
    assert [step[1:] for step in steps] == [("raised", None, "common_mode", "advisory")]
    assert "fallen in most joints together, by about -8.0%" in health.active_alerts[0].text.text
    assert health.active_alerts[0].probability > 0.99  # the probability of the fall itself
    assert health.state == "CHECK_FUNCTION"
    _, steps = judged([belief_on(day, {3: -0.12}, together=-0.08) for day in range(4)])
    assert {step[2:4] for step in steps} == {(None, "common_mode"), (3, "friction_falling")}


def test_one_joint_that_rises_beyond_what_all_do_is_reported_beside_them():
    health, steps = judged([belief_on(day, {3: 0.17}, together=0.03) for day in range(5)])
    assert {(joint, condition) for _, _, joint, condition, _ in steps} == {(None, "common_mode"), (3, "wear_rising")}
    [wear] = [alert for alert in health.active_alerts if alert.joint == 3]
    assert wear.change == pytest.approx(0.17)


def test_falling_friction_is_reported_and_is_no_wear():
    """−10 %: the joint was greased or replaced, and its function is to be checked."""
    health, steps = judged([belief_on(day, {2: -0.10}) for day in range(4)])
    assert steps == [(0, "raised", 2, "friction_falling", "advisory")]
    assert health.joints[1].state == "CHECK_FUNCTION"


def test_a_shelved_alert_is_still_active():
    """Programs need not show it for a time; the state stays."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    until = START_S + 20 * DAY_S
    health = shelve(health, 3, "wear_rising", by="Ada", why="part ordered", until_unix_s=until, at_unix_s=START_S + 3 * DAY_S)
    health, _ = judged([belief_on(4, {3: 0.12})], health)
    assert health.active_alerts[0].shelved_until_unix_s == until
    assert health.state == "MAINTENANCE_REQUIRED"


def test_an_acknowledgement_or_shelving_that_is_impossible_is_refused():
    """Where the alert is not active, nobody is named, or the end of shelving lies in the past. The message names the active alerts."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    with pytest.raises(BadInput, match="no active alert j4/wear_rising; active: j3/wear_rising"):
        acknowledge(health, 4, "wear_rising", by="Ada", why="", at_unix_s=START_S)
    with pytest.raises(BadInput, match="name of the person"):
        acknowledge(health, 3, "wear_rising", by=" ", why="", at_unix_s=START_S)
    with pytest.raises(BadInput, match="in the past"):
        shelve(health, 3, "wear_rising", by="Ada", why="", until_unix_s=START_S, at_unix_s=START_S + 1)


def test_health_survives_as_json():
    """Read back from JSON it is equal, and the next judgement is the same."""
    health, _ = judged([belief_on(day, {3: 0.12, 2: -0.1}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="seen", at_unix_s=START_S)
    back = health_from_document(json.loads(json.dumps(health.as_document(), allow_nan=False)))
    assert back == health
    assert judged([belief_on(4)], back) == judged([belief_on(4)], health)
    with pytest.raises(BadInput, match="the key 'state' is missing"):
        health_from_document({"joints": []})
    with pytest.raises(BadInput, match="health"):
        health_from_document({**health.as_document(), "alerts": [{"joint": 1}]})


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"wear_rise": 0.005}, "advisory_rise < wear_rise"),
        ({"wear_sure": 1.0}, "wear_sure"),
        ({"clear_fraction": 1.0}, "clear_fraction"),
        ({"min_days": 0}, "min_days"),
    ],
)
def test_thresholds_out_of_order_are_named(wrong, says):
    """The message contains the key of the configuration."""
    with pytest.raises(BadConfiguration, match=says):
        HealthSettings(**wrong)


def test_a_rise_that_was_found_raises_no_graver_tier_than_its_size_proves():
    """16 % ± 8 % is above 5 % with a probability of 0.91: the wear tier asks for 0.95."""
    assert judged([belief_on(0, {3: 0.16}, std=0.08)])[1] == [(0, "raised", 3, "wear_rising", "advisory")]
    assert judged([belief_on(0, {3: 0.16}, std=0.05)])[1] == [(0, "raised", 3, "wear_rising", "wear")]


def test_who_asks_for_rarer_false_alerts_needs_higher_odds():
    belief, rarer = belief_on(0), AssessSettings(health=HealthSettings(false_alarms_per_year=0.025))
    usual, more = (belief.odds_of_rise(of.friction) for of in (SETTINGS, rarer))
    assert more.limit == pytest.approx(10.0 * usual.limit)
    assert np.allclose(more.needed, 10.0 * usual.needed)


def test_the_reasons_why_a_joint_does_not_alert_are_given_in_the_models_terms():
    """Odds against those that are asked for, why it is more than usual, and what noise is believed to be; at the limit none."""
    health, _ = judged([belief_on(day) for day in range(4)])
    quiet = belief_on(4)
    quiet.friction.odds[0, 2] = 300.0
    reasons = " ".join(each.text for each in why_not_alerting(health, quiet, 3, SETTINGS))
    assert "next is the advisory tier" in reasons
    assert "chance alone comes as far as this joint once in 300 days; a rise is told from 11356 on (61% of the way" in reasons
    assert "noise between replays is believed to be ±" in reasons
    assert "times the usual" not in reasons
    quiet.friction.age_days[:] = 300.0
    quiet.friction.peaks[1, 4] = 9_000.0  # a fall of another joint that chance made
    reasons = " ".join(each.text for each in why_not_alerting(health, quiet, 3, SETTINGS))
    assert "12.8 times the usual 11356: chance has moved this arm's joints by more than noise explains" in reasons
    health, _ = judged([belief_on(day, {3: 0.40}) for day in range(3)])
    assert why_not_alerting(health, belief_on(3, {3: 0.40}), 3, SETTINGS) == ()
    health, _ = judged([belief_on(day, {3: 0.06}) for day in range(3)])
    assert any("P(more than 30%)" in reason.text for reason in why_not_alerting(health, belief_on(3, {3: 0.06}), 3, SETTINGS))


def test_joints_without_a_replay_for_a_week_are_stale():
    """After nine days every joint is stale; after five days none is. The state does not change."""
    health, _ = judged([belief_on(0), belief_on(1)])
    assert stale_joints(health, START_S + 5 * DAY_S, SETTINGS.health) == (False,) * 6
    assert stale_joints(health, START_S + 9 * DAY_S, SETTINGS.health) == (True,) * 6
    assert health.state == "NORMAL"


def test_status_names_the_stale_joints_of_a_stored_health(capsys):
    """One joint without a recent update is named, in JSON and above the table."""
    from monitor.publish.documents import as_json
    from monitor.publish.health_document import health_document
    from monitor.views.terminal.arm import print_status

    health, _ = judged([belief_on(0), belief_on(1)])
    silent = replace(health, joints=(replace(health.joints[0], learnt_at_unix_s=START_S - 3 * DAY_S), *health.joints[1:]))
    stored = health_from_document(silent.as_document())
    document = as_json(health_document(stored, START_S + 5 * DAY_S, SETTINGS.health))
    assert document["stale"] is True
    assert [joint["stale"] for joint in document["joints"]] == [True] + [False] * 5
    assert (document["state"], [joint["state"] for joint in document["joints"]]) == (silent.state, [joint.state for joint in silent.joints])
    print_status(
        {
            "said_at": "2026-01-09T00:00:00Z",
            "robot": "cell-1",
            "model_revision": 2,
            "health": document,
            "friction": [],
            "ledger": [],
        }
    )
    assert "STALE: Base: nothing was learnt for 8 days" in " ".join(capsys.readouterr().out.split())
    fresh = health_document(health, START_S + 5 * DAY_S, SETTINGS.health)
    assert (fresh.stale, fresh.stale_why) == (False, None)


@pytest.mark.slow
def test_a_change_is_attributed_to_its_causes():
    """10 K colder and 10 % of wear: the causes add up to the whole, and each has the size of the simulated cause."""
    from synthetic_arm import History

    from monitor.judge.alerts.states import attribute_changes

    history, rng = History(), np.random.default_rng(3)
    for day in range(80):
        T = (30.0 if day < 10 else 30.0 + 10.0 * rng.uniform(-1, 1)) if day < 79 else 20.0
        history.add(day, Arm(seed=day, noise=0.003).replay(T, np.array([0, 0, 0.1 * (day > 60), 0, 0, 0])))
    parts = attribute_changes(history.last.belief, history.settings.friction)[2]
    assert parts is not None
    assert parts.whole == pytest.approx(parts.temperature + parts.payload + parts.wear + parts.rest, abs=1e-12)
    fv, fc = 9.0 * np.exp(-0.015 * np.array([5.0, -5.0])) * 0.4, 7.0
    assert parts.temperature == pytest.approx(np.log((fc + fv[1]) / (fc + fv[0])), abs=0.006)
    assert parts.wear == pytest.approx(np.log(1.1), abs=0.01)
    assert parts.payload == 0.0
    assert abs(parts.rest) < 0.02
