"""What stands against a motion before it begins: every such fault of the simulator refuses it by its condition, and nothing starts."""

from contextlib import closing
from typing import Any

import pytest
from excitations import short
from fault_cases import ATTEMPTS, DISTURBED, restore
from simulated_arm import simulated_arm

from monitor.acquire.driver import usual_driver
from monitor.acquire.replay import replay
from monitor.acquire.settings import Installation, ReplaySettings
from monitor.errors import MotionRefused, ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

UR5 = load_robot("ur5")
PAYLOAD_KG, PAYLOAD_COG_M = 1.0, (0.0, 0.0, 0.05)  # the simulator's own centre of a payload
BEFORE: tuple[tuple[str, str, dict[str, Any]], ...] = (  # the condition, and the fault that is there before the motion
    ("teach_button", "teach_button", {}),
    ("speed_scaling", "speed_slider", {"fraction": 0.5}),
    ("payload", "payload_changed", {"kg": 2.0, "z": 0.05}),
    ("payload_cog", "payload_changed", {"kg": 1.0, "x": 0.1, "z": 0.05}),
    ("tcp_offset", "tcp_changed", {"z": 0.1}),
    ("safety_mode", "reduced", {}),
    ("joints_running", "brake", {"joint": 3}),
    ("remote_control", "remote", {"state": "off"}),
    ("no_other_program", "foreign_program", {"seconds": 60.0, "moves": "off"}),
    ("software", "version", {"version": "3.3.4"}),
    ("safety_mode", "safeguard_stop", {}),
    ("safety_mode", "emergency_stop", {}),
    ("safety_mode", "protective_stop", {}),  # the last one: its unlock would be waited for five seconds
)


def try_to_move(host: str) -> None:
    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0)
    installation = Installation(tcp_offset=(0.0,) * 6, payload_cog_m=PAYLOAD_COG_M)
    with closing(usual_driver().witness(host)) as witness:
        replay(short(), UR5, settings, context=Context(payload_kg=PAYLOAD_KG), installation=installation, witness=witness)


def test_what_stands_against_a_motion_refuses_it_by_its_condition_and_nothing_starts():
    """One after the other on an arm as recorded. No program of ours is started, nobody's program is stopped, and the arm stands."""
    with simulated_arm("127.0.2.64", "--personality", "recorded", "--payload", str(PAYLOAD_KG)) as host:
        for condition, fault, arguments in BEFORE:
            restore(host)
            with Remote(host) as remote:
                remote.fault(fault, **arguments)
                with pytest.raises(MotionRefused, match=f"{condition}:"):
                    try_to_move(host)
                truth = remote.truth()
            assert not [run for run in truth["programs"] if run["owner"] == "client"], fault
            assert not [motion for motion in truth["motions"] if motion["fastest_rad_s"] > 0.05], fault
            assert {run["stopped_by"] for run in truth["programs"]} <= {"", "itself", "somebody else", "safety"}, fault


def test_a_program_that_only_waits_while_ours_is_on_its_way_is_noticed_by_its_name_and_nothing_moves():
    """Theirs plays for one tick and for 0.2 s before the controller starts our script, which replaces it without a pause.

    No row of RTDE shows that, and the replay followed. Ours ends by itself, and a person hears which program must be started again.
    """
    with simulated_arm("127.0.2.63", "--personality", "recorded", "--payload", str(PAYLOAD_KG)) as host, Remote(host) as remote:
        for delay_s in (0.0, 0.2):
            aborted = ended_by_a_program_during_the_upload(host, remote, delay_s)
            assert aborted.cause == "program_replaced", str(aborted)
            assert "start 'cell' again" in str(aborted)
            assert aborted.needs_a_person
            assert aborted.at_rest
            truth = remote.truth()
            assert [(run["owner"], run["stopped_by"]) for run in truth["programs"]][-2:] == [
                ("somebody else", "client"),
                ("client", "itself"),
            ]
            assert truth["program"] is None
            assert not truth["motions"]


def ended_by_a_program_during_the_upload(host: str, remote: Remote, delay_s: float) -> ReplayAborted:
    """How a replay ends beside such a program; it is tried again where other work of the machine ended it."""
    for _ in range(ATTEMPTS):
        restore(host)
        remote.fault("foreign_program", when="during_upload", delay=delay_s, moves="off")
        with pytest.raises((ReplayAborted, RobotUnreachable)) as ended:
            try_to_move(host)
        if isinstance(ended.value, ReplayAborted) and ended.value.cause not in DISTURBED:
            return ended.value
    raise AssertionError(f"the machine was too busy: {ended.value}")


def test_a_watchdog_that_only_says_yes_is_found_out_at_standstill():
    """It is acknowledged and never acts: the arm does not move."""
    with simulated_arm("127.0.2.62", "--personality", "recorded", "--payload", str(PAYLOAD_KG)) as host, Remote(host) as remote:
        remote.fault("watchdog_dead")
        with pytest.raises(ReplayAborted) as aborted:
            try_to_move(host)
        assert aborted.value.cause == "no_watchdog"
        assert not remote.truth()["motions"]


def test_our_program_that_takes_no_command_is_stopped_and_the_call_that_blocked_is_named():
    """ur-rtde waits for its program until its process is ended. That was told as a lack of processor time, and the program played on."""
    with simulated_arm("127.0.2.67", "--personality", "recorded", "--payload", str(PAYLOAD_KG)) as host, Remote(host) as remote:
        remote.fault("never_ready")
        with pytest.raises(ReplayAborted, match="setWatchdog had not returned") as aborted:
            try_to_move(host)
        assert aborted.value.cause == "no_control"
        assert not aborted.value.needs_a_person, str(aborted.value)
        truth = remote.truth()
        assert truth["program"] is None
        assert not truth["motions"]
