"""The variables of RTDE by the manufacturer's guide: the types of the outputs, and the first version that has a variable.

A controller answers `NOT_FOUND` to a variable of a newer version. Where the guide does not give the version, a comment gives the source.
"""

import re
from typing import NamedTuple

from monitor.simulate.controller.registers import INPUT_TYPES, REGISTERS
from monitor.simulate.polyscope import Version

NOT_MODELLED = {  # published outputs that are always zero here
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
    "script_control_line": "UINT32",  # scripts are not run line by line
    "time_scale_source": "INT32",
    "collision_detection_ratio": "DOUBLE",  # the arm never hits anything
}
OUTPUT_TYPES = {  # every output that any version up to 5.23 has
    "timestamp": "DOUBLE",
    "target_q": "VECTOR6D",
    "target_qd": "VECTOR6D",
    "target_qdd": "VECTOR6D",
    "target_moment": "VECTOR6D",
    "target_current": "VECTOR6D",
    "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D",
    "actual_current": "VECTOR6D",
    "actual_current_as_torque": "VECTOR6D",
    "joint_control_output": "VECTOR6D",
    "joint_temperatures": "VECTOR6D",
    "actual_joint_voltage": "VECTOR6D",
    "actual_TCP_pose": "VECTOR6D",
    "actual_TCP_speed": "VECTOR6D",
    "target_TCP_pose": "VECTOR6D",
    "target_TCP_speed": "VECTOR6D",
    "actual_TCP_force": "VECTOR6D",
    "tcp_offset": "VECTOR6D",
    "ft_raw_wrench": "VECTOR6D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "safety_status": "INT32",
    "runtime_state": "UINT32",
    "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32",
    "joint_mode": "VECTOR6INT32",
    "tool_mode": "UINT32",
    "actual_execution_time": "DOUBLE",
    "speed_scaling": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "actual_momentum": "DOUBLE",
    "tcp_force_scalar": "DOUBLE",
    "joint_position_deviation_ratio": "DOUBLE",
    "tool_temperature": "DOUBLE",
    "actual_main_voltage": "DOUBLE",
    "actual_robot_voltage": "DOUBLE",
    "actual_robot_current": "DOUBLE",
    "actual_tool_accelerometer": "VECTOR3D",
    "payload": "DOUBLE",
    "payload_cog": "VECTOR3D",
    "payload_inertia": "VECTOR6D",
    "actual_digital_input_bits": "UINT64",
    "actual_digital_output_bits": "UINT64",
    "analog_io_types": "UINT32",
    "standard_analog_input0": "DOUBLE",
    "standard_analog_input1": "DOUBLE",
    "standard_analog_output0": "DOUBLE",
    "standard_analog_output1": "DOUBLE",
    "elbow_position": "VECTOR3D",
    "elbow_velocity": "VECTOR3D",
    "actual_current_window": "VECTOR6D",
    **NOT_MODELLED,
    **{f"output_bit_register_{i}": "BOOL" for i in range(64, 128)},  # the others are published in words of 32 bits
    **{name: kind for name, kind in INPUT_TYPES.items() if name.startswith("input_bit")},
    **{f"{way}_int_register_{i}": "INT32" for way in ("output", "input") for i in range(REGISTERS)},
    **{f"{way}_double_register_{i}": "DOUBLE" for way in ("output", "input") for i in range(REGISTERS)},
}

ALWAYS, NEVER = (0, 0, 0), (99, 0, 0)


class Since(NamedTuple):
    """The first version that has a variable, on CB3 and on the e-Series."""

    cb3: tuple[int, ...] = ALWAYS
    e_series: tuple[int, ...] = ALWAYS

    def __contains__(self, version: object) -> bool:
        """Whether a controller of this version has the variable."""
        return isinstance(version, Version) and version[:3] >= (self.cb3 if version.major < 5 else self.e_series)


UPPER = Since((3, 9, 0), (5, 3, 0))  # registers that fieldbuses do not use: bits from 64 on, the other registers from 24 on
SINCE = {
    "elbow_position": Since((3, 5, 0)),
    "elbow_velocity": Since((3, 5, 0)),
    "safety_status": Since((3, 10, 0), (5, 4, 0)),
    "payload": Since((3, 11, 0), (5, 5, 1)),
    "payload_cog": Since((3, 11, 0), (5, 5, 1)),
    "tcp_offset": Since((3, 12, 0), (5, 5, 1)),  # from the manufacturer's client library; the guide has listed it since 2025
    "script_control_line": Since((3, 14, 0), (5, 9, 0)),
    "payload_inertia": Since((3, 15, 0), (5, 11, 0)),
    "tool_output_mode": Since(NEVER, (5, 2, 0)),
    "tool_digital_output0_mode": Since(NEVER, (5, 2, 0)),
    "tool_digital_output1_mode": Since(NEVER, (5, 2, 0)),
    "ft_raw_wrench": Since(NEVER, (5, 9, 0)),  # the e-Series' own sensor
    # The configuration of the manufacturer's own recorder asks every controller for joint_position_deviation_ratio, so each has it.
    # Not in the guide of 5.11. Clients of newer controllers ask for these; the exact first version is not confirmed.
    "collision_detection_ratio": Since(NEVER, (5, 15, 0)),
    "time_scale_source": Since(NEVER, (5, 17, 0)),
    "actual_current_as_torque": Since(NEVER, (5, 23, 0)),  # ur-rtde asks for it from this version on
}
NUMBERED = re.compile(r"(?:in|out)put_(bit|int|double)_register_(\d+)")


def known(name: str, version: Version) -> bool:
    """Whether a controller of this version has the variable, if any version has it."""
    numbered = NUMBERED.fullmatch(name)
    if numbered and int(numbered[2]) >= (64 if numbered[1] == "bit" else 24):
        return version in UPPER
    return version in SINCE.get(name, Since())
