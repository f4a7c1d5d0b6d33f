"""Wrong units and clocks of whole recordings: corrected where the recording determines how, refused otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.errors import Unidentifiable
from monitor.identify.detectors import warnings_of
from monitor.identify.signals.motion import Motion, motion
from monitor.identify.signals.units import in_si
from monitor.recording import Recording

OMEGA = np.pi  # 0.5 Hz


def swing(rate_hz=125.0, duration_s=20.0, speed_rad_s=1.0):
    """Three joints that swing, each a sixth of a turn later; q̈ recorded too."""
    t_s = 100.0 + np.arange(round(duration_s * rate_hz)) / rate_hz
    phase = OMEGA * t_s[:, None] + np.arange(3) * np.pi / 3
    size = speed_rad_s / OMEGA
    return Recording(
        t_s=t_s,
        q=size * np.sin(phase) + np.array([0.0, -1.5, 1.0]),
        qd=speed_rad_s * np.cos(phase),
        qdd=-speed_rad_s * OMEGA * np.sin(phase),
        current=3.0 * np.cos(phase),
        source="swing",
    )


def scaled(recording, **factors):
    """The same recording with fields in other units."""
    return replace(recording, **{name: getattr(recording, name) * factor for name, factor in factors.items()})


def told(found: Motion) -> list[str]:
    """The codes of all warnings of a recording."""
    return [warning.code for value in (found.repaired, found) for warning in warnings_of(value)]


DEGREES = 180.0 / np.pi


@pytest.mark.parametrize(
    ("factors", "texts"),
    [
        ({"q": DEGREES}, ["positions are in degrees"]),
        ({"qd": DEGREES}, ["speeds are in degrees a second"]),
        ({"qd": DEGREES, "qdd": DEGREES}, ["speeds are in degrees a second", "accelerations are in degrees a second squared"]),
        (
            {"q": DEGREES, "qd": DEGREES, "qdd": DEGREES},
            ["positions are in degrees", "speeds are in degrees a second", "accelerations are in degrees a second squared"],
        ),
        ({"t_s": 1e3}, ["time is in milliseconds"]),
        ({"t_s": 1e6}, ["time is in microseconds"]),
    ],
)
def test_a_wrong_unit_is_recognised_corrected_and_reported(factors, texts):
    """The motion is that of the recording in SI units, to rounding, and each correction is a warning of its own."""
    right, found = motion(swing()), motion(scaled(swing(), **factors))
    assert found.repaired.units == tuple(texts)
    for name in ("q", "qd", "qdd", "current"):
        np.testing.assert_allclose(getattr(found, name), getattr(right, name), atol=1e-6)  # a clock in ms is rounded elsewhere
    assert told(found) == ["unit_repaired"] * len(texts)


def test_positions_in_degrees_without_speeds_are_recognised():
    """Two joints beyond any cable, faster than any arm: degrees."""
    alone = replace(scaled(swing(), q=DEGREES), qd=None, qdd=None)
    assert motion(alone).repaired.units == ("positions are in degrees",)


@given(
    rate_hz=st.sampled_from([12.0, 25.0, 94.0, 125.0, 500.0]),
    speed_rad_s=st.floats(0.06, 6.0),
    noise=st.floats(0.0, 0.05),
    seed=st.integers(0, 1000),
)
def test_a_recording_in_si_units_is_left_alone(rate_hz, speed_rad_s, noise, seed):
    """Slow or fast, sparse or dense, with encoder noise of 1e-4 rad and noise of speed: no repair, and no refusal."""
    rng = np.random.default_rng(seed)
    clean = swing(rate_hz=rate_hz, speed_rad_s=speed_rad_s)
    noisy = replace(clean, q=clean.q + 1e-4 * rng.normal(size=clean.q.shape), qd=clean.qd + noise * rng.normal(size=clean.qd.shape))
    found = in_si(noisy)
    assert warnings_of(found) == []
    assert found.recording is noisy


@given(rows=st.lists(st.integers(0, 2499), max_size=100, unique=True), value=st.sampled_from([np.nan, np.inf, 1e305, -1e305]))
def test_torn_rows_do_not_hide_a_unit(rows, value):
    """Up to a twenty-fifth of the rows torn in any way: the unit is still found."""
    degrees = scaled(swing(), qd=DEGREES)
    damaged = degrees.qd.copy()
    damaged[rows] = value
    assert [warning.code for warning in warnings_of(in_si(replace(degrees, qd=damaged)))] == ["unit_repaired"]


def test_speeds_that_are_not_the_positions_own_are_refused():
    """Three times too fast, which is no unit: the message gives the ratio that was found and the one that was expected."""
    wrong = replace(swing(), qd=3.0 * swing().qd)
    with pytest.raises(Unidentifiable, match=r"swing: positions change 0\.33\d? times as fast as the speeds say; expected 1"):
        motion(wrong)


@pytest.mark.parametrize("leap_s", [-50.0, -5.0, 3.2e7], ids=["restart", "set back", "a year ahead"])
def test_a_clock_that_was_set_costs_no_row(leap_s):
    """Both halves stay, with a hole between them that no filter and no block reaches over."""
    whole = swing(duration_s=40.0)
    t_s = whole.t_s.copy()
    t_s[2500:] += leap_s
    found = motion(replace(whole, t_s=t_s))
    assert found.rejected_samples == 0
    assert told(found) == ["clock_jump"]
    assert found.segments[-1] == 1
    assert found.duration_s == pytest.approx(41.0, abs=0.1)
    assert found.samples > 4800  # 5000 less the filter's edges at four ends


def test_a_clock_that_was_set_several_times_loses_no_row():
    """Back, ahead, back: three jumps, no row lost."""
    whole = swing(duration_s=60.0)
    t_s = whole.t_s.copy()
    for row, leap_s in ((1500, -7.0), (3000, 500.0), (5000, -300.0)):
        t_s[row:] += leap_s
    found = motion(replace(whole, t_s=t_s))
    assert found.rejected_samples == 0
    assert "3 times" in warnings_of(found.repaired)[0].text


@given(rows=st.lists(st.integers(3, 2496), max_size=30, unique=True), value=st.floats(-1e6, 1e6))
def test_a_torn_time_is_no_clock_that_was_set(rows, value):
    """Scattered times, too early or too late, are left out row by row."""
    t_s = swing().t_s.copy()
    scattered = [row for k, row in enumerate(sorted(rows)) if k == 0 or row - sorted(rows)[k - 1] > 60]
    t_s[scattered] = value
    assert warnings_of(in_si(replace(swing(), t_s=t_s))) == []


@pytest.mark.parametrize("factor", [1.3, 1.9, 0.6])
def test_a_clock_that_runs_at_another_rate_is_refused(factor):
    """No unit explains the ratio, and inertia would be wrong by its square."""
    with pytest.raises(Unidentifiable, match="check the columns and the clock"):
        motion(scaled(swing(), t_s=factor))


def test_a_clock_that_is_slightly_wrong_is_fitted_with_a_warning():
    """Ten per cent: the recording is fitted, and a warning says that the clock is doubtful."""
    found = motion(scaled(swing(), t_s=1.1))
    assert told(found) == ["clock_doubtful"]
