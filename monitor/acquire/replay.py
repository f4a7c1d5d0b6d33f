"""One replay, supervised from outside: guard, spawn, watch, reap → Recording.

The child moves the arm; this side only watches, kills and stops. It never touches ur-rtde. Whatever ends a replay
early, the child is dead and reaped and the controller has been told to stop before `replay` raises.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

import numpy as np

from monitor import __version__
from monitor.acquire.rows import columns, recording_from_columns
from monitor.acquire.safety.conditions import OF_CONFIGURATION, OF_CONTROLLER, ConditionInputs, refuse_unless, some
from monitor.acquire.safety.gate import Announce, AskPermit, Gate
from monitor.acquire.safety.torque_band import TorqueBand
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState, arm_state
from monitor.acquire.ur import dashboard
from monitor.acquire.ur.child import Child, ChildLost
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array, Context, Recording

POLL_S = 0.05  # how often the caller is asked whether to stop
STOP_PATIENCE_S = 5.0  # slow down along the path, come to rest, end the program
LEAVING_S = 1.0  # from the child's last word to its end


class ReplayProgress(NamedTuple):
    """Where a replay is, for a display."""

    phase: str  # connect, control, approach, settle, play, return, finish
    elapsed_s: float  # in this phase
    duration_s: float  # of this phase; 0 where it is not known
    rows: int


def replay(
    excitation: Excitation,
    robot: Robot,
    settings: ReplaySettings,
    *,
    context: Context | None = None,
    on_progress: Callable[[ReplayProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    stopped_before: str | None = None,
    ask: AskPermit | None = None,
    announce: Announce | None = None,
    band: TorqueBand | None = None,
) -> Recording:
    """Move to the start, play every repetition once, come back; the rows of the play alone, one a tick.

    `context` is what the caller knows of the arm; what the controller says of itself is added. The calling thread
    blocks until the arm is back, and must not end before. `should_stop` is asked about every 50 ms. `stopped_before`: a stop
    that nobody acknowledged, in words. `ask` and `announce`: who else must agree, and know. `band`: torque outside it ends the play.

    Raises MotionRefused (nothing was moved), RobotUnreachable (nothing was moved), ReplayAborted with its `cause`.
    """
    facts = ConditionInputs(
        settings=settings,
        excitation=excitation,
        robot=robot,
        context=context or Context(),
        now_unix_s=time.time(),
        identity=None,
        state=None,
        stopped_before=stopped_before,
    )
    refuse_unless(some(facts, OF_CONFIGURATION))
    facts = dataclasses.replace(facts, identity=dashboard.identity(settings.host))
    refuse_unless(some(facts, OF_CONTROLLER))
    job = {
        "settings": dataclasses.asdict(dataclasses.replace(settings, cell=None)),
        "cell": None if settings.cell is None else settings.cell.as_document(),
        "excitation": excitation.as_document(),
        "context": dataclasses.asdict(facts.context),
        "max_position_rad": robot.max_position_rad.tolist(),
        "max_speed_rad_s": robot.max_speed_rad_s.tolist(),
    }
    watch = _Watch(settings, Gate(facts, ask=ask, announce=announce), on_progress, should_stop, band)
    child = Child("monitor.acquire.ur.stream", job)
    try:
        watch.until_done(child)
    finally:
        # also when a callback raised: first the child, then the arm, then the exception
        exit_code = child.end(LEAVING_S if watch.last_word else 0.0)
        stopped = not watch.may_move or dashboard.stop_program(settings.host)
    if not watch.done:
        _tell(watch, settings, exit_code, child.printed, stopped=stopped)
    return _recording(watch, _known(facts, watch.state), settings, excitation)


def _known(facts: ConditionInputs, state: ArmState | None) -> Context:
    """The context with what the controller says of itself."""
    who, context = facts.identity, facts.context
    assert who is not None
    payload_kg = context.payload_kg
    if payload_kg is None and state is not None and not np.isnan(state.payload_kg):
        payload_kg = state.payload_kg
    return dataclasses.replace(
        context,
        robot=facts.robot.name,
        serial=who.serial or context.serial,
        firmware=who.firmware or context.firmware,
        mounting_rad=facts.excitation.mounting.angles_rad,
        payload_kg=payload_kg,
        trajectory_digest=facts.excitation.digest,
        software=f"joint-monitor {__version__}",
    )


class _Watch:
    """What the parent has seen of one child, and for how long it waits for more."""

    def __init__(
        self,
        settings: ReplaySettings,
        gate: Gate,
        on_progress: Callable[[ReplayProgress], None] | None,
        should_stop: Callable[[], bool] | None,
        band: TorqueBand | None,
    ) -> None:
        self.settings, self.gate, self.on_progress, self.should_stop, self.band = settings, gate, on_progress, should_stop, band
        self.state: ArmState | None = None  # the latest before the arm moved
        self.gone = False  # the child was told to go
        self.rows: list[Array] = []
        self.first_row_unix_s: float | None = None
        self.in_control = False  # the child may have a program of ours running
        self.last_word: dict[str, Any] | None = None
        self.doubt: tuple[str, str] | None = None  # cause and text of what made this side give up
        self.phase, self.duration_s = "start", 0.0
        self.phase_at = self.heard_at = time.monotonic()
        self.asked_at: float | None = None

    @property
    def done(self) -> bool:
        """The arm is back, the control program ended, every row is here."""
        return self.last_word is not None and self.last_word["kind"] == "done"

    @property
    def may_move(self) -> bool:
        """A program of ours may still run: not before control was taken, nor after the child gave it back or was refused it."""
        return self.in_control and (self.last_word is None or self.last_word["kind"] == "failed")

    def until_done(self, child: Child) -> None:
        """Follow the child to its last word, its death, or the end of our patience."""
        shown_at = 0.0
        while self.last_word is None:
            try:
                for frame in child.frames(POLL_S):
                    self._take(frame)
            except ChildLost:
                return
            now = time.monotonic()
            if self.on_progress and now - shown_at >= 0.1:
                shown_at = now
                self.on_progress(ReplayProgress(self.phase, now - self.phase_at, self.duration_s, len(self.rows)))
            if self.asked_at is None and self.should_stop and self.should_stop():
                self.asked_at = now
                if not self.in_control:  # nothing moves yet
                    self.doubt = ("parent_asked_to_stop", "stopped on request before the arm moved")
                    return
                child.send("stop")
            if self.last_word is None and self.phase == "ready" and self.state is not None and not self.gone:
                self.gone = self.gate.step(self.state, now)
                if self.gone:
                    child.send("go")
                    self.phase_at = time.monotonic()  # from here on the child proves its way to the start, and takes control
            if self.last_word is None and self._out_of_patience(now):
                return

    def _take(self, frame: Array | dict[str, Any]) -> None:
        self.heard_at = time.monotonic()
        if not isinstance(frame, dict):
            if self.first_row_unix_s is None:
                self.first_row_unix_s = time.time()
            self.rows.append(frame)
            if self.band is not None and self.doubt is None:
                self.doubt = self.band.outside(frame)
        elif frame["kind"] == "phase":
            self.phase, self.duration_s, self.phase_at = frame["phase"], frame["duration_s"], self.heard_at
            self.in_control = self.in_control or self.phase == "control"
        elif frame["kind"] == "state":
            self.state = arm_state(np.array(frame["row"], dtype=float))
        elif frame["kind"] != "alive":
            self.last_word = frame

    def _out_of_patience(self, now: float) -> bool:
        if self.doubt is not None:
            return True
        settings = self.settings
        patient_s = settings.startup_timeout_s
        still = {"start": patient_s, "connect": patient_s, "ready": patient_s, "control": settings.control_timeout_s}
        if not self.gone:
            still["ready"] += self.gate.patience_s
        moving = self.phase not in {*still, "finish"}
        limit_s = settings.finish_timeout_s if self.phase == "finish" else still.get(self.phase, self.duration_s + settings.phase_grace_s)
        if now - self.phase_at > limit_s:
            self.doubt = ("timeout", f"the phase {self.phase!r} took longer than {limit_s:.1f} s")
        elif moving and now - self.heard_at > settings.silence_timeout_s:
            self.doubt = ("timeout", f"the child process said nothing for {now - self.heard_at:.1f} s in the phase {self.phase!r}")
        elif self.asked_at is not None and now - self.asked_at > STOP_PATIENCE_S:
            self.doubt = ("parent_asked_to_stop", f"the arm did not come to rest by itself within {STOP_PATIENCE_S:g} s of the request")
        return self.doubt is not None


def _tell(watch: _Watch, settings: ReplaySettings, exit_code: int, printed: str, *, stopped: bool) -> NoReturn:
    """Raise what ended the replay, in words for a person."""
    word = watch.last_word
    host = settings.host
    if word is not None and word["kind"] == "refused":
        raise MotionRefused(f"{host}: {word['text']}")
    if word is not None and word["kind"] == "unreachable":
        raise RobotUnreachable(word["text"])
    if word is not None:
        cause, text = word["cause"], word["text"]
    elif watch.doubt is not None:
        cause, text = watch.doubt
    else:
        cause = "child_died"
        how = f"by signal {-exit_code}" if exit_code < 0 else f"with code {exit_code}"
        text = f"the child process ended {how}"
        if printed:
            text += f"; its last words: {printed[-300:]!r}"
    if not watch.in_control and cause == "timeout":
        raise RobotUnreachable(f"{host}: no RTDE connection: {text}")
    if cause in ReplayAborted.HARMLESS and watch.may_move and stopped and (told := dashboard.safety_stop(host)):
        # a stop that the child did not live to see, or saw only as a program that stopped, is one nevertheless
        cause, text = told[0], f"{told[1]}; {cause}: {text}"
    where = f"in the phase {watch.phase!r}" if watch.in_control else "before anything moved"
    outcome = "" if stopped else "; THE CONTROLLER DID NOT CONFIRM THE STOP: look at the arm"
    raise ReplayAborted(f"{host}: {cause} {where}: {text}{outcome}", cause)


def _recording(watch: _Watch, context: Context, settings: ReplaySettings, excitation: Excitation) -> Recording:
    """The rows as signals, and how well they were taken."""
    assert watch.last_word is not None
    table = columns(np.array(watch.rows))
    t_s, host_s = table["timestamp"], table["host_monotonic_s"]
    ticks = np.diff(t_s) * settings.rate_hz  # (N−1,)
    pace_ms = 1000.0 * np.abs(np.diff(host_s) - np.diff(t_s))  # (N−1,)
    following = np.abs(table["actual_q"] - table["target_q"])  # (N, J)
    quality = {
        "missed_ticks": int(np.sum(np.maximum(np.round(ticks) - 1, 0))),
        "duplicated_ticks": int(np.sum(ticks < 0.5)),
        "torn_reads": int(watch.last_word["torn_reads"]),
        "slipped_s": float(watch.last_word["slipped_s"]),
        "max_following_error_rad": float(np.max(following)),
        "min_speed_scaling": float(np.min(table["speed_scaling"])),
        "latency_p99_ms": float(np.quantile(1000.0 * (host_s - t_s - np.min(host_s - t_s)), 0.99)),
        "pacing_p99_ms": float(np.quantile(pace_ms, 0.99)),
        "pacing_max_ms": float(np.max(pace_ms)),
        "rate_hz": settings.rate_hz,
        "repetitions": excitation.repetitions,
        "time_scale": excitation.time_scale,
        "late_share": float(np.mean((ticks > 1.5) | (pace_ms > 500.0 / settings.rate_hz))),
        "longest_gap_ms": 1000.0 * float(watch.last_word["longest_gap_s"]),
        "real_time_priority": bool(watch.last_word["real_time"]),
        "controller_clock_at_start_s": float(t_s[0]),
        "host_clock_at_start_unix_s": watch.first_row_unix_s,
    }
    return recording_from_columns(
        table,
        context=dataclasses.replace(context, recorded_at_unix_s=watch.first_row_unix_s),
        quality=quality,
        source=f"replay on {settings.host}",
    )
