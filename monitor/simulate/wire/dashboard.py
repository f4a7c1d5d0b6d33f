"""The dashboard's lines: one reply a command."""

import re
from collections.abc import Collection
from typing import TYPE_CHECKING

from monitor.simulate.controller.modes import RobotMode, Runtime, SafetyMode

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller

GREETING = "Connected: Universal Robots Dashboard Server"
LINE_MAX_BYTES = 4096
QUIT, SHUTDOWN = "Disconnected", "Shutting down"  # after which the connection, or the controller, is gone
USER_ROLES, OPERATIONAL_MODES = {"PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED"}, {"MANUAL", "AUTOMATIC"}
PROGRAM = "rtde_control.urp"  # programs that come over a script port have no file; the dashboard needs a name


def reply(controller: "Controller", line: str) -> str:
    """The answer to one line, without its newline."""
    command = line.strip()
    word = command.lower()
    settings = controller.settings
    match word:
        case "polyscopeversion":
            return f"URSoftware {'.'.join(map(str, controller.reported_version))} ({settings.build_date})"
        case "get serial number":
            return settings.serial
        case "get robot model":
            return settings.robot.removesuffix("e").upper()
        case "is in remote control":
            return "true" if controller.remote_control else "false"
        case "robotmode":
            return f"Robotmode: {controller.robot_mode.name}"
        case "safetymode":
            return f"Safetymode: {controller.safety_mode.name}"
        case "safetystatus":
            return f"Safetystatus: {controller.safety_mode.name}"
        case "running":
            return f"Program running: {str(controller.runtime == Runtime.PLAYING).lower()}"
        case "programstate":
            return f"{controller.runtime.name} {PROGRAM}"
        case "get loaded program":
            return f"Loaded program: /programs/{PROGRAM}"
        case "isprogramsaved":
            return f"true {PROGRAM}"
        case "stop":
            controller.stop_program("dashboard: stop")
            return "Stopped"  # also when nothing ran: ur-rtde's constructor asks for exactly this
        case "play":
            return "Starting program" if controller.play() else "Failed to execute: play"
        case "pause":
            return "Pausing program" if controller.pause() else "Failed to execute: pause"
        case "power on":
            return "Powering on" if controller.power(RobotMode.IDLE) else "Failed to execute: power on"
        case "power off":
            return "Powering off" if controller.power(RobotMode.POWER_OFF) else "Failed to execute: power off"
        case "brake release":
            return "Brake releasing" if controller.power(RobotMode.RUNNING) else "Failed to execute: brake release"
        case "unlock protective stop":
            early = "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
            if controller.unlock() or controller.safety_mode != SafetyMode.PROTECTIVE_STOP:
                return "Protective stop releasing"
            return early
        case "close safety popup":
            return "closing safety popup"
        case "close popup":
            return "closing popup"
        case "restart safety":
            return "Restarting safety"
        case "version":
            return ".".join(map(str, controller.reported_version))
        case "quit":
            return QUIT
        case "shutdown":
            return SHUTDOWN
    answer = _of_generation(controller, command)
    if answer:
        return answer
    if word.startswith("popup "):
        return "showing popup"
    if word.startswith("addtolog "):
        return "Added log message"
    if word.startswith("load "):
        named = command[18:] if word.startswith("load installation ") else command[5:]
        return f"File not found: {_printable(named)}"  # there are no files here
    return f"could not understand: {_printable(command)}"


def _of_generation(controller: "Controller", command: str) -> str:
    """What only CB3 or only the e-Series answers, or nothing: whoever may use the pendant, which this arm has not."""
    word, _, given = command.rpartition(" ")
    if controller.settings.polyscope.major < 5:
        if command.lower() == "getuserrole":
            return controller.user_role
        if word.lower() == "setuserrole":
            return _set(controller, "user_role", given, USER_ROLES)
        return ""
    if command.lower() == "get operational mode":
        return controller.operational_mode
    if command.lower() == "clear operational mode":
        controller.operational_mode = "NONE"
        return "operational mode is no longer controlled by Dashboard Server"
    if word.lower() == "set operational mode":
        return _set(controller, "operational_mode", given, OPERATIONAL_MODES)
    return ""


def _set(controller: "Controller", what: str, given: str, known: Collection[str]) -> str:
    if given.upper() not in known:
        return f"Failed setting {what.replace('_', ' ')}: {_printable(given)}"
    setattr(controller, what, given.upper())
    return f"Setting {what.replace('_', ' ')}: {given}"


def _printable(text: str) -> str:
    return re.sub(r"[^ -~]", "?", text)[:200]
