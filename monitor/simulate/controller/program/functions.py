"""Functions of URScript that have a value and take no time, and the arithmetic of its values."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from monitor.simulate.arm.kinematics import composed, pose_of, se3
from monitor.simulate.controller.program import queries
from monitor.simulate.controller.program.contact import touched
from monitor.simulate.controller.program.machine import Machine
from monitor.simulate.controller.program.steps import text_of

TEXT_MAX = 1023  # characters of a text, as the manufacturer's guide limits them

Value = Any  # a number, a truth value, a text, a list of values, or a pose


class Pose(list[Value]):
    """A pose p[x, y, z, rx, ry, rz]."""

    is_pose = True


class Callee(NamedTuple):
    """A function, and whether it asks for the state of the controller."""

    call: Callable[..., Value]
    asks: bool


def evaluated(operation: Callable[[Any, Any], Any], a: Value, b: Value) -> Value:
    """The result of an operation. Lists are added element by element, and multiplied by numbers.

    Raises TypeError for other kinds of values.
    """
    if isinstance(a, str) or isinstance(b, str):
        raise TypeError("a text is no number")
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            raise TypeError(f"lists of {len(a)} and {len(b)} elements")
        return [evaluated(operation, x, y) for x, y in zip(a, b, strict=True)]
    if isinstance(a, list):
        return [evaluated(operation, x, b) for x in a]
    if isinstance(b, list):
        return [evaluated(operation, a, y) for y in b]
    return operation(a, b)


def _joined(first: str, second: str) -> str:
    if len(first) + len(second) > TEXT_MAX:
        raise ValueError(f"str_cat: a text of more than {TEXT_MAX} characters")
    return first + second


def _norm(_: Machine | None, value: Value) -> float:
    return math.hypot(*map(float, value)) if isinstance(value, list) else abs(float(value))


def _solution(machine: Machine, pose: Value, near: Value) -> np.ndarray | None:
    return machine.moves.inverse(_figures(pose), None if near is None else _figures(near))


def _inverse(machine: Machine, pose: Value, near: Value = None, *_: Value) -> Value:
    """get_inverse_kin; the largest errors of position and orientation behind `near` are not modelled."""
    found = _solution(machine, pose, near)
    if found is None:
        raise ValueError(f"get_inverse_kin: no joint positions for {text_of(pose)}")
    return found.tolist()


def _forward(machine: Machine, q: Value = None, tool: Value = None) -> Value:
    at = machine.measurements.latest.q if q is None else _figures(q)
    return Pose(machine.kinematics.pose(at, None if tool is None else _figures(tool)).tolist())


def _figures(value: Value) -> np.ndarray:
    figures = np.array(value, dtype=float)
    if figures.shape != (6,) or not np.isfinite(figures).all():
        raise ValueError(f"{text_of(value)} is not a list of 6 finite figures")
    return figures


def _register(machine: Machine, kind: str, number: Value) -> Value:
    if not 0 <= int(number) < 48:
        raise ValueError(f"register {number}; expected 0 … 47")
    registers = machine.registers
    files: dict[str, list[Value]] = {
        "read_input_integer_register": registers.inputs.ints,
        "read_input_float_register": registers.inputs.doubles,
        "read_output_integer_register": registers.output_ints,
        "read_output_float_register": registers.output_doubles,
    }
    return files[kind][int(number)]


def _bit(machine: Machine, first: int, count: int, number: Value) -> bool:
    if not 0 <= int(number) < count:
        raise ValueError(f"input {number}; expected 0 … {count - 1}")
    return bool(machine.registers.digital_inputs >> (first + int(number)) & 1)


PURE: dict[str, Callable[..., Value]] = {
    "norm": _norm,
    "length": lambda _, value: len(value),
    "get_list_length": lambda _, value: len(value),
    "size": lambda _, value: len(value),
    "floor": lambda _, value: math.floor(value),
    "ceil": lambda _, value: math.ceil(value),
    "sqrt": lambda _, value: math.sqrt(value),
    "pow": lambda _, base, exponent: math.pow(base, exponent),
    "sin": lambda _, value: math.sin(value),
    "cos": lambda _, value: math.cos(value),
    "tan": lambda _, value: math.tan(value),
    "asin": lambda _, value: math.asin(value),
    "acos": lambda _, value: math.acos(value),
    "atan": lambda _, value: math.atan(value),
    "atan2": lambda _, y, x: math.atan2(y, x),
    "d2r": lambda _, value: math.radians(value),
    "r2d": lambda _, value: math.degrees(value),
    "to_str": lambda _, value: text_of(value),
    "to_num": lambda _, value: float(value),
    "str_cat": lambda _, first, second: _joined(text_of(first), text_of(second)),
    "str_len": lambda _, value: len(value),
    "pose_trans": lambda _, first, second: Pose(composed(_figures(first), _figures(second)).tolist()),
    "pose_inv": lambda _, pose: Pose(pose_of(se3(_figures(pose)).inverse()).tolist()),
    "pose_add": lambda _, first, second: Pose(_pose_add(_figures(first), _figures(second))),
    "pose_sub": lambda _, first, second: Pose(_pose_add(_figures(first), -_figures(second))),
    # modes of force control and freedrive that never begin here: their settings and ends change nothing
    **dict.fromkeys(("force_mode_set_damping", "force_mode_set_gain_scaling"), lambda _, _value: None),
    **dict.fromkeys(("end_force_mode", "end_teach_mode", "end_freedrive_mode", "zero_ftsensor"), lambda _: None),
    "get_freedrive_status": lambda _: 0,
}


def _pose_add(first: np.ndarray, second: np.ndarray) -> list[float]:
    turned = pose_of(se3(np.concatenate((np.zeros(3), first[3:]))) * se3(np.concatenate((np.zeros(3), second[3:]))))
    return [*(first[:3] + second[:3]).tolist(), *turned[3:].tolist()]


def _within(machine: Machine, target: Value) -> bool:
    """is_within_safety_limits of a pose or of joint positions."""
    figures = _figures(target)
    return machine.moves.inverse(figures) is not None if getattr(target, "is_pose", False) else not machine.limits.outside(figures)


ASKING: dict[str, Callable[..., Value]] = {
    "get_actual_joint_positions": lambda machine: machine.measurements.latest.q.tolist(),
    "get_joint_positions": lambda machine: machine.measurements.latest.q.tolist(),
    "get_actual_joint_speeds": lambda machine: machine.measurements.latest.qd.tolist(),
    "get_target_joint_positions": lambda machine: machine.reference.q.tolist(),
    "get_target_joint_speeds": lambda machine: machine.reference.qd.tolist(),
    "get_actual_tcp_pose": _forward,
    "get_target_tcp_pose": lambda machine: _forward(machine, machine.reference.q.tolist()),
    "get_forward_kin": _forward,
    "get_inverse_kin": _inverse,
    "get_tcp_offset": lambda machine: Pose(machine.kinematics.tool.tolist()),
    "get_target_tcp_speed": lambda machine: machine.kinematics.speed(machine.reference.q, machine.reference.qd).tolist(),
    "get_actual_tool_flange_pose": lambda machine: Pose(queries.flange_pose(machine).tolist()),
    "get_target_waypoint": lambda machine: Pose(queries.waypoint(machine).tolist()),
    "get_inverse_kin_has_solution": lambda machine, pose, near=None, *_: _solution(machine, pose, near) is not None,
    "is_within_safety_limits": _within,
    "get_joint_torques": lambda machine: queries.external_torque(machine).tolist(),
    "get_target_joint_accelerations": lambda machine: machine.reference.qdd.tolist(),
    "get_actual_joint_positions_history": lambda machine, steps: queries.positions_before(machine, int(steps)).tolist(),
    "tool_contact": lambda machine, *_, **_named: int(touched(machine)),
    "get_target_payload": lambda machine: machine.installation.payload[0],
    "get_target_payload_cog": lambda machine: list(machine.installation.payload[1:4]),
    "get_target_payload_inertia": lambda machine: list(machine.installation.inertia_kg_m2),
    "get_steptime": lambda machine: machine.clock.tick_s,
    "is_steady": lambda machine: machine.standing,
    **{
        f"read_{way}_{kind}_register": lambda machine, number, name=f"read_{way}_{kind}_register": _register(machine, name, number)
        for way in ("input", "output")
        for kind in ("integer", "float")
    },
    **{
        f"get_{kind}_digital_in": lambda machine, number, first=first, count=count: _bit(machine, first, count, number)
        for kind, first, count in (("standard", 0, 8), ("configurable", 8, 8), ("tool", 16, 2))
    },
}
FUNCTIONS: dict[str, Callee] = {
    **{name: Callee(call, asks=False) for name, call in PURE.items()},
    **{name: Callee(call, asks=True) for name, call in ASKING.items()},
}
