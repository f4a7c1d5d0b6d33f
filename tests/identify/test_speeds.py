"""Speeds that are not those of the positions, joint by joint; and clocks that were written too coarsely."""

from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import GROUND, recording, truth

from monitor.errors import Unidentifiable
from monitor.identify.detectors import warnings_of
from monitor.identify.identify import identify
from monitor.identify.signals.motion import motion
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")
HEALTHY = recording(truth(UR5, repetitions=1))


def exchanged(a, b, *fields):
    """The recording with these fields of joints a and b exchanged, numbered from 0."""
    order = np.arange(6)
    order[[a, b]] = b, a
    return replace(HEALTHY, **{field: getattr(HEALTHY, field)[:, order] for field in fields})


def with_speed(j, factor):
    qd = HEALTHY.qd.copy()
    qd[:, j] *= factor
    return replace(HEALTHY, qd=qd)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (replace(HEALTHY, q=HEALTHY.qd, qd=HEALTHY.q), "q and q̇ are exchanged"),
        (replace(HEALTHY, qd=-HEALTHY.qd), "the speeds of joints 1, 2, 3, 4, 5, 6 have the opposite sign"),
        (with_speed(2, -1.0), "the speeds of joint 3 have the opposite sign"),
        (exchanged(1, 4, "qd"), "the speeds of joints 2 and 5 are exchanged"),
        (with_speed(5, np.degrees(1.0)), r"the positions of joint 6 change 0\.017\d times as fast"),
        (with_speed(0, 2.0), r"the positions of joint 1 change 0\.(499|5) times as fast"),
        (replace(HEALTHY, qd=HEALTHY.qd[:, [0, 1, 2, 1, 4, 5]]), "the speeds of joint 4 are not the change of their positions"),
    ],
    ids=["q and qd", "sign of all", "sign of one", "two joints", "degrees of one", "half of one", "of another joint"],
)
def test_speeds_that_are_another_signal_are_refused_with_the_likely_reason(wrong, reason):
    """Each joint's speed is set beside the change of its own position, with its sign."""
    with pytest.raises(Unidentifiable, match=f"synthetic: .*{reason}.*check the columns"):
        motion(wrong)


@pytest.mark.parametrize("noise_rad", [0.0, 0.01])
@pytest.mark.parametrize("torn", [0, 120])
def test_noise_and_torn_rows_do_not_make_speeds_wrong(noise_rad, torn):
    """A tenth of the rows torn, and positions known to 10 mrad only: no refusal, and no doubt about the speeds."""
    rng = np.random.default_rng(3)
    q, rows = HEALTHY.q + noise_rad * rng.normal(size=HEALTHY.q.shape), rng.choice(HEALTHY.samples, torn, replace=False)
    q[rows] = rng.normal(size=(torn, 6))
    found = motion(replace(HEALTHY, q=q))
    assert warnings_of(found.repaired) == []
    assert found.rejected_samples == pytest.approx(torn, abs=3)


def test_a_factor_of_one_tenth_and_a_lag_are_told_by_joint():
    """A speed 10 % too large, and one that comes 40 ms late, are identified with a doubt that names joint and size."""
    late = HEALTHY.qd.copy()
    late[5:, 3] = HEALTHY.qd[:-5, 3]
    texts = [warning.text for warning in identify([replace(HEALTHY, qd=late)], UR5, GROUND).warnings if warning.code == "speeds_doubtful"]
    assert any("joint 4" in text for text in texts), texts
    assert len(texts) == 1
    texts = [warning.text for warning in identify([with_speed(2, 1.1)], UR5, GROUND).warnings if warning.code == "speeds_doubtful"]
    assert len(texts) == 1
    assert "joint 3" in texts[0]
    assert "factor 1.1" in texts[0]


@pytest.mark.parametrize("resolution_s", [0.01, 0.02, 0.016])
def test_a_coarse_clock_is_restored(resolution_s):
    """125 Hz written in steps of 10, 16 or 20 ms: no row is lost, and friction at 0.4 rad/s is that of the true clock to 0.1 %."""
    coarse = replace(HEALTHY, t_s=np.floor(HEALTHY.t_s / resolution_s) * resolution_s)
    found, whole = identify([coarse], UR5, GROUND), identify([HEALTHY], UR5, GROUND)
    assert found.sources[0].rejected_samples == 0
    assert [warning.code for warning in found.warnings if warning not in whole.warnings] == ["clock_restored"]
    np.testing.assert_allclose(found.friction_at(0.4)[0], whole.friction_at(0.4)[0], rtol=1e-3)


def test_a_coarse_clock_with_a_hole_is_restored_on_both_sides_of_it():
    """A second without rows stays a second without rows."""
    rows = np.delete(np.arange(HEALTHY.samples), np.arange(600, 725))
    cut = {name: getattr(HEALTHY, name)[rows] for name in ("q", "qd", "current", "temperature_c")}
    found = motion(replace(HEALTHY, t_s=np.round(HEALTHY.t_s[rows], 2), **cut))
    assert found.rejected_samples == 0
    assert [warning.code for warning in warnings_of(found.repaired)] == ["clock_restored"]
    assert np.max(np.diff(found.t_s)) > 1.0


def test_a_clock_in_nanoseconds_is_recognised():
    """As ROS stamps messages."""
    found = motion(replace(HEALTHY, t_s=HEALTHY.t_s * 1e9))
    assert found.repaired.units == ("time is in nanoseconds",)
    assert found.rate_hz == pytest.approx(125.0, rel=1e-6)
