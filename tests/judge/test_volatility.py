"""Noise of one joint that waxes and wanes: an arm's past tells whether calm and rough weeks alternate, and steady noise never seems to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_noise import DRIFT, J, correlated, lived

from monitor.judge.drift.filter_state import unknown_joint
from monitor.judge.drift.from_production import begin_production, swapped
from monitor.judge.drift.noise.volatility import LEAST, Volatility, steady
from monitor.recording import Array

DAY_S = 86400.0


def squares(noise: Array) -> Array:
    """(days − 1, N) half squared differences of successive noises, over their mean."""
    half = 0.5 * np.diff(noise, axis=0) ** 2
    over_mean: Array = half / half.mean(axis=0)
    return over_mean


def after_all(each: Array) -> Volatility:
    """After squares (days, N)."""
    volatility = steady(each.shape[1])
    for square in each:
        volatility = volatility.after(square, np.zeros(len(square)))
    return volatility


def swelling(rng: np.random.Generator, days: int, joints: int) -> Array:
    """(days, joints) factor of σ: a walk of its logarithm about 0, within a factor of two for three weeks; mean square 1."""
    size = np.exp(0.6 * correlated(rng, days, joints, std=1.0, rho=0.95))
    relative: Array = size / np.sqrt(np.mean(size**2, axis=0))
    return relative


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_noise_of_one_size_shows_no_volatility_however_long_its_tails_are(rho: float) -> None:
    """60 arms, a year: what chance makes is taken off, and hardly an arm has a coefficient that would matter."""
    rng, joints = np.random.default_rng(11), 60 * J
    shocks = rng.standard_t(3, size=(365, joints))
    for noise in (correlated(rng, 365, joints, std=1.0, rho=rho), correlated(rng, 365, joints, std=1.0, rho=rho, shocks=shocks)):
        b = after_all(squares(noise)).coefficient(J)
        assert np.mean(b[::J] > 0.25) <= 0.05


def test_weeks_of_more_noise_are_foreseen_where_they_come_again_and_again() -> None:
    """20 arms, the second half of a year: squares are larger where the factor is among the largest fifth than where among the smallest."""
    rng, joints = np.random.default_rng(12), 20 * J
    volatility, factors = steady(joints), []
    each = squares(swelling(rng, 365, joints) * correlated(rng, 365, joints, std=1.0, rho=0.5))
    for square in each:
        factors.append(volatility.factor(J))
        volatility = volatility.after(square, np.zeros(len(square)))
    assert np.all(volatility.coefficient(J) > 0.1)
    told, seen = np.array(factors)[180:], each[180:]
    low, high = np.quantile(told, [0.2, 0.8])
    assert seen[told > high].mean() > 3.0 * seen[told < low].mean()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
@settings(max_examples=20)
def test_a_joint_without_a_square_is_as_it_was_and_every_factor_is_bounded(seed: int, joints: int) -> None:
    """Squares of any size, a third of them missing."""
    rng = np.random.default_rng(seed)
    volatility = steady(joints)
    for _ in range(60):
        square = np.where(rng.random(joints) < 1 / 3, np.nan, np.exp(3.0 * rng.normal(size=joints)))
        new = volatility.after(square, np.zeros(len(square)))
        missing = np.isnan(square)
        for name in Volatility.__dataclass_fields__:
            assert np.array_equal(getattr(new, name)[missing], getattr(volatility, name)[missing], equal_nan=True)
        volatility = new
        factor = volatility.factor(joints)
        assert np.all((factor >= LEAST) & (factor <= 10.0 * (1.0 + 8.0 * 4.0 / 27.0)))
    assert np.all(volatility.of_new_joints(np.ones(joints, dtype=bool)).factor(joints) == 1.0)


MIXED = np.array([0.003, 0.006, 0.012, 0.02, 0.03, 0.05])


def test_a_joint_that_is_noisier_for_good_does_not_make_its_arm_volatile() -> None:
    """20 arms: joint 1 has 2.5 times as much noise from the seventh month on."""
    noise = correlated(np.random.default_rng(14), 500, 20 * J, std=1.0, rho=0.5)
    noise[200:, ::J] *= 2.5
    assert np.all(after_all(squares(noise)).coefficient(J) < 0.2)


@pytest.mark.slow
def test_production_and_replays_have_each_its_own_volatility() -> None:
    """Replays are judged as before once work was observed; work begins with nothing seen."""
    rng, joints = np.random.default_rng(15), 4 * J
    state, _ = lived(swelling(rng, 120, joints) * correlated(rng, 120, joints, std=0.02, rho=0.5))
    replays = state.filter_state
    assert np.any(replays.volatility.factor(J) != 1.0)
    both = begin_production(replays, J, DRIFT)
    assert np.array_equal(both.noise_var(J, DRIFT), replays.noise_var(J, DRIFT))
    production = swapped(both)
    assert np.all(production.volatility.factor(J) == 1.0)
    again = swapped(production).volatility
    assert all(np.array_equal(getattr(again, name), getattr(replays.volatility, name)) for name in Volatility.__dataclass_fields__)


def test_a_joint_that_nobody_has_seen_begins_anew_and_the_others_keep_theirs() -> None:
    """As where a joint is replaced whose noise is unknown."""
    state, _ = lived(correlated(np.random.default_rng(16), 40, 2 * J, std=0.02, rho=0.5))
    new = np.arange(2 * J) == 3
    fresh = unknown_joint(state.filter_state, new, DRIFT, slope_std=0.01)
    assert np.all(fresh.volatility.replays[new] == 0.0)
    assert np.array_equal(fresh.volatility.usual[~new], state.filter_state.volatility.usual[~new])
