"""From the upload to the first target, and the gaps that end a motion: the streaming process on scripted rows, without ur-rtde."""

import math

import pytest
from excitations import short
from test_driver import row

from monitor.acquire.driver import ReplayTask
from monitor.acquire.rows import COLUMN
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur import stream
from monitor.acquire.ur.streaming import arm as arm_module
from monitor.acquire.ur.streaming import control as control_module
from monitor.acquire.ur.streaming.arm import SPEED_RISE_S, START_S, Arm
from monitor.acquire.ur.streaming.failures import StreamFailure
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
        self.connected, self.answers_after_s = True, 0.016

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

    def alive(self):
        self.signs += 1

    def __getattr__(self, name):
        return lambda *_, **__: None


class Wide:
    """A torque band that ends the motion with its third row where `blocked`; it remembers the phases."""

    def __init__(self, *, blocked=False):
        self.blocked, self.phases = blocked, []

    def outside(self, row, phase_s):
        self.phases.append(phase_s)
        return ("torque_band", "joint 2 needs 99 N·m") if self.blocked and len(self.phases) == 3 else None


@pytest.fixture
def scripted(monkeypatch):
    """A function: rows, as (host's time, row) or as rows in every tick → an arm whose control connection is `FakeControl`."""

    def make(rows):
        clock = Clock()
        if not isinstance(rows[0], tuple):
            rows = [(1000.0 + TICK_S * n, made) for n, made in enumerate(rows)]
        receiver = ScriptedReceiver(clock, rows)
        monkeypatch.setattr(arm_module, "time", clock)
        monkeypatch.setattr(arm_module, "connect_receiver", lambda *_: (receiver, ()))
        monkeypatch.setattr(arm_module, "read_row", lambda *_: (receiver.present.copy(), 0))
        task = ReplayTask(settings=SETTINGS, excitation=short(), robot=load_robot("ur5"), context=Context())
        arm = Arm(task, Silent(), Silent())
        arm.control = FakeControl(receiver)
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


# --- the upload --------------------------------------------------------------------------------------------------


def test_the_program_is_sent_over_nothing_that_runs_and_awaited_on_both_connections(scripted):
    arm = scripted(rows((STOPPED, 10), (PLAYING, 40)))
    arm.start_program()
    assert arm.control.asked == ["upload"]
    assert arm.control.program_runs()


@pytest.mark.parametrize("ticks", [1, 2, 8, 13])
@pytest.mark.parametrize("pause", [STOPPING, STOPPED])
def test_a_program_that_ours_replaced_is_noticed_and_nothing_is_stopped(scripted, ticks, pause):
    """Somebody's program began after our last look and played for up to 0.1 s before ours replaced it; the replay went on over it."""
    arm = scripted(rows((STOPPED, 6), (PLAYING, ticks), (pause, 1), (PLAYING, 60)))
    with pytest.raises(StreamFailure) as failure:
        arm.start_program()
    assert (failure.value.cause, failure.value.ours) == ("no_control", False)


def test_a_program_that_moves_the_arm_before_our_first_target_is_not_ours(scripted):
    made = rows((STOPPED, 6), (PLAYING, 60))
    for each in made[9:12]:
        each[COLUMN["target_qd"]] = 0.2
    with pytest.raises(StreamFailure) as failure:
        scripted(made).start_program()
    assert (failure.value.cause, failure.value.ours) == ("no_control", False)


@pytest.mark.parametrize("state", [PLAYING, PAUSED, STOPPING])
def test_nothing_is_sent_while_somebody_elses_program_is_there(scripted, state):
    """It began after the conditions were checked; before, ur-rtde stopped it. The parent hears that no program of ours runs."""
    arm = scripted(rows((STOPPED, 1), (state, 10)))
    assert cause_of(arm.start_program) == "no_control"
    assert arm.control.asked == []
    assert not arm.program_sent


def test_nothing_is_sent_while_only_the_control_connection_shows_a_program(scripted):
    """ur-rtde judges by that connection whether to stop a program."""
    arm = scripted(rows((STOPPED, 10)))
    arm.control.runs = True
    assert cause_of(arm.start_program) == "no_control"
    assert arm.control.asked == []


def test_a_program_that_does_not_start_is_given_up(scripted):
    arm = scripted(rows((STOPPED, int((START_S + 1.0) / TICK_S))))
    assert cause_of(arm.start_program) == "no_control"


def test_a_safety_stop_before_the_program_starts_is_named(scripted):
    made = rows((STOPPED, 20))
    for each in made[8:]:
        each[COLUMN["safety_mode"]] = 3
    assert cause_of(scripted(made).start_program) == "protective_stop"


