"""How the parent names the death of its child, and when it gives up on a silent one. No process, no clock of a robot."""

import signal
from types import SimpleNamespace

import numpy as np
import pytest
from excitations import short
from test_driver import DONE, UR5, WAITING, ScriptedDriver, ScriptedSession, phase, row

from monitor.acquire import watch as watch_module
from monitor.acquire.protocol import State
from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur import lend as borrow
from monitor.acquire.ur import stream
from monitor.acquire.ur.driver import cause_of_death
from monitor.acquire.ur.failures import Stopped, StreamFailure
from monitor.acquire.ur.lend import Lend
from monitor.acquire.watch import Caller
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable

ALIVE = {"kind": "alive"}
TAKEN, GIVEN_BACK = {"kind": "taken", "number": 1}, {"kind": "given_back"}
WAITING_FOR_A_ROW = {"kind": "waiting"}


@pytest.mark.parametrize(
    ("exit_code", "silent_s", "cause"),
    [
        (-signal.SIGSYS, 0.01, "connection_lost"),  # the kernel refused it a new connection
        (-signal.SIGALRM, 0.06, "stalled"),  # a call did not return
        (-signal.SIGALRM, 0.12, "late"),  # it got no processor time
        (-signal.SIGKILL, 0.01, "child_died"),
        (71, 0.01, "child_died"),
    ],
)
def test_each_way_to_die_has_its_cause(exit_code, silent_s, cause):
    """None of them asks for a person."""
    found = cause_of_death(exit_code, silent_s)
    assert found.cause == cause
    assert cause in ReplayAborted.HARMLESS
    assert found.text


class Clock:
    def __init__(self):
        self.now_s = 0.0

    def monotonic(self):
        return self.now_s

    def time(self):
        return self.now_s


class TimedSession(ScriptedSession):
    """After `go` its frames come at given times; None stands for a look that finds an empty pipe."""

    def __init__(self, clock, frames):
        super().__init__(WAITING, [DONE])
        self.clock, self.timed, self.looks = clock, list(frames), 0

    def frames(self, timeout_s):
        if self.before or "go" not in self.sent:
            yield from super().frames(timeout_s)
            return
        self.looks += 1
        frame = self.timed.pop(0) if self.timed else None
        if frame is None:
            self.clock.now_s += timeout_s
            return
        self.clock.now_s += 0.008
        yield from self.say(frame)


def played(monkeypatch, frames, **replayed):
    clock = Clock()
    monkeypatch.setattr(watch_module, "time", clock)
    session = TimedSession(clock, [phase("control"), phase("play"), *frames])
    settings = ReplaySettings(host="127.0.0.1", allow_motion=True)
    with pytest.raises(ReplayAborted) as aborted:
        replay(
            short(), UR5, settings, driver=ScriptedDriver(session), caller=Caller(**{name: make(clock) for name, make in replayed.items()})
        )
    return aborted.value, clock


def test_a_child_that_is_silent_for_60_ms_while_the_arm_moves_is_ended(monkeypatch):
    """It took 1 s before; the child says something in every tick."""
    error, clock = played(monkeypatch, [ALIVE] * 10)
    assert error.cause == "timeout"
    assert "said nothing for 60 ms" in str(error)
    assert clock.now_s < 0.3


def test_a_parent_that_was_busy_itself_does_not_blame_its_child(monkeypatch):
    """Its callback takes 0.2 s; meanwhile the child went on, and what it sent is there at the next look."""

    def make(clock):
        def on_progress(_):
            clock.now_s += 0.2

        return on_progress

    error, _ = played(monkeypatch, [ALIVE, None, ALIVE, None, None, ALIVE] * 2, on_progress=make)
    assert error.cause == "timeout"
    assert "said nothing for 60 ms" in str(error)  # three empty looks at the very end, none before


def test_an_old_setting_of_one_second_counts_as_a_tenth(monkeypatch):
    """Configurations of earlier versions hold 1.0; they are read, and do not bring the old second back."""
    clock = Clock()
    monkeypatch.setattr(watch_module, "time", clock)
    session = TimedSession(clock, [phase("control"), phase("play"), ALIVE])
    with pytest.raises(ReplayAborted, match="said nothing for 100 ms"):
        replay(
            short(),
            UR5,
            ReplaySettings(host="127.0.0.1", allow_motion=True, silence_timeout_s=1.0),
            driver=ScriptedDriver(session),
        )


