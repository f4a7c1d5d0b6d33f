"""Bounds of a study's figures: they hold as often as they say."""

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from monitor.studies.figures import median_bounds, over_arms


@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=30))
def test_the_bounds_of_a_mean_are_those_of_student(values):
    """The jackknife of a mean is its usual standard error."""
    rows = np.array(values)
    found = over_arms(np.mean, rows)
    reach = scipy.stats.t.ppf(0.95, len(rows) - 1) * np.std(rows, ddof=1) / np.sqrt(len(rows))
    assert found.value == pytest.approx(rows.mean(), abs=1e-9)
    assert found.at_most - found.value == pytest.approx(reach, abs=1e-6)
    assert found.value - found.at_least == pytest.approx(reach, abs=1e-6)


def test_the_bounds_of_a_ratio_of_sums_hold_in_95_percent_of_fleets():
    """2000 fleets of 24 arms, some of which err much more than others: the upper bound is missed by 5 ± 2 % of them."""
    rng, missed = np.random.default_rng(3), 0

    def ratio(rows):
        return np.sqrt(rows[:, 0].sum() / rows[:, 1].sum())

    for _ in range(2000):
        size = rng.uniform(0.5, 2.0, 24)
        rows = np.stack([0.1 * size * rng.uniform(0.5, 1.5, 24), size], axis=1)
        missed += over_arms(ratio, rows).at_most < np.sqrt(0.1)
    assert 0.03 < missed / 2000 < 0.07


def test_each_bound_of_a_median_is_missed_by_at_most_one_in_twenty():
    """2000 times 15 and 120 days of which every tenth is never; of fewer than five values nothing bounds it."""
    rng = np.random.default_rng(4)
    for n in (15, 120):
        days = np.where(rng.random((2000, n)) < 0.1, np.inf, rng.exponential(10.0, (2000, n)))
        median = -10.0 * np.log(1.0 - 0.5 / 0.9)
        low, high = np.array([median_bounds(each) for each in days]).T
        assert 0.01 < np.mean(low > median) <= 0.06
        assert 0.01 < np.mean(high < median) <= 0.06
    assert median_bounds(np.array([3.0, 9.0, 4.0, 5.0, np.inf])) == (3.0, np.inf)
    assert median_bounds(np.array([7.0, 7.0, 7.0, 7.0])) == (-np.inf, np.inf)


def test_one_arm_has_no_bounds():
    """With one arm, the spread between arms is unknown."""
    found = over_arms(np.mean, np.array([2.0]))
    assert found.value == 2.0
    assert np.isnan(found.at_most)
    assert np.isnan(found.at_least)
