"""A replay on a driver that is handed in: no process, no socket, no clock of a robot."""

import math
from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from test_guard import ready_state

from monitor.acquire.check import check
from monitor.acquire.driver import SafetyStop, SessionEnded
from monitor.acquire.listen import Listener, ListenSettings
from monitor.acquire.record import record
from monitor.acquire.replay import replay
from monitor.acquire.rows import COLUMN, WIDTH
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import Identity
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context

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
    return {"kind": "phase", "phase": name, "duration_s": 1.0}


WAITING = [phase("connect"), phase("ready"), {"kind": "state", "row": row(0).tolist()}]


class ScriptedSession:
    """Sends the frames before `go`, then those after it; then it ends with an exit code."""

    def __init__(self, before, after, exit_code=0):
        self.before, self.after, self.exit_code = list(before), list(after), exit_code
        self.sent, self.ended, self.printed = [], False, ""

    def send(self, word):
        self.sent.append(word)

    def frames(self, timeout_s):
        waiting = self.before or (self.after if "go" in self.sent else [])
        if not waiting and ("go" in self.sent or not self.after):
            raise SessionEnded("the script is at its end")
        yield from list(waiting)
        waiting.clear()

    def end(self, patience_s=0.0):
        self.ended = True
        return self.exit_code


class ScriptedDriver:
    """A robot of another make."""

    def __init__(self, session, *, identity=None, stop=None):
        self.session, self.stop = session, stop
        self._identity = identity or Identity(model="UR5", serial="7", firmware="3.15.8", remote_control=True)
        self.programs_stopped = 0

    def identity(self, host):
        if host != SETTINGS.host:
            raise RobotUnreachable(f"{host}: nobody")
        return self._identity

    def state(self, host, rate_hz, timeout_s):
        return ready_state()

    def listen(self, host, rate_hz, *, every_tick):
        return self.session

    def stream(self, task):
        self.task = task
        return self.session

    def safety_stop(self, host):
        return self.stop

    def stop_program(self, host):
        assert self.session.ended  # first the session, then the robot
        self.programs_stopped += 1
        return True


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
    for stop, cause in ((None, "child_died"), (SafetyStop("protective_stop", "it ran into a box"), "protective_stop")):
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


def test_torque_outside_its_band_ends_the_session_and_stops_the_robot():
    """The band is the parent's own reason to give the session up."""

    class Narrow:
        def outside(self, row):
            return "torque_band", "joint 2 needs 9 N·m"

    driver = ScriptedDriver(ScriptedSession(WAITING, [phase("control"), phase("play"), row(1), row(2)]))
    with pytest.raises(ReplayAborted, match="joint 2 needs") as aborted:
        replay(short(), UR5, SETTINGS, driver=driver, band=Narrow())
    assert aborted.value.cause == "torque_band"
    assert driver.programs_stopped == 1


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