def test_a_sign_of_life_without_a_row_and_a_last_message_do_not_show_that_a_program_is_still_ours(monkeypatch):
    """While the rows are late somebody else may have started a program, and we must not stop it."""
    late = {"kind": "failed", "cause": "late", "text": "no processor time"}
    clock = Clock()
    monkeypatch.setattr(watch_module, "time", clock)
    driver = ScriptedDriver(TimedSession(clock, [phase("control"), phase("play"), ALIVE, *[WAITING_FOR_A_ROW] * 12, late]))
    with pytest.raises(ReplayAborted, match="no processor time"):
        replay(short(), UR5, ReplaySettings(host="127.0.0.1", allow_motion=True), driver=driver)
    assert clock.now_s - driver.ours.at_s > 0.1


def test_an_abort_by_the_library_is_a_lost_connection_where_its_last_words_say_so():
    """ur-rtde aborts the whole process where one of its threads meets a reset; other aborts stay unexplained."""
    words = "terminate called after throwing an instance of 'boost::wrapexcept<boost::system::system_error>'\n  what():  Broken pipe"
    assert cause_of_death(-signal.SIGABRT, 0.01, words).cause == "connection_lost"
    assert cause_of_death(-signal.SIGABRT, 0.01, "double free or corruption").cause == "child_died"
    assert cause_of_death(-signal.SIGALRM, 0.06, "RTDEControlInterface: Robot closed the connection!").cause == "connection_lost"


@pytest.mark.parametrize(
    ("exit_code", "printed", "cause"),
    [
        (-signal.SIGSYS, "", "connection_lost"),
        (-signal.SIGKILL, "", "timeout"),
        (-signal.SIGKILL, "RTDEControlInterface: Lost connection to robot...", "connection_lost"),
    ],
)
def test_a_silent_child_that_was_already_dying_is_named_by_its_death(monkeypatch, exit_code, printed, cause):
    """A process that the kernel ends takes some time to go on a busy machine, longer than the silence that its parent bears."""
    clock = Clock()
    monkeypatch.setattr(watch_module, "time", clock)
    session = TimedSession(clock, [phase("control"), phase("play"), *[ALIVE] * 5])
    session.exit_code, session.printed = exit_code, printed
    with pytest.raises(ReplayAborted) as aborted:
        replay(short(), UR5, ReplaySettings(host="127.0.0.1", allow_motion=True), driver=ScriptedDriver(session))
    assert aborted.value.cause == cause


@pytest.mark.parametrize(("end", "cause"), [("ended", "stalled"), ("replaced", "program_stopped"), ("not_shown", "stalled")])
def test_a_target_that_no_program_of_ours_takes_is_told_as_the_other_program_where_the_controller_shows_one(end, cause):
    """Somebody's program that comes while a target is sent lets the call wait until the kernel ends the process. It was told `stalled`."""
    session = ScriptedSession(WAITING, [phase("control"), phase("play"), ALIVE], exit_code=-signal.SIGALRM)
    driver = ScriptedDriver(session)
    driver.end = end
    with pytest.raises(ReplayAborted) as ended:
        replay(short(), UR5, ReplaySettings(host="127.0.0.1", allow_motion=True), driver=driver)
    assert ended.value.cause == cause
    assert ("somebody else's program" in str(ended.value)) == (end == "replaced")


def test_a_stop_that_comes_while_a_refused_arm_is_given_back_lets_the_session_finish():
    """Before `go` the session itself refuses; killed in the middle, it would leave the parent to stop a program that has its arm again."""
    looks = iter([[phase("node"), TAKEN, phase("finish")], [], [GIVEN_BACK, {"kind": "refused", "text": "the guard says no"}]])
    session = ScriptedSession([phase("node")], [DONE])
    session.frames = lambda timeout_s: (each for frame in next(looks) for each in session.say(frame))
    driver = ScriptedDriver(session)
    settings = ReplaySettings(host="127.0.0.1", allow_motion=True, hand_over="external_control")
    with pytest.raises(MotionRefused, match="the guard says no"):
        replay(short(), UR5, settings, driver=driver, caller=Caller(should_stop=lambda: True))
    assert session.sent == ["stop"]
    assert driver.programs_stopped == 0


def lending(node, next_row=lambda: None):
    """A way to take an arm from a program at this node, the arm, and what its session told."""
    told: list[str] = []
    taking = Lend()
    taking._node = node
    arm = SimpleNamespace(
        say=lambda event, **values: told.append(event.value), next_row=next_row, program_sent=False, state=State.at_start(lent=True)
    )
    return taking, arm, told


def test_an_arm_that_was_taken_is_told_before_anything_else_may_fail():
    """The parent would take its program for untouched where the controller's data ends in that very tick."""

    def next_row():
        raise StreamFailure("stalled", "no new data from the controller")

    taking, arm, told = lending(SimpleNamespace(taken=True, take=lambda number: None), next_row)
    with pytest.raises(StreamFailure, match="no new data"):
        taking.take_offered(arm, 7)
    assert arm.program_sent
    assert told == ["asking", "taken"]


