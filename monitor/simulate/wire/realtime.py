"""Port 30003: one packet in each control period, an int32 length and doubles, in the manufacturer's published layout.

Lengths by version: 1108 bytes (3.5, 5.0), 1116 (3.10, 5.4), 1140 (3.14, 5.9), 1220 (3.15, 5.10). The lengths of the e-Series are the
manufacturer's. Those of CB3 follow from the releases that came at the same time and have not been compared with a real controller.
"""

import struct
from collections.abc import Callable, Mapping

from monitor.simulate.polyscope import Version
from monitor.simulate.wire.packing import Variable, constant, reader

# Doubles: a variable of RTDE, or a count of zeros where the manufacturer keeps the meaning to itself or the value is not modelled.
LAYOUT: tuple[str | int, ...] = (
    "timestamp",
    "target_q",
    "target_qd",
    "target_qdd",
    "target_current",
    "target_moment",
    "actual_q",
    "actual_qd",
    "actual_current",
    "joint_control_output",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "target_TCP_pose",
    "target_TCP_speed",
    "actual_digital_input_bits",
    "joint_temperatures",
    "actual_execution_time",
    1,  # test value
    "robot_mode",
    "joint_mode",
    "safety_mode",
    6,
    "actual_tool_accelerometer",
    6,
    "speed_scaling",
    "actual_momentum",
    2,
    "actual_main_voltage",
    "actual_robot_voltage",
    "actual_robot_current",
    "actual_joint_voltage",
    "actual_digital_output_bits",
    "runtime_state",
    "elbow_position",
    "elbow_velocity",
    "safety_status",
    3,
    "payload",
    "payload_cog",
    "payload_inertia",
)
LENGTHS = {  # of a PolyScope X: as 5.10, not verified
    **{(3, 0): 1108, (3, 10): 1116, (3, 14): 1140, (3, 15): 1220},
    **{(5, 0): 1108, (5, 4): 1116, (5, 9): 1140, (5, 10): 1220, (10, 0): 1220},
}


def length(major: int, minor: int) -> int:
    """The length of one packet of this version, in bytes."""
    return LENGTHS[max(since for since in LENGTHS if since[0] == major and since <= (major, minor))]


def packing(root: object, variables: Mapping[str, Variable], version: Version) -> Callable[[], bytes]:
    """A function that makes the packet of the present control period. The paths of the variables begin at the root object."""
    size = length(version.major, version.minor)
    zero = Variable("DOUBLE", constant(0.0))
    chosen = [v for entry in LAYOUT for v in ([zero] * entry if isinstance(entry, int) else [variables[entry]])]
    doubles = (size - 4) // 8
    layout, read = struct.Struct(f">i{doubles}d"), reader(root, chosen, size)
    return lambda: layout.pack(*read()[: 1 + doubles])
