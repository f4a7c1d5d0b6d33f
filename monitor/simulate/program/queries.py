"""Contact of the arm with something outside, as programs ask for it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.kinematics import composed, pose_of
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.moves import Move, StopMotion
from monitor.simulate.settings import PAYLOAD_COM_MAX_M

TOUCH_NM = 2.0  # a joint torque from outside that counts as a contact; a real arm notices about 20 N at its tool
STOP_M_S2 = 3.0  # deceleration after a contact, as in ur-rtde's script
BACK_M_S, BACK_M_S2 = 0.25, 1.2  # URScript's defaults of the movel back to where the contact began


def touched(machine: Machine) -> bool:
    """Whether something presses against the arm."""
    arm = machine.arm
    return arm.contact is not None and float(np.abs(arm.contact.torque_nm(arm.q)).max()) > TOUCH_NM


class UntilContact:
    """ur-rtde's moveUntilContact: the tool moves at a speed until it touches something, stops, and goes back to where it touched first.

    Where nothing is in its way the arm goes on to its limits, and ends in a protective stop there.
    """

    def __init__(self, machine: Machine, speed: Array, acceleration: float) -> None:
        """`speed` (6,) is that of the tool along the base's axes [m/s, rad/s]."""
        self._machine, self._speed, self._acceleration = machine, speed, acceleration
        self._touched_at: Array | None = None
        self._going_back = False

    def over(self) -> bool:
        """Go on by one control period. Returns whether the motion has ended."""
        machine = self._machine
        if not machine.modes.may_move:
            return False
        if self._touched_at is None:
            self._advance()
            return False
        if not machine.moves.over:
            return False
        if self._going_back:
            return True
        self._going_back = True
        back = Move(tuple(self._touched_at.tolist()), pose=False, straight=True, speed=BACK_M_S, acceleration=BACK_M_S2)
        return bool(machine.moves.start(back))  # an obstacle: the arm stays where it stopped

    def _advance(self) -> None:
        machine = self._machine
        if touched(machine):
            self._touched_at = machine.measurements.latest.q.copy()
            machine.moves.stop(StopMotion(STOP_M_S2, straight=True))
        elif np.isfinite(self._speed).all() and math.isfinite(self._acceleration):
            machine.moves.tool_speed(self._speed, self._acceleration)
            self._stop_at_limits()
        else:
            machine.supervisor.protective_stop("moveUntilContact with a figure that is not a number")

    def _stop_at_limits(self) -> None:
        outside = self._machine.limits.outside(self._machine.reference.q)
        if outside:
            self._machine.supervisor.protective_stop(f"moveUntilContact: {outside}")


# --- Commands of ur-rtde's control script that end at once: settings, kinematics, limits and dynamics, by the number of the command ---

Result = bool | int | Array | None  # what a command writes to the output registers
STEADY_RAD_S = 0.01  # measured joint speed below which the robot counts as steady
TOOL_MAX = 10.0  # largest component of a tool: [m], and [rad] in the rotation vector


class ImpossibleArguments(Exception):
    """The real controller would end the program with a runtime exception."""


@dataclass(frozen=True, slots=True)
class Call:
    """The arguments of a command in the input registers, and the machine that executes it."""

    machine: Machine
    int_offset: int  # first integer register of the control script
    double_offset: int  # first double register of the control script

    def integer(self, index: int) -> int:
        """One integer argument; the first is the number of the command."""
        return self.machine.registers.inputs.ints[self.int_offset + index]

    def vector(self, index: int = 0, length: int = 6) -> list[float]:
        """Consecutive double arguments, from `index` on."""
        at = self.double_offset + index
        return self.machine.registers.inputs.doubles[at : at + length]


def _finite(name: str, values: list[float]) -> Array:
    if not all(map(math.isfinite, values)):
        raise ImpossibleArguments(f"{name}: {values} is not finite")
    return np.array(values)


def _set_payload(machine: Machine, figures: list[float]) -> None:
    mass, *com = _finite("set_payload", [*figures, 0.0, 0.0, 0.0][:4]).tolist()
    most_kg = 2.0 * machine.robot.payload_max_kg
    if not 0.0 <= mass <= most_kg:
        raise ImpossibleArguments(f"set_payload: {mass:g} kg; expected 0 … {most_kg:g}")
    if max(map(abs, com)) > PAYLOAD_COM_MAX_M:
        raise ImpossibleArguments(f"set_payload: centre of mass {com}; expected within ±{PAYLOAD_COM_MAX_M:g} m of the flange")
    # from 5.0 on, a centre of mass at the flange itself keeps the present one: ur-rtde's script says so
    keep = not any(com) and machine.settings.polyscope.major >= 5
    machine.installation.declare(payload=(mass, *(machine.installation.payload[1:] if keep else com)))


def _set_target_payload(machine: Machine, figures: list[float]) -> None:
    inertia = _finite("set_target_payload", [*figures[4:10], *[0.0] * 6][:6])  # the transition time behind it is not modelled
    _set_payload(machine, figures[:4])
    machine.installation.inertia_kg_m2 = tuple(inertia.tolist())


def _set_tcp(machine: Machine, figures: list[float]) -> None:
    tool = _finite("set_tcp", figures[:6])
    if tool.shape != (6,) or np.abs(tool).max() > TOOL_MAX:
        raise ImpossibleArguments(f"set_tcp: {tool.tolist()}; expected 6 figures of at most {TOOL_MAX:g} m and rad")
    machine.kinematics.tool = tool


