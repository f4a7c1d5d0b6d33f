"""The parent's view of one replay's session: what has come from it, for how long to wait for more, and when to say `go` or `stop`."""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.acquire.driver import OurProgram, Session, SessionEnded
from monitor.acquire.rows import COLUMN
from monitor.acquire.safety.gate import Announce, AskPermit, Gate
from monitor.acquire.safety.oversight import Interruption, Oversight
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState, Identity, arm_state
from monitor.errors import RobotUnreachable
from monitor.recording import Array

POLL_S = 0.05  # how often the caller is asked whether to stop
MOVING_POLL_S = 0.02  # while the arm moves something comes in every tick, and a silence must be seen soon
CALL_SILENCE_S = 0.08  # a call that blocks ends the process 0.06 s after its last sign of life, a lack of processor time after 0.1 s
LONGEST_SILENCE_S = 0.1  # a larger setting counts as this one: the controller's watchdog has stopped the arm by then
PROGRESS_EVERY_S = 0.1  # how often the caller is shown the progress
TIME_ROUNDING_S = 1e-6  # of the sum of several waits
CONNECTION_WORDS = (  # what ur-rtde and the libraries below it print when a connection breaks off
    "Robot closed the connection",
    "Robot is disconnected",
    "Lost connection to robot",
    "Connection reset by peer",
    "Broken pipe",
    "End of file",
    "boost::system::system_error",
)
BEAT_EVERY_S = 0.1  # a session that moves the arm hears so often that this process still watches it
STOP_PATIENCE_S = 5.0  # after a request to stop: slow down along the path, come to rest, end the program


NODE_DECIDES_S = 1.5  # a node that has lent its arm and hears no beat ends its program 1 s later
NODE_PATIENCE_S = 5.0  # a session that waits for a program's node ends the wait itself
WINDOW_EVERY_S = 1.0  # while it waits, so often is looked whether the arm may still move now

NOTHING_SENT = frozenset({"start", "connect", "node", "ready"})  # the phases in which the session has sent no program
MOTIONS = frozenset({"approach", "way_back", "play", "return"})  # the phases that move the arm from one place to another


class ReplayProgress(NamedTuple):
    """Where a replay is, for a display."""

    phase: str  # start, connect, node, ready, control, approach, way_back, settle, play, return or finish
    elapsed_s: float  # in this phase
    duration_s: float  # of this phase; 0 where it is not known
    rows: int
    slow: bool = False  # of a slow first pass
    passed_by: str = ""  # in the phase `node`: why the arm was not taken at the program's last node; empty: none offered it yet

    @property
    def text(self) -> str:
        """What is under way, for a person."""
        playing = "slow first pass" if self.slow else "replay"
        return {"play": playing, "approach": "way to the start", "return": "way back"}.get(self.phase, self.phase)


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """What the caller of a replay wants to be asked and told, in the thread that follows the session."""

    met: Callable[[Identity], None] = lambda _: None  # called with who answers, before anything is refused for it
    announce: Announce | None = None  # tells whoever must know that the arm is going to move
    ask: AskPermit | None = None  # asks for somebody else's permit, again and again while the arm moves
    begin: Callable[[Identity], None] = lambda _: None  # just before the arm may move; what it raises ends the replay, and nothing moves
    should_stop: Callable[[], bool] = lambda: False  # asked about every 50 ms …
    forbidden: Callable[[], str | None] = lambda: None  # … and so is this: why the arm may not move any longer
    on_progress: Callable[[ReplayProgress], None] | None = None


