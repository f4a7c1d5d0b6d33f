"""Arguments that no sane client sends are refused with a reason, and the state of the arm stays finite."""

import struct

import numpy as np
import pytest
from sim_pendant import DOUBLES, MOVE, SERVO, Pendant

from monitor.model.robot import Mounting, load_robot
from monitor.simulate.arm.kinematics import Kinematics, se3
from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.registers import INPUT_TYPES, recipe
from monitor.simulate.machine.state import RobotMode, Runtime, SafetyMode
from monitor.simulate.program.language import Source
from monitor.simulate.program.scripts import Refused, parse
from monitor.simulate.scenario import scenario_from_document
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.rtde import RtdeSession
from monitor.simulate.wire.variables import output_variables

PAYLOAD = recipe(["input_int_register_0", *DOUBLES[:4]], INPUT_TYPES)
SIX = recipe(["input_int_register_0", *DOUBLES[:6]], INPUT_TYPES)
SPEED = recipe(["input_int_register_0", *DOUBLES[:8]], INPUT_TYPES)


@pytest.fixture
def pendant() -> Pendant:
    return Pendant()


def test_a_register_takes_32_bits_and_a_script_with_more_is_refused(pendant):
    """A larger value would not fit the packet, and clients that read the register would get no more packets."""
    c = pendant.controller
    session = RtdeSession(c, output_variables(c), 1)
    names = b"output_int_register_1"
    session.feed(struct.pack(">HBd", 11 + len(names), 79, 125.0) + names + struct.pack(">HB", 3, 83))
    for value in (2**31, -(2**31) - 1):
        c.run_script(f"write_output_integer_register(1, {value})")
        pendant.run(0.05)
        assert "32 bits" in c.journal.refused_scripts[-1]
        assert session.output(0, {}) == struct.pack(">HBBi", 8, 85, 1, 0)
    c.run_script(f"write_output_integer_register(1, {2**31 - 1})")
    pendant.run(0.05)
    assert session.output(0, {}) == struct.pack(">HBBi", 8, 85, 1, 2**31 - 1)


def test_a_secondary_program_runs_beside_the_one_that_plays(pendant):
    """A secondary program writes a register while the main program plays. It is refused if it moves the arm."""
    c = pendant.controller
    before = c.programs.current
    c.run_script("sec note():\n  write_output_integer_register(5, 7)\nend")
    pendant.run(0.05)
    assert (c.programs.current, c.modes.runtime, c.registers.output_ints[5]) == (before, Runtime.PLAYING, 7)
    assert isinstance(parse("sec go():\n  movej([0,0,0,0,0,0])\nend"), Refused)
    assert isinstance(parse('sec hello():\n  textmsg("hello")\nend'), Source)


@pytest.mark.parametrize(
    ("written", "values", "why"),
    [
        (PAYLOAD, [17, 1.0, 0.0, 0.0, 1e200], "centre of mass"),
        (PAYLOAD, [17, 1.0, 3.0, 0.0, 0.0], "centre of mass"),
        (SIX, [29, 1e200, 0, 0, 0, 0, 0], "set_tcp"),
        (SIX, [29, 0, 0, 0, 1e308, 1e308, 0], "set_tcp"),
        (MOVE, [1, *[0.5] * 6, 5e-324, 1.0, 0], "must be positive"),
    ],
)
def test_absurd_figures_end_the_program(pendant, written, values, why):
    """They raise a runtime exception, and the arm stays where it is."""
    c = pendant.controller
    assert pendant.do(written, values) == -1
    assert why in c.journal.stops[-1].reason
    pendant.run(0.1)
    assert np.isfinite(c.arm.q).all()


def test_a_motion_with_figures_near_the_largest_double_is_a_protective_stop(pendant):
    """A tool speed and an acceleration near the largest double lead to a protective stop."""
    c = pendant.controller
    with np.errstate(all="ignore"):
        c.write_inputs(SPEED, [10, *[1.7e308] * 6, 1e308, 0.0])
        pendant.run(1.0)
    assert c.modes.safety == SafetyMode.PROTECTIVE_STOP
    assert np.isfinite(c.arm.q).all()
    assert np.isfinite(c.reference.q).all()


