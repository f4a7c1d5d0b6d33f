"""Noise that no model assumed: a healthy arm stays quiet, a step is still found, and beliefs from before go on."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.judge.alerts.evidence import nothing_counted, wear_of_state, weigh_evidence
from monitor.judge.drift.noise.chance import AGES, GROUPS, LEAST, LONGEST, inflation_of, nothing_seen
from monitor.judge.drift.noise.correlation import own_correlation
from monitor.judge.drift.noise.size import LEAST_SIGMA, MOST_SIGMA, alike, counted_sigma, follow, present
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.settings import HealthSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.recording import Array

J = 6
DRIFT, LAWS, HEALTH = DriftSettings(), TemperatureSettings(), HealthSettings()


def correlated(rng: np.random.Generator, days: int, joints: int, *, std: float, rho: float | Array, shocks: Array | None = None) -> Array:
    """(days, joints) noise with correlation ρ from replay to replay."""
    new = rng.normal(size=(days, joints)) if shocks is None else shocks
    noise = new.copy()
    for day in range(1, days):
        noise[day] = rho * noise[day - 1] + np.sqrt(1.0 - rho**2) * new[day]
    return std * noise


def flicker(rng: np.random.Generator, days: int, joints: int) -> Array:
    """(days, joints) noise with a spectrum of 1/f and a standard deviation of 2 %; it ends where it began."""
    f = np.fft.rfftfreq(days)
    f[0] = np.inf
    wave = (rng.normal(size=(len(f), joints)) + 1j * rng.normal(size=(len(f), joints))) / np.sqrt(f)[:, None]
    noise = np.fft.irfft(wave, days, axis=0)
    scaled: Array = 0.02 * noise / noise.std(axis=0)
    return scaled


def lived(log_torque: Array, learning: int = 60) -> tuple[DriftState, np.ndarray]:
    """The state after daily replays (days, N) at one temperature, and which joints had a tier or fell after `learning` days."""
    N = log_torque.shape[1]
    state, counts, alerted = None, nothing_counted(N, N // J), np.zeros(N, dtype=bool)
    for day, y in enumerate(log_torque):
        seen = Observation(
            log_torque=2.0 + y,
            variance=np.full(N, 0.005**2),
            temperature_c=np.full(N, 30.0) + 0.1 * np.sin(day),
            viscous_share=np.full(N, 0.4),
            warming_k_per_min=np.zeros(N),
            coulomb_nm=0.6 * np.exp(2.0 + y),
            viscous_nm_s_per_rad=np.exp(2.0 + y),
        )
        state = state or initial_state(seen, J, DRIFT, LAWS)
        result = step(state, Replay(observation=seen, days=np.full(N // J, float(day > 0))), DRIFT, LAWS)
        state = result.state
        usable = state.filter_state.learnt_from & result.inside_range
        evidence = weigh_evidence(wear_of_state(state.filter_state, usable, day), counts, J, HEALTH)
        counts = evidence.counts
        alerted |= (day >= learning) & ((evidence.raises >= 0) | evidence.falls)
    assert state is not None
    return state, alerted


@pytest.mark.slow
def test_a_shock_that_fades_is_no_step_and_a_step_is_found_at_its_third_replay():
    """Both begin 40 % up; the shock's noise halves from replay to replay."""
    rng, days = np.random.default_rng(2), 83
    noise = correlated(rng, days, 2 * J, std=0.02, rho=0.5)
    noise[80:, 1] += 0.4 * 0.5 ** np.arange(3)
    noise[80:, J + 1] += 0.4
    state, _ = lived(noise)
    assert abs(state.filter_state.wear[1]) < 0.01
    assert state.filter_state.wear[J + 1] == pytest.approx(0.4, abs=0.06)


def test_noise_far_below_its_prior_is_learnt_within_weeks():
    """Noise of 0.7 % and no correlation: after 30 replays neither the prior of 2 % nor what was taken off for it is left in either."""
    rng = np.random.default_rng(3)
    state, _ = lived(correlated(rng, 30, 10 * J, std=0.007, rho=0.0))
    filter_state = state.filter_state
    assert np.median(np.sqrt(filter_state.noise_var(J, DRIFT))) < 0.009
    assert np.median(filter_state.autocorrelation(J, DRIFT)) < 0.4


@pytest.mark.parametrize(
    ("law", "days"),
    [(lambda t: 0.1 * (t > 0), 2), (lambda t: 0.02 * t, 5), (lambda t: 0.002 * t**2, 7)],
    ids=["a step of 10 %", "2 % a day", "accelerating"],
)
@pytest.mark.slow
def test_fast_wear_after_two_weeks_is_at_a_tier_within_days(law, days):
    """Growing outliers in a row are no shock that fades: nine of ten are found as soon as release 0.1.0 found half of them."""
    rng, arms, onset = np.random.default_rng(4), 30, 14
    noise = correlated(rng, onset + days + 1, arms * J, std=0.003, rho=0.0)
    grown = np.log1p([law(max(day - onset + 1, 0)) for day in range(len(noise))])
    noise[:, 2::J] += grown[:, None]
    _, alerted = lived(noise, learning=onset)
    assert np.mean(alerted[2::J]) >= 0.9
    assert not np.any(np.delete(alerted.reshape(arms, J), 2, axis=1))


