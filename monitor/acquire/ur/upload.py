"""The upload of our control program: over nothing that runs, and what shows that another program came between.

From our last look to the last byte of our program it takes a millisecond; a controller then needs some tens of milliseconds to begin it.
Another program that somebody starts in that time is replaced by ours, and nothing on the wire prevents that. It is noticed by its motion
or by a pause of what plays, and where it only waited, by its name: the controller's primary port tells every program that starts. Ours
ends then, and a person is asked to start the other one again.
"""

import math
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib.metadata import version

import numpy as np

from monitor.acquire.protocol import Event
from monitor.acquire.safety.inputs import ConditionInputs
from monitor.acquire.state import (
    RUNTIME_PAUSED,
    RUNTIME_PAUSING,
    RUNTIME_PLAYING,
    RUNTIME_STOPPED,
    RUNTIME_STOPPING,
    STANDSTILL_RAD_S,
    ArmState,
    arm_state,
    program_name,
)
from monitor.acquire.ur.arm import Arm
from monitor.acquire.ur.failures import StreamFailure, state_failure
from monitor.acquire.ur.primary import OUR_NAME, ProgramMessages
from monitor.reason import Reason, Sentence

ALONE_S = 0.12  # our program is watched so long after it began: one that began before it is replaced by ours within 0.11 s
START_S = 5.0  # from the upload until the control program runs; a real controller needs some tenths of a second
MESSAGE_S = 0.3  # a program's name comes so soon after its start; the port sends something ten times a second
REPLACED_S = 1.0  # from the first sign of another program until ours has taken its place
ANSWERS_S = 0.05  # after its start our program takes a command
PAUSES = frozenset({"late", "stalled"})  # causes after which the same connections may go on
AGAIN_S = 1.0  # data that paused for longer does not come back in time
END_S = 1.0  # our program ends so soon after it was asked to
WATCHDOG_LATE_S = 0.1  # a program that ends so much later than its watchdog says is not watched
WATCHDOG_EARLY_SHARE = 0.5  # a program that ends before this share of the watchdog's time was not ended by it
ANSWER_S, ANSWER_TICKS = 0.05, 5.0  # our program answers two to four ticks after its start; the larger of both is the limit
END_CHECKS, END_PAUSE_S = 100, 0.01  # a control program that was asked to end at the end of the replay gets 1 s


FOREIGN_PROGRAM_STATE = Sentence("foreign_program_state", "somebody else's program is {name:word}; nothing was sent")
FOREIGN_PROGRAM_STARTED = Sentence("foreign_program_started", "somebody else's program has started; nothing was sent")
FOREIGN_PROGRAM_NAMED = Sentence("foreign_program_named", "somebody else's program {program!r} has started; nothing was sent")
PROGRAM_CONNECTION_CLOSED = Sentence(
    "program_connection_closed", "the controller closed the connection on which programs are sent; nothing was sent"
)
PROGRAM_NOT_SENT = Sentence("program_not_sent", "the control program could not be sent")
WATCHDOG_SILENT = Sentence("watchdog_silent", "without targets the program went on for {went_on_s:.2f} s")
WATCHDOG_EARLY = Sentence("watchdog_early", "the program ended {took_s:.2f} s after its watchdog was set; asked {period_s:g} s")
WATCHDOG_WRONG_STATE = Sentence("watchdog_wrong_state", "without targets the program is {name:word}; expected stopped")
ANSWERED_LATE = Sentence(
    "answered_late", "the program answered only after {took_ms:.0f} ms: somebody else's may have run until ours replaced it"
)
WATCHDOG_NOT_ACCEPTED = Sentence("watchdog_not_accepted", "the controller did not accept the watchdog")
PROGRAM_REPLACED_OURS = Sentence("program_replaced_ours", "somebody else's program {program!r} was started in the place of ours")
CLOSED_BEFORE_END = Sentence("closed_before_end", "the controller closed the RTDE connection before it said that the program has ended")
PROGRAM_RUNS_ON = Sentence("program_runs_on", "the control program still runs although it was asked to end")


