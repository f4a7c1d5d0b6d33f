"""The gaps, people and programs that end a motion, and how it ends: the streaming process on scripted rows, without ur-rtde."""

import math
from functools import partial

import pytest
from scripted_arm import PLAYING, STOPPED, TICK_S, ScriptedMessages, Wide, cause_of, rows, scripted_arm, told
from test_driver import row

from monitor.acquire.protocol import Order, Phase, Program, State
from monitor.acquire.ur import arm as arm_module
from monitor.acquire.ur import control as control_module
from monitor.acquire.ur import stream
from monitor.acquire.ur.failures import StreamFailure
from monitor.acquire.ur.rtde import COLUMN

AT_REST = State(Phase.SETTLE, Program.OURS, Order.GO)


@pytest.fixture
def scripted(monkeypatch):
    """A function: rows → an arm whose control connection is `FakeControl`."""
    return scripted_arm(monkeypatch)


# --- while the arm moves -----------------------------------------------------------------------------------------


def play(arm, cycles):
    for _ in range(cycles):
        arm.cycle(arm.recent[-1], arm.next_row())


def moving(scripted, made):
    arm = scripted(made)
    arm.begin()
    arm.state = State(Phase.PLAY, Program.OURS, Order.GO)
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


def test_a_program_that_takes_the_place_of_ours_in_mid_motion_is_named_before_the_next_target(scripted):
    """It plays without a pause; its limiter, which stands at 0 at first, was told as the slider's."""
    made = rows((PLAYING, 30), robot_status_bits=3.0)
    arm = moving(scripted, made)
    arm.taking.messages = ScriptedMessages(arm.receive.clock, [(0.1, "welding")])
    for each in made[14:]:
        each[COLUMN["speed_scaling"]] = 0.0
    with pytest.raises(StreamFailure, match="'welding' was started in the place of ours") as failure:
        play(arm, 20)
    assert (failure.value.cause, failure.value.ours) == ("program_stopped", False)


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
    monkeypatch.setattr(control_module, "report_within", reports.append)

    class Broken:
        def __getattr__(self, name):
            def fail(*_):
                raise RuntimeError("write: Broken pipe [system:32]")

            return fail

    control = object.__new__(control_module.Control)
    control._rtde, control._pause_s, control._calling, control._program = Broken(), 0.11, lambda _: None, None
    arguments = {"set_watchdog": (10.0,), "servo": ([0.0] * 6, 0.008, 0.03, 500.0), "stop_servo": (5.0,)}.get(call, ())
    assert cause_of(lambda: getattr(control, call)(*arguments)) == "connection_lost"
    assert reports[0] == (control_module.TARGET_CALL_S if call == "servo" else reports[0])
    assert 0.0 < reports[0] <= control_module.ENDING_CALL_S


# --- a late process ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cause", ["late", "stalled"])
def test_a_pause_before_any_target_leaves_no_program_without_a_watchdog(scripted, cause):
    """It stayed on the controller, kept every program of the cell and our own next one from starting, and a person had to stop it.

    The data may be away for some tenths of a second more.
    """
    made = [(1000.0 + TICK_S * n + (0.3 if n else 0.0), each) for n, each in enumerate(rows((PLAYING, 8), (STOPPED, 60)))]
    arm = scripted(made)
    arm.program_sent = True
    arm.taking.leave_nothing_behind(arm, StreamFailure(cause, "no processor time for 84 ms"))
    assert arm.control.asked == ["end_program"]
    assert not arm.program_sent
    arm = scripted(rows((PLAYING, 400)))
    arm.program_sent = True
    arm.taking.leave_nothing_behind(arm, StreamFailure(cause, "no processor time for 84 ms"))
    assert arm.program_sent  # it goes on: that is not hidden


@pytest.mark.parametrize("lost", ["receive", "control", "data"])
def test_over_a_cut_connection_and_one_that_stays_silent_nothing_is_sent_any_more(scripted, lost):
    arm = scripted(rows((PLAYING, 5), (STOPPED, 60)) if lost != "data" else rows((PLAYING, 1)))
    arm.program_sent = True
    if lost != "data":
        getattr(arm, lost).connected = False
    assert cause_of(partial(arm.taking.leave_nothing_behind, arm, StreamFailure("stalled", "x"))) in {"connection_lost", "stalled", "late"}
    assert arm.control.asked == []
    assert arm.program_sent


def test_only_a_late_process_that_stands_ends_its_program_and_none_that_may_be_anothers(scripted):
    """Whatever else is wrong, no call of ur-rtde follows; a moving arm is stopped by its watchdog."""
    made = rows((PLAYING, 60))
    for failure, arm in (
        (StreamFailure("late", "x"), moving(scripted, made)),
        (StreamFailure("protective_stop", "x"), scripted(made)),
        (StreamFailure("late", "x", ours=False), scripted(made)),
        (StreamFailure("late", "x"), told(scripted, made)),
    ):
        arm.program_sent, arm.taking.in_doubt = True, isinstance(arm.taking.messages, ScriptedMessages)
        arm.control.asked.clear()
        arm.taking.leave_nothing_behind(arm, failure)
        assert arm.control.asked == []


# --- the end -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", ["receive", "control"])
def test_a_connection_that_is_lost_while_the_program_ends_is_named_so(scripted, monkeypatch, lost):
    """Nothing says any more whether the program has ended; it was named as a program that goes on."""
    arm = scripted(rows((PLAYING, 3)))
    getattr(arm, lost).connected = False
    arm.state = AT_REST
    assert cause_of(lambda: stream.finish(arm)) == "connection_lost"


def test_a_program_that_goes_on_after_it_was_asked_to_end_is_named_and_one_that_ends_is_no_failure(scripted, monkeypatch):
    arm = scripted(rows((PLAYING, 3)))
    arm.state = AT_REST
    assert cause_of(lambda: stream.finish(arm)) == "program_stopped"
    arm = scripted(rows((PLAYING, 3), (STOPPED, 3)))
    arm.state = AT_REST
    stream.finish(arm)
    assert arm.control.asked[-2:] == ["stop_servo", "end_program"]


@pytest.mark.parametrize("runtime", [STOPPED, PLAYING])
@pytest.mark.parametrize("which", ["receive", "control"])
def test_a_command_that_is_refused_over_a_cut_connection_was_refused_by_nobody(scripted, runtime, which):
    """At the end of a motion, where no row is awaited; the controller ends our program for the same reason, and nobody stopped it."""
    arm = scripted([row(n, runtime_state=runtime) for n in range(20)])
    getattr(arm, which).connected = False
    assert arm.refusal().cause == "connection_lost"


def test_a_command_that_is_refused_over_sound_connections_has_its_cause_from_the_rows(scripted):
    """A program that somebody stopped, and one that plays and takes nothing."""
    assert scripted([row(n, runtime_state=STOPPED) for n in range(20)]).refusal().cause == "program_stopped"
    assert scripted([row(n, runtime_state=PLAYING) for n in range(20)]).refusal().cause == "servo_refused"
