"""The disposable child process of one replay: `python -m monitor.acquire.stream`. The only place that moves an arm.

One continuous servoJ stream: approach, the excitation, return, each a smooth path, paced on the robot's own timestamp.
Every cycle looks at the connections, the age of the data, the safety and program state, the following error and the
parent. At the first doubt it tells the cause and ends the process, without another call into ur-rtde: no more targets
come, and the controller's watchdog stops the arm.
"""

import gc
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from monitor.acquire import guard
from monitor.acquire.child import Lifeline, Outbox, begin, leave
from monitor.acquire.guard import ArmState, ReplaySettings
from monitor.acquire.path import joint_path
from monitor.acquire.rows import PLACE, VARIABLES, Torn, snapshot
from monitor.errors import MonitorError, MotionRefused
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.recording import Array

POLL_S = 0.0003  # the finest sleep that does not burn a core; measured 0 missed of 3750 ticks
REMEMBERED = 25  # targets: 0.2 s at 125 Hz, longer than lookahead and servo lag together
STILL_S = 0.15  # at rest for so long before the next phase begins
SETTLE_S = 3.0  # and if it does not come to rest within this, something is wrong
STOP_RAMP_S = 0.4  # on request the arm slows down along its path within this
HEARTBEAT_S = 0.1
SERVO_STOP_RAD_S2 = 5.0  # the arm is at rest already


class Failure(Exception):
    """The stream must end now."""

    def __init__(self, cause: str, text: str) -> None:
        super().__init__(text)
        self.cause = cause


class Stopped(Exception):
    """The parent asked, and the arm stands."""


def arm_state(row: Array) -> ArmState:
    """What the guards ask, from one row."""
    of = {name: row[place] for name, place in PLACE.items()}
    return ArmState(
        robot_mode=int(of["robot_mode"][0]),
        safety_mode=int(of["safety_mode"][0]),
        safety_bits=int(of["safety_status_bits"][0]),
        runtime_state=int(of["runtime_state"][0]),
        q=of["actual_q"],
        qd=of["actual_qd"],
        target_q=of["target_q"],
        target_qd=of["target_qd"],
        temperature_c=of["joint_temperatures"],
    )


def unwell(state: ArmState, settings: ReplaySettings) -> Failure | None:
    """Why the stream may not go on, from the controller's own words; None if all is well."""
    if state.safety_mode != guard.SAFETY_MODE_NORMAL or state.safety_bits != guard.SAFETY_BITS_NORMAL:
        bits = state.safety_bits
        if state.safety_mode in {6, 7} or bits & 0b1110_0000:
            cause = "emergency_stop"
        elif state.safety_mode == 3 or bits & 0b100:
            cause = "protective_stop"
        elif state.safety_mode == 5 or bits & 0b1_0000:
            cause = "safeguard_stop"
        else:
            cause = "safety"
        name = guard.SAFETY_MODES.get(state.safety_mode, "unknown")
        return Failure(cause, f"safety mode {state.safety_mode} ({name}), bits {bits:#x}")
    if state.robot_mode != guard.ROBOT_MODE_RUNNING:
        return Failure("robot_mode", f"robot mode {state.robot_mode} ({guard.ROBOT_MODES.get(state.robot_mode, 'unknown')})")
    if state.runtime_state != guard.RUNTIME_PLAYING:
        name = guard.RUNTIME_STATES.get(state.runtime_state, "unknown")
        return Failure("program_stopped", f"the control program is {name} (runtime state {state.runtime_state})")
    if not (np.all(np.isfinite(state.q)) and np.all(np.isfinite(state.target_q))):
        return Failure("bad_data", "the controller reports positions that are not finite")
    coldest, hottest = settings.joint_temperature_range_c
    if not np.all((state.temperature_c >= coldest) & (state.temperature_c <= hottest)):
        return Failure("joint_temperature", f"joint temperatures {np.round(state.temperature_c, 1)} °C; allowed {coldest:g} to {hottest:g}")
    return None