class Upload:
    """Our own program takes the arm: it is sent over nothing that runs, and its watchdog stops the arm where targets do not come."""

    variables: tuple[str, ...] = ()
    anywhere = True
    absent_s = math.inf  # nobody waits for the arm

    def __init__(self) -> None:
        self.messages = ProgramMessages()  # which programs start and end; `connect` begins to read them
        self.in_doubt = False

    def prepare(self, arm: Arm, known: ConditionInputs) -> None:
        """Nothing: no connection that could move the arm is held while people are asked."""

    @contextmanager
    def kept(self, arm: Arm) -> Iterator[None]:  # noqa: ARG002 - there is nothing to give up
        """Nothing."""
        yield

    def connect(self, arm: Arm) -> None:
        """Open the control connection, and the one that tells which programs start."""
        self.messages = ProgramMessages.of(arm.settings.host)
        arm.connect_control(lent=False)

    def take_control(self, arm: Arm) -> None:
        """Start our program twice: the first shows that its watchdog ends it, the second gets the targets."""
        arm.say(Event.CONTROL, duration_s=0.0)
        self.start_program(arm)
        self.prove_watchdog(arm)
        self.start_program(arm)
        arm.control.end_uploads()
        arm.wait_for_full_speed()

    def start_program(self, arm: Arm) -> None:
        """Send the control program over nothing that runs, and wait until it runs and nothing else did meanwhile.

        Raises StreamFailure: `no_control` where our program does not run, or where another may; `connection_lost` where it cannot be
        sent; `program_replaced` where ours has taken the place of another and has ended.
        """
        control = arm.control
        runtime = arm_state(arm.fresh_row()).runtime_state
        if runtime != RUNTIME_STOPPED:
            raise StreamFailure("no_control", FOREIGN_PROGRAM_STATE(name=program_name(runtime)))
        if control.program_runs():
            raise StreamFailure("no_control", FOREIGN_PROGRAM_STARTED())
        if self.messages.started() and (name := self.messages.running) not in (None, OUR_NAME):
            raise StreamFailure("no_control", FOREIGN_PROGRAM_NAMED(program=name))
        if not control.can_upload:  # ur-rtde would send it to nobody
            raise StreamFailure("connection_lost", PROGRAM_CONNECTION_CLOSED())
        self.messages.mistake = ""
        arm.program_sent = True
        if not control.upload():
            raise StreamFailure("no_control", PROGRAM_NOT_SENT())
        arm.note_busy()
        _Beginning(arm, self).follow()

    def prove_watchdog(self, arm: Arm) -> None:
        """Set the watchdog, send nothing, and see the controller end the program in time; the arm stands meanwhile.

        Raises StreamFailure where the program goes on, or ends for another reason.
        """
        control = arm.control
        self.guard(arm)
        period_s = 1.0 / arm.settings.watchdog_hz
        row = arm.next_row()
        since_s, state = float(row[0]), arm_state(row)
        while state.runtime_state == RUNTIME_PLAYING:
            if failure := self.replaced(arm):
                raise failure
            if row[0] - since_s > period_s + WATCHDOG_LATE_S:
                # where the controller tells no names it may be another one by now, which nobody of us may stop
                raise StreamFailure("no_watchdog", WATCHDOG_SILENT(went_on_s=row[0] - since_s), ours=self.messages.open)
            if failure := state_failure(state, arm.settings, arm.payload_kg, up_to_speed=False):
                raise failure
            row = arm.next_row()
            state = arm_state(row)
        took_s = row[0] - since_s
        if took_s < WATCHDOG_EARLY_SHARE * period_s - arm.tick_s:
            text = WATCHDOG_EARLY(took_s=took_s, period_s=period_s)
            arm.program_sent = state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}
            raise StreamFailure("program_stopped", text, ours=False)  # what plays from now on is another
        while state.runtime_state != RUNTIME_STOPPED or control.program_runs():
            if failure := self.replaced(arm):
                raise failure
            if row[0] - since_s > period_s + START_S or state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}:
                name = program_name(state.runtime_state)
                text = WATCHDOG_WRONG_STATE(name=name)
                raise StreamFailure("no_watchdog", text, ours=state.runtime_state != RUNTIME_PLAYING)  # it ended: what plays now is another
            row = arm.next_row()
            state = arm_state(row)
        arm.program_sent = False

    def guard(self, arm: Arm) -> None:
        """Set the watchdog; only our program acknowledges it. From now on a target must come in time.

        Raises StreamFailure where it is not acknowledged, or so late that somebody else's program must have run until then.
        """
        since_s = time.monotonic()
        if not arm.control.set_watchdog(arm.settings.watchdog_hz):
            raise self._not_watched(arm)
        arm.note_busy()
        took_s = arm.seen_at - since_s
        if took_s > max(ANSWER_S, ANSWER_TICKS * arm.tick_s):
            text = ANSWERED_LATE(took_ms=1000 * took_s)
            raise StreamFailure("no_control", text)

    def _not_watched(self, arm: Arm) -> StreamFailure:
        """Why the watchdog was not accepted: our program has ended, or another has taken its place, or it is there and refuses."""
        failure = arm.refusal()
        if arm.receive.getRuntimeState() in {RUNTIME_STOPPED, RUNTIME_STOPPING}:
            arm.program_sent = False  # it was seen to run before: it has ended, and what runs next is another
        if failure.cause == "servo_refused":
            failure = StreamFailure("no_watchdog", WATCHDOG_NOT_ACCEPTED(), ours=self.messages.open)
        return self.replaced(arm) or failure

    def replaced(self, arm: Arm) -> StreamFailure | None:
        """The failure where another program has started since ours did; None where the controller tells none."""
        if not (names := self.messages.started()):
            return None
        arm.program_sent = False  # a controller runs one program: ours has ended
        return StreamFailure("program_stopped", PROGRAM_REPLACED_OURS(program=names[-1]), ours=False)

    def failure(self, arm: Arm, found: StreamFailure | None) -> StreamFailure | None:
        """Another program before all else: what the state says then is said of that one."""
        return self.replaced(arm) or found

    def beat(self) -> None:
        """Nothing: the targets are what the watchdog waits for."""

    def beats(self) -> AbstractContextManager[None]:
        """Nothing."""
        return nullcontext()

    def give_up(self, arm: Arm) -> None:
        """End our program. Raises StreamFailure where it goes on, or where nobody says that it ended."""
        control = arm.control
        control.end_program()
        for _ in range(END_CHECKS):
            if arm.receive.getRuntimeState() != RUNTIME_PLAYING:
                return
            if not (arm.receive.isConnected() and control.connected):
                text = CLOSED_BEFORE_END()
                raise StreamFailure("connection_lost", text)
            control.report()
            time.sleep(END_PAUSE_S)
        raise StreamFailure("program_stopped", PROGRAM_RUNS_ON())

    def leave_nothing_behind(self, arm: Arm, failure: StreamFailure) -> None:
        """End our program where this process or the data was late before any target was sent: it may have no watchdog yet.

        Only the command of our own program's end is sent, and only over sound connections on which data comes. Raises StreamFailure where
        none comes within AGAIN_S, or where a connection is lost.
        """
        standing = arm.program_sent and not arm.recent and not self.in_doubt
        if not (failure.cause in PAUSES and failure.ours and standing):
            return
        arm.note_busy()
        since_s = arm.seen_at
        while True:
            try:
                arm.fresh_row()
                break
            except StreamFailure as again:
                if again.cause not in PAUSES or time.monotonic() - since_s > AGAIN_S:
                    raise
        _end_ours(arm)