def cause_of_death(exit_code: int, silent_s: float, printed: str = "") -> Interruption:
    """Why a session's process ended without a last message; it had been silent for silent_s before.

    The process lets the kernel end it where it would open a new connection (SIGSYS), and where it does not report in time (SIGALRM).
    ur-rtde aborts it (SIGABRT) where one of its own threads meets a connection that was reset, or blocks; what it `printed` says so.
    """
    if exit_code < 0 and any(word in printed for word in CONNECTION_WORDS):
        return Interruption("connection_lost", "the RTDE connection broke off, and its library aborted or blocked")
    if exit_code == -signal.SIGSYS:
        return Interruption("connection_lost", "the RTDE connection broke off, and its library was kept from connecting again")
    if exit_code == -signal.SIGALRM and silent_s < CALL_SILENCE_S:
        return Interruption("stalled", "the controller did not take a target in time")
    if exit_code == -signal.SIGALRM:
        return Interruption("late", f"the streaming process got no processor time for {1000.0 * silent_s:.0f} ms")
    how = f"by signal {-exit_code}" if exit_code < 0 else f"with code {exit_code}"
    return Interruption("child_died", f"the child process ended {how}")


class Watch:
    """Follows one session, and remembers what it sent."""

    def __init__(
        self,
        settings: ReplaySettings,
        identity: Identity,
        gate: Gate,
        caller: Caller,
        oversight: Oversight,
    ) -> None:
        """`identity` answers. `oversight` begins once the arm may move; the caller of this ends it."""
        self.settings, self.gate, self.caller, self.oversight = settings, gate, caller, oversight
        self._identity = identity
        self.state: ArmState | None = None  # the latest before the arm moved
        self.rows: list[Array] = []
        self.first_row_unix_s: float | None = None
        self.asked: Interruption | None = None  # why a stop was asked for
        self.last_message: dict[str, Any] | None = None  # the message after which the session ends
        self.interruption: Interruption | None = None
        self.phase, self.duration_s = "start", 0.0
        self.last_motion = ""  # the last phase that moves the arm from one place to another; empty: none has begun
        self._gone = False  # the session was told `go`
        self.borrowed = False  # a program has lent the arm, and not got it back
        self.given_back = False  # … and got it back
        self._between = False  # the program was asked for its arm, or has it offered back, and has not answered
        self._bringing_back = False  # a lent arm, asked to stop, goes back over the way it came
        self.refusal: Exception | None = None  # what refused the motion after the arm was taken, or while its node is waited for
        self._passed_by = ""  # why the arm was not taken at the program's last node
        self._window_at = 0.0  # when the time of the replay was last looked at (monotonic)
        self._beat_at = 0.0  # when the session last heard from here (monotonic)
        self._phase_at = self._received_at = self._asked_at = time.monotonic()
        self._read_at = self._alive_at = time.monotonic()  # when the pipe was empty; when the session was last seen in order
        self.silent_before_end_s = 0.0  # from the last that came until the session was seen to have ended
        self._silent_s = 0.0  # for so long this process has waited for the session while the arm moves

    @property
    def done(self) -> bool:
        """The arm is back, the control program has ended, and every row is here."""
        return self.last_message is not None and self.last_message["kind"] == "done"

    @property
    def in_control(self) -> bool:
        """The session was told `go`: from then on it may have a program of ours running."""
        return self._gone

    @property
    def may_move(self) -> bool:
        """A program of ours may still run: the session was told `go`, and has neither ended its program nor been refused control."""
        message = self.last_message
        if self.given_back or not (self._gone or self.borrowed):
            return False
        return self.borrowed or message is None or (message["kind"] == "failed" and not message.get("ended", False))

    @property
    def our_program(self) -> OurProgram:
        """What is known of our program at the end of the session: it was ours when the session was last in control."""
        message, name = self.last_message, self.oversight.program_name
        if self.phase == "ready" and not self.borrowed:  # it had not begun to send a program
            return OurProgram(None)
        if message is not None and not message.get("ours", True):  # another program may play in its place: the watchdog ends ours
            return OurProgram(None, name=name)
        if message is not None and message["kind"] == "failed" and message.get("found", message["cause"]) == "program_stopped":
            return OurProgram(self._alive_at, "paused", name)  # what plays now is another program
        if self.phase == "control" and not self.borrowed:
            return OurProgram(self._alive_at, "starting", name)
        return OurProgram(self._alive_at, name=name)

    def find_out(self, playing_program: Callable[[], str | None]) -> None:
        """Where the session has ended before the program answered: whether it has its arm, or has ended. The arm stands in either case.

        The node takes no arm back that is elsewhere, and ends its program where nobody beats: nothing need be stopped, only looked at.
        """
        if not self._between:
            return
        time.sleep(NODE_DECIDES_S)
        try:
            self.given_back = playing_program() is not None
        except RobotUnreachable:
            self.given_back = False
        self.borrowed, self._between = not self.given_back, False

    def follow(self, session: Session) -> None:
        """Follow the session until its last message, its death, or a reason to give it up.

        Raises MotionRefused where the gate refuses the motion.
        """
        shown_at = 0.0
        while self.last_message is None:
            try:
                self._wait(session)
            except SessionEnded:
                self.silent_before_end_s = time.monotonic() - self._received_at
                return
            self._read_at = now = time.monotonic()
            if self.caller.on_progress and now - shown_at >= PROGRESS_EVERY_S:
                shown_at = now
                at = ReplayProgress(self.phase, now - self._phase_at, self.duration_s, len(self.rows), passed_by=self._passed_by)
                self.caller.on_progress(at)
            if self.asked is None and (reason := self._reason_to_stop()) is not None:
                self.asked, self._asked_at = reason, now
                if not self._gone and not self._lent:  # nothing moves yet
                    self.interruption = Interruption(reason.cause, f"{reason.text} before the arm moved")
                    return
                self._bringing_back = self.borrowed and self._gone and reason.cause == "parent_asked_to_stop"
                session.send("back" if self._bringing_back else "stop")
            elif self._bringing_back and (reason := self._reason_against_motion()) is not None:
                self.asked, self._asked_at, self._bringing_back = reason, now, False
                session.send("stop")
            if (self._gone or self.settings.lent is not None) and now - self._beat_at >= BEAT_EVERY_S:
                self._beat_at = now
                session.send("here")
            if self.last_message is None and self.asked is None and self.refusal is None and not self._gone:
                self._ask_gate(session, now)
            if self.last_message is None and self._out_of_patience(now):
                return

    def _wait(self, session: Session) -> None:
        """Take what comes, and count for how long nothing came. Raises SessionEnded.

        Only time spent waiting at an empty pipe counts: what came while this process did something else is there at the next look.
        """
        timeout_s = MOVING_POLL_S if self._moving else POLL_S
        began = time.monotonic()
        came = False
        for frame in session.frames(timeout_s):
            came = True
            self._take(frame)
        waited_s = min(time.monotonic() - began, timeout_s)
        self._silent_s = 0.0 if came or not self._moving else self._silent_s + waited_s

    @property
    def _lent(self) -> bool:
        """A session that waits for a program's node, has its arm or gives it back ends by itself: killed, it would end that program too."""
        return self.settings.lent is not None and self.phase in {"node", "ready", "finish"}

    def _ask_gate(self, session: Session, now: float) -> None:
        """Let the arm go if the gate allows it. What refuses a lent arm is kept until the session has given it back.

        Raises whatever refuses another.
        """
        try:
            if self.phase == "node" and now - self._window_at >= WINDOW_EVERY_S:
                self._window_at = now
                self.gate.in_time()
            elif self.phase == "ready" and self.state is not None:
                self._go_if_allowed(session, now)
        except Exception as error:
            if not self._lent:
                raise
            self.refusal = error
            self.asked, self._asked_at = Interruption("parent_asked_to_stop", f"the motion is refused: {error}"), now
            session.send("stop")

    def _go_if_allowed(self, session: Session, now: float) -> None:
        assert self.state is not None
        if not self.gate.step(self.state, now):
            return
        self.caller.begin(self._identity)
        self._gone = True
        session.send("go")
        self.oversight.start()
        self._phase_at = self._alive_at = self._beat_at = time.monotonic()  # now the session proves its way to the start, and takes control

    def _reason_to_stop(self) -> Interruption | None:
        """Why the arm must come to rest, along its path."""
        if self.caller.should_stop():
            return Interruption("parent_asked_to_stop", "stopped on request")
        return self._reason_against_motion()

    def _reason_against_motion(self) -> Interruption | None:
        """Why the arm must not move any longer, not even back."""
        if self._bringing_back:
            self.caller.should_stop()  # it was asked, and hears from this replay that it is alive
        if (why := self.caller.forbidden()) is not None:
            return Interruption("motion_forbidden", why)
        return self.oversight.finding

    def _take(self, frame: Array | dict[str, Any]) -> None:
        self._received_at = time.monotonic()
        if not isinstance(frame, dict):
            self._alive_at = float(frame[COLUMN["host_monotonic_s"]][0])
        elif frame["kind"] not in {"waiting", "failed"}:
            self._alive_at = self._read_at  # a frame may have waited while this process slept: it came after the pipe was last empty
        if not isinstance(frame, dict):
            if self.first_row_unix_s is None:
                self.first_row_unix_s = time.time()
            self.rows.append(frame)
        elif frame["kind"] == "phase":
            self.phase, self.duration_s, self._phase_at = frame["phase"], frame["duration_s"], self._received_at
            self.last_motion = self.phase if self.phase in MOTIONS else self.last_motion
        elif frame["kind"] == "state":
            self.state = arm_state(np.array(frame["row"], dtype=float))
        elif frame["kind"] == "passed_by":
            self._passed_by = frame["text"]
        elif frame["kind"] in {"asking", "giving_back"}:
            self._between = True
        elif frame["kind"] == "not_taken":
            self._between = False
        elif frame["kind"] in {"taken", "given_back"}:
            self.borrowed, self.given_back, self._between = frame["kind"] == "taken", frame["kind"] == "given_back", False
        elif frame["kind"] in {"refused", "unreachable"} and (self.borrowed or not (self.given_back or self.phase in NOTHING_SENT)):
            self.last_message = {"kind": "failed", "cause": "internal", "text": frame["text"]}  # it cannot mean that nothing was moved
        elif frame["kind"] not in {"alive", "waiting"}:
            self.last_message = frame

    def _out_of_patience(self, now: float) -> bool:
        """Whether there is a reason to give the session up; it is remembered as the interruption."""
        if self.interruption is not None:
            return True
        settings = self.settings
        if now - self._phase_at > (limit_s := self._phase_limit_s()):
            self.interruption = Interruption("timeout", f"the phase {self.phase!r} took longer than {limit_s:.1f} s")
        elif self._silent_s >= min(settings.silence_timeout_s, LONGEST_SILENCE_S) - TIME_ROUNDING_S:
            text = f"the child process said nothing for {1000.0 * self._silent_s:.0f} ms in the phase {self.phase!r}"
            self.interruption = Interruption("timeout", text)
        elif self.asked is not None and not self._bringing_back and now - self._asked_at > STOP_PATIENCE_S:
            text = f"{self.asked.text}; the arm did not come to rest by itself within {STOP_PATIENCE_S:g} s of the request"
            self.interruption = Interruption(self.asked.cause, text)
        return self.interruption is not None

    @property
    def _moving(self) -> bool:
        return self.phase not in {"start", "connect", "node", "ready", "control", "finish"}

    def _phase_limit_s(self) -> float:
        """How long the present phase may last."""
        settings = self.settings
        match self.phase:
            case "start" | "connect":
                return settings.startup_timeout_s
            case "node":
                return self.duration_s + NODE_PATIENCE_S
            case "ready":
                return settings.startup_timeout_s + (0.0 if self._gone else self.gate.patience_s)
            case "control":
                return settings.control_timeout_s
            case "finish":
                return settings.finish_timeout_s
            case _:
                return self.duration_s + settings.phase_grace_s
