"""The upload of our control program: over nothing that runs, and what shows that another program came between.

From our last look to the last byte of our program it takes a millisecond; a controller then needs some tens of milliseconds to begin it.
Another program that somebody starts in that time is replaced by ours, and nothing on the wire prevents that. It is noticed by its motion
or by a pause of what plays, and where it only waited, by its name: the controller's primary port tells every program that starts. Ours
ends then, and a person is asked to start the other one again.
"""

import time

import numpy as np

from monitor.acquire.state import (
    RUNTIME_PAUSED,
    RUNTIME_PAUSING,
    RUNTIME_PLAYING,
    RUNTIME_STATES,
    RUNTIME_STOPPED,
    RUNTIME_STOPPING,
    STANDSTILL_RAD_S,
    ArmState,
    arm_state,
)
from monitor.acquire.ur.arm import Arm
from monitor.acquire.ur.control import Control
from monitor.acquire.ur.failures import StreamFailure, state_failure

NAME = "rtde_control"  # of ur-rtde's program, in its first line
ALONE_S = 0.12  # our program is watched so long after it began: one that began before it is replaced by ours within 0.11 s
START_S = 5.0  # from the upload until the control program runs; a real controller needs some tenths of a second
MESSAGE_S = 0.3  # a program's name comes so soon after its start; the port sends something ten times a second
REPLACED_S = 1.0  # from the first sign of another program until ours has taken its place
ANSWERS_S = 0.05  # after its start our program takes a command
PAUSES = frozenset({"late", "stalled"})  # causes after which the same connections may go on
AGAIN_S = 1.0  # data that paused for longer does not come back in time
END_S = 1.0  # our program ends so soon after it was asked to


def start_program(arm: Arm) -> None:
    """Send the control program over nothing that runs, and wait until it runs and nothing else did meanwhile.

    Raises StreamFailure: `no_control` where our program does not run, or where another one may run; `connection_lost` where it cannot be
    sent; `program_replaced` where ours has taken the place of another and has ended.
    """
    control = arm.control
    assert control is not None
    runtime = arm_state(arm.fresh_row()).runtime_state
    if runtime != RUNTIME_STOPPED:
        raise StreamFailure("no_control", f"somebody else's program is {RUNTIME_STATES.get(runtime, 'unknown')}; nothing was sent")
    if control.program_runs():
        raise StreamFailure("no_control", "somebody else's program has started; nothing was sent")
    if arm.messages.started() and (name := arm.messages.running) not in (None, NAME):
        raise StreamFailure("no_control", f"somebody else's program {name!r} has started; nothing was sent")
    if not control.can_upload:  # ur-rtde would send it to nobody
        raise StreamFailure("connection_lost", "the controller closed the connection on which programs are sent; nothing was sent")
    arm.messages.mistake = ""
    arm.program_sent = True
    if not control.upload():
        raise StreamFailure("no_control", "the control program could not be sent")
    arm.note_busy()
    _Beginning(arm, control).follow()


def leave_nothing_behind(arm: Arm, failure: StreamFailure) -> None:
    """End our program where this process or the data was late before any target was sent: it may have no watchdog, and nobody else ends it.

    Only the command of our own program's end is sent, and only over sound connections on which data comes. Raises StreamFailure where it
    does not come within AGAIN_S, or where a connection is lost.
    """
    standing = arm.program_sent and not arm.recent and not arm.in_doubt and arm.node is None
    if not (failure.cause in PAUSES and failure.ours and standing and arm.control is not None):
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
    _end_ours(arm, arm.control)


def _end_ours(arm: Arm, control: Control) -> bool:
    """Ask our program to end, and see that none runs; False where one goes on. Raises StreamFailure."""
    control.end_program()
    arm.note_busy()
    asked_s = arm.seen_at
    while arm_state(arm.next_row()).runtime_state != RUNTIME_STOPPED or control.program_runs():
        if arm.seen_at - asked_s > END_S:
            return False
    arm.program_sent = False
    return True


