"""Stepped replays are deterministic, true to the laws of the simulator, and refused where they do not fit the arm."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim_pendant import CONTROL
from sim_process import excitation

from monitor.errors import BadInput, ReplayAborted
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import Mounting
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay

EXCITATIONS = Path(__file__).parents[2] / "config" / "excitation"


@pytest.fixture(scope="module")
def played():
    """A controller and what it recorded."""
    controller = Controller(SimulateSettings(seed=5))
    return controller, stepped_replay(controller, excitation(), software="test")


def test_equal_seeds_give_equal_recordings_bit_for_bit(played):
    """All signals are equal. Another seed gives other noise."""
    again = stepped_replay(Controller(SimulateSettings(seed=5)), excitation())
    other = stepped_replay(Controller(SimulateSettings(seed=6)), excitation())
    for name, signal in played[1].signals.items():
        assert np.array_equal(signal, again.signals[name]), name
    assert not np.array_equal(again.current, other.current)
    assert np.array_equal(again.target_q, other.target_q)


def test_a_recording_has_a_row_every_8_ms(played):
    """This holds on both generations, although the control period of the e-Series is 2 ms."""
    series_e = stepped_replay(Controller(SimulateSettings(robot="ur5e")), excitation("ur5e"))
    for recording in (played[1], series_e):
        assert recording.samples == 501
        assert np.allclose(np.diff(recording.t_s), 0.008, atol=1e-9)
        assert recording.context.trajectory_digest == excitation(recording.context.robot).digest


def test_the_arm_follows_the_excitation(played):
    """The targets are within 8 mrad of the excitation, and the joints within 2.5 mrad of the targets."""
    path = excitation().sampled(125.0)[1]
    recording = played[1]
    assert np.abs(recording.target_q[:-1] - path.q[1:]).max() < 8e-3
    assert np.abs(recording.q - recording.target_q).max() < 2.5e-3


def test_currents_are_the_drive_torque_and_noise(played):
    """Currents are the drive torque of the laws at the recorded states over Kt·G, plus the noise of the sensors."""
    controller, recording = played
    arm = controller.arm
    qdd = np.gradient(recording.qd, 0.008, axis=0)
    rigid, load = arm.rigid_torque(recording.q, recording.qd, qdd)
    expected = (rigid + arm.friction_torque(recording.qd, load)) / arm.gain_nm_per_a
    error = recording.current - expected
    moving = np.abs(recording.qd) > 0.1
    for joint in range(6):
        spread = np.std(error[moving[:, joint], joint])
        assert 0.01 < spread < (0.2 if joint < 3 else 0.1)  # noise of 0.03–0.09 and 0.01–0.03 A, and q̈ by differences of noisy q̇
        assert abs(np.mean(error[moving[:, joint], joint])) < 0.03


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_acceleration_and_torque_are_of_the_moment_they_are_recorded(robot):
    """q̈ is the slope of q̇, at most 3 ms late, and the drive torque at most 7 ms late, for both control periods.

    A torque that is 20 ms late would look like 4 % more friction at full speed.
    """
    document = json.loads((EXCITATIONS / f"{robot}-ground.json").read_text("utf-8"))
    controller = Controller(SimulateSettings(robot=robot, current_noise=0.0))
    recording = stepped_replay(controller, replace(excitation_from_document(document), repetitions=1))
    arm, q, qd = controller.arm, recording.target_q, recording.target_qd
    qdd = np.gradient(qd, 0.008, axis=0)
    jerk, still = np.gradient(qdd, 0.008, axis=0), np.zeros_like(qd)
    rigid, load = arm.rigid_torque(q, qd, qdd)
    missing_nm = rigid + arm.friction_torque(qd, load) - recording.current * arm.gain_nm_per_a
    per_s = arm.rigid_torque(q, still, jerk)[0] - arm.rigid_torque(q, still, still)[0]  # by which a late torque is short

    def late_s(short, change, joint, slowest):
        at = np.flatnonzero(np.abs(qd[:, joint]) >= slowest)
        at = at[(at > 25) & (at < len(qd) - 25)]  # the stream begins and ends with a jump of the jerk
        return np.dot(short[at, joint], change[at, joint]) / np.dot(change[at, joint], change[at, joint])

    for joint in range(6):
        assert abs(late_s(qdd - recording.target_qdd, jerk, joint, 0.0)) < 0.003
        assert abs(late_s(missing_nm, per_s, joint, 0.4)) < 0.007  # slower, the servo is still catching up with a reversal


def test_temperatures_come_in_sixteenths(played):
    """The temperature rises in a replay."""
    temperature = played[1].temperature_c
    assert np.array_equal(temperature * 16, np.rint(temperature * 16))
    assert np.mean(temperature[-50:]) >= np.mean(temperature[:50])


def test_the_second_replay_needs_no_approach():
    """It begins where the first one ended."""
    controller = Controller(SimulateSettings())
    first = stepped_replay(controller, excitation())
    second = stepped_replay(controller, excitation())
    assert second.t_s[0] - first.t_s[-1] < 0.01 + 1e-9


def test_what_does_not_fit_is_refused():
    """Another robot, another mounting, a joint beyond its limit and a running program are errors."""
    controller = Controller(SimulateSettings())
    with pytest.raises(BadInput, match="ur3"):
        stepped_replay(controller, excitation("ur3"))
    with pytest.raises(BadInput, match="mounting"):
        stepped_replay(controller, replace(excitation(), mounting=Mounting.parse("wall")))
    with pytest.raises(BadInput, match="joint 3"):
        stepped_replay(controller, replace(excitation(), offset_rad=np.array([0, -1.57, 3.1, -1.57, 0, 0])))
    controller.run_script(CONTROL.rstrip())
    with pytest.raises(BadInput, match="a program is running"):
        stepped_replay(controller, excitation())


def test_a_replay_that_the_controller_stops_is_aborted():
    """The drive cannot turn a joint: the error gives the reason, and the arm is free for the next program."""
    controller = Controller(SimulateSettings())
    stepped_replay(controller, excitation())
    controller.arm.set_wear(4, coulomb=40.0)
    with pytest.raises(ReplayAborted, match="protective_stop"):
        stepped_replay(controller, excitation())
    assert controller.programs.current is None
