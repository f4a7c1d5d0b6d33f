"""The variables of RTDE against a table that was written by hand from the manufacturer's guide: names, types, versions."""

import struct

import numpy as np
import pytest

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.identity import OUTPUT_TYPES
from monitor.simulate.machine.registers import width
from monitor.simulate.machine.state import Modes, RobotMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.rtde import RtdeSession
from monitor.simulate.wire.variables import joint_mode, output_variables

# a line: type, first version on CB3 and on the e-Series (0: always, -: never), names; a..b are the numbers in place of #
OUTPUTS = """
DOUBLE 0 0 timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum
DOUBLE 0 0 actual_main_voltage actual_robot_voltage actual_robot_current io_current tcp_force_scalar
DOUBLE 0 0 joint_position_deviation_ratio
DOUBLE 0 0 standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1
DOUBLE 0 0 tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature euromap67_24V_voltage euromap67_24V_current
VECTOR6D 0 0 target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current actual_current_window
VECTOR6D 0 0 joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed
VECTOR6D 0 0 joint_temperatures actual_joint_voltage
VECTOR3D 0 0 actual_tool_accelerometer
UINT64 0 0 actual_digital_input_bits actual_digital_output_bits
INT32 0 0 robot_mode safety_mode tool_output_voltage
VECTOR6INT32 0 0 joint_mode
UINT32 0 0 runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode tool_analog_input_types
UINT32 0 0 euromap67_input_bits euromap67_output_bits output_bit_registers0_to_31 output_bit_registers32_to_63
UINT32 0 0 input_bit_registers0_to_31 input_bit_registers32_to_63
INT32 0 0 output_int_register_# 0..23
INT32 0 0 input_int_register_# 0..23
DOUBLE 0 0 output_double_register_# 0..23
DOUBLE 0 0 input_double_register_# 0..23
INT32 3.9.0 5.3.0 output_int_register_# 24..47
INT32 3.9.0 5.3.0 input_int_register_# 24..47
DOUBLE 3.9.0 5.3.0 output_double_register_# 24..47
DOUBLE 3.9.0 5.3.0 input_double_register_# 24..47
BOOL 3.9.0 5.3.0 output_bit_register_# 64..127
BOOL 3.9.0 5.3.0 input_bit_register_# 64..127
VECTOR3D 3.5.0 5.0.0 elbow_position elbow_velocity
INT32 3.10.0 5.4.0 safety_status
DOUBLE 3.11.0 5.5.1 payload
VECTOR3D 3.11.0 5.5.1 payload_cog
VECTOR6D 3.12.0 5.5.1 tcp_offset
UINT32 3.14.0 5.9.0 script_control_line
VECTOR6D 3.15.0 5.11.0 payload_inertia
UINT8 - 5.2.0 tool_output_mode tool_digital_output0_mode tool_digital_output1_mode
VECTOR6D - 5.9.0 ft_raw_wrench
DOUBLE - 5.15.0 collision_detection_ratio
INT32 - 5.17.0 time_scale_source
VECTOR6D - 5.23.0 actual_current_as_torque
BOOL - - output_bit_register_# 0..63
BOOL - - input_bit_register_# 0..63
DOUBLE - 5.23.0 actual_robot_energy_consumed
UINT64 - 5.26.0 control_step
DOUBLE - - actual_robot_braking_energy_dissipated target_execution_time
VECTOR6D - - actual_TCP_acceleration target_TCP_acceleration wrench_calc_from_currents target_base_acceleration target_base_wrench
INT32 - - encoder0_raw encoder1_raw
UINT64 - - actual_configurable_digital_input_bits actual_configurable_digital_output_bits
VECTOR3D - - target_gravity
"""
INPUTS = """
UINT32 0 0 speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63
DOUBLE 0 0 speed_slider_fraction standard_analog_output_0 standard_analog_output_1
UINT8 0 0 standard_digital_output_mask configurable_digital_output_mask standard_digital_output configurable_digital_output
UINT8 0 0 standard_analog_output_mask standard_analog_output_type tool_digital_output_mask tool_digital_output
INT32 0 0 input_int_register_# 0..23
DOUBLE 0 0 input_double_register_# 0..23
INT32 3.9.0 5.3.0 input_int_register_# 24..47
DOUBLE 3.9.0 5.3.0 input_double_register_# 24..47
BOOL 3.9.0 5.3.0 input_bit_register_# 64..127
VECTOR6D 0 0 external_force_torque
BOOL - - input_bit_register_# 0..63
"""
X_VERSIONS = {"10.11.0": False, "10.12.1": False, "10.13.0": True, "10.14.0": True}  # whether each has `control_step`
BYTES = {"DOUBLE": 8, "VECTOR3D": 24, "VECTOR6D": 48, "INT32": 4, "UINT32": 4, "UINT64": 8, "VECTOR6INT32": 24, "UINT8": 1, "BOOL": 1}


