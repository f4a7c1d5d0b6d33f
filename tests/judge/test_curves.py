"""The choice of a temperature law, by its error on temperatures left out of the fit."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.errors import BadInput
from monitor.judge.document import plain, typed
from monitor.judge.temperature.laws import (
    Law,
    Line,
    TemperatureSettings,
    fit_law,
    initial_law,
    update_law,
)

REFERENCE_C = np.full(6, 25.0)
SETTINGS = TemperatureSettings()


def learnt_of(friction, *, replays: int = 200, noise: float = 0.02, coldest: float = 5.0, warmest: float = 45.0, seed: int = 0) -> Line:
    rng = np.random.default_rng(seed)
    law = initial_law(REFERENCE_C, friction(REFERENCE_C), fall_per_k=0.015, fall_std_per_k=0.007, scatter=0.05)
    for _ in range(replays):
        T = rng.uniform(coldest, warmest, 6)
        law = update_law(law, T, friction(T) * np.exp(noise * rng.normal(size=6)))
    assert plain(typed(Law, plain(law), where="law", sizes={"J": 6})) == plain(law)
    return fit_law(law, REFERENCE_C, SETTINGS)


LAWS = {
    "linear": lambda T: 10.0 * (1.0 - 0.012 * (T - 25.0)),
    "exponential": lambda T: 10.0 * np.exp(-0.03 * (T - 25.0)),
    "vogel": lambda T: 10.0 * np.exp(600.0 * (1.0 / (T + 90.0) - 1.0 / 115.0)),
}


@pytest.mark.parametrize("name", LAWS)
def test_the_true_law_is_chosen(name):
    """2 % noise, 200 replays from 5 to 45 °C: right in at least five of six joints, and within 2.5 % of the truth at the cold end."""
    line = learnt_of(LAWS[name])
    assert sum(law == name for law in line.law) >= 5
    T = np.linspace(5.0, 45.0, 9)[:, None] * np.ones(6)
    assert np.max(np.abs(line.at(T).value / LAWS[name](T) - 1.0)) < 0.025
    held = line.curve.held_out
    assert np.all(np.nanargmin(held, axis=1) == ["linear", "exponential", "vogel"].index(name))


def test_a_curve_has_less_error_than_the_papers_line():
    """From 5 to 45 °C an exponential bends by a tenth. The line stays as it is and is still published."""
    line = learnt_of(LAWS["exponential"])
    T = np.linspace(5.0, 45.0, 9)[:, None] * np.ones(6)
    of_curve = np.abs(line.at(T).value - LAWS["exponential"](T)).mean()
    of_line = np.abs(replace(line, curve=None).at(T).value - LAWS["exponential"](T)).mean()
    assert of_curve < 0.2 * of_line
    assert np.all(line.slope < 0)


def test_few_replays_or_a_narrow_range_keep_the_line():
    """Fourteen replays, or four bins of 2 K, are too few to choose: no error is reported."""
    for line in (learnt_of(LAWS["exponential"], replays=14), learnt_of(LAWS["exponential"], coldest=24.0, warmest=29.9)):
        assert set(line.law) == {"linear"}
        assert np.isnan(line.curve.held_out).all()


def test_an_extrapolation_is_flagged_and_stays_positive():
    """From −20 to 80 °C, for every law."""
    for friction in LAWS.values():
        line = learnt_of(friction, coldest=20.0, warmest=40.0)
        T = np.linspace(-20.0, 80.0, 21)[:, None] * np.ones(6)
        prediction = line.at(T)
        assert np.all(prediction.value > 0)
        assert np.isfinite(prediction.std).all()
        assert np.array_equal(prediction.extrapolated, (line.range_c[:, 0] - 3.0 > T) | (line.range_c[:, 1] + 3.0 < T))


def test_ninety_percent_intervals_contain_the_truth():
    """Of the chosen curves inside the range, 20 seeds: 90 % nominal, and never below 80 %."""
    T = np.linspace(8.0, 42.0, 7)[:, None] * np.ones(6)
    held = [
        np.abs(prediction.value - LAWS["exponential"](T)) < 1.645 * prediction.std
        for prediction in (learnt_of(LAWS["exponential"], replays=60, seed=seed).at(T) for seed in range(20))
    ]
    assert np.mean(held) > 0.8


def test_a_line_with_its_curve_goes_through_json_exactly():
    """And a damaged one is named."""
    line = learnt_of(LAWS["vogel"])
    document = plain(line)
    assert plain(typed(Line, document, where="line", sizes={"J": 6})) == document
    with pytest.raises(BadInput, match="line: curve: the key 'b' is missing"):
        typed(Line, {**document, "curve": {"kind": [0.0] * 6, "a": [0.0] * 6}}, where="line", sizes={"J": 6})
