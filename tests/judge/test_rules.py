"""From belief to states and alerts: when an alert is raised, kept, updated and cleared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.alerts.health import Health, health_from_document
from monitor.judge.alerts.life_cycle import acknowledge, shelve
from monitor.judge.alerts.rules import judge, why_not_alerting
from monitor.judge.alerts.states import stale_joints
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import ORDINARY, RATE, WEAR
from monitor.judge.drift.from_production import begin_production
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.learn import begin
from monitor.judge.settings import HealthSettings
from monitor.judge.temperature.laws import TemperatureSettings

SETTINGS = HealthSettings()


def belief_on(day: float, wear: dict[int, float] | None = None, std: float = 0.005, **changes: object) -> Belief:
    """A belief of that day. wear : joint → wear as a fraction, 0 for joints that are not given; std : of the wear of every joint."""
    fresh = begin("ur5", CONTEXT, Arm().replay(30.0), START_S, settings=DriftSettings(), laws=TemperatureSettings())
    mean, cov = fresh.filter_state.mean.copy(), np.zeros_like(fresh.filter_state.cov)
    for joint, fraction in (wear or {}).items():
        mean[joint - 1, WEAR] = np.log1p(fraction)
    cov[:, WEAR, WEAR], cov[:, RATE, RATE] = std**2, 1e-8
    filter_state = replace(fresh.filter_state, mean=mean, cov=cov, event=np.full(6, float(ORDINARY)), replays=np.full(6, 50.0))
    standing = {"filter_state": filter_state, "inside_range": np.ones(6), "temperature_c": np.full(6, 30.0), "replays": 50}
    return replace(fresh, at_unix_s=START_S + day * DAY_S, **{**standing, **changes})


def judged(days: list[Belief], health: Health | None = None) -> tuple[Health, list[tuple[int, str, int | None, str, str]]]:
    """Health after these replays, and (replay, kind, joint, condition, tier) of every transition."""
    steps = []
    for i, belief in enumerate(days):
        health, transitions = judge(health, belief, SETTINGS)
        steps += [(i, kind, alert.joint, alert.condition, alert.tier) for kind, alert in transitions]
    assert health is not None
    return health, steps


def test_wear_is_reported_at_the_third_replay_that_agrees():
    """12 % ± 0.5 % of wear reaches the wear tier in the first replay. The alert is raised after three replays."""
    health, steps = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    assert steps == [(2, "raised", 3, "wear_rising", "wear")]
    [alert] = health.active_alerts
    assert alert.change == pytest.approx(0.12)
    assert alert.probability > 0.99
    assert "Elbow (joint 3)" in alert.text.text
    assert "+12.0%" in alert.text.text
    assert alert.action
    assert health.state == health.joints[2].state == "MAINTENANCE_REQUIRED"
    assert [joint.state for joint in health.joints if joint.joint != 3] == ["NORMAL"] * 5


def test_three_replays_of_one_day_are_one_days_evidence():
    """Six replays within one day raise no alert. The first replay of the next day does."""
    _, steps = judged([belief_on(0.1 + hour / 24, {3: 0.12}) for hour in range(6)] + [belief_on(1.1, {3: 0.12})])
    assert [step[0] for step in steps] == [6]


def test_a_replay_that_disagrees_begins_the_count_again():
    """Two replays agree, one does not, two agree: no alert is raised."""
    _, steps = judged([belief_on(day, {3: 0.0 if day == 2 else 0.12}) for day in range(5)])
    assert steps == []


def test_replays_outside_the_learnt_temperatures_count_for_nothing():
    """They neither confirm nor contradict wear. The joint is OFF_SPEC, since enough replays are known."""
    cold = {"inside_range": np.zeros(6), "temperature_c": np.full(6, 8.0)}
    days = [belief_on(0, {3: 0.12}), *[belief_on(day, {3: 0.12}, **cold) for day in (1, 2, 3)]]
    health, steps = judged(days)
    assert {condition for _, _, _, condition, _ in steps} == {"outside_range"}
    assert health.joints[0].state == "OFF_SPEC"
    assert "8.0 °C" in health.joints[0].why.text
    _, steps = judged([belief_on(4, {3: 0.12}), belief_on(5, {3: 0.12})], health)
    assert [step[0] for step in steps if step[3] == "wear_rising"] == [1]  # with the one of day 0 these are three


def test_an_uncertain_rise_raises_no_alert():
    """6 % ± 4 %: P(wear > 5 %) is 0.6 and P(wear > 1 %) is 0.9; both are too small for an alert."""
    _, steps = judged([belief_on(day, {3: 0.06}, std=0.04) for day in range(20)])
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
    """Wear that alternates between 0.8 % and 1.8 %, about the advisory level of 1 %, causes no transition."""
    health, _ = judged([belief_on(day, {3: 0.025}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="seen", at_unix_s=START_S + 3 * DAY_S)
    health, steps = judged([belief_on(4 + i, {3: 0.008 if i % 2 else 0.018}) for i in range(40)], health)
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
    """It takes three replays again, and is not acknowledged."""
    health, _ = judged([belief_on(day, {3: 0.12}) for day in range(3)])
    health = acknowledge(health, 3, "wear_rising", by="Ada", why="greased", at_unix_s=START_S + 3 * DAY_S)
    health, _ = judged([belief_on(4)], health)
    health, steps = judged([belief_on(day, {3: 0.12}) for day in range(5, 8)], health)
    assert steps == [(2, "raised", 3, "wear_rising", "wear")]
    assert health.active_alerts[0].acknowledged_by is None


def test_all_joints_rising_together_is_not_wear():
    """4–6 % in every joint: one alert of the arm and no alert of a joint."""
    shared = {j + 1: 0.05 + 0.002 * (j - 2.5) for j in range(6)}
    health, steps = judged([belief_on(day, shared) for day in range(5)])
    assert steps == [(2, "raised", None, "common_mode", "advisory")]
    assert health.state == "CHECK_FUNCTION"
    assert health.active_alerts[0].probability > 0.9


def test_all_joints_falling_together_is_one_alert_of_the_arm():
    """The supply or the gains have changed. A joint that fell much more than the others has an alert of its own."""
    health, steps = judged([belief_on(day, dict.fromkeys(range(1, 7), -0.08)) for day in range(4)])
    assert [step[1:] for step in steps] == [("raised", None, "common_mode", "advisory")]
    assert "fallen in most joints together, by about -8.0%" in health.active_alerts[0].text.text
    assert health.active_alerts[0].probability > 0.99  # the probability of the fall itself
    assert health.state == "CHECK_FUNCTION"
    _, steps = judged([belief_on(day, {**dict.fromkeys(range(1, 7), -0.08), 3: -0.2}) for day in range(4)])
    assert {step[2:4] for step in steps} == {(None, "common_mode"), (3, "friction_falling")}
    # the joint that did not fall has not risen either
    _, steps = judged([belief_on(day, {**dict.fromkeys(range(1, 7), -0.08), 3: 0.0}) for day in range(4)])
    assert {step[2:4] for step in steps} == {(None, "common_mode")}


def test_one_joint_that_rises_more_than_the_others_is_reported_beside_them():
    """All joints rise by 3 % and joint 3 by 20 %: the alert of joint 3 has the change beyond the common rise."""
    shared = {j + 1: 0.03 for j in range(6)} | {3: 0.20}
    health, steps = judged([belief_on(day, shared) for day in range(5)])
    assert {(joint, condition) for _, _, joint, condition, _ in steps} == {(None, "common_mode"), (3, "wear_rising")}
    [wear] = [alert for alert in health.active_alerts if alert.joint == 3]
    assert wear.change == pytest.approx(1.20 / 1.03 - 1)


def test_falling_friction_is_reported_and_is_no_wear():
    """−10 %: the joint was greased or replaced, and its function is to be checked."""
    health, steps = judged([belief_on(day, {2: -0.10}) for day in range(4)])
    assert steps == [(2, "raised", 2, "friction_falling", "advisory")]
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


def with_rise(sigmas: float, *, found: bool, excess: float = 0.03) -> Belief:
    """A belief of an arm whose work is observed. Joint 3 has risen, its size is known to so many σ, and 40 observations agree.

    found : whether the rise was found as a change.
    """
    belief = belief_on(40, {3: excess}, std=np.log1p(excess) / sigmas)
    state = begin_production(belief.filter_state, 6, DriftSettings())
    of_joint = np.arange(6) == 2
    sources = replace(state.sources, risen=np.where(of_joint, float(found), 0.0))
    return replace(belief, filter_state=replace(state, sources=sources, agreeing=np.where(of_joint, 40.0, 1.0)))


def test_a_rise_that_was_found_is_an_advisory_although_its_size_is_less_sure():
    assert judged([with_rise(2.6, found=False)])[1] == []
    assert judged([with_rise(2.4, found=True)])[1] == []
    assert judged([with_rise(2.6, found=True)])[1] == [(0, "raised", 3, "wear_rising", "advisory")]


def test_a_rise_that_was_found_raises_no_graver_tier_than_its_size_proves():
    """16 % ± 6 % is above 5 % with a probability of 0.96; its own standard deviations are too few for the wear tier."""
    assert judged([with_rise(2.6, found=True, excess=0.16)])[1] == [(0, "raised", 3, "wear_rising", "advisory")]
    assert judged([with_rise(3.1, found=True, excess=0.16)])[1] == [(0, "raised", 3, "wear_rising", "wear")]


def test_who_asks_for_rarer_false_alerts_gets_no_advisory_of_a_rise_that_is_less_sure():
    rarer = HealthSettings(false_alarms_per_year=0.001)  # 4.1 σ, 3.4 σ of a rise that was found
    assert judge(None, with_rise(3.3, found=True), rarer)[1] == ()
    assert [kind for kind, _ in judge(None, with_rise(3.5, found=True), rarer)[1]] == ["raised"]


@pytest.mark.parametrize(
    ("sigmas", "found", "says"), [(2.4, True, "2.4 of its standard deviations; 2.5"), (2.6, False, "2.6 of its standard deviations; 3.0")]
)
def test_the_reason_against_an_advisory_names_what_a_rise_needs(sigmas, found, says):
    health, _ = judged([belief_on(39)])
    assert any(says in each.text for each in why_not_alerting(health, with_rise(sigmas, found=found), 3, SETTINGS))
    assert not any(
        "standard deviations" in each.text for each in why_not_alerting(health, with_rise(sigmas + 0.5, found=found), 3, SETTINGS)
    )


def test_the_reasons_why_a_joint_does_not_alert_are_given():
    """A rise that is too small, too uncertain, or in too few replays: one sentence each. At the limit tier there is none."""
    health, _ = judged([belief_on(day, {3: 0.008}) for day in range(4)])
    reasons = " ".join(each.text for each in why_not_alerting(health, belief_on(4, {3: 0.008}), 3, SETTINGS))
    assert "next is the advisory tier" in reasons
    assert "1.6 of its standard deviations" in reasons
    assert "below +1%" in reasons
    health, _ = judged([belief_on(day, {3: 0.40}) for day in range(3)])
    assert why_not_alerting(health, belief_on(3, {3: 0.40}), 3, SETTINGS) == ()
    health, _ = judged([belief_on(day, {3: 0.06}) for day in range(3)])
    assert any("P(more than 30%)" in reason.text for reason in why_not_alerting(health, belief_on(3, {3: 0.06}), 3, SETTINGS))


def test_joints_without_a_replay_for_a_week_are_stale():
    """After nine days every joint is stale; after five days none is. The state does not change."""
    health, _ = judged([belief_on(0), belief_on(1)])
    assert stale_joints(health, START_S + 5 * DAY_S, SETTINGS) == (False,) * 6
    assert stale_joints(health, START_S + 9 * DAY_S, SETTINGS) == (True,) * 6
    assert health.state == "NORMAL"


def test_status_names_the_stale_joints_of_a_stored_health(capsys):
    """One joint without a recent update is named, in JSON and above the table."""
    from monitor.publish.documents import as_json
    from monitor.publish.health_document import health_document
    from monitor.views.terminal.arm import print_status

    health, _ = judged([belief_on(0), belief_on(1)])
    silent = replace(health, joints=(replace(health.joints[0], learnt_at_unix_s=START_S - 3 * DAY_S), *health.joints[1:]))
    stored = health_from_document(silent.as_document())
    document = as_json(health_document(stored, START_S + 5 * DAY_S, SETTINGS))
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
    fresh = health_document(health, START_S + 5 * DAY_S, SETTINGS)
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
    parts = attribute_changes(history.last.belief)[2]
    assert parts is not None
    assert parts.whole == pytest.approx(parts.temperature + parts.payload + parts.wear + parts.rest, abs=1e-12)
    fv, fc = 9.0 * np.exp(-0.015 * np.array([5.0, -5.0])) * 0.4, 7.0
    assert parts.temperature == pytest.approx(np.log((fc + fv[1]) / (fc + fv[0])), abs=0.006)
    assert parts.wear == pytest.approx(np.log(1.1), abs=0.01)
    assert parts.payload == 0.0
    assert abs(parts.rest) < 0.02
