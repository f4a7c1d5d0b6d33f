"""The temperature laws fv(T) and fc(T) after one replay and after many, and temperature sensors that are stuck."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_arm import Arm, History

from monitor.errors import BadConfiguration, BadInput
from monitor.judge.document import plain, typed
from monitor.judge.temperature.laws import (
    Law,
    Line,
    TemperatureSettings,
    fit_law,
    initial_law,
    reopen_law,
    update_law,
)
from monitor.judge.temperature.stuck import held_still, stuck_sensors, suspect_sensors, update_sensors
from monitor.studies.worlds.laws import SENSOR_STEP_K
from monitor.studies.worlds.table import WORLDS

SETTINGS = TemperatureSettings()
ONE = np.ones(1)


def law_of(temperatures: np.ndarray, values: np.ndarray) -> Law:
    law = initial_law(temperatures[:1], values[:1], fall_per_k=0.015, fall_std_per_k=0.007, scatter=0.05)
    for T, value in zip(temperatures, values, strict=True):
        law = update_law(law, np.array([T]), np.array([value]))
    return law


def test_one_replay_gives_a_usable_law_with_a_realistic_uncertainty():
    """The level is measured, the slope is the robot family's with its published spread; ten kelvin away the uncertainty is larger."""
    line = fit_law(law_of(np.array([25.0]), np.array([10.0])), 25.0 * ONE, SETTINGS)
    assert line.intercept[0] == pytest.approx(10.0)
    assert line.slope[0] == pytest.approx(-0.15)  # 1.5 %/K of 10
    assert np.sqrt(line.cov[0, 1, 1]) == pytest.approx(0.07)
    here, there = line.at(25.0 * ONE), line.at(35.0 * ONE)
    assert here.std[0] == pytest.approx(0.5)  # 5 % scatter
    assert there.std[0] == pytest.approx(np.hypot(0.5, 0.7))
    assert not here.extrapolated[0]
    assert there.extrapolated[0]


def test_many_replays_give_the_true_line():
    """60 replays over 20–40 °C with 3 % scatter: slope and level within 3 of their σ, and σ of the slope below 0.1 %/K."""
    rng = np.random.default_rng(0)
    T = rng.uniform(20, 40, 60)
    fv = 10.0 - 0.12 * (T - 30.0) + rng.normal(size=60) * 0.3
    line = fit_law(law_of(T, fv), 30.0 * ONE, SETTINGS)
    std = np.sqrt(np.diagonal(line.cov[0]))
    assert abs(line.intercept[0] - 10.0) < 3 * std[0]
    assert abs(line.slope[0] + 0.12) < 3 * std[1]
    assert std[1] < 0.01
    assert line.scatter[0] == pytest.approx(0.3, rel=0.3)  # χ² with 60 degrees leaves 9 %; the prior's five replays the rest
    assert line.change[0] == pytest.approx(-0.12 * np.ptp(T) / (10.0 + 0.12 * (30.0 - T.min())), rel=0.15)


@given(st.lists(st.tuples(st.floats(0, 60), st.floats(1, 20)), min_size=2, max_size=12))
def test_the_running_sums_are_the_whole_regression(replays):
    """The line equals a batch Bayesian regression with the same scatter, for any replays."""
    T, value = np.array(replays).T
    law = law_of(T, value)
    line = fit_law(law, T[:1], SETTINGS)
    X = np.stack([np.ones_like(T), T - T[0]], axis=1)
    precision = X.T @ X / line.scatter[0] ** 2 + np.diag([0.0, 1.0 / law.slope_prior_std[0] ** 2])
    right = X.T @ value / line.scatter[0] ** 2 + [0.0, law.slope_prior[0] / law.slope_prior_std[0] ** 2]
    expected = np.linalg.solve(precision, right)
    assert line.intercept[0] == pytest.approx(expected[0], rel=1e-6, abs=1e-6)  # sums cancel, the batch does not
    assert line.slope[0] == pytest.approx(expected[1], rel=1e-6, abs=1e-6)


def test_the_reference_temperature_does_not_change_the_law():
    """Value and uncertainty at 33 °C are equal for a line referred to 20 °C and to 40 °C."""
    law = law_of(np.array([22.0, 28.0, 36.0]), np.array([11.0, 10.1, 9.2]))
    a, b = (fit_law(law, T0 * ONE, SETTINGS).at(33.0 * ONE) for T0 in (20.0, 40.0))
    assert a.value[0] == pytest.approx(b.value[0], rel=1e-12)
    assert a.std[0] == pytest.approx(b.std[0], rel=1e-9)


