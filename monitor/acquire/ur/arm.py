"""The arm as the streaming process holds it: both ur-rtde connections, and the fixed order of one cycle.

A cycle takes one complete, new row, checks everything that may be wrong, and sends one target. What is wrong is raised as a
`StreamFailure` with its cause; after that nobody may call ur-rtde again. How the arm is taken and given up is behind `TakesTheArm`.
"""

import math
import time
from collections import deque
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np

from monitor.acquire.child import Lifeline, Outbox
from monitor.acquire.driver import ReplayTask
from monitor.acquire.protocol import Event, State
from monitor.acquire.safety.inputs import ConditionInputs
from monitor.acquire.safety.torque_band import TorqueBand
from monitor.acquire.state import arm_state
from monitor.acquire.ur.control import STANDING_S, Control
from monitor.acquire.ur.failures import CycleGaps, StreamFailure, Tracking, gap_failure, state_failure
from monitor.acquire.ur.receive import POLL_S, PacketTiming, TornRow, connect_receiver, read_row
from monitor.acquire.ur.rtde import COLUMN
from monitor.reason import Sentence
from monitor.recording import Array

RECENT_TARGETS = 25  # 0.2 s at 125 Hz: longer than servoJ's lookahead and the servo's lag together
DEAD_MAN_MARGIN_S = 0.01  # the dead-man timer is so much longer than the longest gap: this process reports a gap itself if it can
SIGN_OF_LIFE_S = 0.01  # without a row for so long the parent gets another sign: it ends this process after 60 ms of silence
SUSPECT_SHARE = 0.8  # of the largest age of a row: from here on a stall is suspected
TARGET_TICKS = 2.2  # a target may be so many ticks of full speed from the one before: a cycle advances by at most two ticks
LONGEST_STEP_S = 10.0  # of the controller's clock between two rows of a standing arm; more means that the controller was restarted
SPEED_RISE_S = 1.0  # after the start of a program the trajectory limiter reports 0 for 4 to 20 ms
MOVED_RAD = 0.005  # an arm moved by more between the proof of its approach and its first target would take an unproved path
UNWATCHED_S = 0.5  # without a word from the parent, which says one every 0.1 s: it is stopped, or hangs, or has no processor time
REASON_READS, REASON_PAUSE_S = 4, 0.005  # how often and how far apart the state is read after a target was refused: two ticks and more


class TakesTheArm(Protocol):
    """One way to take the arm and to give it up: our own program is sent, or a program that plays lends it. All else is the same."""

    variables: tuple[str, ...]  # received beside the rows
    anywhere: bool  # the arm may be given up wherever it rests; False: only where it was taken
    absent_s: float  # an arm that waits for GO is given up where the parent says nothing for so long
    in_doubt: bool  # another program than the one that has the arm for us may be what plays

    def prepare(self, arm: "Arm", known: ConditionInputs) -> None:
        """What must be done before the arm is seen in order. Raises Stopped, MotionRefused, StreamFailure."""

    def kept(self, arm: "Arm") -> AbstractContextManager[None]:
        """While the arm stands, and computing takes time: whatever refuses the motion or stops it gives the arm up."""

    def connect(self, arm: "Arm") -> None:
        """Open the control connection after GO, where `prepare` has not. Raises RobotUnreachable, MotionRefused."""

    def take_control(self, arm: "Arm") -> None:
        """Make the arm take targets, and prove what stops it if this process dies. Raises StreamFailure, Stopped, MotionRefused."""

    def guard(self, arm: "Arm") -> None:
        """From now on something else than this process stops the arm where targets do not come. Raises StreamFailure."""

    def failure(self, arm: "Arm", found: StreamFailure | None) -> StreamFailure | None:
        """The more telling of what the controller's state says (`found`) and why the arm is not ours any longer; None: all is in order."""

    def beat(self) -> None:
        """Say once more that the arm is watched: with each target, and with each row while it stands. Raises StreamFailure."""

    def beats(self) -> AbstractContextManager[None]:
        """Say so while this process computes or waits for one answer; the arm stands."""

    def give_up(self, arm: "Arm") -> None:
        """Give the arm up, at rest for good and without a stream of targets. Raises StreamFailure where that is not seen to have worked."""

    def leave_nothing_behind(self, arm: "Arm", failure: StreamFailure) -> None:
        """After a failure: end what nobody else would end. Raises StreamFailure."""


