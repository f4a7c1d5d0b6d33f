"""Conditions on the state that the controller reports of the arm."""

import math

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.acquire.safety.of_configuration import clear_line
from monitor.acquire.safety.way import Way
from monitor.acquire.state import (
    FULL_SPEED,
    JOINT_MODE_RUNNING,
    JOINT_MODES,
    ROBOT_MODE_RUNNING,
    ROBOT_MODES,
    RUNTIME_PLAYING,
    RUNTIME_STATES,
    RUNTIME_STOPPED,
    SAFETY_BITS_NORMAL,
    SAFETY_MODE_NORMAL,
    SAFETY_MODES,
    STANDSTILL_RAD_S,
    ArmState,
)
from monitor.design.clearance import frames
from monitor.errors import MotionRefused
from monitor.model.robot import STANDARD_GRAVITY_M_S2, Mounting, Robot
from monitor.reason import joint_text
from monitor.recording import Array

HOLD_ERROR_RAD = 0.05  # an arm that holds its pose has its target within this of its position
ACCELEROMETER_ERROR_M_S2 = 1.5  # a real arm's reads 9.28 at rest; a larger difference means a fault, or an arm that is not at rest


def _state(inputs: ConditionInputs) -> ArmState:
    """The state, which must be known."""
    if inputs.state is None:
        raise MotionRefused("unknown: no RTDE data")
    return inputs.state


def safety_mode(inputs: ConditionInputs) -> str:
    """The safety system is in its normal mode, without any stop or fault."""
    state = _state(inputs)
    if state.safety_mode != SAFETY_MODE_NORMAL or state.safety_bits != SAFETY_BITS_NORMAL:
        name = SAFETY_MODES.get(state.safety_mode, "unknown")
        raise MotionRefused(f"safety mode is {state.safety_mode} ({name}), bits {state.safety_bits:#x}; expected 1 (normal), bits 0x1")
    return "normal"


def robot_mode(inputs: ConditionInputs) -> str:
    """The robot is powered on and running."""
    mode = _state(inputs).robot_mode
    if mode != ROBOT_MODE_RUNNING:
        raise MotionRefused(f"robot mode is {mode} ({ROBOT_MODES.get(mode, 'unknown')}); expected 7 (running)")
    return "running"


def no_other_program(inputs: ConditionInputs) -> str:
    """No program runs on the controller: it would be stopped by ours. A program that lends the arm must play: it alone can offer it."""
    runtime = _state(inputs).runtime_state
    if inputs.settings.lent is not None:
        if runtime != RUNTIME_PLAYING:
            name = RUNTIME_STATES.get(runtime, "unknown")
            raise MotionRefused(f"the program is {name} (runtime state {runtime}); it must play, because its node lends the arm")
        return "the program plays, and its node lends the arm"
    if runtime != RUNTIME_STOPPED:
        name = RUNTIME_STATES.get(runtime, "unknown")
        raise MotionRefused(f"a program is {name} on the controller (runtime state {runtime}); it is not ours to stop")
    return "no program runs"


def finite(inputs: ConditionInputs) -> str:
    """Positions, speeds and temperatures are numbers."""
    state = _state(inputs)
    if not all(np.all(np.isfinite(part)) for part in (state.q, state.qd, state.target_q, state.target_qd, state.temperature_c)):
        raise MotionRefused("the controller reports values that are not finite")
    return "positions, speeds and temperatures are finite"


def stationary(inputs: ConditionInputs) -> str:
    """The arm is at rest, and every joint is near the controller's own target."""
    state = _state(inputs)
    speed = np.maximum(np.abs(state.qd), np.abs(state.target_qd))  # (J,)
    j = int(np.argmax(speed))
    if not speed[j] <= STANDSTILL_RAD_S:
        raise MotionRefused(f"the arm is moving: {joint_text(j + 1)} at {speed[j]:.3f} rad/s; expected standstill")
    hold = np.abs(state.q - state.target_q)  # (J,)
    j = int(np.argmax(hold))
    if not hold[j] <= HOLD_ERROR_RAD:
        raise MotionRefused(f"{joint_text(j + 1)} is {hold[j]:.3f} rad from the controller's own target; at most {HOLD_ERROR_RAD}")
    return f"at rest, every joint within {1000.0 * hold[j]:.1f} mrad of the controller's own target"


