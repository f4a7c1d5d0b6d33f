"""Conditions on the state that the controller reports of the arm."""

import math
from dataclasses import replace

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.acquire.safety.of_configuration import clear_line
from monitor.acquire.state import FULL_SPEED, NOT_FINITE, RUNTIME_PLAYING, RUNTIME_STOPPED, STANDSTILL_RAD_S, program_name
from monitor.design.clearance import frames
from monitor.errors import MotionRefused
from monitor.model.robot import STANDARD_GRAVITY_M_S2, Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array

HOLD_ERROR_RAD = 0.05  # an arm that holds its pose has its target within this of its position
ACCELEROMETER_ERROR_M_S2 = 1.5  # a real arm's reads 9.28 at rest; a larger difference means a fault, or an arm that is not at rest


def _unless(wrong: Reason | None, found: Reason) -> Reason:
    """What was found. Raises MotionRefused where something is wrong."""
    if wrong is not None:
        raise MotionRefused(wrong)
    return found


SAFETY_IS_NORMAL = Sentence("safety_mode_normal", "normal")


def safety_mode(inputs: ConditionInputs) -> Reason:
    """The safety system is in its normal mode, without any stop or fault."""
    return _unless(inputs.arm.not_safe, SAFETY_IS_NORMAL())


ROBOT_RUNS = Sentence("robot_mode_running", "running")


def robot_mode(inputs: ConditionInputs) -> Reason:
    """The robot is powered on and running."""
    return _unless(inputs.arm.not_running, ROBOT_RUNS())


PROGRAM_DOES_NOT_PLAY = Sentence(
    "program_does_not_play", "the program is {name:word} (runtime state {runtime}); it must play, because its node lends the arm"
)
PROGRAM_LENDS = Sentence("program_lends", "the program plays, and its node lends the arm")
ANOTHER_PROGRAM = Sentence(
    "another_program", "a program is {name:word} on the controller (runtime state {runtime}); it is not ours to stop"
)
NO_PROGRAM = Sentence("no_program", "no program runs")


def no_other_program(inputs: ConditionInputs) -> Reason:
    """No program runs on the controller: it would be stopped by ours. A program that lends the arm must play: it alone can offer it."""
    runtime = inputs.arm.runtime_state
    if inputs.settings.lent is not None:
        if runtime != RUNTIME_PLAYING:
            raise MotionRefused(PROGRAM_DOES_NOT_PLAY(name=program_name(runtime), runtime=runtime))
        return PROGRAM_LENDS()
    if runtime != RUNTIME_STOPPED:
        raise MotionRefused(ANOTHER_PROGRAM(name=program_name(runtime), runtime=runtime))
    return NO_PROGRAM()


VALUES_FINITE = Sentence("values_finite", "positions, speeds and temperatures are finite")


def finite(inputs: ConditionInputs) -> Reason:
    """Positions, speeds and temperatures are numbers."""
    state = inputs.arm
    if not all(np.all(np.isfinite(part)) for part in (state.q, state.qd, state.target_q, state.target_qd, state.temperature_c)):
        raise MotionRefused(NOT_FINITE())
    return VALUES_FINITE()


ARM_MOVES = Sentence("arm_moves", "the arm is moving: {joint:joint} at {speed_rad_s:.3f} rad/s; expected standstill")
ARM_OFF_TARGET = Sentence("arm_off_target", "{joint:joint} is {error_rad:.3f} rad from the controller's own target; at most {limit_rad}")
ARM_AT_REST = Sentence("arm_at_rest", "at rest, every joint within {error_mrad:.1f} mrad of the controller's own target")


def stationary(inputs: ConditionInputs) -> Reason:
    """The arm is at rest, and every joint is near the controller's own target."""
    state = inputs.arm
    speed = np.maximum(np.abs(state.qd), np.abs(state.target_qd))  # (J,)
    j = int(np.argmax(speed))
    if not speed[j] <= STANDSTILL_RAD_S:
        raise MotionRefused(ARM_MOVES(joint=j + 1, speed_rad_s=speed[j]))
    hold = np.abs(state.q - state.target_q)  # (J,)
    j = int(np.argmax(hold))
    if not hold[j] <= HOLD_ERROR_RAD:
        raise MotionRefused(ARM_OFF_TARGET(joint=j + 1, error_rad=hold[j], limit_rad=HOLD_ERROR_RAD))
    return ARM_AT_REST(error_mrad=1000.0 * hold[j])


SLIDER_NOT_REPORTED = Sentence("slider_not_reported", "the slider is not reported: one below 100 % ends the replay before the arm moves")
SPEED_SCALING_WRONG = Sentence("speed_scaling_wrong", "the controller's speed scaling is {share:g}; expected a share of 0 to 1")
SLIDER_FULL = Sentence("slider_full", "100 %")


