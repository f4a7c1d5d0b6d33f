"""Stories of up to a year of an arm: which alerts the monitor raises, and which it must not raise."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_arm import CONTEXT, START_S, Arm, History, lived_together, weather

from monitor.errors import BadInput
from monitor.judge.alerts.health import alert_document
from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.assess import Rejected, assess, judge_identification
from monitor.judge.assessment import Assessment
from monitor.judge.friction.settings import DriftSettings
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting, load_robot
from monitor.recording import Context, Recording
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

ROOT = Path(__file__).parent.parent

ALL_TIERS = ("advisory", "wear", "limit")


def lived(days: int, *, seed: int, wear=lambda day: np.zeros(6), temperature=weather, **arm) -> History:
    """Daily replays at a quarter past seven."""
    history, source, rng = History(), Arm(seed=seed, **arm), np.random.default_rng(1000 + seed)
    for day in range(days):
        history.add(day + 0.3, source.replay(temperature(day, rng), wear(day)))
    return history


def on_joint_3(fraction: float) -> np.ndarray:
    return np.array([0, 0, fraction, 0, 0, 0])


KINDS = ({"autocorrelation": 0.5}, {"fall_per_k": 0.022}, {}, {"noise": 0.01})
QUIET = [(KINDS[0], 1), *(pytest.param(kind, 2, marks=pytest.mark.soak) for kind in KINDS)]


@pytest.mark.parametrize(("kind", "arms"), QUIET, ids=str)
def test_a_quiet_year_raises_no_wear_alert(kind, arms):
    """Seasons, warm and cold mornings, 2 % noise: a year of correlated noise without a wear alert; two of each kind in the soak tests.

    Advisories: at most 1 (measured over 36 arm-years: none of a joint, two of the arm's common mode).
    """
    years = [lived(365, seed=seed, **kind) for seed in range(arms)]
    assert [year.first() for year in years] == [{}] * arms
    assert sum(len(year.first(tiers=ALL_TIERS)) for year in years) <= 1
    assert all(abs(joint.wear) < 0.04 for year in years for joint in year.last.friction)  # 1 % a year of chance, 3 σ and the noise


def test_a_cold_monday_is_no_wear():
    """Every Monday is 10 K colder after an idle weekend, which is +15 % of fv without compensation: no alert in 20 weeks."""
    history = lived(140, seed=1, noise=0.01, temperature=lambda day, rng: 21.0 + rng.normal() if day % 7 == 0 else 31.0 + rng.normal())
    assert history.transitions == []


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2, 3))])
def test_wear_of_ten_percent_a_month_is_detected_in_its_joint(seed):
    """From day 30 on, 2 % noise: an advisory within 35 days, a wear alert within 45 days (15 % by then), both of joint 3 only."""
    history = lived(80, seed=seed, wear=lambda day: on_joint_3(max(0, day - 30) * 0.1 / 30))
    assert set(history.first(tiers=ALL_TIERS)) == {3}
    assert 30 < history.first(tiers=ALL_TIERS)[3] < 65
    assert 30 < history.first()[3] < 75
    assert history.health.joints[2].state == "MAINTENANCE_REQUIRED"
    truth = 50 * 0.1 / 30
    # start and rate of wear are estimated together; with a month of baseline the start is open by a week (2.5 %), and noise adds 1.7 %
    assert history.last.friction[2].wear == pytest.approx(truth, abs=0.06)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))])
def test_a_step_of_eight_percent_is_detected(seed):
    """1 % noise: a wear alert within 8 replays of the step, of joint 3 only, and the size is right to 2.5 %."""
    history = lived(80, seed=seed, noise=0.01, wear=lambda day: on_joint_3(0.08 * (day >= 60)))
    assert set(history.first(tiers=ALL_TIERS)) == {3}
    assert 60 < history.first()[3] < 68.5
    assert history.last.friction[2].wear == pytest.approx(0.08, abs=0.025)


def test_a_change_of_all_joints_together_is_not_six_worn_joints():
    """All joints rise by 4 % from one day to the next: the arm has an alert, and no joint has a wear alert."""
    history = lived(90, seed=2, noise=0.01, wear=lambda day: np.full(6, 0.04 * (day >= 60)))
    assert history.first() == {}
    assert None in history.first(tiers=ALL_TIERS, condition="common_mode")
    assert history.health.state == "CHECK_FUNCTION"


@pytest.mark.soak
def test_remaining_life_is_near_the_truth_for_a_constant_rate():
    """0.1 % a day, 1 % noise, asked at 12 % of 30 %: the median P50 of 6 arms is within 20 %, and most P10–P90 contain the truth.

    The first arm is judged as by the daemon, replay by replay, and is told the same; all of them in one go by the daemon's filter step.
    """
    days, arms, settings = 120, 6, AssessSettings()
    weathers = [np.random.default_rng(1000 + seed) for seed in range(arms)]
    sources = [Arm(seed=seed, noise=0.01) for seed in range(arms)]
    lives = [
        [arm.replay(weather(day, rng), on_joint_3(0.001 * day)) for day in range(days)] for arm, rng in zip(sources, weathers, strict=True)
    ]
    state = lived_together(lives)[-1]
    told = [remaining_life_of_joint(state.friction, 7 * k + 2, settings.friction, settings.prognosis) for k in range(arms)]
    first = lived(days, seed=0, noise=0.01, wear=lambda day: on_joint_3(0.001 * day)).last.friction
    life = first[2].remaining_life
    assert (life.p10_days, life.p50_days, life.p90_days) == pytest.approx((told[0].p10_days, told[0].p50_days, told[0].p90_days), rel=1e-3)
    assert first[0].remaining_life.p50_days is None  # a quiet joint of the same arm
    truth = 0.30 / 0.001 - (days - 1)
    assert {life.verdict for life in told} == {"trend"}
    assert abs(np.median([life.p50_days / truth - 1 for life in told])) < 0.2
    assert sum(life.p10_days <= truth <= (life.p90_days or np.inf) for life in told) >= 4


def test_learning_continues_after_a_gap_of_a_month():
    """The gap raises no alert, and wear is still detected."""
    wear = {3: 0.0}
    history, arm = History(), Arm(seed=3, noise=0.01)
    for day in range(60):
        history.add(day, arm.replay(30.0))
    history.add(90, arm.replay(30.0))
    for day in range(91, 130):
        wear[3] += 0.005
        history.add(day, arm.replay(30.0, on_joint_3(wear[3])))
    assert set(history.first()) == {3}


def test_assessment_is_markov():
    """Belief and health through JSON after every replay give the same verdicts as without."""
    from monitor.judge.alerts.health import health_from_document
    from monitor.judge.belief import belief_from_document

    straight = lived(40, seed=5, noise=0.01, wear=lambda day: on_joint_3(0.08 * (day >= 28)))
    through, arm, rng = History(), Arm(seed=5, noise=0.01), np.random.default_rng(1005)
    for day in range(40):
        through.add(day + 0.3, arm.replay(weather(day, rng), on_joint_3(0.08 * (day >= 28))))
        belief = belief_from_document(json.loads(json.dumps(through.last.belief.as_document())))
        through.last, through.health = (
            replace(through.last, belief=belief),
            health_from_document(json.loads(json.dumps(through.health.as_document()))),
        )
    assert through.transitions == straight.transitions
    assert straight.transitions
    assert json.dumps(through.last.as_document()) == json.dumps(straight.last.as_document())


def test_the_published_document_is_plain_json():
    """It has no NaN, the promised names, and one entry for each joint, also where the temperature is unknown."""
    history = History()
    first = history.add(0, replace(Arm().replay(30.0), temperature_c=None))
    document = json.loads(json.dumps(first.as_document(), allow_nan=False))
    assert set(document) >= {"health", "alerts", "temperature", "friction", "contexts", "warnings"}
    assert document["health"]["arm"] in {"NORMAL", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED", "FAILURE"}
    assert [entry["joint"] for entry in document["friction"]] == [1, 2, 3, 4, 5, 6]
    assert document["friction"][0]["temperature_c"] is None
    assert {warning["code"] for warning in document["warnings"]} == {"temperature_unknown"}
    json.dumps(first.belief.as_document(), allow_nan=False)
    json.dumps(first.model.as_document(), allow_nan=False)


def test_the_published_law_is_the_one_from_which_torque_is_predicted():
    """Point by point along the learnt range, for curves as for lines; a joint that was never resolved has no points."""
    history, source, rng = History(), Arm(seed=3, noise=0.005), np.random.default_rng(3)
    for day in range(40):
        history.add(day, source.replay(rng.uniform(8.0, 40.0)))
    last = history.last
    assert "exponential" in {law.law for law in last.temperature}
    for law in last.temperature:
        points = np.array(law.viscous_by_temperature)
        assert (points[0, 0], points[-1, 0]) == law.range_c
        for temperature_c, fv, std in points:
            predicted = last.model.viscous_at(np.full(6, temperature_c))
            fresh = np.exp(last.model.wear[law.joint - 1])
            assert (fv * fresh, std * fresh) == pytest.approx((predicted.value[law.joint - 1], predicted.std[law.joint - 1]))
    unseen = replace(source.replay(20.0), viscous_nm_s_per_rad=np.full(6, np.nan), coulomb_nm=np.full(6, np.nan))
    assert all(law.viscous_by_temperature == () for law in History().add(0, unseen).temperature)


def test_an_alert_document_states_whether_it_is_active():
    """It has the joint counted from 1, the tier, and the evidence in words."""
    history = lived(40, seed=0, noise=0.005, wear=lambda day: on_joint_3(0.12 * (day >= 30)))
    [alert] = history.health.active_alerts
    document = alert_document(alert)
    assert document["active"] is True
    assert (document["joint"], document["condition"], document["tier"]) == (3, "sudden_step", "wear")
    assert document["probability"] > 0.95
    assert "chance alone shows as much in a sound joint" in document["text"]


def test_a_replay_is_learnt_once_and_in_time_order():
    """The same replay again, an older one, and one without a time are Rejected, and the belief does not change."""
    first = History().add(10, Arm().replay(30.0))
    for at, says in ((first.recorded_at_unix_s, "learnt last"), (first.recorded_at_unix_s - 60, "60 s older"), (None, "does not say when")):
        outcome = judge_identification(
            Arm().replay(30.0), replace(CONTEXT, recorded_at_unix_s=at), belief=first.belief, health=first.health
        )
        assert isinstance(outcome, Rejected)
        assert says in outcome.reason.text


def test_another_arms_belief_is_refused():
    """Robot and reference speed belong to the history; another one is an error of the caller, and BadInput names it."""
    first = History().add(0, Arm().replay(30.0))
    later = replace(CONTEXT, recorded_at_unix_s=START_S + 90_000.0)
    with pytest.raises(BadInput, match="belief is of ur5, the recording of ur3"):
        judge_identification(replace(Arm().replay(30.0), robot="ur3"), later, belief=first.belief, health=first.health)
    other = AssessSettings(drift=DriftSettings(reference_speed_rad_s=0.5))
    with pytest.raises(BadInput, match="reference_speed_rad_s"):
        judge_identification(Arm().replay(30.0), later, belief=first.belief, health=first.health, settings=other)


def test_a_recording_without_motion_is_rejected_with_its_reason():
    """An arm that stood still gives nothing to learn from. That is an ordinary outcome."""
    t = np.arange(1250) / 125.0
    still = Recording(
        t_s=t,
        q=np.zeros((1250, 6)),
        qd=np.zeros((1250, 6)),
        current=np.zeros((1250, 6)),
        temperature_c=np.full((1250, 6), 30.0),
        context=Context(robot="ur5", recorded_at_unix_s=START_S),
    )
    outcome = assess(still, robot=load_robot("ur5"), mounting=Mounting(), belief=None, health=None)
    assert isinstance(outcome, Rejected)
    assert outcome.reason.text


@pytest.fixture(scope="module")
def simulated() -> list[Assessment]:
    """A simulated UR5, its own friction law, warm and cool days: 14 replays as new, then 7 with joint 3 worn by 25 %."""
    controller = Controller(SimulateSettings(seed=11))
    excitation = replace(excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text())), repetitions=1)
    verdicts: list[Assessment] = []
    for day in range(21):
        controller.pass_time(23.5, 20.0 + 6.0 * (day % 3), 0.3)
        if day == 14:
            controller.arm.set_wear(2, coulomb=1.25, viscous=1.25)
        recording = stepped_replay(controller, excitation)
        recording = replace(recording, context=replace(recording.context, recorded_at_unix_s=START_S + day * 86_400.0))
        last = verdicts[-1] if verdicts else None
        verdict = assess(
            recording,
            robot=load_robot("ur5"),
            mounting=Mounting(),
            belief=last and last.belief,
            health=last and last.health,
        )
        assert isinstance(verdict, Assessment), verdict
        verdicts.append(verdict)
    return verdicts


@pytest.mark.soak
def test_the_whole_flow_detects_the_worn_joint_of_a_simulated_arm(simulated):
    """Full physics and the real identification: joint 3 has wear, no other has, and the size is right to 5 %."""
    raised = {(alert.joint, alert.tier) for verdict in simulated for _, alert in verdict.transitions if alert.tier != "advisory"}
    assert raised == {(3, "wear")}
    assert simulated[-1].friction[2].wear == pytest.approx(0.25, abs=0.05)
    assert not any(verdict.transitions for verdict in simulated[:14])


@pytest.mark.soak
def test_the_simulated_arm_shows_friction_falling_with_temperature(simulated):
    """Every joint's β is positive after 21 days over 12 K, as in the paper, and the range is that of the simulated temperatures."""
    last = simulated[-1]
    assert all(entry.friction_slope_per_k > 0 for entry in last.temperature)
    assert all(entry.range_c[1] - entry.range_c[0] > 8 for entry in last.temperature)


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        ({"missed_ticks": 400}, "ticks are missing"),
        ({"late_share": 0.5}, "targets came late"),
        ({"slipped_s": 1.2}, "1.20 s behind its trajectory"),
        ({"min_speed_scaling": 0.5}, "speed slider went to 50 %"),
    ],
)
def test_a_replay_that_was_disturbed_is_stored_and_not_learnt_from(quality, words):
    """The quality that acquisition counted decides, before anything is identified."""
    rows = np.zeros((1250, 6))
    recording = Recording(
        t_s=np.arange(1250) * 0.008,
        q=rows,
        qd=rows,
        current=rows,
        context=replace(CONTEXT, recorded_at_unix_s=START_S),
        quality={"missed_ticks": 0, "late_share": 0.01, "slipped_s": 0.0, "min_speed_scaling": 1.0} | quality,
    )
    outcome = assess(recording, robot=load_robot("ur5"), mounting=Mounting(), belief=None, health=None)
    assert isinstance(outcome, Rejected)
    assert "not to be trusted" in outcome.reason.text
    assert words in outcome.reason.text
