"""The parent's side of one replay: what has come from the session, for how long to wait for more, and when to say GO, BACK or STOP."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.acquire.driver import OurProgram, Session, SessionEnded
from monitor.acquire.protocol import MOTIONS, Event, Phase, State, Unexpected
from monitor.acquire.rows import layout_of
from monitor.acquire.safety.gate import Announce, AskPermit, Gate
from monitor.acquire.safety.oversight import Interruption, Oversight
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState, Identity, arm_state
from monitor.errors import LastSeen, MonitorError, RobotUnreachable
from monitor.reason import Reason, Sentence, reason_from
from monitor.recording import Array

POLL_S = 0.05  # how often the caller is asked whether to stop
MOVING_POLL_S = 0.02  # while the arm moves something comes in every tick, and a silence must be seen soon
LONGEST_SILENCE_S = 0.1  # a larger setting counts as this one: the controller's watchdog has stopped the arm by then
PROGRESS_EVERY_S = 0.1  # how often the caller is shown the progress
TIME_ROUNDING_S = 1e-6  # of the sum of several waits
BEAT_EVERY_S = 0.1  # a session that moves the arm hears so often that this process still watches it
STOP_PATIENCE_S = 5.0  # after a request to stop: slow down along the path, come to rest, end the program
NODE_DECIDES_S = 1.5  # a node that has lent its arm and hears no beat ends its program 1 s later
NODE_PATIENCE_S = 5.0  # a session that waits for a program's node ends the wait itself
WINDOW_EVERY_S = 1.0  # while it waits, so often is looked whether the arm may still move now

HERE = "here"  # the word that says that this process still watches
LAST_WORDS = frozenset({Event.DONE, Event.STOPPED, Event.FAILED, Event.REFUSED, Event.UNREACHABLE})
NO_EVENTS = frozenset({"state", "alive", "calling", "waiting", "passed_by"})  # messages that leave the replay in its state


class ReplayProgress(NamedTuple):
    """Where a replay is, for a display."""

    phase: Phase
    elapsed_s: float  # in this phase
    duration_s: float  # of this phase; 0 where it is not known
    rows: int
    slow: bool = False  # of a slow first pass
    passed_by: Reason | None = None  # in the phase NODE: why the arm was not taken at the program's last node; None: none offered it yet

    @property
    def text(self) -> str:
        """What is under way, for a person."""
        playing = "slow first pass" if self.slow else "replay"
        return {Phase.PLAY: playing, Phase.APPROACH: "way to the start", Phase.RETURN: "way back"}.get(self.phase, self.phase.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Caller:
    """What the caller of a replay wants to be asked and told, in the thread that follows the session."""

    met: Callable[[Identity], None] = lambda _: None  # called with who answers, before anything is refused for it
    announce: Announce | None = None  # tells whoever must know that the arm is going to move
    ask: AskPermit | None = None  # asks for somebody else's permit, again and again while the arm moves
    begin: Callable[[Identity], None] = lambda _: None  # just before the arm may move; what it raises ends the replay, and nothing moves
    should_stop: Callable[[], bool] = lambda: False  # asked about every 50 ms …
    forbidden: Callable[[], Reason | None] = lambda: None  # … and so is this: why the arm may not move any longer
    on_progress: Callable[[ReplayProgress], None] | None = None


BEFORE_IT_MOVED = Sentence("before_it_moved", "{why} before the arm moved")
REFUSED_MEANWHILE = Sentence("refused_meanwhile", "the motion is refused: {why}")
STOP_REQUESTED = Sentence("stop_requested", "stopped on request")
SESSION_SAYS = Sentence("session_says", "the session says {event}")
PHASE_TOO_LONG = Sentence("phase_too_long", "the phase {phase!r} took longer than {limit_s:.1f} s")
SESSION_SILENT = Sentence("session_silent", "the child process said nothing for {silent_ms:.0f} ms in the phase {phase!r}")
NOT_AT_REST = Sentence("not_at_rest", "{why}; the arm did not come to rest by itself within {limit_s:g} s of the request")


class Watch:
    """Follows one session, and remembers what it sent."""

    def __init__(self, settings: ReplaySettings, identity: Identity, gate: Gate, caller: Caller, oversight: Oversight) -> None:
        """`identity` answers. `oversight` begins once the arm may move; the caller of this ends it."""
        self.settings, self.gate, self.caller, self.oversight = settings, gate, caller, oversight
        self._identity = identity
        self.state = State.at_start(lent=settings.lent is not None)
        self.phase, self.duration_s = Phase.START, 0.0  # of the session: its last one where it has ended
        self.last_motion: Phase | None = None  # the last phase that moves the arm from one place to another; None: none has begun
        self.arm: ArmState | None = None  # the latest before the arm moved
        self.rows: list[Array] = []
        self._seen: Array | None = None  # (WIDTH,) the newest row of all; None: none has come
        self.first_row_unix_s: float | None = None
        self.call = ""  # of the maker's library, in which the session is; empty: in none
        self.last_word: dict[str, Any] | None = None  # the message after which the session ends
        self.asked: Interruption | None = None  # why a stop was asked for
        self.interruption: Interruption | None = None  # why the session was given up
        self.refusal: Exception | None = None  # what refused the motion while a program waits for its arm, or for the node
        self._passed_by: Reason | None = None  # why the arm was not taken at the program's last node
        now = time.monotonic()
        self._window_at = self._beat_at = 0.0  # when the time of the replay was last looked at; when the session last heard from here
        self._phase_at = self._received_at = self._asked_at = now
        self._read_at = self._alive_at = now  # when the pipe was empty; when the session was last seen in order
        self.silent_before_end_s = 0.0  # from the last that came until the session was seen to have ended
        self._silent_s = 0.0  # for so long this process has waited for the session while the arm moves

    @property
    def done(self) -> bool:
        """The arm is back, the control program has ended, and every row is here."""
        return self.last_word is not None and self.last_word["kind"] == Event.DONE

    @property
    def our_program(self) -> OurProgram:
        """What is known of our program at the end of the session: it was ours when the session was last in control."""
        message, name = self.last_word, self.oversight.program_name
        if self.phase is Phase.READY and not self.state.lent:  # it had not begun to send a program
            return OurProgram(None)
        if message is not None and not message.get("ours", True):  # another program may play in its place: the watchdog ends ours
            return OurProgram(None, name=name)
        if message is not None and message["kind"] == Event.FAILED and message.get("found", message["cause"]) == "program_stopped":
            return OurProgram(self._alive_at, "paused", name)  # what plays now is another program
        if self.phase is Phase.CONTROL and not self.state.lent:
            return OurProgram(self._alive_at, "starting", name)
        return OurProgram(self._alive_at, name=name)

    @property
    def last_seen(self) -> LastSeen | None:
        """The arm as the session last showed it; None: it never did."""
        if self._seen is None:
            return None
        state = arm_state(self._seen)
        return LastSeen(state.host_s, state.controller_s, tuple(state.q.tolist()), tuple(state.qd.tolist()), state.payload_kg)

    def find_out(self, playing_program: Callable[[], str | None]) -> None:
        """Where the session has ended before the program answered: whether it has its arm, or has ended. The arm stands in either case.

        The node takes no arm back that is elsewhere, and ends its program where nobody beats: nothing need be stopped, only looked at.
        """
        if self.state.phase is not Phase.ENDED:  # it was given up, or died
            self.state = self.state.after(Event.DIED)
        if not self.state.unanswered:
            return
        time.sleep(NODE_DECIDES_S)
        try:
            plays = playing_program() is not None
        except RobotUnreachable:
            plays = False
        self.state = self.state.after(Event.PLAYS if plays else Event.PLAYS_NOT)

    def follow(self, session: Session) -> None:
        """Follow the session until its last word, its death, or a reason to give it up.

        Raises MotionRefused where the gate refuses the motion.
        """
        shown_at = 0.0
        while True:
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
            self._stop_where_there_is_a_reason(session, now)
            if self.interruption is not None:
                return
            if (self.state.gone or self.settings.lent is not None) and now - self._beat_at >= BEAT_EVERY_S:
                self._beat_at = now
                session.send(HERE)
            if self.last_word is not None:
                return
            if self.state.allows(Event.STOP) and not self.state.gone:
                self._ask_gate(session, now)
            if self._out_of_patience(now):
                return

    def _wait(self, session: Session) -> None:
        """Take what comes, and count for how long nothing came. Raises SessionEnded.

        Only time spent waiting at an empty pipe counts: what came while this process did something else is there at the next look.
        """
        timeout_s = MOVING_POLL_S if self.state.streams else POLL_S
        began = time.monotonic()
        came = False
        for frame in session.frames(timeout_s):
            came = True
            self._take(frame)
        waited_s = min(time.monotonic() - began, timeout_s)
        self._silent_s = 0.0 if came or not self.state.streams else self._silent_s + waited_s

    def _stop_where_there_is_a_reason(self, session: Session, now: float) -> None:
        """Order the arm to rest where there is a reason to, or end the replay where nothing moves yet."""
        if not self.state.allows(Event.STOP) or self.last_word is not None:
            return
        reason = self._reason_against_motion() if self.state.brings_back else self._reason_to_stop()
        if reason is None:
            return
        if not self.state.gone and not self.state.needs_its_session:  # nothing moves yet
            self.asked, self.interruption = reason, Interruption(reason.cause, BEFORE_IT_MOVED(why=reason.reason))
            return
        back = self.state.lent and self.state.allows(Event.BACK) and reason.cause == "parent_asked_to_stop"
        self._order(session, Event.BACK if back else Event.STOP, reason, now)

    def _order(self, session: Session, event: Event, reason: Interruption, now: float) -> None:
        self.state = self.state.after(event)
        self.asked, self._asked_at = reason, now
        session.send(event)

    def _ask_gate(self, session: Session, now: float) -> None:
        """Let the arm go if the gate allows it. What refuses a lent arm is kept until the session has given it back.

        Raises whatever refuses another.
        """
        try:
            if self.phase is Phase.NODE and now - self._window_at >= WINDOW_EVERY_S:
                self._window_at = now
                self.gate.in_time()
            elif self.phase is Phase.READY and self.arm is not None and self.gate.step(self.arm, now):
                self.caller.begin(self._identity)
                self.state = self.state.after(Event.GO)
                session.send(Event.GO)
                self.oversight.start()
                # now the session proves its way to the start, and takes control
                self._phase_at = self._alive_at = self._beat_at = time.monotonic()
        except Exception as error:
            if not self.state.needs_its_session:
                raise
            self.refusal = error
            why = error.reason if isinstance(error, MonitorError) else str(error)
            self._order(session, Event.STOP, Interruption("parent_asked_to_stop", REFUSED_MEANWHILE(why=why)), now)

    def _reason_to_stop(self) -> Interruption | None:
        """Why the arm must come to rest, along its path."""
        if self.caller.should_stop():
            return Interruption("parent_asked_to_stop", STOP_REQUESTED())
        return self._forbidden()

    def _reason_against_motion(self) -> Interruption | None:
        """Why the arm must not move any longer, not even back."""
        self.caller.should_stop()  # it was asked, and hears from this replay that it is alive
        return self._forbidden()

    def _forbidden(self) -> Interruption | None:
        if (why := self.caller.forbidden()) is not None:
            return Interruption("motion_forbidden", why)
        return self.oversight.finding

    def _take(self, frame: Array | dict[str, Any]) -> None:
        self._received_at = time.monotonic()
        self.call = frame.get("call", "") if isinstance(frame, dict) else ""
        if not isinstance(frame, dict):
            self._seen = frame
            self._alive_at = float(frame[layout_of(len(frame)).column["host_monotonic_s"]][0])
            if self.first_row_unix_s is None:
                self.first_row_unix_s = time.time()
            self.rows.append(frame)
            return
        kind = frame["kind"]
        if kind not in {"waiting", Event.FAILED, Event.STOPPED}:
            self._alive_at = self._read_at  # a frame may have waited while this process slept: it came after the pipe was last empty
        if (row := frame.get("row")) is not None:
            self._seen = np.asarray(row, dtype=float)
        if kind == "state":
            assert self._seen is not None
            self.arm = arm_state(self._seen)
        elif kind == "passed_by":
            self._passed_by = reason_from(frame["reason"])
        elif kind not in NO_EVENTS and self.last_word is None:
            self._hear(Event(kind), frame)

    def _hear(self, event: Event, frame: dict[str, Any]) -> None:
        """Move the state by what the session says. What it cannot say in this state counts as a failure of the session."""
        try:
            self.state = self.state.after(event)
        except Unexpected as unexpected:
            said = SESSION_SAYS(event=str(unexpected)).document()
            event, frame = Event.FAILED, {"cause": "internal", "reason": said, **frame, "kind": Event.FAILED}
            self.state = self.state.after(event)
        if event in LAST_WORDS:
            self.last_word = frame
        elif self.state.phase is not self.phase or event == self.phase.value:
            self.phase, self.duration_s, self._phase_at = self.state.phase, frame.get("duration_s", 0.0), self._received_at
            self.last_motion = self.phase if self.phase in MOTIONS else self.last_motion

    def _out_of_patience(self, now: float) -> bool:
        """Whether there is a reason to give the session up; it is remembered as the interruption."""
        settings, phase = self.settings, self.phase.value
        if now - self._phase_at > (limit_s := self._phase_limit_s()):
            self.interruption = Interruption("timeout", PHASE_TOO_LONG(phase=phase, limit_s=limit_s))
        elif self._silent_s >= min(settings.silence_timeout_s, LONGEST_SILENCE_S) - TIME_ROUNDING_S:
            text = SESSION_SILENT(silent_ms=1000.0 * self._silent_s, phase=phase)
            self.interruption = Interruption("timeout", text)
        elif self.asked is not None and not self.state.brings_back and now - self._asked_at > STOP_PATIENCE_S:
            text = NOT_AT_REST(why=self.asked.reason, limit_s=STOP_PATIENCE_S)
            self.interruption = Interruption(self.asked.cause, text)
        return self.interruption is not None

    def _phase_limit_s(self) -> float:
        """How long the present phase may last."""
        settings = self.settings
        match self.phase:
            case Phase.START | Phase.CONNECT:
                return settings.startup_timeout_s
            case Phase.NODE:
                return self.duration_s + NODE_PATIENCE_S
            case Phase.READY:
                return settings.startup_timeout_s + (0.0 if self.state.gone else self.gate.patience_s)
            case Phase.CONTROL:
                return settings.control_timeout_s
            case Phase.FINISH | Phase.RETURNED:
                return settings.finish_timeout_s
            case _:
                return self.duration_s + settings.phase_grace_s
