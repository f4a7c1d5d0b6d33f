"""Ports 30001 and 30002: robot state ten times a second, and messages, in the manufacturer's published layout.

Big-endian; int32 total length and uint8 type lead every message and every package within one. Layouts: Universal Robots, Primary
and Secondary Interfaces, software 5.9–5.11 and 3.14–3.15. Kinematics, configuration and internal packages are left out, as the
guide allows; what is not modelled (analogue inputs, forces) is zero.
"""

import struct
from typing import TYPE_CHECKING

import numpy as np

from monitor.simulate.wire.variables import SUPPLY_V, TOOL_OFF, TOOL_RUNNING, joint_mode, supply_current

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

STATE, MESSAGE = 16, 20
ROBOT_MODE, JOINTS, TOOL, MASTERBOARD, CARTESIAN, FORCE, ADDITIONAL = 0, 1, 2, 3, 4, 7, 8
VERSION, SAFETY, ERROR, KEY, EXCEPTION = 3, 5, 6, 7, 10
FROM_CONTROLLER = 7
POSITION_CONTROL = 0  # of the control modes
PERIOD_S = 0.1
PROTECTIVE_STOP_CODE = 153  # "C153": position deviates from path; the only one that this controller tells

_MODE = struct.Struct(">Q7?BBddd")
_JOINT = struct.Struct(">dddffffB")
_TOOL = struct.Struct(">BBddfBffB")
_BOARD = struct.Struct(">iiBBddBBddffffBBBIBBB")
_SIX = struct.Struct(">6d")
_TWELVE = struct.Struct(">12d")


def package(kind: int, payload: bytes) -> bytes:
    """Length and type in front."""
    return struct.pack(">iB", len(payload) + 5, kind) + payload


def state(c: "Controller") -> bytes:
    """One robot state message."""
    running, powered = c.runtime == 2, c.robot_mode > 3
    stopped = (c.safety_mode in (6, 7), c.safety_mode == 3)
    speed = c.speed_fraction
    mode = (int(1e6 * c.clock_s), True, True, powered, *stopped, running, c.runtime == 4, int(c.robot_mode))
    reserved = b"\0" if c.settings.polyscope.major >= 5 else b""  # one byte more since 5.0
    measured = c.measured
    joints = zip(measured.q, c.reference.q, measured.qd, measured.current, measured.temperature_c, strict=True)
    code = joint_mode(c)
    joint_data = b"".join(_JOINT.pack(q, target, qd, current, SUPPLY_V, warm, warm, code) for q, target, qd, current, warm in joints)
    tool = (0, 0, 0.0, 0.0, 0.0, 0, 0.0, c.arm.ambient_c, TOOL_RUNNING if powered else TOOL_OFF)
    board = (0, 0, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0, c.arm.ambient_c, SUPPLY_V, supply_current(c), 0.0, int(c.safety_mode), 0, 0, 0, 0, 0, 0)
    pose = np.concatenate([c.kinematics.pose(measured.q), c.kinematics.tool])
    packages = (
        package(ROBOT_MODE, _MODE.pack(*mode, POSITION_CONTROL, speed, speed, 1.0) + reserved),
        package(JOINTS, joint_data),
        package(TOOL, _TOOL.pack(*tool)),
        package(MASTERBOARD, _BOARD.pack(*board)),
        package(CARTESIAN, _TWELVE.pack(*pose)),
        package(FORCE, bytes(56)),
        package(ADDITIONAL, bytes(4)),
    )
    return package(STATE, b"".join(packages))


def _message(c: "Controller", kind: int, payload: bytes) -> bytes:
    return package(MESSAGE, struct.pack(">QbB", int(1e6 * c.clock_s), FROM_CONTROLLER, kind) + payload)


def version(c: "Controller") -> bytes:
    """First on every connection."""
    told, name = c.reported_version, b"URControl"
    head = struct.pack(">B", len(name)) + name
    return _message(
        c, VERSION, head + struct.pack(">BBii", told.major, told.minor, told.bugfix, told.build) + c.settings.build_date.encode()
    )


def key(c: "Controller", title: str, text: str) -> bytes:
    """A program has started or stopped."""
    name = title.encode()
    return _message(c, KEY, struct.pack(">iiB", 0, 0, len(name)) + name + text.encode("utf-8", "replace")[:1000])


def safety(c: "Controller") -> bytes:
    """The safety mode has changed."""
    return _message(c, SAFETY, struct.pack(">iiBII", 0, 0, int(c.safety_mode), 0, 0))


def error(c: "Controller", text: str) -> bytes:
    """What accompanies a protective stop."""
    return _message(c, ERROR, struct.pack(">iiiII", PROTECTIVE_STOP_CODE, 0, 3, 0, 0) + text.encode("utf-8", "replace")[:1000])


def exception(c: "Controller", text: str) -> bytes:
    """A program ended by a runtime exception."""
    return _message(c, EXCEPTION, struct.pack(">ii", 1, 1) + text.encode("utf-8", "replace")[:1000])
