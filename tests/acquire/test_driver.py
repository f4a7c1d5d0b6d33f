"""A replay on a driver that is handed in: no process, no socket, no clock of a robot."""

import math
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from test_guard import ready_state

from monitor.acquire.driver import History, SafetyStop, SessionEnded
from monitor.acquire.listen import Listener, ListenSettings, record
from monitor.acquire.protocol import Event, Phase, State
from monitor.acquire.replay import check, replay
from monitor.acquire.safety import oversight
from monitor.acquire.safety.inputs import LastMotion, Permit
from monitor.acquire.safety.torque_basis import BandBasis
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import Identity, Services
from monitor.acquire.ur.driver import cause_of_death, understood
from monitor.acquire.ur.rtde import COLUMN, WIDTH
from monitor.acquire.watch import LAST_WORDS, Caller
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable, StoreUnavailable
from monitor.model.robot import load_robot
from monitor.reason import ANYTHING, reason_of
from monitor.recording import Context

pytestmark = pytest.mark.real_time

UR5 = load_robot("ur5")
SETTINGS = ReplaySettings(host="127.0.0.1", allow_motion=True)
DONE = {"kind": "done", "torn_reads": 0, "slipped_s": 0.0, "longest_gap_s": 0.008, "real_time": False}


def row(tick: int, **values) -> np.ndarray:
    """A row (WIDTH,) of an arm at rest at the start of `short()`, so many ticks after its first."""
    state = ready_state()
    made = np.full(WIDTH, np.nan)
    known = {
        "timestamp": 10.0 + 0.008 * tick,
        "host_monotonic_s": 20.0 + 0.008 * tick,
        "actual_q": state.q,
        "actual_qd": 0.0,
        "target_q": state.q,
        "target_qd": 0.0,
        "joint_temperatures": 25.0,
        "robot_mode": 7,
        "safety_mode": 1,
        "safety_status_bits": 1,
        "runtime_state": 1,
        "speed_scaling": 1.0,
        "target_speed_fraction": 1.0,
        "robot_status_bits": 1,
        "joint_mode": 253,
    }
    for name, value in (known | values).items():
        made[COLUMN[name]] = value
    return made


def phase(name: str) -> dict:
    return {"kind": name, "duration_s": 1.0}


SAID = [event for event in Event if event not in {Event.GO, Event.BACK, Event.STOP, *LAST_WORDS, Event.DIED}]  # by a session that goes on


def before(state: State, event: Event) -> list[Event]:
    """What a session must say first, as briefly as the protocol allows, so that it may say this; nothing where that is never possible."""
    ways = deque([(state, [])])
    seen = {state}
    while ways:
        at, said = ways.popleft()
        if at.allows(event):
            return said
        for each in SAID:
            if at.phase is not Phase.ENDED and at.allows(each) and (after := at.after(each)) not in seen:
                seen.add(after)
                ways.append((after, [*said, each]))
    return []


WAITING = [phase("connect"), phase("ready"), {"kind": "state", "row": row(0).tolist()}]


class ScriptedSession:
    """Sends the frames before `go`, then those after it, and before each what the protocol asks for; then it ends with an exit code."""

    def __init__(self, before, after, exit_code=0):
        self.before, self.after, self.exit_code = list(before), list(after), exit_code
        self.sent, self.ended, self.printed = [], False, ""
        self.beats = 0
        lent = any(isinstance(frame, dict) and frame["kind"] in {"node", "taken", "asking"} for frame in self.before)
        self.state = State.at_start(lent=lent)

    def send(self, word):
        if word == "here":
            self.beats += 1
            return
        self.sent.append(word)
        if self.state.allows(Event(word)):
            self.state = self.state.after(Event(word))

    def say(self, frame):
        if not isinstance(frame, dict) or frame["kind"] not in list(Event):
            return [frame]
        event = Event(frame["kind"])
        frame = {**frame, "reason": ANYTHING(text=frame["text"]).document()} if "text" in frame else frame
        first = before(self.state, event)
        for each in (*first, event):
            self.state = self.state.after(each) if self.state.allows(each) else self.state
        return [*({"kind": each, "duration_s": 1.0} for each in first), frame]

    def frames(self, timeout_s):
        waiting = self.before or (self.after if "go" in self.sent else [])
        if not waiting and ("go" in self.sent or not self.after):
            raise SessionEnded("the script is at its end")
        said = [each for frame in waiting for each in self.say(frame)]
        waiting.clear()
        yield from said

    def end(self, patience_s=0.0):
        self.ended = True
        return self.exit_code


