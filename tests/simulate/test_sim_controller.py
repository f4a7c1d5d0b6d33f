"""Programs of a controller without sockets: the register machine, the watchdog, moves and queries."""

import math

import numpy as np
import pytest
from sim_pendant import COMMAND, CONTROL, DOUBLES, FOUR, FOURTEEN, MOVE, ONE, SERVO, SIX, SPEED, Pendant

from monitor.simulate.arm.physics import Contact
from monitor.simulate.commands import truth
from monitor.simulate.machine.registers import INPUT_TYPES, recipe
from monitor.simulate.machine.state import Runtime, SafetyMode
from monitor.simulate.wire.variables import output_variables


@pytest.fixture
def pendant() -> Pendant:
    return Pendant()


def test_an_uploaded_script_plays_and_is_ready(pendant):
    """The program state is 2 and output integer 0 is 1."""
    pendant.run(0.02)
    assert pendant.controller.modes.runtime == Runtime.PLAYING
    assert pendant.controller.registers.output_ints[0] == 1


def test_a_blocking_move_is_done_when_the_arm_is_there(pendant):
    """During moveJ output integer 0 is 1; at the goal it becomes 2."""
    goal = pendant.controller.reference.q + np.array([0.2, -0.1, 0.1, 0, 0, 0.3])
    pendant.controller.write_inputs(MOVE, [1, *goal, 1.0, 1.0, 0])
    pendant.run(0.3)
    assert pendant.controller.registers.output_ints[0] == 1
    pendant.run(1.5)
    assert pendant.controller.registers.output_ints[0] == 2
    assert np.allclose(pendant.controller.arm.q, goal, atol=2e-3)  # the servo's error at rest


def test_an_asynchronous_move_is_done_at_once_and_reports_its_progress(pendant):
    """Bit 15 of output integer 2 is set while the move runs and clear at its end."""
    goal = pendant.controller.reference.q + 0.1
    pendant.do(MOVE, [1, *goal, 1.0, 1.0, 1])
    assert pendant.controller.clock.now_s < 0.1
    assert pendant.controller.registers.output_ints[2] & 0x8000
    pendant.run(1.5)
    assert not pendant.controller.registers.output_ints[2] & 0x8000
    assert np.allclose(pendant.controller.arm.q, goal, atol=2e-3)


def test_an_edge_command_is_processed_once(pendant):
    """While the command register keeps its value, the command is not executed again: the watchdog keeps its limit."""
    pendant.controller.write_inputs(ONE, [35, 10.0])
    pendant.controller.step()
    armed_at = truth(pendant.controller)["watchdog_s"]
    pendant.controller.registers.inputs.doubles[0] = 1.0
    pendant.controller.step()
    assert truth(pendant.controller)["watchdog_s"] == armed_at == 0.1


def test_servoj_latches_and_servostop_ends_it(pendant):
    """After a second without packets and without a watchdog, servoj still holds the last target. servoStop ends it with a linear stop."""
    pendant.stream(0.5)
    pendant.run(1.0)
    assert pendant.controller.reference.mode == "servo"
    assert pendant.controller.modes.runtime == Runtime.PLAYING
    assert pendant.do(ONE, [16, 10.0]) >= 0
    assert pendant.standing


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_the_watchdog_stops_a_program_whose_client_has_died(robot):
    """A watchdog of 10 Hz ends the program 0.1 s after the last packet. An arm at 1 rad/s stands within 0.3 s."""
    pendant = Pendant(robot=robot)
    pendant.do(ONE, [35, 10.0])
    pendant.stream(1.0)
    last = pendant.controller.clock.now_s
    pendant.run(0.5)
    stop = pendant.controller.journal.stops[-1]
    assert stop.kind == "watchdog"
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert stop.at_s - last == pytest.approx(0.1, abs=2 * 0.008 + 1e-6)
    assert stop.stood_at_s is not None
    assert stop.stood_at_s - last < 0.3
    assert pendant.controller.journal.watchdog_trips == 1


def test_a_blocking_move_does_not_feed_the_watchdog(pendant):
    """A watchdog of 10 Hz stops moveJ after 0.1 s, as on the wire of a real controller."""
    pendant.do(ONE, [35, 10.0])
    assert pendant.do(MOVE, [1, *(pendant.controller.reference.q + 0.5), 1.0, 1.0, 0]) == -1
    assert pendant.controller.journal.stops[-1].kind == "watchdog"
    assert pendant.controller.clock.now_s < 0.3


