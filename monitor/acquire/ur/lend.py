"""Borrowing the arm from a program that plays: wait for its node, take the arm, and give it back where it was taken.

Until the arm is taken nothing is asked of it but its state. Once it is taken, there are two ends: it is given back within NEAR_RAD of where
it was taken, or this process says nothing more, and the node stops the arm and ends the program.
"""

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import numpy as np

from monitor.acquire.protocol import Event
from monitor.acquire.safety.conditions import check_state
from monitor.acquire.safety.inputs import ConditionInputs
from monitor.acquire.state import RUNTIME_PLAYING, arm_state, program_name
from monitor.acquire.ur.arm import Arm
from monitor.acquire.ur.failures import Stopped, StreamFailure, state_failure
from monitor.acquire.ur.node import NO_NUMBER, VARIABLES, Node
from monitor.acquire.ur.node_script import ASTRAY, LIMITS, LOST
from monitor.acquire.ur.rtde import COLUMN
from monitor.errors import DOES_NOT_HOLD, MotionRefused
from monitor.reason import Reason, Sentence
from monitor.recording import Array

NEAR_RAD = LIMITS["near_rad"]  # the node looks at the same limit, at its own target
GIVEN_BACK = frozenset({"speed_scaling", "payload", "joint_temperature"})  # before the first motion these are no doubt about the arm
QUIET_S = 2.0  # while the node is waited for, the controller may send nothing for so long; ur-rtde gives up after 2.5 s
ANSWER_S = 1.0  # from what the node is told until it shows that it has heard; it takes some ticks
GUARD_S = 0.3  # the guard of a node that was taken repeats beats within that time
ABSENT_S = 3.0  # a parent that says nothing for so long, ten times as long as it ever computes, is stopped or hangs
UNGUARDED_S = 0.1  # a beat comes back after two ticks; a guard that repeats none for so long does not run
ABSENT = Sentence("monitor_says_nothing", "the monitor's own process says nothing")()
GONE_ON = Sentence("program_went_on", "the program went on before the arm was taken")()
DEAF = Sentence("node_is_deaf", "the program's node neither lends the arm nor goes on; does the program play, or is it paused there?")()
GONE_ON_S = 0.3  # so long the program is watched after it got its arm back: a watchdog that was left behind would stop it after 0.1 s


NODE_TOOK_BACK = Sentence("node_took_back", "the program's node has taken the arm back (state {state})")
GUARD_SILENT = Sentence("guard_silent", "the guard of the program's node has repeated no beat for {silent_ms:.0f} ms")
NO_NODE_AT_ALL = Sentence("no_node_at_all", "is there a node in the program, and does it play?")
NOT_TAKEN_AT = Sentence("not_taken_at", "at the last one: {why}")
NO_NODE = Sentence("no_node", "hand_over: no node at which the arm could be taken within {wait_h:.3g} h; {last}")
GUARD_REPEATS_NO_BEAT = Sentence(
    "guard_repeats_no_beat",
    "hand_over: the guard of the program's node repeats no beat, so nothing would stop a lost arm; is the node's text of this version?",
)
AWAY_FROM_PLACE = Sentence("away_from_place", "{joint:joint} is {away_mrad:.1f} mrad from where the arm was taken")
NODE_TOOK_BACK_EARLY = Sentence("node_took_back_early", "the program's node has taken the arm back before it was given (state {state})")
NODE_FOUND_ASTRAY = Sentence("node_found_astray", "the program's node found the arm elsewhere than it was taken, and ended the program")
NODE_ENDED_PROGRAM = Sentence("node_ended_program", "the program's node ended the program after it got its arm back (state {state})")


