"""Conditions on the drives, the installation and the software: what must be known, and what is compared with the controller."""

import itertools
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitations import short
from hypothesis import given
from hypothesis import strategies as st
from simulated_arm import known_gains
from test_guard import SIMULATED, inputs, ready_state, tcp_of

from monitor.acquire.safety import conditions as guard
from monitor.acquire.safety.conditions import conditions, named_conditions
from monitor.acquire.safety.inputs import ConditionInputs, ConditionResult
from monitor.acquire.safety.of_installation import angle_deg, offset_of, points, rotation
from monitor.acquire.settings import Installation
from monitor.acquire.state import Identity
from monitor.acquire.ur.driver import SOFTWARE, TESTED_LIBRARY, understood
from monitor.config.load import load
from monitor.errors import BadConfiguration, MotionRefused
from monitor.model.energy import flange_speed
from monitor.model.robot import load_robot, robot_names
from monitor.recording import Context
from monitor.simulate.arm.kinematics import Kinematics

GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)  # [N·m/A] of a UR10e, by its authors' code
HALF_A_METRE_UP = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
PUBLISHED = {"ur3", "ur5"}  # robots whose torque constants are published


def found(name: str, known: ConditionInputs) -> ConditionResult:
    (result,) = named_conditions(known, (name,))
    return result


@pytest.mark.parametrize("name", robot_names())
def test_an_arm_whose_gains_nobody_knows_is_refused_by_the_name_of_the_key(name):
    """Torque is current times gain: without it the band sees no collision. Configured gains are enough for every arm."""
    known = inputs(robot=load_robot(name), excitation=short(robot=name), installation=Installation())
    result = found("drive_gains", known)
    assert result.holds is (name in PUBLISHED)
    if not result.holds:
        assert "robot.gains_nm_per_a" in result.text
        with pytest.raises(MotionRefused, match="gains_nm_per_a"):
            guard.check_quick(replace(known, context=Context()))
    assert found("drive_gains", replace(known, installation=Installation(gains_nm_per_a=GAINS))).holds


@pytest.mark.parametrize("name", robot_names())
def test_a_torque_constant_of_the_motor_is_no_gain_of_the_joint(name):
    """A factory calibration lists the motors' constants, a hundredth of the gains: a joint without load would show no collision."""
    robot = load_robot(name)
    for gain in (0.1, 1000.0):
        result = found("drive_gains", inputs(robot=robot, installation=Installation(gains_nm_per_a=(gain,) * 6)))
        assert not result.holds
        assert "gear ratio" in result.text
    assert found("drive_gains", inputs(robot=robot, installation=known_gains(name))).holds


@pytest.mark.parametrize(
    ("firmware", "holds", "words"),
    [
        ("3.15.8.106339", True, "tested"),
        ("3.10.0", True, "tested"),
        ("5.4.0", True, "tested"),
        ("5.11.0.108249", True, "tested"),
        ("5.23.0.1", True, "tested"),
        ("5.26.0", True, "tested"),
        ("10.12.0.5", True, "tested"),
        ("10.14.2", True, "tested"),
        ("3.9.1", False, "protocol 2"),
        ("5.3.2", False, "crashes in its constructor"),
        ("10.8.0", False, "no program could be stopped"),
        ("10.11.0", False, "does not tell whether it is in remote control"),
        ("10.15.0", False, "allow_untested_software"),
        ("5.27.0", False, "allow_untested_software"),
        ("3.16.0", False, "allow_untested_software"),
        (None, False, "not reported"),
        ("who knows", False, "allow_untested_software"),
    ],
)
def test_software_that_nobody_tested_is_refused_and_what_crashes_always_is(firmware, holds, words):
    """replay.allow_untested_software lets an untested version pass, and none that ur-rtde cannot drive."""
    identity = understood(Identity("UR5", "2016331234", firmware, True))
    result = found("software", inputs(ready_state(), identity=identity))
    assert result.holds is holds
    assert words in result.text
    allowed = found("software", inputs(ready_state(), identity=identity, settings=replace(SIMULATED, allow_untested_software=True)))
    assert allowed.holds is (holds or ("crashes" not in words and "no program" not in words and "protocol" not in words))


def test_the_spans_of_versions_do_not_overlap_and_each_has_a_reason():
    """A version in two spans would be judged by whichever comes first."""
    for before, after in itertools.pairwise(SOFTWARE):
        assert before.first <= before.last < after.first <= after.last
    assert all(len(span.reason) > 20 for span in SOFTWARE)


