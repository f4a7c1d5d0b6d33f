"""Noise that no model assumed, over fleets: how seldom a healthy arm has an alert."""

import numpy as np
import pytest

from evidence.lived import J, correlated, fleet, flicker, learnt_correlation, lived, of_joint, swelling
from monitor.judge.friction.figures import noise_var
from monitor.judge.settings import AssessSettings

pytestmark = pytest.mark.soak
MODEL = AssessSettings().friction


def test_noise_of_other_colours_and_tails_raises_few_alerts():
    """4 arms for a year in each of five worlds; a judge that knows noise of one correlation time only has some 30 alerts in them."""
    days, N, rng = 365, 4 * J, np.random.default_rng(21)
    worlds = [
        correlated(rng, days, N, std=0.05, rho=0.5),
        correlated(rng, days, N, std=0.02, rho=0.9),
        flicker(rng, days, N),
        correlated(rng, days, N, std=0.02, rho=0.5, shocks=rng.standard_t(3, size=(days, N)) / np.sqrt(3.0)),
        0.02 * np.sin(2.0 * np.pi * np.arange(days)[:, None] / 365.0 + np.repeat(rng.uniform(0.0, 6.28, 4), J))
        + correlated(rng, days, N, std=0.02, rho=0.5),
    ]
    assert lived(np.concatenate(worlds, axis=1)).told().sum() <= 10


def test_years_of_one_over_f_noise_are_no_wear():
    """6 arms, their second and third year: noise that never averages out takes friction away from the level that was learnt."""
    noise = flicker(np.random.default_rng(5), 8 * 365, 6 * J)[: 3 * 365]
    assert lived(noise).told(slice(365, None)).sum() <= 5


def test_joints_of_long_noise_among_joints_that_only_scatter_raise_few_alerts():
    """12 arms for a year, ρ from 0 to 0.9 within each: 22 to 24 joints have an alert where all have the ρ of their arm."""
    rho = np.tile(np.linspace(0.0, 0.9, J), 12)
    assert lived(correlated(np.random.default_rng(6), 365, 12 * J, std=0.02, rho=rho)).told().sum() <= 10


@pytest.mark.parametrize("unresolved", [0, 2, 5])
def test_a_joint_that_is_never_resolved_does_not_make_the_others_alike(unresolved):
    """As above: 10 to 21 joints of 12 arms have an alert where one that tells nothing counts like the others."""
    rho = np.tile(np.linspace(0.0, 0.9, J), 12)
    noise = correlated(np.random.default_rng(6), 365, 12 * J, std=0.02, rho=rho)
    noise[:, unresolved::J] = np.nan
    assert lived(noise).told().sum() <= 9


def test_slow_wear_of_one_joint_is_not_taken_for_its_noise():
    """10 % a year for four months among joints of ρ 0.5: on average its ρ stays within 0.05 of its fellows', and its σ within a tenth."""
    days, onset, arms = 220, 100, 12
    worn = of_joint(2, np.log1p(0.1 / 365.0 * np.maximum(np.arange(days) - onset, 0)))
    friction = fleet(arms, worn, seed=7).state.friction
    rho, var = (each(friction, MODEL).reshape(arms, J) for each in (learnt_correlation, noise_var))
    assert np.mean(rho[:, 2] - np.delete(rho, 2, axis=1).mean(axis=1)) < 0.05
    assert np.mean(np.log(var[:, 2])) < np.mean(np.log(np.delete(var, 2, axis=1))) + 0.2


def test_a_rough_fortnight_of_a_joint_is_no_wear_where_such_came_before() -> None:
    """8 arms, σ of each joint walks, after ten months: 7 to 9 joints had an alert while each had the σ that it has on average."""
    rng, days, joints = np.random.default_rng(2), 600, 8 * J
    noise = swelling(rng, days, joints) * correlated(rng, days, joints, std=0.02, rho=0.5)
    assert lived(noise).told(slice(300, None)).sum() <= 3


@pytest.mark.parametrize(("std", "rho"), [(0.002, 0.5), (0.02, 0.9)], ids=["quiet", "long"])
def test_noise_below_what_a_replay_resolves_or_that_lasts_is_not_believed_to_wander(std: float, rho: float) -> None:
    """10 arms, eight months: kinds of noise that wander for months, or swing with the year, have less than their prior on average."""
    friction = lived(correlated(np.random.default_rng(13), 240, 10 * J, std=std, rho=rho)).state.friction
    slow = (MODEL.noise.column("kappa") > 0.0)[:, 0]
    prior = MODEL.noise.column("weight")[:, 0]
    assert friction.of_joints(friction.p)[slow].sum(axis=0).mean() < prior[slow].sum() / prior.sum()