def speed_scaling(inputs: ConditionInputs) -> str:
    """The operator's slider stands at 100 %. The trajectory limiter says nothing while no program plays: a real arm's stands at 0 then."""
    state = _state(inputs)
    if math.isnan(state.speed_fraction):
        raise Unreported("the slider is not reported: one below 100 % ends the replay before the arm moves")
    if not (math.isnan(state.speed_scaling) or 0.0 <= state.speed_scaling <= 2.0 - FULL_SPEED):
        raise MotionRefused(f"the controller's speed scaling is {state.speed_scaling:g}; expected a share of 0 to 1")
    if not state.slider_full:
        share = 100.0 * state.speed_fraction
        raise MotionRefused(f"the speed slider is at {share:.0f} %; expected 100 %: at less the arm plays another trajectory")
    return "100 %"


def joints_running(inputs: ConditionInputs) -> str:
    """Every joint's drive is on and its brake is released."""
    state = _state(inputs)
    if not state.joint_modes or all(math.isnan(mode) for mode in state.joint_modes):
        raise Unreported("not reported: a joint with a closed brake shows as a following error")
    for j, mode in enumerate(state.joint_modes):
        if mode != JOINT_MODE_RUNNING:
            name = JOINT_MODES.get(int(mode), "unknown") if math.isfinite(mode) else "unknown"
            raise MotionRefused(
                f"{joint_text(j + 1)} is in mode {mode:g} ({name}); expected {JOINT_MODE_RUNNING} (running, its brake released)"
            )
    return "every drive is on, every brake is released"


def teach_button(inputs: ConditionInputs) -> str:
    """Nobody holds the freedrive button."""
    state = _state(inputs)
    if math.isnan(state.status_bits):
        raise Unreported("not reported: somebody who holds the freedrive button is not noticed")
    if state.teach_button_held:
        raise MotionRefused("somebody holds the freedrive button; expected nobody at the arm")
    return "nobody holds the freedrive button"


def payload(inputs: ConditionInputs) -> str:
    """The controller reckons with the configured payload."""
    payload, expected = _state(inputs).payload_kg, inputs.context.payload_kg
    if math.isnan(payload):
        raise Unreported("not reported: a payload that nobody told the monitor would be taken for friction")
    if expected is None:
        raise Unreported(f"the controller reckons with {payload:.3f} kg, the configuration names none")
    if not abs(payload - expected) <= inputs.settings.max_payload_error_kg:
        raise MotionRefused(
            f"the controller reckons with {payload:.3f} kg, the configuration says {expected:.3f} kg; "
            f"at most {inputs.settings.max_payload_error_kg:g} kg apart"
        )
    return f"{payload:.3f} kg, as configured"


def gravity(inputs: ConditionInputs) -> str:
    """The tool's accelerometer agrees with the configured mounting."""
    state, expected = _state(inputs), inputs.context.mounting_rad
    mounting = inputs.excitation.mounting if expected is None else Mounting.of(expected)
    measured = np.array(state.accelerometer_m_s2)
    if np.all(np.isnan(measured)) or not np.any(measured):
        raise Unreported("not reported: a mounting that is not the configured one shows only in the torque of the first pass")
    length = float(np.linalg.norm(measured))
    if not abs(length - STANDARD_GRAVITY_M_S2) <= ACCELEROMETER_ERROR_M_S2:
        raise MotionRefused(f"the tool's accelerometer reads {length:.2f} m/s²; expected {STANDARD_GRAVITY_M_S2:.2f} at standstill")
    angle = tilt_deg(inputs.robot, mounting, state.q, measured)
    if not angle <= inputs.settings.max_gravity_error_deg:
        raise MotionRefused(
            f"by the tool's accelerometer the base is tilted by {angle:.1f}° against the configured mounting; "
            f"at most {inputs.settings.max_gravity_error_deg:g}°"
        )
    return f"{angle:.1f}° from the configured mounting"


