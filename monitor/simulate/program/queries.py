"""What programs ask of a controller and declare to it; contact of the arm with something outside."""

import math
from collections.abc import Callable

import numpy as np

from monitor.recording import Array
from monitor.simulate.arm.kinematics import pose_of
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
            self._machine.supervisor.protective_stop(f"moveUntilContact: {outside.text}", joint=outside.joint)


# --- What a program declares, and what it asks of the controller: figures in the order of URScript's arguments ---

TOOL_MAX = 10.0  # largest component of a tool: [m], and [rad] in the rotation vector


def _finite(name: str, values: list[float]) -> Array:
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{name}: {values} is not finite")
    return np.array(values)


def _set_payload(machine: Machine, figures: list[float]) -> None:
    mass, *com = _finite("set_payload", [*figures, 0.0, 0.0, 0.0][:4]).tolist()
    most_kg = 2.0 * machine.robot.payload_max_kg
    if not 0.0 <= mass <= most_kg:
        raise ValueError(f"set_payload: {mass:g} kg; expected 0 … {most_kg:g}")
    if max(map(abs, com)) > PAYLOAD_COM_MAX_M:
        raise ValueError(f"set_payload: centre of mass {com}; expected within ±{PAYLOAD_COM_MAX_M:g} m of the flange")
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
        raise ValueError(f"set_tcp: {tool.tolist()}; expected 6 figures of at most {TOOL_MAX:g} m and rad")
    machine.kinematics.tool = tool


def _set_gravity(machine: Machine, figures: list[float]) -> None:
    direction = _finite("set_gravity", figures[:3])
    length = float(np.linalg.norm(direction))
    if not 1.0 < length < 20.0:
        raise ValueError(f"set_gravity: {direction} is {length:g} m/s² long; expected about 9.82")
    machine.installation.declare(gravity=-direction)  # set_gravity takes what an accelerometer at rest shows, which points upwards


DECLARATIONS: dict[str, Callable[[Machine, list[float]], None]] = {  # by URScript's name; each raises ValueError for impossible figures
    "set_payload": _set_payload,
    "set_target_payload": _set_target_payload,
    "set_tcp": _set_tcp,
    "set_gravity": _set_gravity,
}


def waypoint(machine: Machine) -> Array:
    """(6,) tool pose at the end of the last move; before any move, the present one."""
    return machine.moves.waypoint if machine.moves.waypoint is not None else machine.kinematics.pose(machine.reference.q)


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
