"""The arm as the streaming process holds it: both ur-rtde connections, and the fixed order of one cycle.

A cycle takes one complete, new row, checks everything that may be wrong, and sends one target. What is wrong is raised as a
`StreamFailure` with its cause; after that nobody may call ur-rtde again.
"""

import time
from collections import deque

import numpy as np
from rtde_control import RTDEControlInterface

from monitor.acquire.driver import ReplayTask
from monitor.acquire.rows import COLUMN
from monitor.acquire.state import arm_state
from monitor.acquire.ur.child import Lifeline, Outbox
from monitor.acquire.ur.failures import StreamFailure, following_failure, state_failure
from monitor.acquire.ur.gaps import CycleGaps
from monitor.acquire.ur.pacing import POLL_S, PacketTiming
from monitor.acquire.ur.receive import TornRow, connect_receiver, read_row
from monitor.recording import Array

RECENT_TARGETS = 25  # 0.2 s at 125 Hz: longer than servoJ's lookahead and the servo's lag together
HEARTBEAT_S = 0.1  # the parent hears from this process at least so often while the arm moves
SUSPECT_SHARE = 0.8  # of the largest age of a row: from here on a stall is suspected
TARGET_TICKS = 2.2  # a target may be so many ticks of full speed from the one before: a cycle advances by at most two ticks
LONGEST_STEP_S = 10.0  # of the controller's clock between two rows; more means that the controller was restarted
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
        self.receive, self.signals = connect_receiver(self.settings.host, self.settings.rate_hz)
        self.control: RTDEControlInterface | None = None
        self.seen_at = self._checked_at = time.monotonic()  # [s] when the last row was read, and when the next check for a row was due
        self.gaps = CycleGaps()
        self._reported_at = 0.0
        self._timestamp_s = self.receive.getTimestamp()
        self._timing = PacketTiming(timestamp_s=self._timestamp_s, offset_s=self.seen_at - self._timestamp_s)
        self.step_s = 0.0  # controller's time between the last two rows
        self.recent: deque[Array] = deque(maxlen=RECENT_TARGETS)
        self.asked_to_stop: str | None = None  # the cause, once a stop was asked for
        self.may_go = False
        self.missed = self.torn = 0  # ticks without a target; rows that were read again
        self.slipped_s = 0.0  # delay of the motion behind its plan

    def note_busy(self) -> None:
        """Note that this process was busy with something else: the age of the last row says nothing about the controller."""
        self.seen_at = self._checked_at = time.monotonic()

    def approach_proved(self, target_q: Array) -> None:
        """Note that the way to the start was proved clear from this position (J,) [rad]."""
        self.proved_q = target_q.copy()
        self.note_busy()  # the proof takes longer than a row may be old

    def upload_control(self) -> RTDEControlInterface:
        """Upload the control program. Raises RuntimeError as ur-rtde does."""
        self.control = RTDEControlInterface(self.settings.host, self.settings.rate_hz)
        self.note_busy()  # the constructor returns when the program runs, which takes seconds
        return self.control

    def begin_from(self, target_q: Array) -> None:
        """Take this position (J,) [rad] as the last target: the first step is measured from it."""
        self.recent.append(target_q)

    def count_cycle(self, advance_s: float) -> None:
        """Count the ticks that this cycle missed, and the time by which the motion fell behind because it advanced by advance_s only."""
        self.missed += max(round(self.step_s / self.tick_s) - 1, 0)
        self.slipped_s += self.step_s - advance_s

    def next_row(self) -> Array:
        """The next tick's row (WIDTH,), waiting for it.

        Raises StreamFailure where none comes, or where the connection is lost. Leaves the process where the parent is gone.
        """
        age_limit_s = self.settings.max_timestamp_age_s
        suspected_at = None
        while True:
            now = time.monotonic()
            self.gaps.add(now, now - self._checked_at)
            self._checked_at = now
            if not self.receive.isConnected() or (self.control is not None and not self.control.isConnected()):
                raise StreamFailure("connection_lost", "the controller closed the RTDE connection")
            if self.receive.getTimestamp() != self._timestamp_s:
                break
            if now - self.seen_at > SUSPECT_SHARE * age_limit_s:
                # perhaps this process slept: give ur-rtde's own thread a moment to decode what has arrived
                suspected_at = suspected_at or now
                if now - self.seen_at > age_limit_s and now - suspected_at > (1.0 - SUSPECT_SHARE) * age_limit_s:
                    raise StreamFailure("stalled", f"no new data from the controller for {1000 * (now - self.seen_at):.0f} ms")
            self._listen_to_parent()
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
        if not 0.0 < self.step_s < LONGEST_STEP_S:
            raise StreamFailure("controller_restarted", f"the controller's clock jumped by {self.step_s:.3f} s")
        return row

    def _sleep(self) -> None:
        """Sleep until shortly before the next packet is expected. The part that was planned beyond one poll is no gap."""
        began = time.monotonic()
        planned_s = self._timing.sleep_s(began, self.tick_s)
        time.sleep(planned_s)
        self._timing = self._timing.woke(time.monotonic() - began - planned_s)
        self._checked_at += planned_s - POLL_S

    def cycle(self, target: Array, row: Array) -> None:
        """Check the row (WIDTH,), send the target (J,) for it, and enter the target in the row.

        Raises StreamFailure where anything is wrong; the target is not sent then.
        """
        self._listen_to_parent()
        settings = self.settings
        failure = state_failure(arm_state(row), settings, self.payload_kg)
        failure = failure or following_failure(row[COLUMN["actual_q"]], np.array(self.recent), settings.max_following_error_rad)
        if failure:
            raise failure
        if self.asked_to_stop is None and not self._permitted(row):
            self.asked_to_stop = "permit_withdrawn"
        last = self.recent[-1]
        allowed = self.robot.max_speed_rad_s * TARGET_TICKS * self.tick_s + 1e-6  # (J,) [rad], with rounding
        if not (np.all(np.abs(target - last) <= allowed) and np.all(np.abs(target) <= self.robot.max_position_rad)):
            raise StreamFailure(
                "bad_target", f"target {np.round(target, 4)} after {np.round(last, 4)}: not finite, too far, or out of range"
            )
        assert self.control is not None
        if not self.control.servoJ(target, 0.0, 0.0, self.tick_s, settings.lookahead_s, settings.gain):
            raise self.refusal()
        self.recent.append(target)
        row[COLUMN["commanded_q"]] = target

    def _permitted(self, row: Array) -> bool:
        """Whether the digital input that gives the permit is on; True where none is configured, False where it is not reported."""
        number = self.settings.permit_input
        return number is None or bool(int(np.nan_to_num(row[COLUMN["actual_digital_input_bits"]][0])) >> number & 1)

    def report_alive(self) -> None:
        """Tell the parent every HEARTBEAT_S that this process lives; for phases that send no rows."""
        if self.seen_at - self._reported_at > HEARTBEAT_S:
            self._reported_at = self.seen_at
            self.outbox.message("alive")

    def explained(self, failure: StreamFailure) -> StreamFailure:
        """The failure by its true cause: `late` where targets came late just before it, because of this process or the network."""
        return self.gaps.explain(failure, time.monotonic(), tick_s=self.tick_s, watchdog_s=1.0 / self.settings.watchdog_hz)

    def refusal(self) -> StreamFailure:
        """Why a command was refused. The next rows say so; reading what was received sends nothing to the controller."""
        for _ in range(REASON_READS):
            time.sleep(REASON_PAUSE_S)
            try:
                row, _ = read_row(self.receive, self.signals)
            except (TornRow, RuntimeError):
                break
            if failure := state_failure(arm_state(row), self.settings, self.payload_kg):
                return failure
        return StreamFailure("servo_refused", "the control program did not take the target")

    def _listen_to_parent(self) -> None:
        word = self.lifeline.word()
        if word == "stop":
            self.asked_to_stop = "parent_asked_to_stop"
        elif word == "go":
            self.may_go = True
