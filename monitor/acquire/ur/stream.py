"""The disposable child process of one replay: `python -m monitor.acquire.ur.stream`. The only place that moves an arm.

One continuous servoJ stream: approach, the excitation, return, each a smooth path, paced on the robot's own timestamp.
At the first doubt it tells the cause and ends the process, without another call into ur-rtde: no more targets come,
and the controller's watchdog stops the arm.
"""

import gc
import ipaddress
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from rtde_control import RTDEControlInterface

from monitor.acquire.path import joint_path
from monitor.acquire.rows import COLUMN
from monitor.acquire.safety import guard
from monitor.acquire.safety.conditions import ConditionInputs
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import RUNTIME_PLAYING, STANDSTILL_RAD_S, arm_state
from monitor.acquire.ur.arm import Arm, StreamFailure
from monitor.acquire.ur.child import Lifeline, Outbox, begin, leave, real_time
from monitor.design.cell import cell_from_document
from monitor.errors import MonitorError, MotionRefused, RobotUnreachable
from monitor.model.fourier import excitation_from_document
from monitor.model.robot import load_robot
from monitor.recording import Array, Context

LOOKS = 13  # rows: 0.1 s at 125 Hz
STATE_EVERY_S = 0.1
STILL_S = 0.15  # at rest for so long before the next phase begins
SETTLE_S = 3.0  # and if it does not come to rest within this, something is wrong
STOP_RAMP_S = 0.4  # on request the arm slows down along its path within this
MOVED_RAD = 0.005  # between the proof of the approach and the program that begins it: another way, which nobody proved
SERVO_STOP_RAD_S2 = 5.0  # the arm is at rest already


class Stopped(Exception):
    """Somebody asked, and the arm stands."""


def connect(job: dict[str, Any], outbox: Outbox, lifeline: Lifeline, known: ConditionInputs) -> Arm:
    """The arm, heard, and found well and at rest for 0.1 s; then held ready until the parent says go. Nothing is sent yet.

    Raises RobotUnreachable or MotionRefused, Stopped where the parent does not want it any more.
    """
    outbox.message("phase", phase="connect", duration_s=0.0)
    host = known.settings.host
    try:
        arm = Arm(job, outbox, lifeline)
    except RuntimeError as error:
        raise RobotUnreachable(f"{host}: RTDE: {error}") from None
    if not arm.receive.isConnected():
        raise RobotUnreachable(f"{host}: RTDE answers but sends no data")
    try:
        seen = [arm.next_row() for _ in range(LOOKS)]
        for row in seen:
            guard.check_state(replace(known, state=arm_state(row)), but=("approach_clear",))
        outbox.message("phase", phase="ready", duration_s=0.0)
        told_at = 0.0
        while not arm.may_go:
            if arm.seen_at - told_at > STATE_EVERY_S:  # the mean of what an accelerometer says; the latest of everything else
                row = seen[-1].copy()
                place = COLUMN["actual_tool_accelerometer"]
                row[place] = np.mean([each[place] for each in seen], axis=0)
                outbox.message("state", row=row.tolist())
                told_at = arm.seen_at
            if arm.asked_to_stop:
                raise Stopped
            seen = [*seen[1:], arm.next_row()]
        guard.check_state(replace(known, state=arm_state(seen[-1])))
        arm.proved_q = seen[-1][COLUMN["target_q"]].copy()
        arm.seen_at = time.monotonic()  # the proof of the way to the start held up this process, not the controller
        guard.check_state(replace(known, state=arm_state(arm.next_row())), but=("approach_clear",))
    except StreamFailure as failure:
        raise RobotUnreachable(f"{host}: {failure}") from None
    return arm


def take_control(arm: Arm) -> Array:
    """Upload the control program and set its watchdog; (J,) the pose in which the arm stands, as the controller's target.

    The constructor would stop any program that runs; `connect` saw none one tick ago.
    Raises MotionRefused where another client has the arm, StreamFailure where the program does not come up.
    """
    arm.outbox.message("phase", phase="control", duration_s=0.0)
    try:
        arm.control = RTDEControlInterface(arm.settings.host, arm.settings.rate_hz)
    except RuntimeError as error:
        if "already in use" in str(error):  # said before anything was uploaded
            raise MotionRefused(f"another RTDE client controls the arm: {error}") from None
        raise StreamFailure("no_control", f"the control program did not start: {error}") from None
    arm.seen_at = time.monotonic()  # the constructor held up this process, not the controller
    arm.looked_at = arm.seen_at
    begin_q: Array = arm.next_row()[COLUMN["target_q"]].copy()
    assert arm.proved_q is not None
    moved = np.abs(begin_q - arm.proved_q)  # (J,)
    if not np.all(moved <= MOVED_RAD):
        j = int(np.argmax(moved))
        raise StreamFailure("no_control", f"joint {j + 1} was moved by {moved[j]:.3f} rad since the way to the start was proved")
    arm.recent.append(begin_q)
    if not arm.control.setWatchdog(arm.settings.watchdog_hz):
        raise StreamFailure("no_watchdog", "the controller did not accept the watchdog")
    return begin_q


