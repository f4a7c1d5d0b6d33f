"""The streaming process of one replay: `python -m monitor.acquire.ur.stream`. The only place that moves an arm.

It sends one continuous stream of servoJ targets: approach, excitation, return, each a smooth path whose time is the robot's own clock.
When anything is wrong it reports the cause and ends, without another call of ur-rtde: no more targets come, and the controller's
watchdog stops the arm.
"""

import gc
import ipaddress
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from monitor.acquire.child import Lifeline, Outbox, begin, leave, request_real_time
from monitor.acquire.driver import ReplayTask, task_from_document
from monitor.acquire.rows import COLUMN
from monitor.acquire.safety.conditions import check_quick, check_state, inputs
from monitor.acquire.safety.inputs import ConditionInputs
from monitor.acquire.safety.torque_band import TorqueBand, band_for
from monitor.acquire.safety.way import Left
from monitor.acquire.state import RUNTIME_PLAYING, STANDSTILL_RAD_S, arm_state
from monitor.acquire.ur import lend as borrow
from monitor.acquire.ur.arm import UNWATCHED_S, Arm
from monitor.acquire.ur.failures import Stopped, StreamFailure
from monitor.acquire.ur.upload import leave_nothing_behind, prove_watchdog, start_program
from monitor.errors import MonitorError, MotionRefused, RobotUnreachable
from monitor.recording import Array

STATE_ROWS = 13  # the accelerometer is averaged over so many rows: 0.1 s at 125 Hz
STATE_EVERY_S = 0.1  # the parent gets the state so often while the arm waits for `go`
STILL_S = 0.15  # the arm must be at rest for so long before the next phase begins
STILL_TARGET_RAD_S = 1e-3  # the controller's own target stands still below this speed
SETTLE_S = 3.0  # an arm that does not come to rest within this time has a problem
STOP_RAMP_S = 0.4  # when a stop is asked for, the arm slows down along its path within this time
MOST_TICKS = 2.0  # a cycle advances along the path by at most so many ticks, so that a late cycle does not throw the arm forward
TIME_ROUNDING_S = 1e-6  # the controller's timestamps carry rounding
SERVO_STOP_RAD_S2 = 5.0  # deceleration of servoStop; the arm is at rest already
END_CHECKS, END_PAUSE_S = 100, 0.01  # a control program that was asked to end gets 1 s


def connect(task: ReplayTask, outbox: Outbox, lifeline: Lifeline, known: ConditionInputs) -> Arm:
    """The arm in order and at rest for STATE_ROWS rows, held until the parent says `go`; then with both connections. No program runs yet.

    An arm that a program lends is taken before that, and given back where anything refuses the motion.
    Raises RobotUnreachable or MotionRefused; Stopped where the parent withdraws the replay; StreamFailure where a lent arm is not given
    back.
    """
    outbox.message("phase", phase="connect", duration_s=0.0)
    host = known.settings.host
    try:
        arm = Arm(task, outbox, lifeline)
    except RuntimeError as error:
        raise RobotUnreachable(f"{host}: RTDE: {error}") from None
    if not arm.receive.isConnected():
        raise RobotUnreachable(f"{host}: RTDE answers but sends no data")
    try:
        if arm.settings.lent is None:
            _prove(arm, task, known)
            arm.connect_control()
        else:
            arm.connect_control()
            borrow.take(arm, known)
            with _given_back_if_refused(arm), arm.beats():
                _prove(arm, task, known)
        with _given_back_if_refused(arm):
            check_state(replace(known, state=arm_state(arm.fresh_row())), without=("approach_clear",))
    except StreamFailure as failure:
        if arm.program_sent:
            raise
        raise RobotUnreachable(f"{host}: {failure}") from None
    return arm


def _prove(arm: Arm, task: ReplayTask, known: ConditionInputs) -> None:
    """See the arm in order and at rest, wait for `go`, and prove the way to the start. Raises MotionRefused, Stopped, StreamFailure."""
    rows = [arm.next_row() for _ in range(STATE_ROWS)]
    for row in rows:
        check_state(replace(known, state=arm_state(row)), without=("approach_clear",))
    arm.guard_torque(_band(task, rows[-1]))
    last = wait_for_go(arm, rows)
    check_state(replace(known, state=arm_state(last)))
    arm.approach_proved(last[COLUMN["target_q"]])
    check_state(replace(known, state=arm_state(arm.next_row())), without=("approach_clear",))


@contextmanager
def _given_back_if_refused(arm: Arm) -> Iterator[None]:
    """Give a lent arm back before a refusal or a request to stop is passed on: it has not moved."""
    try:
        yield
    except (MotionRefused, Stopped):
        if arm.node is not None:
            borrow.give_back(arm)
        raise


def _band(task: ReplayTask, row: Array) -> TorqueBand:
    """The torque band of this task's motion."""
    return band_for(
        row,
        robot=task.robot,
        excitation=task.excitation,
        settings=task.settings,
        context=task.context,
        installation=task.installation,
        basis=task.basis,
    )


