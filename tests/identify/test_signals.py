"""One even clock, no delay, and every torn row counted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.errors import Unidentifiable
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.motion import motion
from monitor.recording import Recording

FREQUENCY_HZ = 0.5  # the fastest harmonic of the paper's excitation
OMEGA = 2 * np.pi * FREQUENCY_HZ


def swing(rate_hz: float = 125.0, duration_s: float = 20.0, t_s: np.ndarray | None = None, speed_rad_s: float = 1.0) -> Recording:
    """Two joints that swing, the second a quarter later; current in phase with speed."""
    t_s = np.arange(round(duration_s * rate_hz)) / rate_hz if t_s is None else t_s
    phase = OMEGA * t_s[:, None] + np.array([0.0, np.pi / 2])
    return Recording(
        t_s=t_s,
        q=speed_rad_s / OMEGA * np.sin(phase),
        qd=speed_rad_s * np.cos(phase),
        current=3.0 * np.cos(phase),
        source="swing",
    )


def torn(recording: Recording, rows: list[int], **values: float) -> Recording:
    """The same, with these fields of these rows overwritten."""
    changed = {}
    for name, value in values.items():
        signal = getattr(recording, name).copy()
        signal[rows] = value
        changed[name] = signal
    return replace(recording, **changed)


def test_filtering_shifts_nothing():
    """Position, speed, acceleration and current of a 0.5 Hz swing keep their phase to 0.1 mrad and their size to 0.1 %."""
    found = motion(swing())
    phase = OMEGA * found.t_s
    # amplitude: |H|² of 2nd order at 0.5 of 8 Hz is 1 − 1.5e-5; the central difference takes (ω·dt)²/6 = 1e-4
    for signal, size, lead in (
        (found.q, 1 / OMEGA, 0.0),
        (found.qd, 1.0, np.pi / 2),
        (found.qdd, OMEGA, np.pi),
        (found.current, 3.0, np.pi / 2),
    ):
        for j, start in enumerate((0.0, np.pi / 2)):
            basis = np.column_stack([np.sin(phase + lead + start), np.cos(phase + lead + start)])
            in_phase, across = np.linalg.lstsq(basis, signal[:, j], rcond=None)[0]
            assert in_phase == pytest.approx(size, rel=1e-3)
            assert abs(across / in_phase) < 1e-4


def test_noise_above_the_motion_is_removed_alike():
    """A 25 Hz ripple, three times the cutoff, loses 99 % of its size in speed and in current."""
    ripple = np.sin(2 * np.pi * 25.0 * swing().t_s)[:, None]
    noisy = replace(swing(), qd=swing().qd + ripple, current=swing().current + ripple)
    clean, dirty = motion(swing()), motion(noisy)
    # |H|² at 25 of 8 Hz is 1/(1 + 3.125⁴) ≈ 0.0104, a little less with the bilinear transform
    assert np.max(np.abs(dirty.qd - clean.qd)) < 0.0105
    assert np.max(np.abs(dirty.current - clean.current)) < 0.0105


def test_a_jittered_clock_becomes_an_even_one():
    """10–12 ms ticks, as from the UR10e, give the swing at even times, to 1e-4 of its size."""
    rng = np.random.default_rng(0)
    found = motion(swing(t_s=800.0 + np.cumsum(rng.choice([0.010, 0.012, 0.002], p=[0.6, 0.39, 0.01], size=2000))))
    np.testing.assert_allclose(np.diff(found.t_s), 1.0 / found.rate_hz, rtol=1e-9)  # rounding of times near 800 s
    assert 90.0 < found.rate_hz < 96.0  # mean tick 10.7 ms
    expected = np.cos(OMEGA * found.t_s)
    assert np.max(np.abs(found.qd[:, 0] - expected)) < 1e-4  # cubic between knots: (ω·dt)⁴/384 ≈ 3e-9; filter: 1.5e-5


def test_speed_comes_from_position_where_it_was_not_recorded():
    """Central differences of a 0.5 Hz swing at 125 Hz: (ω·dt)²/6 ≈ 1e-4."""
    with_speed, without = motion(swing()), motion(replace(swing(), qd=None))
    np.testing.assert_allclose(without.qd, with_speed.qd, atol=2e-4)


def test_torn_rows_are_counted_by_reason_and_change_nothing():
    """Not finite, absurd, out of order, out of place: each row is dropped once, and what remains is the undisturbed swing."""
    damaged = torn(swing(), [100], q=np.nan)
    damaged = torn(damaged, [300, 301], current=1e305)
    damaged = torn(damaged, [500], t_s=3.9)  # a repeated, older time
    damaged = torn(damaged, [700], t_s=1e6)  # a time far ahead must not outlaw all that follow
    damaged = torn(damaged, [900], q=7.0)  # plausible anywhere but here
    damaged = torn(damaged, [1100], t_s=np.inf)
    found = motion(damaged)
    assert found.rejected_why == {"not_finite": 2, "absurd_value": 2, "time_not_increasing": 2, "position_jump": 1}
    assert found.rejected_samples == 7
    # three neighbouring knots missing from a cubic: (ω·3dt)⁴/384 ≈ 1e-7
    np.testing.assert_allclose(found.qd, motion(swing()).qd, atol=1e-5)


@given(rows=st.lists(st.integers(0, 2499), max_size=60, unique=True), field=st.sampled_from(["q", "qd", "current", "t_s"]))
@settings(max_examples=40)
def test_any_scattered_rows_may_be_torn(rows, field):
    """Whatever up to 60 of 2500 rows are torn, exactly those are dropped."""
    assert motion(torn(swing(), rows, **{field: np.nan})).rejected_samples == len(rows)


def test_a_hole_is_not_bridged():
    """A second without rows leaves a second without motion, and no block of time reaches over it."""
    whole = swing()
    hole = (whole.t_s > 8.0) & (whole.t_s < 9.0)
    found = motion(Recording(t_s=whole.t_s[~hole], q=whole.q[~hole], qd=whole.qd[~hole], current=whole.current[~hole]))
    assert not np.any((found.t_s > 8.0) & (found.t_s < 9.0))
    assert found.rate_hz == pytest.approx(125.0, rel=1e-6)
    blocks = found.blocks(0.8)
    before, after = found.t_s <= 8.0, found.t_s >= 9.0
    assert not set(blocks[before]) & set(blocks[after])
    assert np.all(np.diff(blocks) >= 0)
    assert np.array_equal(np.unique(blocks), np.arange(blocks[-1] + 1))


def test_the_controllers_clock_may_start_anywhere():
    """Six weeks of uptime change only the rounding of the clock: 4e6 s holds 5e-10 s, times ω."""
    early, late = motion(swing()), motion(replace(swing(), t_s=swing().t_s + 4e6))
    np.testing.assert_allclose(late.q, early.q, atol=1e-7)
    assert late.rate_hz == pytest.approx(early.rate_hz, rel=1e-6)


def test_slow_recordings_get_a_lower_cutoff():
    """At 25 Hz the cutoff of 8 Hz stays below Nyquist and a 0.5 Hz swing keeps its size to 2 % (the difference's (ω·dt)²/6 is 0.3 %)."""
    found = motion(swing(rate_hz=12.0), SignalSettings(cutoff_hz=30.0))
    assert np.max(np.abs(found.qd[:, 0] - np.cos(OMEGA * found.t_s))) < 0.02


@pytest.mark.parametrize(
    ("recording", "reason"),
    [
        (swing(rate_hz=1.0, duration_s=600.0), r"sampled at 1 Hz; expected at least 10 Hz"),
        (swing(speed_rad_s=0.01), r"the arm stands still \(fastest 0.01 rad/s\)"),
        (swing(duration_s=3.0), r"2.99 s long; expected at least 5 s"),
        (replace(swing(), current=None), r"neither current nor torque"),
        (torn(swing(), list(range(0, 2500, 3)), current=np.nan), r"834 of 2500 rows are torn \(834 not finite\)"),
        (torn(swing(), list(range(2500)), q=np.nan), r"q of joints 1, 2 holds no number"),
        (swing(t_s=np.concatenate([np.arange(50) * 0.008 + 10.0 * k for k in range(20)])), r"usable"),
    ],
    ids=["1Hz", "standstill", "short", "no-current", "torn", "all-torn", "scraps"],
)
def test_a_recording_that_cannot_be_identified_is_refused_with_the_reason(recording, reason):
    """Unidentifiable, exit code 2, naming the file, what was found and what was expected."""
    with pytest.raises(Unidentifiable, match=reason) as refusal:
        motion(recording)
    assert refusal.value.exit_code == 2
    assert str(refusal.value).startswith("swing: ")


def test_temperature_follows_the_motions_clock():
    """A linear warm-up is the same line at the motion's times; a sensor without readings is NaN, and has no other joint's value."""
    base = swing()
    warm = np.stack([30.0 + 0.1 * base.t_s, np.full(len(base.t_s), np.nan)], axis=1)
    found = motion(replace(base, temperature_c=warm))
    np.testing.assert_allclose(found.temperature_c[:, 0], 30.0 + 0.1 * found.t_s, atol=1e-9)
    assert np.all(np.isnan(found.temperature_c[:, 1]))


def test_despiking_repairs_isolated_samples_and_keeps_the_rest():
    """Twenty spikes of 30 A are counted and gone (3 % of the amplitude); a step of friction and noise pass untouched, bit for bit."""
    rng = np.random.default_rng(1)
    clean = swing()
    noisy = clean.current + 0.05 * rng.normal(size=clean.current.shape) + 2.0 * np.sign(clean.qd)
    sound = replace(clean, current=noisy)
    spiky = noisy.copy()
    spiky[50::120, 0] += 30.0
    despike = SignalSettings(despike=True)
    untouched, repaired = motion(sound, despike), motion(replace(sound, current=spiky), despike)
    assert untouched.spikes == 0
    np.testing.assert_array_equal(untouched.current, motion(sound).current)
    assert repaired.spikes == len(spiky[50::120])
    assert np.max(np.abs(repaired.current - untouched.current)) < 0.15


def test_a_column_passes_the_filter_of_the_signals():
    """`rounded` of sgn(q̇) is the motion's own `direction`, away from the ends by a filter's length to 1e-3, over a hole too."""
    t_s = np.delete(np.arange(2500) / 125.0, np.arange(1000, 1060))
    found = motion(swing(t_s=t_s))
    again = found.rounded(np.tanh(found.qd / 0.001))
    assert len(np.unique(found.segments)) == 2
    for number in (0, 1):
        stretch = np.flatnonzero(found.segments == number)[30:-30]
        np.testing.assert_allclose(again[stretch], found.direction[stretch], atol=1e-3)
