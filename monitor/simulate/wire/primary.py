"""Ports 30001 and 30002: the robot's state ten times a second, and messages, in the manufacturer's published layout.

Numbers are big-endian. Every message, and every package within a message, begins with an int32 total length and a uint8 type. Layouts:
Universal Robots, Primary and Secondary Interfaces, software 5.9–5.11 and 3.14–3.15. The packages of kinematics and configuration come in
the first state of a connection, as they do not change; internal data are left out, as the guide allows. What is not modelled (analogue
inputs, forces) is zero.
"""

import struct
import zlib
from collections.abc import Callable, Mapping

import numpy as np

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.identity import Identity
from monitor.simulate.machine.journal import ErrorMessage, ExceptionMessage, Message, ProgramMessage, SafetyMessage, TextMessage
from monitor.simulate.machine.personality import SUPPLY_V
from monitor.simulate.machine.state import Runtime, SafetyMode
from monitor.simulate.polyscope import Version
from monitor.simulate.wire.packing import Variable, constant, reader
from monitor.simulate.wire.variables import TOOL_OFF, TOOL_RUNNING, joint_mode, supply_current

# numbers of the primary interface's client protocol: kinds of message, parts of a state, kinds of text, and their sender
STATE, MESSAGE = 16, 20
ROBOT_MODE, JOINTS, TOOL, MASTERBOARD, CARTESIAN, FORCE, ADDITIONAL = 0, 1, 2, 3, 4, 7, 8
KINEMATICS, CONFIGURATION = 5, 6
TEXT, VERSION, SAFETY, ERROR, KEY, EXCEPTION = 0, 3, 5, 6, 7, 10
FROM_CONTROLLER = 7  # sender of a message
POSITION_CONTROL, TEACH_CONTROL = 0, 1  # the control modes of a robot that follows positions, and of one in freedrive
PERIOD_S = 0.1  # between two messages with the state
TEXT_MAX_BYTES = 1000  # of a message's text: a longer one is cut, so that a packet stays small
ROBOT_TYPES = {"ur5": 1, "ur10": 2, "ur3": 3, "ur16": 4, "ur20": 7, "ur30": 8}  # the manufacturer's numbers; an e-Series has the same
DEFAULT_MOTION = (1.05, 1.4, 0.25, 1.2)  # URScript's defaults: speed and acceleration of a movej and of a movel
MAX_ACCELERATION_RAD_S2 = 40.0  # what ur-rtde and the manufacturer's guide give as the largest joint acceleration

_MODE = struct.Struct(">Q7?BBddd")
_JOINT = struct.Struct(">dddffffB")
_TOOL = struct.Struct(">BBddfBffB")
_BOARD = struct.Struct(">iiBBddBBddffffBBBIBBB")
_TWELVE = struct.Struct(">12d")


def package(kind: int, payload: bytes) -> bytes:
    """A message or a package: length, type and payload."""
    return struct.pack(">iB", len(payload) + 5, kind) + payload


def state(controller: Controller, *, first: bool = False) -> bytes:
    """One message with the robot's state. The first one of a connection holds the kinematics and the configuration too."""
    modes, measured, arm = controller.modes, controller.measurements.latest, controller.arm
    stopped = (modes.safety == SafetyMode.ROBOT_EMERGENCY_STOP, modes.safety == SafetyMode.PROTECTIVE_STOP)
    playing, paused = modes.runtime == Runtime.PLAYING, modes.runtime == Runtime.PAUSED
    speed = controller.registers.speed_fraction
    mode = (_microseconds(controller.clock.now_s), True, True, modes.powered, *stopped, playing, paused, int(modes.robot))
    reserved = b"\0" if controller.settings.polyscope.major >= 5 else b""  # one byte more since 5.0
    joints = zip(measured.q, controller.reference.q, measured.qd, measured.current, measured.temperature_c, strict=True)
    code = joint_mode(modes)
    joint_data = b"".join(_JOINT.pack(q, target, qd, current, SUPPLY_V, warm, warm, code) for q, target, qd, current, warm in joints)
    tool = (0, 0, 0.0, 0.0, 0.0, 0, 0.0, arm.ambient_c, TOOL_RUNNING if modes.powered else TOOL_OFF)
    electric = (arm.ambient_c, SUPPLY_V, supply_current(arm, controller.personality), 0.0)
    board = (0, 0, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0, *electric, int(modes.safety), 0, 0, 0, 0, 0, 0)
    pose = np.concatenate([controller.kinematics.pose(measured.q), controller.kinematics.tool])
    packages = (
        package(ROBOT_MODE, _MODE.pack(*mode, TEACH_CONTROL if modes.teach_button else POSITION_CONTROL, speed, speed, 1.0) + reserved),
        package(JOINTS, joint_data),
        package(TOOL, _TOOL.pack(*tool)),
        package(MASTERBOARD, _BOARD.pack(*board)),
        package(CARTESIAN, _TWELVE.pack(*pose)),
        package(FORCE, bytes(56)),
        package(ADDITIONAL, bytes(4)),
        *((package(KINEMATICS, _kinematics(controller)), package(CONFIGURATION, _configuration(controller))) if first else ()),
    )
    return package(STATE, b"".join(packages))


