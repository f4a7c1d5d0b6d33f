"""The start of a simulator: settings from a scenario and from options, the announcement, and the end of its process."""

import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

from monitor.errors import BadInput
from monitor.model.robot import Mounting
from monitor.simulate.program_tree import load_tree
from monitor.simulate.scenario import Scenario, load_scenario
from monitor.simulate.settings import RTDE_PORT, SCRIPT_PORTS, SimulateSettings


def settings_from(scenario: Scenario | None, **given: Any) -> SimulateSettings:
    """Settings from options, a scenario and defaults. A given option (not None) goes before the scenario, which goes before a default.

    Raises BadInput for wrong settings, and for a payload in the scenario that the arm cannot carry.
    """
    known = {field.name for field in fields(SimulateSettings)}
    chosen: dict[str, Any] = {} if scenario is None else {key: value for key, value in scenario.arm.items() if key in known}
    chosen.update({key: value for key, value in given.items() if value is not None})
    if isinstance(chosen.get("mounting"), str):
        chosen["mounting"] = Mounting.parse(chosen["mounting"])
    if scenario is not None and scenario.room is not None and given.get("ambient_c") is None:
        chosen["ambient_c"] = scenario.room.at(scenario.started_s)
    settings = SimulateSettings(**chosen, scenario=scenario)
    if settings.cell is not None:
        from monitor.simulate.cells.catalogue import cell  # pinocchio is slow to import
        from monitor.simulate.cells.cell import in_cell

        if any(given.get(name) is not None for name in ("payload_kg", "home_rad")):
            raise BadInput(f"simulate: the cell {settings.cell} has its own tool and its own first place; give no payload and no home")
        settings = in_cell(settings, cell(settings.cell, settings.arm, settings.seed))
    if scenario is None:
        return settings
    for event in scenario.events:
        if event.do == "payload" and event.arguments["kg"] > 2.0 * settings.arm.payload_max_kg:
            most = settings.arm.payload_max_kg
            raise BadInput(f"scenario {scenario.name}: payload of {event.arguments['kg']:g} kg; a {settings.robot} carries {most:g} kg")
    return settings


def settings_of_options(
    *,
    scenario: str | None = None,
    program: str | Path | None = None,
    home: str | None = None,
    wear_per_revolution: str | None = None,
    **given: Any,
) -> SimulateSettings:
    """Settings from options as they are typed: a scenario's name or file, a program's file, and numbers separated by commas.

    given : fields of the settings; None counts as not given. Raises BadInput for wrong ones.
    """
    return settings_from(
        None if scenario is None else load_scenario(scenario),
        program=None if program is None else load_tree(Path(program)),
        home_rad=numbers("--home", home),
        wear_per_revolution=numbers("--wear-per-revolution", wear_per_revolution),
        **given,
    )


def numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    """The numbers of an option, one a joint. Raises BadInput with the option if the text is no list of numbers."""
    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: expected one number a joint, comma-separated") from None


def announcement(settings: SimulateSettings) -> str:
    """What the command prints: where the simulator listens, its scenario, and how to use it."""
    version = ".".join(map(str, settings.polyscope))
    scenario, ports = settings.scenario, settings.service_ports
    asked = f"Robot API {ports['robot_api']}" if "robot_api" in ports else f"dashboard {ports['dashboard']}"
    state = "/".join(map(str, SCRIPT_PORTS))
    lines = [
        f"simulated {settings.robot}, {1.0 / settings.tick_s:.0f} Hz, PolyScope {version}, listening on {settings.bind}",
        f"  RTDE {RTDE_PORT}, {asked}, state and scripts {state}, commands {settings.command_port}",
        *([] if settings.cell is None else [f"  cell {settings.cell}: its program plays"]),
        f"  scenario {scenario.name}: {scenario.about}" if scenario else "  no scenario: a fresh arm",
        f'  talk to it   RTDEReceiveInterface("{settings.bind}"), or host = "{settings.bind}" in a configuration',
        f"  make faults  joint-monitor simulate --bind {settings.bind} --fault 'stall seconds=2'",
        "  Ctrl-C ends it",
    ]
    return "\n".join(lines)


def ended(process: "subprocess.Popen[str]", within_s: float = 5.0) -> None:
    """End a simulator's process: ask it, and kill it if it has not ended in time."""
    process.terminate()
    try:
        process.wait(timeout=within_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
