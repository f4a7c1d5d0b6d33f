"""Safety stops, power and the dashboard of a controller without sockets."""

import numpy as np
import pytest
from sim_pendant import CLEAR, CONTROL, DOUBLES, Pendant

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.registers import INPUT_TYPES, recipe
from monitor.simulate.machine.state import RobotMode, Runtime, SafetyMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import dashboard
from monitor.simulate.wire.variables import output_variables


@pytest.fixture
def pendant() -> Pendant:
    return Pendant()


def test_beyond_the_limits_the_arm_protects_itself(pendant):
    """speedj moves the elbow beyond its range. The protective stop names the joint."""
    speed = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)
    pendant.controller.write_inputs(speed, [9, 0, 0, 2.0, 0, 0, 0, 2.0, 0.0])
    pendant.run(4.0)
    stop = pendant.controller.journal.stops[-1]
    assert stop.kind == "protective_stop"
    assert "joint 3" in stop.reason


def test_a_joint_beyond_its_range_finds_its_way_back_and_no_further_out(pendant):
    """After the unlock the joint may stand there and go back. If it moves farther out, the arm stops again."""
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
    """Joint 5 is so worn that its drive cannot turn it. The arm stops within a second of motion."""
    pendant = Pendant()
    pendant.controller.arm.set_wear(4, coulomb=40.0)
    pendant.stream(1.0)
    assert pendant.controller.modes.safety == SafetyMode.PROTECTIVE_STOP


@pytest.mark.parametrize(("runtime", "state"), [("paused", 4), ("stopped", 1), ("playing", 2)])
def test_a_protective_stop_halts_the_arm_in_each_variant(runtime, state):
    """Modes, bits and program state are right, and servoj packets do not move the arm."""
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
    """The dashboard's replies are literal. The program stays paused until `play`."""
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
    """The arm stands before the power goes off. Scripts are refused until the arm runs again."""
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
    """ur-rtde compares or parses these replies."""
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
    """User roles belong to CB3 and operational modes to the e-Series. A mode is reported until it is cleared."""
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
        "Operational mode AUTOMATIC is set",
        "AUTOMATIC",
        "No longer controlling the operational mode. Current operational mode: NONE",
        "NONE",
    ]
