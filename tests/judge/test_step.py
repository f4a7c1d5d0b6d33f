"""The filter step: its documented example, and that the daemon and the fleet both go through every one of its stages."""

import doctest
import hashlib
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic_arm import CONTEXT, Arm, History, weather

from monitor.judge.drift import step
from monitor.judge.friction import step as friction
from monitor.judge.friction.figures import wear_and_rate
from monitor.judge.friction.observation import Observation
from monitor.judge.settings import AssessSettings
from monitor.reason import Reason
from monitor.studies.rehearsal.fleet import FleetSettings, Wear
from monitor.studies.rehearsal.play import play

ASSESS = AssessSettings()
DAYS, JUMP_DAY = 45, 25
DAMAGES = {}  # stage → (module in which it is looked up, its name, the damaged stage)


def damaged(module, name):
    """Register the decorated function, of the sound stage and its arguments, in place of a stage."""

    def register(damage):
        DAMAGES[name] = (module, name, damage)
        return damage

    return register


@damaged(step, "_check_sensors")
def every_third_sensor_is_stuck(sound, *args):
    sensors, stuck, _ = sound(*args)
    wrong = np.arange(len(stuck)) % 3 == 0
    return sensors, wrong, wrong


@damaged(step, "_withhold")
def everything_of_joint_2_is_withheld(sound, *args):
    seen = sound(*args)
    return seen._replace(log_torque=np.where(np.arange(len(seen.log_torque)) % 6 == 1, np.nan, seen.log_torque))


@damaged(step, "update_usage")
def every_day_is_two_days_of_production(sound, *args):
    production = sound(*args)
    return production._replace(usual_days=2.0 * production.usual_days)


@damaged(step, "inside_range")
def every_temperature_is_out_of_range(sound, range_c, temperature_c, margin_k):
    return np.zeros(len(temperature_c), dtype=bool)


@damaged(step, "_remember_baseline")
def the_first_replays_are_forgotten(sound, state, *args):
    return state


@damaged(step, "_learn_laws")
def the_laws_do_not_learn(sound, state, *args):
    return state


@damaged(step, "_look_beside")
def nothing_beside_is_looked_at(sound, state, *args):
    return state.beside


@damaged(friction, "_age")
def time_stands_still(sound, state, days, use, model):
    return sound(state, 0.0 * days, 0.0 * use, model)


@damaged(friction, "_remember")
def the_reference_temperature_stays_the_first_one(sound, state, seen):
    return None


@damaged(friction, "_learn")
def the_measurement_is_ignored(sound, state, seen, model, production):
    return None


@damaged(friction, "follow_scale")
def the_noise_is_not_learnt(sound, scale, *args):
    return scale


@damaged(friction, "absorb")
def a_change_that_was_found_is_not_part_of_the_filters(sound, *args):
    return None


@damaged(friction, "crossings")
def no_change_is_found(sound, *args):
    told = sound(*args)
    return told._replace(rises=0 * told.rises > 0, falls=0 * told.falls > 0, common=0 * told.common > 0)