def test_the_watchdog_ends_with_the_program(pendant):
    """A new program has no watchdog until it asks for one."""
    pendant.do(ONE, [35, 10.0])
    pendant.run(0.3)
    pendant.controller.run_script(CONTROL.rstrip())
    pendant.run(1.0)
    assert pendant.controller.modes.runtime == Runtime.PLAYING


def test_queries_and_settings(pendant):
    """isSteady, isJointsWithinSafetyLimits and setPayload return what they should. A declared payload does not change the arm."""
    assert pendant.do(COMMAND, [47]) == 1
    assert pendant.do(SIX, [37, 0, 0, 0, 0, 0, 0]) == 1
    assert pendant.do(SIX, [37, 0, 0, 3.5, 0, 0, 0]) == 0  # the elbow turns ±π
    assert pendant.do(FOUR, [17, 1.5, 0, 0, 0.1]) >= 0
    assert output_variables(pendant.controller)["payload"].read() == (1.5,)
    assert pendant.controller.arm.payload_kg == 0.0  # a declared payload is not carried


def test_a_payloads_inertia_is_published(pendant):
    """setTargetPayload sets the published mass and inertia of the payload."""
    assert pendant.do(FOURTEEN, [65, 1.2, 0, 0, 0.1, 0.01, 0.02, 0.03, 0, 0, 0.001, 0, 0, 0, 0]) >= 0
    assert output_variables(pendant.controller)["payload"].read() == (1.2,)
    assert output_variables(pendant.controller)["payload_inertia"].read() == (0.01, 0.02, 0.03, 0.0, 0.0, 0.001)


@pytest.mark.parametrize(
    ("written", "values"),
    [
        (FOUR, [17, math.nan, 0, 0, 0.1]),
        (FOUR, [17, 50.0, 0, 0, 0.1]),
        (FOUR, [17, 1.0, 0, math.inf, 0.1]),
        (ONE, [35, 0.0]),
        (ONE, [35, math.nan]),
        (SIX, [29, 0, 0, math.nan, 0, 0, 0]),
        (FOUR, [59, 0.0, 0.0, 0.0, 0]),
        (SIX, [46, 9.0, 0, 0, 0, 0, 0]),
    ],
)
def test_arguments_that_cannot_be_end_the_program_as_a_runtime_exception_does(pendant, written, values):
    """A command with impossible arguments is never done, so ur-rtde returns False."""
    assert pendant.do(written, values) == -1
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert "runtime exception" in pendant.controller.journal.stops[-1].reason


@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10e"])
def test_a_target_that_leaps_is_a_protective_stop(robot):
    """A servoj target that is one radian away at once stops the arm, as on a real controller."""
    pendant = Pendant(robot=robot)
    pendant.stream(0.2)
    pendant.servo(pendant.controller.reference.q + np.array([1.0, 0, 0, 0, 0, 0]))
    pendant.run(0.1)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert "joint 1 by 1.0" in pendant.controller.journal.stops[-1].reason


