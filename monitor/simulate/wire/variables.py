"""Output variables of the RTDE interface: name, type and where the value comes from."""

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.controller.registers import INPUT_TYPES, REGISTERS
from monitor.simulate.wire.packing import Sort, Source, Variable, array, computed, constant, listed, number

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

SUPPLY_V = 48.0
ELECTRONICS_A = 0.9  # of the whole arm at rest
JOINT_RUNNING, JOINT_POWER_OFF = 253, 239
TOOL_RUNNING, TOOL_OFF = 253, 239
NOTHING = (0.0,) * 6
POWER_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1  # robot_status_bits
NORMAL, PROTECTIVE, ROBOT_EMERGENCY, EMERGENCY, STOPPED = 1 << 0, 1 << 2, 1 << 6, 1 << 7, 1 << 10  # safety_status_bits


NOT_MODELLED = {  # published outputs that are constantly zero here
    "output_bit_registers0_to_31": "UINT32",
    "output_bit_registers32_to_63": "UINT32",
    "io_current": "DOUBLE",
    "euromap67_input_bits": "UINT32",
    "euromap67_output_bits": "UINT32",
    "euromap67_24V_voltage": "DOUBLE",
    "euromap67_24V_current": "DOUBLE",
    "tool_output_mode": "UINT8",
    "tool_digital_output0_mode": "UINT8",
    "tool_digital_output1_mode": "UINT8",
    "tool_analog_input_types": "UINT32",
    "tool_analog_input0": "DOUBLE",
    "tool_analog_input1": "DOUBLE",
    "tool_output_voltage": "INT32",
    "tool_output_current": "DOUBLE",
    "script_control_line": "UINT32",  # scripts are played, not run line by line
    "time_scale_source": "INT32",
    "collision_detection_ratio": "DOUBLE",  # nothing is ever hit
}


def output_variables(c: "Controller") -> dict[str, Variable]:
    """Every output that any version up to 5.23 knows; `published` tells which of them the emulated one does.

    Not modelled and constantly zero: forces at the tool but for a payload's weight, momentum, analogue inputs.
    """
    tool = _ToolState(c)
    actual, target = Source(Sort.COMPUTED, 12, tool.actual), Source(Sort.COMPUTED, 12, tool.target)
    state = Source(Sort.LISTED, 12, _State(c).read)
    gain = c.arm.gain_nm_per_a
    pace = number("DOUBLE", c, "speed_fraction")
    payload, analog = Source(Sort.LISTED, 4, lambda: c.declared_payload), Source(Sort.LISTED, 2, c.outputs.analog.copy)
    zero = constant("DOUBLE", 0.0)
    table = {
        "timestamp": number("DOUBLE", c, "clock_s"),
        "target_q": array(c, "reference.q"),
        "target_qd": array(c, "reference.qd"),
        "target_qdd": array(c, "reference.qdd"),
        "target_moment": computed("VECTOR6D", lambda: target_moment(c)),
        "target_current": computed("VECTOR6D", lambda: target_moment(c) / gain),
        "actual_q": array(c, "measured.q"),
        "actual_qd": array(c, "measured.qd"),
        "actual_current": array(c, "measured.current"),
        "actual_current_as_torque": computed("VECTOR6D", lambda: c.measured.current * gain),
        "joint_control_output": computed("VECTOR6D", lambda: c.arm.torque_nm / gain),
        "joint_temperatures": array(c, "measured.temperature_c"),
        "actual_joint_voltage": constant("VECTOR6D", *[SUPPLY_V] * 6),
        "actual_TCP_pose": Variable("VECTOR6D", actual),
        "actual_TCP_speed": Variable("VECTOR6D", actual, 6),
        "target_TCP_pose": Variable("VECTOR6D", target),
        "target_TCP_speed": Variable("VECTOR6D", target, 6),
        "actual_TCP_force": constant("VECTOR6D", *NOTHING),
        "tcp_offset": array(c, "kinematics.tool"),
        "ft_raw_wrench": listed("VECTOR6D", tool.weight),
        "robot_mode": Variable("INT32", state),
        "safety_mode": Variable("INT32", state, 1),
        "safety_status": Variable("INT32", state, 1),
        "runtime_state": Variable("UINT32", state, 2),
        "robot_status_bits": Variable("UINT32", state, 3),
        "safety_status_bits": Variable("UINT32", state, 4),
        "joint_mode": Variable("VECTOR6INT32", state, 5),
        "tool_mode": Variable("UINT32", state, 11),
        "actual_execution_time": constant("DOUBLE", 1e3 * c.tick_s / 4),
        "speed_scaling": pace,
        "target_speed_fraction": pace,
        "actual_momentum": zero,
        "tcp_force_scalar": zero,
        "joint_position_deviation_ratio": number("DOUBLE", c, "deviation_ratio"),
        "tool_temperature": number("DOUBLE", c, "arm.ambient_c"),
        "actual_main_voltage": constant("DOUBLE", SUPPLY_V),
        "actual_robot_voltage": constant("DOUBLE", SUPPLY_V),
        "actual_robot_current": listed("DOUBLE", lambda: (supply_current(c),)),
        "actual_tool_accelerometer": computed("VECTOR3D", tool.accelerometer),
        "payload": Variable("DOUBLE", payload),
        "payload_cog": Variable("VECTOR3D", payload, 1),
        "payload_inertia": listed("VECTOR6D", lambda: c.declared_inertia),
        "actual_digital_input_bits": number("UINT64", c, "digital_inputs"),
        "actual_digital_output_bits": number("UINT64", c, "outputs.digital"),
        "analog_io_types": number("UINT32", c, "outputs.analog_types"),
        **{f"standard_analog_input{i}": zero for i in (0, 1)},
        "standard_analog_output0": Variable("DOUBLE", analog),
        "standard_analog_output1": Variable("DOUBLE", analog, 1),
        "elbow_position": computed("VECTOR3D", lambda: c.kinematics.elbow(c.measured.q)),
        "elbow_velocity": computed("VECTOR3D", lambda: c.kinematics.elbow_speed(c.measured.q, c.measured.qd)),
        "actual_current_window": constant("VECTOR6D", *(0.1 * c.robot.max_torque_nm / gain).tolist()),
        **{name: constant(kind, *[0] * (1 if kind != "VECTOR6D" else 6)) for name, kind in NOT_MODELLED.items()},
        **{f"output_bit_register_{i}": constant("BOOL", False) for i in range(64, 128)},  # the others are words of 32
        **{
            name: listed(kind, lambda name=name: (c.inputs.others.get(name, 0),))  # type: ignore[misc,arg-type]
            for name, kind in INPUT_TYPES.items()
            if name.startswith("input_bit")
        },
    }
    for name, kind, values in (
        ("output_int", "INT32", c.output_ints),
        ("output_double", "DOUBLE", c.output_doubles),
        ("input_int", "INT32", c.inputs.ints),
        ("input_double", "DOUBLE", c.inputs.doubles),
    ):
        all_of_them = Source(Sort.LISTED, REGISTERS, values.copy)
        table |= {f"{name}_register_{i}": Variable(kind, all_of_them, i) for i in range(REGISTERS)}
    return table