def verdict() -> str:
    """The daemon's verdicts over a series: alerts, and the last assessment with its belief."""
    history, arm, rng = History(ASSESS), Arm(seed=3, autocorrelation=0.5), np.random.default_rng(3)
    for day in range(DAYS):
        seen = arm.replay(weather(day, rng) + 0.3 * np.arange(6), np.array([0, 0.4 * (day >= JUMP_DAY), 0, 0, 0, 0]))
        if day == 8:
            seen = replace(seen, warnings=(Reason("mounting_contradiction", {}, "gravity is 90° off"),))
        awaiting_proof = 4000.0 * (day - day // 7)
        history.add(day, seen, replace(CONTEXT, revolutions=(awaiting_proof,) * 6, payload_kg=2.0 if day in {15, 16} else 0.0))
    last = history.last
    return json.dumps([history.transitions, last.as_document(), last.belief.as_document(), last.health.as_document()])


def figures() -> str:
    """What the fleet's life comes to: every figure of `play`, and the state at its end."""
    A = 8
    joint = np.arange(A) % 6.0
    wear = Wear(joint=joint, onset_day=np.full(A, float(JUMP_DAY)), step=np.full(A, 0.4), per_day=np.full(A, 0.001))
    played = play(FleetSettings(arms=A, days=DAYS, seed=3), ASSESS, wear, learning=15)
    state = played.state
    arrays = [played.tier_day, played.falling_day, played.common_day, played.covered, played.slope_error_per_k]
    arrays += [state.reference_temperature_c, state.first_log_torque, state.viscous.range_c, wear_and_rate(state.friction).mean]
    arrays += [series.p for series in state.beside.values()]
    return " ".join(hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for array in arrays)


@cache
def sound() -> tuple[str, str]:
    """Of undamaged stages."""
    return verdict(), figures()


def test_the_example_of_the_step_runs():
    """The documented way to judge one's own fleet gives what its text promises."""
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    [example] = finder.find(step.step, "step", globs={})
    runner.run(example)
    assert runner.tries > 10
    assert runner.failures == 0


@pytest.mark.slow
def test_without_a_damage_verdict_and_figures_are_what_they_were():
    """Neither depends on anything but its seed; the sabotage below is not seen by chance."""
    again, before = (verdict(), figures()), sound()
    assert again == before
    assert '"sudden_step"' in before[0]


SAMPLE = list(DAMAGES)[::5]


@pytest.mark.parametrize("stage", [*SAMPLE, *(pytest.param(name, marks=pytest.mark.soak) for name in DAMAGES if name not in SAMPLE)])
@pytest.mark.slow
def test_a_damaged_stage_changes_the_daemons_verdict_and_the_fleets_figures(stage, monkeypatch):
    """Both go through the one step: there is no copy of it that could be left behind."""
    before = sound()
    module, name, damage = DAMAGES[stage]
    whole = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *args, **kwargs: damage(whole, *args, **kwargs))
    assert verdict() != before[0]
    assert figures() != before[1]


def days_of_two_arms(number: int) -> list[Observation]:
    """That many replays of two arms in healthy joints; the second arm has not begun in the first one, and nothing of it is known."""
    rng, seen = np.random.default_rng(4), []
    for day in range(number):
        torque = 10.0 * np.exp(0.01 * rng.normal(size=12))
        torque[6:] *= np.nan if day == 0 else 1.0
        seen.append(
            Observation(
                log_torque=np.log(torque),
                variance=np.full(12, 0.005**2),
                temperature_c=30.0 + 0.0 * torque,
                viscous_share=0.4 + 0.0 * torque,
                warming_k_per_min=0.0 * torque,
                coulomb_nm=0.6 * torque,
                viscous_nm_s_per_rad=torque,
            )
        )
    return seen


def test_an_arm_that_is_absent_at_the_beginning_is_learnt_when_it_comes():
    """Its unknown share of viscous friction in the fleet's first replay leaves no unknown figure behind."""
    seen = days_of_two_arms(10)
    state = step.initial_state(seen[0], 6, ASSESS)
    for day, observation in enumerate(seen):
        here = np.array([True, day > 0])
        days = np.array([float(day > 0), float(day > 1)])
        state = step.step(state, step.Replay(observation=observation, days=days, replayed=here), ASSESS).state
    assert np.all(np.isfinite(state.friction.x))
    assert np.all(np.isfinite(state.friction.P))
    assert list(state.friction.of_joints(state.friction.replays)) == [10.0] * 6 + [9.0] * 6


@pytest.mark.parametrize("days", [-1.0, np.nan])
def test_a_replay_before_the_last_one_is_refused_and_the_arm_is_named(days):
    """Time that runs backwards would make the filter surer; days of an arm that did not replay say nothing."""
    [_, seen] = days_of_two_arms(2)
    state = step.initial_state(seen, 6, ASSESS)
    replay = step.Replay(observation=seen, days=np.array([0.0, days]))
    with pytest.raises(ValueError, match=r"arm 1 of 2: .*expected 0 or more"):
        step.step(state, replay, ASSESS)
    step.step(state, replace(replay, replayed=np.array([True, False])), ASSESS)