def wait_for_go(arm: Arm, rows: list[Array]) -> Array:
    """Report the state to the parent until it says `go`; the last row (WIDTH,).

    Raises Stopped where it says `stop`, and where it says nothing while a program waits for its arm.
    """
    arm.outbox.message("phase", phase="ready", duration_s=0.0)
    reported_at = 0.0
    while not arm.may_go:
        if arm.node is not None and arm.unheard_s > borrow.ABSENT_S:
            raise Stopped("late")  # nobody would ever say `go`, and the program waits for its arm
        if arm.seen_at - reported_at > STATE_EVERY_S:
            row, column = rows[-1].copy(), COLUMN["actual_tool_accelerometer"]
            row[column] = np.mean([each[column] for each in rows], axis=0)  # a single reading of an accelerometer is noisy
            arm.outbox.message("state", row=row.tolist())
            reported_at = arm.seen_at
        if arm.asked_to_stop:
            raise Stopped
        rows = [*rows[1:], arm.next_row()]
    return rows[-1]


def take_control(arm: Arm) -> Array:
    """Start the control program twice: the first shows that its watchdog ends it, the second gets the targets.

    Returns the position (J,) in which the arm stands, as the controller's target. Until then no target is sent.
    Raises StreamFailure; Stopped where a stop was asked for before.
    """
    assert arm.control is not None
    if arm.node is not None:
        return _take_lent_control(arm)
    _raise_if_asked_to_stop(arm)
    arm.outbox.message("phase", phase="control", duration_s=0.0)
    start_program(arm)
    prove_watchdog(arm)
    start_program(arm)
    arm.control.end_uploads()
    arm.wait_for_full_speed()
    return arm.begin()


def _take_lent_control(arm: Arm) -> Array:
    """The position (J,) in which a lent arm stands, once its node is known to guard it. The control loop runs already."""
    arm.outbox.message("phase", phase="control", duration_s=0.0)
    with _given_back_if_refused(arm):
        _raise_if_asked_to_stop(arm)
        borrow.prove_guard(arm)
        borrow.at_full_speed(arm)
    return arm.begin()


def _raise_if_asked_to_stop(arm: Arm) -> None:
    """Raises Stopped where the request came so late that the phase before ended by itself."""
    if arm.asked_to_stop:
        raise Stopped


def stream(arm: Arm, phase: str, duration_s: float, position: Callable[[float], Array], *, keep: bool = False) -> None:
    """Stream position(τ), τ from 0 to duration_s; with `keep` every row goes to the parent.

    τ follows the robot's own clock. Where a late cycle skipped ticks, τ falls behind by what exceeds MOST_TICKS.
    After a request to stop, τ comes to rest within STOP_RAMP_S. Raises Stopped then, and at once where the request came before.
    """
    _raise_if_asked_to_stop(arm)
    arm.outbox.message("phase", phase=phase, duration_s=duration_s)
    tau_s, pace, begun = 0.0, 1.0, False
    while True:
        row = arm.next_row()
        if begun:
            advance_s = min(arm.step_s, MOST_TICKS * arm.tick_s)
            if keep:
                arm.count_cycle(advance_s)
            if arm.asked_to_stop:
                pace = max(pace - advance_s / STOP_RAMP_S, 0.0)
            tau_s += pace * advance_s
        begun = True
        tau_s = min(tau_s, duration_s) if tau_s < duration_s - TIME_ROUNDING_S else duration_s
        arm.cycle(position(tau_s), row, tau_s if keep and pace == 1.0 else None)
        if keep:
            arm.tell(row)
        else:
            arm.tell()
        if pace == 0.0:
            raise Stopped
        if tau_s == duration_s:
            return


