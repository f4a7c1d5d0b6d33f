"""Wear along its paths, over fleets: the path that is found, the life that is told, and what a fleet's prior adds."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from synthetic_arm import of_arm
from test_wear_paths import LIFE, MODEL, PATHS, PROGNOSIS, lives_of, worn_fleet

from monitor.judge.alerts.remaining_life import remaining_life_of_joint
from monitor.judge.friction.figures import wear_and_rate
from monitor.judge.friction.prior import WearPrior, prior_from_document
from monitor.judge.settings import AssessSettings
from monitor.studies.fleet_prior import Joint, LearntArm, learn_prior, learn_wear
from monitor.studies.rehearsal.fleet import FleetSettings
from monitor.studies.rehearsal.play import COMPARABLE, play
from monitor.studies.rehearsal.rehearse import answers_of, wear_along

pytestmark = pytest.mark.soak
J, ASKED = 4, 4  # joints of each arm of `worn_fleet`, of which the second wears; arms that are asked


def worn_channels(arms: int) -> range:
    return range(1, arms * (J + 1), J + 1)


@functools.cache
def learnt() -> WearPrior:
    """What ten arms say whose second joint has worn to six tenths of the limit along a straight path."""
    state, _ = worn_fleet("straight", 10, 0.6)
    found = learn_wear([Joint(state, n) for n in worn_channels(10)], MODEL)
    assert found is not None
    return found


def medians(path: str, asked_at: float, prior: WearPrior | None, seed: int = 0) -> tuple[np.ndarray, float]:
    """P50 [days] of the arms that have a date, and the truth."""
    state, left = worn_fleet(path, ASKED, asked_at, seed=seed)
    lives = [remaining_life_of_joint(state, n, MODEL, PROGNOSIS, prior) for n in worn_channels(ASKED)]
    return np.array([life.p50_days for life in lives if life.p50_days is not None]), left


def test_at_a_third_of_life_a_prior_of_wear_brings_the_median_to_the_truth():
    """Arms that it was not learnt from: within 20 % of the truth in most, and in more of them than without."""
    near = []
    for prior in (None, learnt()):
        days, left = medians("straight", 0.33, prior, seed=5)
        near.append(np.mean(np.abs(days - left) <= 0.2 * left))
    assert near[1] > 0.6
    assert near[1] > near[0]


def test_a_joint_that_wears_otherwise_is_not_held_to_its_fleet():
    """It accelerates; 200 joints of its fleet rise along a straight path, and take three times as long. Its date is hardly later."""
    slow = WearPrior(joints=200, slowing=0.02, straight=0.96, accelerating=0.02, life_days=3.0 * LIFE, life_spread=0.2)
    days, _ = medians("accelerating", 0.75, slow)
    without, _ = medians("accelerating", 0.75, None)
    assert len(days) == len(without) == ASKED
    assert np.median(days) < 1.2 * np.median(without)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("path", "spread", "least"),
    [("straight", 0.15, 0.5), ("root", 0.15, 0.4), ("straight", 0.5, 0.35)],
    ids=["straight, lives alike", "root, lives alike", "straight, 10 to 80 % a year"],
)
def test_remaining_life_at_a_quarter_of_life(soak_row, request, path: str, spread: float, least: float):
    """α-λ (P50 within 20 % of the truth) of 96 arms that wear; the prior is of 96 other ones after 260 days."""
    rng, assess, arms = np.random.default_rng(29), AssessSettings(), 96
    rate, joint = 0.3 * np.exp(spread * rng.normal(size=arms)) / 365.0, rng.integers(0, 6, arms)
    fleet = FleetSettings(arms=arms, days=260, seed=31, scenarios=COMPARABLE)
    state = play(fleet, assess, wear_along(path, rate, joint, assess.prognosis.limit_rise)).state.friction
    learnt_from = [LearntArm(f"cell-{k}", "ur5", of_arm(state, k), 260.0) for k in range(arms)]
    document = learn_prior(learnt_from, assess.drift, assess.temperature)
    prior = prior_from_document(document, "ur5", 6, assess.drift.reference_speed_rad_s, digest="0")
    rate, joint = np.sort(0.3 * np.exp(spread * rng.normal(size=arms))) / 365.0, rng.integers(0, 6, arms)
    reached = []
    for settings in (assess, replace(assess, drift=replace(assess.drift, prior=prior))):
        answers = [
            each
            for k, part in enumerate(np.array_split(np.arange(arms), 2))
            for each in answers_of(path, rate[part], joint[part], settings, replace(fleet, arms=len(part), seed=37 + k), (0.25,))
        ]
        dated = [each for each in answers if each.covered is not None]
        near, held = sum(each.near for each in answers), np.mean([each.covered for each in dated])
        ratio = np.median([each.ratio for each in dated])
        reached.append(near / arms)
        text = (
            f"{near / arms:.0%} of all, {near / len(dated):.0%} of the {len(dated)} with a date; P10–P90 {held:.0%}; P50/truth {ratio:.2f}"
        )
        soak_row(f"{request.node.callspec.id}: {'without' if settings is assess else 'with prior'}", text, "≥ 80 %")
    assert reached[1] > reached[0]
    assert reached[1] >= least
    assert held > 0.7


@pytest.mark.parametrize("path", list(PATHS))
def test_the_path_of_wear_is_found_and_its_life_held(path):
    """Of 8 arms at 75 % of life, P10–P90 hold the truth in 5 or more, 88 % of trials with 80 %, and P50 is not twice off in the median."""
    state, left = worn_fleet(path, 8, 0.75)
    lives = [life for life in lives_of(state) if life.verdict == "trend"]
    assert len(lives) >= 6
    assert sum(life.p10_days <= left <= (life.p90_days or np.inf) for life in lives) >= len(lives) - 3
    assert 0.6 < np.median([life.p50_days / left for life in lives]) < 1.6
    assert sum(life.path == path for life in lives) >= 0.6 * len(lives)


def test_an_accelerating_joint_is_not_told_half_its_rate():
    """The rate as found is that of a straight line; the rate along the paths is within 35 % of the truth in the median of 8 arms."""
    state, _ = worn_fleet("accelerating", 8, 0.75)
    truth = 0.3 * 3.0 * np.exp(3.0 * 0.75) / np.expm1(3.0) / LIFE
    told = np.median([life.rate_per_day / truth for life in lives_of(state) if life.rate_per_day is not None])
    assert 0.7 < told < 1.4
    assert told > 1.1 * np.median(wear_and_rate(state).mean[1::J, 1]) / truth


@pytest.mark.parametrize("path", list(PATHS))
@pytest.mark.parametrize("share", [0.5, 0.75])
def test_p10_to_p90_hold_eight_of_ten_on_every_path(path, share):
    """The figures of 200 arms with the short life of 300 days: 70–98 %, and the median of P50 over the truth within 0.7–1.5."""
    state, left = worn_fleet(path, 200, share, seed=1)
    lives = [life for life in lives_of(state) if life.verdict == "trend"]
    held = np.mean([life.p10_days <= left <= (life.p90_days or np.inf) for life in lives])
    assert 0.70 < held < 0.98
    assert 0.7 < np.median([(life.p50_days or np.inf) / left for life in lives]) < 1.5