def test_friction_never_drives_however_far_a_line_is_extrapolated():
    """At 200 °C the line of −0.15/K from 10 would be negative: it stays at 5 % of its intercept and is flagged."""
    hot = fit_law(law_of(np.array([25.0]), np.array([10.0])), 25.0 * ONE, SETTINGS).at(200.0 * ONE)
    assert hot.value[0] == pytest.approx(0.5)
    assert hot.extrapolated[0]


def test_a_new_context_keeps_the_slope_and_learns_the_level_again():
    """A payload that adds 30 % moves the level at once; the slope learnt before is the prior."""
    T = np.linspace(20, 40, 30)
    law = law_of(T, 10.0 - 0.10 * (T - 30.0))
    slope = fit_law(law, 30.0 * ONE, SETTINGS).slope[0]
    anew = update_law(reopen_law(law, np.ones(1, dtype=bool), SETTINGS), 30.0 * ONE, 13.0 * ONE)
    line = fit_law(anew, 30.0 * ONE, SETTINGS)
    assert line.intercept[0] == pytest.approx(13.0)
    assert line.slope[0] == pytest.approx(slope)


def test_a_joint_that_was_never_resolved_has_no_law():
    """NaN values change nothing: the line is NaN instead of a guess, and the other joints keep theirs."""
    law = initial_law(np.full(2, 25.0), np.array([10.0, np.nan]), fall_per_k=0.015, fall_std_per_k=0.007, scatter=0.05)
    line = fit_law(update_law(law, np.full(2, 25.0), np.array([10.0, np.nan])), np.full(2, 25.0), SETTINGS)
    assert line.intercept[0] == pytest.approx(10.0)
    assert np.isnan(line.intercept[1])
    assert not line.inside(np.full(2, 25.0))[1]


def test_friction_at_an_unknown_temperature_teaches_the_level_only_while_none_was_known():
    """A warm joint without a reading would else be a cold one of less friction; an arm without sensors still has its friction."""
    cold = law_of(np.array([11.0, 12.0, 13.0]), np.array([10.3, 10.2, 10.1]))
    assert plain(update_law(cold, np.array([np.nan]), np.array([6.0]))) == plain(cold)
    blind = initial_law(25.0 * ONE, 9.0 * ONE, fall_per_k=0.015, fall_std_per_k=0.007, scatter=0.05)
    for value in (9.0, 9.2):
        blind = update_law(blind, np.array([np.nan]), np.array([value]))
    assert fit_law(blind, 25.0 * ONE, SETTINGS).intercept[0] == pytest.approx(9.1, abs=0.01)


def test_documents_of_laws_and_lines_are_exact():
    """NaN becomes null, and every float is read as it was written."""
    law = update_law(law_of(np.array([21.3, 30.7]), np.array([10.1, 9.3])), np.array([np.nan]), np.array([9.9]))
    line = fit_law(law, 27.1 * ONE, SETTINGS)
    assert plain(typed(Law, plain(law), where="law", sizes={"J": 1})) == plain(law)
    assert plain(typed(Line, line.as_document(), where="line", sizes={"J": 1})) == line.as_document()
    with pytest.raises(BadInput, match="sums has shape"):
        typed(Law, {**plain(law), "sums": [[1.0]]}, where="law", sizes={"J": 1})


def test_invalid_settings_are_named():
    """A scatter of 0 would make one replay certain."""
    with pytest.raises(BadConfiguration, match=r"temperature\.scatter"):
        TemperatureSettings(scatter=0.0)


@pytest.mark.slow
def test_a_stuck_sensor_is_reported_and_a_winter_is_no_wear():
    """Joint 3 reports 31.0 °C from day 60 on while a season passes: an alert of its sensor, none of its wear, none of another sensor."""
    history, arm, rng = History(), Arm(seed=5, noise=0.01, autocorrelation=0.5), np.random.default_rng(5)
    for day in range(130):
        true = 31.0 - 8.0 * np.sin(2 * np.pi * day / 365.0) + 1.5 * rng.normal()
        seen = arm.replay(true)
        measured = np.full(6, true)
        if day >= 60:
            measured[2] = 31.0
        history.add(day, replace(seen, temperature_c=measured))
    assert [(kind, joint, condition) for _, kind, joint, condition, _ in history.transitions] == [("raised", 3, "temperature_sensor")]
    assert 60 < history.transitions[0][0] < 90
    assert "temperature_stuck" in {warning.code for warning in history.last.warnings}


