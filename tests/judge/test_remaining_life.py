"""When friction reaches its limit: the distribution, its quantiles, and when there is no date."""

import doctest
import math

import numpy as np
import pytest
import scipy

import monitor.judge.alerts.remaining_life as life_of
from monitor.errors import BadConfiguration
from monitor.judge.alerts.remaining_life import first_passage, remaining_life
from monitor.judge.settings import PrognosisSettings

SETTINGS = PrognosisSettings()
WALK = 5e-4


def test_first_passage_is_the_inverse_gaussian():
    """Compared with SciPy's distribution, for a drift and a walk with which both terms of the formula matter."""
    days, rise, rate, walk = np.linspace(1, 2000, 50), 0.2, 0.0005, 0.01
    mean, shape = rise / rate, rise**2 / walk**2
    expected = scipy.stats.invgauss.cdf(days, mean / shape, scale=shape)
    assert np.allclose(first_passage(days, np.float64(rise), np.float64(rate), walk), expected, atol=1e-12)  # rounding


def test_first_passage_is_finite_where_its_formula_overflows():
    """With 2νd/σ² = 40 000 the distribution is a sharp step at d/ν, without an infinity or a NaN."""
    passed = first_passage(np.array([90.0, 110.0]), np.float64(0.2), np.float64(0.002), 1e-4)
    assert passed == pytest.approx([0.0, 1.0], abs=1e-9)


def test_a_known_constant_rate_reaches_the_limit_on_time():
    """0.1 % a day from 5 % to 30 %: the median is the remaining rise over the rate, to 1 %; the spread is that of the walk."""
    life = remaining_life(np.array([math.log(1.05), 0.001]), np.diag([1e-10, 1e-12]), wear_walk_per_sqrt_day=WALK, settings=SETTINGS)
    truth = 0.25 / 0.001
    assert life.verdict == "trend"
    assert life.p50_days == pytest.approx(truth, rel=0.01)
    assert life.p10_days == pytest.approx(truth - 1.2816 * WALK * math.sqrt(truth) / 0.001, rel=0.02)
    assert life.p10_days < life.p50_days < life.p90_days


def test_quantiles_are_those_of_a_simulation():
    """Compared with 200 000 drawn rates and wears, whose passage times are drawn in closed form, to 2 %.

    The lattice has 199 points, and the table has steps of 2–4 %.
    """
    mean, cov = np.array([0.08, 0.0008]), np.array([[1e-4, 1e-6], [1e-6, 6e-8]])
    rng = np.random.default_rng(0)
    wear, rate = rng.multivariate_normal(mean, cov, size=200_000).T
    rise = 1.3 - np.exp(wear)
    rising = rate > 0
    days = np.full(len(rate), np.inf)
    shape = rise[rising] ** 2 / WALK**2
    days[rising] = scipy.stats.invgauss.rvs(rise[rising] / rate[rising] / shape, scale=shape, random_state=rng)
    life = remaining_life(mean, cov, wear_walk_per_sqrt_day=WALK, settings=SETTINGS)
    assert [life.p10_days, life.p50_days, life.p90_days] == pytest.approx(np.quantile(days, [0.1, 0.5, 0.9]), rel=0.02)
    soon = PrognosisSettings(service_days=float(np.quantile(days, 0.2)))
    with_service = remaining_life(mean, cov, wear_walk_per_sqrt_day=WALK, settings=soon)
    assert with_service.before_service_probability == pytest.approx(0.2, abs=0.01)


def test_a_limit_beyond_the_longest_prediction_has_no_date():
    """A certain but small rate, 30 % in 270 years, is a trend without a date, since predictions end after 54 years."""
    life = remaining_life(np.array([0.0, 2.7e-6]), np.diag([1e-8, 1e-13]), wear_walk_per_sqrt_day=1e-5, settings=SETTINGS)
    assert life.verdict == "trend"
    assert (life.p10_days, life.p50_days, life.p90_days) == (None, None, None)


def test_without_a_trend_there_is_no_date():
    """P(rate > 0) = 0.84 is below the required probability."""
    life = remaining_life(np.array([0.02, 1e-4]), np.diag([1e-4, 1e-8]), wear_walk_per_sqrt_day=WALK, settings=SETTINGS)
    assert life.verdict == "no_trend"
    assert life.trend_probability == pytest.approx(0.841, abs=0.001)
    assert (life.p10_days, life.p50_days, life.p90_days) == (None, None, None)


def test_beyond_the_limit_no_days_remain():
    """A rise of 35 % is beyond the limit of 30 %, whatever the rate."""
    mean, cov = np.array([math.log(1.35), -1e-4]), np.diag([1e-4, 1e-8])
    life = remaining_life(mean, cov, wear_walk_per_sqrt_day=WALK, settings=SETTINGS)
    assert life.verdict == "reached"
    assert life.p50_days == 0.0


def test_settings_out_of_bounds_are_refused():
    """The message contains the key."""
    with pytest.raises(BadConfiguration, match=r"prognosis\.limit_rise"):
        PrognosisSettings(limit_rise=0.0)
    with pytest.raises(BadConfiguration, match=r"prognosis\.trend_sure"):
        PrognosisSettings(trend_sure=1.0)


def test_the_example_of_remaining_life_runs():
    result = doctest.testmod(life_of)
    assert result.attempted > 5
    assert result.failed == 0