class _Beginning:
    """The beginning of our program, from its upload on."""

    def __init__(self, arm: Arm, control: Control) -> None:
        self._arm, self._control = arm, control
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
            self._names += arm.messages.started()
            if state.runtime_state == RUNTIME_PLAYING and self._begun_s is None:
                self._begun_s = float(row[0])
            if self._ours_runs and self._names == [NAME] and state.runtime_state in {RUNTIME_PAUSING, RUNTIME_PAUSED}:
                name = RUNTIME_STATES[state.runtime_state]
                raise StreamFailure("program_stopped", f"the control program is {name}, before it moved the arm")
            if (sign := self._sign_of_another(state)) is not None:
                self._give_way(sign)
            if self._runs_alone(row[0]):
                return
            if arm.seen_at - self._sent_s > START_S:
                raise StreamFailure("no_control", f"the control program did not start within {START_S:g} s{self._mistake}")

    def _sign_of_another(self, state: ArmState) -> StreamFailure | None:
        """Why another program than ours plays, or played until ours took its place; None where nothing says so."""
        if self._names not in ([], [NAME]):
            return StreamFailure("no_control", f"somebody else's program {self._others} was started while ours was on its way", ours=False)
        if state.runtime_state == RUNTIME_PLAYING:
            moves = np.max(np.abs(state.target_qd)) > STANDSTILL_RAD_S
            text = "a program moved the arm before ours did: somebody else's was started"
            return StreamFailure("no_control", text, ours=False) if moves else None
        if self._begun_s is None and state.runtime_state == RUNTIME_STOPPED:
            return None
        name = RUNTIME_STATES.get(state.runtime_state, "unknown")
        return StreamFailure("no_control", f"the program is {name} after its upload: somebody else's was started", ours=False)

    def _runs_alone(self, now_s: float) -> bool:
        """Whether our program has run long enough, and its name was told where the controller tells names."""
        if self._begun_s is None or now_s - self._begun_s < ALONE_S or not self._control.program_runs():
            return False
        if self._arm.messages.open and not self._names:
            if now_s - self._begun_s < ALONE_S + MESSAGE_S:
                return False
            self._arm.messages.close()  # this controller tells no names
        return True

    def _give_way(self, sign: StreamFailure) -> None:
        """End our program once it has taken the other one's place. Raises StreamFailure: that it did, or the sign where it did not.

        Nothing is sent before the controller says by name that ours is what runs now.
        """
        arm = self._arm
        arm.in_doubt = True
        since_s = arm.seen_at
        while arm.messages.open and arm.seen_at - since_s < REPLACED_S:
            if self._names == [NAME] and arm.messages.running is None:
                raise StreamFailure("no_control", f"the control program began, and has ended{self._mistake}", ours=False)
            if NAME in self._names and arm.messages.running not in (NAME, None):
                arm.program_sent = False  # a controller runs one program: ours has ended
                raise sign
            if self._ours_runs and self._names != [NAME] and self._ended():
                text = (
                    f"the program {self._others} was started while ours was on its way, and ours took its place and has ended; "
                    f"ours has moved nothing: look at the arm and start {self._others} again"
                )
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
        if not _end_ours(arm, self._control):
            text = f"the program {self._others} was replaced by ours, which does not end: look at the arm and start {self._others} again"
            raise StreamFailure("program_replaced", text, ours=False)
        return True

    def _next(self) -> ArmState:
        """The next row's state, with the programs that have started until then noted."""
        state = arm_state(self._arm.next_row())
        self._names += self._arm.messages.started()
        return state

    @property
    def _ours_runs(self) -> bool:
        """Whether the controller says by name that our program is the one that started last and has not ended."""
        return self._names[-1:] == [NAME] and self._arm.messages.running == NAME

    @property
    def _mistake(self) -> str:
        """What the controller says against our program, as the end of a sentence; empty where it says nothing."""
        said = self._arm.messages.mistake
        return f"; the controller says: {said}" if said else ""

    @property
    def _others(self) -> str:
        """The names of the programs that are not ours, for a person."""
        names = [name for name in self._names if name != NAME] or self._names[:1]
        return " and ".join(repr(name) for name in dict.fromkeys(names))


WATCHDOG_LATE_S = 0.1  # a program that ends so much later than its watchdog says is not watched
WATCHDOG_EARLY_SHARE = 0.5  # a program that ends before this share of the watchdog's time was not ended by it


def prove_watchdog(arm: Arm) -> None:
    """Set the watchdog, send nothing, and see the controller end the program in time; the arm stands meanwhile.

    Raises StreamFailure where the program goes on, or ends for another reason.
    """
    control = arm.control
    assert control is not None
    arm.set_watchdog()
    period_s = 1.0 / arm.settings.watchdog_hz
    row = arm.next_row()
    since_s, state = float(row[0]), arm_state(row)
    while state.runtime_state == RUNTIME_PLAYING:
        if failure := arm.replaced():
            raise failure
        if row[0] - since_s > period_s + WATCHDOG_LATE_S:
            # where the controller tells no names it may be another one by now, which nobody of us may stop
            raise StreamFailure("no_watchdog", f"without targets the program went on for {row[0] - since_s:.2f} s", ours=arm.messages.open)
        if failure := state_failure(state, arm.settings, arm.payload_kg, up_to_speed=False):
            raise failure
        row = arm.next_row()
        state = arm_state(row)
    took_s = row[0] - since_s
    if took_s < WATCHDOG_EARLY_SHARE * period_s - arm.tick_s:
        text = f"the program ended {took_s:.2f} s after its watchdog was set; asked {period_s:g} s"
        arm.program_sent = state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}
        raise StreamFailure("program_stopped", text, ours=False)  # what plays from now on is another
    while state.runtime_state != RUNTIME_STOPPED or control.program_runs():
        if failure := arm.replaced():
            raise failure
        if row[0] - since_s > period_s + START_S or state.runtime_state not in {RUNTIME_STOPPED, RUNTIME_STOPPING}:
            name = RUNTIME_STATES.get(state.runtime_state, "unknown")
            text = f"without targets the program is {name}; expected stopped"
            raise StreamFailure("no_watchdog", text, ours=state.runtime_state != RUNTIME_PLAYING)  # it ended: what plays now is another
        row = arm.next_row()
        state = arm_state(row)
    arm.program_sent = False