class Untold:
    """The witness of a robot that tells nothing of itself."""

    def ours_runs(self):
        return False

    def begin(self):
        pass

    def history(self, since_s, until_s, *, programs=True):
        return History()

    def close(self):
        pass


class ScriptedDriver:
    """A robot of another make."""

    def __init__(self, session, *, identity=None, stop=None):
        self.session, self.stop, self.end = session, stop, "ended"  # the last: how our program has ended
        self._identity = understood(identity or Identity(model="UR5", serial="7", firmware="3.15.8", remote_control=True))
        self.programs_stopped = 0

    def identity(self, host):
        if host != SETTINGS.host:
            raise RobotUnreachable(f"{host}: nobody")
        return self._identity

    def services(self, host):
        return Services((host,))

    def state(self, host, rate_hz, timeout_s):
        return ready_state()

    def listen(self, host, rate_hz):
        return self.session

    def stream(self, task):
        self.task = task
        return self.session

    def cause_of_death(self, exit_code, silent_s, printed, call):
        return cause_of_death(exit_code, silent_s, printed, call)

    def witness(self, host):
        return Untold()

    def safety_stop(self, host):
        return self.stop

    @contextmanager
    def remote_control(self, host):
        yield lambda: True

    def playing_program(self, host):
        return "ours.urp"

    def stop_program(self, host, ours):
        assert self.session.ended  # first the session, then the robot
        self.programs_stopped += 1
        self.ours = ours
        return self.end


def test_a_replay_needs_nothing_but_its_driver():
    """The rows that the session sends become the recording, with the robot's data from the driver."""
    rows = [row(tick) for tick in (1, 2, 4)]
    driver = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), *rows, DONE]))
    recording = replay(short(), UR5, SETTINGS, driver=driver)
    assert driver.session.sent == ["go"]
    assert driver.session.ended
    assert driver.programs_stopped == 0
    assert driver.task.robot.name == "ur5"
    assert recording.samples == 3
    assert recording.quality["missed_ticks"] == 1
    assert (recording.context.serial, recording.context.firmware) == ("7", "3.15.8")


def test_a_session_that_dies_in_control_leaves_a_stopped_robot_and_its_safety_stop_is_the_cause():
    """Without a safety stop the death of the session is the cause."""
    for stop, cause in ((None, "child_died"), (SafetyStop("protective_stop", ANYTHING(text="it ran into a box")), "protective_stop")):
        driver = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1)], exit_code=-9), stop=stop)
        with pytest.raises(ReplayAborted, match="by signal 9") as aborted:
            replay(short(), UR5, SETTINGS, driver=driver)
        assert aborted.value.cause == cause
        assert driver.programs_stopped == 1


def test_a_refusal_before_control_stops_no_program_of_somebody_else():
    """By the session, by a condition of the state, and by the identity: nothing of ours runs on the robot."""
    refused = ScriptedDriver(ScriptedSession([phase("connect"), {"kind": "refused", "text": "a program is playing"}], []))
    playing = {"kind": "state", "row": row(0, runtime_state=2).tolist()}
    not_ready = ScriptedDriver(ScriptedSession([phase("connect"), phase("ready"), playing], [DONE]))
    for driver in (refused, not_ready):
        with pytest.raises(MotionRefused, match="a program is playing"):
            replay(short(), UR5, SETTINGS, driver=driver)
        assert driver.session.sent == []
        assert driver.session.ended
        assert driver.programs_stopped == 0
    with pytest.raises(MotionRefused, match="robot_model"):
        replay(short(), UR5, SETTINGS, driver=ScriptedDriver(None, identity=Identity("UR10", "7", None, None)))


