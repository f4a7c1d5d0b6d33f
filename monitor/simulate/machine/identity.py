"""The variables of RTDE by the manufacturer's guide: the types of the outputs, and the first version that has a variable.

A controller answers `NOT_FOUND` to a variable of a newer version. Where the guide does not give the version, a comment gives the source.
"""

import re

from monitor.errors import BadInput
from monitor.simulate.machine.registers import INPUT_TYPES, REGISTERS
from monitor.simulate.polyscope import Since, Version, X, knows
from monitor.simulate.settings import SimulateSettings

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
    "actual_robot_energy_consumed": "DOUBLE",
}
OUTPUT_TYPES = {  # every output that any version up to 5.23 has, and what is known of later ones
    "timestamp": "DOUBLE",
    "control_step": "UINT64",
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

UPPER: Since = ((3, 9), (5, 3))  # registers that fieldbuses do not use: bits from 64 on, the other registers from 24 on
SINCE: dict[str, Since] = {  # a variable that is not here is one of every version
    "elbow_position": ((3, 5),),
    "elbow_velocity": ((3, 5),),
    "safety_status": ((3, 10), (5, 4)),
    "payload": ((3, 11), (5, 5, 1)),
    "payload_cog": ((3, 11), (5, 5, 1)),
    "tcp_offset": ((3, 12), (5, 5, 1)),  # from the manufacturer's client library; the guide has listed it since 2025
    "script_control_line": ((3, 14), (5, 9)),
    "payload_inertia": ((3, 15), (5, 11)),
    "tool_output_mode": ((5, 2),),
    "tool_digital_output0_mode": ((5, 2),),
    "tool_digital_output1_mode": ((5, 2),),
    "ft_raw_wrench": ((5, 9),),  # the e-Series' own sensor
    # The configuration of the manufacturer's own recorder asks every controller for joint_position_deviation_ratio, so each has it.
    # Not in the guide of 5.11. Clients of newer controllers ask for these; the exact first version is not confirmed.
    "collision_detection_ratio": ((5, 15),),
    "time_scale_source": ((5, 17),),
    "actual_current_as_torque": ((5, 23),),  # ur-rtde asks for it from this version on
    "actual_robot_energy_consumed": ((5, 23), (10, 11)),  # these two from the manufacturer's client library
    "control_step": ((5, 26), (10, 13)),
}
NUMBERED = re.compile(r"(?:in|out)put_(bit|int|double)_register_(\d+)")


def known(name: str, version: Version) -> bool:
    """Whether a controller of this version has the variable, if any version has it."""
    numbered = NUMBERED.fullmatch(name)
    if numbered and int(numbered[2]) >= (64 if numbered[1] == "bit" else 24):
        return knows(version, UPPER)
    return name not in SINCE or knows(version, SINCE[name])


# --- What a controller reports about itself: version, control mode, roles, serial numbers and known variables ---


class Identity:
    """The self-description of one controller. The pendant, the dashboard and faults change parts of it."""

    def __init__(self, settings: SimulateSettings) -> None:
        self._settings, self._polyscope = settings, settings.polyscope
        self.reported_version, self.remote_control = settings.polyscope, settings.remote_control
        # the dashboard sets them; a PolyScope X is always in one of two modes
        self.user_role, self.operational_mode = "PROGRAMMER", "AUTOMATIC" if settings.polyscope.major >= X else "NONE"
        self.joint_serials = [f"{settings.serial}-{i + 1}" for i in range(settings.arm.joints)]
        self.missing_outputs: set[str] = set()  # a fault hides these output variables

    def set_manual(self, on: bool) -> None:
        """Switch between manual and automatic mode at the pendant. Remote control is only possible in automatic mode."""
        self.operational_mode = "MANUAL" if on else "AUTOMATIC"
        if on:
            self.remote_control = False

    @property
    def local(self) -> bool:
        """Whether the pendant has taken control: commands over the network are then refused. A CB3 has no such mode."""
        return not self.remote_control and self._polyscope.major >= 5

    def take_over(self, before: "Identity") -> None:
        """Keep what a restart does not change: the joints in the arm."""
        self.joint_serials = before.joint_serials

    def knows(self, name: str) -> bool:
        """Whether this version of PolyScope has a variable of this name, if any version has it."""
        return known(name, self._polyscope)

    def publishes(self, name: str) -> bool:
        """Whether a client can subscribe to the output variable of this name now."""
        return name in OUTPUT_TYPES and self.knows(name) and name not in self.missing_outputs

    def outputs(self, names: str) -> list[str]:
        """The output variables in a comma-separated list of names.

        Raises BadInput with the names that this controller does not have.
        """
        wanted = [name for name in names.split(",") if name]
        unknown = [name for name in wanted if name not in OUTPUT_TYPES or not self.knows(name)]
        if unknown:
            raise BadInput(f"fault not_found: {', '.join(unknown)} is no output of this controller")
        return wanted

    def restore(self) -> None:
        """Report again what the settings say."""
        self.reported_version, self.remote_control = self._polyscope, self._settings.remote_control
        if self._polyscope.major >= X:
            self.operational_mode = "AUTOMATIC"
        self.missing_outputs.clear()