def tilt_deg(robot: Robot, mounting: Mounting, q: Array, accelerometer_m_s2: Array) -> float:
    """Angle [°] between two directions that should both be up: the accelerometer's reading, and the z axis of the configured mounting.

    The reading (3,) in the flange's frame is turned into the world by forward kinematics at q (J,). An accelerometer at rest reads the
    force that holds it against gravity, +9.81 m/s² upwards; recordings of a real arm confirm it.
    """
    attitudes, _ = frames(robot, mounting, q[None])
    up = attitudes[0, -1] @ (accelerometer_m_s2 / np.linalg.norm(accelerometer_m_s2))  # (3,) in the world frame, whose z axis is up
    return math.degrees(math.acos(min(max(float(up[2]), -1.0), 1.0)))


def approach_near(inputs: ConditionInputs) -> str:
    """The start of the trajectory is near enough to where the arm stands, or the arm stands on it, where our last motion left it."""
    state, settings = _state(inputs), inputs.settings
    way = inputs.way_from(state)
    if way.back_from_s is not None:
        return (
            f"the arm stands where the last motion left it, {way.off_path_rad:.2f} rad from its trajectory: it is brought back over the "
            f"way it came, in {way.to_start(settings).duration_s:.0f} s"
        )
    far = np.abs(state.q - way.start_q)  # (J,)
    j = int(np.argmax(far))
    if not far[j] <= settings.max_approach_rad:
        raise MotionRefused(
            f"{joint_text(j + 1)} is {far[j]:.2f} rad from the start of the excitation; at most {settings.max_approach_rad:g}: "
            + _what_to_do(way)
        )
    return f"{joint_text(j + 1)} has farthest to go: {far[j]:.2f} rad"


def _what_to_do(way: Way) -> str:
    """What a person does about an arm that stands too far from the start."""
    start = ", ".join(f"{angle:.0f}" for angle in np.degrees(way.start_q))
    return (
        f"jog the arm near the start, at {start}°; or, where a stop of ours left it on its trajectory, look whether the way back along it "
        "is free and say so: joint-monitor allow --way-back"
    )


def approach_clear(inputs: ConditionInputs) -> str:
    """The straight ways in joint space to the start, and from it to where the arm will rest, keep clear of the cell."""
    state, cell = _state(inputs), inputs.settings.cell
    if cell is None:
        raise Unreported("the configuration says unchecked: the way to the start is not proved")
    if not np.all(np.isfinite(state.target_q)):
        raise MotionRefused("unknown: where the arm stands is not finite")
    gaps = []
    for begin, end in inputs.way_from(state).lines:
        line = clear_line(cell, inputs.excitation, inputs.robot, begin, end)
        gaps += [1000.0 * line.itself.gap_m] + ([] if line.cell is None else [1000.0 * line.cell.gap_m])
    return f"the straight way to the start keeps {min(gaps):.0f} mm clear"


def temperatures(inputs: ConditionInputs) -> str:
    """Every joint is within the allowed range of temperature."""
    state = _state(inputs)
    coldest, hottest = inputs.settings.joint_temperature_range_c
    outside = np.flatnonzero(~((state.temperature_c >= coldest) & (state.temperature_c <= hottest)))
    if outside.size:
        j = int(outside[0])
        raise MotionRefused(f"{joint_text(j + 1)} is at {state.temperature_c[j]:.1f} °C; allowed are {coldest:g} to {hottest:g} °C")
    return f"{np.min(state.temperature_c):.0f} to {np.max(state.temperature_c):.0f} °C"


def permit(inputs: ConditionInputs) -> str:
    """The digital input is on, or the program that was asked over Zenoh agrees, where the configuration wants a permit."""
    number = inputs.settings.permit_input
    if inputs.settings.permit == "none":
        return "nobody else is asked"
    if number is not None:
        bits = _state(inputs).digital_inputs
        if not math.isfinite(bits):
            raise MotionRefused(f"digital input {number} must be on, and the controller does not report its inputs")
        if not int(bits) >> number & 1:
            raise MotionRefused(f"digital input {number} is off; expected on")
        return f"digital input {number} is on"
    if inputs.permit is None:
        raise MotionRefused("permit/replay was not asked over Zenoh")
    if not inputs.permit.given:
        raise MotionRefused(inputs.permit.reason)
    return inputs.permit.reason