def test_a_connection_that_ends_while_the_arm_is_asked_for_leaves_the_parent_to_find_out():
    """It was told as a robot that cannot be reached, although its program may have lent the arm and ended."""

    def next_row():
        raise StreamFailure("connection_lost", "the controller closed the RTDE connection")

    taking, arm, told = lending(SimpleNamespace(taken=False, offered=7, take=lambda number: None), next_row)
    with pytest.raises(StreamFailure):
        taking.take_offered(arm, 7)
    assert arm.program_sent
    assert told == ["asking"]


def test_a_node_that_neither_lends_nor_goes_on_is_passed_by_with_its_reason(monkeypatch):
    """As where the program is paused there, or was stopped while it offered its arm. It was told as a robot that cannot be reached."""
    monkeypatch.setattr(borrow, "ANSWER_S", 0.02)
    words: list[str] = []
    node = SimpleNamespace(taken=False, offered=7, take=lambda number: words.append("take"), release=lambda: words.append("release"))
    taking, arm, told = lending(node)
    assert taking.take_offered(arm, 7) == borrow.DEAF
    assert "is it paused there?" in borrow.DEAF.text
    assert words == ["take", "release"]  # a program that plays on later lends no arm to nobody
    assert not arm.program_sent
    assert told == ["asking", "not_taken"]


class Lent(ScriptedDriver):
    """A robot whose program plays, or has ended; None: it does not answer."""

    def __init__(self, session, *, plays):
        super().__init__(session)
        self.plays, self.asked_late = plays, False

    def playing_program(self, host):
        self.asked_late = self.session.ended
        if self.plays is None:
            raise RobotUnreachable(f"{host}: nobody")
        return "cell.urp" if self.plays else None


ASKING, GIVING_BACK = {"kind": "asking", "number": 1}, {"kind": "giving_back"}


@pytest.mark.parametrize("frames", [[ASKING], [TAKEN, phase("finish"), GIVING_BACK]])
@pytest.mark.parametrize(("plays", "person"), [(True, False), (False, True), (None, True)])
def test_a_session_that_dies_before_the_program_has_answered_is_followed_by_a_look_and_not_by_a_stop(monkeypatch, frames, plays, person):
    """Killed between the last word to the node and its answer: a program that has its arm again was stopped in the middle of production."""
    monkeypatch.setattr(watch_module, "NODE_DECIDES_S", 0.0)
    driver = Lent(ScriptedSession([phase("node"), *frames], [], exit_code=-signal.SIGKILL), plays=plays)
    settings = ReplaySettings(host="127.0.0.1", allow_motion=True, hand_over="external_control")
    with pytest.raises(ReplayAborted) as ended:
        replay(short(), UR5, settings, driver=driver)
    assert driver.asked_late
    assert (ended.value.cause, ended.value.borrowed, ended.value.needs_a_person) == ("child_died", person, person)
    assert driver.programs_stopped == int(person)  # which finds that nothing plays


def test_a_session_that_waits_for_a_node_hears_that_somebody_is_there(monkeypatch):
    """Without that it takes no arm: one that was taken for a stopped parent stood there for ever."""
    session = ScriptedSession([phase("node")], [], exit_code=0)
    with pytest.raises(ReplayAborted):
        replay(
            short(),
            UR5,
            ReplaySettings(host="127.0.0.1", allow_motion=True, hand_over="external_control"),
            driver=ScriptedDriver(session),
        )
    assert session.beats >= 1


def test_an_arm_that_was_lent_is_given_back_where_the_parent_says_nothing():
    """It is stopped, or hangs, while the arm stands and the program waits for it."""
    now = borrow.ABSENT_S
    waits = SimpleNamespace(taking=Lend(), state=State.at_start(lent=True), unheard_s=now + 0.1, seen_at=0.0, say=lambda *_, **__: None)
    with pytest.raises(Stopped, match="late"):
        stream.wait_for_go(waits, [])
    assert borrow.why_not_taken(waits, np.zeros(1), None) == borrow.ABSENT


@pytest.mark.parametrize(
    ("safety_mode", "bits", "cause"), [(3, 0x5, "protective_stop"), (5, 0x11, "safeguard_stop"), (1, 0x1, "program_stopped")]
)
def test_a_stop_while_the_arm_is_given_back_is_named_by_its_kind(safety_mode, bits, cause):
    """It pauses the program, which then takes no arm back; only that was told."""
    shown = row(0, runtime_state=4, safety_mode=safety_mode, safety_status_bits=bits)
    taking, arm, _ = lending(SimpleNamespace(taken=True), lambda: shown)
    arm.seen_at, arm.settings = 0.0, ReplaySettings(host="127.0.0.1")
    with pytest.raises(StreamFailure, match="did not take its arm back") as found:
        borrow.wait_until_taken_back(arm, taking.node)
    assert found.value.cause == cause
