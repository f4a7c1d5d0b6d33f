"""The controller without sockets: the register machine, the watchdog, stops and the dashboard's rules."""

import math

import numpy as np
import pytest
from test_sim_scripts import CONTROL

from monitor.errors import BadInput
from monitor.simulate.controller.controller import Controller
from monitor.simulate.controller.modes import RobotMode, Runtime, SafetyMode
from monitor.simulate.controller.registers import INPUT_TYPES, recipe
from monitor.simulate.controller.truth import truth
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import dashboard
from monitor.simulate.wire.variables import output_variables

DOUBLES = [f"input_double_register_{i}" for i in range(11)]
COMMAND = recipe(["input_int_register_0"], INPUT_TYPES)
SERVO = recipe(["input_int_register_0", *DOUBLES], INPUT_TYPES)
MOVE = recipe(["input_int_register_0", *DOUBLES[:8], "input_int_register_1"], INPUT_TYPES)
ONE = recipe(["input_int_register_0", DOUBLES[0]], INPUT_TYPES)
CLEAR = (COMMAND, [0])


class Pendant:
    """Writes registers as ur-rtde does."""

    def __init__(self, **settings) -> None:
        self.controller = Controller(SimulateSettings(**settings))
        self.controller.step()
        self.controller.run_script(CONTROL.rstrip())

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / self.controller.clock.tick_s)):
            self.controller.step()

    def do(self, written, values, within_s: float = 20.0) -> int:
        """A blocking command: wait for done, then clear. Returns OI1."""
        c = self.controller
        c.write_inputs(written, values)
        until = c.clock.now_s + within_s
        while c.registers.output_ints[0] != 2 and c.clock.now_s < until and c.modes.runtime == Runtime.PLAYING:
            c.step()
        result = c.registers.output_ints[1] if c.registers.output_ints[0] == 2 else -1
        c.write_inputs(*CLEAR)
        c.step()
        return result

    def servo(self, q) -> None:
        self.controller.write_inputs(SERVO, [11, *q, 0, 0, 0.008, 0.03, 500])

    def stream(self, seconds: float, speed: float = 1.0) -> None:
        """servoj at 125 Hz, all joints at a constant speed after a soft start."""
        c = self.controller
        q = c.reference.q.copy()
        v = 0.0
        for _ in range(round(seconds / 0.008)):
            v = min(speed, v + 0.05)
            q = q + 0.008 * v
            self.servo(q)
            for _ in range(round(0.008 / c.clock.tick_s)):
                c.step()

    @property
    def standing(self) -> bool:
        return self.controller.reference.at_rest and np.abs(self.controller.arm.qd).max() < 0.01


@pytest.fixture
def pendant() -> Pendant:
    return Pendant()


def test_an_uploaded_script_plays_and_is_ready(pendant):
    """runtime 2, OI0 = 1."""
    pendant.run(0.02)
    assert pendant.controller.modes.runtime == Runtime.PLAYING
    assert pendant.controller.registers.output_ints[0] == 1


def test_a_blocking_move_is_done_when_the_arm_is_there(pendant):
    """moveJ: OI0 stays 1 on the way and becomes 2 at the goal."""
    goal = pendant.controller.reference.q + np.array([0.2, -0.1, 0.1, 0, 0, 0.3])
    pendant.controller.write_inputs(MOVE, [1, *goal, 1.0, 1.0, 0])
    pendant.run(0.3)
    assert pendant.controller.registers.output_ints[0] == 1
    pendant.run(1.5)
    assert pendant.controller.registers.output_ints[0] == 2
    assert np.allclose(pendant.controller.arm.q, goal, atol=2e-3)  # the servo's error at rest


def test_an_asynchronous_move_is_done_at_once_and_tells_its_progress(pendant):
    """OI2: bit 15 is set while it runs and cleared at the end."""
    goal = pendant.controller.reference.q + 0.1
    pendant.do(MOVE, [1, *goal, 1.0, 1.0, 1])
    assert pendant.controller.clock.now_s < 0.1
    assert pendant.controller.registers.output_ints[2] & 0x8000
    pendant.run(1.5)
    assert not pendant.controller.registers.output_ints[2] & 0x8000
    assert np.allclose(pendant.controller.arm.q, goal, atol=2e-3)


