"""How a replay ends: what became of our program, in words for a person why it ended, and what is known of the arm after it.

A session that has ended leaves a `State` whose program may still run. `end_program` finds out what became of it, and stops it;
`how_it_ended` names the cause; `look` looks at the arm, by receiving only, and `judged_end` adds what it has seen. The protocol's table
(`protocol`) has no end that is not found out so.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.acquire.driver import Driver, OurEnd, SafetyStop
from monitor.acquire.protocol import Event, Program
from monitor.acquire.safety.oversight import Interruption
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import RUNTIME_STOPPED, STANDSTILL_RAD_S, ArmState, program_name
from monitor.acquire.watch import Watch
from monitor.errors import AT_HOST, LastSeen, MonitorError, MotionRefused, ReplayAborted, RobotUnreachable
from monitor.reason import Reason, Sentence, reason_from

PRINTED_TAIL = 300  # characters of what a dead process printed that go into the error's text
LOOK_S = 5.0  # one look: the start of a process that receives, on a busy host too, its connection, and a tenth of a second of rows
REST_S = 3.0  # an arm that still moves, or a program that still runs, so long after the end did not end
LEAVING_S = 3.0  # somebody who wants this process to end does not wait longer for a controller that does not answer


def end_program(watch: Watch, driver: Driver) -> OurEnd | None:
    """Find out what became of the program that has the arm, once the session has ended, and stop ours where it may run.

    Returns how it has ended; None where nothing of ours could run any more.
    """
    host = watch.settings.host
    watch.find_out(lambda: driver.playing_program(host))
    if not watch.state.may_run:
        return None
    end = driver.stop_program(host, watch.our_program)
    watch.state = watch.state.after(Event.NOT_SHOWN if end == "not_shown" else Event.PROGRAM_ENDED)
    return end


NO_CONNECTION = Sentence("no_connection", "{host}: no RTDE connection: {why}")
REPLACED_BY_ANOTHER = Sentence("replaced_by_another", "somebody else's program was started in the place of ours; {why}")
LAST_WORDS_PRINTED = Sentence("last_words", "{why}; its last words: {printed!r}")
AND_THEN = Sentence("and_then", "{first}; {then}")
CAUSED = Sentence("caused", "{cause}: {why}")
NOT_CONFIRMED = Sentence("stop_not_confirmed", "THE CONTROLLER DID NOT CONFIRM THE STOP: look at the arm")
PROGRAM_LOST = Sentence(
    "program_lost",
    "the program that lent the arm has ended and does not go on: bring the arm where the program can begin, and start it",
)
PROGRAM_UNKNOWN = Sentence("program_unknown", "it is not known whether our program has ended")
ENDED_IN_PHASE = Sentence("ended_in_phase", "{host}: {cause} in the phase {phase!r}: {why}")
ENDED_BEFORE = Sentence("ended_before", "{host}: {cause} before anything moved: {why}")


def how_it_ended(
    watch: Watch, driver: Driver, end: OurEnd | None, death: Interruption, printed: str, home_q: tuple[float, ...]
) -> MonitorError:
    """What ended a replay early.

    end : of our program, None where nothing had to be stopped. death : why the session's process ended, if it ended by itself. printed : by
    that process. home_q : (J,) [rad] where the arm should have come back to; empty: not known.
    """
    message, host, state = watch.last_word, watch.settings.host, watch.state
    said = None if message is None else reason_from(message["reason"])
    if message is not None and message["kind"] == Event.REFUSED:
        return MotionRefused(AT_HOST(host=host, why=said))
    if message is not None and message["kind"] == Event.UNREACHABLE:
        return RobotUnreachable(said or "")
    if message is not None and said is not None:
        cause, why = message["cause"], said
    else:
        cause, why = death
        # a silent process that was given up may have been dying of a lost connection already
        dying = state.gone and cause == "connection_lost"
        if watch.interruption is not None and not (watch.interruption.cause == "timeout" and dying):
            cause, why = watch.interruption
        elif cause == "stalled" and end == "replaced":  # a command waits for our program, which is not there any more
            cause, why = "program_stopped", REPLACED_BY_ANOTHER(why=why)
        elif printed:
            why = LAST_WORDS_PRINTED(why=why, printed=printed[-PRINTED_TAIL:])
    if not state.moved and cause == "timeout":
        return RobotUnreachable(NO_CONNECTION(host=host, why=why))
    if watch.asked is not None and cause == "parent_asked_to_stop" != watch.asked.cause:  # the session knows only that it was asked
        cause, why = watch.asked.cause, AND_THEN(first=watch.asked.reason, then=why)
    if cause in ReplayAborted.HARMLESS and end in {"ended", "replaced"} and (stop := driver.safety_stop(host)):
        # the session did not live to see this stop, or saw only that the program stopped
        cause, why = stop.cause, AND_THEN(first=stop.reason, then=CAUSED(cause=cause, why=why))
    outcome = [NOT_CONFIRMED()] if state.unknown else []
    outcome += [PROGRAM_LOST()] if state.lent else []
    if state.gone:
        ended = ENDED_IN_PHASE(host=host, cause=cause, phase=watch.phase.value, why=why)
    else:
        ended = ENDED_BEFORE(host=host, cause=cause, why=why)
    for each in outcome:
        ended = AND_THEN(first=ended, then=each)
    given_back = state.program is Program.GOES_ON
    return ReplayAborted(
        ended,
        cause,
        moved=state.moved,
        at_rest=message is not None and message["kind"] == Event.STOPPED,
        unknown=PROGRAM_UNKNOWN() if state.unknown else None,
        phase="" if given_back or watch.last_motion is None else watch.last_motion.value,  # the program that has its arm back moves it now
        home_q=home_q,
        borrowed=state.lent,
        last_seen=watch.last_seen,
    )


class Gap(NamedTuple):
    """From the last that a session showed of its arm to the first look at it. Nobody has seen what happened between the two.

    The two clocks agree where the controller ran through the gap.
    """

    host_s: float
    controller_s: float  # NaN: one of the two did not show it


@dataclass(frozen=True, slots=True, eq=False)
class ArmAfter:
    """The arm after a motion."""

    stop: SafetyStop | None = None  # that its safety system holds
    unknown: Reason | None = None  # what is not known; None: all is in order
    state: ArmState | None = None  # what the controller reported; None: it did not answer
    gap: Gap | None = None  # before the first look; None: nobody looked, or nothing was seen before


NO_ANSWER = Sentence(
    "no_answer_after",
    "the controller did not answer for {lasted_s:.0f} s: it is not known whether the arm came to rest, whether it has power, and whether "
    "its safety system stopped it",
)
A_PROGRAM_RUNS = Sentence(
    "a_program_runs", "a program is {name:word}: it is not known whether it is ours, and whether the arm came to rest"
)
NOT_STILL = Sentence("not_still", "the arm does not stand still")


def gap_between(last: LastSeen | None, state: ArmState | None) -> Gap | None:
    """The gap before a look that showed this state; None where nothing was seen on one of its sides."""
    if last is None or state is None:
        return None
    return Gap(state.host_s - last.host_s, state.controller_s - last.controller_s)


def look(
    driver: Driver,
    settings: ReplaySettings,
    *,
    clean: bool,
    last_seen: LastSeen | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> ArmAfter:
    """Look at the arm until it is in order, for at most confirm_timeout_s.

    clean : the session has shown that the arm came to rest and its program ended; a program that runs now is another's, and may move it.
    """
    began, gap = time.monotonic(), None
    while True:
        state = driver.state(settings.host, settings.rate_hz, LOOK_S)
        found, gap = judged(state, clean=clean), gap or gap_between(last_seen, state)
        lasted_s = time.monotonic() - began
        patience_s = settings.confirm_timeout_s if found is None else min(REST_S, settings.confirm_timeout_s)
        if should_stop():
            patience_s = min(patience_s, LEAVING_S)
        if found is None and lasted_s > patience_s:
            return ArmAfter(unknown=NO_ANSWER(lasted_s=lasted_s), gap=gap)
        if found is not None and (found.unknown is None or found.stop is not None or lasted_s > patience_s):
            return replace(found, gap=gap)


def judged(state: ArmState | None, *, clean: bool) -> ArmAfter | None:
    """What one state says; None where there is none."""
    if state is None:
        return None
    if (why := state.not_safe) is not None:
        return ArmAfter(SafetyStop(state.safety_cause, why), why, state)
    if (why := state.not_running) is not None:
        return ArmAfter(SafetyStop("robot_mode", why), why, state)
    if clean:
        return ArmAfter(state=state)
    if state.runtime_state != RUNTIME_STOPPED:
        return ArmAfter(None, A_PROGRAM_RUNS(name=program_name(state.runtime_state)), state)
    if not np.all(np.abs(state.qd) <= STANDSTILL_RAD_S):  # also where a speed is no number
        return ArmAfter(None, NOT_STILL(), state)
    return ArmAfter(state=state)


def judged_end(error: ReplayAborted, after: ArmAfter) -> ReplayAborted:
    """The same end of a replay, with what is known of the arm after it. A stop by the robot's safety system is the cause of any end."""
    if after.stop is not None:
        return error.stopped(after.stop.cause, after.stop.reason, after.unknown)
    return error.known(after.unknown)
