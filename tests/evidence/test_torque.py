"""How well torque is predicted at another temperature, compared with the noise-free torque of the full simulator."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence import torque
from evidence.torque import TorqueErrors, study_arm, summary, surrogate
from monitor.judge.settings import AssessSettings
from monitor.model.fourier import excitation_from_document

EXCITATION = Path(__file__).parents[2] / "config" / "excitation" / "ur5-ground.json"
BLANK = TorqueErrors(  # of two joints, one test, no replay
    squares_nm2=np.ones((2, 2)),
    friction_error_nm=np.ones((2, 1, 2)),
    slope_per_k=np.zeros(2),
    law_residual=np.zeros((0, 2)),
    grease_c=np.zeros((0, 2)),
    covered=np.full(2, 0.9),
    range_c=(10.0, 30.0),
    assess_s=0.1,
)


def arm(seed, replays, tests):
    excitation = replace(excitation_from_document(json.loads(EXCITATION.read_text("utf-8"))), repetitions=1)
    return study_arm(seed, excitation=excitation, settings=AssessSettings(), replays=replays, tests=tests, clock=lambda: 0.0)


@pytest.mark.soak
def test_after_twelve_replays_temperatures_halve_the_error():
    """One arm with fewer replays than on the card: half of the error remains at most, and a fifth of the error of friction alone.

    The 90 % intervals contain 75 to 99 % of the samples.
    """
    found = arm(41, 12, 4)
    assert found.ratio < 0.5
    with_T, without = np.nanmean(found.friction_error_nm**2, axis=1)
    assert np.sqrt(with_T.sum() / without.sum()) < 0.2
    assert np.all((found.covered > 0.75) & (found.covered < 0.99))
    assert 4.0 < found.range_c[0] < found.range_c[1] < 50.0


@pytest.mark.soak
def test_the_range_is_that_of_the_temperatures_that_count(monkeypatch):
    """A joint outside the temperatures of the study does not count for the errors, nor for the range beside them."""
    monkeypatch.setattr(torque, "WARMEST_C", 30.0)
    found = arm(41, 2, 2)
    assert np.isnan(found.friction_error_nm).any()
    assert found.range_c[1] <= 30.0


def test_the_errors_of_arms_are_averaged_as_squares():
    """Two arms: √((1 + 9)/(100 + 100)), and the worst arm beside it. A joint without a slope does not count for the slope."""
    one = replace(BLANK, squares_nm2=np.array([[1.0, 0.0], [100.0, 0.0]]), slope_per_k=np.array([0.001, np.nan]))
    other = replace(one, squares_nm2=np.array([[9.0, 0.0], [100.0, 0.0]]), slope_per_k=np.array([-0.003, np.nan]), range_c=(5.0, 20.0))
    with np.errstate(invalid="ignore"):  # the second joint's own ratio is 0/0 here
        figures = summary([one, other], replays=3, tests=1)
    assert figures["ratio"]["value"] == pytest.approx(np.sqrt(0.05))
    assert figures["ratio_of_worst_arm"] == pytest.approx(0.3)
    assert figures["slope_per_k"]["value"] == pytest.approx(0.002)
    assert figures["range_c"] == [5.0, 30.0]


def drawn(std, course, seed=0):
    """Four arms with 100 replays each: a constant of the arm, noise of size `std`, and a slope `course` against temperature."""
    rng, arms = np.random.default_rng(seed), []
    for _ in range(4):
        grease = rng.uniform(10.0, 30.0, (100, 2))
        left = 0.02 * rng.normal() + std * rng.uniform(0.7, 1.5, (100, 2)) * rng.normal(size=(100, 2)) + course * (grease - 20.0)
        arms.append(replace(BLANK, law_residual=left, grease_c=grease))
    return arms


def test_a_distribution_other_than_the_surrogates_is_detected():
    """Draws of the surrogate pass; a slope against temperature, or noise with two modes, is detected."""
    same = surrogate(drawn(0.005, 0.0), 0.005)
    assert same["replays"] == 400
    assert same["p"] > 0.01
    assert same["slope_per_k"] < 0.0002
    assert same["std"] == pytest.approx([same["surrogate_std"]] * 2, rel=0.1)
    assert surrogate(drawn(0.005, 0.002), 0.005)["slope_per_k"] == pytest.approx(0.002, rel=0.1)
    split = [replace(arm, law_residual=0.005 * np.sign(arm.law_residual - arm.law_residual.mean(axis=0))) for arm in drawn(0.005, 0.0)]
    assert surrogate(split, 0.005)["p"] < 1e-6


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_the_error_with_temperatures_is_a_third_of_that_without():
    """Ten arms of other seeds than those of the card: the bound of the ratio is 1/3, that of the slope 0.1 %/K.

    90 % intervals contain 85–95 % of the samples.
    """
    figures = summary([arm(seed, 40, 12) for seed in range(77, 87)], replays=40, tests=12)
    print(json.dumps(figures, indent=1))
    assert figures["ratio"]["at_most"] <= 1 / 3
    assert figures["slope_per_k"]["at_most"] <= 0.001
    assert figures["covered_90"]["at_least"] >= 0.85
    assert figures["covered_90"]["at_most"] <= 0.95
    assert all(0.83 <= covered <= 0.97 for covered in figures["covered_90_by_joint"])
