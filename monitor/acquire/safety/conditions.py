"""The conditions under which an arm may move, each by its name: does it hold, and what was found.

One pure function, `conditions`, looks at everything that is known and says all of it; `joint-monitor check` prints what it says, a
replay logs it and refuses at the first that does not hold. What a controller does not report cannot speak against a motion: such a
condition holds, is marked as not checked, and says what that means. What should be known and is not, speaks against it.
"""

import ipaddress
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.acquire.path import joint_path
from monitor.acquire.safety.limits import clear_approach, clear_of, within_limits
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import (
    ROBOT_MODE_RUNNING,
    ROBOT_MODES,
    RUNTIME_STATES,
    RUNTIME_STOPPED,
    SAFETY_BITS_NORMAL,
    SAFETY_MODE_NORMAL,
    SAFETY_MODES,
    STANDSTILL_RAD_S,
    ArmState,
    Identity,
)
from monitor.design.clearance import frames
from monitor.errors import MotionRefused
from monitor.model.fourier import Excitation
from monitor.model.robot import STANDARD_GRAVITY_M_S2, Mounting, Robot
from monitor.recording import Array, Context

HOLD_ERROR_RAD = 0.05  # an arm that holds its pose has its target within this of its position
ACCELEROMETER_ERROR_M_S2 = 1.5  # a real arm's reads 9.28 at rest; further off it is broken, or the arm does not stand
PRIVATE_NETWORKS = tuple(ipaddress.IPv4Network(network) for network in ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16"))  # RFC 1918


class Permit(NamedTuple):
    """What somebody else said when asked whether the arm may move."""

    given: bool
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionResult:
    """One condition: whether it holds, and what was found. Not checked: the controller does not report what it needs."""

    name: str
    holds: bool
    text: str
    checked: bool = True

    @property
    def status(self) -> str:
        """For a table: ok, NO or not checked."""
        return ("ok" if self.checked else "not checked") if self.holds else "NO"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConditionInputs:
    """Everything that is known when somebody asks whether the arm may move."""

    settings: ReplaySettings
    excitation: Excitation
    robot: Robot
    context: Context  # what the configuration says of the arm
    now_unix_s: float
    identity: Identity | None  # None: the dashboard does not answer
    state: ArmState | None  # None: no RTDE data
    stopped_before: str | None = None  # a stop that nobody has acknowledged, in words
    permit: Permit | None = None  # the answer over Zenoh; None: nobody was asked


class Unreported(Exception):
    """A condition cannot be checked: what the controller does not say, and what that means."""


def conditions(facts: ConditionInputs) -> tuple[ConditionResult, ...]:
    """All of them, in the order in which a person would look."""
    return tuple(_found(name, check, facts) for name, check in CHECKS.items())


def refuse_unless(found: tuple[ConditionResult, ...]) -> None:
    """Raises MotionRefused with the name of the first condition that does not hold, and what was found."""
    for condition in found:
        if not condition.holds:
            raise MotionRefused(f"{condition.name}: {condition.text}")


def _found(name: str, check: Callable[[ConditionInputs], str], facts: ConditionInputs) -> ConditionResult:
    try:
        return ConditionResult(name=name, holds=True, text=check(facts))
    except MotionRefused as why:
        return ConditionResult(name=name, holds=False, text=str(why))
    except Unreported as why:
        return ConditionResult(name=name, holds=True, text=str(why), checked=False)


# --- what the configuration says ------------------------------------------------------------------------------


def _motion_allowed(facts: ConditionInputs) -> str:
    if facts.settings.allow_motion is not True:
        raise MotionRefused("motion is not allowed: allow_motion is false (set it to true to let this arm move)")
    return "allow_motion is true"


def _address(facts: ConditionInputs) -> str:
    return check_address(facts.settings)


def check_address(settings: ReplaySettings) -> str:
    """Raises MotionRefused unless the address is a literal one of this machine, or of a private network with every guard on."""
    host = settings.host
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:
        raise MotionRefused(f"host {host!r}: expected a literal IPv4 address; a name may come to mean another arm") from None
    if address.is_loopback:
        return f"{host} is a simulated arm"
    if not address.is_link_local and not any(address in network for network in PRIVATE_NETWORKS):
        raise MotionRefused(f"host {host}: expected an address of this machine or of a private network")
    if not settings.first_pass:
        raise MotionRefused(f"host {host} is a real arm, and first_pass is false: only a simulated one may go without")
    if settings.cell is None:
        raise MotionRefused(f"host {host} is a real arm, and its cell is unchecked: describe what stands around it")
    return f"{host} is a real arm: first passes are slow, clearances are proved"


def _time_window(facts: ConditionInputs) -> str:
    left = facts.settings.minutes_left(facts.now_unix_s)
    if left is None:
        raise MotionRefused(f"now is outside every allowed window: {', '.join(facts.settings.windows_utc)} UTC")
    needed = (facts.excitation.duration_s + _there_and_back_s(facts)) / 60.0
    if left < needed:
        raise MotionRefused(f"the window closes in {left:.1f} minutes, the motion alone takes {needed:.1f}")
    return "at any time" if math.isinf(left) else f"open for another {left:.0f} minutes"


def _there_and_back_s(facts: ConditionInputs) -> float:
    """The way to the start and back, where it is known where the arm stands."""
    if facts.state is None or not np.all(np.isfinite(facts.state.target_q)):
        return 0.0
    settings, start_q = facts.settings, facts.excitation.at(np.zeros(1)).q[0]
    way = joint_path(
        facts.state.target_q, start_q, speed_rad_s=settings.approach_speed_rad_s, acceleration_rad_s2=settings.approach_acceleration_rad_s2
    )
    return 2.0 * way.duration_s


def _trajectory(facts: ConditionInputs) -> str:
    excitation, robot = facts.excitation, facts.robot
    if excitation.robot != robot.name:
        raise MotionRefused(f"the excitation was designed for {excitation.robot!r}, the arm is {robot.name!r}")
    mounting = facts.context.mounting_rad
    if mounting is not None and not np.allclose(mounting, excitation.mounting.angles_rad, atol=1e-6):
        designed = np.round(np.degrees(excitation.mounting.angles_rad), 3)
        raise MotionRefused(f"the excitation was designed for mounting {designed}°, the arm hangs at {np.degrees(mounting)}°")
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)
    return f"{excitation.digest}, {excitation.duration_s:.1f} s within every limit of the {robot.name}"


