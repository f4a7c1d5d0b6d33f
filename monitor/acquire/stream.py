"""The disposable child process of one replay: `python -m monitor.acquire.stream`. The only place that moves an arm.

One continuous servoJ stream: approach, the excitation, return, each a smooth path, paced on the robot's own timestamp.
At the first doubt it tells the cause and ends the process, without another call into ur-rtde: no more targets come,
and the controller's watchdog stops the arm.
"""

import gc
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rtde_control import RTDEControlInterface

from monitor.acquire import guard
from monitor.acquire.arm import Arm, Failure, arm_state
from monitor.acquire.child import Lifeline, Outbox, begin, leave
from monitor.acquire.guard import ReplaySettings
from monitor.acquire.path import joint_path
from monitor.acquire.rows import PLACE
from monitor.design.cell import cell_from_document
from monitor.errors import MonitorError, MotionRefused, RobotUnreachable
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import load_robot
from monitor.recording import Array

STILL_S = 0.15  # at rest for so long before the next phase begins
SETTLE_S = 3.0  # and if it does not come to rest within this, something is wrong
STOP_RAMP_S = 0.4  # on request the arm slows down along its path within this
SERVO_STOP_RAD_S2 = 5.0  # the arm is at rest already


class Stopped(Exception):
    """The parent asked, and the arm stands."""


def connect(job: dict[str, Any], outbox: Outbox, lifeline: Lifeline, excitation: Excitation) -> Arm:
    """The arm, heard and found well, at rest and free for 0.1 s, its way to the start clear. Only receiving: nothing is sent yet.

    Raises RobotUnreachable or MotionRefused.
    """
    outbox.message("phase", phase="connect", duration_s=0.0)
    host = job["settings"]["host"]
    try:
        arm = Arm(job, outbox, lifeline)
    except RuntimeError as error:
        raise RobotUnreachable(f"{host}: RTDE: {error}") from None
    if not arm.receive.isConnected():
        raise RobotUnreachable(f"{host}: RTDE answers but sends no data")
    start_q = excitation.at(np.zeros(1)).q[0]  # (J,)
    try:
        for _ in range(13):
            state = arm_state(arm.next_row())
            guard.ready(state, arm.settings, start_q)
    except Failure as failure:
        raise RobotUnreachable(f"{host}: {failure}") from None
    if job["cell"] is not None:
        guard.clear_approach(cell_from_document(job["cell"]), excitation, load_robot(excitation.robot), state.target_q)
    return arm


def take_control(arm: Arm) -> Array:
    """Upload the control program and set its watchdog; (J,) the pose in which the arm stands, as the controller's target.

    The constructor would stop any program that runs; `connect` saw none one tick ago.
    Raises MotionRefused where another client has the arm, Failure where the program does not come up.
    """
    arm.outbox.message("phase", phase="control", duration_s=0.0)
    try:
        arm.control = RTDEControlInterface(arm.settings.host, arm.settings.rate_hz)
    except RuntimeError as error:
        if "already in use" in str(error):  # said before anything was uploaded
            raise MotionRefused(f"another RTDE client controls the arm: {error}") from None
        raise Failure("no_control", f"the control program did not start: {error}") from None
    arm.seen_at = time.monotonic()  # the constructor held up this process, not the controller
    begin_q: Array = arm.next_row()[PLACE["target_q"]].copy()
    arm.recent.append(begin_q)
    if not arm.control.setWatchdog(arm.settings.watchdog_hz):
        raise Failure("no_watchdog", "the controller did not accept the watchdog")
    return begin_q


def stream(arm: Arm, phase: str, duration_s: float, position: Callable[[float], Array], *, keep: bool = False) -> None:
    """Stream position(τ), τ from 0 to the duration; with `keep`, every row goes to the parent.

    τ is the robot's own time. If a late cycle skipped ticks, τ falls behind by what exceeds two ticks rather than
    throw the arm after it. A stop request lets τ run out within STOP_RAMP_S, then raises Stopped.
    """
    arm.outbox.message("phase", phase=phase, duration_s=duration_s)
    tau_s, pace, begun = 0.0, 1.0, False
    while True:
        row = arm.next_row()
        if begun:
            ticks = round(arm.step_s / arm.tick_s)
            arm.missed += max(ticks - 1, 0) if keep else 0
            advance_s = min(arm.step_s, 2.0 * arm.tick_s)
            arm.slipped_s += arm.step_s - advance_s if keep else 0.0
            if arm.asked_to_stop:
                pace = max(pace - advance_s / STOP_RAMP_S, 0.0)
            tau_s += pace * advance_s
        begun = True
        tau_s = min(tau_s, duration_s) if tau_s < duration_s - 1e-6 else duration_s  # timestamps carry rounding
        arm.cycle(position(tau_s), row)
        if keep:
            arm.outbox.row(row)
        else:
            arm.tell()
        if pace == 0.0:
            raise Stopped
        if tau_s == duration_s:
            return


