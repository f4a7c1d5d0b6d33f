"""Outliers in a row say together what generalised least squares makes of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_shocks_and_gaps import J, lived, noise

from monitor.judge.drift.filter_state import NOISE, RATE, STATES, WEAR, WINDOW
from monitor.judge.drift.update.innovation import Innovation, Noise
from monitor.judge.drift.update.outlier_run import ChangeSums, OutlierRun, outlier_run

STD = 0.02


def run_of(nu: np.ndarray, rho: float, length: int) -> tuple[OutlierRun, ChangeSums, np.ndarray]:
    """The run of one joint whose noise was known to be 0 before it, the sums that the bank has of it, and S of each outlier.

    nu : (length,) youngest first.
    """
    S = STD**2 * (1.0 - rho ** (2.0 * np.arange(length, 0, -1)))
    ages = np.arange(WINDOW, dtype=float)
    counted = np.arange(WINDOW)[:, None] >= np.arange(1, length)  # (W, length − 1): which outliers before this one a start has
    before = ChangeSums(np.zeros((1, 2, WINDOW)), np.zeros((1, 2, WINDOW)))
    before.score[0, 0], before.information[0, 0] = counted @ (nu[1:] / S[1:]), counted @ (1.0 / S[1:])
    responses = np.zeros((1, 2, WINDOW, STATES))
    responses[:, 0, :, WEAR] = 1.0
    responses[:, 1, :, RATE], responses[:, 1, :, WEAR] = 1.0, ages + 1.0
    effect = responses[..., WEAR]
    nothing = np.zeros(1)
    innovation = Innovation(
        resolved=np.ones(1, dtype=bool),
        sensed=np.ones(1, dtype=bool),
        row=np.zeros((1, STATES)),
        log_torque=nothing,
        within_var=nothing,
        value=nu[:1],
        state_cov=np.zeros((1, STATES)),
        var=S[:1],
        normalised=nu[:1] / np.sqrt(S[:1]),
        level_var=nothing,
        shared=nothing,
        settling=np.zeros(1, dtype=bool),
    )
    noise_of_one = Noise(np.array([rho]), np.array([STD**2]))
    run = outlier_run(before, effect, responses, ages[None], innovation, noise_of_one, np.array([float(length)]), np.ones(1))
    return run, before, S


@given(rho=st.floats(0.0, 0.85), length=st.integers(2, 6), seed=st.integers(0, 1000))
def test_a_step_that_began_with_the_run_is_known_as_least_squares_know_it(rho, length, seed):
    """Score and information of the outliers before, and what this replay adds once the noise before it is seen."""
    nu = 0.2 + STD * np.random.default_rng(seed).normal(size=length)
    run, counted, S = run_of(nu, rho, length)
    before = run.left_of(counted, run.before)
    since = length - 1  # the age of the run's first outlier
    G, phi = 1.0 - run.phi[0] * run.last_effect[0, 0, since], run.phi[0]
    new_var = S[0] - phi**2 * run.var[0]
    information = before.information[0, 0, since] + G**2 / new_var
    score = before.score[0, 0, since] + G * (nu[0] - phi * run.nu[0]) / new_var

    k = np.arange(length, 0, -1.0)  # replays since the noise was known
    C = STD**2 * (rho ** np.abs(k[:, None] - k) - rho ** (k[:, None] + k))
    weights = np.linalg.solve(C, np.ones(length))
    assert np.isclose(information, weights.sum(), rtol=1e-6)
    assert np.isclose(score, weights @ nu, rtol=1e-6)


@given(rho=st.floats(0.0, 0.99), length=st.integers(2, 28), seed=st.integers(0, 1000))
def test_what_is_left_is_positive_and_of_a_step_with_the_run_never_more_than_was_counted(rho, length, seed):
    nu = 0.2 + STD * np.random.default_rng(seed).normal(size=length)
    run, counted, _ = run_of(nu, rho, length)
    left = run.left_of(counted, run.before)
    assert np.isfinite(left.score).all()
    assert (left.information[0, 0, 1:] > 0.0).all()
    assert (left.information[0, 0, length - 1 :] <= counted.information[0, 0, length - 1 :] * (1.0 + 1e-9)).all()
    mean, cov = run.with_noise_seen(np.zeros((1, STATES)), 1e-4 * np.eye(STATES)[None])
    assert np.linalg.eigvalsh(cov[0]).min() > 0.0
    assert np.flatnonzero(mean[0]).tolist() in ([], [NOISE])


def test_a_single_outlier_says_what_it_said():
    run, counted, _ = run_of(np.array([0.2]), 0.5, 1)
    assert run.phi[0] == run.nu[0] == 0.0
    assert not run.now.score.any()
    assert not run.now.information.any()
    assert np.array_equal(run.left_of(counted, run.before).score, counted.score)


@pytest.mark.slow
def test_a_shock_that_fades_away_is_no_step():
    """Joint 2 of 20 arms is 16 % up on day 60, and a fifth less of it with each replay, in noise of ρ 0.8: no wear above 5 % on day 75."""
    y = noise(8, 76, 20, rho=0.8)
    y[60:, 1::J] += 0.16 * 0.8 ** np.arange(16)[:, None]
    wear, _, raised = lived(y)
    assert raised[60:66, 1::J].any(axis=0).sum() <= 1
    assert np.abs(wear[75, 1::J]).max() < 0.05