def test_the_parent_hears_from_the_process_while_it_takes_control(scripted):
    """What runs just after a sign of life is ours to stop, and nothing else is."""
    arm = scripted(rows((STOPPED, 10), (PLAYING, 38), (STOPPED, 10)))
    arm.start_program()
    assert arm.program_sent
    signs = arm.outbox.signs
    arm.prove_watchdog()
    assert not arm.program_sent  # it was seen to end; what runs now is somebody else's
    assert signs >= 3
    assert arm.outbox.signs - signs >= 3


# --- the watchdog ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spans", "cause"),
    [
        ([(PLAYING, 16), (STOPPED, 10)], None),
        ([(PLAYING, 16), (STOPPING, 3), (STOPPED, 10)], None),
        ([(PLAYING, 100)], "no_watchdog"),  # acknowledged, and not there
        ([(PLAYING, 5), (STOPPED, 10)], "program_stopped"),  # somebody else stopped it: that proves nothing
        ([(PLAYING, 14), (PAUSED, 10)], "no_watchdog"),  # a paused program may go on
    ],
)
def test_the_watchdog_must_end_a_program_without_targets_in_time(scripted, spans, cause):
    """Its acknowledgement alone was believed before. The arm stands meanwhile, and gets no target."""
    arm = scripted(rows(*spans))
    if cause is None:
        arm.prove_watchdog()
    else:
        assert cause_of(arm.prove_watchdog) == cause
    assert arm.control.asked == ["watchdog"]


def test_a_program_that_answers_late_was_not_alone(scripted):
    """Somebody else's began while ours was on its way; ours replaced it, and the arm moved for 17 s before."""
    for act in ("prove_watchdog", "begin"):
        arm = scripted(rows((PLAYING, 100)))
        arm.control.answers_after_s = 0.15
        assert cause_of(getattr(arm, act)) == "no_control"
        assert "servo" not in arm.control.asked


def test_a_watchdog_that_is_refused_is_named(scripted):
    arm = scripted(rows((PLAYING, 100)))
    arm.control.takes = False
    assert cause_of(arm.prove_watchdog) == "no_watchdog"


# --- the trajectory limiter ----------------------------------------------------------------------------------------


def limited(shares):
    made = rows((PLAYING, len(shares)), target_speed_fraction=1.0)
    for each, share in zip(made, shares, strict=True):
        each[COLUMN["speed_scaling"]] = share
    return made


def test_a_limiter_that_stands_at_zero_for_some_ticks_after_the_start_is_awaited(scripted):
    """As recorded from real arms: it aborted every approach before."""
    arm = scripted(limited([0.0, 0.0, 0.3, 1.0, 1.0]))
    arm.wait_for_full_speed()
    assert arm.receive.present[COLUMN["speed_scaling"]][0] == 1.0
    assert arm.control.asked == []


def test_a_limiter_that_stays_below_full_speed_ends_the_motion_before_it_begins(scripted):
    arm = scripted(limited([0.5] * int((SPEED_RISE_S + 1.0) / TICK_S)))
    assert cause_of(arm.wait_for_full_speed) == "speed_scaling"


def test_a_limiter_that_is_not_reported_is_not_awaited(scripted):
    made = limited([math.nan] * 5)
    for each in made:
        each[COLUMN["target_speed_fraction"]] = math.nan
    scripted(made).wait_for_full_speed()


# --- while the arm moves -----------------------------------------------------------------------------------------


def moving(scripted, made):
    arm = scripted(made)
    arm.begin()
    return arm


@pytest.mark.parametrize(("by_rad", "taken"), [(0.001, True), (0.01, False), (-0.02, False), (math.nan, False)])
def test_an_arm_that_was_moved_since_its_way_was_proved_gets_no_target(scripted, by_rad, taken):
    """The upload takes up to seconds; in that time a person may move the arm far."""
    made = rows((PLAYING, 5))
    arm = scripted(made)
    for each in made[1:]:
        each[COLUMN["target_q"]] = each[COLUMN["target_q"]] + by_rad
    if taken:
        assert arm.begin().tolist() == made[1][COLUMN["target_q"]].tolist()
    else:
        assert cause_of(arm.begin) == "no_control"


@pytest.mark.parametrize("jump_s", [5.0, 0.3, -5.0])
def test_a_jump_of_the_controllers_clock_ends_the_motion(scripted, jump_s):
    """RTDE's clock went on by 5 s while the host's went on by a tick, and the arm played on."""
    made = rows((PLAYING, 20))
    for each in made[8:]:
        each[0] += jump_s
    arm = moving(scripted, made)
    assert cause_of(lambda: [arm.next_row() for _ in range(15)]) == "controller_restarted"