def settle(arm: Arm) -> None:
    """Hold the last target until the arm is at rest.

    Raises Failure if that takes longer than SETTLE_S.
    """
    arm.outbox.message("phase", phase="settle", duration_s=STILL_S)
    target = arm.recent[-1]
    still_s = waited_s = 0.0
    while still_s < STILL_S:
        row = arm.next_row()
        arm.cycle(target, row)
        arm.tell()
        waited_s += arm.step_s
        slow = np.max(np.abs(row[PLACE["actual_qd"]])) < guard.STANDSTILL_RAD_S and np.max(np.abs(row[PLACE["target_qd"]])) < 1e-3
        still_s = still_s + arm.step_s if slow else 0.0
        if waited_s > SETTLE_S:
            raise Failure("restless", f"the arm did not come to rest within {SETTLE_S:g} s")


def finish(arm: Arm) -> None:
    """End the control program; the arm is at rest."""
    assert arm.control is not None
    arm.outbox.message("phase", phase="finish", duration_s=0.0)
    if not arm.control.servoStop(SERVO_STOP_RAD_S2):
        raise arm.why_refused()
    arm.control.stopScript()
    for _ in range(100):  # 1 s
        if arm.receive.getRuntimeState() != guard.RUNTIME_PLAYING:
            return
        time.sleep(0.01)
    raise Failure("program_stopped", "the control program still runs although it was asked to end")


def play(arm: Arm, excitation: Excitation, begin_q: Array) -> None:
    """The whole motion: approach, excitation, return, each followed by rest."""
    settings = arm.settings
    start_q = excitation.at(np.zeros(1)).q[0]  # (J,)
    gently = {"speed_rad_s": settings.approach_speed_rad_s, "acceleration_rad_s2": settings.approach_acceleration_rad_s2}
    there, back = joint_path(begin_q, start_q, **gently), joint_path(start_q, begin_q, **gently)
    try:
        stream(arm, "approach", there.duration_s, there.at)
        settle(arm)
        stream(arm, "play", excitation.duration_s, lambda tau_s: excitation.at(np.array([tau_s])).q[0], keep=True)
        stream(arm, "return", back.duration_s, back.at)
        settle(arm)
    except Stopped:
        settle(arm)
        finish(arm)
        raise
    finish(arm)


def main() -> None:
    """One replay, as the job on standard input says; never returns."""
    job, outbox, lifeline = begin()
    gc.disable()  # the process lives for one replay; a collection would cost several ticks
    try:
        excitation = excitation_from_document(job["excitation"])
        guard.permitted(ReplaySettings(**job["settings"]))
        guard.within_limits(
            excitation, max_position_rad=np.array(job["max_position_rad"]), max_speed_rad_s=np.array(job["max_speed_rad_s"])
        )
        arm = connect(job, outbox, lifeline, excitation)
        play(arm, excitation, take_control(arm))
        outbox.message("done", missed_ticks=arm.missed, torn_reads=arm.torn, slipped_s=arm.slipped_s)
        leave(0)
    except Failure as failure:
        outbox.message("failed", cause=failure.cause, text=str(failure))
    except Stopped:
        outbox.message("failed", cause="parent_asked_to_stop", text="stopped on request; the arm stands")
    except RobotUnreachable as error:
        outbox.message("unreachable", text=str(error))
    except MonitorError as error:
        outbox.message("refused", text=str(error))
    except BaseException as error:
        outbox.message("failed", cause="internal", text=f"{type(error).__name__}: {error}")
    leave(1)


if __name__ == "__main__":
    main()
