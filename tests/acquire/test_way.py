"""The way back over the trajectory: where it begins, how fast it goes, and when it is not taken."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from learnt_arms import SHIPPED_NAMES, shipped
from test_guard import inputs, ready_state

from monitor.acquire.safety.conditions import named_conditions
from monitor.acquire.safety.inputs import LastMotion
from monitor.acquire.safety.way import JOIN_RAD, LEFT_RAD, Left, left_from_document, nearest_place, way
from monitor.acquire.settings import ReplaySettings
from monitor.model.robot import load_robot

UR5 = load_robot("ur5")
FAR = short(amplitude_rad=1.5)  # its first joint leaves the start by more than 1 rad
SETTINGS = ReplaySettings(host="127.0.0.1", allow_motion=True, max_approach_rad=1.0)
HOME = FAR.at(np.zeros(1)).q[0] + 0.1


def left_at(t_s: float, **changes) -> Left:
    """An arm that was left there on the trajectory `FAR`, by a cause that is harmless."""
    known = {"path_digest": FAR.path_digest, "on_path": True, "free": True, "home_q": tuple(HOME.tolist())}
    return Left(**(known | {"q": tuple(FAR.at(np.array([t_s])).q[0].tolist())} | changes))


def way_of(left: Left | None, q=None, excitation=FAR):
    return way(excitation, UR5, np.array(left.q) if q is None else q, left, max_approach_rad=SETTINGS.max_approach_rad)


def test_an_arm_that_was_left_on_its_trajectory_goes_back_along_it_slowly_and_then_rests_where_the_motion_before_began():
    """Every position is one that it came through, in reverse order; no joint is faster than an approach, nor accelerates more."""
    found = way_of(left_at(1.9))
    assert found.back_from_s == pytest.approx(1.9, abs=0.002)
    motion = found.to_start(SETTINGS)
    t_s = np.arange(0.0, motion.duration_s + 0.008, 0.008)
    q = np.array([motion.at(each) for each in t_s])
    assert np.allclose(q[0], found.begin_q)
    assert np.allclose(q[-1], FAR.at(np.zeros(1)).q[0])
    places = [nearest_place(FAR, each) for each in q[::10]]
    assert max(off for off, _ in places) < 0.006  # the search samples the path
    qd = np.diff(q, axis=0) / 0.008
    assert np.max(np.abs(qd)) < 1.02 * SETTINGS.approach_speed_rad_s
    assert np.max(np.abs(np.diff(qd, axis=0) / 0.008)) < 1.5 * SETTINGS.approach_acceleration_rad_s2  # and the curve's own, slowed
    assert np.allclose(found.to_home(SETTINGS).at(1e9), HOME)


@pytest.mark.parametrize("name", SHIPPED_NAMES[::5])
def test_an_arm_that_braked_at_full_speed_joins_its_trajectory_again(name):
    """Each joint brakes by itself, with 10 rad/s²: the arm stands beside its path, and the straight way to it is short."""
    excitation = shipped(name)
    robot = load_robot(excitation.robot)
    for t_s in np.random.default_rng(5).uniform(0.0, excitation.pass_s, 20):
        at = excitation.at(np.array([t_s]))
        q = at.q[0] + np.sign(at.qd[0]) * at.qd[0] ** 2 / 20.0
        left = Left(path_digest=excitation.path_digest, on_path=True, free=True, q=tuple(q.tolist()))
        found = way(excitation, robot, q, left, max_approach_rad=2.5)
        assert found.back_from_s is not None
        assert found.off_path_rad < 0.5 * JOIN_RAD
        assert np.array_equal(found.home_q, found.start_q)  # where the motion before began is not known


@pytest.mark.parametrize(
    "why",
    ["jogged", "another trajectory", "a cause that is not harmless", "never seen", "left beside the path", "brought back"],
)
def test_an_arm_is_not_brought_back_over_a_way_that_it_did_not_come(why):
    """It then stands too far from the start, and a person is told what to do."""
    left, q = left_at(1.9), np.array(left_at(1.9).q)
    match why:
        case "jogged":
            q = q + 1.5 * LEFT_RAD
        case "another trajectory":
            left = replace(left, path_digest="0" * 16)
        case "a cause that is not harmless":
            left = replace(left, free=False)
        case "never seen":
            left = replace(left, q=())
        case "left beside the path":
            q = q + 1.5 * JOIN_RAD
            left = replace(left, q=tuple(q.tolist()))
        case "brought back":
            left = None
    found = way_of(left, q)
    assert found.back_from_s is None
    as_left = why in {"a cause that is not harmless", "left beside the path"}
    assert np.allclose(found.home_q, HOME if as_left else q)
    (near,) = named_conditions(
        inputs(ready_state(q=q, target_q=q), settings=SETTINGS, excitation=FAR, last=LastMotion(left=left)), ("approach_near",)
    )
    assert not near.holds
    assert "jog the arm near the start" in near.text
    assert "allow --way-back" in near.text


def test_an_arm_that_was_left_on_the_way_to_the_start_goes_straight_and_then_to_where_that_way_began():
    """Else each such end would move its place of rest."""
    q = FAR.at(np.zeros(1)).q[0] + 0.05
    found = way_of(left_at(0.0, on_path=False, q=tuple(q.tolist())))
    assert found.back_from_s is None
    assert np.allclose(found.home_q, HOME)
    assert len(found.lines) == 2


def test_a_joint_some_turns_on_is_brought_back_around_the_turn_in_which_it_was_played():
    """At its farthest the first joint is nearer to another turn's start; it is the path of the motion before that counts."""
    far = short(amplitude_rad=3.4, joint=5)
    t_s = float(np.argmax(np.abs(far.at(np.linspace(0.0, far.pass_s, 301)).q[:, 5])) * far.pass_s / 300)
    q = far.at(np.array([t_s])).q[0]
    left = Left(path_digest=far.path_digest, on_path=True, free=True, q=tuple(q.tolist()), home_q=tuple(far.at(np.zeros(1)).q[0].tolist()))
    found = way(far, UR5, q, left, max_approach_rad=2.5)
    assert found.back_from_s == pytest.approx(t_s, abs=0.02)
    assert np.allclose(found.start_q, far.at(np.zeros(1)).q[0])


def test_the_earliest_of_places_that_are_as_near_begins_the_way_back():
    """The path crosses itself where every joint turns round: the start is one such place, and the end is the same."""
    _, at_s = nearest_place(FAR, FAR.at(np.zeros(1)).q[0])
    assert at_s == 0.0


def test_how_an_arm_was_left_survives_json_and_keys_of_later_versions():
    left = left_at(1.9, cause="late", failed=2)
    assert left_from_document({**left.as_document(), "later": 1}) == left