def test_a_sensor_that_changes_again_is_used_again():
    """Five replays at 31.0 °C while the others changed by 3 K; then it changes. Where nothing changes, no sensor is stuck."""
    others = [25.0, 26.0, 28.0, 27.0, 25.5]
    sensors = None
    for median in others:
        sensors = update_sensors(sensors, np.array([median, median, 31.0, median, median, np.nan]), 6)
    assert stuck_sensors(sensors).tolist() == [False, False, True, False, False, False]
    assert not stuck_sensors(update_sensors(sensors, np.array([25.0, 25.0, 31.1, 25.0, 25.0, np.nan]), 6)).any()
    for _ in range(20):
        sensors = update_sensors(sensors, np.full(6, 30.0), 6)
    assert not stuck_sensors(sensors).any()


def test_a_warm_arm_that_is_replayed_again_and_again_has_no_stuck_sensor():
    """After a cold morning, every five minutes, steady to a step of the sensor: other joints in turn say the step, at other levels."""
    sensors, apart = None, np.full(6, 5.0 / 1440.0)
    for k in range(10):
        sensors = update_sensors(sensors, np.array([11.0, 11.0, 11.0, 11.1, 11.1, 11.2]) + 0.2 * k, 6, days=apart)
    for k in range(12):
        step = np.array([0.0, 0.0, 0.0, 0.06 * (k % 2), 0.06 * (k % 3 == 0), 0.06 * (k // 2 % 2)])
        sensors = update_sensors(sensors, np.array([44.8, 44.5, 43.6, 45.8, 46.2, 48.9]) + step, 6, days=apart)
        assert not (suspect_sensors(sensors) | stuck_sensors(sensors) | held_still(sensors)).any(), k


def test_a_sensor_that_stands_still_while_the_arm_warms_is_stuck_within_the_hour():
    """The others are two steps warmer after each replay."""
    sensors = None
    for k in range(26):
        T = np.array([20.0, 20.1, 31.0, 20.4, 20.2, 20.3]) + 0.13 * k * np.array([1, 1, 0, 1, 1, 1])
        sensors = update_sensors(sensors, T, 6, days=np.full(6, 5.0 / 1440.0))
    assert stuck_sensors(sensors).tolist() == [False, False, True, False, False, False]


def year_of(frozen: Callable[[int, np.ndarray], np.ndarray], days: int, *, constant: bool = False) -> History:
    """A winter of daily replays whose sensors say `frozen(day, true temperatures)`; `constant`: they say it throughout each replay."""
    history, arm, rng = History(), Arm(seed=5, noise=0.01, autocorrelation=0.5), np.random.default_rng(5)
    for day in range(days):
        true = 31.0 - 8.0 * np.sin(2 * np.pi * day / 365.0) + 1.5 * rng.normal() + 0.3 * rng.normal(size=6)
        said = frozen(day, true.copy())
        held = (said != true).astype(float) if constant else None
        history.add(day, replace(arm.replay(true), temperature_c=said, temperature_constant=held))
    return history


@pytest.mark.slow
@pytest.mark.parametrize("at_c", [None, 0.0, 34.0])
@pytest.mark.parametrize("joints", [(0, 1, 2, 3, 4, 5), (0, 1, 3, 4), (2, 4, 5)])
def test_any_sensors_that_stand_still_are_told_whatever_the_others_do(joints, at_c):
    """From day 40 on, all sensors or some say what they said last, or a value of their own: their alerts within two weeks, and no other."""
    last: list[np.ndarray] = []

    def frozen(day, true):
        if day >= 40:
            last.append(true.copy())
            true[list(joints)] = last[0][list(joints)] if at_c is None else at_c
        return true

    history = year_of(frozen, 70)
    told = {joint for _, _, joint, condition, _ in history.transitions if condition == "temperature_sensor"}
    assert told == ({None} if len(joints) == 6 else {j + 1 for j in joints})
    assert {condition for *_, condition, _ in history.transitions} == {"temperature_sensor"}
    assert 40 < min(day for day, *_ in history.transitions) <= max(day for day, *_ in history.transitions) <= 54


@pytest.mark.slow
@pytest.mark.parametrize("joints", [(0, 1, 2, 3, 4, 5), (0, 1, 2, 3, 4)])
def test_sensors_that_never_moved_are_told(joints):
    """All six say one and the same number throughout every replay from the first day on; or five of them do, and the sixth moves."""

    def frozen(_, true):
        true[list(joints)] = 31.0
        return true

    history = year_of(frozen, 20, constant=True)
    assert {joint for _, _, joint, *_ in history.transitions} == ({None} if len(joints) == 6 else {j + 1 for j in joints})
    assert {condition for *_, condition, _ in history.transitions} == {"temperature_sensor"}


def test_friction_that_falls_in_all_joints_under_sensors_that_never_moved_is_not_told_as_friction():
    """A season that the sensors miss takes 7.6 % off the friction of every joint: the sensors are told, and nothing has fallen."""
    history = History()
    for day in range(60):
        history.add(day, Arm(seed=day, noise=0.005).replay(30.0, np.full(6, -0.076 * (day >= 40))))
    assert {(joint, condition) for _, _, joint, condition, _ in history.transitions} == {(None, "temperature_sensor")}


@pytest.mark.soak
@pytest.mark.parametrize("name", ["plain", "summer-24", "four-a-day"])
def test_sensors_of_healthy_arms_are_not_taken_for_stuck(name):
    """At most 0.01 findings a robot-year, in worlds whose sensors have the steps of real ones."""
    world, rng, arms = WORLDS[name], np.random.default_rng(1), 60
    every, days = world.replays_a_day, 1095
    heat = world.heat.at_replays(rng, (days * every, arms, 6), every)
    said = np.rint((heat.motor_c + 0.01 * rng.normal(size=(days * every, arms, 6))) / SENSOR_STEP_K) * SENSOR_STEP_K
    sensors, findings, before = None, 0, np.zeros(arms * 6, dtype=bool)
    for replay in said:
        sensors = update_sensors(sensors, replay.ravel(), 6, days=np.full(arms * 6, 1.0 / every))
        found = stuck_sensors(sensors) | held_still(sensors)
        findings, before = findings + np.count_nonzero(found & ~before), found
    assert findings <= 0.01 * arms * days / 365.0


@pytest.mark.parametrize("step_k", [1.0 / 16.0, 1.0 / 4.0, 1.0])
def test_a_calm_laboratory_is_no_stuck_sensor(step_k):
    """Sensors of coarse steps where the temperature varies by a tenth of a kelvin: they say the same for weeks, and are right."""
    rng, sensors = np.random.default_rng(2), None
    room = 30.0 + rng.normal(size=(40, 1))
    for _ in range(730):
        true = room + 0.1 * rng.normal(size=(40, 1)) + 0.1 * rng.normal(size=(40, 6))
        said = np.mean(np.rint((true + 0.02 * rng.normal(size=(50, 40, 6))) / step_k) * step_k, axis=0)
        sensors = update_sensors(sensors, said.ravel(), 6)
        assert not held_still(sensors).any()


def test_replays_within_an_hour_do_not_count_for_a_sensor_that_stands_still():
    """A warm arm that replays every few minutes keeps its temperature."""
    rng, sensors = np.random.default_rng(3), None
    for replay in range(60):
        T = 30.0 + rng.normal(size=6) if replay < 20 else np.full(6, 30.0)
        sensors = update_sensors(sensors, T, 6, days=np.full(6, 1.0 if replay < 20 else 0.01))
    assert not held_still(sensors).any()


@pytest.mark.slow
def test_an_impossible_temperature_is_not_learnt_from_and_is_reported():
    """One replay at 1000 °C, 0 K or infinity changes neither law nor range; three in a row raise the sensor's alert."""
    spoilt, sound, arm, rng = History(), History(), Arm(seed=5, noise=0.01), np.random.default_rng(5)
    for day in range(40):
        true = 31.0 + 3.0 * rng.normal()
        seen = arm.replay(true)
        sound.add(day, seen)
        odd = np.array([true, true, 1000.0, -273.0, np.inf, true])
        spoilt.add(day, replace(seen, temperature_c=odd) if day in {15, 30, 31, 32} else seen)
    for wrong, right in zip(spoilt.last.temperature, sound.last.temperature, strict=True):
        assert wrong.range_c == pytest.approx(right.range_c, abs=2.0)
        assert wrong.slope_nm_s_per_rad_k == pytest.approx(right.slope_nm_s_per_rad_k, abs=0.02)
    assert {(joint, condition) for _, _, joint, condition, _ in spoilt.transitions} == {(j, "temperature_sensor") for j in (3, 4, 5)}
    assert spoilt.last.belief.as_document() == json.loads(json.dumps(spoilt.last.belief.as_document(), allow_nan=False))
