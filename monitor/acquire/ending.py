"""How a replay ends: what became of our program, in words for a person why it ended, and what is known of the arm after it.

A session that has ended leaves a `State` whose program may still run. `end_program` finds out what became of it, and stops it;
`how_it_ended` names the cause; `look_after` looks at the arm, by receiving only, and adds what it has seen. The protocol's table
(`protocol`) has no end that is not found out so.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.acquire.driver import Driver, History, OurEnd, OurProgram, SafetyStop, Witness
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
LONGEST_GAP_S = 2.0  # the controller's watchdog (0.1 s), the stop of our program (at most 1.6 s), and the first row of a look
UNKNOWN_GAP_S = 1.0  # where the robot does not tell what happened in it: a program and an unlocked stop take longer
CLOCKS_APART_S = 0.15  # over a gap: a row may be 0.1 s old when it is read, and both clocks drift by less than 1e-3
AT_REST_RAD, STOPS_WITHIN_S = 0.05, 0.3  # an arm at rest stays so near; one that moves comes to rest within so long
PAYLOAD_KG = 0.01  # the controller's rounding
LEAVING_S = 3.0  # somebody who wants this process to end does not wait longer for a controller that does not answer


def end_program(watch: Watch, driver: Driver, witness: Witness | None = None) -> OurEnd | None:
    """Find out what became of the program that has the arm, once the session has ended, and stop ours where it may run.

    witness : knows longer than the session that what runs is ours. Returns how it has ended; None where nothing of ours could run any more.
    """
    host = watch.settings.host
    watch.find_out(lambda: driver.playing_program(host))
    if not watch.state.may_run:
        return None
    end = driver.stop_program(host, watch.our_program._replace(runs=None if witness is None else witness.ours_runs))
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


GAP_NOT_SEEN = Sentence("gap_not_seen", "the arm was not seen in this motion: nobody knows what happened to it")
GAP_OF_CLOCKS = Sentence(
    "gap_of_clocks",
    "nobody saw the arm for {host_s:.1f} s by the clock of this machine, and {controller_s:.1f} s by the controller's: this monitor or its "
    "machine stood still, a clock was set, or the controller was restarted; look at the arm",
)
GAP_TOO_LONG = Sentence(
    "gap_too_long",
    "nobody saw the arm for {host_s:.2f} s, and anything may have happened to it; at most {limit_s:g} s are explained; look at the arm",
)
GAP_TOLD = Sentence("gap_told", "{what}: look at the arm")
GAP_MOVED = Sentence(
    "gap_moved", "{joint:joint} went {moved_rad:.2f} rad while nobody saw the arm, more than it takes to come to rest: look at the arm"
)
GAP_PAYLOAD = Sentence(
    "gap_payload", "the payload was {before_kg:.3f} kg, and is {after_kg:.3f} kg since nobody saw the arm: look at the arm"
)


def unexplained(before: LastSeen | None, after: ArmState, history: History, *, clean: bool) -> Reason | None:
    """Why the gap from the last that a session showed of its arm to the first look at it is not explained; None: it is.

    Nobody has seen what happened between the two. A gap is explained where the controller's clock went on by the time of the host; where it
    is no longer than our own end takes (the watchdog, the stop of our program, one look); where the robot's own history of it tells of
    nothing else or, if that is not known, it was too short for a person; and where the arm is where a stop leaves it. A controller lets
    nobody unlock a protective stop within 5 s.

    clean : as of `look`: a program that runs now is another's, and may move the arm.
    """
    if before is None:
        return GAP_NOT_SEEN()
    host_s, controller_s = after.host_s - before.host_s, after.controller_s - before.controller_s
    if not abs(controller_s - host_s) <= CLOCKS_APART_S:  # also where one of them is no number
        return GAP_OF_CLOCKS(host_s=host_s, controller_s=controller_s)
    limit_s = LONGEST_GAP_S if history.known else UNKNOWN_GAP_S
    if not host_s <= limit_s:
        return GAP_TOO_LONG(host_s=host_s, limit_s=limit_s)
    if history.found is not None:
        return GAP_TOLD(what=history.found)
    if clean and after.runtime_state != RUNTIME_STOPPED:
        return None
    ahead = (after.q - np.array(before.q)) * np.where(np.array(before.qd) < 0.0, -1.0, 1.0)  # (J,) [rad] in the direction of the motion
    beyond = np.maximum(-ahead, ahead - STOPS_WITHIN_S * np.abs(before.qd)) - AT_REST_RAD  # (J,)
    if not np.all(beyond <= 0.0):
        j = int(np.argmax(beyond))
        return GAP_MOVED(joint=j + 1, moved_rad=abs(ahead[j]))
    if abs(after.payload_kg - before.payload_kg) > PAYLOAD_KG:  # not where it is not reported
        return GAP_PAYLOAD(before_kg=before.payload_kg, after_kg=after.payload_kg)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class ArmAfter:
    """The arm after a motion."""

    stop: SafetyStop | None = None  # that its safety system holds
    unknown: Reason | None = None  # what is not known; None: all is in order
    state: ArmState | None = None  # what the controller reported; None: it did not answer


NO_ANSWER = Sentence(
    "no_answer_after",
    "the controller did not answer for {lasted_s:.0f} s: it is not known whether the arm came to rest, whether it has power, and whether "
    "its safety system stopped it",
)
A_PROGRAM_RUNS = Sentence(
    "a_program_runs", "a program is {name:word}: it is not known whether it is ours, and whether the arm came to rest"
)
NOT_STILL = Sentence("not_still", "the arm does not stand still")


def look(driver: Driver, settings: ReplaySettings, *, clean: bool, should_stop: Callable[[], bool] = lambda: False) -> ArmAfter:
    """Look at the arm until it is in order, for at most confirm_timeout_s.

    clean : the session has shown that the arm came to rest and its program ended; a program that runs now is another's, and may move it.
    """
    return _look(driver, settings, clean=clean, should_stop=should_stop)[0]


def look_after(
    driver: Driver,
    settings: ReplaySettings,
    error: ReplayAborted,
    *,
    witness: Witness | None = None,
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[ReplayAborted, ArmAfter]:
    """Look at the arm that a replay left early; the same end with what is known after it, and what was seen.

    A stop by the robot's safety system is the cause of any end. What is unknown, and a gap that is not explained, ask for a person.
    """

    def stop_ours() -> None:
        if witness is not None and witness.ours_runs():
            driver.stop_program(settings.host, OurProgram(None, runs=witness.ours_runs))

    after, first = _look(driver, settings, clean=error.at_rest, should_stop=should_stop, stop_ours=stop_ours)
    if after.stop is not None:
        return error.stopped(after.stop.cause, after.stop.reason, after.unknown), after
    if first is None:
        return error.known(after.unknown), after
    history, before = History(), error.last_seen
    if before is not None and witness is not None:
        history = witness.history(before.host_s, first.host_s, programs=not error.at_rest)
    gap = unexplained(before, first, history, clean=error.at_rest)
    return error.known(after.unknown or gap), after


def _look(
    driver: Driver, settings: ReplaySettings, *, clean: bool, should_stop: Callable[[], bool], stop_ours: Callable[[], None] = lambda: None
) -> tuple[ArmAfter, ArmState | None]:
    """What `look` returns, and the first state that was seen. stop_ours : is called where a program runs, which may be ours."""
    began, first = time.monotonic(), None
    while True:
        state = driver.state(settings.host, settings.rate_hz, LOOK_S)
        found, first = judged(state, clean=clean), first or state
        lasted_s = time.monotonic() - began
        patience_s = settings.confirm_timeout_s if found is None else min(REST_S, settings.confirm_timeout_s)
        if should_stop():
            patience_s = min(patience_s, LEAVING_S)
        if found is None and lasted_s > patience_s:
            return ArmAfter(unknown=NO_ANSWER(lasted_s=lasted_s)), first
        if found is not None and (found.unknown is None or found.stop is not None or lasted_s > patience_s):
            return found, first
        if found is not None and state is not None and state.runtime_state != RUNTIME_STOPPED:
            stop_ours()


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
