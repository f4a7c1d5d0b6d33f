"""One arm's replays: outliers, contexts, missing values and fast changes."""

from dataclasses import replace

import numpy as np
import pytest
from evidence.lived import learnt_correlation
from synthetic_arm import CONTEXT, COULOMB_NM, START_S, Arm, History, fresh, lived_together, weather

from monitor.errors import BadInput
from monitor.judge.alerts.rules import why_not_alerting
from monitor.judge.drift.step import OUTLIER, STEP, UNRESOLVED
from monitor.judge.friction.figures import noise_var
from monitor.judge.friction.states import SLOPE
from monitor.judge.friction.step import FrictionState
from monitor.judge.learn import learn
from monitor.judge.settings import AssessSettings

SETTINGS = AssessSettings()


def test_a_replay_before_the_beliefs_time_is_an_error():
    """BadInput names the time."""
    with pytest.raises(BadInput, match="before it"):
        learn(fresh(), Arm().replay(30.0), CONTEXT, START_S - 1.0, SETTINGS)


def test_a_single_outlier_teaches_little_and_is_reported():
    """A replay 40 % off moves friction by less than one replay's noise; a warning names the joint."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.friction[1].reference_torque_nm
    wild = history.add(20, Arm(seed=99).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
    assert wild.belief.event[1] == OUTLIER
    assert wild.friction[1].reference_torque_nm == pytest.approx(before, rel=0.02)
    assert any(warning.code == "outlier" and "joint 2" in warning.text for warning in wild.warnings)
    assert wild.health.joints[1].state == "CHECK_FUNCTION"
    calm = history.add(21, Arm(seed=21).replay(30.0))
    assert calm.health.joints[1].state == "NORMAL"
    assert not history.transitions


def test_a_jump_that_stays_is_a_step_within_days():
    """A 40 % jump is found within six replays, is known to within 6 % three later, and no bad data are told meanwhile."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0))
    for day in range(40, 46):
        last = history.add(day, Arm(seed=day).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
        if last.belief.event[1] == STEP:
            break
    assert last.belief.event[1] == STEP
    for after in range(day + 1, day + 4):
        last = history.add(after, Arm(seed=after).replay(30.0, np.array([0, 0.4, 0, 0, 0, 0])))
    assert {condition for _, _, _, condition, _ in history.transitions} == {"sudden_step"}
    assert abs(last.friction[1].wear - 0.4) < 0.4 * 0.06 + 0.06
    assert all(abs(joint.wear) < 0.03 for joint in last.friction if joint.joint != 2)  # no other joint changed


def test_outliers_on_both_sides_are_no_step():
    """Up, down, up, down: these are bad data, and the estimate stays where it was."""
    history = History()
    for day in range(20):
        history.add(day, Arm(seed=day).replay(30.0))
    for day, wear in enumerate((0.4, -0.3, 0.4, -0.3), start=20):
        last = history.add(day, Arm(seed=day).replay(30.0, np.array([0, wear, 0, 0, 0, 0])))
        assert last.belief.event[1] == OUTLIER
    assert abs(last.friction[1].wear) < 0.03


@pytest.fixture(scope="module")
def quiet() -> FrictionState:
    """After 150 quiet replays: an arm with noise of 1 %, one of 3 %, and of 2 % one with ρ = 0 and one with ρ = 0.5."""
    arms = (Arm(seed=3, noise=0.01), Arm(seed=3, noise=0.03), Arm(seed=4), Arm(seed=4, autocorrelation=0.5))
    return lived_together([[arm.replay(30.0) for _ in range(150)] for arm in arms])[-1].friction


@pytest.mark.parametrize(("arm", "noise"), [(0, 0.01), (1, 0.03)])
@pytest.mark.slow
def test_the_noise_between_replays_is_learnt(quiet, arm, noise):
    """After 150 quiet replays the estimated noise is the true noise, to 30 % averaged over the joints. Its prior is 2 %."""
    estimated = np.sqrt(noise_var(quiet, SETTINGS.friction)).reshape(-1, 6)[arm]
    assert np.mean(estimated) == pytest.approx(noise, rel=0.3)


def test_the_autocorrelation_of_the_noise_is_learnt(quiet):
    """The mean over the joints after 150 replays distinguishes ρ = 0.5 from ρ = 0; its σ is about 0.03."""
    learnt = learnt_correlation(quiet, SETTINGS.friction).reshape(-1, 6).mean(axis=1)
    assert learnt[2] < 0.2
    assert learnt[3] > 0.3


@pytest.mark.slow
def test_the_temperature_slope_is_learnt():
    """From a year's weather the filter learns how friction falls with temperature, within 3 of its σ and within 0.15 %/K."""
    history, arm, rng = History(), Arm(seed=7), np.random.default_rng(7)
    for day in range(0, 365, 4):
        history.add(day, arm.replay(weather(day, rng)))
    belief = history.last.belief
    fv = arm.viscous * np.exp(-0.015 * (belief.reference_temperature_c - 25.0)) * 0.4
    truth = 0.015 * fv / (COULOMB_NM + fv)
    error = np.abs(belief.slope - truth)
    state = belief.friction
    assert np.all(error < 3 * np.sqrt(state.of_joints((state.p * state.P[:, SLOPE, SLOPE]).sum(axis=0))))
    assert np.all(error < 0.0015)


@pytest.mark.slow
def test_a_new_payload_keeps_the_wear_and_is_reported():
    """In a new context the level is unknown and the wear is kept; later wear is measured against the new level."""
    history = History()
    for day in range(60):
        history.add(day, Arm(seed=day, noise=0.005).replay(30.0, np.array([0, 0, 0.12 * (day > 30), 0, 0, 0])))
    before = history.last.friction[2].wear
    assert before == pytest.approx(0.12, abs=0.02)
    heavier = replace(CONTEXT, payload_kg=3.0)
    loaded = Arm(seed=60, noise=0.005).replay(30.0, 0.3 + 0.0 * COULOMB_NM)  # a payload that raises friction by 30 %
    after = history.add(60, loaded, heavier)
    assert after.friction[2].wear == pytest.approx(before, abs=0.01)
    assert all(abs(joint.wear) < 0.02 for joint in after.friction if joint.joint != 3)
    [warning] = [warning for warning in after.warnings if warning.code == "context_changed"]
    assert "payload_kg 0.0 → 3.0" in warning.text
    assert [opened.replays for opened in after.belief.contexts] == [60, 1]
    again = history.add(61, Arm(seed=61, noise=0.005).replay(30.0, 0.3), heavier)
    assert not [warning for warning in again.warnings if warning.code == "context_changed"]


def test_contexts_are_equal_within_their_tolerance():
    """The same payload with rounding opens no new context; an unknown payload does."""
    history = History()
    history.add(0, Arm().replay(30.0), replace(CONTEXT, payload_kg=1.2))
    same = history.add(1, Arm().replay(30.0), replace(CONTEXT, payload_kg=1.2000001))
    other = history.add(2, Arm().replay(30.0), replace(CONTEXT, payload_kg=None))
    assert len(same.belief.contexts) == 1
    assert len(other.belief.contexts) == 2


def test_an_unresolved_joint_keeps_its_prediction():
    """A joint that did not reach the reference speed is predicted, not updated, and its state is CHECK_FUNCTION."""
    history = History()
    for day in range(5):
        history.add(day, Arm(seed=day).replay(30.0))
    before = history.last.belief
    slow = replace(Arm(seed=5).replay(30.0), max_speed_rad_s=np.array([2.0, 2.0, 2.0, 0.1, 2.0, 2.0]))
    after = history.add(5, slow)
    assert after.belief.event[3] == UNRESOLVED
    now, was = (of.reference_torque_nm(SETTINGS.friction)[0][3] for of in (after.belief, before))
    assert now == pytest.approx(was, rel=0.01)
    assert after.health.joints[3].state == "CHECK_FUNCTION"


def test_without_temperatures_the_uncertainty_is_larger_and_no_wear_alert_is_raised():
    """Without a sensor, 15 % more friction may be a cold morning: it is learnt with a larger uncertainty, and a warning says so."""
    with_t, without = History(), History()
    for day in range(55):
        seen = Arm(seed=day).replay(30.0, 0.15 if day > 40 else 0.0)
        with_t.add(day, seen)
        blind = without.add(day, replace(seen, temperature_c=None))
        if day == 2:  # later the scatter that is seen decides how sure one may be
            sure, unsure = (of.reference_torque_nm(SETTINGS.friction)[1] for of in (with_t.last.belief, blind.belief))
            assert np.all(unsure > 1.2 * sure)
    assert with_t.transitions
    assert any(warning.code == "temperature_unknown" for warning in blind.warnings)
    # but one alert of the arm reports the missing temperatures, and the reason of each joint is right
    assert [(kind, joint, condition) for _, kind, joint, condition, _ in without.transitions] == [("raised", None, "temperature_sensor")]
    assert without.health.state == "CHECK_FUNCTION"
    reasons = " ".join(each.text for each in why_not_alerting(without.health, blind.belief, 3, SETTINGS))
    assert "does not tell this joint's temperature" in reasons
    assert "outside the temperatures" not in reasons


def test_a_context_that_returns_has_its_baseline():
    """Two payloads in turn: 30 % more friction under the second is no wear and is learnt once; wear that came meanwhile is detected."""
    history, heavier = History(), replace(CONTEXT, payload_kg=3.0)
    for day in range(60):
        loaded = day % 20 >= 10
        wear = np.array([0, 0, 0.1 * (day >= 45), 0, 0, 0])
        history.add(day, Arm(seed=day, noise=0.005).replay(30.0, 1.3 * (1 + wear) - 1 if loaded else wear), heavier if loaded else CONTEXT)
    assert [opened.replays for opened in history.last.belief.contexts] == [30, 30]
    assert history.last.friction[2].wear == pytest.approx(0.1, abs=0.02)
    assert all(abs(joint.wear) < 0.02 for joint in history.last.friction if joint.joint != 3)
    level = np.exp(history.last.belief.level())
    back = history.add(60, Arm(seed=60, noise=0.005).replay(30.0, np.array([0, 0, 0.1, 0, 0, 0])))
    assert np.allclose(np.exp(back.belief.level()), level / 1.3, rtol=0.02)
    [warning] = [warning for warning in back.warnings if warning.code == "context_changed"]
    assert "known from before" in warning.text


def test_a_fifth_context_takes_the_slot_of_the_one_that_was_left_first():
    """Four baselines are kept. The ledger lists every context and shows which have lost their slot."""
    history = History()
    for day, payload in enumerate([0.0, 1.0, 2.0, 3.0, 0.0, 4.0, 0.0]):
        last = history.add(day, Arm(seed=day).replay(30.0), replace(CONTEXT, payload_kg=payload))
    assert [(opened.context.payload_kg, opened.slot) for opened in last.belief.contexts] == [
        (1.0, None),
        (2.0, 2),
        (3.0, 3),
        (4.0, 1),
        (0.0, 0),
    ]


@pytest.mark.parametrize("firmware", ["URSoftware 5.11.0.108249 (Feb 2021)", "5.11.00.108249", " 5.11.0.108249 "])
def test_firmware_is_compared_by_its_version(firmware):
    """Blanks or words around it open no context; another version does."""
    history = History()
    history.add(0, Arm().replay(30.0), replace(CONTEXT, firmware="5.11.0.108249"))
    assert len(history.add(1, Arm().replay(30.0), replace(CONTEXT, firmware=firmware)).belief.contexts) == 1
    assert len(history.add(2, Arm().replay(30.0), replace(CONTEXT, firmware="5.12.0.108249")).belief.contexts) == 2


def test_an_outlier_as_the_first_replay_is_no_wear_later():
    """The first replay is 40 % low and the others are normal: the baseline starts again, and no joint has wear."""
    history = History()
    for day in range(40):
        history.add(day, Arm(seed=day).replay(30.0, np.array([0, -0.4 * (day == 0), 0, 0, 0, 0])))
    assert abs(history.last.friction[1].wear) < 0.03
    assert history.transitions == []


def test_a_fast_warm_up_is_no_wear():
    """The grease lags behind the sensor by 3 minutes: replays that warm at 1 K/min have 2 % more friction, and none of it is wear."""
    history, rng = History(), np.random.default_rng(4)
    for day in range(60):
        warming = 1.2 * (day >= 30) * rng.uniform(0.5, 1.0)
        colder = Arm(seed=day, noise=0.005).replay(32.0 - 3.0 * warming)
        seen = replace(colder, temperature_c=np.full(6, 32.0), warming_k_per_min=np.full(6, warming))
        last = history.add(day, seen)
    assert any(warning.code == "warming_fast" for warning in last.warnings)
    assert np.max(np.abs(last.belief.wear)) < 0.01
    assert history.transitions == []


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))])
@pytest.mark.slow
def test_fast_wear_is_estimated(seed):
    """2 % a day from day 40 on: ten days later the estimated wear is within 3 of its standard deviations, and within 5 %."""
    history, arm, rng = History(), Arm(seed=seed, noise=0.01), np.random.default_rng(seed)
    for day in range(51):
        history.add(day, arm.replay(weather(day, rng), np.array([0, 0, 0.02 * max(0, day - 40), 0, 0, 0])))
    friction_3 = history.last.friction[2]
    assert friction_3.wear == pytest.approx(0.20, abs=0.05)
    assert abs(friction_3.wear - 0.20) < 3.0 * friction_3.wear_std
