"""What ur-rtde's control script answers at once: settings, kinematics, limits, dynamics; by the number of the command."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.kinematics import composed, pose_of
from monitor.simulate.settings import PAYLOAD_COM_MAX_M

if TYPE_CHECKING:
    from monitor.simulate.controller.program.control import ControlProgram

Result = bool | int | Array | None
STEADY_RAD_S = 0.01
TOOL_MAX = 10.0  # m, and rad of the rotation vector


class Impossible(Exception):
    """The real controller would end the program with a runtime exception."""


def _finite(name: str, values: list[float]) -> Array:
    if not all(map(math.isfinite, values)):
        raise Impossible(f"{name}: {values} is not finite")
    return np.array(values)


def _set_payload(p: "ControlProgram") -> Result:
    mass, *com = _finite("set_payload", p.vector(0, 4))
    controller = p.controller
    if not 0.0 <= mass <= 2.0 * controller.robot.payload_max_kg:
        raise Impossible(f"set_payload: {mass:g} kg; expected 0 … {2.0 * controller.robot.payload_max_kg:g}")
    if max(map(abs, com)) > PAYLOAD_COM_MAX_M:
        raise Impossible(f"set_payload: centre of mass {com}; expected within ±{PAYLOAD_COM_MAX_M:g} m of the flange")
    # a centre of mass at the flange itself means "as before" from 5.0 on, says the script
    before = controller.declared_payload[1:]
    keep = not any(com) and controller.settings.polyscope.major >= 5
    controller.declare(payload=(float(mass), *(before if keep else (float(x) for x in com))))
    return None


def _set_target_payload(p: "ControlProgram") -> Result:
    inertia = _finite("set_target_payload", p.vector(4, 6))
    _set_payload(p)
    p.controller.declared_inertia = tuple(inertia.tolist())
    return None


def _set_tcp(p: "ControlProgram") -> Result:
    tool = _finite("set_tcp", p.vector())
    if np.abs(tool).max() > TOOL_MAX:
        raise Impossible(f"set_tcp: {tool.tolist()}; expected at most {TOOL_MAX:g} m and rad")
    p.controller.kinematics.tool = tool
    return None


def _set_gravity(p: "ControlProgram") -> Result:
    direction = _finite("set_gravity", p.vector(0, 3))
    length = float(np.linalg.norm(direction))
    if not 1.0 < length < 20.0:
        raise Impossible(f"set_gravity: {direction} is {length:g} m/s² long; expected about 9.82")
    p.controller.declare(gravity=-direction)  # it is given as the acceleration that a sensor at rest would show, upwards
    return None


def _pose_within(p: "ControlProgram") -> Result:
    pose = np.array(p.vector())
    return bool(np.isfinite(pose).all()) and p.controller.moves.inverse(pose) is not None


def _joints_within(p: "ControlProgram") -> Result:
    q = np.array(p.vector())
    return bool(np.isfinite(q).all()) and not p.controller.limits.outside(q)


def _steady(p: "ControlProgram") -> Result:
    return p.controller.reference.at_rest and bool(np.all(np.abs(p.controller.measured.qd) < STEADY_RAD_S))


def _inverse(p: "ControlProgram", near: Array | None = None) -> Array:
    pose = _finite("get_inverse_kin", p.vector())
    found = p.controller.moves.inverse(pose, near)
    if found is None:
        raise Impossible(f"get_inverse_kin: no joint positions for {pose.round(4).tolist()}")
    return found


def _inverse_near(p: "ControlProgram") -> Result:
    return _inverse(p, _finite("get_inverse_kin", p.vector(6)))


def _has_solution(p: "ControlProgram") -> Result:
    try:
        _inverse(p)
    except Impossible:
        return False
    return True


def _has_solution_near(p: "ControlProgram") -> Result:
    try:
        _inverse_near(p)
    except Impossible:
        return False
    return True


def _forward_of(p: "ControlProgram") -> Result:
    q, tool = _finite("get_forward_kin", p.vector()), _finite("get_forward_kin", p.vector(6))
    return p.controller.kinematics.pose(q, tool)


def _forward(p: "ControlProgram") -> Result:
    return p.controller.kinematics.pose(p.controller.measured.q)


def _tcp_offset(p: "ControlProgram") -> Result:
    return p.controller.kinematics.tool


def _waypoint(p: "ControlProgram") -> Result:
    return (
        p.controller.moves.waypoint if p.controller.moves.waypoint is not None else p.controller.kinematics.pose(p.controller.reference.q)
    )


def _pose_trans(p: "ControlProgram") -> Result:
    return composed(_finite("pose_trans", p.vector()), _finite("pose_trans", p.vector(6)))


ONCE: dict[int, Callable[["ControlProgram"], Result]] = {
    17: _set_payload,
    28: _waypoint,
    29: _set_tcp,
    30: _inverse_near,
    36: _pose_within,
    37: _joints_within,
    39: _pose_trans,
    40: _tcp_offset,
    43: _forward,
    44: _forward_of,
    46: _inverse,
    47: _steady,
    59: _set_gravity,
    60: _has_solution,
    61: _has_solution_near,
    65: _set_target_payload,
}


def _step_time(p: "ControlProgram") -> None:
    p.answer(np.array([p.controller.tick_s]))


def _history(p: "ControlProgram") -> None:
    history = p.controller.history
    back = min(max(p.whole(1), 0), len(history) - 1)
    p.answer(history[-1 - back])


def _external_torque(p: "ControlProgram") -> None:
    """What neither the model of the arm nor friction explains: an untold payload shows here."""
    controller = p.controller
    arm, reference = controller.arm, controller.reference
    p.answer(arm.torque_nm - controller.moments.at(reference.q, reference.qd, reference.qdd) - arm.friction_nm)


def _flange(p: "ControlProgram") -> None:
    p.answer(pose_of(p.controller.kinematics.flange(p.controller.measured.q)))


def _contact(p: "ControlProgram") -> None:
    p.answer(0)  # nothing is ever touched


REALTIME: dict[int, Callable[["ControlProgram"], None]] = {
    25: _contact,
    26: _step_time,
    27: _history,
    38: _external_torque,
    58: _flange,
}