def _trajectory_clear(facts: ConditionInputs) -> str:
    cell = facts.settings.cell
    if cell is None:
        raise Unreported("the configuration says unchecked: nothing is known to be within reach, and no clearance is proved")
    clear_of(cell, facts.excitation, facts.robot)
    return f"proved against the cell {cell.name!r}, and proved again now"


def _previous_stop(facts: ConditionInputs) -> str:
    if facts.stopped_before is not None:
        raise MotionRefused(f"{facts.stopped_before}; a person must look at the arm and say so: joint-monitor allow")
    return "no stop is waiting for a person"


# --- what the controller says of itself -----------------------------------------------------------------------


def _reachable(facts: ConditionInputs) -> Identity:
    if facts.identity is None:
        raise MotionRefused("unknown: the dashboard does not answer")
    return facts.identity


def _robot_model(facts: ConditionInputs) -> str:
    who = _reachable(facts)
    if facts.context.robot is not None and facts.context.robot != facts.robot.name:
        raise MotionRefused(f"the context is of a {facts.context.robot}, the arm is a {facts.robot.name}")
    if who.model is None:
        raise Unreported("not reported: this software does not tell its model; the configuration is believed")
    if who.model.lower().removesuffix("e") != facts.robot.name.lower().removesuffix("e"):
        raise MotionRefused(f"the controller says it is a {who.model}, the configuration says {facts.robot.name}")
    return f"{who.model}, software {who.firmware or 'not reported'}"


def _serial(facts: ConditionInputs) -> str:
    who, expected = _reachable(facts), facts.context.serial
    if who.serial is None:
        raise Unreported("not reported: this arm cannot be told from another of its model")
    if expected is not None and who.serial != expected:
        raise MotionRefused(f"the controller's serial number is {who.serial}, expected {expected}")
    return who.serial if expected is not None else f"{who.serial}; the configuration names none"


def _remote_control(facts: ConditionInputs) -> str:
    who = _reachable(facts)
    if who.remote_control is None:
        raise Unreported("not reported: this generation has no local control; whoever holds the pendant may start a program meanwhile")
    if not who.remote_control:
        raise MotionRefused("the controller is in local control; set it to remote control on its pendant")
    return "on"


# --- what the controller says of the arm ----------------------------------------------------------------------


def _heard(facts: ConditionInputs) -> ArmState:
    if facts.state is None:
        raise MotionRefused("unknown: no RTDE data")
    return facts.state


