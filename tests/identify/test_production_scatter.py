"""How far friction from work differs, by the arm's own days and paths, beside what is usual."""

import numpy as np
import pytest

from monitor.identify.production.information import USUAL_SCALE, Days, between_days, noise_scale

USUAL, FRICTION = 0.015, np.array([12.0, 13.0, 10.0, 2.5, 2.4, 2.3])


def days(rng, count: int, scatter: float, swing_k: float = 0.0) -> Days:
    """Days of an arm whose friction differs so much from day to day, in a room whose temperature swings."""
    warmer = swing_k * rng.normal(size=(count, 1)) + np.zeros(6)
    change = scatter * rng.normal(size=(count, 6)) - 0.006 * warmer
    return Days(FRICTION * np.exp(change), 30.0 + warmer)


def test_one_day_says_nothing_of_its_own_and_the_usual_figure_counts():
    one = days(np.random.default_rng(1), 1, 0.05)
    assert np.allclose(between_days(one, USUAL), USUAL)
    assert np.allclose(between_days(Days(np.zeros((0, 6)), np.zeros((0, 6))), USUAL), USUAL)


@pytest.mark.parametrize(
    ("count", "scatter", "least"), [(3, 0.004, 0.85), (7, 0.004, 0.85), (3, 0.015, 0.85), (7, 0.015, 0.85), (7, 0.03, 0.8)]
)
def test_intervals_by_the_days_of_the_arm_hold_its_next_day(count, scatter, least):
    """Arms that repeat better than usual, as usual and worse: 90 % intervals of the next day hold, none too often where a week is known."""
    rng, held, widths = np.random.default_rng(2), [], []
    for _ in range(300):
        found = between_days(days(rng, count, scatter, swing_k=1.0), USUAL)
        held.append(np.abs(scatter * rng.normal(size=6)) < 1.645 * found)
        widths.append(found)
    assert least <= np.mean(held) <= (0.97 if scatter > 0.01 else 1.0)
    assert np.median(widths) < (2.0 if count > 3 else 2.7) * scatter  # an arm that repeats well is soon known to


def test_the_weather_is_no_scatter():
    """Eight kelvin between days make 5 % of friction, and a scatter of half a per cent is known beside that."""
    found = between_days(days(np.random.default_rng(3), 7, 0.004, swing_k=4.0), USUAL)
    assert np.all(found < 0.009)


def test_a_joint_that_repeats_worse_than_the_others_is_told_apart():
    rng = np.random.default_rng(4)
    seen = days(rng, 7, 0.004)
    seen.friction_nm[:, 2] = FRICTION[2] * np.exp(0.04 * rng.normal(size=7))
    found = between_days(seen, USUAL)
    assert found[2] > 1.3 * np.max(np.delete(found, 2))


def test_paths_that_agree_lessen_what_rows_promise_and_paths_that_differ_enlarge_it():
    enough = np.array([True, True, True, False])
    quiet, loud = (noise_scale(np.ones(4), ratio * np.ones(4), enough) for ratio in (0.1, 3.0))
    assert np.all(quiet[:3] < 0.4)
    assert np.all(loud[:3] > 2.0)
    assert quiet[3] > quiet[0]  # a joint with few paths has those of the others and what is usual
    assert noise_scale(np.ones(4), np.ones(4), np.zeros(4, dtype=bool)) == pytest.approx(USUAL_SCALE)