def table(text: str, version: str) -> dict[str, str]:
    """The type of each name at this version, or NOT_FOUND."""
    at, types = tuple(map(int, version.split("."))), {}
    for line in text.strip().splitlines():
        kind, cb3, e_series, *names = line.split()
        since = cb3 if at[0] == 3 else e_series
        there = since != "-" and at >= tuple(map(int, since.split(".")))
        if "#" in names[0]:
            first, last = map(int, names[1].split(".."))
            names = [names[0].replace("#", str(i)) for i in range(first, last + 1)]
        types |= dict.fromkeys(names, kind if there else "NOT_FOUND")
    return types


def pieces(names: list[str], size: int = 40) -> list[list[str]]:
    """Lists of names that are short enough: a list may have 2048 bytes."""
    return [names[i : i + size] for i in range(0, len(names), size)]


def session_of(controller: Controller) -> RtdeSession:
    return RtdeSession(controller, output_variables(controller), 1)


def request(kind: bytes, payload: bytes) -> bytes:
    return struct.pack(">H", 3 + len(payload)) + kind + payload


@pytest.mark.parametrize(
    "version", ["3.4.0", "3.9.1", "3.11.0", "3.15.8", "5.4.0", "5.5.1", "5.9.4", "5.11.0", "5.17.2", "5.22.0", "5.23.0", "5.25.1", "5.26.0"]
)
def test_every_output_has_its_published_type_from_its_version_on(version):
    """Outputs are requested in groups. A packet is as long as the types of its outputs say."""
    controller = Controller(SimulateSettings(robot="ur5" if version[0] == "3" else "ur5e", version=version))
    expected = table(OUTPUTS, version)
    session = session_of(controller)
    types = {}
    for names in pieces(list(expected)):
        reply = session.feed(request(b"O", struct.pack(">d", 500.0) + ",".join(names).encode()))
        types |= dict(zip(names, reply[4:].decode().split(","), strict=True))
    assert types == expected
    there = [name for name, kind in expected.items() if kind != "NOT_FOUND"]
    for names in pieces(there):
        session.feed(request(b"O", struct.pack(">d", 500.0) + ",".join(names).encode()))
        session.feed(request(b"S", b""))
        packet = session.output(0, {})
        assert len(packet) == struct.unpack_from(">H", packet)[0] == 4 + sum(BYTES[expected[name]] for name in names)


def test_a_polyscope_x_has_a_variable_from_a_version_of_its_own_on():
    """The number of control periods came with 5.26 and with 10.13: 10.12 is newer than 5.26 by its number only."""
    there = {
        version: Controller(SimulateSettings(robot="ur5e", version=version)).identity.publishes("control_step") for version in X_VERSIONS
    }
    assert there == X_VERSIONS
    c = Controller(SimulateSettings(robot="ur5e", version="10.13.0"))
    before = output_variables(c)["control_step"].read()[0]
    c.step()
    assert output_variables(c)["control_step"].read()[0] == before + 1


