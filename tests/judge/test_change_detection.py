"""The filter from replay to replay: which replays the noise is estimated from, and which sudden changes are detected."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import CONTEXT, DAY_S, START_S, Arm, lived_together, weather

from monitor.identify.identification import Identification
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import OUTLIER, WINDOW, replace_joints
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.update.change_detection import DENSE, SUMMED_STD, JointNoise, likelihood_ratios, summed_evidence, thresholds
from monitor.judge.learn import begin, learn
from monitor.judge.temperature.laws import TemperatureSettings

DRIFT, LAWS = DriftSettings(), TemperatureSettings()


def lived(replays: list[Identification]) -> list[Belief]:
    """The belief after each of the replays, one a day."""
    belief, beliefs = begin("ur5", CONTEXT, replays[0], START_S, settings=DRIFT, laws=LAWS), []
    for day, seen in enumerate(replays):
        belief = learn(belief, seen, CONTEXT, START_S + day * DAY_S, settings=DRIFT, laws=LAWS).belief
        beliefs.append(belief)
    return beliefs


def a_year(seed: int, *, days: int = 150, wear: dict[int, np.ndarray] | None = None) -> list[Identification]:
    """Daily replays under varying temperature; `wear` (6,) on single days."""
    arm, rng = Arm(seed=seed, autocorrelation=0.5), np.random.default_rng(seed)
    return [arm.replay(weather(day, rng), (wear or {}).get(day, 0.0)) for day in range(days)]


@pytest.mark.soak
def test_outliers_do_not_raise_the_estimated_noise():
    """Joint 3 is 35 % off every 15 days: its estimated noise is that of the same days without outliers, within 8 %."""
    wild = {day: np.array([0, 0, 0.35, 0, 0, 0]) for day in range(30, 150, 15)}
    days = [state.filter_state for state in lived_together([a_year(3), a_year(3, wear=wild)])]
    assert sum(joints.event[6 + 2] == OUTLIER for joints in days) == len(wild)
    calm, shaken = np.sqrt(days[-1].noise_var(6, DRIFT)).reshape(2, 6)
    assert shaken[2] / calm[2] == pytest.approx(1.0, abs=0.08)


@pytest.mark.soak
def test_replays_without_a_temperature_do_not_raise_the_estimated_noise():
    """Every tenth replay is 15 K colder without a temperature: the estimated noise is that of the other replays, within 8 %."""
    seen = a_year(4)
    arm = Arm(seed=40, autocorrelation=0.0)
    dark = [replace(arm.replay(16.0), temperature_c=None) if day > 20 and day % 10 == 0 else one for day, one in enumerate(seen)]
    calm, blind = np.sqrt(lived_together([seen, dark])[-1].filter_state.noise_var(6, DRIFT)).reshape(2, 6)
    assert np.allclose(blind / calm, 1.0, atol=0.08)


@pytest.mark.soak
def test_a_step_among_the_first_replays_belongs_to_the_baseline():
    """+7 % from the third replay on. As wear, its uncertainty would stay at 4 %, and later wear would not be detected."""
    settled = {day: np.full(6, 0.07) * (np.arange(6) == 1) for day in range(2, 150)}
    later = {day: wear if day < 90 else wear + 0.05 * 1.07 * (np.arange(6) == 1) for day, wear in settled.items()}
    states = lived_together([a_year(seed, wear=later) for seed in range(3)])
    before, after = states[85].filter_state, states[-1].filter_state
    assert before.wear[1::6] == pytest.approx(0.0, abs=0.015)
    assert np.all(before.wear_std[1::6] < 0.01)
    assert after.wear[1::6] == pytest.approx(np.log(1.05), abs=0.025)
    assert np.all(after.wear_std[1::6] < 0.015)


@pytest.mark.parametrize("first", [DRIFT.baseline_replays - 1, DRIFT.baseline_replays + 2])
@pytest.mark.parametrize("size", [1.0, -0.3])
@pytest.mark.slow
def test_a_jump_right_after_the_baseline_is_wear_although_it_is_gated(first, size):
    """Outliers count as replays although nothing is learnt from them: a jump at the 7th or 8th replay is wear, as at the 9th.

    So is a jump of so much before: neither noise nor running-in makes it.
    """
    jumped = {day: size * (np.arange(6) == 2) for day in range(first, 30)}
    belief = lived(a_year(8, days=30, wear=jumped))[-1]
    assert belief.filter_state.change[2] == pytest.approx(np.log1p(size), abs=0.06)


@pytest.mark.slow
def test_every_one_of_the_last_replays_may_be_the_start_of_a_change():
    """A step's first replay has most of its evidence: none of the youngest starts is dropped, and ever more of the older ones."""
    ages = lived(a_year(5))[-1].filter_state.ages[0]
    assert np.array_equal(ages[: DENSE + 1], np.arange(DENSE + 1))
    assert np.all(np.diff(ages) > 0)
    assert len(ages) == WINDOW
    assert np.max(np.diff(ages[DENSE:]) / ages[DENSE:-1]) < 0.25


@pytest.mark.parametrize("true", [0.20])
@pytest.mark.soak
def test_noise_far_above_its_prior_is_learnt_although_the_gate_excludes_much_of_it(true):
    """Noise of twice or ten times the prior of 2 %: after 80 days the estimate is within a quarter."""
    arm, rng = Arm(seed=11, noise=true), np.random.default_rng(11)
    belief = lived([arm.replay(weather(day, rng)) for day in range(80)])[-1]
    assert np.median(belief.noise_std(DRIFT)) == pytest.approx(true, rel=0.25)


