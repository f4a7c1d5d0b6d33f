"""The arm as the streaming process holds it: both ur-rtde connections, and the fixed order of one cycle.

A cycle takes one complete, new row, checks everything that may be wrong, and sends one target. What is wrong is raised as a
`StreamFailure` with its cause; after that nobody may call ur-rtde again.
"""

import math
import time
from collections import deque
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from monitor.acquire.child import Lifeline, Outbox
from monitor.acquire.driver import ReplayTask
from monitor.acquire.rows import COLUMN
from monitor.acquire.safety.torque_band import TorqueBand
from monitor.acquire.state import RUNTIME_STOPPED, RUNTIME_STOPPING, arm_state
from monitor.acquire.ur.control import STANDING_S, Control
from monitor.acquire.ur.failures import CycleGaps, StreamFailure, Tracking, gap_failure, state_failure
from monitor.acquire.ur.node import VARIABLES, Node
from monitor.acquire.ur.primary import ProgramMessages
from monitor.acquire.ur.receive import POLL_S, PacketTiming, TornRow, connect_receiver, read_row
from monitor.reason import joint_text
from monitor.recording import Array

RECENT_TARGETS = 25  # 0.2 s at 125 Hz: longer than servoJ's lookahead and the servo's lag together
DEAD_MAN_MARGIN_S = 0.01  # the dead-man timer is so much longer than the longest gap: this process reports a gap itself if it can
SIGN_OF_LIFE_S = 0.01  # without a row for so long the parent gets another sign: it ends this process after 60 ms of silence
SUSPECT_SHARE = 0.8  # of the largest age of a row: from here on a stall is suspected
TARGET_TICKS = 2.2  # a target may be so many ticks of full speed from the one before: a cycle advances by at most two ticks
LONGEST_STEP_S = 10.0  # of the controller's clock between two rows of a standing arm; more means that the controller was restarted
ANSWER_S, ANSWER_TICKS = 0.05, 5.0  # our program answers two to four ticks after its start; the larger of both is the limit
SPEED_RISE_S = 1.0  # after the start of a program the trajectory limiter reports 0 for 4 to 20 ms
MOVED_RAD = 0.005  # an arm moved by more between the proof of its approach and its first target would take an unproved path
UNWATCHED_S = 0.5  # without a word from the parent, which says one every 0.1 s: it is stopped, or hangs, or has no processor time
UNGUARDED_S = 0.1  # a beat comes back after two ticks; a guard that repeats none for so long does not run
REASON_READS, REASON_PAUSE_S = 4, 0.005  # how often and how far apart the state is read after a target was refused: two ticks and more


