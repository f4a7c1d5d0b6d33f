"""What ends a stream of targets: a failure with its cause, found in the controller's state or in the arm's position. Values only."""

import math

import numpy as np

from monitor.acquire import state as names
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState
from monitor.reason import joint_text

EMERGENCY_MODES = {6, 7}  # safety modes: system and robot emergency stop
PROTECTIVE_MODE, SAFEGUARD_MODE = 3, 5
EMERGENCY_BITS, PROTECTIVE_BIT, SAFEGUARD_BIT = 0b1110_0000, 0b100, 0b1_0000  # of the RTDE variable safety_status_bits


class StreamFailure(Exception):
    """The stream must end now, for this cause.

    `ours` is False where another program than ours may be what plays: nobody may stop it then, and our watchdog ends ours.
    """

    def __init__(self, cause: str, text: str, *, ours: bool = True) -> None:
        super().__init__(text)
        self.cause, self.ours = cause, ours


class Stopped(Exception):
    """A stop was asked for, and the arm stands. Its argument is the cause where that is not the request."""


def state_failure(
    state: ArmState,
    settings: ReplaySettings,
    payload_kg: float | None = None,
    *,
    playing: bool = True,
    up_to_speed: bool = True,
) -> StreamFailure | None:
    """Why the stream must end, as the controller's state says; None while everything is in order.

    `payload_kg` is the configured payload; None skips its comparison. Without `playing` no program need run yet. `up_to_speed` is False
    until the program has played at full speed once: until then only the slider counts. The most specific cause comes first where several
    hold.
    """
    if state.safety_mode != names.SAFETY_MODE_NORMAL or state.safety_bits != names.SAFETY_BITS_NORMAL:
        name = names.SAFETY_MODES.get(state.safety_mode, "unknown")
        return StreamFailure(_safety_cause(state), f"safety mode {state.safety_mode} ({name}), bits {state.safety_bits:#x}")
    if failure := teach_failure(state):  # before the robot mode, which an arm in freedrive leaves
        return failure
    if state.robot_mode != names.ROBOT_MODE_RUNNING:
        return StreamFailure("robot_mode", f"robot mode {state.robot_mode} ({names.ROBOT_MODES.get(state.robot_mode, 'unknown')})")
    if failure := joints_failure(state):
        return failure
    if playing and state.runtime_state != names.RUNTIME_PLAYING:
        name = names.RUNTIME_STATES.get(state.runtime_state, "unknown")
        return StreamFailure("program_stopped", f"the control program is {name} (runtime state {state.runtime_state})")
    if not (np.all(np.isfinite(state.q)) and np.all(np.isfinite(state.target_q))):
        return StreamFailure("bad_data", "the controller reports positions that are not finite")
    if failure := speed_failure(state) if up_to_speed else slider_failure(state):
        return failure
    if payload_kg is not None and abs(state.payload_kg - payload_kg) > settings.max_payload_error_kg:  # False for NaN: not reported
        return StreamFailure(
            "payload", f"the controller reckons with {state.payload_kg:.3f} kg now, the configuration says {payload_kg:.3f} kg"
        )
    coldest, hottest = settings.joint_temperature_range_c
    if not np.all((state.temperature_c >= coldest) & (state.temperature_c <= hottest)):
        return StreamFailure(
            "joint_temperature", f"joint temperatures {np.round(state.temperature_c, 1)} °C; allowed {coldest:g} to {hottest:g}"
        )
    return None


def slider_failure(state: ArmState) -> StreamFailure | None:
    """The failure where the operator's slider is below 100 %; for a program that has just started, whose limiter still stands at 0."""
    if math.isnan(state.speed_fraction) or state.slider_full:
        return None
    return StreamFailure("speed_scaling", f"the speed slider is at {100.0 * state.speed_fraction:.0f} %: the arm plays another trajectory")


def speed_failure(state: ArmState) -> StreamFailure | None:
    """The failure where a program that has come up to full speed plays at less, because of the slider or of the trajectory limiter."""
    if math.isnan(state.speed) or state.at_full_speed:
        return None
    return StreamFailure(
        "speed_scaling",
        f"the program plays at {100.0 * state.speed:.0f} % of its speed: the arm plays another trajectory",
        ours=not state.slider_full,  # with a full slider so begins every program, and ours has begun long ago
    )


def joints_failure(state: ArmState) -> StreamFailure | None:
    """The failure where a joint's drive is off or its brake is closed."""
    for j, mode in enumerate(state.joint_modes):
        if not (math.isnan(mode) or mode == names.JOINT_MODE_RUNNING):
            return StreamFailure("robot_mode", f"{joint_text(j + 1)} is in mode {mode:g}; expected {names.JOINT_MODE_RUNNING} (running)")
    return None


def teach_failure(state: ArmState) -> StreamFailure | None:
    """The failure where somebody holds the freedrive button: a person is at the arm."""
    return StreamFailure("teach_button", "somebody holds the freedrive button") if state.teach_button_held else None


def _safety_cause(state: ArmState) -> str:
    if state.safety_mode in EMERGENCY_MODES or state.safety_bits & EMERGENCY_BITS:
        return "emergency_stop"
    if state.safety_mode == PROTECTIVE_MODE or state.safety_bits & PROTECTIVE_BIT:
        return "protective_stop"
    if state.safety_mode == SAFEGUARD_MODE or state.safety_bits & SAFEGUARD_BIT:
        return "safeguard_stop"
    return "safety"
