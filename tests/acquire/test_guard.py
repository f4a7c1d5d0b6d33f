"""What the guards refuse, and in which words."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import short

from monitor.acquire import guard
from monitor.acquire.guard import ArmState, ReplaySettings
from monitor.errors import BadInput, MotionRefused
from monitor.model.robot import load_robot

SIMULATED = ReplaySettings(host="127.0.0.1", allow_motion=True)


def test_a_sound_excitation_may_be_played_on_a_simulated_arm():
    """The other tests would prove nothing if everything were refused."""
    guard.permission(SIMULATED, short(), load_robot("ur5"))


def test_motion_is_off_unless_somebody_turned_it_on():
    """The default of allow_motion refuses."""
    with pytest.raises(MotionRefused, match="allow_motion is false"):
        guard.permission(ReplaySettings(host="127.0.0.1"), short(), load_robot("ur5"))


@pytest.mark.parametrize("truthy", ["yes", 1, "false"])
def test_only_true_itself_allows_motion(truthy):
    """A word or number that happens to be truthy, "false" above all, does not move an arm."""
    with pytest.raises(MotionRefused, match="allow_motion"):
        guard.permitted(ReplaySettings(host="127.0.0.1", allow_motion=truthy))


@pytest.mark.parametrize(
    "host", ["192.168.0.10", "localhost", "ur5.local", "0.0.0.0", "10.127.0.1", "127.0.0.1.example.org", "::1", "127.1", ""]
)
def test_only_a_loopback_literal_may_be_moved(host):
    """Names may resolve to anything, so even localhost is refused."""
    with pytest.raises(MotionRefused, match="simulated arm"):
        guard.permitted(replace(SIMULATED, host=host))


def test_an_excitation_of_another_robot_is_refused_by_name():
    """Both names are said."""
    with pytest.raises(MotionRefused, match=r"'ur3'.*'ur5'"):
        guard.permission(SIMULATED, short(robot="ur3"), load_robot("ur5"))


@pytest.mark.parametrize(
    ("excitation", "words"),
    [
        (short(amplitude_rad=7.0, joint=3, period_s=60.0), r"joint 4: position 7 rad, at most 6\.283"),
        (short(amplitude_rad=1.5, joint=1, period_s=4.0), r"joint 2: speed 3\.\d+ rad/s, at most 3\.142"),
        (short(period_s=0.7), r"joint 1: acceleration \d+\.\d+ rad/s², at most 17\.28"),
        (short(start_speed_rad_s=0.2, joint=4), r"joint 5: speed at the start 0\.2\d* rad/s"),
        (short(start_acceleration_rad_s2=0.5, joint=2), r"joint 3: acceleration at the start 0\.5\d* rad/s²"),
    ],
)
def test_a_curve_beyond_a_limit_is_refused_with_joint_value_and_limit(excitation, words):
    """Position, speed, acceleration, and rest at the ends."""
    with pytest.raises(MotionRefused, match=words):
        guard.permission(SIMULATED, excitation, load_robot("ur5"))


def test_settings_that_would_weaken_the_watchdog_are_refused():
    """Slower than 10 Hz a killed client leaves the arm moving for too long."""
    with pytest.raises(BadInput, match=r"watchdog_hz = 2.*10 to 60"):
        ReplaySettings(host="127.0.0.1", watchdog_hz=2.0)


def well(**changes) -> ArmState:
    """An arm at rest at the start of `short()`."""
    start = short().at(np.zeros(1)).q[0]
    state = ArmState(
        robot_mode=7,
        safety_mode=1,
        safety_bits=1,
        runtime_state=1,
        q=start,
        qd=np.zeros(6),
        target_q=start,
        target_qd=np.zeros(6),
        temperature_c=np.full(6, 25.0),
    )
    return replace(state, **changes)


def nudged(joint, by):
    """(6,) the start of `short()`, one joint elsewhere."""
    q = short().at(np.zeros(1)).q[0].copy()
    q[joint] += by
    return q


def test_an_arm_that_is_well_and_at_rest_may_begin():
    """Again: not everything is refused."""
    guard.ready(well(), SIMULATED, well().q)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"safety_mode": 3, "safety_bits": 0x404}, "protective stop"),
        ({"safety_mode": 2, "safety_bits": 0b10}, "reduced"),
        ({"safety_bits": 0b101}, "bits 0x5"),
        ({"robot_mode": 5}, r"5 \(idle\)"),
        ({"runtime_state": 2}, "a program is playing"),
        ({"runtime_state": 4}, "a program is paused"),
        ({"qd": np.array([0, 0, 0.1, 0, 0, 0])}, "joint 3 at 0.100 rad/s"),
        ({"q": nudged(1, np.nan)}, "not finite"),
        ({"q": nudged(1, 0.2)}, "joint 2 is 0.200 rad from the controller's own target"),
        ({"q": nudged(5, 2.6), "target_q": nudged(5, 2.6)}, "joint 6 is 2.60 rad from the start"),
        ({"temperature_c": np.array([25, 25, 25, 90, 25, 25.0])}, "joint 4 is at 90.0 °C"),
    ],
)
def test_an_arm_that_is_not_ready_is_left_alone_and_the_reason_said(changes, words):
    """One doubt at a time."""
    with pytest.raises(MotionRefused, match=words):
        guard.ready(well(**changes), SIMULATED, short().at(np.zeros(1)).q[0])
