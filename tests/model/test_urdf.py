"""Arms from URDF, and back."""

import math
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.errors import BadInput
from monitor.model.base import base_parameters
from monitor.model.regressor import regressor
from monitor.model.robot import Mounting, load_robot, robot_names
from monitor.model.urdf import robot_from_urdf_text, urdf_text
from monitor.store.identify_files import robot_from_urdf

INERTIAL = '<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/><inertia {tensor}/></inertial>'


def spelled(values):
    return " ".join(repr(float(v)) for v in values)


def link(name, rng):
    """A link with a physical inertia: that of some point masses."""
    points, masses = rng.normal(size=(6, 3)) * 0.1, rng.uniform(0.1, 1.0, 6)
    J = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points - masses @ points / masses.sum(), strict=True))
    keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    tensor = " ".join(f'{key}="{J[at]!r}"' for key, at in keys.items())
    tensor = re.sub(r"np\.float64\((.*?)\)", r"\1", tensor)
    return f'<link name="{name}">' + INERTIAL.format(
        xyz=spelled(rng.normal(size=3) * 0.2), rpy=spelled(rng.uniform(-3, 3, 3)), mass=repr(float(masses.sum())), tensor=tensor
    ) + "</link>"  # fmt: skip


def joint(name, parent, child, xyz, rpy, axis, kind="revolute", limit='<limit lower="-3" upper="2.5" effort="10" velocity="2"/>'):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{spelled(xyz)}" rpy="{spelled(rpy)}"/><axis xyz="{spelled(axis)}"/>{limit}</joint>'
    )


# how an axis lies to the one before: the cases that DH tables treat apart, and the one they treat badly
RELATIONS = ["skew", "parallel", "antiparallel", "crossing", "perpendicular", "coincident", "nearly parallel", "barely parallel"]


def arm(relations, seed, first_upright=True):
    """A URDF of a random serial arm, with fixed links at random places, as text."""
    rng = np.random.default_rng(seed)
    parts = [link("base", rng)]
    parent = "base"
    for i, relation in enumerate(relations):
        xyz, rpy, axis = rng.uniform(-0.5, 0.5, 3), np.zeros(3), np.array([0.0, 0.0, 1.0])
        tilt = {"crossing": 0.7, "perpendicular": math.pi / 2, "antiparallel": math.pi, "nearly parallel": 1e-5, "barely parallel": 2e-9}
        if i == 0 and not first_upright:
            rpy = rng.uniform(-3, 3, 3)
        elif i and relation == "skew":
            rpy, axis = rng.uniform(-3, 3, 3), rng.normal(size=3)
            axis /= np.linalg.norm(axis)
        elif i and relation in tilt:
            rpy = np.array([tilt[relation], 0.0, 0.0])
            if relation == "crossing":
                xyz = np.array([0.0, 0.0, xyz[2]])
        elif i and relation == "coincident":
            xyz = np.array([0.0, 0.0, xyz[2]])
        if relation == "skew":
            axis = 2.0 * axis  # a URDF's axis need not be of unit length
        # skew axes are given along another axis than z, so the next relation refers to the frame, not to this axis
        parts += [link(f"link{i}", rng), joint(f"joint{i}", parent, f"link{i}", xyz, rpy, axis)]
        parent = f"link{i}"
        if rng.random() < 0.4:
            shift, turn = rng.normal(size=(2, 3)) * 0.1
            parts += [link(f"tool{i}", rng), joint(f"screw{i}", parent, f"tool{i}", shift, turn, axis, "fixed", "")]
            if relation == "skew" and rng.random() < 0.5:
                parent = f"tool{i}"
    return f'<robot name="random">{"".join(parts)}</robot>'