class Arm:
    """Both connections to the controller, and the discipline of one cycle."""

    def __init__(self, job: dict[str, Any], outbox: Outbox, lifeline: Lifeline) -> None:
        self.settings = ReplaySettings(**job["settings"])
        self.max_speed = np.array(job["max_speed_rad_s"])  # (J,)
        self.max_position = np.array(job["max_position_rad"])  # (J,)
        self.tick_s = 1.0 / self.settings.rate_hz
        self.outbox, self.lifeline = outbox, lifeline
        self.receive = RTDEReceiveInterface(self.settings.host, self.settings.rate_hz, VARIABLES)
        self.control: RTDEControlInterface | None = None
        self.seen_at = time.monotonic()
        self.told_at = 0.0
        self.timestamp_s = self.receive.getTimestamp()
        self.step_s = 0.0  # robot time between the last two rows
        self.recent: deque[Array] = deque(maxlen=REMEMBERED)
        self.asked_to_stop = False
        self.missed = self.torn = 0
        self.slipped_s = 0.0

    def next_row(self) -> Array:
        """(WIDTH,) the next tick's row, waiting for it.

        Raises Failure where none comes, or where a connection or the parent is gone.
        """
        age_limit_s = self.settings.max_timestamp_age_s
        suspected_at = None
        while True:
            now = time.monotonic()
            if self.receive.getTimestamp() != self.timestamp_s:
                break
            if not self.receive.isConnected() or (self.control is not None and not self.control.isConnected()):
                raise Failure("connection_lost", "the controller closed the RTDE connection")
            if now - self.seen_at > 0.8 * age_limit_s:
                # perhaps it was this process that slept: give ur-rtde's own thread a moment to decode what has come
                suspected_at = suspected_at or now
                if now - self.seen_at > age_limit_s and now - suspected_at > 0.2 * age_limit_s:
                    raise Failure("stalled", f"no new data from the controller for {1000 * (now - self.seen_at):.0f} ms")
            self._listen_to_parent()
            time.sleep(POLL_S)
        try:
            row, again = snapshot(self.receive)
        except (Torn, RuntimeError) as error:
            raise Failure("connection_lost", f"the RTDE data broke off: {error}") from None
        self.torn += again
        row[PLACE["host_monotonic_s"]] = self.seen_at = time.monotonic()
        timestamp_s = float(row[0])
        self.step_s = timestamp_s - self.timestamp_s
        self.timestamp_s = timestamp_s
        if not 0.0 < self.step_s < 10.0:
            raise Failure("controller_restarted", f"the controller's clock jumped by {self.step_s:.3f} s")
        return row

    def cycle(self, target: Array, row: Array) -> None:
        """Check the row, and send the target (J,) for it."""
        self._listen_to_parent()
        failure = unwell(arm_state(row), self.settings) or self._strayed(row)
        if failure:
            raise failure
        last = self.recent[-1]
        allowed = self.max_speed * 2.2 * self.tick_s + 1e-6  # a target moves on by at most two ticks a cycle
        if not (np.all(np.abs(target - last) <= allowed) and np.all(np.abs(target) <= self.max_position)):
            raise Failure("bad_target", f"target {np.round(target, 4)} after {np.round(last, 4)}: not finite, too far, or out of range")
        assert self.control is not None
        settings = self.settings
        if not self.control.servoJ(target, 0.0, 0.0, self.tick_s, settings.lookahead_s, settings.gain):
            raise self.why_refused()
        self.recent.append(target)
        row[PLACE["commanded_q"]] = target

    def tell(self) -> None:
        """A sign of life, now and then."""
        if self.seen_at - self.told_at > HEARTBEAT_S:
            self.told_at = self.seen_at
            self.outbox.message("alive")

    def _strayed(self, row: Array) -> Failure | None:
        """Is any joint outside the band of the recent targets? Lag stays inside it, standing still does not."""
        q = row[PLACE["actual_q"]]
        band = np.array(self.recent)  # (≤ REMEMBERED, J)
        outside = np.maximum(band.min(axis=0) - q, q - band.max(axis=0))  # (J,)
        j = int(np.argmax(outside))
        if outside[j] <= self.settings.max_following_error_rad:
            return None
        return Failure("following_error", f"joint {j + 1} is {outside[j]:.3f} rad from where it was sent")

    def why_refused(self) -> Failure:
        """ServoJ said no. The next rows say why; reading what has been received is no call to the controller."""
        for _ in range(4):
            time.sleep(0.005)
            try:
                row, _ = snapshot(self.receive)
            except (Torn, RuntimeError):
                break
            if failure := unwell(arm_state(row), self.settings):
                return failure
        return Failure("servo_refused", "the control program did not take the target")

    def _listen_to_parent(self) -> None:
        word = self.lifeline.word()
        if word == "stop":
            self.asked_to_stop = True


