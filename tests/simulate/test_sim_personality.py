"""What an arm publishes beside its motion: ideal values, and values as recorded from real arms."""

import math

import numpy as np
import pytest
from sim_pendant import Pendant
from sim_process import excitation

from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.simulate.wire.variables import output_variables

QUIET = ("actual_joint_voltage", "actual_main_voltage", "actual_TCP_force", "actual_tool_accelerometer", "actual_execution_time")


def controller(robot: str = "ur5", **settings) -> Controller:
    made = Controller(SimulateSettings(robot=robot, personality="recorded", **settings))
    made.step()
    return made


def read(made: Controller, name: str) -> np.ndarray:
    return np.array(output_variables(made)[name].read())


def mean(made: Controller, name: str, ticks: int = 400) -> np.ndarray:
    variable, rows = output_variables(made)[name], []
    for _ in range(ticks):
        made.step()
        rows.append(variable.read())
    return np.mean(rows, axis=0)


@pytest.mark.parametrize("robot", ["ur5", "ur3e"])
def test_speed_scaling_is_zero_while_no_program_plays_and_for_up_to_20_ms_after_a_start(robot):
    """The slider's own position stays at 100 %. The time after a start is drawn anew for each program, within 4–20 ms."""
    waits = set()
    pendant = Pendant(robot=robot, personality="recorded")
    c = pendant.controller
    for _ in range(20):
        since = c.clock.now_s
        while read(c, "speed_scaling")[0] == 0.0:
            c.step()
        waits.add(round(c.clock.now_s - since, 6))
        assert read(c, "speed_scaling")[0] == read(c, "target_speed_fraction")[0] == 1.0
        c.stop_program("the test")
        c.step()
        assert read(c, "speed_scaling")[0] == 0.0
        assert read(c, "target_speed_fraction")[0] == 1.0
        c.run_script("movej([0,-1.5,0,-1.5,0,0])")
    assert len(waits) > 1
    assert min(waits) >= 0.004 - 1e-9
    assert max(waits) <= 0.020 + c.clock.tick_s


def test_with_ideal_values_speed_scaling_is_zero_until_a_program_plays_and_full_from_then_on():
    """In all recordings, of CB3, e-Series and the manufacturer's simulator, it is 0 while no program plays."""
    pendant = Pendant()
    pendant.controller.stop_program("the test")
    assert read(pendant.controller, "speed_scaling")[0] == 0.0
    pendant.controller.run_script("movej([0,-1.5,0,-1.5,0,0])")
    assert read(pendant.controller, "speed_scaling")[0] == 1.0
    pendant.controller.inject("protective_stop", {"runtime": "paused"})
    assert read(pendant.controller, "speed_scaling")[0] == 0.0


def test_an_arm_as_recorded_stands_as_the_recorded_ones_did():
    """The accelerometer is 9.28 m/s² long, the voltages are 47.3–47.8 V, the tool feels half a newton, the joints pull against friction."""
    made = controller()
    gravity = mean(made, "actual_tool_accelerometer")
    assert np.linalg.norm(gravity) == pytest.approx(9.28, abs=0.02)
    off = math.acos(-gravity[1] / np.linalg.norm(gravity))  # the home pose is that of the recording: −y is up at the flange
    assert 0.3 < math.degrees(off) < 1.5
    assert mean(made, "actual_joint_voltage") == pytest.approx([47.62, 47.64, 47.57, 47.51, 47.62, 47.33], abs=0.01)
    assert mean(made, "actual_main_voltage")[0] == pytest.approx(47.73, abs=0.01)
    assert mean(made, "actual_robot_current")[0] == pytest.approx(0.55, abs=0.1)
    assert np.linalg.norm(mean(made, "actual_TCP_force")[:3]) == pytest.approx(0.53, abs=0.1)
    held = mean(made, "actual_current") - mean(made, "target_current")
    assert held == pytest.approx([-0.15, -0.17, -0.17, -0.05, 0.0, -0.04], abs=0.05)
    assert np.array_equal(made.arm.qd, np.zeros(6))
    assert read(made, "joint_mode").tolist() == [253] * 6
    assert read(made, "robot_status_bits").tolist() == [1]
    assert read(made, "safety_status_bits").tolist() == [1]
    temperatures = read(made, "joint_temperatures") * 16.0
    assert np.array_equal(temperatures, np.rint(temperatures))


def test_target_current_as_recorded_contains_friction_and_target_moment_does_not():
    """In motion the two differ by 0.04–0.06 of the maximum torque and more; at rest they agree by the gain."""
    made = controller("ur5e")
    assert read(made, "target_current") * made.arm.gain_nm_per_a == pytest.approx(read(made, "target_moment"))
    recording = stepped_replay(made, excitation("ur5e"))
    friction = recording.target_current * made.arm.gain_nm_per_a - recording.target_moment
    fast = np.abs(recording.target_qd) > 0.05
    assert np.all(np.sign(friction[fast]) == np.sign(recording.target_qd[fast]))
    share = np.abs(friction / made.robot.max_torque_nm)[fast]
    assert 0.05 < share.min() < share.max() < 0.3


def test_the_motion_is_the_same_with_both_personalities():
    """The personality changes what is published beside the motion, and neither positions nor measured currents of the arm in motion."""
    ideal, recorded = (stepped_replay(Controller(SimulateSettings(personality=name)), excitation()) for name in ("ideal", "recorded"))
    assert recorded.q == pytest.approx(ideal.q, abs=2e-4)
    later = slice(ideal.samples // 2, None)
    assert np.abs(recorded.current - ideal.current)[later].max() < 0.1


def test_an_equal_seed_gives_equal_values():
    """The values as recorded have noise of their own, drawn from the seed."""
    first, second, other = ([read(controller(seed=seed), name) for name in QUIET] for seed in (1, 1, 2))
    for name, one, same, another in zip(QUIET, first, second, other, strict=True):
        assert np.array_equal(one, same), name
        assert not np.array_equal(one, another), name


@pytest.mark.parametrize("robot", ["ur3", "ur3e"])
def test_the_last_joint_of_a_small_arm_may_stand_two_turns_on(robot):
    """A recording of a UR3e has wrist 3 at +4π. Wrist 3 of a UR5 ends at ±2π."""
    home = (0.0, -1.6, -1.8, 3.3, -2.6, 12.6)
    made = controller(robot, home_rad=home)
    for _ in range(100):
        made.step()
    assert made.modes.safety == 1
    assert read(made, "actual_q")[5] == pytest.approx(12.6, abs=1e-3)
    assert read(made, "target_q")[5] == 12.6
    made = controller("ur5", home_rad=home)
    assert made.modes.safety == 3


def test_another_personality_is_refused_with_the_known_ones():
    """The message names the value and what is expected."""
    with pytest.raises(BadInput, match="personality = 'grumpy'; expected one of ideal, recorded"):
        SimulateSettings(personality="grumpy")