class Lend:
    """A program that plays lends the arm at its node. The node's guard stops the arm, and ends the program, where beats do not come."""

    variables = VARIABLES
    anywhere = False
    absent_s = ABSENT_S
    in_doubt = False

    def __init__(self) -> None:
        self._node: Node | None = None

    @property
    def node(self) -> Node:
        """The node, once its registers are open."""
        assert self._node is not None
        return self._node

    def prepare(self, arm: Arm, known: ConditionInputs) -> None:
        """Open both connections, and take the arm at the first node at which every condition on its state holds."""
        self._node = Node(arm.settings.host, arm.receive)
        arm.connect_control(lent=True)
        self._take(arm, known)

    @contextmanager
    def kept(self, arm: Arm) -> Iterator[None]:
        """The arm stands, and is given back before a refusal or a request to stop is passed on: it has not moved."""
        try:
            with self.beats():
                yield
        except (MotionRefused, Stopped):
            arm.say(Event.FINISH, duration_s=0.0)
            self.give_up(arm)
            raise

    def connect(self, arm: Arm) -> None:
        """Nothing: the connections stand."""

    def take_control(self, arm: Arm) -> None:
        """The control loop runs already: see that the node guards the arm, and that the program plays at full speed."""
        arm.say(Event.CONTROL, duration_s=0.0)
        with self.kept(arm):
            self._prove_guard(arm)
            try:
                arm.wait_for_full_speed()
            except StreamFailure as failure:
                if failure.cause in GIVEN_BACK:
                    raise MotionRefused(DOES_NOT_HOLD(condition=failure.cause, why=failure.reason)) from None
                raise

    def guard(self, arm: Arm) -> None:
        """Nothing: a watchdog would outlive the node, and stop the program after it; the node has a guard of its own."""

    def failure(self, arm: Arm, found: StreamFailure | None) -> StreamFailure | None:
        """What the state says, else that the node does not lend the arm any longer, or that its guard does not watch it."""
        if found is not None:
            return found
        if not self.node.taken:
            return StreamFailure("program_stopped", NODE_TOOK_BACK(state=self.node.state))
        if (silent_s := self.node.silent_s(arm.seen_at)) > UNGUARDED_S:
            return StreamFailure("no_watchdog", GUARD_SILENT(silent_ms=1000 * silent_s))
        return None

    def beat(self) -> None:
        """Say once more that the arm is watched."""
        if self._node is not None:
            self._node.beat()

    def beats(self) -> AbstractContextManager[None]:
        """Beat from a thread meanwhile."""
        return self.node.beating()

    def leave_nothing_behind(self, arm: Arm, failure: StreamFailure) -> None:
        """Nothing: without beats the node ends its program."""

    def _take(self, arm: Arm, known: ConditionInputs) -> None:
        """Wait until the program offers the arm while every condition on its state but the way to the start holds, and take it.

        Raises Stopped where a stop was asked for; MotionRefused where no such node came in time; StreamFailure.
        """
        node, lent = self.node, arm.settings.lent
        assert lent is not None
        arm.say(Event.NODE, duration_s=lent.wait_s)
        node.say_due(True)
        until, number, deaf = time.monotonic() + lent.wait_s, None, None
        why: Reason | None = None
        while True:
            row = _row_in_time(arm)
            if arm.state.must_rest:
                self._leave_alone()
                raise Stopped(arm.stop_cause)
            offered = node.offered
            if number is not None and offered != number:  # the program has gone on
                arm.outbox.message("passed_by", reason=(why or GONE_ON).document())
                number = None
            if offered is not None and offered != deaf:
                number, why = offered, why_not_taken(arm, row, known)
                if why is None and (why := self.take_offered(arm, offered)) is None:
                    return
                deaf = offered if why == DEAF else None
            if time.monotonic() > until:
                self._leave_alone()
                last = NO_NODE_AT_ALL() if why is None else NOT_TAKEN_AT(why=why)
                raise MotionRefused(NO_NODE(wait_h=lent.wait_s / 3600.0, last=last))

    def take_offered(self, arm: Arm, number: int) -> Reason | None:
        """Ask for the arm that is offered under this number: why it was not taken; None once it is ours.

        Until the node has answered nobody knows whether its program would end with this process: the parent is told so before. Raises
        StreamFailure.
        """
        node, begin_s = self.node, time.monotonic()
        arm.program_sent = True  # from now on the program may end unless it gets its arm back
        arm.say(Event.ASKING, number=number)
        node.take(number)
        while not node.taken:
            gone_on = node.offered != number and time.monotonic() - begin_s > ANSWER_S / 10 and not node.taken
            if gone_on or time.monotonic() - begin_s > ANSWER_S:
                node.release()
                arm.program_sent = False
                arm.say(Event.NOT_TAKEN)
                return GONE_ON if gone_on else DEAF
            arm.next_row()
        arm.say(Event.TAKEN, number=number)
        node.taken_q = arm.next_row()[COLUMN["target_q"]].copy()
        return None

    def _prove_guard(self, arm: Arm) -> None:
        """See the node's guard repeat beats: it is what stops the arm if this process dies.

        Raises MotionRefused where it does not, with an arm that has not moved; StreamFailure.
        """
        node, begin_s = self.node, arm.seen_at
        node.silent_s(arm.seen_at)  # what it repeated before does not count
        repeated = 0
        while repeated < 3:
            arm.next_row()
            repeated += node.silent_s(arm.seen_at) == 0.0
            if arm.seen_at - begin_s > GUARD_S:
                raise MotionRefused(GUARD_REPEATS_NO_BEAT())

    def _leave_alone(self) -> None:
        """No replay is due any longer: the node costs the program nothing."""
        self.node.say_due(False)
        self.node.release()

    def give_up(self, arm: Arm) -> None:
        """Give the arm back where it was taken, and see the program go on.

        Raises StreamFailure where the arm is elsewhere, without a word to the node, or where the program does not go on.
        """
        node = self.node
        row = arm.fresh_row()
        for name in ("actual_q", "target_q"):
            away = np.abs(row[COLUMN[name]] - node.taken_q)  # (J,)
            if not np.all(away <= NEAR_RAD):
                j = int(np.argmax(away))
                raise StreamFailure("astray", AWAY_FROM_PLACE(joint=j + 1, away_mrad=1000.0 * away[j]))
        if not node.taken:
            raise StreamFailure("program_stopped", NODE_TOOK_BACK_EARLY(state=node.state))
        arm.say(Event.GIVING_BACK)
        node.say_due(False)
        node.release()
        wait_until_taken_back(arm, node)
        if node.state in {LOST, ASTRAY}:
            raise StreamFailure("astray", NODE_FOUND_ASTRAY())
        node.number, arm.program_sent = NO_NUMBER, False
        arm.say(Event.GIVEN_BACK)
        begin_s = arm.seen_at
        while arm.seen_at - begin_s < GONE_ON_S:
            arm.next_row()
            if node.state in {LOST, ASTRAY}:
                text = NODE_ENDED_PROGRAM(state=node.state)
                raise StreamFailure("program_stopped", text)