def test_a_replaced_joint_has_no_outliers_behind_it():
    """The count of the old joint would let every outlier of the new one count as noise."""
    wild = {day: np.array([0, 0, 0.4, 0, 0, 0]) for day in range(20, 60, 5)}
    filter_state = lived(a_year(9, days=60, wear=wild))[-1].filter_state
    new = np.arange(6) == 2
    assert filter_state.outliers[2] >= len(wild) - 1
    assert replace_joints(filter_state, new, DRIFT).outliers[2] == 0
    assert np.array_equal(replace_joints(filter_state, new, DRIFT).outliers[~new], filter_state.outliers[~new])


@pytest.mark.soak
def test_noise_is_learnt_where_every_second_replay_has_no_temperature():
    """The replays before and after a blind one are compared: from a true 4 % the estimate is 3 to 5 %, and not the prior of 2 %."""
    arm, rng = Arm(seed=12, noise=0.04, within=0.002), np.random.default_rng(12)
    seen = [arm.replay(weather(day, rng)) for day in range(100)]
    blind = [replace(one, temperature_c=None) if day % 2 else one for day, one in enumerate(seen)]
    assert np.median(lived(blind)[-1].noise_std(DRIFT)) == pytest.approx(0.04, abs=0.01)


def test_a_wear_rate_that_only_a_few_replays_fit_needs_more_evidence():
    """At σ 2 %, six replays know a rate within 77 % a year and a step within 0.8 %: of the same ratio, the rate's counts two thirds.

    Thirty replays know the rate within 8 % a year, and its ratio counts in full.
    """
    ages = np.array([[6.0, 30.0]])
    information = np.stack([ages, ages * (ages + 1.0) * (2.0 * ages + 1.0) / 6.0], axis=1) / 0.02**2  # Σ G²/S of steps and of rates
    score = 6.0 * np.sqrt(information)
    settings = DriftSettings()
    enough, noise = np.ones((1, 2), dtype=bool), JointNoise(np.zeros(1), np.zeros(1), np.ones(1))
    ratio, relative = likelihood_ratios(score, information, information, ages, enough, settings, noise)
    assert ratio == pytest.approx(36.0)
    counted = relative * thresholds(ages, settings, noise) / ratio
    assert counted[0, 0] == pytest.approx(1.0, abs=0.01)
    assert counted[0, 1, 1] == pytest.approx(1.0, abs=0.01)
    assert counted[0, 1, 0] == pytest.approx(0.67, abs=0.02)


def evidence(score, information, *, inflation=1.0, starts=1, ages=None):
    """The summed evidence of one joint, of so many starts of a step that say the same; the rates say nothing."""
    told, scores = np.zeros((2, 1, 2, WINDOW))
    told[0, 0, :starts], scores[0, 0, :starts] = information, score
    ages = np.arange(WINDOW, dtype=float)[None] if ages is None else ages
    return summed_evidence(scores, told, np.full_like(told, inflation), ages, np.ones((1, WINDOW), dtype=bool))[0]


def test_evidence_of_a_rise_is_its_likelihood_averaged_over_the_sizes_that_a_rise_may_have():
    """By numerical integration over half of a Gaussian; a step of 3 % ± 1 %."""
    information, std = 1e4, SUMMED_STD[0, 0]
    score = 0.03 * information
    sizes = np.linspace(0.0, 10.0 * std, 200_001)
    prior = np.exp(-0.5 * (sizes / std) ** 2)
    expected = np.log(np.sum(prior * np.exp(sizes * score - 0.5 * sizes**2 * information)) / np.sum(prior))
    assert evidence(score, information) == pytest.approx(expected, abs=1e-3)


def test_starts_that_explain_the_same_add_up_and_an_old_one_stands_for_those_that_are_left_out():
    one = evidence(300.0, 1e4)
    assert evidence(300.0, 1e4, starts=8) == pytest.approx(one + np.log(8.0))
    assert evidence(300.0, 1e4, ages=4.0 * np.arange(WINDOW, dtype=float)[None]) == pytest.approx(one + np.log(4.0))


def test_a_fall_is_no_evidence_of_a_rise_and_chance_that_is_larger_weakens_it():
    assert evidence(-300.0, 1e4) < 0.0
    assert evidence(300.0, 1e4, inflation=2.0) < evidence(300.0, 1e4) - 1.0
    assert evidence(0.0, 0.0) == -np.inf


@pytest.mark.slow
def test_without_a_change_the_evidence_over_no_change_is_one_in_the_mean():
    """So a rise is found by chance as rarely as the threshold says."""
    information, N = 0.3 / SUMMED_STD[0, 0] ** 2, 4000  # so little that the mean of few draws tells
    told, scores = np.zeros((2, N, 2, WINDOW))
    told[:, 0, 0], scores[:, 0, 0] = information, np.sqrt(information) * np.random.default_rng(5).normal(size=N)
    ages = np.tile(np.arange(WINDOW, dtype=float), (N, 1))
    found = summed_evidence(scores, told, np.ones_like(told), ages, np.ones((N, WINDOW), dtype=bool))
    assert np.mean(np.exp(found)) == pytest.approx(1.0, abs=0.05)