@given(
    relations=st.lists(st.sampled_from(RELATIONS), min_size=1, max_size=8),
    seed=st.integers(0, 10**6),
    upright=st.booleans(),
    mounting=st.sampled_from(["ground", "ceiling", "wall", "10,20,30"]),
)
@pytest.mark.slow
def test_torque_of_any_serial_arm_equals_that_of_pinocchio(relations, seed, upright, mounting):
    """Y·p and our own pinocchio model against pinocchio's reading of the URDF, to 1e-10 of the largest torque, which is 10² N·m."""
    text = arm(relations, seed, upright)
    attitude = Mounting.parse(mounting)
    robot = robot_from_urdf_text(text)
    J = robot.joints
    assert len(relations) == J
    model = pin.buildModelFromXML(text)
    model.gravity = pin.Motion(np.concatenate([attitude.gravity_in_base, np.zeros(3)]))
    data = model.createData()
    q, qd, qdd = np.random.default_rng(seed).uniform(-3.0, 3.0, (3, 5, J))
    expected = np.array([pin.rnea(model, data, *state).copy() for state in zip(q, qd, qdd, strict=True)])
    size = max(1.0, float(np.max(np.abs(expected))))
    torque = regressor(robot, attitude, q, qd, qdd) @ robot.nominal_parameters(with_inertia=True)
    assert np.max(np.abs(torque - expected)) < 1e-10 * size
    own = robot.pinocchio_model(attitude)
    ours = np.array([pin.rnea(own, own.createData(), *state).copy() for state in zip(q, qd, qdd, strict=True)])
    assert np.max(np.abs(ours - expected)) < 1e-10 * size
    again = robot_from_urdf_text(urdf_text(robot))
    torque = regressor(again, attitude, q, qd, qdd) @ again.nominal_parameters(with_inertia=True)
    assert np.max(np.abs(torque - expected)) < 1e-10 * size


@pytest.mark.parametrize("name", robot_names())
def test_a_published_arm_is_the_same_when_read_from_its_urdf(name):
    """Out and in again: the same count of base parameters and the same torques, to 1e-10 of the largest."""
    robot = load_robot(name)
    again = robot_from_urdf_text(urdf_text(robot))
    np.testing.assert_allclose(again.mass_kg, robot.mass_kg)
    np.testing.assert_allclose(again.max_position_rad, robot.max_position_rad)
    np.testing.assert_allclose(again.max_speed_rad_s, robot.max_speed_rad_s)
    np.testing.assert_allclose(again.max_torque_nm, robot.max_torque_nm)
    assert np.all(again.y_m == 0.0)
    for text in ("ground", "wall"):
        mounting = Mounting.parse(text)
        assert base_parameters(again, mounting).count == base_parameters(robot, mounting).count
        q, qd, qdd = np.random.default_rng(0).uniform(-3.0, 3.0, (3, 20, 6))
        expected = regressor(robot, mounting, q, qd, qdd) @ robot.nominal_parameters(with_inertia=True)
        torque = regressor(again, mounting, q, qd, qdd) @ again.nominal_parameters(with_inertia=True)
        assert np.max(np.abs(torque - expected)) < 1e-10 * np.max(np.abs(expected))


def two(middle="", kind="revolute", limit='<limit lower="-3" upper="2.5" effort="10" velocity="2"/>', extra=""):
    rng = np.random.default_rng(0)
    joints = joint("a", "base", "one", [0, 0, 0.1], [0, 0, 0], [0, 0, 1]) + joint(
        "b", "one", "two", [0.3, 0, 0], [0, 0, 0], [0, 1, 0], kind, limit
    )
    return f'<robot name="two"><link name="base"/>{link("one", rng)}{link("two", rng)}{joints}{extra}{middle}</robot>'


def test_limits_that_are_missing_are_infinite():
    """A continuous joint without <limit>, and one with: sizes of both ends, the larger counts."""
    robot = robot_from_urdf_text(two(kind="continuous", limit=""))
    np.testing.assert_array_equal(robot.max_position_rad, [3.0, math.inf])
    np.testing.assert_array_equal(robot.max_speed_rad_s, [2.0, math.inf])
    np.testing.assert_array_equal(robot.max_torque_nm, [10.0, math.inf])
    assert np.all(np.isnan(robot.drive_gain_nm_per_a))
    back = robot_from_urdf_text(urdf_text(robot))
    np.testing.assert_array_equal(back.max_torque_nm, robot.max_torque_nm)
    np.testing.assert_array_equal(back.max_position_rad, robot.max_position_rad)


