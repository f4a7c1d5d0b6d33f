"""The charts have the run lengths of the textbook, and what they chart is white where nothing changes."""

import json
import math

import numpy as np
import pytest

from evidence import baselines
from evidence.baselines import CHARTS, HEAD, charted, comparison, cusum, ewma, fit, innovations, shewhart, table_row
from evidence.informed import Seen

ARL = (  # chart, threshold, and mean run length to a signal on either side: in control, and after a shift of 1 σ
    (shewhart, 3.0, 370.4, 43.9),  # Montgomery, section 5.3
    (ewma, 2.814, 500.0, 10.3),  # λ 0.1, Montgomery, table 9.11
    (cusum, 5.0, 465.0, 10.4),  # k 0.5, Montgomery, section 9.1.3
)
JOINTS, IN_CONTROL = 1000, 30


def run_length(over):
    """Replays at risk over signals, of charts that run on to their end or to their first signal; over : (D, N)."""
    signal = over.any(axis=0)
    return np.where(signal, over.argmax(axis=0) + 1, len(over)).sum() / signal.sum()


@pytest.mark.parametrize(("chart", "threshold", "in_control", "shifted"), ARL, ids=[each[0].__name__ for each in ARL])
def test_a_chart_has_the_run_lengths_of_the_textbook(chart, threshold, in_control, shifted):
    """Of a thousand charts a mean run length is known to 3 %. The shift comes after a month, as no textbook's does: up to 10 % sooner."""
    z = np.random.default_rng(5).normal(size=(1500, JOINTS))
    assert run_length(chart(z).max(axis=0) > threshold) == pytest.approx(in_control, rel=0.1)
    z = z[:400]
    z[IN_CONTROL:] += 1.0
    over = chart(z).max(axis=0) > threshold
    assert 0.88 * shifted < run_length(over[IN_CONTROL:, ~over[:IN_CONTROL].any(axis=0)]) < 1.06 * shifted


def test_a_replay_that_is_missing_changes_no_chart():
    """The charts of what was seen are those of the same replays without gaps."""
    rng = np.random.default_rng(1)
    z = rng.normal(size=(60, 3))
    gaps = np.full((120, 3), np.nan)
    gaps[::2] = z
    for chart in (ewma, cusum):
        assert np.array_equal(chart(gaps)[:, ::2], chart(z))


def seen(days, joints, *, rho=0.6, std=0.03, seed=3):
    """Friction with a level, a slope and a warming of its own in each joint, under noise of one correlation; one replay is missing."""
    rng = np.random.default_rng(seed)
    temperature = 25.0 + 8.0 * np.sin(np.arange(days) / 58.0)[:, None] + rng.normal(size=(days, joints))
    warming = 0.1 * rng.normal(size=(days, joints))
    noise = std * rng.normal(size=(days, joints))
    for day in range(1, days):
        noise[day] = rho * noise[day - 1] + math.sqrt(1.0 - rho**2) * noise[day]
    y = rng.normal(2.0, 1.0, joints) - rng.uniform(0.005, 0.015, joints) * temperature + 0.05 * warming + noise
    y[100] = np.nan
    return Seen(y, np.full(y.shape, 1e-5), temperature, warming)


def test_what_is_charted_is_white_and_of_unit_size_where_nothing_changes():
    """Though level, slope, warming, σ and ρ are all estimated, from the learning days on, and another joint's are others."""
    z = innovations(seen(700, 60))
    assert np.isnan(z[:60]).all()
    for part in (z[60:120], z[400:]):
        known = part[np.isfinite(part)]
        assert abs(known.mean()) < 4.0 / math.sqrt(known.size)
        assert known.std() == pytest.approx(1.0, abs=0.05)
    product = z[200:-1] * z[201:]
    assert abs(np.nanmean(product)) < 0.04  # 2.5 of its standard deviation


def test_a_regression_finds_the_correlation_and_what_is_new_in_a_replay(monkeypatch):
    """From two years, within what so many replays say."""
    fits = []

    def kept(moments, start):
        fits.append(fit(moments, start))
        return fits[-1]

    monkeypatch.setattr(baselines, "fit", kept)
    innovations(seen(730, 40))
    last = fits[-1]
    assert last.rho.mean() == pytest.approx(0.6, abs=0.02)
    assert np.sqrt(last.var).mean() == pytest.approx(0.03 * 0.8, rel=0.03)
    assert last.mean[:, 3].mean() == pytest.approx(0.05, abs=0.005)


def test_a_regression_that_is_not_fitted_again_keeps_a_change_that_one_fitted_daily_takes_in():
    """A step of 10 % is in every later innovation of the one, and fades out of the other's."""
    one = seen(500, 40)
    one.log_torque[150:] += 0.10
    fixed, daily = (np.nanmean(innovations(one, learn_days=days)[450:]) for days in (140, None))
    assert fixed > 0.8
    assert daily < 0.5 * fixed


def test_a_chart_has_as_many_false_advisories_as_the_judge_and_finds_what_it_finds(monkeypatch):
    """A step of 5 % under noise of 2 % within weeks; every figure is JSON and its row has every chart."""
    judged = {"counted": {"events": 2, "per_year": 2.0 / 3.0}}
    detection = [{"median_days": 10.0, "p90_days": None}]
    document = {"world": "plain", "robot_years": 3.0, "false_advisories": judged, "detection": detection}
    monkeypatch.setattr(baselines, "judge_world", lambda _fleet, _settings: None)
    monkeypatch.setattr(baselines, "world_document", lambda _healthy, _worn: document)
    plain = charted("plain", arms=4, worn=6, days=300, seed=2)
    one = json.loads(json.dumps(comparison(plain, {**plain.tuned(), "Shewhart": 99.0}), allow_nan=False))
    assert {name: each["events"] for name, each in one["tuned"].items()} == dict.fromkeys(CHARTS, 2)
    assert {name: each["events"] for name, each in one["by_thresholds_of_plain"].items()} == {**dict.fromkeys(CHARTS, 2), "Shewhart": 0}
    assert one["tuned"]["CUSUM"]["detection"][0]["median_days"] < 40
    assert one["by_thresholds_of_plain"]["Shewhart"]["detection"][0]["median_days"] is None
    assert table_row(one).startswith("| plain | 0.667 | 10 (–) | ")
    assert table_row(one).count("|") == HEAD.splitlines()[0].count("|") == 5 + len(CHARTS)