def _safety_mode(facts: ConditionInputs) -> str:
    state = _heard(facts)
    if state.safety_mode != SAFETY_MODE_NORMAL or state.safety_bits != SAFETY_BITS_NORMAL:
        name = SAFETY_MODES.get(state.safety_mode, "unknown")
        raise MotionRefused(f"safety mode is {state.safety_mode} ({name}), bits {state.safety_bits:#x}; expected 1 (normal), bits 0x1")
    return "normal"


def _robot_mode(facts: ConditionInputs) -> str:
    mode = _heard(facts).robot_mode
    if mode != ROBOT_MODE_RUNNING:
        raise MotionRefused(f"robot mode is {mode} ({ROBOT_MODES.get(mode, 'unknown')}); expected 7 (running)")
    return "running"


def _no_program(facts: ConditionInputs) -> str:
    runtime = _heard(facts).runtime_state
    if runtime != RUNTIME_STOPPED:
        name = RUNTIME_STATES.get(runtime, "unknown")
        raise MotionRefused(f"a program is {name} on the controller (runtime state {runtime}); it is not ours to stop")
    return "no program runs"


def _finite(facts: ConditionInputs) -> str:
    state = _heard(facts)
    if not all(np.all(np.isfinite(part)) for part in (state.q, state.qd, state.target_q, state.target_qd, state.temperature_c)):
        raise MotionRefused("the controller reports values that are not finite")
    return "positions, speeds and temperatures are finite"


def _stationary(facts: ConditionInputs) -> str:
    state = _heard(facts)
    speed = np.maximum(np.abs(state.qd), np.abs(state.target_qd))  # (J,)
    j = int(np.argmax(speed))
    if not speed[j] <= STANDSTILL_RAD_S:
        raise MotionRefused(f"the arm is moving: joint {j + 1} at {speed[j]:.3f} rad/s; expected standstill")
    hold = np.abs(state.q - state.target_q)  # (J,)
    j = int(np.argmax(hold))
    if not hold[j] <= HOLD_ERROR_RAD:
        raise MotionRefused(f"joint {j + 1} is {hold[j]:.3f} rad from the controller's own target; at most {HOLD_ERROR_RAD}")
    return f"at rest, every joint within {1000.0 * hold[j]:.1f} mrad of the controller's own target"


def _speed_scaling(facts: ConditionInputs) -> str:
    state = _heard(facts)
    if math.isnan(state.speed):
        raise Unreported("not reported: a slider below 100 % would show as a following error")
    if not state.at_full_speed:
        raise MotionRefused(f"the speed slider is at {100.0 * state.speed:.0f} %; expected 100 %: at less the arm plays another trajectory")
    return "100 %"


def _payload(facts: ConditionInputs) -> str:
    payload, expected = _heard(facts).payload_kg, facts.context.payload_kg
    if math.isnan(payload):
        raise Unreported("not reported: a payload that nobody told the monitor would be taken for friction")
    if expected is None:
        raise Unreported(f"the controller reckons with {payload:.3f} kg, the configuration names none")
    if not abs(payload - expected) <= facts.settings.max_payload_error_kg:
        raise MotionRefused(
            f"the controller reckons with {payload:.3f} kg, the configuration says {expected:.3f} kg; "
            f"at most {facts.settings.max_payload_error_kg:g} kg apart"
        )
    return f"{payload:.3f} kg, as configured"


def _gravity(facts: ConditionInputs) -> str:
    state, expected = _heard(facts), facts.context.mounting_rad
    mounting = facts.excitation.mounting if expected is None else Mounting.of(expected)
    measured = np.array(state.accelerometer_m_s2)
    if np.all(np.isnan(measured)) or not np.any(measured):
        raise Unreported("not reported: a mounting that is not the configured one shows only in the torque of the first pass")
    length = float(np.linalg.norm(measured))
    if not abs(length - STANDARD_GRAVITY_M_S2) <= ACCELEROMETER_ERROR_M_S2:
        raise MotionRefused(f"the tool's accelerometer reads {length:.2f} m/s²; expected {STANDARD_GRAVITY_M_S2:.2f} at standstill")
    angle = tilt_deg(facts.robot, mounting, state.q, measured)
    if not angle <= facts.settings.max_gravity_error_deg:
        raise MotionRefused(
            f"by the tool's accelerometer the base is tilted by {angle:.1f}° against the configured mounting; "
            f"at most {facts.settings.max_gravity_error_deg:g}°"
        )
    return f"{angle:.1f}° from the configured mounting"


