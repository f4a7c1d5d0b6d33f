"""What ends the stream, by the controller's own words and by the arm's deeds; values only, no connection."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.acquire.arm import REMEMBERED, strayed, unwell
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.state import ArmState

SETTINGS = ReplaySettings(host="127.0.0.1")
WELL = ArmState(
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


def test_an_arm_that_plays_and_is_well_goes_on():
    """Otherwise the causes below would prove nothing."""
    assert unwell(WELL, SETTINGS) is None


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"safety_mode": 3, "safety_bits": 0x404, "runtime_state": 4}, "protective_stop"),  # not merely "program paused"
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
        ({"temperature_c": np.full(6, np.nan)}, "joint_temperature"),
    ],
)
def test_each_way_of_being_unwell_has_its_cause(changes, cause):
    """The most telling one first where several hold."""
    failure = unwell(replace(WELL, **changes), SETTINGS)
    assert failure is not None
    assert failure.cause == cause


def test_lag_is_not_straying_and_standing_still_is():
    """At 2.5 rad/s an arm 50 ms behind is inside the band; one that stopped is found within a quarter of a second."""
    t = np.arange(0.0, 1.0, 0.008)
    sent = np.outer(t, [0.0, 2.5, 0.0, 0.0, 0.0, 0.0])  # (N, J)
    for i in range(REMEMBERED, len(t)):
        behind = sent[i] - 0.05 * np.array([0.0, 2.5, 0.0, 0.0, 0.0, 0.0])
        assert strayed(behind, sent[i - REMEMBERED : i], 0.05) is None
    stopped = sent[40]
    found = next(i for i in range(41, len(t)) if strayed(stopped, sent[i - REMEMBERED : i], 0.05))
    # out of the band's memory after 0.2 s, beyond 0.05 rad of its edge 0.02 s later
    assert t[found] - t[40] < 0.2 + 0.02 + 2 * 0.008


def test_the_joint_that_strayed_is_named():
    """Counted from 1, with the distance."""
    failure = strayed(np.array([0, 0, 0, 0.1, 0, 0]), np.zeros((3, 6)), 0.05)
    assert failure is not None
    assert "joint 4 is 0.100 rad" in str(failure)