def test_what_moves_without_a_word_was_played_on_a_simulated_controller_first_and_last_version_too():
    """A span that nobody played is not a tested one; nor is one of whose ends nothing is known."""
    for span in SOFTWARE:
        minors = [tuple(map(int, version.split(".")[:2])) for version in span.played]
        assert all(span.first <= minor <= span.last for minor in minors)
        assert not (span.drives and span.tested) or {span.first, span.last} <= set(minors)
        assert span.drives or not span.played


def test_the_release_of_the_client_library_is_named_beside_the_tested_one():
    """The tested one is what constraints.txt pins; another one moves the arm, and `check` says that it is another."""
    pinned = re.search(r"^ur_rtde==(.+)$", (Path(__file__).parents[2] / "constraints.txt").read_text("utf-8"), re.MULTILINE)
    assert pinned is not None
    assert pinned[1] == TESTED_LIBRARY
    identity = understood(Identity("UR5", "2016331234", "3.15.8", True))
    for installed, words in ((TESTED_LIBRARY, "as tested"), ("1.6.9", f"tested is ur-rtde {TESTED_LIBRARY}")):
        known = identity._replace(software=identity.software._replace(client_library=f"ur-rtde {installed}"))
        result = found("software", inputs(ready_state(), identity=known))
        assert result.holds
        assert f"driven by ur-rtde {installed}" in result.text
        assert words in result.text


def test_the_tool_and_the_payloads_centre_of_the_controller_are_compared_with_the_configured_ones():
    """A millimetre passes, three centimetres or ten degrees do not; what is not configured is reported and not checked."""
    good = inputs(ready_state())
    assert "100 mm, as configured" in found("tcp_offset", good).text
    assert "0.050 m, as configured" in found("payload_cog", good).text
    for changes in (
        {"tcp_offset": (0.0, 0.0, 0.13, 0.0, 0.0, 0.0)},
        {"tcp_offset": (0.0, 0.0, 0.1, np.radians(10.0), 0.0, 0.0)},
        {"payload_cog_m": (0.0, 0.03, 0.05)},
    ):
        (key,) = changes
        name = key.removesuffix("_m")
        wrong = found(name, replace(good, installation=replace(good.installation, **changes)))
        assert not wrong.holds
        assert f"robot.{key}" in wrong.text
        bare = found(name, replace(good, installation=Installation()))
        assert bare.holds
        assert not bare.checked
        assert f"robot.{key} names none" in bare.text
    assert found("tcp_offset", replace(good, installation=Installation(tcp_offset=(0.001, 0.0, 0.1, 0.0, 0.0, 0.01)))).holds


def test_the_centre_of_no_payload_does_not_matter():
    """A controller without payload may report any centre."""
    state = ready_state(payload_kg=0.0, payload_cog_m=(0.3, 0.0, 0.0))
    assert found("payload_cog", inputs(state)).holds


@given(
    q=st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6),
    offset=st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3),
    turn=st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3),
)
def test_the_tcp_offset_is_found_in_any_pose(q, offset, turn):
    """The simulator's kinematics, which are not ours, give the TCP pose; the offset comes back from it."""
    tool = np.array([*offset, *turn])
    pose = Kinematics(load_robot("ur10e")).pose(np.array(q), tool)
    place, attitude = offset_of(load_robot("ur10e"), np.array(q), pose)
    np.testing.assert_allclose(place, offset, atol=1e-9)
    assert angle_deg(attitude.T @ rotation(tool[3:])) < 1e-3  # arccos loses half the digits at its ends


def test_speeds_of_elbow_flange_and_tcp_are_the_simulators():
    """Against kinematics that are not ours, for a long tool."""
    robot, kinematics = load_robot("ur5e"), Kinematics(load_robot("ur5e"))
    rng = np.random.default_rng(1)
    q, qd = rng.uniform(-3, 3, (20, 6)), rng.uniform(-2, 2, (20, 6))
    here = points(robot, q, qd, np.array([0.1, 0.0, 0.3]))
    np.testing.assert_allclose(here.speed[:, 1], flange_speed(robot, q, qd), atol=1e-9)
    kinematics.tool = np.array([0.1, 0.0, 0.3, 0.0, 0.0, 0.0])
    for n in range(20):
        np.testing.assert_allclose(here.place[n, 0], kinematics.elbow(q[n]), atol=1e-9)
        np.testing.assert_allclose(here.speed[n, 0], np.linalg.norm(kinematics.elbow_speed(q[n], qd[n])), atol=1e-9)
        np.testing.assert_allclose(here.place[n, 2], kinematics.pose(q[n])[:3], atol=1e-9)
        np.testing.assert_allclose(here.speed[n, 2], np.linalg.norm(kinematics.speed(q[n], qd[n])[:3]), atol=1e-9)


