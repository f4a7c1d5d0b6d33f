"""What a fleet by somebody else found: shocks of a few days, steps in noise that lasts, weeks without a temperature, noise that grows."""

import numpy as np
import pytest
from test_noise import correlated

from monitor.judge.alerts.evidence import nothing_counted, wear_of_state, weigh_evidence
from monitor.judge.drift.noise.size import follow, present
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import Replay, initial_state, step
from monitor.judge.settings import HealthSettings
from monitor.judge.temperature.laws import TemperatureSettings
from monitor.recording import Array

J, FALL_PER_K = 6, 0.008
DRIFT, LAWS, HEALTH = DriftSettings(), TemperatureSettings(), HealthSettings()


def noise(seed: int, days: int, arms: int, *, rho: float | Array) -> Array:
    """(days, A·J) noise of 2 %; rho : of all joints, or of each (A·J,)."""
    return correlated(np.random.default_rng(seed), days, arms * J, std=0.02, rho=rho)


def lived(log_torque: Array, temperature_c: Array | None = None, unknown: np.ndarray | None = None) -> tuple[Array, Array, np.ndarray]:
    """Wear, its ± and whether an alert may be raised, (days, N) each, after daily replays.

    log_torque : (days, N) at 30 °C; temperature_c : (days,); unknown : (days,) whether joint 1 of each arm has no temperature.
    """
    days, N = log_torque.shape
    T = np.full(days, 30.0) if temperature_c is None else temperature_c
    wear, std, raised = np.zeros((days, N)), np.zeros((days, N)), np.zeros((days, N), dtype=bool)
    state, counts = None, nothing_counted(N, N // J)
    for day in range(days):
        y = 2.0 + log_torque[day] - FALL_PER_K * (T[day] - 30.0)
        silent = (np.arange(N) % J == 0) & (unknown is not None and unknown[day])
        seen = Observation(
            log_torque=y,
            variance=np.full(N, 0.005**2),
            temperature_c=np.where(silent, np.nan, T[day] + 0.3 * np.sin(day)),
            viscous_share=np.full(N, 0.4),
            warming_k_per_min=np.zeros(N),
            coulomb_nm=0.6 * np.exp(y),
            viscous_nm_s_per_rad=np.exp(y),
        )
        state = state or initial_state(seen, J, DRIFT, LAWS)
        result = step(state, Replay(observation=seen, days=np.full(N // J, float(day > 0))), DRIFT, LAWS)
        state, joints = result.state, result.state.filter_state
        evidence = weigh_evidence(wear_of_state(joints, joints.learnt_from & result.inside_range, day), counts, J, HEALTH)
        counts = evidence.counts
        wear[day], std[day], raised[day] = joints.wear, joints.wear_std, evidence.raises >= 0
    return wear, std, raised


@pytest.mark.soak
def test_a_shock_of_three_days_makes_no_more_wear_than_was_seen() -> None:
    """Joints 1, 3 and 5 of 20 arms are 15 % up for three days: wear is never told above 25 %, nor with more than ± 6 %."""
    y = noise(3, 112, 20, rho=0.5)
    shaken = np.arange(y.shape[1]) % 2 == 0
    y[100:103, shaken] += 0.15
    wear, std, _ = lived(y)
    assert wear[:, shaken].max() < 0.25
    assert std[100:, shaken].max() < 0.06


@pytest.mark.slow
def test_weeks_without_a_temperature_teach_no_wear() -> None:
    """Joint 1 has none for eight weeks, in which the hall cools by 10 K and friction rises by 8 %: no alert, no wear above 2 %."""
    days = np.arange(240)
    hall = 30.0 - 10.0 / (1.0 + np.exp(-(days - 140.0) / 6.0)) + np.where(days < 60, 6.0 * np.sin(days / 4.0), 0.0)
    wear, _, raised = lived(noise(5, 240, 8, rho=0.5), hall, (days >= 120) & (days < 176))
    assert not raised[120:, ::J].any()
    assert wear[176:, ::J].max() < 0.02


def test_noise_that_grows_is_taken_for_what_it_is_within_a_fortnight() -> None:
    """Squares four times as large: after ten replays the variance is taken for 2.5 times as large or more, and not for more than 4."""
    activity = np.ones(J)
    for _ in range(10):
        activity = follow(activity, np.full(J, 4.0), J)
    grown = present(activity, J)
    assert (grown >= 2.5).all()
    assert (grown <= 4.0).all()
    for _ in range(60):
        activity = follow(activity, np.full(J, 1.0), J)
    assert present(activity, J) == pytest.approx(1.0)