ARM_WAS_MOVED = Sentence("arm_was_moved", "{joint:joint} was moved by {moved_rad:.3f} rad since the way to the start was proved")
CONNECTION_CLOSED = Sentence("connection_closed", "the controller closed the RTDE connection")
DATA_BROKE_OFF = Sentence("data_broke_off", "the RTDE data broke off: {why}")
CLOCK_JUMPED = Sentence("clock_jumped", "the controller's clock jumped by {step_s:.3f} s")
DATA_GAP = Sentence("data_gap", "the controller's data has a gap of {gap_ms:.0f} ms")
TARGET_WRONG = Sentence("target_wrong", "target {target_rad:g} after {last_rad:g}: not finite, too far, or out of range")
TARGET_LATE = Sentence("target_late", "{gap_ms:.0f} ms after the last target: this process got no processor time")
TARGET_NOT_TAKEN = Sentence("target_not_taken", "the control program did not take the target")


class Arm:
    """Both connections to the controller, and what one cycle does with them."""

    def __init__(self, task: ReplayTask, outbox: Outbox, lifeline: Lifeline, taking: TakesTheArm) -> None:
        """Connect the receiver. Raises RuntimeError as ur-rtde does."""
        self.taking = taking
        self.state = State.at_start(lent=task.settings.lent is not None).after(Event.CONNECT)
        self.settings, self.robot, self.program = task.settings, task.robot, task.program
        self.payload_kg = task.context.payload_kg
        self.proved_q: Array | None = None  # (J,) [rad] the position from which the way to the start was proved clear
        self.tick_s = 1.0 / self.settings.rate_hz
        self.outbox, self.lifeline = outbox, lifeline
        self.receive, self.signals = connect_receiver(self.settings.host, self.settings.rate_hz, taking.variables)
        self.connection: Control | None = None
        self.seen_at = self._checked_at = time.monotonic()  # [s] when the last row was read, and when the next check for a row was due
        self.gaps = CycleGaps()
        self._row: Array | None = None  # (WIDTH,) the newest; None: none has come
        self._told_at = 0.0  # [s] when the parent last heard from this process
        self._sent_at = 0.0  # [s] when the last target was sent
        self._timestamp_s = self.receive.getTimestamp()
        self._timing = PacketTiming(timestamp_s=self._timestamp_s, offset_s=self.seen_at - self._timestamp_s)
        self._tracking = Tracking(
            self.tick_s, largest_rad=self.settings.max_following_error_rad, lasting_rad=self.settings.max_tracking_error_rad
        )
        self.step_s = 0.0  # controller's time between the last two rows
        self.recent: deque[Array] = deque(maxlen=RECENT_TARGETS)
        self.program_sent = False  # a program with our commands may run
        self.stop_cause = "parent_asked_to_stop"  # why the arm was ordered to rest, where it was
        self._heard_at = time.monotonic()  # when the parent last said anything
        self.band: TorqueBand | None = None  # of the motion; `guard_torque` sets it before anything moves
        self.missed = self.torn = 0  # ticks without a target; rows that were read again
        self.slipped_s = 0.0  # delay of the motion behind its plan

    def note_busy(self) -> None:
        """Note that this process was busy with something else: the age of the last row says nothing about the controller."""
        self.seen_at = self._checked_at = time.monotonic()

    def guard_torque(self, band: TorqueBand) -> None:
        """Let every row of the motion pass this band before the next target is sent."""
        self.band = band
        self.note_busy()  # its preparation takes some tenths of a second

    def approach_proved(self, target_q: Array) -> None:
        """Note that the way to the start was proved clear from this position (J,) [rad]."""
        self.proved_q = target_q.copy()
        self.note_busy()  # the proof takes longer than a row may be old

    def connect_control(self, *, lent: bool) -> None:
        """Open the control connection. From now on this process opens no other.

        Raises RobotUnreachable, or MotionRefused where another client controls the arm.
        """
        self.connection = Control(
            self.settings.host,
            self.settings.rate_hz,
            lent=lent,
            program=self.program,
            calling=lambda call: self.outbox.message("calling", call=call),
        )
        self.note_busy()  # the constructor takes some tenths of a second
        self.control.report()

    @property
    def control(self) -> Control:
        """The control connection, which must be open."""
        assert self.connection is not None
        return self.connection

    def say(self, event: Event, **content: Any) -> None:
        """Do what the protocol calls by this name, and tell the parent."""
        self.state = self.state.after(event)
        self.outbox.message(event, **content)

    def obey(self, event: Event, cause: str = "parent_asked_to_stop") -> None:
        """Take an order. One that has crossed with what this process did since is void."""
        if self.state.allows(event):
            self.state = self.state.after(event)
            self.stop_cause = cause

    def fresh_row(self) -> Array:
        """A row (WIDTH,) that came while this process waited for it: at most one tick old."""
        self.next_row()
        return self.next_row()

    def wait_for_full_speed(self) -> None:
        """Wait until the controller's own limiter lets the program play at full speed. Raises StreamFailure where it does not."""
        since_s = self.seen_at
        while True:
            state = arm_state(self.next_row())
            if failure := state_failure(state, self.settings, self.payload_kg, up_to_speed=self.seen_at - since_s > SPEED_RISE_S):
                raise failure
            if math.isnan(state.speed) or state.at_full_speed:
                return

    def begin(self) -> Array:
        """Begin to send targets. Returns the position (J,) in which the arm stands, as the controller's target.

        Raises StreamFailure.
        """
        begin_q: Array = self.next_row()[COLUMN["target_q"]].copy()
        assert self.proved_q is not None
        moved = np.abs(begin_q - self.proved_q)  # (J,)
        if not np.all(moved <= MOVED_RAD):
            j = int(np.argmax(moved))
            raise StreamFailure("no_control", ARM_WAS_MOVED(joint=j + 1, moved_rad=moved[j]))
        self.taking.guard(self)
        self.recent.append(begin_q)
        self.note_busy()
        self.gaps.clear()  # proofs and the upload took their time before anything moved
        self._sent_at = self._heard_at = self.seen_at
        self.control.report_every(self.settings.max_timestamp_age_s + DEAD_MAN_MARGIN_S)
        return begin_q

    def rest(self) -> None:
        """Note that the arm has come to rest for good: no more targets are sent."""
        self.control.report_every(STANDING_S)

    @property
    def unheard_s(self) -> float:
        """For how long the parent has said nothing."""
        return time.monotonic() - self._heard_at

    @property
    def _cut(self) -> bool:
        """Whether one of the connections has come to its end."""
        return not self.receive.isConnected() or (self.connection is not None and not self.connection.connected)

    def count_cycle(self, advance_s: float) -> None:
        """Count the ticks that this cycle missed, and the time by which the motion fell behind because it advanced by advance_s only."""
        self.missed += max(round(self.step_s / self.tick_s) - 1, 0)
        self.slipped_s += self.step_s - advance_s

    def next_row(self) -> Array:
        """The next tick's row (WIDTH,), waiting for it.

        Raises StreamFailure where none comes, where the connection is lost, and, while the arm moves, after every gap that is too long.
        Leaves the process where the parent is gone.
        """
        before_s, longest_s, suspected_at = self.seen_at, 0.0, None
        limit_s = self.settings.max_timestamp_age_s
        while True:
            now = time.monotonic()
            longest_s = max(longest_s, now - self._checked_at)
            self.gaps.add(now, now - self._checked_at)
            self._checked_at = now
            if self._cut:
                raise StreamFailure("connection_lost", CONNECTION_CLOSED())
            if self.state.streams and now - before_s >= limit_s:
                raise gap_failure(now - before_s, longest_s, limit_s)
            if self.receive.getTimestamp() != self._timestamp_s:
                break
            if now - before_s > SUSPECT_SHARE * limit_s:
                # perhaps this process slept: give ur-rtde's own thread a moment to decode what has arrived
                suspected_at = suspected_at or now
                if now - before_s > limit_s and now - suspected_at > (1.0 - SUSPECT_SHARE) * limit_s:
                    raise gap_failure(now - before_s, longest_s, limit_s)
            self._listen_to_parent()
            self._tell_if_due(now)
            self._sleep()
        try:
            row, again = read_row(self.receive, self.signals)
        except (TornRow, RuntimeError) as error:
            raise StreamFailure("connection_lost", DATA_BROKE_OFF(why=str(error))) from None
        self.torn += again
        row[COLUMN["host_monotonic_s"]] = self.seen_at = time.monotonic()
        self._row = row
        timestamp_s = float(row[0])
        self._timing = self._timing.arrived(timestamp_s, self._checked_at)
        self.step_s = timestamp_s - self._timestamp_s
        self._timestamp_s = timestamp_s
        self.gaps.add(self.seen_at, self.step_s)
        if not 0.0 < self.step_s < LONGEST_STEP_S or (self.state.streams and self.step_s >= self.seen_at - before_s + limit_s):
            raise StreamFailure("controller_restarted", CLOCK_JUMPED(step_s=self.step_s))
        if self.state.streams and self.step_s >= limit_s:
            raise StreamFailure("stalled", DATA_GAP(gap_ms=1000 * self.step_s))
        if self.connection is not None:
            self.connection.report()
            if not self.state.streams:
                self._tell_if_due(self.seen_at)
        if not self.state.streams:
            self.taking.beat()
        return row

    def _sleep(self) -> None:
        """Sleep until shortly before the next packet is expected. The part that was planned beyond one poll is no gap."""
        began = time.monotonic()
        planned_s = self._timing.sleep_s(began, self.tick_s)
        time.sleep(planned_s)
        self._timing = self._timing.woke(time.monotonic() - began - planned_s)
        self._checked_at += planned_s - POLL_S

    def cycle(self, target: Array, row: Array, phase_s: float | None = None) -> None:
        """Check the row (WIDTH,), send the target (J,) for it, and enter the target in the row.

        phase_s : time since the beginning of the trajectory's repetition, where it is played at its pace [s].
        Raises StreamFailure where anything is wrong; the target is not sent then.
        """
        self._listen_to_parent()
        settings = self.settings
        failure = self.taking.failure(self, state_failure(arm_state(row), settings, self.payload_kg))
        failure = failure or self._tracking.failure(
            row[COLUMN["actual_q"]],
            row[COLUMN["target_q"]],
            row[COLUMN["target_qd"]],
            np.array(self.recent),
            late=self.gaps.were_late(self.seen_at, self.tick_s),
            step_s=self.step_s,
        )
        assert self.band is not None
        outside = self.band.outside(row, phase_s)
        if failure is None and outside is not None:
            failure = StreamFailure(*outside)
        if failure:
            raise failure
        if not self.state.must_rest and not self._permitted(row):
            self.obey(Event.STOP, "permit_withdrawn")
        last = self.recent[-1]
        allowed = self.robot.max_speed_rad_s * TARGET_TICKS * self.tick_s + 1e-6  # (J,) [rad], with rounding
        if not (np.all(np.abs(target - last) <= allowed) and np.all(np.abs(target) <= self.robot.reach_rad)):
            raise StreamFailure("bad_target", TARGET_WRONG(target_rad=np.round(target, 4), last_rad=np.round(last, 4)))
        gap_s = time.monotonic() - self._sent_at
        if gap_s >= settings.max_timestamp_age_s:
            raise StreamFailure("late", TARGET_LATE(gap_ms=1000 * gap_s))
        if not self.control.servo(target, self.tick_s, settings.lookahead_s, settings.gain):
            raise self.refusal()
        self.taking.beat()  # each target is a beat, and nothing else is while the arm moves
        self._sent_at = time.monotonic()
        self.gaps.add(self._sent_at, gap_s)
        self.recent.append(target)
        row[COLUMN["commanded_q"]] = target

    def _permitted(self, row: Array) -> bool:
        """Whether the digital input that gives the permit is on; True where none is configured, False where it is not reported."""
        number = self.settings.permit_input
        return number is None or bool(int(np.nan_to_num(row[COLUMN["actual_digital_input_bits"]][0])) >> number & 1)

    def tell(self, row: Array | None = None) -> None:
        """Send the row (WIDTH,) to the parent, or a sign of life: the parent hears from this process in every tick while the arm moves."""
        self._told_at = self.seen_at
        if row is None:
            self.outbox.alive(self._row)
        else:
            self.outbox.row(row)

    def _tell_if_due(self, now: float) -> None:
        """A sign of life where the next row is late. Before the arm moves it says too that what runs now is ours."""
        if self.connection is None or now - self._told_at <= SIGN_OF_LIFE_S:
            return
        self._told_at = now
        if self.state.streams or self.taking.in_doubt:
            self.outbox.waiting()
        else:
            self.outbox.alive(self._row)

    def explained(self, failure: StreamFailure) -> StreamFailure:
        """The failure by its true cause: `late` where targets came late just before it, because of this process or the network."""
        if not self.recent:
            return failure  # no target was due yet
        return self.gaps.explain(failure, time.monotonic(), tick_s=self.tick_s, watchdog_s=1.0 / self.settings.watchdog_hz)

    def refusal(self) -> StreamFailure:
        """Why a command was refused. The next rows say so; reading what was received sends nothing to the controller.

        A program that ends because its connection was cut was not stopped by anybody.
        """
        for _ in range(REASON_READS):
            time.sleep(REASON_PAUSE_S)
            try:
                row, _ = read_row(self.receive, self.signals)
            except (TornRow, RuntimeError):
                break
            failure = state_failure(arm_state(row), self.settings, self.payload_kg)
            if failure is not None and not (failure.cause == "program_stopped" and self._cut):
                return failure
        if self._cut:
            return StreamFailure("connection_lost", CONNECTION_CLOSED())
        return StreamFailure("servo_refused", TARGET_NOT_TAKEN())

    def _listen_to_parent(self) -> None:
        word = self.lifeline.word()
        if word is not None:
            self._heard_at = time.monotonic()
        elif self.state.streams and not self.state.must_rest and self.unheard_s > UNWATCHED_S:
            self.obey(Event.STOP, "late")  # the parent asks whether motion is still allowed: without it nobody does
        if word in {Event.GO, Event.BACK, Event.STOP}:
            self.obey(Event(word))
