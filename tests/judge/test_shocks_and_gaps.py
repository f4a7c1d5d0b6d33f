"""What a fleet by somebody else found: shocks of a few days, steps in noise that lasts, weeks without a temperature, noise that grows."""

import numpy as np
import pytest
from test_noise import correlated

from monitor.judge.alerts.evidence import weigh_evidence
from monitor.judge.drift.step import DriftState, Replay, initial_state, step
from monitor.judge.friction.figures import found_wear, noise_var
from monitor.judge.friction.observation import Observation
from monitor.judge.settings import AssessSettings
from monitor.recording import Array

J, FALL_PER_K = 6, 0.008
SETTINGS = AssessSettings()


def noise(seed: int, days: int, arms: int, *, rho: float | Array) -> Array:
    """(days, A·J) noise of 2 %; rho : of all joints, or of each (A·J,)."""
    return correlated(np.random.default_rng(seed), days, arms * J, std=0.02, rho=rho)


class Lived:
    """Wear, its ±, the noise that is believed and whether an alert may be raised, (days, N) each, after daily replays.

    log_torque : (days, N) at 30 °C; temperature_c : (days,); unknown : (days,) whether joint 1 of each arm has no temperature.
    """

    def __init__(self, log_torque: Array, temperature_c: Array | None = None, unknown: np.ndarray | None = None) -> None:
        days, N = log_torque.shape
        T = np.full(days, 30.0) if temperature_c is None else temperature_c
        self.wear, self.std, self.noise = np.zeros((3, days, N))
        self.raised = np.zeros((days, N), dtype=bool)
        state: DriftState | None = None
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
            state = state or initial_state(seen, J, SETTINGS)
            state = step(state, Replay(observation=seen, days=np.full(N // J, float(day > 0))), SETTINGS, in_place=True).state
            self.wear[day], self.std[day] = found_wear(state.friction)
            self.noise[day] = np.sqrt(noise_var(state.friction, SETTINGS.friction))
            self.raised[day] = weigh_evidence(state, SETTINGS.health).raises >= 0


@pytest.mark.soak
def test_a_shock_of_three_days_makes_no_more_wear_than_was_seen() -> None:
    """Joints 1, 3 and 5 of 20 arms are 15 % up for three days: wear is never told above 25 %, nor with more than ± 6 %.

    One joint of 120 may be told afterwards: of 1200 that were shaken 9 are, and of as many beside them 1.
    """
    y = noise(3, 112, 20, rho=0.5)
    shaken = np.arange(y.shape[1]) % 2 == 0
    y[100:103, shaken] += 0.15
    lived = Lived(y)
    assert lived.wear[:, shaken].max() < 0.25
    assert lived.std[100:, shaken].max() < 0.06
    assert lived.raised[106:].any(axis=0).sum() <= 1


@pytest.mark.slow
def test_weeks_without_a_temperature_teach_no_wear() -> None:
    """Joint 1 has none for eight weeks, in which the hall cools by 10 K and friction rises by 8 %: no alert, no wear above 2 %."""
    days = np.arange(240)
    hall = 30.0 - 10.0 / (1.0 + np.exp(-(days - 140.0) / 6.0)) + np.where(days < 60, 6.0 * np.sin(days / 4.0), 0.0)
    lived = Lived(noise(5, 240, 8, rho=0.5), hall, (days >= 120) & (days < 176))
    assert not lived.raised[120:, ::J].any()
    assert lived.wear[176:, ::J].max() < 0.02


@pytest.mark.slow
def test_noise_that_grows_is_taken_for_what_it_is_within_weeks_and_is_no_wear() -> None:
    """Twice the noise in all joints from day 100 on, for two months: it is believed within three weeks. One joint of 24 may be told."""
    y = noise(7, 220, 4, rho=0.5)
    y[100:160] *= 2.0
    lived = Lived(y)
    assert lived.raised.any(axis=0).sum() <= 1
    before, grown = np.median(lived.noise[95:100]), np.median(lived.noise[121:140])
    assert before == pytest.approx(0.02, rel=0.2)
    assert 1.4 <= grown / before <= 2.5
    assert np.median(lived.noise[-1]) < 0.75 * np.median(lived.noise[155])


def test_a_step_in_noise_that_lasts_for_days_is_found() -> None:
    """Noise of ρ 0.8, and 15 % more in one joint of each arm from day 150 on."""
    y = noise(9, 190, 4, rho=0.8)
    y[150:, 2::J] += 0.15
    lived = Lived(y)
    assert lived.raised[:, 2::J].any(axis=0).all()
    assert not np.delete(lived.raised.reshape(190, 4, J), 2, axis=2).any()