def test_a_trajectory_faster_than_the_installations_limit_is_refused():
    """The limit is a configured one; the tool counts, and so does the way to the start."""
    known = inputs(ready_state())
    assert "m/s (TCP), the limit is 4 m/s" in found("tcp_speed", known).text
    slow = found("tcp_speed", replace(known, installation=replace(known.installation, tcp_speed_limit_m_s=0.1)))
    assert not slow.holds
    assert "robot.tcp_speed_limit_m_s = 0.1" in slow.text
    assert not found("tcp_speed", replace(known, installation=Installation())).checked


def test_a_trajectory_or_a_way_to_its_start_beyond_a_safety_plane_is_refused():
    """The base turned by half a turn stands on the other side of a plane through the base; so does a tool that reaches through it."""
    known = inputs(ready_state())
    assert "1 planes" in found("safety_planes", known).text
    assert not found("safety_planes", replace(known, installation=Installation())).checked
    tip = points(known.robot, ready_state().q[None], np.zeros((1, 6)), np.array(known.installation.tcp_offset[:3])).place[0, 2]
    beyond = (0.0, 0.0, 1.0, float(tip[2]) - 0.05)  # a ceiling 5 cm below the tip
    result = found("safety_planes", replace(known, installation=replace(known.installation, safety_planes=(beyond,))))
    assert not result.holds
    assert "plane 1 of robot.safety_planes" in result.text
    still = replace(short(), a_rad_s=np.zeros_like(short().a_rad_s), b_rad_s=np.zeros_like(short().b_rad_s))
    side = (1.0, 0.0, 0.0, 0.4)  # x ≤ 0.4 m
    q = still.at(np.zeros(1)).q[0].copy()
    q[1] += 1.5  # leans over to the side of the plane, or away from it
    opposite = q.copy()
    opposite[0] += np.pi
    walls = replace(known, excitation=still, installation=Installation(safety_planes=(side,)))
    held = [
        found("safety_planes", replace(walls, state=ready_state(q=each, target_q=each, tcp_pose=tcp_of(each)))).holds
        for each in (q, opposite)
    ]
    assert sorted(held) == [False, True]


def test_the_tool_that_the_controller_reports_counts_where_none_is_configured():
    """A long tool is faster than the flange, whoever told of it."""
    bare = inputs(ready_state(tcp_pose=tcp_of(ready_state().q, (0.0, 0.0, 0.6))), installation=Installation(tcp_speed_limit_m_s=4.0))
    assert "(TCP)" in found("tcp_speed", bare).text
    configured = replace(bare, installation=Installation(tcp_speed_limit_m_s=4.0, tcp_offset=(0.0, 0.0, 0.6, 0.0, 0.0, 0.0)))
    assert found("tcp_speed", bare).text == found("tcp_speed", configured).text
    assert found("tcp_speed", replace(bare, state=None)).text != found("tcp_speed", bare).text


def test_the_configuration_names_the_installation_and_its_mistakes(tmp_path):
    """Every key is optional; a plane without a unit normal, a centre or a tool of another length are mistakes."""
    path = tmp_path / "arm.toml"
    head = '[robot]\nmodel = "ur10e"\nsite = "lab"\nid = "arm"\n'
    path.write_text(head)
    assert load(path, {}).installation == Installation()
    path.write_text(head + "payload_cog_m = [0.0, 0.0, 0.1]\ntcp_speed_limit_m_s = 1.5\nsafety_planes = [[1.0, 0.0, 0.0, 0.6]]\n")
    assert load(path, {}).installation == Installation(
        payload_cog_m=(0.0, 0.0, 0.1), tcp_speed_limit_m_s=1.5, safety_planes=((1.0, 0.0, 0.0, 0.6),)
    )
    path.write_text(head + "payload_cog_m = [0.1]\ntcp_offset = [0.0]\nsafety_planes = [[1.0, 1.0, 0.0, 0.6]]\n")
    with pytest.raises(BadConfiguration, match=r"(?s)payload_cog_m.*tcp_offset.*safety_planes") as wrong:
        load(path, {})
    assert str(wrong.value).count("expected") == 3
    assert "allow_untested_software" in tomllib.loads((Path(__file__).parents[2] / "config/monitor.toml").read_text("utf-8"))["replay"]


def test_every_new_condition_is_one_that_check_prints():
    """A person who calls `check` sees each by its name."""
    names = {each.name for each in conditions(inputs(ready_state()))}
    assert names >= {"drive_gains", "tcp_speed", "safety_planes", "software", "payload_cog", "tcp_offset", "joints_running", "teach_button"}
