"""The smooth path in joint space."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from monitor.acquire.safety.way import joint_path

angles = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


@given(start=angles, end=angles, speed=st.floats(0.05, 1.5), acceleration=st.floats(0.1, 5.0))
def test_a_path_begins_and_ends_where_it_should_and_keeps_its_limits(start, end, speed, acceleration):
    """The ends are exact, and no joint exceeds speed or acceleration, whatever the way."""
    path = joint_path(start, end, speed_rad_s=speed, acceleration_rad_s2=acceleration)
    t = np.linspace(0.0, path.duration_s, 400)
    q = np.array([path.at(s) for s in t])
    assert np.allclose(q[0], start, atol=1e-12)
    assert np.allclose(q[-1], end, atol=1e-12)
    dt = t[1] - t[0]
    v = np.diff(q, axis=0) / dt
    rounding = 1e-12 / dt  # of a difference of two angles
    assert np.max(np.abs(v)) <= speed + rounding
    assert np.max(np.abs(np.diff(v, axis=0))) / dt <= acceleration * (1 + 1e-6) + 4 * rounding / dt


def test_a_path_has_no_kink_where_its_ramps_meet_the_cruise():
    """Acceleration is continuous: half the step gives half the greatest jump."""
    path = joint_path(np.zeros(6), np.full(6, 2.0), speed_rad_s=0.5, acceleration_rad_s2=1.5)

    def greatest_jump(samples):
        t = np.linspace(-0.1, path.duration_s + 0.1, samples)
        q = np.array([path.at(s)[0] for s in t])
        return np.max(np.abs(np.diff(q, 3))) / (t[1] - t[0]) ** 2

    assert greatest_jump(8001) < 0.6 * greatest_jump(4001)


def test_all_joints_arrive_together():
    """At any time each joint has covered the same share of its way."""
    path = joint_path(np.zeros(6), np.array([1.0, -2.0, 0.5, 0.0, 3.0, -0.1]), speed_rad_s=0.5, acceleration_rad_s2=1.5)
    share = path.at(0.4 * path.duration_s)[[0, 1, 2, 4, 5]] / np.array([1.0, -2.0, 0.5, 3.0, -0.1])
    assert np.allclose(share, share[0], rtol=1e-12)


def test_a_path_without_length_stays_at_its_pose():
    """A path from a pose to itself is that pose."""
    here = np.array([0.1, -1.5, 0.2, 0.3, -0.2, 0.1])
    path = joint_path(here, here, speed_rad_s=0.5, acceleration_rad_s2=1.5)
    assert path.duration_s > 0.0
    assert np.array_equal(path.at(0.07), here)
