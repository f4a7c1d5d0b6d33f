"""What ends the stream of targets: the controller's state, the arm's position, late targets. Values only, no connection."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState
from monitor.acquire.ur.failures import CycleGaps, StreamFailure, state_failure

SETTINGS = ReplaySettings(host="127.0.0.1")
SOUND = ArmState(
    robot_mode=7,
    safety_mode=1,
    safety_bits=1,
    runtime_state=2,
    q=np.zeros(6),
    qd=np.zeros(6),
    target_q=np.zeros(6),
    target_qd=np.zeros(6),
    temperature_c=np.full(6, 30.0),
)


def test_an_arm_in_order_may_go_on():
    """Without this, a check that always fails would pass the tests below."""
    assert state_failure(SOUND, SETTINGS) is None


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"safety_mode": 3, "safety_bits": 0x404, "runtime_state": 4}, "protective_stop"),  # and not only "program paused"
        ({"safety_mode": 3, "safety_bits": 0x404}, "protective_stop"),  # program still playing
        ({"safety_mode": 7, "safety_bits": 0x4C0, "robot_mode": 3, "runtime_state": 1}, "emergency_stop"),
        ({"safety_mode": 5, "safety_bits": 0x410}, "safeguard_stop"),
        ({"safety_mode": 2, "safety_bits": 0x2}, "safety"),  # reduced mode: other limits than the ones checked
        ({"robot_mode": 5}, "robot_mode"),
        ({"runtime_state": 1}, "program_stopped"),
        ({"runtime_state": 4}, "program_stopped"),
        ({"q": np.array([0, 0, np.nan, 0, 0, 0])}, "bad_data"),
        ({"temperature_c": np.array([30, 30, 30, 30, 30, 76.0])}, "joint_temperature"),
        ({"speed_scaling": 0.6}, "speed_scaling"),
        ({"speed_scaling": 1.0, "speed_fraction": 0.6}, "speed_scaling"),
        ({"status_bits": 0b111}, "teach_button"),
        ({"status_bits": 0b101, "robot_mode": 6, "runtime_state": 1}, "teach_button"),  # an arm in freedrive
        ({"joint_modes": (253.0, 253.0, 255.0, 253.0, 253.0, 253.0)}, "robot_mode"),
        ({"temperature_c": np.full(6, np.nan)}, "joint_temperature"),
    ],
)
def test_each_state_that_ends_the_stream_has_its_cause(changes, cause):
    """Where several causes hold, the most telling one is named."""
    failure = state_failure(replace(SOUND, **changes), SETTINGS)
    assert failure is not None
    assert failure.cause == cause


@pytest.mark.parametrize(
    ("temperatures_c", "text"),
    [
        ([30, 80, 30, 112.5, 30, 30], "Wrist 1 (joint 4) is at 112.5 °C; allowed are 0 to 75 °C"),
        ([30, 80, 30, -20.0, 30, 30], "Wrist 1 (joint 4) is at -20.0 °C; allowed are 0 to 75 °C"),
        ([30, 80, np.nan, 30, 30, np.nan], "Elbow (joint 3) tells no temperature; allowed are 0 to 75 °C"),
    ],
)
def test_a_stop_for_temperature_names_the_joint_that_is_farthest_off_or_tells_none(temperatures_c, text):
    """By number and name, as the history keeps it."""
    failure = state_failure(replace(SOUND, temperature_c=np.array(temperatures_c, dtype=float)), SETTINGS)
    assert (failure.cause, failure.reason.text) == ("joint_temperature", text)


def test_a_program_that_begins_in_the_place_of_ours_is_not_taken_for_ours():
    """Every program begins with a limiter of 0 and a full slider; a slider that somebody moves says nothing of the kind."""
    failure = state_failure(replace(SOUND, speed_scaling=0.0, speed_fraction=1.0), SETTINGS)
    assert (failure.cause, failure.ours) == ("speed_scaling", False)
    failure = state_failure(replace(SOUND, speed_scaling=0.5, speed_fraction=0.5), SETTINGS)
    assert (failure.cause, failure.ours) == ("speed_scaling", True)


def test_a_program_that_has_just_started_may_stand_at_zero_speed_and_later_may_not():
    """Real arms report a limiter of 0 for 4–20 ms after a program's start; the slider counts from the beginning."""
    starting = replace(SOUND, speed_scaling=0.0, speed_fraction=1.0)
    assert state_failure(starting, SETTINGS, up_to_speed=False) is None
    for late in (state_failure(starting, SETTINGS), state_failure(replace(starting, speed_fraction=0.5), SETTINGS, up_to_speed=False)):
        assert late is not None
        assert late.cause == "speed_scaling"


@pytest.mark.parametrize(
    ("cause", "gap_s", "ago_s", "named"),
    [
        ("bad_target", 0.008, 0.0, "bad_target"),  # every cycle was in time
        ("bad_target", 0.06, 0.1, "late"),
        ("bad_target", 0.06, 2.0, "bad_target"),  # long ago
        ("following_error", 0.06, 0.1, "following_error"),  # the arm left the controller's own target: late targets do not cause that
        ("program_stopped", 0.03, 0.1, "program_stopped"),  # too short to wake the watchdog: somebody else stopped it
        ("program_stopped", 0.11, 0.1, "late"),
        ("protective_stop", 0.3, 0.0, "protective_stop"),  # what the controller reports itself keeps its cause
        ("connection_lost", 0.3, 0.0, "connection_lost"),
    ],
)
def test_a_failure_that_late_targets_can_cause_is_named_late_and_no_other_is(cause, gap_s, ago_s, named):
    """The operator reads the cause on which to act."""
    gaps, now_s = CycleGaps(), 1000.0
    gaps.add(now_s - ago_s, gap_s)
    failure = gaps.explain(StreamFailure(cause, "…"), now_s, tick_s=0.008, watchdog_s=1.0 / SETTINGS.watchdog_hz)
    assert failure.cause == named
    assert named == cause or cause in str(failure)


def test_real_time_priority_is_taken_where_it_is_permitted_and_reported_where_not():
    """Tried in a process of its own: it has the priority, or the function returns False. Its threads inherit the priority."""
    code = "import os, threading\nfrom monitor.acquire.child import request_real_time\n" + (
        "got = request_real_time()\nhas = []\nt = threading.Thread(target=lambda: has.append(os.sched_getscheduler(0) == os.SCHED_FIFO))\n"
        "t.start(); t.join()\nprint(got, has[0])"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert printed in (["True", "True"], ["False", "False"])
