"""The arm as the child process holds it: both ur-rtde connections, and the discipline of one cycle.

One row a tick, complete and fresh; a look at everything that may be wrong; one target. What is wrong is raised as a
`StreamFailure` with its cause; whoever catches it must not call ur-rtde again.
"""

import math
import time
from collections import deque
from typing import Any

import numpy as np
from rtde_control import RTDEControlInterface

from monitor.acquire import state as names
from monitor.acquire.rows import COLUMN, Torn, connect_receiver, snapshot
from monitor.acquire.safety.conditions import is_full_speed
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur.child import Lifeline, Outbox
from monitor.acquire.ur.pacing import POLL_S, Pace
from monitor.recording import Array

REMEMBERED = 25  # targets: 0.2 s at 125 Hz, longer than lookahead and servo lag together
HEARTBEAT_S = 0.1
REMEMBERED_S = 0.5  # what goes wrong so soon after targets came late is laid at their door
ODD_TICKS = 2.5  # between two rows: one tick left out is made good, more is a gap in the stream of targets
WATCHDOG_SHARE = 0.5  # of the watchdog's patience: after a gap of more, it may be our lateness that it stopped


class StreamFailure(Exception):
    """The stream must end now."""

    def __init__(self, cause: str, text: str) -> None:
        super().__init__(text)
        self.cause = cause


def state_failure(state: ArmState, settings: ReplaySettings, payload_kg: float | None = None) -> StreamFailure | None:
    """Why the stream may not go on, from the controller's own words; None if all is well. `payload_kg`: as configured."""
    if state.safety_mode != names.SAFETY_MODE_NORMAL or state.safety_bits != names.SAFETY_BITS_NORMAL:
        bits = state.safety_bits
        if state.safety_mode in {6, 7} or bits & 0b1110_0000:
            cause = "emergency_stop"
        elif state.safety_mode == 3 or bits & 0b100:
            cause = "protective_stop"
        elif state.safety_mode == 5 or bits & 0b1_0000:
            cause = "safeguard_stop"
        else:
            cause = "safety"
        name = names.SAFETY_MODES.get(state.safety_mode, "unknown")
        return StreamFailure(cause, f"safety mode {state.safety_mode} ({name}), bits {bits:#x}")
    if state.robot_mode != names.ROBOT_MODE_RUNNING:
        return StreamFailure("robot_mode", f"robot mode {state.robot_mode} ({names.ROBOT_MODES.get(state.robot_mode, 'unknown')})")
    if state.runtime_state != names.RUNTIME_PLAYING:
        name = names.RUNTIME_STATES.get(state.runtime_state, "unknown")
        return StreamFailure("program_stopped", f"the control program is {name} (runtime state {state.runtime_state})")
    if not (np.all(np.isfinite(state.q)) and np.all(np.isfinite(state.target_q))):
        return StreamFailure("bad_data", "the controller reports positions that are not finite")
    if not (math.isnan(state.speed) or is_full_speed(state.speed)):
        return StreamFailure("speed_scaling", f"the speed slider went to {100.0 * state.speed:.0f} %: the arm plays another trajectory")
    if payload_kg is not None and abs(state.payload_kg - payload_kg) > settings.max_payload_error_kg:  # NaN: not reported
        return StreamFailure(
            "payload", f"the controller reckons with {state.payload_kg:.3f} kg now, the configuration says {payload_kg:.3f} kg"
        )
    coldest, hottest = settings.joint_temperature_range_c
    if not np.all((state.temperature_c >= coldest) & (state.temperature_c <= hottest)):
        return StreamFailure(
            "joint_temperature", f"joint temperatures {np.round(state.temperature_c, 1)} °C; allowed {coldest:g} to {hottest:g}"
        )
    return None


def following_failure(q: Array, targets: Array, limit_rad: float) -> StreamFailure | None:
    """Is any joint of q (J,) outside the band of the last targets (n, J) by more than the limit?

    A servo's lag stays inside the band; an arm that stands while its targets go on does not.
    """
    outside = np.maximum(targets.min(axis=0) - q, q - targets.max(axis=0))  # (J,)
    j = int(np.argmax(outside))
    if outside[j] <= limit_rad:
        return None
    return StreamFailure("following_error", f"joint {j + 1} is {outside[j]:.3f} rad from where it was sent")


