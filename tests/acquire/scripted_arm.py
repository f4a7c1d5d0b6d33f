"""An arm of the streaming process on scripted rows: ur-rtde's connections and the host's clock are made up, all else is the program's."""

import pytest
from excitations import short
from test_driver import row

from monitor.acquire.driver import ReplayTask
from monitor.acquire.protocol import Order, Phase, Program, State
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur import arm as arm_module
from monitor.acquire.ur import upload as upload_module
from monitor.acquire.ur.arm import Arm
from monitor.acquire.ur.failures import StreamFailure
from monitor.acquire.ur.rtde import COLUMN
from monitor.acquire.ur.upload import Upload
from monitor.model.robot import load_robot
from monitor.recording import Context

STOPPED, PLAYING, PAUSED, STOPPING = 1, 2, 4, 0
SETTINGS = ReplaySettings(host="127.0.0.1", allow_motion=True)
TICK_S = 0.008


class Clock:
    """The host's clock; only `sleep` lets time pass."""

    def __init__(self):
        self.now_s = 1000.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


class ScriptedReceiver:
    """A receiving connection that shows the rows one after the other, each at its time of the host's clock."""

    def __init__(self, clock, rows):
        self.clock, self.rows, self.connected = clock, rows, True

    def isConnected(self):
        return self.connected

    @property
    def present(self):
        return next(made for at_s, made in reversed(self.rows) if at_s <= self.clock.now_s)

    def getTimestamp(self):
        return float(self.present[0])

    def getRuntimeState(self):
        return int(self.present[COLUMN["runtime_state"]][0])


class FakeControl:
    """A control connection that takes everything; it notes what it was asked for."""

    def __init__(self, receiver):
        self.receiver, self.asked, self.runs, self.takes = receiver, [], None, True
        self.connected, self.can_upload, self.answers_after_s = True, True, 0.016

    def program_runs(self):
        runtime = int(self.receiver.present[COLUMN["runtime_state"]][0])
        return runtime == PLAYING if self.runs is None else self.runs

    def report(self):
        pass

    def report_every(self, pause_s):
        self.asked.append("report_every")

    def upload(self):
        self.asked.append("upload")
        return True

    def set_watchdog(self, lowest_hz):
        self.asked.append("watchdog")
        self.receiver.clock.now_s += self.answers_after_s
        return self.takes

    def servo(self, target, tick_s, lookahead_s, gain):
        self.asked.append("servo")
        return True

    def stop_servo(self, deceleration_rad_s2):
        self.asked.append("stop_servo")
        return True

    def end_program(self):
        self.asked.append("end_program")


class Silent:
    """Parent's words and the pipe to it; it counts the signs of life."""

    signs = 0

    def word(self):
        return None

    def alive(self, row):
        self.signs += 1

    def __getattr__(self, name):
        return lambda *_, **__: None


class ScriptedMessages:
    """The primary port's messages of programs: (host's time since the beginning, name or None for the end of what runs)."""

    def __init__(self, clock, told):
        self.clock, self.told, self.open, self.running = clock, [(1000.0 + at_s, name) for at_s, name in told], True, None
        self.mistake = ""

    def started(self):
        names = []
        while self.told and self.told[0][0] <= self.clock.now_s:
            _, self.running = self.told.pop(0)
            names += [] if self.running is None else [self.running]
        return names

    def close(self):
        self.open = False


class Wide:
    """A torque band that ends the motion with its third row where `blocked`; it remembers the phases."""

    def __init__(self, *, blocked=False):
        self.blocked, self.phases = blocked, []

    def outside(self, row, phase_s):
        self.phases.append(phase_s)
        return ("torque_band", "joint 2 needs 99 N·m") if self.blocked and len(self.phases) == 3 else None


def scripted_arm(monkeypatch):
    """A function: rows, as (host's time, row) or as rows in every tick → an arm whose control connection is `FakeControl`."""

    def make(rows):
        clock = Clock()
        if not isinstance(rows[0], tuple):
            rows = [(1000.0 + TICK_S * n, made) for n, made in enumerate(rows)]
        receiver = ScriptedReceiver(clock, rows)
        monkeypatch.setattr(arm_module, "time", clock)
        monkeypatch.setattr(upload_module, "time", clock)
        monkeypatch.setattr(arm_module, "connect_receiver", lambda *_: (receiver, ()))
        monkeypatch.setattr(arm_module, "read_row", lambda *_: (receiver.present.copy(), 0))
        task = ReplayTask(settings=SETTINGS, excitation=short(), robot=load_robot("ur5"), context=Context())
        arm = Arm(task, Silent(), Silent(), Upload())
        arm.connection = FakeControl(receiver)
        arm.state = State(Phase.CONTROL, Program.OURS, Order.GO)
        arm.guard_torque(Wide())
        arm.approach_proved(rows[0][1][COLUMN["target_q"]])
        return arm

    return make


def rows(*spans, **values):
    """Rows in every tick: spans of (runtime state, ticks)."""
    states = [state for state, ticks in spans for _ in range(ticks)]
    return [row(tick, runtime_state=state, **values) for tick, state in enumerate(states)]


def cause_of(act):
    with pytest.raises(StreamFailure) as failure:
        act()
    return failure.value.cause


def told(scripted, made, *messages):
    arm = scripted(made)
    arm.taking.messages = ScriptedMessages(arm.receive.clock, messages)
    return arm