def test_after_a_clean_end_no_program_is_stopped():
    """The session ended its own program, at the end of the replay or on request: what runs now is somebody else's."""
    done = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1), row(2), DONE]))
    replay(short(), UR5, SETTINGS, driver=done)
    ended = {"kind": "stopped", "cause": "parent_asked_to_stop", "text": "the arm stands"}
    asked = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1), ended]))
    with pytest.raises(ReplayAborted) as aborted:
        replay(short(), UR5, SETTINGS, driver=asked)
    assert (done.programs_stopped, asked.programs_stopped) == (0, 0)
    assert aborted.value.moved
    nothing_sent = {"kind": "stopped", "cause": "no_control", "text": "somebody else's program is playing"}
    other = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), nothing_sent]))
    with pytest.raises(ReplayAborted, match="somebody else's"):
        replay(short(), UR5, SETTINGS, driver=other)
    assert other.programs_stopped == 0


@pytest.mark.parametrize(
    ("frames", "state"),
    [
        ([], None),
        ([phase("control")], "starting"),
        ([phase("control"), {"kind": "failed", "cause": "no_control", "text": "replaced", "ours": False}], None),
        ([phase("control"), {"kind": "failed", "cause": "program_stopped", "text": "stopped"}], "paused"),
        ([phase("control"), phase("play"), row(1)], "running"),
        ([phase("control"), phase("play"), row(1), {"kind": "failed", "cause": "program_stopped", "text": "stopped"}], "paused"),
        ([phase("play"), row(1), {"kind": "failed", "cause": "late", "found": "program_stopped", "text": "late, then stopped"}], "paused"),
        ([phase("control"), phase("play"), row(1), {"kind": "failed", "cause": "speed_scaling", "text": "0 %", "ours": False}], None),
    ],
)
def test_the_robot_is_told_what_is_known_of_our_program(frames, state):
    """Before control nothing is ours; a row says when it was; after a stop by somebody else only a paused program can be ours.

    Where another program may play in the place of ours nothing is known: the watchdog ends ours.
    """
    driver = ScriptedDriver(ScriptedSession(WAITING, frames, exit_code=-9))
    with pytest.raises(ReplayAborted):
        replay(short(), UR5, SETTINGS, driver=driver)
    assert driver.ours.state == (state or "running")
    if state is None:
        assert driver.ours.at_s is None
    if state == "running":
        assert driver.ours.at_s == pytest.approx(20.008)  # the row's own time, not that of its reading


def test_the_motion_is_entered_before_the_session_is_told_to_go():
    """What `begin` raises ends the replay, and nothing has moved. Who answers is told before anything is refused for it."""
    session, met = ScriptedSession(WAITING, [DONE]), []
    driver = ScriptedDriver(session)

    def begin(identity):
        assert session.sent == []
        raise StoreUnavailable("no space is left")

    with pytest.raises(StoreUnavailable):
        replay(short(), UR5, SETTINGS, driver=driver, caller=Caller(begin=begin, met=met.append))
    assert session.sent == []
    assert session.ended
    assert [identity.serial for identity in met] == ["7"]
    assert driver.programs_stopped == 0
    other = ScriptedDriver(ScriptedSession(WAITING, [DONE]))
    with pytest.raises(MotionRefused, match=r"serial: .* is 7, expected 6, the arm that was moved before"):
        replay(short(), UR5, SETTINGS, driver=other, last=LastMotion(expected_serial="6"), caller=Caller(met=met.append))
    assert [identity.serial for identity in met] == ["7", "7"]


def test_a_refusal_in_the_middle_of_a_motion_is_no_refusal():
    """The arm has moved: our program is stopped, and a person must look."""
    refused = {"kind": "refused", "text": "a value is wrong"}
    driver = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1), refused]))
    with pytest.raises(ReplayAborted, match="a value is wrong") as aborted:
        replay(short(), UR5, SETTINGS, driver=driver)
    assert aborted.value.cause == "internal"
    assert driver.programs_stopped == 1


class MovingSession(ScriptedSession):
    """Moves until it is told to stop; then it comes to rest, and ends its program."""

    def __init__(self):
        super().__init__(WAITING, [phase("control"), phase("play")])
        self.tick = 0

    def frames(self, timeout_s):
        if "stop" in self.sent:
            yield from self.say({"kind": "stopped", "cause": "parent_asked_to_stop", "text": "stopped on request; the arm stands"})
            return
        if not self.before and not self.after and "go" in self.sent:
            time.sleep(0.008)
            self.tick += 1
            yield row(self.tick)
            return
        yield from super().frames(timeout_s)


