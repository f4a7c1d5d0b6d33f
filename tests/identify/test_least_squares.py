"""The solver, and the coverage of its standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import GROUND, truth
from scipy.signal import lfilter

from monitor.identify.fit.jackknife import HIGHEST_LEVERAGE, WINDOW_STEPS, jackknife_covariance, jackknife_covariances
from monitor.identify.fit.least_squares import (
    Factor,
    Rows,
    best_condition,
    condition_number,
    factors,
    residual_rms,
    solve,
    together,
    triangle,
)
from monitor.model.base import base_parameters
from monitor.model.regressor import friction_columns, regressor
from monitor.model.robot import load_robot

RATE_HZ = 25.0
SCALE_NM = np.array([3.0, 3.0, 2.0, 0.6, 0.5, 0.4])  # residuals of a real arm, joint 1 … 6


@pytest.fixture(scope="module")
def arm():
    """The base regressor of 30 s on a UR5, without torque."""
    robot = load_robot("ur5")
    known = truth(robot, rate_hz=RATE_HZ)
    base = base_parameters(robot, GROUND)
    Y = regressor(robot, GROUND, known.q, known.qd, known.qdd)[:, :, list(base.columns)]
    friction = np.searchsorted(base.columns, np.concatenate(friction_columns(6)))
    return Y, np.abs(known.qd) > 0.02, friction


def rows(Y, used, torque):
    steps = np.arange(len(Y)) * 225 // len(Y)  # 30 s in steps of 0.8/6 s
    return Rows(Y, torque, used, steps, np.zeros(len(Y), dtype=int))


def correlated(rng, shape, time_constant_s):
    """AR(1) noise of unit size."""
    phi = np.exp(-1.0 / RATE_HZ / time_constant_s)
    return lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], rng.normal(size=(shape[0] + 500, shape[1])), axis=0)[500:]


def naive_std(joints, weights):
    """σ·√diag((AᵀA)⁻¹) of textbook least squares, after scaling."""
    A = np.concatenate([w * f.R[:, :-1] for w, f in zip(weights, joints, strict=True)])
    return np.sqrt(np.diag(np.linalg.inv(A.T @ A)))


def test_factors_replace_the_rows():
    """Residuals and solution from triangular factors equal those from the rows themselves, to 1e-9 (condition number about 1e2)."""
    rng = np.random.default_rng(0)
    Y, x = rng.normal(size=(400, 3, 7)), rng.normal(size=7)
    torque = Y @ x + rng.normal(size=(400, 3))
    used = rng.random((400, 3)) < 0.8
    halves = [Rows(Y[k], torque[k], used[k], np.arange(200), np.zeros(200, dtype=int)) for k in (slice(0, 200), slice(200, 400))]
    joints, weights = factors(halves), np.array([1.0, 5.0, 0.2])
    found = solve(joints, weights, np.zeros(7)).values
    A = (Y * weights[None, :, None])[used]
    np.testing.assert_allclose(found, np.linalg.lstsq(A, (torque * weights)[used], rcond=None)[0], rtol=1e-9)
    rms = [np.sqrt(np.mean((torque[:, j] - Y[:, j] @ found)[used[:, j]] ** 2)) for j in range(3)]
    np.testing.assert_allclose(residual_rms(joints, found), rms, rtol=1e-9)


def test_factors_merge_as_recordings_come():
    """Recordings are added one after the other: the solution is that of all rows at once, to 1e-9."""
    rng = np.random.default_rng(1)
    parts = []
    for samples in (30, 200, 4, 100):  # fewer rows than columns too
        Y = rng.normal(size=(samples, 3, 7))
        torque = Y @ np.arange(7.0) + rng.normal(size=(samples, 3))
        parts.append(Rows(Y, torque, rng.random((samples, 3)) < 0.8, np.arange(samples), np.zeros(samples, dtype=int)))
    running = factors(parts[:1])
    for part in parts[1:]:
        pairs = zip(running, factors([part]), strict=True)
        running = [Factor(triangle(np.concatenate([a.R, b.R])), a.samples + b.samples) for a, b in pairs]
        assert max(len(factor.R) for factor in running) <= 8
    together = factors(parts)
    weights = np.array([1.0, 5.0, 0.2])
    np.testing.assert_allclose(solve(running, weights, np.zeros(7)).values, solve(together, weights, np.zeros(7)).values, rtol=1e-9)
    assert [factor.samples for factor in running] == [factor.samples for factor in together]


def with_small_directions(rng, rows):
    """Rows whose singular values fall from 1 to 1e-9: of a Gram matrix, half of them would be rounding."""
    U, V = np.linalg.qr(rng.normal(size=(rows, 19)))[0], np.linalg.qr(rng.normal(size=(19, 19)))[0]
    sizes = np.logspace(0.0, -9.0, 19)
    return U * sizes @ V.T, sizes


@pytest.mark.parametrize("rows", [40, 3000])
def test_a_factor_keeps_the_directions_that_the_rows_hardly_show(rows):
    A, sizes = with_small_directions(np.random.default_rng(5), rows)
    assert np.linalg.svd(triangle(A), compute_uv=False) == pytest.approx(sizes, rel=1e-5)


@pytest.mark.parametrize("samples", [(2, 3), (3, 2), (4, 1)], ids=str)
def test_as_many_rows_as_a_triangle_has_are_no_triangle(samples):
    """Two joints with few rows make as many rows as one whole triangle would have; their parameters are found all the same."""
    rng, x = np.random.default_rng(5), np.array([1.0, -2.0, 3.0, 4.0])
    blocks = [rng.normal(size=(n, 4)) for n in samples]
    found = solve([Factor(triangle(np.column_stack([A, A @ x])), len(A)) for A in blocks], np.ones(2), np.zeros(4))
    np.testing.assert_allclose(found.values, x, rtol=1e-9)
    A = np.concatenate(blocks) @ found.directions
    np.testing.assert_allclose(A.T @ A, np.eye(4), atol=1e-9)


def test_what_is_not_excited_stays_at_the_prior():
    """The data determine the sum of two equal columns; their difference, and a column of zeros, stay at the prior."""
    rng = np.random.default_rng(0)
    Y = rng.normal(size=(300, 1, 4))
    Y[:, :, 1] = Y[:, :, 0]
    Y[:, :, 3] = 0.0
    torque = Y @ np.array([1.0, 2.0, 5.0, 0.0])
    found = solve(factors([rows(Y, np.ones((300, 1), dtype=bool), torque)]), np.ones(1), np.array([0.5, 0.9, 0.0, 7.0]))
    np.testing.assert_allclose(found.values, [1.3, 1.7, 5.0, 7.0], atol=1e-12)  # sum 3 from the data, difference 0.4 from the prior
    assert found.excited.tolist() == [False, False, True, False]


def test_a_column_of_rounding_is_not_excited_and_a_small_one_is():
    """A sweep's other joints shake by 1e-12 of it: their parameters stay at the prior. A column of a millionth is a small unit."""
    rng = np.random.default_rng(0)
    Y = rng.normal(size=(300, 1, 3)) * [1.0, 1e-6, 1e-12]
    torque = Y @ np.array([1.0, 2e6, 5e12])
    found = solve(factors([rows(Y, np.ones((300, 1), dtype=bool), torque)]), np.ones(1), np.array([0.0, 0.0, 7.0]))
    assert found.excited.tolist() == [True, True, False]
    assert found.values[2] == 7.0


