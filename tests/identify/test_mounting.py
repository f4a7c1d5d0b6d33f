"""Gravity's direction, found in the data."""

import re
from dataclasses import replace

import numpy as np
import pytest
from oracle_arm import exact_motion, excitation, recording, truth

from monitor.identify.mounting import mounting_check, upward
from monitor.identify.signals.arm import joint_torque
from monitor.identify.signals.motion import motion
from monitor.model.robot import Mounting, load_robot
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording

COLUMNS = "timestamp,actual_q:6,actual_qd:6,actual_current:6,target_current:6,target_moment:6"
GAINS = np.array([14.87, 13.26, 11.13, 10.62, 11.03, 11.47])  # of that arm's authors [N·m/A]
UR5 = load_robot("ur5")


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def up_of(mounting):
    return Mounting.parse(mounting).rotation.T @ [0.0, 0.0, 1.0]


@pytest.mark.parametrize("mounting", ["ground", "ceiling", "wall", "0,-90,0", "0.5,0,0", "137,-61,20"])
def test_without_noise_up_is_found_to_a_thousandth_of_a_degree(mounting):
    """Torque by pinocchio; the search ends where steps are 1e-6 rad, and no start decides where."""
    known = truth(UR5, Mounting.parse(mounting))
    for configured in ("ground", "wall"):
        found = upward([exact_motion(known)], [known.torque], UR5, Mounting.parse(configured))
        assert degrees_between(found.up, up_of(mounting)) < 1e-3
        assert found.sign_by == "inertia"
        assert found.mounting.gravity_in_base == pytest.approx(Mounting.parse(mounting).gravity_in_base, abs=1e-3)


@pytest.fixture(scope="module", params=["wall", *(pytest.param(name, marks=pytest.mark.soak) for name in ("ground", "ceiling"))])
def replayed(request):
    """A stepped replay of the simulator, whose friction follows laws that no identification assumes."""
    mounting = Mounting.parse(request.param)
    controller = Controller(SimulateSettings(robot="ur5", mounting=mounting))
    played = stepped_replay(controller, replace(excitation(UR5, repetitions=2), mounting=mounting))
    moved = motion(played)
    return request.param, moved, joint_torque(moved, UR5)


@pytest.mark.parametrize("configured", ["ground", "ceiling", "wall"])
@pytest.mark.slow
def test_a_simulated_arm_contradicts_every_wrong_mounting_and_no_right_one(replayed, configured):
    """All nine pairs: the warning comes for the six wrong ones, with the right name and the angle to 3°.

    This motion is half as fast as a designed one, and its friction follows laws that the fit does not know."""
    real, moved, torque = replayed
    warning = mounting_check([moved], [torque], UR5, Mounting.parse(configured))
    if configured == real:
        assert warning is None
        return
    assert warning.code == "mounting_contradiction"
    angle_deg = float(re.search(r"is (\d+) ±", warning.text)[1])
    assert abs(angle_deg - (180.0 if {configured, real} == {"ground", "ceiling"} else 90.0)) <= 3.0
    assert f"the mounting {configured} puts it" in warning.text
    assert f"likely is {real} " in warning.text
    assert "yaw) never shows" in warning.text


@pytest.mark.slow
def test_yaw_never_matters(replayed):
    """A base turned about the vertical feels the same gravity: no warning for any yaw of the right mounting."""
    real, moved, torque = replayed
    for yaw in (-90.0, 45.0, 180.0):
        turned = replace(Mounting.parse(real), yaw_rad=np.radians(yaw))
        assert mounting_check([moved], [torque], UR5, turned) is None


def test_a_tilt_is_reported_where_it_is_larger_than_that_of_floors():
    """With a real arm's noise: 1° passes, and 4° is reported with its size."""
    known = truth(UR5, Mounting.parse("4,0,0"))
    moved = motion(recording(known))
    torque = joint_torque(moved, UR5)
    assert mounting_check([moved], [torque], UR5, Mounting.parse("3,0,0")) is None
    warning = mounting_check([moved], [torque], UR5, Mounting())
    assert "is 4 ±" in warning.text
    assert "roll 4°, pitch 0°" in warning.text


def test_in_slow_motion_the_masses_give_the_sign_and_the_warning_states_it():
    """At a tenth of the speed inertia is below the noise, so negative weights under a ceiling explain the data of an arm on the ground."""
    known = truth(UR5, Mounting.parse("ceiling"), speed_rad_s=0.15)
    torque = known.torque + 1.5 * np.random.default_rng(0).normal(size=known.torque.shape)
    warning = mounting_check([exact_motion(known)], [torque], UR5, Mounting())
    assert "likely is ceiling" in warning.text
    assert "up is told from down by the manufacturer's masses" in warning.text
    assert mounting_check([exact_motion(known)], [torque], UR5, Mounting.parse("ceiling")) is None


def test_without_published_masses_an_open_sign_is_no_contradiction():
    """The data do not determine the sign: a ceiling does not contradict a ground, and a wall is reported with the sign left open."""
    unknown = replace(UR5, mass_kg=np.full(6, np.nan))
    known = truth(UR5, Mounting.parse("ceiling"), speed_rad_s=0.15)
    torque = known.torque + 1.5 * np.random.default_rng(0).normal(size=known.torque.shape)
    assert mounting_check([exact_motion(known)], [torque], unknown, Mounting()) is None
    warning = mounting_check([exact_motion(known)], [torque], unknown, Mounting.parse("wall"))
    assert "up and down stay open" in warning.text


def test_data_without_weight_contradict_no_mounting():
    """Noise alone: every direction explains it as well, so there is no warning."""
    known = truth(UR5, speed_rad_s=0.3)
    torque = np.random.default_rng(1).normal(size=known.torque.shape)
    assert mounting_check([exact_motion(known)], [torque], UR5, Mounting.parse("wall")) is None


def test_too_few_samples_give_no_warning():
    """Fewer rows than unknowns, or none: no error, no warning."""
    assert mounting_check([], [], UR5, Mounting()) is None
    known = truth(UR5)
    short = replace(exact_motion(known), **{name: getattr(known, name)[:80] for name in ("t_s", "q", "qd", "qdd")})
    short = replace(short, direction=short.direction[:80])
    assert mounting_check([short], [known.torque[:80]], UR5, Mounting.parse("wall")) is None


@pytest.mark.parametrize(
    "name",
    [
        "19_14harm50secLoad",
        *(pytest.param(name, marks=pytest.mark.soak) for name in ("12-50sec_12harm", "10-30sec_12harm", "19_14harm50sec")),
    ],
)
@pytest.mark.slow
def test_the_real_ur10e_stands_on_the_ground(real_data, name):
    """Four recordings, one with a payload: up within half a degree of the base's z, and a wall or a ceiling is contradicted."""
    name = f"ur-20_02_{name}.csv"
    robot = load_robot("ur10e")
    moved = motion(read_recording(real_data / "ur10e" / name, COLUMNS))
    torque = joint_torque(moved, robot, GAINS)
    found = upward([moved], [torque], robot, Mounting())
    print(name, "up", np.round(found.up, 4), f"{np.degrees(found.angle_rad):.2f} ± {np.degrees(found.std_rad):.2f}°", found.sign_by)
    assert np.degrees(found.angle_rad) < 0.5
    assert found.sign_by == "inertia"
    assert mounting_check([moved], [torque], robot, Mounting()) is None
    for wrong in ("wall", "ceiling"):
        assert "likely is ground " in mounting_check([moved], [torque], robot, Mounting.parse(wrong)).text