def test_an_edge_command_is_processed_once(pendant):
    """While the register keeps its value nothing happens again: a second stop log would show it."""
    pendant.controller.write_inputs(ONE, [35, 10.0])
    pendant.controller.step()
    armed_at = truth(pendant.controller)["watchdog_s"]
    pendant.controller.registers.inputs.doubles[0] = 1.0
    pendant.controller.step()
    assert truth(pendant.controller)["watchdog_s"] == armed_at == 0.1


def test_servoj_latches_and_servostop_ends_it(pendant):
    """A second without a packet and without a watchdog: still servoing at the last target; then a linear stop."""
    pendant.stream(0.5)
    pendant.run(1.0)
    assert pendant.controller.reference.mode == "servo"
    assert pendant.controller.modes.runtime == Runtime.PLAYING
    assert pendant.do(ONE, [16, 10.0]) >= 0
    assert pendant.standing


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_the_watchdog_stops_a_program_whose_client_has_died(robot):
    """10 Hz: the program ends 0.1 s after the last packet, and the arm stands within 0.3 s, from 1 rad/s."""
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
    """As measured on the wire: moveJ under a 10 Hz watchdog is stopped after 0.1 s."""
    pendant.do(ONE, [35, 10.0])
    assert pendant.do(MOVE, [1, *(pendant.controller.reference.q + 0.5), 1.0, 1.0, 0]) == -1
    assert pendant.controller.journal.stops[-1].kind == "watchdog"
    assert pendant.controller.clock.now_s < 0.3


def test_the_watchdog_ends_with_the_program(pendant):
    """A new program has none until it asks."""
    pendant.do(ONE, [35, 10.0])
    pendant.run(0.3)
    pendant.controller.run_script(CONTROL.rstrip())
    pendant.run(1.0)
    assert pendant.controller.modes.runtime == Runtime.PLAYING


SIX = recipe(["input_int_register_0", *DOUBLES[:6]], INPUT_TYPES)
FOUR = recipe(["input_int_register_0", *DOUBLES[:4]], INPUT_TYPES)
FOURTEEN = recipe(["input_int_register_0", *[f"input_double_register_{i}" for i in range(14)]], INPUT_TYPES)
SPEED = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)


def test_queries_and_settings(pendant):
    """isSteady, isJointsWithinSafetyLimits, setPayload."""
    assert pendant.do(COMMAND, [47]) == 1
    assert pendant.do(SIX, [37, 0, 0, 0, 0, 0, 0]) == 1
    assert pendant.do(SIX, [37, 0, 0, 3.5, 0, 0, 0]) == 0  # the elbow turns ±π
    assert pendant.do(FOUR, [17, 1.5, 0, 0, 0.1]) >= 0
    assert output_variables(pendant.controller)["payload"].read() == (1.5,)
    assert pendant.controller.arm.payload_kg == 0.0  # told is not carried


def test_a_payloads_inertia_is_told_back(pendant):
    """setTargetPayload: kg, centre of mass, inertia."""
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
    """Payload, watchdog, tool, gravity and inverse kinematics: never done, so that ur-rtde answers False."""
    assert pendant.do(written, values) == -1
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert "runtime exception" in pendant.controller.journal.stops[-1].reason


@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10e"])
def test_a_target_that_leaps_is_a_protective_stop(robot):
    """servoj one radian away at once: no arm goes there, and a real controller stops."""
    pendant = Pendant(robot=robot)
    pendant.stream(0.2)
    pendant.servo(pendant.controller.reference.q + np.array([1.0, 0, 0, 0, 0, 0]))
    pendant.run(0.1)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert "joint 1 by 1.0" in pendant.controller.journal.stops[-1].reason