def _end_ours(arm: Arm) -> bool:
    """Ask our program to end, and see that none runs; False where one goes on. Raises StreamFailure."""
    control = arm.control
    control.end_program()
    arm.note_busy()
    asked_s = arm.seen_at
    while arm_state(arm.next_row()).runtime_state != RUNTIME_STOPPED or control.program_runs():
        if arm.seen_at - asked_s > END_S:
            return False
    arm.program_sent = False
    return True


PROGRAM_PAUSED = Sentence("program_paused", "the control program is {name:word}, before it moved the arm")
CONTROLLER_SAYS = Sentence("controller_says", "; the controller says: {said}")
PROGRAM_NOT_STARTED = Sentence("program_not_started", "the control program did not start within {limit_s:g} s")
PROGRAM_REFUSED = Sentence(
    "program_refused",
    "the controller refused the control program of ur-rtde {release}: {said}; a single name that its software does not know is enough",
)
FOREIGN_PROGRAM_BETWEEN = Sentence("foreign_program_between", "somebody else's program {program} was started while ours was on its way")
ARM_MOVED_BEFORE_OURS = Sentence("arm_moved_before_ours", "a program moved the arm before ours did: somebody else's was started")
PROGRAM_STATE_AFTER_UPLOAD = Sentence(
    "program_state_after_upload", "the program is {name:word} after its upload: somebody else's was started"
)
PROGRAM_ENDED_AT_ONCE = Sentence("program_ended_at_once", "the control program began, and has ended{mistake}")
PROGRAM_REPLACED = Sentence(
    "program_replaced",
    "the program {program} was started while ours was on its way, and ours took its place and has ended; ours has moved "
    "nothing: look at the arm and start {program} again",
)
PROGRAM_REPLACED_FOR_GOOD = Sentence(
    "program_replaced_for_good", "the program {program} was replaced by ours, which does not end: look at the arm and start {program} again"
)


