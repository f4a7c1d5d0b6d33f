"""A joint gain that contradicts the other joints is told, and gains that are wrong alike are told beside the published masses."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracle_arm import GROUND
from own_physics import UR5, productioned_arm, with_current

from monitor.config.files import find_excitation
from monitor.errors import BadInput
from monitor.identify.identify import identify
from monitor.model.robot import Mounting, load_robot
from monitor.simulate.arm.physics import drive_gain
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording

HEALTHY = productioned_arm()
COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # another UR10e's [N·m/A]
UNLOADED = ("ur-20_02_10-30sec_12harm.csv", "ur-20_02_12-50sec_12harm.csv", "ur-20_02_19_14harm50sec.csv")
LOADED = "ur-20_02_19_14harm50secLoad.csv"


def doubts(recording, robot=UR5, gains=None, mounting=GROUND, **options):
    """The texts of `gain_doubtful`."""
    found = identify([recording], robot, mounting, gains=gains, **options)
    return [warning.text for warning in found.warnings if warning.code == "gain_doubtful"]


def named(text):
    """The joints that a text names, with the factor of each."""
    return {int(joint): float(factor) for joint, factor in re.findall(r"joint (\d)(?:: current or torque)? is ([\d.]+) ±", text)}


@pytest.mark.parametrize("factor", [1.2, 1.0 / 1.2])
@pytest.mark.parametrize("joint", [1, 2])
def test_a_gain_of_a_joint_that_carries_the_arm_contradicts_the_other_joints(joint, factor):
    """Upper arm and forearm weigh on joints 2 and 3: the wrong one is named with its factor, perhaps beside the other one."""
    (text,) = doubts(with_current(HEALTHY, joint, lambda x: factor * x))
    assert named(text)[joint + 1] == pytest.approx(factor, abs=0.06), text


@pytest.mark.parametrize("factor", [1.4, 1.0 / 1.4])
def test_gains_that_are_all_wrong_alike_are_told_beside_the_published_masses(factor):
    """No joint contradicts another one then: the whole arm is too heavy, or too light."""
    (text,) = doubts(replace(HEALTHY, current=factor * HEALTHY.current))
    found = re.match(r"joints 2, 3(?:, 4)?: the arm's own links seem to weigh ([\d.]+) ±", text)
    assert found is not None, text
    assert float(found[1]) == pytest.approx(factor, rel=0.08)


@pytest.mark.parametrize("factor", [1.3, 1.0 / 1.3])
def test_a_gain_of_a_joint_that_carries_no_weight_blames_no_other_joint(factor):
    """Only inertia tells of joint 1 on the floor, which is not enough; the joints that weigh the arm still agree."""
    assert doubts(with_current(HEALTHY, 0, lambda x: factor * x)) == []


@pytest.mark.parametrize(
    ("model", "mounting", "payload_kg"),
    [
        ("ur5", "ground", 5.0),
        *(
            pytest.param(*arm, marks=pytest.mark.soak)
            for arm in (("ur3", "ground", 1.5), ("ur5e", "wall", 2.5), ("ur16e", "ground", 12.8), ("ur20", "wall", 0.0))
        ),
    ],
)
@pytest.mark.slow
def test_a_sound_simulated_arms_gains_are_not_doubted(model, mounting, payload_kg):
    """Of each size, with a payload up to the rated one that no identification is told of, on floor and wall; four are in the soak."""
    robot, where = load_robot(model), Mounting.parse(mounting)
    controller = Controller(SimulateSettings(robot=model, mounting=where, payload_kg=payload_kg, payload_com_m=(0.05, -0.04, 0.12)))
    recording = stepped_replay(controller, replace(find_excitation(f"{model}-ground", Path()), mounting=where))
    for options in ({}, {"method": "ls"}, {"method": "robust", "friction": "auto"}):
        assert doubts(recording, robot, drive_gain(robot), where, **options) == [], options


def further(*values):
    """Values that the soak tries."""
    return [pytest.param(value, marks=pytest.mark.soak) for value in values]


def read(real_data, name):
    """A recording of the real arm."""
    return read_recording(real_data / "ur10e" / name, COLUMNS)


@pytest.mark.parametrize(
    "options", [{"friction": "auto"}, *further({}, {"method": "robust", "friction": "auto"}, {"method": "consistent"})]
)
@pytest.mark.parametrize("name", [UNLOADED[0], LOADED, *further(*UNLOADED[1:])])
@pytest.mark.slow
def test_a_real_arms_gains_are_not_doubted_with_and_without_a_payload(real_data, name, options):
    """The gains are those of another arm, and the payload of the last recording is not declared.

    With a rich friction law joint 1, which weighs nothing, seems 24 % off at five standard deviations.
    """
    assert doubts(read(real_data, name), load_robot("ur10e"), GAINS, **options) == []


@pytest.mark.parametrize("name", [LOADED, *further(*UNLOADED)])
@pytest.mark.slow
def test_a_gain_that_is_a_fifth_too_large_is_told_of_a_real_arm(real_data, name):
    """Of joint 2 or 3 alone by the other joints, whatever the arm carries; of all joints by the published masses."""
    recording, robot = read(real_data, name), load_robot("ur10e")
    for joint in (1, 2):
        (text,) = doubts(recording, robot, GAINS * np.where(np.arange(6) == joint, 1.2, 1.0))
        assert named(text)[joint + 1] == pytest.approx(1.18, abs=0.03), text
    (text,) = doubts(recording, robot, 1.25 * GAINS)
    assert text.startswith("joints 2, 3: the arm's own links seem to weigh 1.3"), text


def test_gains_beside_torque_alone_are_refused():
    """Torque needs no gain, and what needs one is no torque: both are possible, and nobody but the reader knows which."""
    torque = replace(HEALTHY, torque=HEALTHY.current * UR5.drive_gain_nm_per_a, current=None)
    with pytest.raises(BadInput, match=r"worked: holds torque .* and no current, and --gains are torque per ampere; .* leave --gains out"):
        identify([torque], UR5, GROUND, gains=np.full(6, 1.25))
    assert identify([torque], UR5, GROUND).warnings == ()


@pytest.mark.parametrize("factor", [1.3, 1.0 / 1.3])
@pytest.mark.parametrize("joint", [1, 2])
def test_an_arm_whose_angles_were_rounded_tells_of_a_gain(joint, factor):
    """As the exact arm does: neither parameters that no motion shows nor a check that goes off."""
    rounded = replace(UR5, alpha_rad=np.round(UR5.alpha_rad, 4))
    found = identify([with_current(HEALTHY, joint, lambda x: factor * x)], rounded, GROUND)
    (text,) = [warning.text for warning in found.warnings if warning.code == "gain_doubtful"]
    assert named(text)[joint + 1] == pytest.approx(factor, abs=0.1)
    assert found.condition_number < 1000.0