def speed_scaling(inputs: ConditionInputs) -> Reason:
    """The operator's slider stands at 100 %. The trajectory limiter says nothing while no program plays: a real arm's stands at 0 then."""
    state = inputs.arm
    if math.isnan(state.speed_fraction):
        raise Unreported(SLIDER_NOT_REPORTED())
    if not (math.isnan(state.speed_scaling) or 0.0 <= state.speed_scaling <= 2.0 - FULL_SPEED):
        raise MotionRefused(SPEED_SCALING_WRONG(share=state.speed_scaling))
    return _unless(state.slider_low, SLIDER_FULL())


JOINT_MODES_NOT_REPORTED = Sentence("joint_modes_not_reported", "not reported: a joint with a closed brake shows as a following error")
JOINTS_RUNNING = Sentence("joints_running", "every drive is on, every brake is released")


def joints_running(inputs: ConditionInputs) -> Reason:
    """Every joint's drive is on and its brake is released."""
    state = inputs.arm
    if not state.joint_modes or all(math.isnan(mode) for mode in state.joint_modes):
        raise Unreported(JOINT_MODES_NOT_REPORTED())
    told = replace(state, joint_modes=tuple(math.inf if math.isnan(mode) else mode for mode in state.joint_modes))
    return _unless(told.joint_not_running, JOINTS_RUNNING())  # where some are reported, one that is not does not run


TEACH_BUTTON_NOT_REPORTED = Sentence("teach_button_not_reported", "not reported: somebody who holds the freedrive button is not noticed")
TEACH_BUTTON_FREE = Sentence("teach_button_free", "nobody holds the freedrive button")


def teach_button(inputs: ConditionInputs) -> Reason:
    """Nobody holds the freedrive button."""
    state = inputs.arm
    if math.isnan(state.status_bits):
        raise Unreported(TEACH_BUTTON_NOT_REPORTED())
    return _unless(state.teach_button, TEACH_BUTTON_FREE())


PAYLOAD_NOT_REPORTED = Sentence("payload_not_reported", "not reported: a payload that nobody told the monitor would be taken for friction")
PAYLOAD_NOT_CONFIGURED = Sentence("payload_not_configured", "the controller reckons with {payload_kg:.3f} kg, the configuration names none")
PAYLOAD_AS_CONFIGURED = Sentence("payload_as_configured", "{payload_kg:.3f} kg, as configured")


def payload(inputs: ConditionInputs) -> Reason:
    """The controller reckons with the configured payload."""
    state, expected = inputs.arm, inputs.context.payload_kg
    payload = state.payload_kg
    if math.isnan(payload):
        raise Unreported(PAYLOAD_NOT_REPORTED())
    if expected is None:
        raise Unreported(PAYLOAD_NOT_CONFIGURED(payload_kg=payload))
    return _unless(state.other_payload(expected, inputs.settings.max_payload_error_kg), PAYLOAD_AS_CONFIGURED(payload_kg=payload))


MOUNTING_NOT_REPORTED = Sentence(
    "mounting_not_reported", "not reported: a mounting that is not the configured one shows only in the torque of the first pass"
)
ACCELEROMETER_WRONG = Sentence(
    "accelerometer_wrong", "the tool's accelerometer reads {measured_m_s2:.2f} m/s²; expected {expected_m_s2:.2f} at standstill"
)
BASE_TILTED = Sentence(
    "base_tilted",
    "by the tool's accelerometer the base is tilted by {angle_deg:.1f}° against the configured mounting; at most {limit_deg:g}°",
)
MOUNTING_AS_CONFIGURED = Sentence("mounting_as_configured", "{angle_deg:.1f}° from the configured mounting")


def gravity(inputs: ConditionInputs) -> Reason:
    """The tool's accelerometer agrees with the configured mounting."""
    state, expected = inputs.arm, inputs.context.mounting_rad
    mounting = inputs.excitation.mounting if expected is None else Mounting.of(expected)
    measured = np.array(state.accelerometer_m_s2)
    if np.all(np.isnan(measured)) or not np.any(measured):
        raise Unreported(MOUNTING_NOT_REPORTED())
    length = float(np.linalg.norm(measured))
    if not abs(length - STANDARD_GRAVITY_M_S2) <= ACCELEROMETER_ERROR_M_S2:
        raise MotionRefused(ACCELEROMETER_WRONG(measured_m_s2=length, expected_m_s2=STANDARD_GRAVITY_M_S2))
    angle = tilt_deg(inputs.robot, mounting, state.q, measured)
    if not angle <= inputs.settings.max_gravity_error_deg:
        raise MotionRefused(BASE_TILTED(angle_deg=angle, limit_deg=inputs.settings.max_gravity_error_deg))
    return MOUNTING_AS_CONFIGURED(angle_deg=angle)


