"""Steps, spells of outliers and common changes, over fleets: what is found, how soon, and how large it is told."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_reference import Lived, of_joint
from test_required_evidence import J
from test_spells import AT, DOWNWARDS, WHICH, changes, spell
from test_undetected_change import DRIFT, LAWS, observation

from monitor.judge.drift.filter_state import STEP
from monitor.judge.drift.step import Replay, initial_state, step
from monitor.judge.drift.undetected_change import FOUND_SIGMAS, unseen_step
from monitor.judge.drift.update import change_detection
from monitor.judge.drift.update.change_detection import JointNoise, thresholds

pytestmark = pytest.mark.soak


@given(st.integers(1, 3), st.lists(st.floats(0.1, 0.7), min_size=3, max_size=5), st.booleans())
@settings(max_examples=10, deadline=None)
def test_a_step_is_never_found_on_the_other_side_of_the_outliers_that_found_it(seed, sizes, downwards):
    """Whatever they are, and however many; nor is it much larger than the largest."""
    side = -1.0 if downwards else 1.0
    size, _ = changes(spell([side * each for each in sizes], arms=6, seed=seed))
    assert np.all(side * size >= -0.05)
    assert np.all(side * size <= 1.25 * max(sizes) + 0.05)


def test_outliers_that_agree_are_told_at_once():
    """Three replays that are 20 % off raise an alert of the joint on the third day, in both directions."""
    for value, told in ((0.2, "rises"), (-0.2, "falls")):
        lived = spell((value,) * 3)
        size, found = changes(lived)
        assert found.sum() >= 18
        assert size[found] == pytest.approx(value, abs=0.04)
        assert getattr(lived, told)[-1, :, WHICH].sum() >= 18


def test_a_joint_that_rises_day_by_day_is_told_within_days():
    """Friction that is higher every day differs too: it is told, and its size is known once it stays."""
    lived = spell((0.1, 0.45, 0.76), after=20, then=0.76)
    assert lived.rises[AT + 6 :, :, WHICH].all()
    assert changes(lived)[0] == pytest.approx(0.76, abs=0.06)


@pytest.mark.parametrize("values", DOWNWARDS)
def test_friction_that_was_low_for_some_days_is_no_wear_afterwards(values):
    """No sound joint stands at a tier because three low days differed."""
    assert spell(values, after=60).rises[-1, :, WHICH].sum() <= 1


def test_running_in_is_no_alert_and_hides_no_step():
    """Friction falls by 8 % in two months, in all joints: nothing is told of it. A step of 8 % on day 200 is told of its joint alone."""

    def path(day):
        return -0.08 * (1.0 - np.exp(-day / 60.0)) + of_joint(2, 0.08 * (day >= 200))

    lived = Lived(8, 250, path)
    assert not lived.rises[:200].any()
    assert not lived.falls.any()
    assert not lived.together.any()
    assert lived.rises[:, :, 2].any(axis=0).sum() >= 7
    assert not np.delete(lived.rises, 2, axis=2).any()


def test_new_grease_that_nobody_declared_is_told_and_hides_no_wear():
    """A fall of 10 % at once is told within 10 days; wear of 20 % a year from then on, although friction stays below the beginning."""

    def path(day):
        return of_joint(1, np.log(0.9) * (day >= 70) + np.log1p(0.2 * max(day - 70, 0) / 365.0))

    lived = Lived(8, 220, path, seed=1)  # 46 of 48 arms within 130 days, in half of them 80
    assert lived.falls[70:80, :, 1].any(axis=0).sum() >= 7
    assert not lived.rises[:70].any()
    assert path(219)[1] < -0.02
    assert lived.rises[:, :, 1].any(axis=0).sum() >= 7


def test_a_small_payload_is_told_of_the_arm():
    """Shoulder and elbow rise by 4 and 3 %, the wrists by less than 1 %: few arms are told of a joint's wear."""
    pattern = np.array([0.003, 0.04, 0.03, 0.01, 0.008, 0.0])
    lived = Lived(16, 140, lambda day: pattern * (day >= 70), seed=5)
    assert lived.rises.any(axis=(0, 2)).sum() <= 3
    assert lived.together.any(axis=0).sum() >= 10


