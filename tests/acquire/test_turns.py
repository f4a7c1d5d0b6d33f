"""A joint some whole turns on: which turn the trajectory is played around, and what that leaves unchanged."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from hypothesis import given
from hypothesis import strategies as st
from test_guard import inputs, ready_state

from monitor.acquire.safety import conditions as guard
from monitor.acquire.safety.way import turned
from monitor.model.regressor import regressor
from monitor.model.robot import load_robot
from monitor.service.history.assess_and_store import robot_digest

START = short().at(np.zeros(1)).q[0]


def turns_of(robot, by):
    """Whole turns (6,) by which the trajectory is shifted for an arm that stands `by` (6,) [rad] from its start."""
    model = load_robot(robot)
    return np.round((turned(short(robot=robot), model, START + by).at(np.zeros(1)).q[0] - START) / (2.0 * np.pi))


@pytest.mark.parametrize(
    ("robot", "joint", "by", "turns"),
    [
        ("ur3e", 5, 4.0 * np.pi, 2),  # as in the real recording
        ("ur3e", 5, -6.0 * np.pi + 0.4, -3),
        ("ur3", 5, 4.0 * np.pi, 2),
        ("ur5e", 5, 4.0 * np.pi, 0),  # its range ends at one turn: the curve would leave it
        ("ur3e", 4, 4.0 * np.pi, 0),
        ("ur5", 1, 2.0 * np.pi, 1),  # −1.5 rad and a turn on is 4.8 rad: within the range
        ("ur5", 1, -2.0 * np.pi, 0),
        ("ur5", 2, 2.0 * np.pi, 0),  # the elbow has half a turn to each side
        ("ur5", 0, 0.4, 0),
    ],
)
def test_the_nearest_turn_within_the_range_is_taken(robot, joint, by, turns):
    """Only whole turns, only where the whole curve stays within the joint's range, only for that joint."""
    found = turns_of(robot, by * np.eye(6)[joint])
    assert found[joint] == turns
    assert not np.any(np.delete(found, joint))


def test_an_endless_wrist_leaves_one_turn_only_where_it_stands_beyond_it_already():
    """An installation may limit wrist 3 of a UR3e; an arm within ±2π does not show that it is free."""
    wide = short(robot="ur3e", joint=5, amplitude_rad=3.0)
    inside = wide.at(np.zeros(1)).q[0].copy()
    inside[5] = 6.2
    assert np.max(turned(wide, load_robot("ur3e"), inside).at(np.linspace(0, 3, 200)).q[:, 5]) <= 2.0 * np.pi
    inside[5] = 6.4
    assert np.max(turned(wide, load_robot("ur3e"), inside).at(np.linspace(0, 3, 200)).q[:, 5]) > 2.0 * np.pi


@given(by=st.lists(st.floats(-15.0, 15.0), min_size=6, max_size=6))
def test_a_turned_trajectory_stays_within_every_range_and_never_farther_than_it_was(by):
    """Whatever the pose; and the digest of what is configured does not change, because the turned one is a copy."""
    robot, q = load_robot("ur3e"), START + np.array(by)
    plain = short(robot="ur3e")
    digest = plain.digest
    played = turned(plain, robot, q)
    curve = played.at(np.linspace(0.0, 3.0, 400))
    assert np.all(np.abs(curve.q) <= robot.reach_rad)
    assert np.all(np.abs(curve.q[0] - q) <= np.abs(START - q) + 1e-9)
    np.testing.assert_allclose(curve.qd, plain.at(np.linspace(0.0, 3.0, 400)).qd)
    assert plain.digest == digest


def test_a_turn_changes_no_torque_and_so_no_identification():
    """Positions enter the equations by their sine and cosine alone."""
    robot = load_robot("ur3e")
    rng = np.random.default_rng(3)
    q, qd, qdd = (rng.uniform(-2, 2, (30, 6)) for _ in range(3))
    on = q + 2.0 * np.pi * np.array([0, 0, 0, 0, 0, 2])
    mounting = inputs().excitation.mounting
    np.testing.assert_allclose(regressor(robot, mounting, on, qd, qdd), regressor(robot, mounting, q, qd, qdd), atol=1e-11)


def test_a_pose_that_is_no_number_is_not_turned():
    """The condition `finite` refuses it."""
    assert turned(short(), load_robot("ur5"), np.full(6, np.nan)).offset_rad.tolist() == short().offset_rad.tolist()


def test_the_conditions_and_the_trajectory_in_play_are_of_the_same_turn():
    """An arm one turn on passes, and the trajectory's own digest stands in what is found."""
    q = START.copy()
    q[1] += 2.0 * np.pi
    known = replace(inputs(ready_state(q=q, target_q=q, tcp_pose=())))
    guard.check_state(known)
    assert known.played.at(np.zeros(1)).q[0, 1] == pytest.approx(q[1])
    assert known.excitation.digest == short().digest


def test_what_a_stored_verdict_says_of_its_robot_stays_as_it_was():
    """Whether a joint turns without end came later; it is no part of an identification, and so not of its robot's digest."""
    assert robot_digest(load_robot("ur5")) == "d0ee52a1c29ffd2d"
    assert robot_digest(load_robot("ur3e")) == robot_digest(replace(load_robot("ur3e"), endless=np.zeros(6)))