def test_the_condition_of_the_best_base_is_that_of_the_motion():
    """Parameters a, b, and a base of a + 1000·b and b: unit columns of a and b have the condition 1, however they are combined."""
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(300, 2)))[0]
    combination = np.array([[1.0, 1000.0], [0.0, 1.0]])
    Y = (Q @ np.linalg.inv(combination))[:, None]
    joints, both = factors([rows(Y, np.ones((300, 1), dtype=bool), np.zeros((300, 1)))]), np.arange(2)
    assert condition_number(together(joints), both) > 1e5
    assert best_condition(together(joints), combination, both) == pytest.approx(1.0, abs=1e-6)
    nothing = factors([rows(Y * [1.0, 0.0], np.ones((300, 1), dtype=bool), np.zeros((300, 1)))])
    assert best_condition(together(nothing), np.eye(2), both) == np.inf
    assert condition_number(together(nothing), both) == np.inf


def test_intervals_of_friction_have_their_coverage_under_correlated_noise(arm):
    """With noise correlated over 0.3 s, 95 % intervals of fc and fv hold the truth in 90–98 % of 480 cases; naive ones in under 65 %.

    480 cases, not independent, give ±4 %; the jackknife's own deficit at 37 blocks is about 2 %.
    """
    Y, used, friction = arm
    rng = np.random.default_rng(7)
    inside = inside_naive = cases = 0
    ratios = []
    for _ in range(40):
        noise = correlated(rng, used.shape, 0.3) * SCALE_NM
        rec = rows(Y, used, noise)  # the truth is zero: least squares is linear, any other only shifts
        joints = factors([rec])
        weights = 1.0 / SCALE_NM
        solution = solve(joints, weights, np.zeros(Y.shape[2]))
        std = np.sqrt(np.diag(jackknife_covariance([rec], weights, solution)))[friction]
        naive = naive_std(joints, weights)[friction]
        error = np.abs(solution.values[friction])
        inside += np.sum(error < 1.96 * std)
        inside_naive += np.sum(error < 1.96 * naive)
        cases += len(friction)
        ratios.append(std / naive)
    assert 0.90 < inside / cases < 0.98
    assert inside_naive / cases < 0.65
    assert np.median(ratios) > 2.0  # √(2·0.3 s·25 Hz) ≈ 3.9 for a constant, less for columns that change within 0.3 s