def test_forward_and_inverse_kinematics_are_each_others_inverse(pendant):
    """Commands 46, 30, 44 and 60; the pose of the outputs is that of command 43, with the tool that was set."""
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
    """0.2 m sideways and a turn of the tool: the tool stays within 0.1 mm of the line, and ends at the goal."""
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
    """Out of reach: the program ends and says so, the arm has not moved."""
    q = pendant.controller.reference.q.copy()
    assert pendant.do(MOVE, [3, 5.0, 0, 0, 0, 0, 0, 0.25, 1.2, 0]) == -1
    assert "no joint positions" in pendant.controller.journal.stops[-1].reason
    assert np.array_equal(pendant.controller.reference.q, q)


def test_speedl_gives_the_tool_its_speed_and_stopl_takes_it(pendant):
    """0.1 m/s downwards, without turning; then standing."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, -1.2, 1.4, -1.8, -1.57, 0.0, 2.0, 4.0, 0])
    c.write_inputs(SPEED, [10, 0, 0, -0.1, 0, 0, 0, 0.5, 0.0])
    pendant.run(0.8)
    assert np.allclose(c.kinematics.speed(c.reference.q, c.reference.qd), [0, 0, -0.1, 0, 0, 0], atol=1e-3)
    pendant.do(recipe(["input_int_register_0", DOUBLES[0], "input_int_register_1"], INPUT_TYPES), [33, 1.0, 0])
    assert pendant.standing


def test_a_path_is_played_to_its_end_and_tells_its_progress():
    """movePath (45) asynchronously: each waypoint, progress in OI2."""
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


def test_told_payload_and_gravity_change_what_the_controller_reckons_with(pendant):
    """target_moment follows what was told; the arm carries what it carries."""
    c = pendant.controller
    pendant.do(MOVE, [1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 4.0, 0])
    before = np.array(output_variables(c)["target_moment"].read())
    pendant.do(FOUR, [17, 3.0, 0, 0, 0.0])
    loaded = np.array(output_variables(c)["target_moment"].read())
    assert loaded[1] - before[1] < -15.0  # 3 kg at 0.8 m
    pendant.do(FOUR, [59, 0, 0, -9.82, 0])
    assert np.array(output_variables(c)["target_moment"].read())[1] == pytest.approx(-loaded[1], rel=0.01)


def test_unknown_commands_are_refused_visibly(pendant):
    """The end of a force mode, freedrive: done, result 0, told in the truth."""
    pendant.controller.registers.output_ints[1] = 1
    assert pendant.do(COMMAND, [52]) == 0
    assert pendant.do(COMMAND, [7]) == 0
    assert truth(pendant.controller)["refused_commands"] == [52, 7]
    pendant.controller.write_inputs(COMMAND, [6])  # a realtime one: told once, not every tick
    pendant.run(0.2)
    assert truth(pendant.controller)["refused_commands"] == [52, 7, 6]


def test_255_ends_the_program(pendant):
    """stopScript."""
    pendant.controller.write_inputs(COMMAND, [255])
    pendant.run(0.02)
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert pendant.controller.journal.stops[-1].kind == "program_end"


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_target_that_is_no_number_stops_the_arm(pendant, broken):
    """servoj and speedj with NaN: a protective stop; moveJ: the program ends. The state stays finite."""
    pendant.stream(0.2)
    pendant.servo([0, broken, 0, 0, 0, 0])
    pendant.run(0.5)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert np.isfinite(pendant.controller.arm.q).all()
    other = Pendant()
    assert other.do(MOVE, [1, broken, 0, 0, 0, 0, 0, 1.0, 1.0, 0]) == -1
    assert other.controller.modes.runtime == Runtime.STOPPED


def test_beyond_the_limits_the_arm_protects_itself(pendant):
    """speedj into the elbow's end stop: a protective stop that names the joint."""
    speed = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)
    pendant.controller.write_inputs(speed, [9, 0, 0, 2.0, 0, 0, 0, 2.0, 0.0])
    pendant.run(4.0)
    stop = pendant.controller.journal.stops[-1]
    assert stop.kind == "protective_stop"
    assert "joint 3" in stop.reason