def test_local_control_taken_while_the_arm_moves_stops_it_within_a_second():
    """The controller is asked again and again; a dashboard that does not answer any more counts as a loss after two seconds."""
    for lost, within_s in ((lambda: False, 0.5), (lambda: (_ for _ in ()).throw(RobotUnreachable("gone")), 2.7)):
        driver = ScriptedDriver(MovingSession())
        answers = [lambda: True, lambda: True, lost]

        @contextmanager
        def conversation(host, answers=answers):
            yield lambda: answers.pop(0)() if len(answers) > 1 else answers[0]()

        driver.remote_control = conversation
        began = time.monotonic()
        with pytest.raises(ReplayAborted) as aborted:
            replay(short(), UR5, SETTINGS, driver=driver)
        assert aborted.value.cause == "local_control"
        assert time.monotonic() - began < within_s + 0.5  # a busy machine
        assert driver.session.sent == ["go", "stop"]
        assert driver.programs_stopped == 0


def test_motion_that_is_forbidden_while_the_arm_moves_stops_it():
    """As by a reload with `allow_motion = false`; before the arm moves it never begins."""
    answers = iter([None] * 20)
    driver = ScriptedDriver(MovingSession())
    with pytest.raises(ReplayAborted, match="allow_motion is false now") as aborted:
        replay(
            short(), UR5, SETTINGS, driver=driver, caller=Caller(forbidden=lambda: next(answers, reason_of("allow_motion is false now")))
        )
    assert aborted.value.cause == "motion_forbidden"
    assert driver.session.sent == ["go", "stop"]
    driver = ScriptedDriver(ScriptedSession(WAITING, [DONE]))
    with pytest.raises(ReplayAborted, match="before the arm moved") as aborted:
        replay(short(), UR5, SETTINGS, driver=driver, caller=Caller(forbidden=lambda: reason_of("allow_motion is false now")))
    assert not aborted.value.moved
    assert driver.session.sent == []


@pytest.mark.parametrize(
    ("later", "text"), [(Permit(False, reason_of("the door is open")), "the door is open"), (None, "nobody has answered")]
)
def test_a_permit_is_asked_again_while_the_arm_moves(later, text, monkeypatch):
    """Its withdrawal stops the arm, and so does silence."""
    monkeypatch.setattr(oversight, "PERMIT_EVERY_S", 0.05)
    monkeypatch.setattr(oversight, "PERMIT_SILENCE_S", 0.09)
    asked = []

    def ask(about, timeout_s):
        asked.append(about)
        return later if len(asked) > 3 else Permit(True, reason_of("yes"))

    driver = ScriptedDriver(MovingSession())
    with pytest.raises(ReplayAborted, match=text) as aborted:
        replay(short(), UR5, replace(SETTINGS, permit="zenoh"), driver=driver, caller=Caller(ask=ask))
    assert aborted.value.cause == "permit_withdrawn"
    assert [about.get("moving", False) for about in asked[:3]] == [False, True, True]


def test_the_session_gets_what_its_torque_band_is_made_of():
    """What was learnt goes with the task: the process that moves the arm needs no history."""
    basis = BandBasis(payload_kg=1.0)
    driver = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1), row(2), DONE]))
    replay(short(), UR5, SETTINGS, driver=driver, basis=basis)
    assert driver.task.basis is basis


def test_check_listen_and_record_use_the_driver_too():
    """Conditions of its state, live states of its rows, a recording of them."""
    found = {each.name: each for each in check(SETTINGS, short(), UR5, Context(), driver=ScriptedDriver(None))}
    assert all(each.holds for each in found.values())
    unknown = check(replace(SETTINGS, host="127.0.0.2"), short(), UR5, Context(), driver=ScriptedDriver(None))
    assert not {each.name: each for each in unknown}["remote_control"].holds

    listener = Listener(ListenSettings(host=SETTINGS.host), ScriptedDriver(ScriptedSession([row(1), row(2)], [DONE])))
    listener.start()
    assert [state.t_s for state in listener.poll()] == [10.008, 10.016]
    assert listener.reachable
    listener.stop()

    scripted = ScriptedDriver(ScriptedSession([row(1), row(3)], [DONE]))
    recording = record(SETTINGS.host, rate_hz=125.0, context=Context(), seconds=0.016, driver=scripted)
    assert recording.quality["missed_ticks"] == 1
    assert math.isclose(recording.duration_s, 0.016)
    assert scripted.session.ended