def test_standard_deviations_are_no_larger_than_needed_under_white_noise(arm):
    """Where residuals are independent the textbook is right, and the jackknife agrees with it within 15 % on average of 20 draws."""
    Y, used, friction = arm
    rng = np.random.default_rng(8)
    weights = 1.0 / SCALE_NM
    ratios = []
    for _ in range(20):
        rec = rows(Y, used, rng.normal(size=used.shape) * SCALE_NM)
        joints = factors([rec])
        solution = solve(joints, weights, np.zeros(Y.shape[2]))
        ratios.append(np.sqrt(np.diag(jackknife_covariance([rec], weights, solution)))[friction] / naive_std(joints, weights)[friction])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def test_a_covariance_is_symmetric_and_has_no_negative_variance(arm):
    """Up to rounding of its largest entry (1e-12)."""
    Y, used, _ = arm
    rec = rows(Y, used, correlated(np.random.default_rng(1), used.shape, 0.3) * SCALE_NM)
    solution = solve(factors([rec]), 1.0 / SCALE_NM, np.zeros(Y.shape[2]))
    P = jackknife_covariance([rec], 1.0 / SCALE_NM, solution)
    assert np.max(np.abs(P - P.T)) <= 1e-12 * np.max(P)
    assert np.linalg.eigvalsh(P)[0] > -1e-12 * np.max(P)


def test_a_block_with_a_leverage_above_one_is_solved_too():
    """Rows that are not orthonormal make a matrix without a Cholesky factor; the covariance is that of the dense equations all the same."""
    rng = np.random.default_rng(4)
    rec = Rows(
        rng.normal(size=(180, 1, 3)), rng.normal(size=(180, 1)), np.ones((180, 1), dtype=bool), np.arange(180) // 10, np.zeros(180, int)
    )
    solution = solve(factors([rec]), np.ones(1), np.zeros(3))
    solution = replace(solution, directions=2.0 * solution.directions)
    Z, e = rec.Y[:, 0] @ solution.directions, (rec.torque_nm - rec.Y @ solution.values)[:, 0]
    blocks = [slice(10 * k, 10 * (k + WINDOW_STEPS)) for k in range(18 - WINDOW_STEPS + 1)]
    limited = np.eye(3) / HIGHEST_LEVERAGE
    assert any(np.linalg.eigvalsh(limited - Z[on].T @ Z[on])[0] < 0.0 for on in blocks)
    off = np.array([solution.directions @ np.linalg.solve(limited - Z[on].T @ Z[on], Z[on].T @ e[on]) for on in blocks])
    expected = (18 / WINDOW_STEPS - 1.0) * off.T @ off / len(off) / HIGHEST_LEVERAGE**2
    np.testing.assert_allclose(jackknife_covariance([rec], np.ones(1), solution), expected, rtol=1e-9)


def test_the_covariance_is_that_of_fits_without_one_block_after_the_other():
    """Two recordings of different length, one with a hole, in steps that end anywhere. That leverages are limited changes 1e-3 at most."""
    rng, w = np.random.default_rng(3), np.array([1.0, 2.0, 0.5])
    recordings, steps = [], []
    for number, (samples, hole) in enumerate(((900, 350), (520, 0))):
        Y, used = rng.normal(size=(samples, 3, 4)), rng.random((samples, 3)) < 0.8
        segments = (np.arange(samples) >= hole).astype(int)
        numbers = np.unique(1000 * segments + np.cumsum(rng.random(samples) < 1 / 9), return_inverse=True)[1]
        recordings.append(Rows(Y, rng.normal(size=(samples, 3)), used, numbers, segments))
        steps += [(number, segments[numbers == k][0], np.flatnonzero(numbers == k)) for k in range(numbers[-1] + 1)]
    whole = solve(factors(recordings), w, np.zeros(4))

    def without(block):
        keep = [rec.used.copy() for rec in recordings]
        for number, _, samples in block:
            keep[number][samples] = False
        return solve(factors([rec._replace(used=used) for rec, used in zip(recordings, keep, strict=True)]), w, np.zeros(4)).values

    residuals = [rec.torque_nm - rec.Y @ whole.values for rec in recordings]
    found = jackknife_covariances(recordings, w, whole, [residuals, [2.0 * left for left in residuals]])
    longest = max(sum(step[:2] == run for step in steps) for run in {step[:2] for step in steps})
    longer = min(36, len(steps) // 8, longest // 2)
    assert longer > WINDOW_STEPS
    for width, (covariance, of_twice_the_noise) in ((WINDOW_STEPS, found.usual), (longer, found.longer)):
        blocks = [steps[k : k + width] for k in range(len(steps) - width + 1) if steps[k][:2] == steps[k + width - 1][:2]]
        off = np.array([whole.values - without(block) for block in blocks[:: width // WINDOW_STEPS]])
        expected = (len(steps) / width - 1.0) * off.T @ off / len(off)
        assert np.max(np.abs(covariance - expected)) < 1e-3 * np.max(expected)
        np.testing.assert_allclose(of_twice_the_noise, 4.0 * covariance, rtol=1e-12)