def test_forward_and_inverse_kinematics_are_each_others_inverse(pendant):
    """Commands 46, 30, 44 and 60 agree. The published pose is that of command 43 with the tool that was set."""
    c = pendant.controller
    pendant.do(SIX, [29, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    c.step()
    pose = np.array(output_variables(c)["actual_TCP_pose"].read())
    pendant.do(COMMAND, [43])
    assert np.allclose(c.registers.output_doubles[:6], pose, atol=1e-4)  # between two ticks the encoders' noise
    flange = c.kinematics.flange(c.measurements.latest.q)
    assert np.linalg.norm(pose[:3] - flange.translation) == pytest.approx(0.1, abs=1e-5)  # one tick's noise apart
    goal = np.array([0.3, -1.2, 1.0, -1.4, -1.5, 0.2])
    there = c.kinematics.pose(goal)
    assert pendant.do(SIX, [60, *there]) == 1
    pendant.do(FOURTEEN, [30, *there, *(goal + 0.1), 1e-4, 1e-4])
    assert np.allclose(c.registers.output_doubles[:6], goal, atol=1e-4)
    assert pendant.do(SIX, [60, 9.0, 0, 0, 0, 0, 0]) == 0
    assert pendant.do(SIX, [36, *there]) == 1


def test_movel_goes_in_a_straight_line(pendant):
    """0.2 m sideways with a rotation: the tool stays within 0.1 mm of the line and ends at the goal."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.4, -1.8, -1.57, 0.0, 2.0, 4.0, 0])
    start = c.kinematics.pose(c.reference.q)
    goal = start + np.array([0.05, 0.2, -0.1, 0.0, 0.0, 0.2])
    along = (goal - start)[:3] / np.linalg.norm((goal - start)[:3])
    c.write_inputs(MOVE, [3, *goal, 0.25, 1.2, 0])
    off = []
    for _ in range(400):
        c.step()
        way = c.kinematics.pose(c.reference.q)[:3] - start[:3]
        off.append(np.linalg.norm(way - along * (along @ way)))
    assert max(off) < 1e-4
    assert c.registers.output_ints[0] == 2
    assert np.allclose(c.kinematics.pose(c.reference.q)[:3], goal[:3], atol=1e-5)


def test_movel_to_nowhere_is_refused(pendant):
    """A pose out of reach ends the program with a reason, and the reference has not moved."""
    q = pendant.controller.reference.q.copy()
    assert pendant.do(MOVE, [3, 5.0, 0, 0, 0, 0, 0, 0.25, 1.2, 0]) == -1
    assert "no joint positions" in pendant.controller.journal.stops[-1].reason
    assert np.array_equal(pendant.controller.reference.q, q)


def test_speedl_gives_the_tool_its_speed_and_stopl_takes_it(pendant):
    """The tool moves down at 0.1 m/s without rotation, and stands after stopL."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.4, -1.8, -1.57, 0.0, 2.0, 4.0, 0])
    c.write_inputs(SPEED, [10, 0, 0, -0.1, 0, 0, 0, 0.5, 0.0])
    pendant.run(0.8)
    assert np.allclose(c.kinematics.speed(c.reference.q, c.reference.qd), [0, 0, -0.1, 0, 0, 0], atol=1e-3)
    pendant.do(recipe(["input_int_register_0", DOUBLES[0], "input_int_register_1"], INPUT_TYPES), [33, 1.0, 0])
    assert pendant.standing


def test_a_path_is_played_to_its_end_and_reports_its_progress():
    """An asynchronous movePath (45) reaches each waypoint and reports its progress in output integer 2."""
    go = "signal_async_progress({0})\nmovej([{1},-1.4,0,-1.5,0,0],a=4,v=2,r=0)\n"
    lines = go.format(0, 0.0) + go.format(1, 0.2)
    pendant = Pendant()
    pendant.controller.run_script(CONTROL.rstrip().replace("# inject move path\n", "# inject move path\n" + lines))
    pendant.do(recipe(["input_int_register_0", "input_int_register_1"], INPUT_TYPES), [45, 1])
    seen = set()
    for _ in range(150):
        pendant.controller.step()
        seen.add(pendant.controller.registers.output_ints[2] & 0xFFFF)
    assert {0x8000, 0x8001, 0} <= seen
    assert np.allclose(pendant.controller.reference.q, [0.2, -1.4, 0, -1.5, 0, 0])


def test_declared_payload_and_gravity_change_what_the_controller_computes_with(pendant):
    """target_moment follows the declared payload and gravity. What the arm carries does not matter."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 4.0, 0])
    before = np.array(output_variables(c)["target_moment"].read())
    pendant.do(FOUR, [17, 3.0, 0, 0, 0.0])
    loaded = np.array(output_variables(c)["target_moment"].read())
    assert loaded[1] - before[1] < -15.0  # 3 kg at 0.8 m
    pendant.do(FOUR, [59, 0, 0, -9.82, 0])
    assert np.array(output_variables(c)["target_moment"].read())[1] == pytest.approx(-loaded[1], rel=0.01)


@pytest.mark.parametrize(("command", "name"), [(52, "freedriveMode"), (6, "forceMode"), (12, "servoC"), (66, "directTorque")])
def test_a_command_that_is_not_simulated_ends_the_program(pendant, command, name):
    """ur-rtde takes any answer for success, so there is none: the program ends with an exception that names the command."""
    assert pendant.do(COMMAND, [command]) == -1
    pendant.controller.write_inputs(COMMAND, [command])
    pendant.run(0.05)
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert truth(pendant.controller)["refused_commands"] == [command]
    assert pendant.controller.journal.stops[-1].reason == f"runtime exception: not simulated: {name}"


def test_ends_of_modes_that_never_began_are_done(pendant):
    """forceModeStop, endTeachMode and endFreedriveMode have nothing to do; freedrive is off and nothing touches the arm."""
    assert [pendant.do(COMMAND, [command]) for command in (7, 19, 53, 62, 54, 63, 64)] == [0] * 7
    assert pendant.controller.modes.runtime == Runtime.PLAYING


def test_move_until_contact_stops_at_an_obstacle_and_goes_back_to_it(pendant):
    """The tool turns about the base until a wall presses against joint 1; it ends where it touched first."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.2, -1.6, -1.57, 0.0, 2.0, 4.0, 0])
    pendant.run(0.2)
    sideways = c.kinematics.speed(c.reference.q, np.array([0.2, 0, 0, 0, 0, 0]))
    c.arm.contact = Contact(joint=0, left_s=math.inf, stiffness_nm_per_rad=500.0, wall_rad=0.1)
    before = c.reference.q[0]
    assert pendant.do(FOURTEEN, [51, *sideways, 0, 0, 0, 0, 0, 0, 0.5, 0]) == 0
    assert c.modes.safety == SafetyMode.NORMAL
    assert before + 0.05 < c.reference.q[0] < before + 0.3
    assert c.reference.at_rest


def test_move_until_contact_ends_in_a_protective_stop_where_nothing_is_in_the_way(pendant):
    """The arm goes on to its limits, as a real one does, and ur-rtde's call returns False."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.2, -1.6, -1.57, 0.0, 2.0, 4.0, 0])
    c.write_inputs(FOURTEEN, [51, 0, 0, 0.5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2.0, 0])
    pendant.run(10.0)
    assert c.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert c.registers.output_ints[0] != 2


@pytest.mark.parametrize("feature", [0, 1, 2])
def test_jogging_moves_the_tool_along_the_axes_of_a_frame(pendant, feature):
    """0 the base, 1 the tool, 2 a frame of its own: here turned by 90° about z. jogStop stops it."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.2, -1.6, -1.57, 0.0, 2.0, 4.0, 0])
    pendant.run(0.2)
    rotation = {0: np.eye(3), 1: c.kinematics.at(c.reference.q).rotation, 2: np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])}[feature]
    assert pendant.do(FOURTEEN, [41, 0.05, 0, 0, 0, 0, 0, feature, 0.5, 0, 0, 0, 0, 0, np.pi / 2]) == 0
    pendant.run(0.5)
    assert np.allclose(c.kinematics.speed(c.reference.q, c.reference.qd)[:3], rotation @ [0.05, 0, 0], atol=2e-3)
    assert pendant.do(COMMAND, [42]) == 0
    assert pendant.standing


