"""Program files on the dashboard: they are loaded, played, paused and stopped by name."""

import numpy as np
import pytest

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.state import RobotMode
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire import dashboard


@pytest.fixture
def arm() -> Controller:
    controller = Controller(SimulateSettings(robot="ur5e"))
    controller.step()
    return controller


def answers(controller: Controller, *lines: str) -> list[str]:
    return [dashboard.reply(controller, line) for line in lines]


def run(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds / controller.clock.tick_s)):
        controller.step()


def test_a_program_file_is_loaded_played_paused_and_stopped_under_its_name(arm):
    """Every answer names the file. Playing goes on after a pause."""
    assert answers(
        arm, "play", "load wait_program.urp", "programState", "get loaded program", "isProgramSaved", "play", "programState"
    ) == [
        "Failed to execute: play",
        "Loading program: wait_program.urp",
        "STOPPED wait_program.urp",
        "Loaded program: /programs/wait_program.urp",
        "true wait_program.urp",
        "Starting program",
        "PLAYING wait_program.urp",
    ]
    run(arm, 0.1)
    assert answers(arm, "pause", "programState", "play", "running", "stop", "running", "programState", "play") == [
        "Pausing program",
        "PAUSED wait_program.urp",
        "Starting program",
        "Program running: true",
        "Stopped",
        "Program running: false",
        "STOPPED wait_program.urp",
        "Starting program",
    ]
    assert answers(arm, "load back_and_forth.urp") == ["Error while loading program: back_and_forth.urp"]  # another one plays


def test_a_file_is_found_in_the_folders_of_an_arm_and_of_the_manufacturers_simulator(arm):
    """The answer repeats the path. What is not there is not found, and the program that was loaded stays."""
    paths = ("/ursim/programs/wait_program.urp", "/programs/wait_program.urp", "/etc/wait_program.urp", "nothing.urp")
    assert answers(arm, *(f"load {path}" for path in paths), "programState", "load installation default.installation") == [
        *(f"Loading program: {path}" for path in paths[:2]),
        *(f"File not found: {path}" for path in paths[2:]),
        "STOPPED wait_program.urp",
        "Loading installation: default.installation",
    ]
    assert answers(arm, "load installation mine.installation") == ["File not found: mine.installation"]


def test_a_cells_own_program_moves_the_arm_for_ever(arm):
    """`back_and_forth.urp` turns the last joint to and fro until it is stopped."""
    answers(arm, "load back_and_forth.urp", "play")
    seen = []
    for _ in range(40):
        run(arm, 0.1)
        seen.append(arm.reference.q[5])
    assert 0.39 < max(seen) < 0.41
    assert np.diff(np.sign(np.diff(seen))).any()
    answers(arm, "stop")
    run(arm, 0.5)
    assert arm.reference.qd[5] == 0.0


def test_the_brakes_are_released_from_power_off_too(arm):
    """A brake release without power switches the power on first."""
    assert answers(arm, "power off", "robotmode", "brake release", "robotmode") == [
        "Powering off",
        "Robotmode: POWER_OFF",
        "Brake releasing",
        "Robotmode: RUNNING",
    ]
    assert arm.modes.robot == RobotMode.RUNNING


def test_logs_and_reports_are_answered(arm):
    """The controller answers as if it had written them; it has no files."""
    assert answers(arm, "saveLog", "generate flight report ", "generate flight report controller", "generate support file /programs") == [
        "Log saved to disk",
        "Flight Report generated with id: 20180500001",
        "Flight Report generated with id: 20180500001",
        "Completed successfully: /programs/ur_20180500001.zip",
    ]
