"""What else happens at a controller while an arm is taken or moved: each has its cause, nothing begins again, nobody's program is stopped.

A pause at the pendant, lines of somebody's script, data that comes late, an operator who is a moment too early. On an arm as recorded.
"""

import socket
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from excitations import short
from fault_cases import ATTEMPTS, DISTURBED, restore
from simulated_arm import simulated_arm

from monitor.acquire.replay import replay
from monitor.acquire.settings import ReplaySettings
from monitor.acquire.ur.dashboard import Dashboard
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.errors import ReplayAborted, RobotUnreachable
from monitor.model.robot import load_robot
from monitor.recording import Context
from monitor.simulate.remote import Remote

pytestmark = pytest.mark.real_time

DONE = "done"
UR5 = load_robot("ur5")
ASIDE = [0.3, -1.4, 0.3, -1.3, 0.2, -0.2]
WAITS = {"seconds": 2.0, "moves": "off"}  # somebody else's program


def dashboard(*lines: str, pause_s: float = 0.0) -> Callable[[str], None]:
    def act(host: str) -> None:
        with Dashboard(host) as asked:
            for line in lines:
                asked.ask(line)
                time.sleep(pause_s)

    return act


def script(text: str, port: int = 30002) -> Callable[[str], None]:
    def act(host: str) -> None:
        with socket.create_connection((host, port), timeout=2.0) as wire:
            wire.sendall(text.encode())
            time.sleep(0.05)

    return act


def fault(name: str, *, ends_after_s: float | None = None, **arguments: Any) -> Callable[[str], None]:
    def act(host: str) -> None:
        with Remote(host) as remote:
            remote.fault(name, **arguments)
            if ends_after_s is not None:
                time.sleep(ends_after_s)
                remote.fault("clear")

    return act


class Happening(NamedTuple):
    """Something that happens so long after a phase has begun, and how the replay may end."""

    about: str
    phase: str
    after_s: float
    act: Callable[[str], None]
    causes: tuple[str, ...]


def secondary(line: str) -> Callable[[str], None]:
    return script(f"sec other():\n  {line}\nend\n")


HAPPENINGS = (
    Happening("pause at the pendant", "play", 0.8, dashboard("pause"), ("program_stopped",)),
    Happening("pause and play at once", "play", 0.8, dashboard("pause", "play", pause_s=0.02), ("program_stopped",)),
    Happening("pause and play later", "play", 0.8, dashboard("pause", "play", pause_s=0.06), ("program_stopped",)),
    Happening("a popup that somebody closes", "play", 0.5, dashboard("popup hello", "close popup", pause_s=0.2), (DONE,)),
    Happening("play while ours plays", "play", 0.5, dashboard("play", "play"), (DONE,)),
    Happening("unlock without a stop", "play", 0.5, dashboard("unlock protective stop", "close safety popup"), (DONE,)),
    Happening("another program is loaded", "play", 0.5, dashboard("load other.urp", "get loaded program"), (DONE,)),
    Happening("power off", "play", 0.8, dashboard("power off"), ("robot_mode",)),
    Happening("a secondary program sets an output", "play", 0.5, secondary("set_digital_out(1, True)"), (DONE,)),
    Happening("a secondary program sets the payload", "play", 0.8, secondary("set_payload(2.0, [0, 0, 0.05])"), ("payload",)),
    Happening("a line of script moves the arm", "play", 0.8, script(f"movej({ASIDE},a=1,v=0.5)\n"), ("program_stopped",)),
    Happening("a line of script stops it", "play", 0.8, script("stopj(2)\n", 30003), ("program_stopped",)),
    Happening("a line of script halts", "play", 0.8, script("halt\n", 30003), ("program_stopped",)),
    Happening("no data for 50 ms", "play", 0.8, fault("stall", seconds=0.05), (DONE,)),
    Happening("no data for 200 ms", "play", 0.8, fault("stall", seconds=0.2), ("stalled",)),
    Happening("freedrive button for a tick", "play", 0.8, fault("teach_button", ends_after_s=0.01), ("teach_button",)),
    Happening("reduced mode for a tick", "play", 0.8, fault("reduced", ends_after_s=0.01), ("safety",)),
    Happening("clock half a second back", "play", 0.8, fault("clock_jump", seconds=-0.5), ("controller_restarted",)),
    Happening("clock 4 ms back", "play", 0.8, fault("clock_jump", seconds=-0.004), (DONE,)),
    Happening("slider as our program begins", "control", 0.0, fault("speed_slider", fraction=0.5), ("speed_scaling",)),
    Happening("slider as the motion begins", "approach", 0.0, fault("speed_slider", fraction=0.9), ("speed_scaling",)),
    Happening("payload as our program begins", "control", 0.0, fault("payload_changed", kg=2.0), ("payload",)),
    Happening("protective stop as our program begins", "control", 0.0, fault("protective_stop"), ("protective_stop",)),
    Happening("pause before it moves", "control", 0.05, dashboard("pause"), ("program_stopped", "no_watchdog")),
    Happening(
        "another program in the test of the watchdog",
        "control",
        0.2,
        fault("foreign_program", **WAITS),
        ("program_stopped", "no_control", "program_replaced"),
    ),
    Happening(
        "another program that waits",
        "play",
        0.5,
        fault("foreign_program", **WAITS),
        ("program_stopped",),
    ),
)


def ended_by(happening: Happening, host: str) -> tuple[str, int]:
    """The cause of one replay's end, and how many programs had begun until it happened."""
    began: list[int] = []

    def on_progress(progress: ReplayProgress) -> None:
        if progress.phase == happening.phase and progress.elapsed_s >= happening.after_s and not began:
            with Remote(host) as remote:
                began.append(len(remote.truth()["programs"]))
            happening.act(host)

    settings = ReplaySettings(host=host, allow_motion=True, first_pass=False, approach_speed_rad_s=1.0, max_approach_rad=6.0)
    try:
        replay(short(), UR5, settings, context=Context(payload_kg=0.0), caller=Caller(on_progress=on_progress))
    except ReplayAborted as error:
        return error.cause, began[0] if began else -1
    except RobotUnreachable:
        return "timeout", -1
    return DONE, began[0] if began else -1


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("happening", HAPPENINGS, ids=lambda each: each.about.replace(" ", "_"))
def test_whatever_happens_at_the_controller_has_its_cause_and_nothing_of_ours_begins_again(happening):
    """Afterwards no program of ours runs, and none of somebody else's was stopped by us."""
    with simulated_arm("127.0.2.60", "--personality", "recorded") as host:
        for _ in range(ATTEMPTS):
            restore(host)
            cause, began = ended_by(happening, host)
            if began >= 0 and (cause in happening.causes or cause not in DISTURBED):
                break
        time.sleep(0.5)
        with Remote(host) as remote:
            truth = remote.truth()
        assert began >= 0, f"{cause} before it happened"
        assert cause in happening.causes
        if happening.phase != "control":
            assert len(truth["programs"]) - began <= 1  # the other one
        assert truth["program"] != "ControlProgram"
        theirs = [run for run in truth["programs"] if run["owner"] == "somebody else"]
        assert not [run for run in theirs if run["stopped_by"] == "dashboard"]