@pytest.mark.parametrize("version", ["3.4.0", "3.15.8", "5.4.0", "5.22.0"])
def test_every_input_has_its_published_type_from_its_version_on(version):
    """Each input is requested alone, because nothing is claimed if one name of a list is unknown."""
    session = session_of(Controller(SimulateSettings(robot="ur5" if version[0] == "3" else "ur5e", version=version)))
    expected = table(INPUTS, version)
    types = {name: session.feed(request(b"I", name.encode()))[4:].decode() for name in expected}
    assert types == expected


def test_the_table_has_nothing_that_the_guide_has_not():
    """The table above has every output that any version publishes."""
    assert set(output_variables(Controller(SimulateSettings(robot="ur5e")))) <= set(table(OUTPUTS, "5.23.0"))


def test_every_published_output_has_a_source():
    """The table of types and the table of sources name the same variables, and each source gives as many numbers as the type has."""
    variables = output_variables(Controller(SimulateSettings(robot="ur5e")))
    assert set(variables) == set(OUTPUT_TYPES)
    assert all(len(variable.read()) == width(OUTPUT_TYPES[name]) for name, variable in variables.items())


def test_the_sensor_at_the_flange_shows_a_payload_that_nobody_declared():
    """1.5 kg is 0.1 m out along the flange's x axis, which is level at home: 14.7 N, 1.47 N·m."""
    c = Controller(SimulateSettings(robot="ur5e"))
    assert output_variables(c)["ft_raw_wrench"].read() == (0.0,) * 6
    c.arm.carry(payload_kg=1.5, payload_com_m=(0.1, 0.0, 0.0), declared=False)
    wrench = np.array(output_variables(c)["ft_raw_wrench"].read())
    down = c.kinematics.flange(c.measurements.latest.q).rotation.T @ [0.0, 0.0, -1.0]
    assert np.allclose(wrench[:3], 1.5 * 9.81 * down, atol=0.01)  # g to three digits
    assert np.allclose(wrench[3:], np.cross([0.1, 0.0, 0.0], wrench[:3]))
    assert np.linalg.norm(wrench[:3]) == pytest.approx(14.7, abs=0.02)


def test_the_deviation_ratio_reaches_one_when_the_arm_is_protected():
    """The following error grows until the protective stop. The ratio is below 1 before it and at least 1 then."""
    c = Controller(SimulateSettings(robot="ur5e"))
    ratios = []
    while c.modes.safety == 1:
        c.reference.put(c.reference.q + np.array([0.004, 0, 0, 0, 0, 0]), c.reference.qd, c.reference.qdd)
        c.arm.q = np.array(SimulateSettings().home_rad)  # held by something
        c.step()
        ratios.append(output_variables(c)["joint_position_deviation_ratio"].read()[0])
    assert max(ratios[:-1]) < 1.0 <= ratios[-1]


def test_what_a_client_sets_is_published():
    """The controller publishes the tool that a client set, and which analogue output gives volts."""
    c = Controller(SimulateSettings(robot="ur5e"))
    c.kinematics.tool = np.array([0.0, 0.0, 0.1, 0.0, 0.5, 0.0])
    assert output_variables(c)["tcp_offset"].read() == (0.0, 0.0, 0.1, 0.0, 0.5, 0.0)
    session = session_of(c)
    session.feed(request(b"I", b"standard_analog_output_mask,standard_analog_output_type,standard_analog_output_1"))
    session.feed(request(b"U", struct.pack(">BBBd", 1, 2, 2, 0.5)))
    assert output_variables(c)["standard_analog_output1"].read() == (5.0,)
    assert output_variables(c)["analog_io_types"].read() == (8,)


@pytest.mark.parametrize(("robot", "mode"), [("POWER_OFF", 239), ("POWER_ON", 247), ("IDLE", 255), ("RUNNING", 253)])
def test_every_joint_has_the_mode_of_the_arms_power(robot, mode):
    """A client that waits for all joints to run must not see an arm with closed brakes as running."""
    assert joint_mode(Modes(robot=RobotMode[robot])) == mode
