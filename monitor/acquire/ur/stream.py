"""The streaming process of one replay: `python -m monitor.acquire.ur.stream`. The only place that moves an arm.

It sends one continuous stream of servoJ targets: approach, excitation, return, each a smooth path whose time is the robot's own clock.
When anything is wrong it reports the cause and ends, without another call of ur-rtde: no more targets come, and the controller's
watchdog stops the arm.
"""

import gc
import ipaddress
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from monitor.acquire.child import Lifeline, Outbox, begin, leave, request_real_time
from monitor.acquire.driver import ReplayTask
from monitor.acquire.protocol import Event, Order, Phase, Program
from monitor.acquire.safety.conditions import check_quick, check_state
from monitor.acquire.safety.inputs import ConditionInputs, LastMotion
from monitor.acquire.safety.torque_band import TorqueBand, band_for
from monitor.acquire.safety.way import Left
from monitor.acquire.state import STANDSTILL_RAD_S, arm_state
from monitor.acquire.ur.arm import UNWATCHED_S, Arm
from monitor.acquire.ur.failures import Stopped, StreamFailure
from monitor.acquire.ur.lend import Lend
from monitor.acquire.ur.rtde import COLUMN, CONNECTION_LOST
from monitor.acquire.ur.upload import Upload
from monitor.errors import AT_HOST, MonitorError, RobotUnreachable
from monitor.reason import Sentence
from monitor.recording import Array

STATE_ROWS = 13  # the accelerometer is averaged over so many rows: 0.1 s at 125 Hz
STATE_EVERY_S = 0.1  # the parent gets the state so often while the arm waits for GO
STILL_S = 0.15  # the arm must be at rest for so long before the next phase begins
STILL_TARGET_RAD_S = 1e-3  # the controller's own target stands still below this speed
SETTLE_S = 3.0  # an arm that does not come to rest within this time has a problem
STOP_RAMP_S = 0.4  # when a stop is asked for, the arm slows down along its path within this time
MOST_TICKS = 2.0  # a cycle advances along the path by at most so many ticks, so that a late cycle does not throw the arm forward
TIME_ROUNDING_S = 1e-6  # the controller's timestamps carry rounding
SERVO_STOP_RAD_S2 = 5.0  # deceleration of servoStop; the arm is at rest already


RTDE_SENDS_NOTHING = Sentence("rtde_sends_nothing", "{host}: RTDE answers but sends no data")


def connect(arm: Arm, task: ReplayTask, known: ConditionInputs) -> None:
    """See the arm in order and at rest for STATE_ROWS rows, wait for GO, and open both connections. No program of ours runs yet.

    An arm that a program lends is taken before that, and given back where anything refuses the motion.
    Raises RobotUnreachable or MotionRefused; Stopped where the parent withdraws the replay; StreamFailure where a lent arm is not given
    back.
    """
    host, taking = known.settings.host, arm.taking
    if not arm.receive.isConnected():
        raise RobotUnreachable(RTDE_SENDS_NOTHING(host=host))
    try:
        taking.prepare(arm, known)
        with taking.kept(arm):
            _prove(arm, task, known)
        taking.connect(arm)
        with taking.kept(arm):
            check_state(replace(known, state=arm_state(arm.fresh_row())), without=("approach_clear",))
    except StreamFailure as failure:
        if arm.program_sent:
            raise
        raise RobotUnreachable(AT_HOST(host=host, why=failure.reason)) from None


def _prove(arm: Arm, task: ReplayTask, known: ConditionInputs) -> None:
    """See the arm in order and at rest, wait for GO, and prove the way to the start. Raises MotionRefused, Stopped, StreamFailure."""
    rows = [arm.next_row() for _ in range(STATE_ROWS)]
    for row in rows:
        check_state(replace(known, state=arm_state(row)), without=("approach_clear",))
    arm.guard_torque(_band(task, rows[-1]))
    last = wait_for_go(arm, rows)
    check_state(replace(known, state=arm_state(last)))
    arm.approach_proved(last[COLUMN["target_q"]])
    check_state(replace(known, state=arm_state(arm.next_row())), without=("approach_clear",))


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
    """Report the state to the parent until it says GO; the last row (WIDTH,).

    Raises Stopped where it says STOP, and where it says nothing while a program waits for its arm.
    """
    arm.say(Event.READY, duration_s=0.0)
    reported_at = 0.0
    while not arm.state.gone:
        if arm.unheard_s > arm.taking.absent_s:
            raise Stopped("late")  # nobody would ever say GO, and the program waits for its arm
        if arm.seen_at - reported_at > STATE_EVERY_S:
            row, column = rows[-1].copy(), COLUMN["actual_tool_accelerometer"]
            row[column] = np.mean([each[column] for each in rows], axis=0)  # a single reading of an accelerometer is noisy
            arm.outbox.message("state", row=row.tolist())
            reported_at = arm.seen_at
        _raise_if_asked_to_stop(arm)
        rows = [*rows[1:], arm.next_row()]
    return rows[-1]