def _set_gravity(machine: Machine, figures: list[float]) -> None:
    direction = _finite("set_gravity", figures[:3])
    length = float(np.linalg.norm(direction))
    if not 1.0 < length < 20.0:
        raise ImpossibleArguments(f"set_gravity: {direction} is {length:g} m/s² long; expected about 9.82")
    machine.installation.declare(gravity=-direction)  # set_gravity takes what an accelerometer at rest shows, which points upwards


DECLARATIONS: dict[str, Callable[[Machine, list[float]], None]] = {  # what a program declares, by URScript's name; figures in its order
    "set_payload": _set_payload,
    "set_target_payload": _set_target_payload,
    "set_tcp": _set_tcp,
    "set_gravity": _set_gravity,
}


def _declaring(name: str, figures: int) -> Callable[[Call], Result]:
    """The command of ur-rtde's script that declares something, with so many figures in the registers."""

    def declare(call: Call) -> Result:
        DECLARATIONS[name](call.machine, call.vector(0, figures))
        return None

    return declare


def _pose_within(call: Call) -> Result:
    pose = np.array(call.vector())
    return bool(np.isfinite(pose).all()) and call.machine.moves.inverse(pose) is not None


def _joints_within(call: Call) -> Result:
    q = np.array(call.vector())
    return bool(np.isfinite(q).all()) and not call.machine.limits.outside(q)


def _steady(call: Call) -> Result:
    return call.machine.reference.at_rest and bool(np.all(np.abs(call.machine.measurements.latest.qd) < STEADY_RAD_S))


def _inverse(call: Call, near: Array | None = None) -> Array:
    pose = _finite("get_inverse_kin", call.vector())
    found = call.machine.moves.inverse(pose, near)
    if found is None:
        raise ImpossibleArguments(f"get_inverse_kin: no joint positions for {pose.round(4).tolist()}")
    return found


def _inverse_near(call: Call) -> Result:
    return _inverse(call, _finite("get_inverse_kin", call.vector(6)))


def _solvable(inverse: Callable[[Call], Result]) -> Callable[[Call], Result]:
    def has_solution(call: Call) -> Result:
        try:
            inverse(call)
        except ImpossibleArguments:
            return False
        return True

    return has_solution


def _forward_of(call: Call) -> Result:
    q, tool = _finite("get_forward_kin", call.vector()), _finite("get_forward_kin", call.vector(6))
    return call.machine.kinematics.pose(q, tool)


def _forward(call: Call) -> Result:
    return call.machine.kinematics.pose(call.machine.measurements.latest.q)


def _tcp_offset(call: Call) -> Result:
    return call.machine.kinematics.tool


def waypoint(machine: Machine) -> Array:
    """(6,) tool pose at the end of the last move; before any move, the present one."""
    return machine.moves.waypoint if machine.moves.waypoint is not None else machine.kinematics.pose(machine.reference.q)


def _pose_trans(call: Call) -> Result:
    return composed(_finite("pose_trans", call.vector()), _finite("pose_trans", call.vector(6)))


ONCE: dict[int, Callable[[Call], Result]] = {  # executed once
    17: _declaring("set_payload", 4),
    28: lambda call: waypoint(call.machine),
    29: _declaring("set_tcp", 6),
    30: _inverse_near,
    36: _pose_within,
    37: _joints_within,
    39: _pose_trans,
    40: _tcp_offset,
    43: _forward,
    44: _forward_of,
    46: _inverse,
    47: _steady,
    59: _declaring("set_gravity", 3),
    60: _solvable(_inverse),
    61: _solvable(_inverse_near),
    65: _declaring("set_target_payload", 10),
}


def _step_time(call: Call) -> Result:
    return np.array([call.machine.clock.tick_s])


def positions_before(machine: Machine, steps: int) -> Array:
    """(J,) measured joint positions so many control periods ago; the oldest one where the history is shorter."""
    history = machine.measurements.history
    return history[-1 - min(max(steps, 0), len(history) - 1)]


def external_torque(machine: Machine) -> Array:
    """(J,) torque that neither the controller's model nor friction explains, for example that of an undeclared payload [N·m]."""
    arm = machine.arm
    external: Array = arm.torque_nm - machine.installation.target_moment(machine.reference) - arm.friction_nm
    return external


def flange_pose(machine: Machine) -> Array:
    """(6,) measured pose of the flange."""
    return pose_of(machine.kinematics.flange(machine.measurements.latest.q))


def _contact(call: Call) -> Result:
    return int(touched(call.machine))  # how many control periods ago the contact began: it is noticed at once


def _not_free(_: Call) -> Result:
    return 0  # get_freedrive_status: freedrive is never on


def _target_acceleration(call: Call) -> Result:
    return call.machine.reference.qdd


ONCE |= {54: _not_free, 63: _contact, 64: _contact}
REALTIME: dict[int, Callable[[Call], Result]] = {  # executed in every control period
    25: _contact,
    26: _step_time,
    27: lambda call: positions_before(call.machine, call.integer(1)),
    38: lambda call: external_torque(call.machine),
    58: lambda call: flange_pose(call.machine),
    69: _target_acceleration,
}