def test_a_joint_beyond_its_range_finds_its_way_back_and_no_further_out(pendant):
    """Unlocked, it may stand there and go back; further out it is protected again, and back within the range as ever."""
    c = pendant.controller
    limit = c.robot.max_position_rad[5]
    speed = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)

    def turn(rad_s: float, seconds: float) -> None:
        c.stop_program("test")
        c.run_script(CONTROL.rstrip())
        c.write_inputs(speed, [9, 0, 0, 0, 0, 0, rad_s, 10.0, 0.0])
        pendant.run(seconds)

    turn(3.0, 3.0)
    assert c.arm.q[5] > limit
    pendant.run(5.0)
    assert c.safety.unlock()
    c.write_inputs(*CLEAR)
    pendant.run(1.0)
    assert c.modes.safety == SafetyMode.NORMAL
    turn(0.5, 0.5)
    assert "beyond" in c.journal.stops[-1].reason
    pendant.run(5.0)
    assert c.safety.unlock()
    turn(-0.5, 2.0)
    assert c.modes.safety == SafetyMode.NORMAL
    assert c.arm.q[5] < limit
    turn(3.0, 1.0)
    assert c.modes.safety == SafetyMode.PROTECTIVE_STOP


def test_a_blocked_drive_becomes_a_protective_stop():
    """Joint 5 so worn that its drive cannot turn it: torque limit or following error, within a second of motion."""
    pendant = Pendant()
    pendant.controller.arm.set_wear(4, coulomb=40.0)
    pendant.stream(1.0)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP


@pytest.mark.parametrize(("runtime", "state"), [("paused", 4), ("stopped", 1), ("playing", 2)])
def test_a_protective_stop_halts_the_arm_in_each_variant(runtime, state):
    """Bits, modes, runtime; servo packets do not move it meanwhile."""
    pendant = Pendant(protective_runtime=runtime)
    pendant.stream(0.3)
    pendant.controller.protective_stop("test")
    pendant.run(0.3)
    assert pendant.standing
    at = pendant.controller.reference.q.copy()
    pendant.stream(0.2)
    assert np.array_equal(pendant.controller.reference.q, at)
    read = {
        name: output_variables(pendant.controller)[name].read()[0]
        for name in ("safety_mode", "safety_status_bits", "robot_mode", "runtime_state")
    }
    assert read == {"safety_mode": 3, "safety_status_bits": (1 << 2) | (1 << 10), "robot_mode": 7, "runtime_state": state}
    stop = pendant.controller.journal.stops[0]
    assert stop.stood_at_s is not None
    assert stop.stood_at_s - stop.at_s < 0.2