class Arm:
    """Both connections to the controller, and what one cycle does with them."""

    def __init__(self, task: ReplayTask, outbox: Outbox, lifeline: Lifeline) -> None:
        """Connect the receiver. Raises RuntimeError as ur-rtde does."""
        self.settings, self.robot = task.settings, task.robot
        self.payload_kg = task.context.payload_kg
        self.proved_q: Array | None = None  # (J,) [rad] the position from which the way to the start was proved clear
        self.tick_s = 1.0 / self.settings.rate_hz
        self.outbox, self.lifeline = outbox, lifeline
        lent = self.settings.lent is not None
        self.receive, self.signals = connect_receiver(self.settings.host, self.settings.rate_hz, VARIABLES if lent else ())
        self.control: Control | None = None
        self.node: Node | None = None  # of the program that lends the arm
        self.seen_at = self._checked_at = time.monotonic()  # [s] when the last row was read, and when the next check for a row was due
        self.gaps = CycleGaps()
        self._told_at = 0.0  # [s] when the parent last heard from this process
        self._sent_at = 0.0  # [s] when the last target was sent
        self._moving = False  # targets are sent: every gap counts
        self._timestamp_s = self.receive.getTimestamp()
        self._timing = PacketTiming(timestamp_s=self._timestamp_s, offset_s=self.seen_at - self._timestamp_s)
        self._tracking = Tracking(
            self.tick_s, largest_rad=self.settings.max_following_error_rad, lasting_rad=self.settings.max_tracking_error_rad
        )
        self.step_s = 0.0  # controller's time between the last two rows
        self.recent: deque[Array] = deque(maxlen=RECENT_TARGETS)
        self.program_sent = False  # a program of ours may run
        self.messages = ProgramMessages()  # which programs start and end; `connect_control` begins to read them
        self.in_doubt = False  # another program than ours may be what plays
        self.asked_to_stop: str | None = None  # the cause, once a stop was asked for
        self.bring_back = False  # asked so that a lent arm may go back over the way it came, and be given back
        self._heard_at = time.monotonic()  # when the parent last said anything
        self.may_go = False
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

    def connect_control(self) -> None:
        """Open the control connection. From now on this process opens no other.

        Raises RobotUnreachable, or MotionRefused where another client controls the arm.
        """
        if self.settings.lent is not None:
            self.node = Node(self.settings.host, self.receive)
        else:
            self.messages = ProgramMessages.of(self.settings.host)
        self.control = Control(self.settings.host, self.settings.rate_hz, lent=self.node is not None)
        self.note_busy()  # the constructor takes some tenths of a second
        self.control.report()

    def fresh_row(self) -> Array:
        """A row (WIDTH,) that came while this process waited for it: at most one tick old."""
        self.next_row()
        return self.next_row()

    def set_watchdog(self) -> None:
        """Set the watchdog; only our program acknowledges it. From now on a target must come in time.

        Raises StreamFailure where it is not acknowledged, or so late that somebody else's program must have run until then.
        """
        since_s = time.monotonic()
        if not self._control.set_watchdog(self.settings.watchdog_hz):
            raise self._not_watched()
        self.note_busy()
        took_s = self.seen_at - since_s
        if took_s > max(ANSWER_S, ANSWER_TICKS * self.tick_s):
            text = f"the program answered only after {1000 * took_s:.0f} ms: somebody else's may have run until ours replaced it"
            raise StreamFailure("no_control", text)

    def _not_watched(self) -> StreamFailure:
        """Why the watchdog was not accepted: our program has ended, or another has taken its place, or it is there and refuses."""
        failure = self.refusal()
        if self.receive.getRuntimeState() in {RUNTIME_STOPPED, RUNTIME_STOPPING}:
            self.program_sent = False  # it was seen to run before: it has ended, and what runs next is another
        if failure.cause == "servo_refused":
            failure = StreamFailure("no_watchdog", "the controller did not accept the watchdog", ours=self.messages.open)
        return self.replaced() or failure

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
        """Set the watchdog and begin to send targets. Returns the position (J,) in which the arm stands, as the controller's target.

        Raises StreamFailure.
        """
        begin_q: Array = self.next_row()[COLUMN["target_q"]].copy()
        assert self.proved_q is not None
        moved = np.abs(begin_q - self.proved_q)  # (J,)
        if not np.all(moved <= MOVED_RAD):
            j = int(np.argmax(moved))
            raise StreamFailure("no_control", f"{joint_text(j + 1)} was moved by {moved[j]:.3f} rad since the way to the start was proved")
        if self.node is None:  # a watchdog would outlive the node, and stop the program after it; the node has a guard of its own
            self.set_watchdog()
        self.recent.append(begin_q)
        self.note_busy()
        self.gaps.clear()  # proofs and the upload took their time before anything moved
        self._moving, self._sent_at, self._heard_at = True, self.seen_at, self.seen_at
        self._control.report_every(self.settings.max_timestamp_age_s + DEAD_MAN_MARGIN_S)
        return begin_q

    def rest(self) -> None:
        """Note that the arm has come to rest for good: no more targets are sent."""
        self._moving = False
        self._control.report_every(STANDING_S)

    @property
    def unheard_s(self) -> float:
        """For how long the parent has said nothing."""
        return time.monotonic() - self._heard_at

    def beats(self) -> AbstractContextManager[None]:
        """Let a lent arm, which stands, be known as watched while this process computes."""
        return nullcontext() if self.node is None else self.node.beating()

    @property
    def _control(self) -> Control:
        assert self.control is not None
        return self.control

    @property
    def _cut(self) -> bool:
        """Whether one of the connections has come to its end."""
        return not self.receive.isConnected() or (self.control is not None and not self.control.connected)

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
                raise StreamFailure("connection_lost", "the controller closed the RTDE connection")
            if self._moving and now - before_s >= limit_s:
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
            raise StreamFailure("connection_lost", f"the RTDE data broke off: {error}") from None
        self.torn += again
        row[COLUMN["host_monotonic_s"]] = self.seen_at = time.monotonic()
        timestamp_s = float(row[0])
        self._timing = self._timing.arrived(timestamp_s, self._checked_at)
        self.step_s = timestamp_s - self._timestamp_s
        self._timestamp_s = timestamp_s
        self.gaps.add(self.seen_at, self.step_s)
        if not 0.0 < self.step_s < LONGEST_STEP_S or (self._moving and self.step_s >= self.seen_at - before_s + limit_s):
            raise StreamFailure("controller_restarted", f"the controller's clock jumped by {self.step_s:.3f} s")
        if self._moving and self.step_s >= limit_s:
            raise StreamFailure("stalled", f"the controller's data has a gap of {1000 * self.step_s:.0f} ms")
        if self.control is not None:
            self.control.report()
            if not self._moving:
                self._tell_if_due(self.seen_at)
        if self.node is not None and not self._moving:
            self.node.beat()
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
        failure = self.replaced() or state_failure(arm_state(row), settings, self.payload_kg) or self._node_failure()
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
        if self.asked_to_stop is None and not self._permitted(row):
            self.asked_to_stop = "permit_withdrawn"
        last = self.recent[-1]
        allowed = self.robot.max_speed_rad_s * TARGET_TICKS * self.tick_s + 1e-6  # (J,) [rad], with rounding
        if not (np.all(np.abs(target - last) <= allowed) and np.all(np.abs(target) <= self.robot.reach_rad)):
            raise StreamFailure(
                "bad_target", f"target {np.round(target, 4)} after {np.round(last, 4)}: not finite, too far, or out of range"
            )
        gap_s = time.monotonic() - self._sent_at
        if gap_s >= settings.max_timestamp_age_s:
            raise StreamFailure("late", f"{1000 * gap_s:.0f} ms after the last target: this process got no processor time")
        if not self._control.servo(target, self.tick_s, settings.lookahead_s, settings.gain):
            raise self.refusal()
        if self.node is not None:
            self.node.beat()  # each target is a beat, and nothing else is while the arm moves
        self._sent_at = time.monotonic()
        self.gaps.add(self._sent_at, gap_s)
        self.recent.append(target)
        row[COLUMN["commanded_q"]] = target

    def replaced(self) -> StreamFailure | None:
        """The failure where another program has started since ours did; None where the controller tells none."""
        if not (names := self.messages.started()):
            return None
        self.program_sent = False  # a controller runs one program: ours has ended
        return StreamFailure("program_stopped", f"somebody else's program {names[-1]!r} was started in the place of ours", ours=False)

    def _node_failure(self) -> StreamFailure | None:
        """Why a lent arm must stop: the node does not lend it any longer, or its guard does not watch it; None where all is in order."""
        if self.node is None:
            return None
        if not self.node.taken:
            return StreamFailure("program_stopped", f"the program's node has taken the arm back (state {self.node.state})")
        if (silent_s := self.node.silent_s(self.seen_at)) > UNGUARDED_S:
            return StreamFailure("no_watchdog", f"the guard of the program's node has repeated no beat for {1000 * silent_s:.0f} ms")
        return None

    def _permitted(self, row: Array) -> bool:
        """Whether the digital input that gives the permit is on; True where none is configured, False where it is not reported."""
        number = self.settings.permit_input
        return number is None or bool(int(np.nan_to_num(row[COLUMN["actual_digital_input_bits"]][0])) >> number & 1)

    def tell(self, row: Array | None = None) -> None:
        """Send the row (WIDTH,) to the parent, or a sign of life: the parent hears from this process in every tick while the arm moves."""
        self._told_at = self.seen_at
        if row is None:
            self.outbox.alive()
        else:
            self.outbox.row(row)

    def _tell_if_due(self, now: float) -> None:
        """A sign of life where the next row is late. Before the arm moves it says too that what runs now is ours."""
        if self.control is None or now - self._told_at <= SIGN_OF_LIFE_S:
            return
        self._told_at = now
        if self._moving or self.in_doubt:
            self.outbox.waiting()
        else:
            self.outbox.alive()

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
            return StreamFailure("connection_lost", "the controller closed the RTDE connection")
        return StreamFailure("servo_refused", "the control program did not take the target")

    def _listen_to_parent(self) -> None:
        word = self.lifeline.word()
        if word is not None:
            self._heard_at = time.monotonic()
        elif self._moving and self.asked_to_stop is None and self.unheard_s > UNWATCHED_S:
            self.asked_to_stop = "late"  # the parent asks whether motion is still allowed: without it nobody does
        if word in {"stop", "back"}:
            self.asked_to_stop, self.bring_back = "parent_asked_to_stop", word == "back"
        elif word == "go":
            self.may_go = True
