"""Noise that no model assumed: a healthy arm stays quiet, and a step is still found."""

import numpy as np
import pytest
from evidence.lived import J, correlated, flicker, learnt_correlation
from evidence.lived import lived as lived_by_fleet

from monitor.judge.drift.step import DriftState
from monitor.judge.friction.figures import found_wear, noise_var
from monitor.judge.settings import AssessSettings
from monitor.recording import Array

SETTINGS = AssessSettings()
MODEL = SETTINGS.friction


def lived(log_torque: Array, learning: int = 60) -> tuple[DriftState, np.ndarray]:
    """The state after daily replays (days, N) at one temperature, and which joints had a tier or fell after `learning` days."""
    whole = lived_by_fleet(log_torque)
    return whole.state, whole.told(slice(learning, None)).ravel()


@pytest.mark.slow
def test_a_shock_that_fades_is_no_step_and_a_step_is_found_within_days():
    """Both begin 40 % up; the shock's noise halves from replay to replay."""
    rng, days = np.random.default_rng(2), 128
    noise = correlated(rng, days, 2 * J, std=0.02, rho=0.5)
    noise[120:, 1] += 0.4 * 0.5 ** np.arange(8)
    noise[120:, J + 1] += 0.4
    state, alerted = lived(noise)
    wear, std = found_wear(state.friction)
    assert abs(wear[1]) < 0.01
    assert np.flatnonzero(alerted).tolist() == [J + 1]
    assert abs(wear[J + 1] - 0.4) < 3.0 * std[J + 1]


def test_noise_far_below_its_prior_is_learnt_within_weeks():
    """Noise of 0.7 % and no correlation: after 30 replays neither the prior of 2 % nor what was taken off for it is left in either."""
    rng = np.random.default_rng(3)
    state, _ = lived(correlated(rng, 30, 10 * J, std=0.007, rho=0.0))
    assert np.median(np.sqrt(noise_var(state.friction, MODEL))) < 0.009
    assert np.median(learnt_correlation(state.friction, MODEL)) < 0.4


@pytest.mark.parametrize(
    ("law", "onset", "days"),
    [
        (lambda t: 0.1 * (t > 0), 30, 7),
        (lambda t: 0.02 * t, 30, 7),
        (lambda t: 0.002 * t**2, 30, 9),
        (lambda t: 0.02 * t, 14, 30),
        (lambda t: 0.002 * t**2, 14, 14),
    ],
    ids=["a step of 10 %", "2 % a day", "accelerating", "2 % a day after two weeks", "accelerating after two weeks"],
)
@pytest.mark.slow
def test_fast_wear_is_at_a_tier_within_days(law, onset, days):
    """Growing outliers in a row are no shock that fades. (A step in the first weeks may be noise of a kind that nobody has seen yet.)"""
    rng, arms = np.random.default_rng(4), 20
    noise = correlated(rng, onset + days + 1, arms * J, std=0.003, rho=0.0)
    grown = np.log1p([law(max(day - onset + 1, 0)) for day in range(len(noise))])
    noise[:, 2::J] += grown[:, None]
    _, alerted = lived(noise, learning=onset)
    assert np.mean(alerted[2::J]) >= 0.9
    assert not np.any(np.delete(alerted.reshape(arms, J), 2, axis=1))


def test_joints_are_as_alike_as_they_prove_to_be():
    """One joint has four times the variance of the others: after weeks it is believed to be between, after a year it is its own."""
    rng = np.random.default_rng(5)
    std = np.tile(np.where(np.arange(J) == 2, 0.02, 0.01), 8)
    noise = std * correlated(rng, 365, 8 * J, std=1.0, rho=0.3)
    ratio = []
    for days in (15, 365):
        of_all = np.sqrt(noise_var(lived(noise[:days])[0].friction, MODEL)).reshape(8, J)
        ratio.append(np.median(of_all[:, 2]) / np.median(np.delete(of_all, 2, axis=1)))
    assert 1.0 < ratio[0] < 1.9
    assert ratio[1] == pytest.approx(2.0, rel=0.15)


@pytest.mark.slow
def test_an_arm_with_outliers_is_quiet_and_its_steps_are_found():
    """One replay in fifty is 12 σ off, in either direction and in any joint: none of them is a change, and a step of 10 % is."""
    rng, arms, days = np.random.default_rng(6), 8, 230
    noise = correlated(rng, days, arms * J, std=0.01, rho=0.3)
    noise += np.where(rng.random(noise.shape) < 0.02, rng.choice([-0.12, 0.12], noise.shape), 0.0)
    noise[200:, 3::J] += 0.10
    state, alerted = lived(noise)
    of_arms = alerted.reshape(arms, J)
    assert not np.delete(of_arms, 3, axis=1).any()
    assert of_arms[:, 3].sum() >= 7
    assert found_wear(state.friction)[0].reshape(arms, J)[:, 3].max() < 0.13


@pytest.mark.slow
def test_noise_that_wanders_in_all_joints_raises_few_alerts():
    """1/f over two years, which no kind of noise is: of 48 joints one or two at most are told."""
    _, alerted = lived(flicker(np.random.default_rng(8), 500, 4 * J), learning=120)
    assert alerted.sum() <= 2


@pytest.mark.slow
def test_a_joints_own_rise_never_excuses_it_and_its_noise_stays_what_it_was():
    """A joint that rises by 20 % a year is told; noise that wanders is believed of none of the arm."""
    rng, days = np.random.default_rng(9), 200
    noise = correlated(rng, days, 4 * J, std=0.01, rho=0.4)
    noise[:, 1::J] += np.log1p(0.2 / 365.0 * np.maximum(np.arange(days) - 60, 0))[:, None]
    state, alerted = lived(noise)
    assert np.array_equal(alerted.reshape(4, J).any(axis=0), np.arange(J) == 1)
    assert alerted.reshape(4, J)[:, 1].all()
    kinds = np.array([kind.kappa > 0.0 for kind in MODEL.noise.kinds])
    assert not kinds[state.friction.of_joints(state.friction.p).argmax(axis=0)].any()


@pytest.mark.slow
def test_a_joint_differs_from_its_arm_in_correlation_as_far_as_it_proves_to():
    """One joint of ρ 0.9 in an arm of 0.2: after two months it is between, after a year its own; the others stay the arm's."""
    rng, arms = np.random.default_rng(10), 6
    rho = np.tile(np.where(np.arange(J) == 2, 0.9, 0.2), arms)
    noise = correlated(rng, 365, arms * J, std=0.02, rho=rho)
    found = learnt_correlation(lived(noise)[0].friction, MODEL).reshape(arms, J)
    assert np.median(found[:, 2]) > 0.75
    assert np.median(np.delete(found, 2, axis=1)) == pytest.approx(0.2, abs=0.12)
