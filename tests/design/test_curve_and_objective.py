"""End conditions and limits by construction; figures of merit against their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tasks import problem, task

from monitor.design.curve import Family, Limits
from monitor.design.objective import CORRELATION_S, REPORT_RATE_HZ, information
from monitor.design.trajectory import design
from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.fourier import excitation_from_document
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, load_robot

UR5 = load_robot("ur5")
UPRIGHT = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])


def family(harmonics=5, period_s=10.0, offset=UPRIGHT, robot="ur5", **changes):
    arm = load_robot(robot)
    values = {"limits": Limits.of(arm), "starts_there": False, **changes}
    return Family(robot=arm, mounting=Mounting(), harmonics=harmonics, period_s=period_s, offset_rad=offset, **values)


@given(
    seed=st.integers(0, 2**32 - 1),
    harmonics=st.integers(2, 12),
    period=st.floats(2.0, 40.0),
    size=st.floats(0.01, 20.0),
    starts=st.booleans(),
    robot=st.sampled_from(["ur3", "ur5", "ur20"]),
)
def test_every_curve_is_at_rest_at_both_ends_and_within_the_limits(seed, harmonics, period, size, starts, robot):
    """For all coefficients: zero speed and acceleration to 1e-12 after one and three repetitions; limits on a grid ten times as dense."""
    curves = family(harmonics, period, robot=robot, starts_there=starts)
    u = size * np.random.default_rng(seed).standard_normal(curves.dimension)
    excitation = curves.excitation(u, repetitions=3)
    ends = excitation.at(np.array([0.0, period, 3.0 * period]))
    assert np.max(np.abs(ends.qd)) < 1e-12
    # q̈ carries harmonic times 2π/T times the rounding of the phase 2πk: 1e-12 at the default period, in proportion at shorter ones
    assert np.max(np.abs(ends.qdd)) < 1e-12 * max(1.0, (harmonics / 5.0) ** 2 * (10.0 / period) ** 2)
    if starts:
        np.testing.assert_allclose(ends.q[0], UPRIGHT, atol=1e-12)
    state = excitation.at(np.linspace(0.0, period, 400 * harmonics))
    limits = curves.limits
    assert np.all(np.abs(state.q) <= limits.position_rad)
    assert np.all(np.abs(state.qd) <= limits.speed_rad_s)
    assert np.all(np.abs(state.qdd) <= limits.acceleration_rad_s2)


@given(seed=st.integers(0, 2**32 - 1))
def test_large_coefficients_reach_a_limit_in_every_joint(seed):
    """The limits are those of the sampled curve, not of the sums of amplitudes: the most binding one is used to 97 %."""
    curves = family()
    state = curves.excitation(50.0 * np.random.default_rng(seed).standard_normal(curves.dimension)).at(np.linspace(0.0, 10.0, 4000))
    limits = curves.limits
    used = np.maximum.reduce(
        [
            np.max(np.abs(state.qd), axis=0) / limits.speed_rad_s,
            np.max(np.abs(state.qdd), axis=0) / limits.acceleration_rad_s2,
            np.max((state.q - UPRIGHT) / (limits.position_rad - UPRIGHT), axis=0),
            np.max((UPRIGHT - state.q) / (limits.position_rad + UPRIGHT), axis=0),
        ]
    )
    assert np.all(used > 0.969)
    assert np.all(used < 0.975)  # a peak between the grid's samples is at most 0.3 % higher


@pytest.mark.parametrize("mounting", ["ground", "ceiling", "wall"])
def test_the_figures_of_merit_are_their_definitions(mounting):
    """Against plain numpy on the stacked regressor: singular values, inverse, determinant."""
    mount = Mounting.parse(mounting)
    arm = information(UR5, mount)
    excitation = family().excitation(0.1 * np.random.default_rng(5).standard_normal(48))
    t = np.arange(1250) / 125.0
    state = excitation.at(t)
    base = base_parameters(UR5, mount)
    Y = regressor(UR5, mount, *state)[:, :, list(base.columns)]  # (N, J, B)
    merits = arm.merits(excitation)
    # a Gram matrix has half the digits: 1e-16 · cond² of a figure of a few hundred
    assert merits.condition == pytest.approx(np.linalg.cond(Y.reshape(-1, base.count)), rel=1e-6)
    columns = Y.reshape(-1, base.count)
    assert merits.scaled == pytest.approx(np.linalg.cond(columns / np.linalg.norm(columns, axis=0)), rel=1e-6)
    weight = (np.abs(state.qd) > 0.02) / arm.noise_nm
    A = (Y * weight[:, :, None]).reshape(-1, base.count)
    covariance = np.linalg.inv(A.T @ A)
    # the friction block with correlated noise: the sandwich, its middle from the full matrix of correlations, joint by joint
    lag = np.abs(np.subtract.outer(np.arange(1250), np.arange(1250)))
    R = np.exp(-np.minimum(lag, 1250 - lag) / 125.0 / CORRELATION_S)
    rows = Y * weight[:, :, None]
    middle = sum(rows[:, j].T @ R @ rows[:, j] for j in range(6))
    sandwich = covariance @ middle @ covariance
    friction = [base.columns.index(13 * j + kind) for kind in (10, 11) for j in range(6)]
    assert merits.dopt == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)
    assert merits.friction == pytest.approx(np.linalg.slogdet(sandwich[np.ix_(friction, friction)])[1], rel=1e-8)


@pytest.mark.soak
def test_the_expected_deviations_are_those_of_correlated_noise():
    """Against noise that is drawn: 4000 fits of white-noise weights to rows with the assumed correlation."""
    arm = information(UR5, Mounting())
    excitation = family().excitation(0.2 * np.random.default_rng(1).standard_normal(48))
    t = np.arange(1250) / REPORT_RATE_HZ
    state = excitation.at(t)
    Y, _ = arm.rows(*state)  # (J, B, N)
    weight = (np.abs(state.qd) > 0.02).T / arm.noise_nm[:, None]
    A = Y * weight[:, None, :]
    estimator = np.linalg.solve(np.einsum("jbn,jcn->bc", A, A), (A * weight[:, None, :]).transpose(1, 0, 2).reshape(len(arm.columns), -1))
    rng = np.random.default_rng(2)
    lag = np.minimum(np.arange(1250), 1250 - np.arange(1250)) / REPORT_RATE_HZ
    spectrum = np.sqrt(np.maximum(np.fft.rfft(np.exp(-lag / CORRELATION_S)).real, 0.0))
    draws = 4000
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal((draws, 6, 1250))) * spectrum, n=1250) * arm.noise_nm[:, None]
    scatter = np.std(noise.reshape(draws, -1) @ estimator[-12:].T, axis=0)
    # a deviation from 4000 draws is itself good to 1/√8000 = 1.1 %; twelve of them within four of that
    np.testing.assert_allclose(np.concatenate(arm.friction_std(excitation)), scatter, rtol=0.045)
    fc, fv = arm.friction_std(excitation, repetitions=4)
    np.testing.assert_allclose(np.concatenate([fc, fv]), 0.5 * np.concatenate(arm.friction_std(excitation)))


def test_a_joint_that_stands_still_makes_every_figure_infinite():
    """Its friction cannot be identified, so no figure is finite."""
    curves = family()
    u = np.random.default_rng(3).standard_normal(48).reshape(8, 6)
    u[:, 3] = 0.0
    excitation = curves.excitation(u.ravel())
    merits = information(UR5, Mounting()).merits(excitation)
    assert merits.friction == merits.dopt == np.inf
    assert merits.condition > 1e6


def test_a_slower_pass_follows_the_same_path():
    """A time scale changes speeds, not the path; the digest at full speed stays that of older files."""
    excitation = family().excitation(0.3 * np.random.default_rng(4).standard_normal(48))
    slow = replace(excitation, time_scale=0.25)
    t = np.linspace(0.0, 10.0, 101)
    fast, slowly = excitation.at(t), slow.at(4.0 * t)
    np.testing.assert_allclose(slowly.q, fast.q, atol=1e-12)
    np.testing.assert_allclose(slowly.qd, 0.25 * fast.qd, atol=1e-12)
    np.testing.assert_allclose(slowly.qdd, 0.0625 * fast.qdd, atol=1e-12)
    assert slow.duration_s == 40.0
    assert slow.path_digest == excitation.path_digest == excitation.digest != slow.digest
    old = {key: value for key, value in excitation.as_document().items() if key not in {"time_scale", "cell", "proof", "objectives"}}
    assert excitation_from_document(old).digest == excitation.digest
    for wrong in (0.0, -1.0, 1.5, float("nan")):
        with pytest.raises(BadInput, match="time_scale"):
            replace(excitation, time_scale=wrong)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000))
def test_a_cost_above_the_forbidden_mark_is_a_broken_limit_and_below_it_none(seed):
    """The search's order: whatever keeps its limits at the samples is better than whatever does not."""
    task_problem = problem()
    u = 0.3 * np.random.default_rng(seed).standard_normal(48)
    state = task_problem.family.excitation(u).at(np.arange(250) * 0.04)
    gaps = task_problem.surroundings.gaps(state.q)
    cost = task_problem.cost(u)
    if cost < 1e6:
        assert gaps.to_itself_m.min() >= 0.01
        assert gaps.to_cell_m.min() >= 0.03
    if min(gaps.to_itself_m.min(), gaps.to_cell_m.min()) < 0.0:
        assert cost > 2e6


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"period_s": 0.0}, "period = 0.0 s; expected more than 0"),
        ({"period_s": float("nan")}, "period = nan"),
        ({"harmonics": 1}, "harmonics = 1; expected 2 to 25"),
        ({"repetitions": 0}, "repetitions = 0"),
        ({"offset_rad": np.array([0.0, np.nan, 0, 0, 0, 0])}, "6 finite angles"),
        ({"offset_rad": np.array([0.0, -1.57, 3.3, 0, 0, 0])}, r"joint 3 is at 3.3 rad, beyond its limit of 3.142 rad by 0.158 rad"),
        ({"offset_rad": np.array([0.0, 0.3, 0, 0, 0, 0])}, r"standing at the offset .* mm inside each other, .* mm short of the margin_m"),
        ({"start_rad": np.array([0.0, -1.57, 2.9, 0, 0, 0])}, r"standing at the start .* short of the self_margin_m"),
        ({"speed_limit_rad_s": -1.0}, "speed limit = -1.0"),
        ({"acceleration_limit_rad_s2": float("nan")}, "acceleration limit = nan"),
        ({"torque_share": 0.05, "offset_rad": np.array([0.0, -0.6, 0, 0, 0, 0])}, r"joint 2 needs .* N·m beyond its limit of 7.5 N·m"),
        ({"objective": "beauty"}, "known are friction, condition, scaled, dopt"),
        ({"noise_nm": np.zeros(6)}, "6 positive torques"),
        ({"approaches_rad": (np.array([0.0, 0.3, 0, 0, 0, 0]),)}, "from where it was to approach"),
    ],
)
def test_a_task_that_cannot_be_done_names_what_binds_and_by_how_far(changes, words):
    """The search ends before it begins."""
    with pytest.raises(BadInput, match=words):
        design(task(**changes), software="test", evaluations=10)
