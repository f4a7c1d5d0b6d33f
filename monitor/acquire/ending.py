"""What is known of an arm after a motion: at rest, in normal safety mode, powered, with no program of ours. By receiving only."""

import time
from collections.abc import Callable

import numpy as np

from monitor.acquire import state as names
from monitor.acquire.driver import Driver, SafetyStop
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState
from monitor.errors import ReplayAborted

LOOK_S = 5.0  # one look: the start of a process that receives, on a busy host too, its connection, and a tenth of a second of rows
REST_S = 3.0  # an arm that still moves, or a program that still runs, so long after the end did not end
LEAVING_S = 3.0  # somebody who wants this process to end does not wait longer for a controller that does not answer
SAFETY_CAUSES = {3: "protective_stop", 5: "safeguard_stop", 6: "emergency_stop", 7: "emergency_stop"}  # by safety mode


class ArmAfter:
    """The arm after a motion. `stop` is the stop that its safety system holds; `unknown` says what is not known; None: all is in order.

    `state` is what the controller reported; None where it did not answer.
    """

    def __init__(self, stop: SafetyStop | None, unknown: str | None, state: ArmState | None = None) -> None:
        self.stop, self.unknown, self.state = stop, unknown, state


def look(driver: Driver, settings: ReplaySettings, *, clean: bool, should_stop: Callable[[], bool] = lambda: False) -> ArmAfter:
    """Look at the arm until it is in order, for at most confirm_timeout_s.

    clean : the session has shown that the arm came to rest and its program ended; a program that runs now is another's, and may move it.
    """
    began = time.monotonic()
    while True:
        found = judged(driver.state(settings.host, settings.rate_hz, LOOK_S), clean=clean)
        lasted_s = time.monotonic() - began
        patience_s = settings.confirm_timeout_s if found is None else min(REST_S, settings.confirm_timeout_s)
        if should_stop():
            patience_s = min(patience_s, LEAVING_S)
        if found is None and lasted_s > patience_s:
            return ArmAfter(
                None,
                f"the controller did not answer for {lasted_s:.0f} s: it is not known whether the arm came to rest, whether it has power, "
                "and whether its safety system stopped it",
            )
        if found is not None and (found.unknown is None or found.stop is not None or lasted_s > patience_s):
            return found


def judged(state: ArmState | None, *, clean: bool) -> ArmAfter | None:
    """What one state says; None where there is none."""
    if state is None:
        return None
    if state.safety_mode != names.SAFETY_MODE_NORMAL or state.safety_bits != names.SAFETY_BITS_NORMAL:
        name = names.SAFETY_MODES.get(state.safety_mode, "unknown")
        text = f"the controller's safety mode is {state.safety_mode} ({name}), bits {state.safety_bits:#x}"
        return ArmAfter(SafetyStop(SAFETY_CAUSES.get(state.safety_mode, "safety"), text), text, state)
    if state.robot_mode != names.ROBOT_MODE_RUNNING:
        text = f"the robot mode is {state.robot_mode} ({names.ROBOT_MODES.get(state.robot_mode, 'unknown')})"
        return ArmAfter(SafetyStop("robot_mode", text), text, state)
    if clean:
        return ArmAfter(None, None, state)
    if state.runtime_state != names.RUNTIME_STOPPED:
        name = names.RUNTIME_STATES.get(state.runtime_state, "unknown")
        return ArmAfter(None, f"a program is {name}: it is not known whether it is ours, and whether the arm came to rest", state)
    if not np.all(np.abs(state.qd) <= names.STANDSTILL_RAD_S):  # also where a speed is no number
        return ArmAfter(None, "the arm does not stand still", state)
    return ArmAfter(None, None, state)


def judged_end(error: ReplayAborted, after: ArmAfter) -> ReplayAborted:
    """The same end of a replay, with what is known of the arm after it. A stop by the robot's safety system is the cause of any end."""
    if after.stop is not None:
        return error.stopped(after.stop.cause, after.stop.text, after.unknown)
    return error.known(after.unknown)