def settle(arm: Arm) -> None:
    """Hold the last target until the arm has been at rest for STILL_S.

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
        slow = np.max(np.abs(row[COLUMN["actual_qd"]])) < STANDSTILL_RAD_S and np.max(np.abs(row[COLUMN["target_qd"]])) < STILL_TARGET_RAD_S
        still_s = still_s + arm.step_s if slow else 0.0
        if waited_s > SETTLE_S:
            raise StreamFailure("restless", f"the arm did not come to rest within {SETTLE_S:g} s")


def finish(arm: Arm) -> None:
    """End the stream of targets of an arm at rest, then the control program, or give a lent arm back.

    Raises StreamFailure where the program goes on, or where nobody says that it ended; where a lent arm is not given back.
    """
    assert arm.control is not None
    if arm.node is None:
        arm.outbox.message("phase", phase="finish", duration_s=0.0)
    arm.rest()
    with arm.beats():
        if not arm.control.stop_servo(SERVO_STOP_RAD_S2):
            raise arm.refusal()
    if arm.node is not None:
        borrow.give_back(arm)
        return
    arm.control.end_program()
    for _ in range(END_CHECKS):
        if arm.receive.getRuntimeState() != RUNTIME_PLAYING:
            return
        if not (arm.receive.isConnected() and arm.control.connected):
            raise StreamFailure("connection_lost", "the controller closed the RTDE connection before it said that the program has ended")
        arm.control.report()
        time.sleep(END_PAUSE_S)
    raise StreamFailure("program_stopped", "the control program still runs although it was asked to end")


def play(arm: Arm, known: ConditionInputs, begin_q: Array) -> None:
    """The whole motion: approach or way back, excitation, return. The arm comes to rest after each but the excitation.

    Raises StreamFailure; Stopped where a stop was asked for, with the arm at rest and the control program ended.
    """
    way, on_path = known.way_from_position(begin_q), False
    excitation, there, back = way.excitation, way.to_start(arm.settings), way.to_home(arm.settings)
    try:
        stream(arm, "approach" if way.back_from_s is None else "way_back", there.duration_s, there.at)
        settle(arm)
        on_path = True
        stream(arm, "play", excitation.duration_s, lambda tau_s: excitation.at(np.array([tau_s])).q[0], keep=True)
        on_path = False
        stream(arm, "return", back.duration_s, back.at)
        settle(arm)
    except Stopped:
        settle(arm)
        if arm.node is None:
            finish(arm)
        elif arm.bring_back:
            _bring_back(arm, known, begin_q, on_path=on_path)
        raise
    finish(arm)


def _bring_back(arm: Arm, known: ConditionInputs, begin_q: Array, *, on_path: bool) -> None:
    """Bring a lent arm, which rests where a stop was asked for, back over the way it came to begin_q (J,), and give it back.

    Raises StreamFailure; Stopped where another stop was asked for meanwhile: the arm rests there, and is not given back.
    """
    here, cause = arm.recent[-1], arm.asked_to_stop
    left = Left(path_digest=known.excitation.path_digest, on_path=on_path, q=tuple(here), home_q=tuple(begin_q), free=True)
    way = replace(known, left=left).way_from_position(here)
    if on_path and way.back_from_s is None:
        raise StreamFailure("astray", f"the arm rests {way.off_path_rad:.2f} rad from its trajectory: there is no way back along it")
    there, back = way.to_start(arm.settings), way.to_home(arm.settings)
    arm.asked_to_stop = None
    stream(arm, "way_back", there.duration_s, there.at)
    settle(arm)
    stream(arm, "return", back.duration_s, back.at)
    settle(arm)
    finish(arm)
    arm.asked_to_stop = cause


def main() -> None:
    """One replay, as the job on standard input says; never returns."""
    job, outbox, lifeline = begin()
    # before ur-rtde starts its threads, which inherit it; a simulated arm shares our processors and would get no time beside us
    real_time = not ipaddress.ip_address(job["settings"]["host"]).is_loopback and request_real_time()
    gc.disable()  # the process lives for one replay; a collection would take several ticks
    arm: Arm | None = None
    try:
        task = task_from_document(job)
        known = inputs(task.settings, task.excitation, task.robot, task.context, task.installation, task.left)
        check_quick(known)
        arm = connect(task, outbox, lifeline, known)
        play(arm, known, take_control(arm))
        outbox.message(
            "done",
            missed_ticks=arm.missed,
            torn_reads=arm.torn,
            slipped_s=arm.slipped_s,
            longest_gap_s=arm.gaps.longest_s,
            real_time=real_time,
        )
        leave(0)
    except StreamFailure as failure:
        explained = failure if arm is None else arm.explained(failure)
        if arm is not None:
            with suppress(StreamFailure):
                leave_nothing_behind(arm, failure)
        # without a program of ours the arm did not move, and what runs on the controller is somebody else's
        ended = arm is None or not arm.program_sent
        outbox.message("failed", cause=explained.cause, found=failure.cause, text=str(explained), ended=ended, ours=failure.ours)
    except Stopped as stopped:
        cause = (stopped.args or ("parent_asked_to_stop",))[0] if arm is None else arm.asked_to_stop
        silence_s = borrow.ABSENT_S if arm is None else UNWATCHED_S  # before and after `go`
        why = f"the monitor's own process said nothing for {silence_s:g} s" if cause == "late" else "stopped on request"
        ended = arm is None or arm.node is None or not arm.program_sent  # a lent arm away from its place is not given back
        where = "the program has its arm back" if arm is not None and arm.node is not None and ended else "the arm stands"
        where = "nothing has moved" if arm is None else where
        outbox.message("failed", cause=cause, text=f"{why}; {where}", ended=ended)
    except RobotUnreachable as error:
        outbox.message("unreachable", text=str(error))
    except MonitorError as error:
        outbox.message("refused", text=str(error))
    except BaseException as error:
        outbox.message("failed", cause="internal", text=f"{type(error).__name__}: {error}")
    leave(1)


if __name__ == "__main__":
    main()