class _Beginning:
    """The beginning of our program, from its upload on."""

    def __init__(self, arm: Arm, upload: Upload) -> None:
        self._arm, self._control, self._upload = arm, arm.control, upload
        self._sent_s = arm.seen_at
        self._begun_s: float | None = None  # when something played first, on the controller's clock
        self._names: list[str] = []  # of the programs that have started since

    def follow(self) -> None:
        """Look through every row until our program has run alone for ALONE_S. Raises StreamFailure."""
        arm = self._arm
        while True:
            row = arm.next_row()
            state = arm_state(row)
            if failure := state_failure(state, arm.settings, arm.payload_kg, playing=False, up_to_speed=False):
                raise failure
            self._names += self._upload.messages.started()
            if state.runtime_state == RUNTIME_PLAYING and self._begun_s is None:
                self._begun_s = float(row[0])
            if self._ours_runs and self._names == [OUR_NAME] and state.runtime_state in {RUNTIME_PAUSING, RUNTIME_PAUSED}:
                name = program_name(state.runtime_state)
                raise StreamFailure("program_stopped", PROGRAM_PAUSED(name=name))
            if (sign := self._sign_of_another(state)) is not None:
                self._give_way(sign)
            if self._runs_alone(row[0]):
                return
            if arm.seen_at - self._sent_s > START_S:
                said = self._upload.messages.mistake
                refused = PROGRAM_REFUSED(release=version("ur_rtde"), said=said)
                raise StreamFailure("no_control", refused if said else PROGRAM_NOT_STARTED(limit_s=START_S))

    def _sign_of_another(self, state: ArmState) -> StreamFailure | None:
        """Why another program than ours plays, or played until ours took its place; None where nothing says so."""
        if self._names not in ([], [OUR_NAME]):
            return StreamFailure("no_control", FOREIGN_PROGRAM_BETWEEN(program=self._others), ours=False)
        if state.runtime_state == RUNTIME_PLAYING:
            moves = np.max(np.abs(state.target_qd)) > STANDSTILL_RAD_S
            text = ARM_MOVED_BEFORE_OURS()
            return StreamFailure("no_control", text, ours=False) if moves else None
        if self._begun_s is None and state.runtime_state == RUNTIME_STOPPED:
            return None
        name = program_name(state.runtime_state)
        return StreamFailure("no_control", PROGRAM_STATE_AFTER_UPLOAD(name=name), ours=False)

    def _runs_alone(self, now_s: float) -> bool:
        """Whether our program has run long enough, and its name was told where the controller tells names."""
        if self._begun_s is None or now_s - self._begun_s < ALONE_S or not self._control.program_runs():
            return False
        if self._upload.messages.open and not self._names:
            if now_s - self._begun_s < ALONE_S + MESSAGE_S:
                return False
            self._upload.messages.close()  # this controller tells no names
        return True

    def _give_way(self, sign: StreamFailure) -> None:
        """End our program once it has taken the other one's place. Raises StreamFailure: that it did, or the sign where it did not.

        Nothing is sent before the controller says by name that ours is what runs now.
        """
        arm = self._arm
        self._upload.in_doubt = True
        since_s = arm.seen_at
        while self._upload.messages.open and arm.seen_at - since_s < REPLACED_S:
            if self._names == [OUR_NAME] and self._upload.messages.running is None:
                raise StreamFailure("no_control", PROGRAM_ENDED_AT_ONCE(mistake=self._mistake), ours=False)
            if OUR_NAME in self._names and self._upload.messages.running not in (OUR_NAME, None):
                arm.program_sent = False  # a controller runs one program: ours has ended
                raise sign
            if self._ours_runs and self._names != [OUR_NAME] and self._ended():
                text = PROGRAM_REPLACED(program=self._others)
                raise StreamFailure("program_replaced", text)
            self._next()
        if self._ours_runs:
            self._ended()
        raise sign

    def _ended(self) -> bool:
        """Let our program begin, and end it; False where another one has taken its place. Raises StreamFailure where it goes on."""
        arm = self._arm
        began_s = arm.seen_at
        while arm.seen_at - began_s < ANSWERS_S or not self._control.program_runs():
            self._next()
            if not self._ours_runs or arm.seen_at - began_s > END_S:
                return False
        if not _end_ours(arm):
            text = PROGRAM_REPLACED_FOR_GOOD(program=self._others)
            raise StreamFailure("program_replaced", text, ours=False)
        return True

    def _next(self) -> ArmState:
        """The next row's state, with the programs that have started until then noted."""
        state = arm_state(self._arm.next_row())
        self._names += self._upload.messages.started()
        return state

    @property
    def _ours_runs(self) -> bool:
        """Whether the controller says by name that our program is the one that started last and has not ended."""
        return self._names[-1:] == [OUR_NAME] and self._upload.messages.running == OUR_NAME

    @property
    def _mistake(self) -> str | Reason:
        """What the controller says against our program, as the end of a sentence; empty where it says nothing."""
        said = self._upload.messages.mistake
        return CONTROLLER_SAYS(said=said) if said else ""

    @property
    def _others(self) -> str:
        """The names of the programs that are not ours, for a person."""
        names = [name for name in self._names if name != OUR_NAME] or self._names[:1]
        return " and ".join(repr(name) for name in dict.fromkeys(names))