def look(arm: Arm, start_q: Array) -> Array:
    """(WIDTH,) the state from which the arm may begin: well, at rest and free for 0.1 s.

    Raises MotionRefused.
    """
    row = arm.next_row()
    for _ in range(12):
        guard.ready(arm_state(row), arm.settings, start_q)
        row = arm.next_row()
    guard.ready(arm_state(row), arm.settings, start_q)
    return row


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
        settings = ReplaySettings(**job["settings"])
        excitation = excitation_from_document(job["excitation"])
        guard.permitted(settings)
        guard.within_limits(
            excitation, max_position_rad=np.array(job["max_position_rad"]), max_speed_rad_s=np.array(job["max_speed_rad_s"])
        )
        outbox.message("phase", phase="connect", duration_s=0.0)
        try:
            arm = Arm(job, outbox, lifeline)
        except RuntimeError as error:
            outbox.message("unreachable", text=f"{settings.host}: RTDE: {error}")
            leave(2)
        if not arm.receive.isConnected():
            outbox.message("unreachable", text=f"{settings.host}: RTDE answers but sends no data")
            leave(2)
        start_q = excitation.at(np.zeros(1)).q[0]
        try:
            row = look(arm, start_q)
        except Failure as failure:
            outbox.message("unreachable", text=f"{settings.host}: {failure}")
            leave(2)
        # the constructor would stop any program that runs: none did, one tick ago
        outbox.message("phase", phase="control", duration_s=0.0)
        try:
            arm.control = RTDEControlInterface(settings.host, settings.rate_hz)
        except RuntimeError as error:
            if "already in use" in str(error):  # said before anything was uploaded
                raise MotionRefused(f"another RTDE client controls the arm: {error}") from None
            raise Failure("no_control", f"the control program did not start: {error}") from None
        arm.seen_at = time.monotonic()  # the constructor held up this process, not the controller
        row = arm.next_row()
        arm.step_s = 0.0
        begin_q = row[PLACE["target_q"]].copy()
        arm.recent.append(begin_q)
        if not arm.control.setWatchdog(settings.watchdog_hz):
            raise Failure("no_watchdog", "the controller did not accept the watchdog")
        play(arm, excitation, begin_q)
        outbox.message("done", missed_ticks=arm.missed, torn_reads=arm.torn, slipped_s=arm.slipped_s)
        leave(0)
    except Failure as failure:
        outbox.message("failed", cause=failure.cause, text=str(failure))
    except Stopped:
        outbox.message("failed", cause="parent_asked_to_stop", text="stopped on request; the arm stands")
    except MonitorError as error:
        outbox.message("refused", text=str(error))
    except BaseException as error:
        outbox.message("failed", cause="internal", text=f"{type(error).__name__}: {error}")
    leave(1)


if __name__ == "__main__":
    main()