def test_joints_are_as_alike_as_they_prove_to_be():
    """Few replays: near the arm's mean. Many: each its own. Equal joints stay equal, and no joint leaves the range of all."""
    var = np.array([1.0, 1.0, 4.0, 1.0, 0.25, 1.0]) * 4e-4
    few, many = alike(var, np.full(J, 3.0), J), alike(var, np.full(J, 300.0), J)
    assert np.ptp(np.log(few)) < 0.6 * np.ptp(np.log(var))
    assert np.allclose(many, var, rtol=0.1)
    assert np.allclose(alike(np.full(J, 4e-4), np.full(J, 50.0), J), 4e-4)
    assert few.min() >= var.min()
    assert few.max() <= var.max()


def test_an_arm_with_outliers_counts_each_replay_for_less():
    """Gaussian noise, outliers in one joint and in none of another arm: the joints of the arm share the bound, and others do not."""
    replays, outliers = np.full(2 * J, 300.0), np.zeros(2 * J)
    outliers[1] = 30.0
    counted = counted_sigma(outliers, replays, J)
    assert np.all(counted[:J] < 2.0)
    assert np.all(counted[:J] >= LEAST_SIGMA)
    assert np.all(counted[J:] == MOST_SIGMA)
    assert np.all(counted_sigma(np.zeros(J), np.zeros(J), J) == MOST_SIGMA)


def test_the_present_noise_follows_the_arm_and_not_chance():
    """Ten per cent more is chance; noise of four times the variance for a month is there after it, and no replay changes nothing."""
    assert np.array_equal(present(np.full(J, 1.1), J), np.ones(J))
    activity = np.ones(J)
    for _ in range(30):
        activity = follow(activity, np.full(J, 4.0), J)
    assert np.all(present(activity, J) > 3.0)
    assert np.array_equal(follow(activity, np.full(J, np.nan), J), activity)


def test_a_joints_own_rises_never_excuse_it():
    """However large the scores of a joint's rises, its own inflation stays; that of the other joints grows."""
    chance = nothing_seen(J)
    chance.replays[:] = 200.0
    chance.mean[:] = 0.5
    before = inflation_of(chance, np.tile(AGES + 2.0, (J, 1)), J)
    chance.mean[3, :, 1] = 50.0
    after = inflation_of(chance, np.tile(AGES + 2.0, (J, 1)), J)
    assert np.allclose(after[3], before[3])
    assert np.all(after[[0, 1, 2, 4, 5]] > before[[0, 1, 2, 4, 5]])
    assert np.all(before >= LEAST)
    assert before.shape == (J, 2, GROUPS)


def test_noise_that_does_not_average_out_makes_wear_of_years_less_sure():
    """Ten times as long as the oldest candidate: ten times the excess. Chance as the model says, and wear of weeks, stay what they are."""
    chance = replace(nothing_seen(3), since=np.array([20.0, LONGEST, 10.0 * LONGEST]))
    assert np.array_equal(chance.of_wear(), np.ones(3))
    noisy = replace(chance, inflation=np.broadcast_to(np.linspace(1.0, 4.5, GROUPS), chance.inflation.shape))
    assert noisy.of_wear() == pytest.approx([3.0, 4.5, 36.0])


def test_a_joint_differs_from_its_arm_in_correlation_as_far_as_it_proves_to():
    """Few replays, or six joints that differ by chance: the arm's ρ. Many, and joints that clearly differ: each its own."""
    chance = 0.5 + 0.05 * np.array([1.0, -1.0, 0.5, -0.5, 0.2, -0.2])
    one, all_differ = np.array([0.5, 0.5, 0.9, 0.5, 0.5, 0.5]), np.linspace(0.0, 0.9, J)
    arm = np.full(J, 0.5)

    def own(seen: Array, replays: float) -> Array:
        return own_correlation(seen, arm, arm, np.full(J, replays), J)

    assert np.ptp(own(chance, 300.0)) < 0.02
    assert np.ptp(own(all_differ, 6.0)) < 0.6 * np.ptp(all_differ)
    assert own(all_differ, 300.0) == pytest.approx(all_differ, abs=0.1)
    assert own(one, 300.0)[2] > 0.75
    assert np.all(np.abs(own(np.array([-3.0, 3.0, 0.5, 0.5, 0.5, 0.5]), 2.0)) <= 1.0)  # of two replays ρ may be anything