def test_a_protective_stop_unlocks_after_five_seconds_and_not_before(pendant):
    """Dashboard's replies literally; the program stays paused until play."""
    pendant.controller.protective_stop("test")
    pendant.run(4.9)
    assert dashboard.reply(pendant.controller, "unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    assert dashboard.reply(pendant.controller, "play") == "Failed to execute: play"
    pendant.run(0.2)
    assert dashboard.reply(pendant.controller, "unlock protective stop") == "Protective stop releasing"
    assert pendant.controller.modes.safety == SafetyMode.NORMAL
    assert pendant.controller.modes.runtime == Runtime.PAUSED
    assert dashboard.reply(pendant.controller, "play") == "Starting program"
    assert pendant.controller.modes.runtime == Runtime.PLAYING


def test_an_emergency_stop_takes_the_power_and_the_dashboard_brings_it_back(pendant):
    """Arm at rest before the drives go off; scripts are refused until it runs again."""
    pendant.stream(0.3)
    pendant.controller.safety.emergency_stop()
    pendant.run(0.5)
    assert pendant.controller.modes.robot == RobotMode.POWER_OFF
    assert output_variables(pendant.controller)["safety_status_bits"].read() == ((1 << 6) | (1 << 7) | (1 << 10),)
    pendant.controller.run_script(CONTROL.rstrip())
    assert pendant.controller.modes.runtime == Runtime.STOPPED
    assert "ROBOT_EMERGENCY_STOP" in pendant.controller.journal.refused_scripts[-1]
    assert dashboard.reply(pendant.controller, "power on") == "Failed to execute: power on"
    pendant.controller.safety.release_emergency_stop()
    assert [dashboard.reply(pendant.controller, line) for line in ("power on", "brake release")] == ["Powering on", "Brake releasing"]
    pendant.controller.run_script(CONTROL.rstrip())
    pendant.run(0.1)
    assert pendant.controller.modes.runtime == Runtime.PLAYING


def test_the_dashboard_answers_literally(pendant):
    """The replies that ur-rtde compares or parses."""
    replies = {
        "PolyscopeVersion": "URSoftware 3.15.8.106339 (Mar 10 2022)",
        "get serial number": "20180500001",
        "is in remote control": "true",
        "robotmode": "Robotmode: RUNNING",
        "safetymode": "Safetymode: NORMAL",
        "safetystatus": "Safetystatus: NORMAL",
        "running": "Program running: true",
        "programState": "PLAYING rtde_control.urp",
        "pause": "Pausing program",
        "stop": "Stopped",
        "play": "Failed to execute: play",
        "close safety popup": "closing safety popup",
        "popup hello": "showing popup",
        "addToLog hello": "Added log message",
        "load nothing.urp": "File not found: nothing.urp",
        "load installation nothing.installation": "File not found: nothing.installation",
        "version": "3.15.8.106339",
        "setUserRole operator": "Setting user role: operator",
        "getUserRole": "OPERATOR",
        "setUserRole king": "Failed setting user role: king",
        "quit": "Disconnected",
        "sing": "could not understand: sing",
    }
    assert {line: dashboard.reply(pendant.controller, line) for line in replies} == replies


def test_the_dashboard_knows_its_generations_commands():
    """The role of a user is CB3's, operational modes are the e-Series'; a mode that was set is told until it is cleared."""
    cb3, e_series = Controller(SimulateSettings()), Controller(SimulateSettings(robot="ur5e"))
    assert dashboard.reply(cb3, "get operational mode").startswith("could not understand")
    assert dashboard.reply(e_series, "setUserRole operator").startswith("could not understand")
    asked = (
        "set operational mode sideways",
        "set operational mode automatic",
        "get operational mode",
        "clear operational mode",
        "get operational mode",
    )
    assert [dashboard.reply(e_series, line) for line in asked] == [
        "Failed setting operational mode: sideways",
        "Setting operational mode: automatic",
        "AUTOMATIC",
        "operational mode is no longer controlled by Dashboard Server",
        "NONE",
    ]


def test_months_pass_at_once_only_without_a_program(pendant):
    """live: heat, wear and clock go on; refused while a program plays."""
    assert pendant.controller.live(1.0, 22.0, 0.0) == "a program is running"
    pendant.controller.stop_program("test")
    before = pendant.controller.clock.now_s
    assert pendant.controller.live(24.0 * 30, 30.0, 0.5) == ""
    assert pendant.controller.clock.now_s - before == pytest.approx(24 * 30 * 3600)
    assert np.all(pendant.controller.arm.temperatures.motor_c > 31.0)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"bind": "0.0.0.0"}, "bind"),
        ({"bind": "192.168.56.101"}, "bind"),
        ({"bind": "localhost"}, "bind"),
        ({"robot": "ur7"}, "ur7"),
        ({"version": "5.3.0"}, "version"),
        ({"version": "new"}, "version"),
        ({"robot": "ur5", "version": "5.11.0"}, "for a ur5"),
        ({"robot": "ur20", "version": "3.15.0"}, "for a ur20"),
        ({"payload_kg": -1.0}, "payload_kg"),
        ({"home_rad": (0.0,) * 5}, "home_rad"),
        ({"serial": "abc"}, "serial"),
        ({"ambient_c": 99.0}, "ambient_c"),
        ({"wear_per_revolution": (-1.0,) * 6}, "wear_per_revolution"),
        ({"protective_runtime": "shrugs"}, "protective_runtime"),
        ({"command_port": 0}, "command_port"),
        ({"command_port": 30004}, "command_port"),
        ({"seed": -1}, "seed"),
        ({"wear_per_revolution": (math.nan,) * 6}, "wear_per_revolution"),
        ({"payload_com_m": (0.0, 0.0, math.nan)}, "payload_com_m"),
    ],
)
def test_wrong_settings_are_named(wrong, named):
    """Every mistake is a BadInput that names the field."""
    with pytest.raises(BadInput, match=named):
        SimulateSettings(**wrong)