def test_a_link_without_inertia_has_no_mass():
    """As pinocchio has it."""
    text = two().replace('<link name="base"/>', '<link name="base"/><link name="tip"/>')
    text = text.replace("</robot>", joint("tip_joint", "two", "tip", [0, 0, 1], [0, 0, 0], [0, 0, 1], "fixed", "") + "</robot>")
    np.testing.assert_array_equal(robot_from_urdf_text(text).mass_kg, robot_from_urdf_text(two()).mass_kg)


NINE = f'<robot name="r">{"".join(f"<link name={chr(34)}l{i}{chr(34)}/>" for i in range(10))}' + "".join(
    joint(f"j{i}", f"l{i}", f"l{i + 1}", [0.1, 0, 0], [0, 0, 0], [0, 0, 1]) for i in range(9)
) + "</robot>"  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot name='x'><link", "not well-formed XML"),
        ("<mujoco/>", "outermost element is <mujoco>"),
        ("<!DOCTYPE lolz [<!ENTITY lol 'lol'>]><robot name='x'/>", "document type"),
        ("<robot name='x'/>", "0 links are nobody's child"),
        ("<robot name='x'><link name='a'/></robot>", "has 0 revolute or continuous joints"),
        ("<robot name='x'><link/></robot>", "a <link> has no name"),
        (two(kind="prismatic"), "joint 'b' is prismatic"),
        (two(kind="floating"), "joint 'b' is floating"),
        (two(extra='<link name="c"/>' + joint("c", "one", "c", [0, 0, 0], [0, 0, 0], [1, 0, 0])), "branches into joints 'b', 'c'"),
        (two(extra='<link name="lost"/>'), "2 links are nobody's child"),
        (two(extra=joint("c", "base", "two", [0, 0, 0], [0, 0, 0], [1, 0, 0])), "'two' hangs on two joints"),
        (two(extra=joint("c", "two", "nowhere", [0, 0, 0], [0, 0, 0], [1, 0, 0])), "child link 'nowhere' does not exist"),
        (two(limit='<mimic joint="a"/>'), "joint 'b' mimics another"),
        (two(limit='<limit effort="strong" velocity="2"/>'), "limit effort is 'strong'"),
        (two().replace('xyz="0.0 1.0 0.0"', 'xyz="0 0 0"'), "its axis is zero"),
        (two().replace('xyz="0.0 1.0 0.0"', 'xyz="0 1"'), "xyz = '0 1'; expected 3 finite numbers"),
        (re.sub(r'mass value="[^"]*"', 'mass value="-1"', two()), "its mass is -1 kg"),
        (NINE, "has 9 revolute or continuous joints in a row; expected 1 to 8"),
    ],
)
def test_what_is_not_one_serial_arm_is_refused_with_its_reason(text, message):
    """Each message names the fault."""
    with pytest.raises(BadInput, match=re.escape(message)):
        robot_from_urdf_text(text)


def test_a_file_is_read_and_a_missing_one_named(tmp_path):
    """The same arm from disk."""
    path = tmp_path / "two.urdf"
    path.write_text(two())
    assert robot_from_urdf(path).joints == 2
    with pytest.raises(BadInput, match=r"none\.urdf: no such file"):
        robot_from_urdf(tmp_path / "none.urdf")
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="cannot be read"):
        robot_from_urdf(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<robot name="r"><link name="a"/><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
            '<child link="b"/><axis xyz="0 0 1"/></joint></robot>',
            "link 'a' stands there twice",
        ),
        (
            '<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>'
            '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>'
            '<joint name="k" type="revolute"><parent link="c"/><child link="d"/></joint>'
            '<joint name="l" type="revolute"><parent link="d"/><child link="c"/></joint></robot>',
            "does not lead to c, d",
        ),
        (
            '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx="-1" iyy="1" izz="1"/>'
            "</inertial></link>"
            '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>',
            "negative principal moment",
        ),
        (
            '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
            '<axis xyz="0 0 1e200"/></joint></robot>',
            "expected 3 finite numbers up to",
        ),
    ],
    ids=["twice", "ring", "inertia", "axis"],
)
def test_faulty_files_by_an_independent_tester_are_refused(text, message):
    """The message names the fault. Without the check it would be ignored, or cause a crash later."""
    with pytest.raises(BadInput, match=message):
        robot_from_urdf_text(text)