def _unless_stopped(arm: Arm) -> None:
    """Raises Stopped where somebody asked so late that the phase before ended by itself: at rest, but not played as designed."""
    if arm.asked_to_stop:
        raise Stopped


def stream(arm: Arm, phase: str, duration_s: float, position: Callable[[float], Array], *, keep: bool = False) -> None:
    """Stream position(τ), τ from 0 to the duration; with `keep`, every row goes to the parent.

    τ is the robot's own time. If a late cycle skipped ticks, τ falls behind by what exceeds two ticks rather than
    throw the arm after it. A stop request lets τ run out within STOP_RAMP_S, then raises Stopped; nothing begins after one.
    """
    _unless_stopped(arm)
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

    Raises StreamFailure if that takes longer than SETTLE_S.
    """
    arm.outbox.message("phase", phase="settle", duration_s=STILL_S)
    target = arm.recent[-1]
    still_s = waited_s = 0.0
    while still_s < STILL_S:
        row = arm.next_row()
        arm.cycle(target, row)
        arm.tell()
        waited_s += arm.step_s
        slow = np.max(np.abs(row[COLUMN["actual_qd"]])) < STANDSTILL_RAD_S and np.max(np.abs(row[COLUMN["target_qd"]])) < 1e-3
        still_s = still_s + arm.step_s if slow else 0.0
        if waited_s > SETTLE_S:
            raise StreamFailure("restless", f"the arm did not come to rest within {SETTLE_S:g} s")


def finish(arm: Arm) -> None:
    """End the control program; the arm is at rest."""
    assert arm.control is not None
    arm.outbox.message("phase", phase="finish", duration_s=0.0)
    if not arm.control.servoStop(SERVO_STOP_RAD_S2):
        raise arm.why_refused()
    arm.control.stopScript()
    for _ in range(100):  # 1 s
        if arm.receive.getRuntimeState() != RUNTIME_PLAYING:
            return
        time.sleep(0.01)
    raise StreamFailure("program_stopped", "the control program still runs although it was asked to end")


def play(arm: Arm, known: ConditionInputs, begin_q: Array) -> None:
    """The whole motion: approach, excitation, return, each followed by rest."""
    settings, excitation = arm.settings, known.excitation
    arm.gap_s = arm.longest_gap_s = 0.0  # proofs and uploads took their time, before anything moved
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


def facts(job: dict[str, Any]) -> ConditionInputs:
    """What the parent knows of this replay."""
    cell = None if job["cell"] is None else cell_from_document(job["cell"])
    excitation = excitation_from_document(job["excitation"])
    return guard.inputs(
        ReplaySettings(**{**job["settings"], "cell": cell}), excitation, load_robot(excitation.robot), Context(**job["context"])
    )


def main() -> None:
    """One replay, as the job on standard input says; never returns."""
    job, outbox, lifeline = begin()
    # before ur-rtde starts its threads, which inherit it. A simulated arm shares our processors: it would be starved, and only it
    scheduled = not ipaddress.ip_address(job["settings"]["host"]).is_loopback and real_time()
    gc.disable()  # the process lives for one replay; a collection would cost several ticks
    arm: Arm | None = None
    try:
        known = facts(job)
        guard.check_quick(known.settings, known.excitation, known.robot)
        arm = connect(job, outbox, lifeline, known)
        play(arm, known, take_control(arm))
        outbox.message(
            "done",
            missed_ticks=arm.missed,
            torn_reads=arm.torn,
            slipped_s=arm.slipped_s,
            longest_gap_s=arm.longest_gap_s,
            real_time=scheduled,
        )
        leave(0)
    except StreamFailure as failure:
        named = failure if arm is None else arm.named(failure)
        outbox.message("failed", cause=named.cause, text=str(named))
    except Stopped:
        cause = "parent_asked_to_stop" if arm is None else arm.asked_to_stop
        outbox.message("failed", cause=cause, text="stopped on request; the arm stands")
    except RobotUnreachable as error:
        outbox.message("unreachable", text=str(error))
    except MonitorError as error:
        outbox.message("refused", text=str(error))
    except BaseException as error:
        outbox.message("failed", cause="internal", text=f"{type(error).__name__}: {error}")
    leave(1)


if __name__ == "__main__":
    main()