class Arm:
    """Both connections to the controller, and the discipline of one cycle."""

    def __init__(self, job: dict[str, Any], outbox: Outbox, lifeline: Lifeline) -> None:
        self.settings = ReplaySettings(**job["settings"])
        self.max_speed = np.array(job["max_speed_rad_s"])  # (J,)
        self.max_position = np.array(job["max_position_rad"])  # (J,)
        self.payload_kg: float | None = job["context"]["payload_kg"]
        self.proved_q: Array | None = None  # (J,) [rad] where the way to the start was proved from
        self.tick_s = 1.0 / self.settings.rate_hz
        self.outbox, self.lifeline = outbox, lifeline
        self.receive, self.signals = connect_receiver(self.settings.host, self.settings.rate_hz)
        self.control: RTDEControlInterface | None = None
        self.seen_at = self.looked_at = time.monotonic()
        self.gap_at, self.gap_s, self.longest_gap_s = -1e9, 0.0, 0.0  # the worst of late: between two looks at the controller, or two rows
        self.told_at = 0.0
        self.timestamp_s = self.receive.getTimestamp()
        self.pace = Pace(timestamp_s=self.timestamp_s, offset_s=time.monotonic() - self.timestamp_s)
        self.step_s = 0.0  # robot time between the last two rows
        self.recent: deque[Array] = deque(maxlen=REMEMBERED)
        self.asked_to_stop: str | None = None  # the cause, once somebody asked
        self.may_go = False
        self.missed = self.torn = 0
        self.slipped_s = 0.0

    def next_row(self) -> Array:
        """(WIDTH,) the next tick's row, waiting for it.

        Raises StreamFailure where none comes, or where a connection or the parent is gone.
        """
        age_limit_s = self.settings.max_timestamp_age_s
        suspected_at = None
        while True:
            now = time.monotonic()
            self._gap(now, now - self.looked_at)
            self.looked_at = now
            if not self.receive.isConnected() or (self.control is not None and not self.control.isConnected()):
                raise StreamFailure("connection_lost", "the controller closed the RTDE connection")
            if self.receive.getTimestamp() != self.timestamp_s:
                break
            if now - self.seen_at > 0.8 * age_limit_s:
                # perhaps it was this process that slept: give ur-rtde's own thread a moment to decode what has come
                suspected_at = suspected_at or now
                if now - self.seen_at > age_limit_s and now - suspected_at > 0.2 * age_limit_s:
                    raise StreamFailure("stalled", f"no new data from the controller for {1000 * (now - self.seen_at):.0f} ms")
            self._listen_to_parent()
            self._sleep()
        try:
            row, again = snapshot(self.receive, self.signals)
        except (Torn, RuntimeError) as error:
            raise StreamFailure("connection_lost", f"the RTDE data broke off: {error}") from None
        self.torn += again
        row[COLUMN["host_monotonic_s"]] = self.seen_at = time.monotonic()
        timestamp_s = float(row[0])
        self.pace = self.pace.arrived(timestamp_s, self.looked_at)
        self.step_s = timestamp_s - self.timestamp_s
        self.timestamp_s = timestamp_s
        self._gap(self.seen_at, self.step_s)
        if not 0.0 < self.step_s < 10.0:
            raise StreamFailure("controller_restarted", f"the controller's clock jumped by {self.step_s:.3f} s")
        return row

    def _sleep(self) -> None:
        """Sleep until shortly before the next packet is expected. The planned part of the sleep is no gap between two looks."""
        began_s = time.monotonic()
        planned_s = self.pace.sleep_s(began_s, self.tick_s)
        time.sleep(planned_s)
        self.pace = self.pace.woke(time.monotonic() - began_s - planned_s)
        self.looked_at += planned_s - POLL_S

    def cycle(self, target: Array, row: Array) -> None:
        """Check the row, and send the target (J,) for it."""
        self._listen_to_parent()
        settings = self.settings
        failure = state_failure(arm_state(row), settings, self.payload_kg)
        failure = failure or following_failure(row[COLUMN["actual_q"]], np.array(self.recent), settings.max_following_error_rad)
        if failure:
            raise failure
        wanted = settings.permit_input
        if (
            wanted is not None
            and self.asked_to_stop is None
            and not int(np.nan_to_num(row[COLUMN["actual_digital_input_bits"]][0])) >> wanted & 1
        ):
            self.asked_to_stop = "permit_withdrawn"
        last = self.recent[-1]
        allowed = self.max_speed * 2.2 * self.tick_s + 1e-6  # a target moves on by at most two ticks a cycle
        if not (np.all(np.abs(target - last) <= allowed) and np.all(np.abs(target) <= self.max_position)):
            raise StreamFailure(
                "bad_target", f"target {np.round(target, 4)} after {np.round(last, 4)}: not finite, too far, or out of range"
            )
        assert self.control is not None
        if not self.control.servoJ(target, 0.0, 0.0, self.tick_s, settings.lookahead_s, settings.gain):
            raise self.why_refused()
        self.recent.append(target)
        row[COLUMN["commanded_q"]] = target

    def tell(self) -> None:
        """A sign of life, now and then."""
        if self.seen_at - self.told_at > HEARTBEAT_S:
            self.told_at = self.seen_at
            self.outbox.message("alive")

    def _gap(self, now: float, gap_s: float) -> None:
        """Remember the longest of the last half second, and of all."""
        if gap_s >= self.gap_s or now - self.gap_at > REMEMBERED_S:
            self.gap_at, self.gap_s = now, gap_s
        self.longest_gap_s = max(self.longest_gap_s, gap_s)

    def named(self, failure: StreamFailure) -> StreamFailure:
        """The failure by its cause: where targets came late just before, because of this process or the network, that is it."""
        enough_s = {
            "following_error": ODD_TICKS * self.tick_s,
            "bad_target": ODD_TICKS * self.tick_s,
            "program_stopped": WATCHDOG_SHARE / self.settings.watchdog_hz,
            "servo_refused": WATCHDOG_SHARE / self.settings.watchdog_hz,
        }.get(failure.cause)
        if enough_s is None or self.gap_s < enough_s or time.monotonic() - self.gap_at > REMEMBERED_S:
            return failure
        return StreamFailure("late", f"targets came late, {1000 * self.gap_s:.0f} ms between two cycles; then {failure.cause}: {failure}")

    def why_refused(self) -> StreamFailure:
        """ServoJ said no. The next rows say why; reading what has been received is no call to the controller."""
        for _ in range(4):
            time.sleep(0.005)
            try:
                row, _ = snapshot(self.receive, self.signals)
            except (Torn, RuntimeError):
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
