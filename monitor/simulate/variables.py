"""Output variables of the RTDE interface: name, type and where the value comes from."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.inputs import INPUT_TYPES, REGISTERS

if TYPE_CHECKING:
    from monitor.simulate.controller import Controller

SUPPLY_V = 48.0
ELECTRONICS_A = 0.9  # of the whole arm at rest
JOINT_RUNNING, JOINT_POWER_OFF = 253, 239
POWER_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1  # robot_status_bits
NORMAL, PROTECTIVE, ROBOT_EMERGENCY, EMERGENCY, STOPPED = 1 << 0, 1 << 2, 1 << 6, 1 << 7, 1 << 10  # safety_status_bits


NOT_MODELLED = {  # published outputs that are constantly zero here
    "output_bit_registers0_to_31": "UINT32",
    "output_bit_registers32_to_63": "UINT32",
    "analog_io_types": "UINT32",
    "io_current": "DOUBLE",
    "euromap67_input_bits": "UINT32",
    "euromap67_output_bits": "UINT32",
    "euromap67_24V_voltage": "DOUBLE",
    "euromap67_24V_current": "DOUBLE",
    "tool_mode": "UINT32",
    "tool_output_mode": "UINT8",
    "tool_digital_output0_mode": "UINT8",
    "tool_digital_output1_mode": "UINT8",
    "tool_analog_input_types": "UINT32",
    "tool_analog_input0": "DOUBLE",
    "tool_analog_input1": "DOUBLE",
    "tool_output_voltage": "INT32",
    "tool_output_current": "DOUBLE",
    "script_control_line": "UINT32",
}


class Variable(NamedTuple):
    """RTDE's type name and a reader of the present value, always a sequence."""

    kind: str
    read: Callable[[], Sequence[float]]
    never_changes: bool = False
    register: tuple[list[int] | list[float], int] | None = None  # where it is read from, if it is one


def joined(variables: Iterable[Variable]) -> list[Callable[[], Sequence[float]]]:
    """Readers of these in order: what never changes and neighbouring registers are read together."""
    readers: list[Callable[[], Sequence[float]]] = []
    for _, group in groupby(_places(variables), key=lambda place: place[0]):
        run = [variable for _, variable in group]
        first = run[0]
        if len(run) == 1:
            readers.append(first.read)
        elif first.register is None:
            readers.append(_constant(*(value for variable in run for value in variable.read())))
        else:
            readers.append(partial(itemgetter(slice(first.register[1], first.register[1] + len(run))), first.register[0]))
    return readers


def _places(variables: Iterable[Variable]) -> Iterator[tuple[object, Variable]]:
    """Each with what it shares with those that it can be read together with."""
    for i, variable in enumerate(variables):
        if variable.register is not None:
            values, at = variable.register
            yield (id(values), at - i), variable
        else:
            yield ("never changes" if variable.never_changes else i), variable


def _constant(*values: float) -> Callable[[], Sequence[float]]:
    return lambda: values