@pytest.mark.parametrize("time_s", [1e308, 1e-320, -1.0, 1000.0])
def test_servoj_for_any_time_leaves_the_arm_within_its_targets(pendant, time_s):
    """ur-rtde does not check the argument `time`."""
    c = pendant.controller
    start = c.reference.q.copy()
    for k in range(40):
        c.write_inputs(SERVO, [11, *(start + 1e-3 * k), 0, 0, time_s, 0.03, 500])
        c.step()
    assert np.all(np.abs(c.arm.q - start) < 0.06)


def test_a_moved_encoder_is_still_moved_after_a_restart():
    """The arm does not jump by the offset when the brakes open."""
    c = Controller(SimulateSettings())
    c.step()
    c.inject("encoder_offset", {"joint": 2, "value": 0.1})
    after = Controller(c.settings, before=c)
    stood = after.arm.q.copy()
    assert after.safety.power(RobotMode.IDLE)
    assert after.safety.power(RobotMode.RUNNING)
    for _ in range(100):
        after.step()
    assert np.allclose(after.arm.q, stood, atol=1e-3)
    assert after.modes.safety == SafetyMode.NORMAL
    assert np.isclose(after.measurements.latest.q[1] - after.arm.q[1], 0.1, atol=1e-3)


def test_a_restart_repairs_no_sensor_and_keeps_the_installed_payload():
    """Faults of sensors and the installed payload survive a restart. What a program declared does not."""
    events = [
        {"at_s": 0, "do": "mounting", "mounting": "ceiling", "declared": True},
        {"at_s": 0, "do": "payload", "kg": 2.0, "declared": True},
    ]
    c = Controller(SimulateSettings(scenario=scenario_from_document({"event": events}, "declared", "declared.toml")))
    c.step()
    c.inject("current_stuck", {"joint": 1})
    c.installation.declare(payload=(3.0, 0.0, 0.0, 0.0))
    after = Controller(c.settings, before=c)
    after.step()
    assert after.installation.payload[0] == 2.0
    assert np.allclose(after.installation.gravity, Mounting.parse("ceiling").gravity_in_base)
    assert after.measurements.latest.current[0] == c.measurements.sensors.faults.stuck_a[0]


def test_an_arm_without_power_is_as_warm_as_its_room():
    """With power, an arm at rest is three kelvins warmer than its room."""
    c = Controller(SimulateSettings(ambient_c=20.0))
    c.safety.power(RobotMode.POWER_OFF)
    c.pass_time(48.0)
    assert np.allclose(c.arm.temperatures.motor_c, 20.0, atol=0.1)
    c.safety.power(RobotMode.IDLE)
    c.pass_time(48.0)
    assert np.allclose(c.arm.temperatures.motor_c, 23.0, atol=0.1)


def test_clear_restores_the_noise_of_the_settings():
    """`clear` restores the noise of the settings, even after the noise was zero."""
    c = Controller(SimulateSettings(current_noise=4.0))

    def loudness() -> float:
        return float(np.std([(c.step(), c.measurements.latest.current)[1] for _ in range(600)], axis=0)[0])

    usual = loudness()
    c.inject("current_noise", {"factor": 0})
    assert loudness() < 0.1 * usual
    c.inject("clear", {})
    assert 0.8 * usual < loudness() < 1.25 * usual


@pytest.mark.parametrize("robot", ["ur3", "ur20"])
def test_a_pose_that_no_arm_reaches_is_not_searched_for(robot, monkeypatch):
    """A search would delay twenty control periods. A pose that the arm reaches is never rejected as too far."""
    kinematics = Kinematics(load_robot(robot))
    rng = np.random.default_rng(1)
    for q in rng.uniform(-np.pi, np.pi, (20, 6)):
        assert kinematics.inverse(kinematics.at(q), q) is not None
    stretched = np.array([0.3, -0.2, 0.0, -0.2, 0.1, 0.0])
    kinematics.tool = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    assert kinematics.inverse(kinematics.at(stretched), stretched) is not None
    monkeypatch.setattr(kinematics, "at", lambda _: pytest.fail("searched"))
    for far in ([3.0, 0.0, 0.0], [1e300, 0.0, 0.0], [np.nan, 0.0, 0.0]):
        assert kinematics.inverse(se3([*far, 0.0, 0.0, 0.0]), stretched) is None
