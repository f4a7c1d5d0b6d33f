"""Wear along its paths, over fleets: the path that is found, and the life that is told."""

import numpy as np
import pytest
from test_wear_paths import LIFE, PATHS, lives_of, worn_fleet

from monitor.judge.friction.states import RATE

pytestmark = pytest.mark.soak


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
    """The filter's rate is that of a straight line; the rate along the paths is within 35 % of the truth in the median of 8 arms."""
    state, _ = worn_fleet("accelerating", 8, 0.75)
    truth = 0.3 * 3.0 * np.exp(3.0 * 0.75) / np.expm1(3.0) / LIFE
    told = np.median([life.rate_per_day / truth for life in lives_of(state) if life.rate_per_day is not None])
    assert 0.7 < told < 1.4
    found = [state.of_kinds(np.array([RATE]), n)[0][0] for n in range(1, len(state.replays), 5)]
    assert told > 1.1 * np.median(found) / truth


@pytest.mark.parametrize("path", list(PATHS))
@pytest.mark.parametrize("share", [0.5, 0.75])
def test_p10_to_p90_hold_eight_of_ten_on_every_path(path, share):
    """The figures of 200 arms with the short life of 300 days: 70–98 %, and the median of P50 over the truth within 0.7–1.5."""
    state, left = worn_fleet(path, 200, share, seed=1)
    lives = [life for life in lives_of(state) if life.verdict == "trend"]
    held = np.mean([life.p10_days <= left <= (life.p90_days or np.inf) for life in lives])
    assert 0.70 < held < 0.98
    assert 0.7 < np.median([(life.p50_days or np.inf) / left for life in lives]) < 1.5