def take_control(arm: Arm) -> Array:
    """Take control of the standing arm. Returns the position (J,) in which it stands, as the controller's target. No target is sent yet.

    Raises StreamFailure; Stopped where a stop was asked for before, MotionRefused with an arm that was given back.
    """
    with arm.taking.kept(arm):
        _raise_if_asked_to_stop(arm)
    arm.taking.take_control(arm)
    return arm.begin()


def _raise_if_asked_to_stop(arm: Arm) -> None:
    """Raises Stopped where the request came so late that the phase before ended by itself."""
    if arm.state.must_rest:
        raise Stopped(arm.stop_cause)


def stream(arm: Arm, event: Event, duration_s: float, position: Callable[[float], Array], *, keep: bool = False) -> None:
    """Begin a phase, and stream position(τ), τ from 0 to duration_s; with `keep` every row goes to the parent.

    After a request to stop, τ comes to rest within STOP_RAMP_S. Raises Stopped then, and at once where the request came before.
    """
    _raise_if_asked_to_stop(arm)
    arm.say(event, duration_s=duration_s)
    follow(arm, duration_s, position, keep=keep)


def follow(arm: Arm, duration_s: float, position: Callable[[float], Array], *, keep: bool = False) -> None:
    """Stream position(τ) in the present phase, as `stream`.

    τ follows the robot's own clock. Where a late cycle skipped ticks, τ falls behind by what exceeds MOST_TICKS.
    """
    tau_s, pace, begun = 0.0, 1.0, False
    while True:
        row = arm.next_row()
        if begun:
            advance_s = min(arm.step_s, MOST_TICKS * arm.tick_s)
            if keep:
                arm.count_cycle(advance_s)
            if arm.state.must_rest:
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
            raise Stopped(arm.stop_cause)
        if tau_s == duration_s:
            return


RESTLESS = Sentence("restless", "the arm did not come to rest within {limit_s:g} s")


def settle(arm: Arm) -> None:
    """Hold the last target until the arm has been at rest for STILL_S.

    Raises StreamFailure if that takes longer than SETTLE_S.
    """
    arm.say(Event.SETTLE, duration_s=STILL_S)
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
            raise StreamFailure("restless", RESTLESS(limit_s=SETTLE_S))


def finish(arm: Arm) -> None:
    """End the stream of targets of an arm at rest, and give the arm up.

    Raises StreamFailure where that is not seen to have worked.
    """
    arm.say(Event.FINISH, duration_s=0.0)
    arm.rest()
    with arm.taking.beats():
        if not arm.control.stop_servo(SERVO_STOP_RAD_S2):
            raise arm.refusal()
    arm.taking.give_up(arm)


def play(arm: Arm, known: ConditionInputs, begin_q: Array) -> None:
    """The whole motion: approach or way back, excitation, return. The arm comes to rest after each but the excitation.

    Raises StreamFailure; Stopped where a stop was asked for, with the arm at rest, and given up where that is possible.
    """
    way = known.way_from_position(begin_q)
    excitation, there, back = way.excitation, way.to_start(arm.settings), way.to_home(arm.settings)
    try:
        stream(arm, Event.APPROACH if way.back_from_s is None else Event.WAY_BACK, there.duration_s, there.at)
        settle(arm)
        stream(arm, Event.PLAY, excitation.duration_s, lambda tau_s: excitation.at(np.array([tau_s])).q[0], keep=True)
        stream(arm, Event.RETURN, back.duration_s, back.at)
        settle(arm)
    except Stopped:
        on_path = arm.state.phase is Phase.PLAY
        settle(arm)
        if arm.taking.anywhere:
            finish(arm)
        elif arm.state.order is Order.BACK:
            _bring_back(arm, known, begin_q, on_path=on_path)
        raise
    finish(arm)


OFF_PATH = Sentence("off_path", "the arm rests {off_path_rad:.2f} rad from its trajectory: there is no way back along it")