def test_255_ends_the_program(pendant):
    """stopScript sends command 255."""
    pendant.controller.write_inputs(COMMAND, [255])
    pendant.run(0.02)
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert pendant.controller.journal.stops[-1].kind == "program_end"


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_target_that_is_no_number_stops_the_arm(pendant, broken):
    """NaN in servoj leads to a protective stop, NaN in moveJ ends the program. The state of the arm stays finite."""
    pendant.stream(0.2)
    pendant.servo([0, broken, 0, 0, 0, 0])
    pendant.run(0.5)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert np.isfinite(pendant.controller.arm.q).all()
    other = Pendant()
    assert other.do(MOVE, [1, broken, 0, 0, 0, 0, 0, 1.0, 1.0, 0]) == -1
    assert other.controller.modes.runtime == Runtime.STOPPED


def test_a_tool_pose_that_is_no_number_is_told_as_such(pendant):
    """A servol towards NaN is refused before joint positions are searched for it."""
    pendant.controller.write_inputs(SERVO, [24, 0.3, 0.0, 0.4, math.nan, 0, 0, 0, 0, 0.008, 0.03, 500])
    pendant.run(0.1)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert "not a number" in pendant.controller.journal.stops[-1].reason


def test_months_pass_at_once_only_without_a_program(pendant):
    """`pass_time` advances heat, wear and clock. It is refused while a program plays."""
    assert pendant.controller.pass_time(1.0, 22.0, 0.0) == "a program is running"
    pendant.controller.stop_program("test")
    before = pendant.controller.clock.now_s
    assert pendant.controller.pass_time(24.0 * 30, 30.0, 0.5) == ""
    assert pendant.controller.clock.now_s - before == pytest.approx(24 * 30 * 3600)
    assert np.all(pendant.controller.arm.temperatures.motor_c > 31.0)