def _kinematics(controller: Controller) -> bytes:
    """Denavit–Hartenberg parameters with a checksum for each joint. The simulated arm is as it was designed: its calibration is zero."""
    robot = controller.robot
    columns = (robot.zero_rad, robot.a_m, robot.d_m, robot.alpha_rad)
    checksums = [zlib.crc32(struct.pack(">4d", *joint)) for joint in zip(*columns, strict=True)]
    return struct.pack(">6I24dI", *checksums, *np.concatenate(columns), 0)


def _configuration(controller: Controller) -> bytes:
    """Limits of the joints, defaults of moves, parameters of the kinematics, and the kind of arm."""
    robot = controller.robot
    positions = [limit for joint in robot.max_position_rad for limit in (-joint, joint)]
    motions = [limit for joint in robot.max_speed_rad_s for limit in (joint, MAX_ACCELERATION_RAD_S2)]
    columns = np.concatenate((robot.a_m, robot.d_m, robot.alpha_rad, robot.zero_rad))
    kind = ROBOT_TYPES.get(controller.settings.robot.removesuffix("e"), 0)
    # equivalent radius, versions of the master board and the box, and the arm's sub type are not published: zero
    return struct.pack(">12d12d4dd24d4i", *positions, *motions, *DEFAULT_MOTION, 0.0, *columns, 0, 0, kind, 0)


def version(identity: Identity, build_date: str, at_s: float) -> bytes:
    """The message that comes first on every connection: the reported version and the date when the software was built."""
    reported, name = identity.reported_version, b"URControl"
    head = struct.pack(">B", len(name)) + name
    numbers = struct.pack(">BBii", reported.major, reported.minor, reported.bugfix, reported.build)
    return _message(at_s, VERSION, head + numbers + build_date.encode())


def encoded(message: Message) -> bytes:
    """One message of the controller's journal."""
    match message:
        case ProgramMessage(at_s, title, text):
            name = title.encode()
            return _message(at_s, KEY, struct.pack(">iiB", 0, 0, len(name)) + name + _text(text))
        case SafetyMessage(at_s, mode):
            return _message(at_s, SAFETY, struct.pack(">iiBII", 0, 0, int(mode), 0, 0))
        case ErrorMessage(at_s, text, code, argument):
            return _message(at_s, ERROR, struct.pack(">iiiII", code.number, argument, code.level, 0, 0) + _text(text))
        case ExceptionMessage(at_s, text, line, column):
            return _message(at_s, EXCEPTION, struct.pack(">ii", line, column) + _text(text))
        case TextMessage(at_s, text):
            return _message(at_s, TEXT, _text(text))


def _message(at_s: float, kind: int, payload: bytes) -> bytes:
    return package(MESSAGE, struct.pack(">QbB", _microseconds(at_s), FROM_CONTROLLER, kind) + payload)


def _text(text: str) -> bytes:
    return text.encode("utf-8", "replace")[:TEXT_MAX_BYTES]


def _microseconds(seconds: float) -> int:
    return int(1e6 * seconds)


# --- Port 30003: one packet in each control period, an int32 length and doubles, in the manufacturer's published layout ---

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


def realtime_packing(root: object, variables: Mapping[str, Variable], version: Version) -> Callable[[], bytes]:
    """A function that makes the packet of the present control period. The paths of the variables begin at the root object."""
    size = length(version.major, version.minor)
    zero = Variable("DOUBLE", constant(0.0))
    chosen = [v for entry in LAYOUT for v in ([zero] * entry if isinstance(entry, int) else [variables[entry]])]
    doubles = (size - 4) // 8
    layout, read = struct.Struct(f">i{doubles}d"), reader(root, chosen, size)
    return lambda: layout.pack(*read()[: 1 + doubles])