class _State:
    """Modes and bits, put together anew only where a mode has changed."""

    def __init__(self, c: "Controller") -> None:
        self._c = c
        self._of: tuple[int, ...] = ()
        self._known: tuple[int, ...] = ()

    def read(self) -> tuple[int, ...]:
        """Robot mode, safety mode, state of the program, bits of the robot, bits of safety, mode of each joint, of the tool."""
        c = self._c
        of = c.robot_mode, c.safety_mode, c.runtime
        if of != self._of:
            self._of = of
            tool = TOOL_RUNNING if c.robot_mode > 3 else TOOL_OFF
            self._known = (*map(int, of), robot_status_bits(c), safety_status_bits(c), *[joint_mode(c)] * 6, tool)
        return self._known


def target_moment(c: "Controller") -> Array:
    """(J,) torque of the rigid body at the targets, without friction: what a controller's model predicts. [N·m]."""
    moment: Array = c.moments.at(c.reference.q, c.reference.qd, c.reference.qdd)
    return moment


class Moments:
    """Inverse dynamics at the targets, computed once for equal arguments: two variables ask each tick."""

    def __init__(self, model: "pin.Model") -> None:
        self._model, self._data = model, model.createData()
        self._of: tuple[Array, Array, Array] = (np.empty(0),) * 3
        self._moment: Array = np.zeros(model.nv)

    def at(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(J,) [N·m]."""
        of = self._of
        if of[0] is not q or of[1] is not qd or of[2] is not qdd:
            self._moment = pin.rnea(self._model, self._data, q, qd, qdd).copy()
            self._of = (q, qd, qdd)
        return self._moment


class _ToolState:
    """Pose (m, rotation vector) and speed of the tool in the base's frame, (12,), computed once for equal arguments."""

    def __init__(self, c: "Controller") -> None:
        self._c = c
        self._actual, self._target = c.kinematics.watch(), c.kinematics.watch()
        self._mounting, self._upwards = c.arm.mounting, -c.arm.mounting.gravity_in_base  # three matrices' product: not every tick

    def actual(self) -> Array:
        """Of the arm as measured."""
        return self._actual.at(self._c.measured.q, self._c.measured.qd)

    def target(self) -> Array:
        """Of the arm as asked for."""
        return self._target.at(self._c.reference.q, self._c.reference.qd)

    def accelerometer(self) -> Array:
        """(3,) of the flange at rest [m/s²]: what holds it against gravity, as a real arm's reads; its own acceleration is not modelled."""
        mounting = self._c.arm.mounting
        if mounting is not self._mounting:
            self._mounting, self._upwards = mounting, -mounting.gravity_in_base
        self.actual()
        upwards: Array = self._upwards.dot(self._actual.flange.rotation)
        return upwards

    def weight(self) -> tuple[float, ...]:
        """(6,) [N, N·m] that the payload, told or not, puts on the flange at rest, in its frame: a raw sensor without bias and noise."""
        arm = self._c.arm
        if arm.payload_kg == 0.0:
            return NOTHING
        x, y, z = (-arm.payload_kg * self.accelerometer()).tolist()
        at_x, at_y, at_z = arm.payload_com_m
        return x, y, z, at_y * z - at_z * y, at_z * x - at_x * z, at_x * y - at_y * x  # r × F: np.cross takes ten times as long


def joint_mode(c: "Controller") -> int:
    """Of every joint: running or power off."""
    return JOINT_RUNNING if c.robot_mode > 3 else JOINT_POWER_OFF


def robot_status_bits(c: "Controller") -> int:
    """Power on, program running."""
    return (POWER_ON if c.robot_mode > 3 else 0) | (PROGRAM_RUNNING if c.runtime == 2 else 0)


def safety_status_bits(c: "Controller") -> int:
    """Normal; or protective or emergency stop, each with "stopped due to safety"."""
    return {1: NORMAL, 3: PROTECTIVE | STOPPED, 7: ROBOT_EMERGENCY | EMERGENCY | STOPPED}[int(c.safety_mode)]


def supply_current(c: "Controller") -> float:
    """Of the whole arm at 48 V [A]: electronics, and what the drives turn into motion and heat."""
    return ELECTRONICS_A + max(c.arm.electric_w(), 0.0) / SUPPLY_V