def _row_in_time(arm: Arm) -> Array:
    """The next row (WIDTH,), of a controller that may be silent for a while: the wait lasts hours, and nothing depends on one tick.

    Raises StreamFailure.
    """
    while True:
        try:
            return arm.next_row()
        except StreamFailure as failure:
            if failure.cause not in {"stalled", "late"} or time.monotonic() - arm.seen_at > QUIET_S:
                raise
            arm.control.report()


def why_not_taken(arm: Arm, row: Array, known: ConditionInputs) -> Reason | None:
    """Why the arm is not taken in this state; None where every condition holds."""
    if arm.unheard_s > ABSENT_S:
        return ABSENT
    try:
        check_state(replace(known, state=arm_state(row)), without=("approach_clear",))
    except MotionRefused as refusal:
        return refusal.reason
    return None


STOPPED_THEN = Sentence("stopped_then", "{why}; {then}")
ARM_NOT_TAKEN_BACK = Sentence("arm_not_taken_back", "the program is {name:word} and did not take its arm back")


def wait_until_taken_back(arm: Arm, node: Node) -> None:
    """Wait for the node's word that the arm is no longer ours. Raises StreamFailure where it does not come."""
    begin_s = arm.seen_at
    while node.taken:
        state = arm_state(arm.next_row())
        if state.runtime_state != RUNTIME_PLAYING or arm.seen_at - begin_s > ANSWER_S:
            name = program_name(state.runtime_state)
            why = state_failure(state, arm.settings, playing=False, up_to_speed=False)  # a safety stop pauses the program
            text = ARM_NOT_TAKEN_BACK(name=name)
            raise (
                StreamFailure("program_stopped", text) if why is None else StreamFailure(why.cause, STOPPED_THEN(why=why.reason, then=text))
            )