def test_chance_finds_no_more_in_a_year_of_four_replays_a_day(monkeypatch):
    """Sixty healthy arms for three months, ρ 0.5 from replay to replay: most of what four times as many chances find is none."""

    def found():
        return Lived(60, 360, lambda number: np.zeros(J), seed=4, interval_days=0.25).found.any(axis=0).sum()

    often = found()
    monkeypatch.setattr(change_detection, "OF_FREQUENT", 0.0)
    assert often <= 0.4 * found()


def test_a_step_in_a_noisy_joint_is_found_sooner_than_by_the_threshold_of_a_usual_one(monkeypatch):
    """Thirty arms of σ 3.8 %, and a step of 5 % in their third joints: sooner in some of them, and later in none."""

    def found():
        return Lived(30, 220, lambda day: of_joint(2, 0.05 * (day >= 140)), seed=1, between_std=0.038).found

    noisy = found()
    monkeypatch.setattr(change_detection, "OF_NOISE", 0.0)
    usual = found()
    alike = np.all(noisy[:140] == usual[:140], axis=(0, 2))  # no chance was found before
    assert alike.sum() >= 25
    noisy, usual = (np.where(each[140:, alike, 2].any(axis=0), np.argmax(each[140:, alike, 2], axis=0), 80) for each in (noisy, usual))
    assert np.all(noisy <= usual)
    assert np.mean(noisy < usual) >= 0.1
    assert np.mean(usual - noisy) >= 0.4


def test_the_step_that_may_be_unseen_is_the_one_that_detection_finds():
    """Of 100 joints of σ = 2 % that step by the size told for each of them, detection finds nine of ten at least in ten days, to 80 %."""
    rng, arms, day = np.random.default_rng(3), 20, 90
    N, state = 6 * arms, None
    noise = np.zeros(N)
    found, told = np.zeros(N, dtype=bool), np.zeros(N)
    stepped = np.arange(N) % 6 < 5
    for k in range(day + 11):
        noise = 0.5 * noise + np.sqrt(0.75) * 0.02 * rng.normal(size=N)
        replay = observation(noise + np.where((k >= day) & stepped, told, 0.0))
        state = state or initial_state(replay, 6, DRIFT, LAWS)
        state = step(state, Replay(observation=replay, days=np.full(arms, float(k > 0))), DRIFT, LAWS).state
        if k == day - 1:
            unseen = unseen_step(state.filter_state, 6, DRIFT)
            stepped &= np.isfinite(unseen.days)  # nothing is told after a detection a few days ago
            assert stepped.sum() >= 95
            told = np.where(stepped, unseen.log_rise, 0.0)
            assert np.allclose(unseen.days[stepped], 10.0, atol=0.1)
            assert np.all((told[stepped] > 0.02) & (told[stepped] < 0.12))
        if k >= day:
            found |= state.filter_state.event == STEP
    assert found[stepped].mean() >= 0.8


def test_the_step_that_may_be_unseen_is_by_the_threshold_of_the_joints_noise():
    """Three replays a day, of σ 4 %: after ten days detection needs less than in a joint of σ 2 %, and that is what is told."""
    rng, state = np.random.default_rng(5), None
    for k in range(270):
        replay = observation(0.04 * rng.normal(size=6))
        state = state or initial_state(replay, 6, DRIFT, LAWS)
        state = step(state, Replay(observation=replay, days=np.full(1, (k > 0) / 3.0)), DRIFT, LAWS).state
    told, seen = unseen_step(state.filter_state, 6, DRIFT), state.filter_state
    at = np.argmin(np.abs(seen.ages / 3.0 - told.days[:, None]), axis=1)[:, None]
    information = np.take_along_axis(seen.glr_informations[:, 0] / seen.chance.of_starts()[:, 0], at, axis=1)[:, 0]
    sigmas = told.log_rise * np.sqrt(information) - FOUND_SIGMAS
    noisy, usual = (
        np.take_along_axis(thresholds(seen.ages, DRIFT, JointNoise(np.zeros(6), var, seen.interval_days))[:, 0], at, axis=1)[:, 0]
        for var in (seen.noise_var(6, DRIFT), np.zeros(6))
    )
    assert sigmas**2 == pytest.approx(noisy, rel=1e-9)
    assert np.all(noisy < usual - 0.1)
