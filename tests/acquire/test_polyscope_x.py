"""Replays on a simulated PolyScope X with the unmodified ur-rtde: played, watched by its Robot API, stopped and refused."""

import time
from dataclasses import replace

import numpy as np
import pytest
from excitations import short
from simulated_arm import known_gains, simulated_arm

from monitor.acquire.replay import check, replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.driver import UniversalRobots
from monitor.acquire.watch import Caller
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

PORT = 18080
DRIVER = UniversalRobots(robot_api_port=PORT)
UR5E = load_robot("ur5e")
OPTIONS = ("--robot", "ur5e", "--robot-api-port", str(PORT))


def checked(host):
    """What `check` finds of every condition."""
    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False)
    return check(settings, short(robot="ur5e"), UR5E, Context(serial="77"), installation=known_gains("ur5e"), driver=DRIVER)


def played(host, *, after_s=None, act=None, **changes):
    """One short replay; `act` is called once, so long after the arm began to play."""
    done = []

    def on_progress(progress):
        if act is not None and not done and progress.phase == "play" and progress.elapsed_s >= after_s:
            done.append(time.monotonic())
            act()

    settings = replace(ReplaySettings(host=host, allow_motion=True, allow_untested_software=True, first_pass=False), **changes)
    return replay(
        short(robot="ur5e"),
        UR5E,
        settings,
        context=Context(serial="77"),
        installation=known_gains("ur5e"),
        driver=DRIVER,
        caller=Caller(on_progress=on_progress),
    )


def stands(remote):
    return max(abs(speed) for speed in remote.truth()["qd"]) < 0.01


def test_a_replay_on_a_polyscope_x_is_played_while_its_robot_api_is_asked():
    """In local control and without an API nothing is sent; then it is played."""
    with simulated_arm("127.0.96.21", *OPTIONS, "--polyscope", "10.12.0") as host, Remote(host) as remote:
        found = {each.name: each for each in checked(host)}
        assert [name for name, each in found.items() if not each.holds] == []
        assert found["remote_control"].text == "on, in automatic mode"
        assert "software by RTDE, model by the primary port" in found["robot_model"].text
        assert not found["serial"].checked  # 10.12 does not tell it, and `check` says who is believed
        remote.fault("manual_mode")
        with pytest.raises(MotionRefused, match=r"remote_control: .*manual mode"):
            played(host)
        remote.fault("clear")
        for answer, words in (("forbidden", "403"), ("garbage", "JSON"), ("elsewhere", "elsewhere"), ("unauthorized", "401")):
            remote.fault("robot_api", answer=answer)
            with pytest.raises(RobotUnreachable, match=words):
                played(host)
        remote.fault("clear")
        assert remote.truth()["scripts_started"] == 0
        recording = played(host)
        assert recording.context.firmware == "10.12.0.0"
        assert recording.context.serial == "77"  # the configured one: the API does not tell it
        assert recording.quality["duplicated_ticks"] == 0
        assert np.max(np.abs(recording.qd)) > 0.2
        assert stands(remote)


@pytest.mark.soak
@pytest.mark.parametrize("answer", ["silent", "unauthorized", "forbidden", "failing", "garbage", "elsewhere", "gone"])
def test_a_robot_api_that_fails_in_the_middle_ends_the_motion_and_the_arm_comes_to_rest(answer):
    """Whether remote control is on is not known any more: within 2 s and the time of the ramp the arm stands, along its path."""
    with simulated_arm("127.0.96.22", *OPTIONS, "--polyscope", "10.12.0") as host, Remote(host) as remote:

        def act():
            if answer == "gone":
                remote.fault("listener_gone", service="robot_api")
                remote.fault("reset", service="robot_api")
            else:
                remote.fault("robot_api", answer=answer)

        with pytest.raises(ReplayAborted) as ended:
            played(host, after_s=0.2, act=act)
        assert ended.value.cause == "local_control"
        assert ended.value.at_rest
        assert stands(remote)


@pytest.mark.soak
@pytest.mark.parametrize("version", ["10.11.0", "10.12.0"])
@pytest.mark.parametrize(
    ("fault", "arguments", "causes"),
    [
        ("protective_stop", {}, {"protective_stop"}),
        ("program_stop", {}, {"program_stopped"}),
        ("reset", {"service": "rtde"}, {"connection_lost", "child_died", "timeout"}),
        ("restart", {"seconds": 4.0}, {"connection_lost", "child_died", "timeout"}),
        ("remote", {"state": "off"}, {"local_control"}),
        ("manual_mode", {}, {"local_control"}),
    ],
)
def test_a_stop_or_a_lost_connection_ends_the_motion_by_its_cause(version, fault, arguments, causes):
    """ur-rtde's dashboard client, which does not exist there, is never needed: a child that dies is told, and the arm stands."""
    if version == "10.11.0" and fault in {"remote", "manual_mode"}:
        pytest.skip("10.11 does not tell it")
    with simulated_arm("127.0.96.23", *OPTIONS, "--polyscope", version) as host, Remote(host) as remote:
        with pytest.raises(ReplayAborted) as ended:
            played(host, after_s=1.4, act=lambda: remote.fault(fault, **arguments))
        assert ended.value.cause in causes
        time.sleep(0.5)
        if fault != "restart":
            assert stands(remote)


@pytest.mark.soak
def test_somebody_elses_program_that_starts_during_the_upload_costs_the_child_and_nothing_moves():
    """ur-rtde would stop it by a dashboard client that is not there; ours ends by itself, or the child by its signal."""
    with simulated_arm("127.0.96.24", *OPTIONS, "--polyscope", "10.12.0") as host, Remote(host) as remote:
        remote.fault("foreign_program", when="during_upload", delay=0.2, moves="off")
        with pytest.raises(ReplayAborted) as ended:
            played(host)
        assert ended.value.cause in {"program_replaced", "no_control", "child_died", "stalled"}
        assert not [motion for motion in remote.truth()["motions"] if motion["fastest_rad_s"] > 0.05]
