"""The dashboard server: one line of text in, one line out."""

import re

from monitor.simulate.controller.controller import Controller
from monitor.simulate.machine.state import RobotMode, Runtime, SafetyMode

GREETING = "Connected: Universal Robots Dashboard Server"
LINE_MAX_BYTES = 4096
QUIT, SHUTDOWN = "Disconnected", "Shutting down"  # replies after which the connection, or the whole controller, ends
LOCAL = "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port 29999"
ACTS = frozenset(  # commands that are refused in local control
    (
        *("play", "stop", "pause", "power on", "power off", "brake release", "unlock protective stop"),
        *("close safety popup", "restart safety", "shutdown"),
    )
)
ACTS_ON = ("load ", "set operational mode ")
USER_ROLES, OPERATIONAL_MODES = {"PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED"}, {"MANUAL", "AUTOMATIC"}


def reply(controller: Controller, line: str) -> str:
    """The reply to one line, without a newline."""
    command = line.strip()
    word = command.lower()
    if controller.identity.local and (word in ACTS or word.startswith(ACTS_ON)):
        return LOCAL
    answer = _about_the_robot(controller, word) or _about_programs(controller, word) or _about_safety(controller, word)
    answer = answer or SIMPLE.get(word, "") or _of_generation(controller, command) or _with_argument(controller, command)
    return answer or f"could not understand: {_printable(command)}"


SIMPLE = {  # commands without an effect here
    "close safety popup": "closing safety popup",
    "restart safety": "Restarting safety",
    "savelog": "Log saved to disk",
    "quit": QUIT,
    "shutdown": SHUTDOWN,
}


def _about_the_robot(controller: Controller, word: str) -> str:
    identity, settings, modes = controller.identity, controller.settings, controller.modes
    version = ".".join(map(str, identity.reported_version))
    match word:
        case "polyscopeversion":
            return f"URSoftware {version} ({settings.build_date})"
        case "version":
            return version
        case "get serial number":
            return settings.serial
        case "get robot model":
            return settings.robot.removesuffix("e").upper()
        case "is in remote control":
            return "true" if identity.remote_control else "false"
        case "robotmode":
            return f"Robotmode: {modes.robot.name}"
        case "safetymode":
            return f"Safetymode: {modes.safety.name}"
        case "safetystatus":
            return f"Safetystatus: {modes.safety.name}"
    return ""


def _about_programs(controller: Controller, word: str) -> str:
    programs, runtime, file = controller.programs, controller.modes.runtime, controller.programs.files.loaded
    match word:
        case "close popup":
            controller.modes.popup = ""
            return "closing popup"
        case "running":
            return f"Program running: {str(runtime == Runtime.PLAYING).lower()}"
        case "programstate":
            return f"{runtime.name} {file}"
        case "get loaded program":
            return f"Loaded program: /programs/{file}"
        case "isprogramsaved":
            return f"true {file}"
        case "stop":
            programs.stop("dashboard: stop", by="dashboard")
            return "Stopped"  # also when no program ran: ur-rtde's constructor asks for exactly this reply
        case "play":
            return "Starting program" if programs.play() else "Failed to execute: play"
        case "pause":
            return "Pausing program" if programs.pause() else "Failed to execute: pause"
    return ""


def _about_safety(controller: Controller, word: str) -> str:
    safety, modes = controller.safety, controller.modes
    match word:
        case "power on":
            return "Powering on" if safety.power(RobotMode.IDLE) else "Failed to execute: power on"
        case "power off":
            return "Powering off" if safety.power(RobotMode.POWER_OFF) else "Failed to execute: power off"
        case "brake release":
            return "Brake releasing" if safety.power(RobotMode.RUNNING) else "Failed to execute: brake release"
        case "unlock protective stop":
            if safety.unlock() or modes.safety != SafetyMode.PROTECTIVE_STOP:
                return "Protective stop releasing"
            return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
    return ""


def _with_argument(controller: Controller, command: str) -> str:
    """The reply to a command that is followed by a text. Reports and support files are reported as made; nothing is written."""
    word, programs = command.lower(), controller.programs
    if word.startswith("popup "):
        controller.modes.popup = command[len("popup ") :]
        return "showing popup"
    if word.startswith("addtolog "):
        return "Added log message"
    if word.startswith("load installation "):
        file = command[len("load installation ") :]
        found = programs.files.has_installation(file)
        return f"{'Loading installation' if found else 'File not found'}: {_printable(file)}"
    if word.startswith("load "):
        file = command[len("load ") :]
        if controller.modes.runtime != Runtime.STOPPED:
            return f"Error while loading program: {_printable(file)}"
        return f"{'Loading program' if programs.files.load(file) else 'File not found'}: {_printable(file)}"
    if word.startswith("generate flight report"):
        return f"Flight Report generated with id: {controller.settings.serial}"
    if word.startswith("generate support file "):
        folder = command[len("generate support file ") :].rstrip("/")
        return f"Completed successfully: {_printable(folder)}/ur_{controller.settings.serial}.zip"
    return ""


def _of_generation(controller: Controller, command: str) -> str:
    """The reply to a command that only CB3 or only the e-Series has: the role of the pendant's user, and the operational mode."""
    identity, (word, _, value) = controller.identity, command.rpartition(" ")
    if controller.settings.polyscope.major < 5:
        if command.lower() == "getuserrole":
            return identity.user_role
        if word.lower() == "setuserrole":
            if value.upper() not in USER_ROLES:
                return f"Failed setting user role: {_printable(value)}"
            identity.user_role = value.upper()
            return f"Setting user role: {value}"
        return ""
    if command.lower() == "get operational mode":
        return identity.operational_mode
    if command.lower() == "clear operational mode":
        identity.operational_mode = "NONE"
        return "No longer controlling the operational mode. Current operational mode: NONE"
    if word.lower() == "set operational mode":
        if value.upper() not in OPERATIONAL_MODES:
            return f"Failed setting operational mode: {_printable(value)}"
        identity.operational_mode = value.upper()
        return f"Operational mode {identity.operational_mode} is set"
    return ""


def _printable(text: str) -> str:
    return re.sub(r"[^ -~]", "?", text)[:200]