def tilt_deg(robot: Robot, mounting: Mounting, q: Array, accelerometer_m_s2: Array) -> float:
    """Angle between up by the flange's accelerometer (3,) through forward kinematics at q (J,), and up by the mounting.

    An accelerometer at rest reads what holds it against gravity: +9.81 m/s² upwards, as recordings of a real arm confirm.
    """
    attitudes, _ = frames(robot, mounting, q[None])
    up = attitudes[0, -1] @ (accelerometer_m_s2 / np.linalg.norm(accelerometer_m_s2))  # (3,) in the world, whose z is up
    return math.degrees(math.acos(min(max(float(up[2]), -1.0), 1.0)))


def _approach_near(facts: ConditionInputs) -> str:
    state, settings = _heard(facts), facts.settings
    far = np.abs(state.q - facts.excitation.at(np.zeros(1)).q[0])  # (J,)
    j = int(np.argmax(far))
    if not far[j] <= settings.max_approach_rad:
        raise MotionRefused(f"joint {j + 1} is {far[j]:.2f} rad from the start of the excitation; at most {settings.max_approach_rad:g}")
    return f"joint {j + 1} has farthest to go: {far[j]:.2f} rad"


def _approach_clear(facts: ConditionInputs) -> str:
    state, cell = _heard(facts), facts.settings.cell
    if cell is None:
        raise Unreported("the configuration says unchecked: the way to the start is not proved")
    if not np.all(np.isfinite(state.target_q)):
        raise MotionRefused("unknown: where the arm stands is not finite")
    line = clear_approach(cell, facts.excitation, facts.robot, state.target_q)
    gaps = [1000.0 * line.itself.gap_m] + ([] if line.cell is None else [1000.0 * line.cell.gap_m])
    return f"the straight way to the start keeps {min(gaps):.0f} mm clear"


def _temperatures(facts: ConditionInputs) -> str:
    state = _heard(facts)
    coldest, hottest = facts.settings.joint_temperature_range_c
    outside = np.flatnonzero(~((state.temperature_c >= coldest) & (state.temperature_c <= hottest)))
    if outside.size:
        j = int(outside[0])
        raise MotionRefused(f"joint {j + 1} is at {state.temperature_c[j]:.1f} °C; allowed are {coldest:g} to {hottest:g} °C")
    return f"{np.min(state.temperature_c):.0f} to {np.max(state.temperature_c):.0f} °C"


def _permit(facts: ConditionInputs) -> str:
    number = facts.settings.permit_input
    if facts.settings.permit == "none":
        return "nobody else is asked"
    if number is not None:
        bits = _heard(facts).digital_inputs
        if not math.isfinite(bits):
            raise MotionRefused(f"digital input {number} must be on, and the controller does not report its inputs")
        if not int(bits) >> number & 1:
            raise MotionRefused(f"digital input {number} is off; expected on")
        return f"digital input {number} is on"
    if facts.permit is None:
        raise MotionRefused("permit/replay was not asked over Zenoh")
    if not facts.permit.given:
        raise MotionRefused(facts.permit.reason)
    return facts.permit.reason


CHECKS: dict[str, Callable[[ConditionInputs], str]] = {
    "motion_allowed": _motion_allowed,
    "address": _address,
    "time_window": _time_window,
    "trajectory": _trajectory,
    "trajectory_clear": _trajectory_clear,
    "previous_stop": _previous_stop,
    "robot_model": _robot_model,
    "serial": _serial,
    "remote_control": _remote_control,
    "safety_mode": _safety_mode,
    "robot_mode": _robot_mode,
    "no_other_program": _no_program,
    "finite": _finite,
    "stationary": _stationary,
    "speed_scaling": _speed_scaling,
    "payload": _payload,
    "gravity": _gravity,
    "approach_near": _approach_near,
    "approach_clear": _approach_clear,
    "temperatures": _temperatures,
    "permit": _permit,
}
OF_CONFIGURATION = ("motion_allowed", "address", "time_window", "trajectory", "trajectory_clear", "previous_stop")
OF_CONTROLLER = ("robot_model", "serial", "remote_control")
# what minutes may have changed; the way to the start the child proves again
AT_THE_LAST = tuple(name for name in CHECKS if name not in {"trajectory_clear", "approach_clear", "permit"})
OF_STATE = tuple(name for name in CHECKS if name not in {*OF_CONFIGURATION, *OF_CONTROLLER, "permit"})


def some(facts: ConditionInputs, names: tuple[str, ...]) -> tuple[ConditionResult, ...]:
    """Those conditions alone, in the same order."""
    return tuple(_found(name, CHECKS[name], facts) for name in names)