def tilt_deg(robot: Robot, mounting: Mounting, q: Array, accelerometer_m_s2: Array) -> float:
    """Angle [°] between two directions that should both be up: the accelerometer's reading, and the z axis of the configured mounting.

    The reading (3,) in the flange's frame is turned into the world by forward kinematics at q (J,). An accelerometer at rest reads the
    force that holds it against gravity, +9.81 m/s² upwards; recordings of a real arm confirm it.
    """
    attitudes, _ = frames(robot, mounting, q[None])
    up = attitudes[0, -1] @ (accelerometer_m_s2 / np.linalg.norm(accelerometer_m_s2))  # (3,) in the world frame, whose z axis is up
    return math.degrees(math.acos(min(max(float(up[2]), -1.0), 1.0)))


BROUGHT_BACK = Sentence(
    "brought_back",
    "the arm stands where the last motion left it, {off_path_rad:.2f} rad from its trajectory: it is brought back over the "
    "way it came, in {duration_s:.0f} s",
)
FAR_FROM_START = Sentence(
    "far_from_start",
    "{joint:joint} is {far_rad:.2f} rad from the start of the excitation; at most {limit_rad:g}: jog the arm near the start, at "
    "{start_deg:.0f}°; or, where a stop of ours left it on its trajectory, look whether the way back along it is free and say so: "
    "joint-monitor allow --way-back",
)
FARTHEST_JOINT = Sentence("farthest_joint", "{joint:joint} has farthest to go: {far_rad:.2f} rad")


def approach_near(inputs: ConditionInputs) -> Reason:
    """The start of the trajectory is near enough to where the arm stands, or the arm stands on it, where our last motion left it."""
    state, settings = inputs.arm, inputs.settings
    way = inputs.way_from(state)
    if way.back_from_s is not None:
        return BROUGHT_BACK(off_path_rad=way.off_path_rad, duration_s=way.to_start(settings).duration_s)
    far = np.abs(state.q - way.start_q)  # (J,)
    j = int(np.argmax(far))
    if not far[j] <= settings.max_approach_rad:
        start_deg = np.degrees(way.start_q)
        raise MotionRefused(FAR_FROM_START(joint=j + 1, far_rad=far[j], limit_rad=settings.max_approach_rad, start_deg=start_deg))
    return FARTHEST_JOINT(joint=j + 1, far_rad=far[j])


WAY_UNCHECKED = Sentence("way_unchecked", "the configuration says unchecked: the way to the start is not proved")
PLACE_NOT_FINITE = Sentence("place_not_finite", "unknown: where the arm stands is not finite")
WAY_CLEAR = Sentence("way_clear", "the straight way to the start keeps {gap_mm:.0f} mm clear")


def approach_clear(inputs: ConditionInputs) -> Reason:
    """The straight ways in joint space to the start, and from it to where the arm will rest, keep clear of the cell."""
    state, cell = inputs.arm, inputs.settings.cell
    if cell is None:
        raise Unreported(WAY_UNCHECKED())
    if not np.all(np.isfinite(state.target_q)):
        raise MotionRefused(PLACE_NOT_FINITE())
    gaps = []
    for begin, end in inputs.way_from(state).lines:
        line = clear_line(cell, inputs.excitation, inputs.robot, begin, end)
        gaps += [1000.0 * line.itself.gap_m] + ([] if line.cell is None else [1000.0 * line.cell.gap_m])
    return WAY_CLEAR(gap_mm=min(gaps))


TEMPERATURES_WITHIN = Sentence("temperatures_within", "{low_c:.0f} to {high_c:.0f} °C")


def temperatures(inputs: ConditionInputs) -> Reason:
    """Every joint is within the allowed range of temperature."""
    state = inputs.arm
    if (why := state.temperature_outside(inputs.settings.joint_temperature_range_c)) is not None:
        raise MotionRefused(why)
    return TEMPERATURES_WITHIN(low_c=np.min(state.temperature_c), high_c=np.max(state.temperature_c))


NO_PERMIT_WANTED = Sentence("no_permit_wanted", "nobody else is asked")
INPUT_NOT_REPORTED = Sentence("input_not_reported", "digital input {input} must be on, and the controller does not report its inputs")
INPUT_OFF = Sentence("input_off", "digital input {input} is off; expected on")
INPUT_ON = Sentence("input_on", "digital input {input} is on")
PERMIT_NOT_ASKED = Sentence("permit_not_asked", "permit/replay was not asked over Zenoh")


def permit(inputs: ConditionInputs) -> Reason:
    """The digital input is on, or the program that was asked over Zenoh agrees, where the configuration wants a permit."""
    number = inputs.settings.permit_input
    if inputs.settings.permit == "none":
        return NO_PERMIT_WANTED()
    if number is not None:
        bits = inputs.arm.digital_inputs
        if not math.isfinite(bits):
            raise MotionRefused(INPUT_NOT_REPORTED(input=number))
        if not int(bits) >> number & 1:
            raise MotionRefused(INPUT_OFF(input=number))
        return INPUT_ON(input=number)
    if inputs.permit is None:
        raise MotionRefused(PERMIT_NOT_ASKED())
    if not inputs.permit.given:
        raise MotionRefused(inputs.permit.reason)
    return inputs.permit.reason