def output_variables(c: "Controller") -> dict[str, Variable]:
    """Every output that this controller knows.

    Not modelled and constantly zero: forces at the tool, momentum, analogue inputs.
    """
    pose = _Poses(c)

    def constant(kind: str, *values: float) -> Variable:
        return Variable(kind, _constant(*values), never_changes=True)

    def vector(path: str) -> Variable:
        array = attrgetter(path)  # C all the way: ten of these are read every tick
        return Variable("VECTOR6D", lambda: array(c).tolist())

    def derived(read: Callable[[], Array]) -> Variable:
        return Variable("VECTOR6D", lambda: read().tolist())

    none6 = constant("VECTOR6D", *[0.0] * 6)
    zero = constant("DOUBLE", 0.0)
    gain = c.arm.gain_nm_per_a
    table = {
        "timestamp": Variable("DOUBLE", lambda: (c.clock_s,)),
        "target_q": vector("reference.q"),
        "target_qd": vector("reference.qd"),
        "target_qdd": vector("reference.qdd"),
        "target_moment": derived(lambda: target_moment(c)),
        "target_current": derived(lambda: target_moment(c) / gain),
        "actual_q": vector("measured.q"),
        "actual_qd": vector("measured.qd"),
        "actual_current": vector("measured.current"),
        "actual_current_as_torque": derived(lambda: c.measured.current * gain),
        "joint_control_output": derived(lambda: c.arm.torque_nm / gain),
        "joint_temperatures": vector("measured.temperature_c"),
        "actual_joint_voltage": constant("VECTOR6D", *[SUPPLY_V] * 6),
        "actual_TCP_pose": Variable("VECTOR6D", lambda: pose.actual()[0]),
        "actual_TCP_speed": Variable("VECTOR6D", lambda: pose.actual()[1]),
        "target_TCP_pose": Variable("VECTOR6D", lambda: pose.target()[0]),
        "target_TCP_speed": Variable("VECTOR6D", lambda: pose.target()[1]),
        "actual_TCP_force": none6,
        "ft_raw_wrench": none6,
        "payload_inertia": none6,
        "joint_mode": Variable("VECTOR6INT32", lambda: [joint_mode(c)] * 6),
        "robot_mode": Variable("INT32", lambda: (int(c.robot_mode),)),
        "safety_mode": Variable("INT32", lambda: (int(c.safety_mode),)),
        "safety_status": Variable("INT32", lambda: (int(c.safety_mode),)),
        "runtime_state": Variable("UINT32", lambda: (int(c.runtime),)),
        "robot_status_bits": Variable("UINT32", lambda: (robot_status_bits(c),)),
        "safety_status_bits": Variable("UINT32", lambda: (safety_status_bits(c),)),
        "actual_execution_time": constant("DOUBLE", 1e3 * c.tick_s / 4),
        "speed_scaling": Variable("DOUBLE", lambda: (c.speed_fraction,)),
        "target_speed_fraction": Variable("DOUBLE", lambda: (c.speed_fraction,)),
        "actual_momentum": zero,
        "tcp_force_scalar": zero,
        "joint_position_deviation_ratio": zero,
        "collision_detection_ratio": zero,
        "tool_temperature": Variable("DOUBLE", lambda: (c.arm.ambient_c,)),
        "actual_main_voltage": constant("DOUBLE", SUPPLY_V),
        "actual_robot_voltage": constant("DOUBLE", SUPPLY_V),
        "actual_robot_current": Variable("DOUBLE", lambda: (supply_current(c),)),
        "actual_tool_accelerometer": Variable("VECTOR3D", lambda: pose.accelerometer().tolist()),
        "payload": Variable("DOUBLE", lambda: c.declared_payload[:1]),
        "payload_cog": Variable("VECTOR3D", lambda: c.declared_payload[1:]),
        "actual_digital_input_bits": Variable("UINT64", lambda: (c.digital_inputs,)),
        "actual_digital_output_bits": Variable("UINT64", lambda: (c.outputs.digital,)),
        **{f"standard_analog_input{i}": zero for i in (0, 1)},
        "standard_analog_output0": Variable("DOUBLE", lambda: (c.outputs.analog[0],)),
        "standard_analog_output1": Variable("DOUBLE", lambda: (c.outputs.analog[1],)),
        "elbow_position": Variable("VECTOR3D", lambda: c.kinematics.elbow(c.measured.q).tolist()),
        "elbow_velocity": Variable("VECTOR3D", lambda: c.kinematics.elbow_speed(c.measured.q, c.measured.qd).tolist()),
        "actual_current_window": Variable("VECTOR6D", (0.1 * c.robot.max_torque_nm / gain).tolist),
        **{name: constant(kind, *[0] * (1 if kind != "VECTOR6D" else 6)) for name, kind in NOT_MODELLED.items()},
        **{f"output_bit_register_{i}": constant("BOOL", False) for i in range(128)},
        **{f"input_bit_register_{i}": constant("BOOL", False) for i in range(64)},
        **{
            name: Variable(kind, lambda name=name: (c.inputs.others.get(name, 0),))  # type: ignore[misc,arg-type]
            for name, kind in INPUT_TYPES.items()
            if name.startswith("input_bit")
        },
    }

    def register(kind: str, values: list[int] | list[float], i: int) -> Variable:
        return Variable(kind, lambda: (values[i],), register=(values, i))

    for i in range(REGISTERS):
        table[f"output_int_register_{i}"] = register("INT32", c.output_ints, i)
        table[f"output_double_register_{i}"] = register("DOUBLE", c.output_doubles, i)
        for name, source in ((f"input_int_register_{i}", c.inputs.ints), (f"input_double_register_{i}", c.inputs.doubles)):
            table[name] = register(INPUT_TYPES[name], source, i)
    return table


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


class _Poses:
    """Pose (m, rotation vector) and speed of the tool in the base's frame, computed once for equal arguments."""

    def __init__(self, c: "Controller") -> None:
        self._c = c
        nothing: tuple[Array, Array, Array] = (np.empty(0),) * 3
        self._of = {"actual": nothing, "target": nothing}
        self._known: dict[str, tuple[list[float], list[float]]] = {}
        self._rotation: dict[str, Array] = {}  # (3, 3) flange → base
        self._mounting, self._upwards = c.arm.mounting, -c.arm.mounting.gravity_in_base  # three matrices' product: not every tick

    def actual(self) -> tuple[list[float], list[float]]:
        return self._at("actual", self._c.measured.q, self._c.measured.qd)

    def target(self) -> tuple[list[float], list[float]]:
        return self._at("target", self._c.reference.q, self._c.reference.qd)

    def accelerometer(self) -> Array:
        """(3,) of the flange at rest [m/s²]: what holds it against gravity, as a real arm's reads; its own acceleration is not modelled."""
        mounting = self._c.arm.mounting
        if mounting is not self._mounting:
            self._mounting, self._upwards = mounting, -mounting.gravity_in_base
        self.actual()
        upwards: Array = self._upwards.dot(self._rotation["actual"])
        return upwards

    def _at(self, key: str, q: Array, qd: Array) -> tuple[list[float], list[float]]:
        kinematics, of = self._c.kinematics, self._of[key]
        if of[0] is not q or of[1] is not qd or of[2] is not kinematics.tool:
            self._of[key] = (q, qd, kinematics.tool)
            self._known[key], self._rotation[key] = kinematics.state(q, qd)
        return self._known[key]


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
