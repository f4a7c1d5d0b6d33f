"""How the parent names the death of its child, and when it gives up on a silent one. No process, no clock of a robot."""

import signal
from types import SimpleNamespace

import pytest
from excitations import short
from test_driver import DONE, UR5, WAITING, ScriptedDriver, ScriptedSession, phase

from monitor.acquire import watch as watch_module
from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.streaming import borrow
from monitor.acquire.ur.streaming.failures import StreamFailure
from monitor.acquire.watch import cause_of_death
from monitor.errors import MotionRefused, ReplayAborted

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
        yield frame


def played(monkeypatch, frames, **replayed):
    clock = Clock()
    monkeypatch.setattr(watch_module, "time", clock)
    session = TimedSession(clock, [phase("control"), phase("play"), *frames])
    settings = ReplaySettings(host="127.0.0.1", allow_motion=True)
    with pytest.raises(ReplayAborted) as aborted:
        replay(short(), UR5, settings, driver=ScriptedDriver(session), **{name: make(clock) for name, make in replayed.items()})
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
    late = {"kind": "failed", "cause": "late", "text": "no processor time", "ended": False}
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


def test_a_stop_that_comes_while_a_refused_arm_is_given_back_lets_the_session_finish():
    """Before `go` the session itself refuses; killed in the middle, it would leave the parent to stop a program that has its arm again."""
    looks = iter([[TAKEN, phase("finish")], [], [GIVEN_BACK, {"kind": "refused", "text": "the guard says no"}]])
    session = ScriptedSession([], [DONE])
    session.frames = lambda timeout_s: iter(next(looks))
    driver = ScriptedDriver(session)
    settings = ReplaySettings(host="127.0.0.1", allow_motion=True, hand_over="external_control")
    with pytest.raises(MotionRefused, match="the guard says no"):
        replay(short(), UR5, settings, driver=driver, should_stop=lambda: True)
    assert session.sent == ["stop"]
    assert driver.programs_stopped == 0


def test_an_arm_that_was_taken_is_told_before_anything_else_may_fail():
    """The parent would take its program for untouched where the controller's data ends in that very tick."""
    told: list[str] = []

    def next_row():
        raise StreamFailure("stalled", "no new data from the controller")

    node = SimpleNamespace(taken=True, take=lambda number: None)
    outbox = SimpleNamespace(message=lambda kind, **values: told.append(kind))
    arm = SimpleNamespace(node=node, outbox=outbox, next_row=next_row, program_sent=False)
    with pytest.raises(StreamFailure, match="no new data"):
        borrow._takes(arm, 7)
    assert arm.program_sent
    assert told == ["taken"]