def test_a_gap_between_two_rows_ends_the_motion_although_the_data_goes_on(scripted):
    """0.12 s without a row: by then the controller's watchdog has stopped the arm, and nobody would expect it to go on."""
    made = rows((PLAYING, 60))
    timed = [(1000.0 + TICK_S * n + (0.112 if n >= 10 else 0.0), each) for n, each in enumerate(made)]
    arm = moving(scripted, timed)
    assert cause_of(lambda: [arm.next_row() for _ in range(50)]) == "stalled"


def test_a_process_that_slept_too_long_sends_no_target_when_it_comes_back(scripted):
    """SIGSTOP, a suspended machine, no processor time: named as what it is."""
    arm = moving(scripted, rows((PLAYING, 100)))
    arm.next_row()
    arm_module.time.sleep(0.15)
    assert cause_of(arm.next_row) == "late"


def test_a_process_that_slept_between_row_and_target_does_not_send_it(scripted):
    arm = moving(scripted, rows((PLAYING, 100)))
    made = arm.next_row()
    arm_module.time.sleep(0.15)
    assert cause_of(lambda: arm.cycle(arm.recent[-1], made)) == "late"
    assert "servo" not in arm.control.asked


def test_a_freedrive_button_that_is_pressed_ends_the_motion(scripted):
    """Somebody stands at the arm."""
    arm = moving(scripted, rows((PLAYING, 5), robot_status_bits=3.0 + 4.0))
    assert cause_of(lambda: arm.cycle(arm.recent[-1], arm.next_row())) == "teach_button"


def test_no_target_follows_a_row_whose_torque_is_outside_the_band(scripted):
    """The band sees every row of every phase before the next target; the trajectory's phase is known to it only while it is played."""
    arm = moving(scripted, rows((PLAYING, 30), robot_status_bits=3.0))
    band = Wide(blocked=True)
    arm.guard_torque(band)
    sent = arm.control.asked.count("servo")
    arm.cycle(arm.recent[-1], arm.next_row())
    arm.cycle(arm.recent[-1], arm.next_row(), 0.008)
    assert cause_of(lambda: arm.cycle(arm.recent[-1], arm.next_row(), 0.016)) == "torque_band"
    assert band.phases == [None, 0.008, 0.016]
    assert arm.control.asked.count("servo") == sent + 2


def test_every_cycle_in_order_sends_one_target(scripted):
    """Without this, a check that always fails would pass the tests above."""
    arm = moving(scripted, rows((PLAYING, 30), robot_status_bits=3.0))
    for _ in range(20):
        arm.cycle(arm.recent[-1], arm.next_row())
    assert arm.control.asked.count("servo") == 20


@pytest.mark.parametrize("call", ["upload", "end_program", "set_watchdog", "servo", "stop_servo"])
def test_whatever_ur_rtde_raises_on_a_lost_connection_is_named_so(monkeypatch, call):
    """It was `internal` before, which asks for a person. Around each call the dead-man timer is short, and longer again after it."""
    reports = []
    monkeypatch.setattr(control_module.dead_man, "report_within", reports.append)

    class Broken:
        def __getattr__(self, name):
            def fail(*_):
                raise RuntimeError("write: Broken pipe [system:32]")

            return fail

    control = object.__new__(control_module.Control)
    control._rtde, control._pause_s = Broken(), 0.11
    arguments = {"set_watchdog": (10.0,), "servo": ([0.0] * 6, 0.008, 0.03, 500.0), "stop_servo": (5.0,)}.get(call, ())
    assert cause_of(lambda: getattr(control, call)(*arguments)) == "connection_lost"
    assert reports[0] == (control_module.TARGET_CALL_S if call == "servo" else reports[0])
    assert 0.0 < reports[0] <= control_module.ENDING_CALL_S


# --- the end -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", ["receive", "control"])
def test_a_connection_that_is_lost_while_the_program_ends_is_named_so(scripted, monkeypatch, lost):
    """Nothing says any more whether the program has ended; it was named as a program that goes on."""
    arm = scripted(rows((PLAYING, 3)))
    monkeypatch.setattr(stream, "time", arm.receive.clock)
    getattr(arm, lost).connected = False
    assert cause_of(lambda: stream.finish(arm)) == "connection_lost"


def test_a_program_that_goes_on_after_it_was_asked_to_end_is_named_and_one_that_ends_is_no_failure(scripted, monkeypatch):
    arm = scripted(rows((PLAYING, 3)))
    monkeypatch.setattr(stream, "time", arm.receive.clock)
    assert cause_of(lambda: stream.finish(arm)) == "program_stopped"
    arm = scripted(rows((PLAYING, 3), (STOPPED, 3)))
    monkeypatch.setattr(stream, "time", arm.receive.clock)
    stream.finish(arm)
    assert arm.control.asked[-2:] == ["stop_servo", "end_program"]