def _bring_back(arm: Arm, known: ConditionInputs, begin_q: Array, *, on_path: bool) -> None:
    """Bring a lent arm, which rests where a stop was asked for, back over the way it came to begin_q (J,), and give it back.

    Raises StreamFailure; Stopped where another stop was asked for meanwhile: the arm rests there, and is not given back.
    """
    here = arm.recent[-1]
    left = Left(path_digest=known.excitation.path_digest, on_path=on_path, q=tuple(here), home_q=tuple(begin_q), free=True)
    way = replace(known, last=LastMotion(left=left)).way_from_position(here)
    if on_path and way.back_from_s is None:
        raise StreamFailure("astray", OFF_PATH(off_path_rad=way.off_path_rad))
    there, back = way.to_start(arm.settings), way.to_home(arm.settings)
    arm.say(Event.WAY_BACK, duration_s=there.duration_s)
    follow(arm, there.duration_s, there.at)
    settle(arm)
    stream(arm, Event.RETURN, back.duration_s, back.at)
    settle(arm)
    finish(arm)


UNWATCHED = Sentence("unwatched", "the monitor's own process said nothing for {silence_s:g} s")
ON_REQUEST = Sentence("stop_requested", "stopped on request")
NOTHING_MOVED, ARM_BACK, ARM_STANDS = (
    Sentence("nothing_moved", "nothing has moved"),
    Sentence("arm_given_back", "the program has its arm back"),
    Sentence("arm_stands", "the arm stands"),
)
STOPPED_AT = Sentence("stopped_at", "{why}; {where}")
FAULT = Sentence("fault", "{kind}: {what}")


def main() -> None:
    """One replay, as the job on standard input says; never returns."""
    task: ReplayTask
    task, outbox, lifeline = begin()
    # before ur-rtde starts its threads, which inherit it; a simulated arm shares our processors and would get no time beside us
    real_time = not ipaddress.ip_address(task.settings.host).is_loopback and request_real_time()
    gc.disable()  # the process lives for one replay; a collection would take several ticks
    arm: Arm | None = None
    try:
        known = ConditionInputs(
            settings=task.settings,
            excitation=task.excitation,
            robot=task.robot,
            context=task.context,
            installation=task.installation,
            last=LastMotion(left=task.left),
        )
        check_quick(known)
        outbox.message(Event.CONNECT, duration_s=0.0)
        arm = _arm(task, outbox, lifeline)
        connect(arm, task, known)
        play(arm, known, take_control(arm))
        arm.say(
            Event.DONE,
            missed_ticks=arm.missed,
            torn_reads=arm.torn,
            slipped_s=arm.slipped_s,
            longest_gap_s=arm.gaps.longest_s,
            real_time=real_time,
        )
        leave(0)
    except StreamFailure as failure:
        assert arm is not None
        explained = arm.explained(failure)
        with suppress(StreamFailure):
            arm.taking.leave_nothing_behind(arm, failure)
        # without a program of ours the arm did not move, and what runs on the controller is somebody else's
        last = Event.FAILED if arm.program_sent else Event.STOPPED
        outbox.message(last, cause=explained.cause, found=failure.cause, reason=explained.reason.document(), ours=failure.ours)
    except Stopped as stopped:
        assert arm is not None
        before = arm.proved_q is None
        silence_s = arm.taking.absent_s if before else UNWATCHED_S
        why = UNWATCHED(silence_s=silence_s) if stopped.cause == "late" else ON_REQUEST()
        given_back = arm.state.program is Program.GOES_ON
        where = NOTHING_MOVED if before else ARM_BACK if given_back else ARM_STANDS
        # a lent arm away from its place is not given back
        last = Event.FAILED if arm.program_sent and not arm.taking.anywhere else Event.STOPPED
        outbox.message(last, cause=stopped.cause, reason=STOPPED_AT(why=why, where=where()).document())
    except RobotUnreachable as error:
        outbox.message(Event.UNREACHABLE, reason=error.reason.document())
    except MonitorError as error:
        outbox.message(Event.REFUSED, reason=error.reason.document())
    except BaseException as error:
        outbox.message(Event.FAILED, cause="internal", reason=FAULT(kind=type(error).__name__, what=str(error)).document())
    leave(1)


def _arm(task: ReplayTask, outbox: Outbox, lifeline: Lifeline) -> Arm:
    """The arm, which only receives yet. Raises RobotUnreachable."""
    try:
        return Arm(task, outbox, lifeline, Upload() if task.settings.lent is None else Lend())
    except RuntimeError as error:
        raise RobotUnreachable(CONNECTION_LOST(host=task.settings.host, why=str(error))) from None


if __name__ == "__main__":
    main()
