"""The dashboard server: one line of text in, one line out."""

import re
from collections.abc import Collection
from typing import Protocol

from monitor.simulate.controller.identity import Identity
from monitor.simulate.controller.modes import Modes, RobotMode, Runtime, SafetyMode
from monitor.simulate.controller.program.runner import Programs
from monitor.simulate.controller.safety import Safety
from monitor.simulate.settings import SimulateSettings

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
PROGRAM = "rtde_control.urp"  # the file name that the dashboard reports for programs that came over a script port


class DashboardController(Protocol):
    """What the dashboard uses of a controller."""

    @property
    def settings(self) -> SimulateSettings:
        """The settings of the simulated arm."""

    @property
    def identity(self) -> Identity:
        """What the controller reports about itself."""

    @property
    def modes(self) -> Modes:
        """The present modes."""

    @property
    def programs(self) -> Programs:
        """The program that runs."""

    @property
    def safety(self) -> Safety:
        """Protective stop, emergency stop and power."""


def reply(controller: DashboardController, line: str) -> str:
    """The reply to one line, without a newline."""
    command = line.strip()
    word = command.lower()
    if controller.identity.local and (word in ACTS or word.startswith(ACTS_ON)):
        return LOCAL
    answer = _about_the_robot(controller, word) or _about_programs(controller, word) or _about_safety(controller, word)
    answer = answer or SIMPLE.get(word, "") or _of_generation(controller, command)
    if answer:
        return answer
    if word.startswith("popup "):
        return "showing popup"
    if word.startswith("addtolog "):
        return "Added log message"
    if word.startswith("load "):
        file = command[18:] if word.startswith("load installation ") else command[5:]
        return f"File not found: {_printable(file)}"  # this controller has no files
    return f"could not understand: {_printable(command)}"


SIMPLE = {  # commands without an effect here
    "close safety popup": "closing safety popup",
    "close popup": "closing popup",
    "restart safety": "Restarting safety",
    "quit": QUIT,
    "shutdown": SHUTDOWN,
}


def _about_the_robot(controller: DashboardController, word: str) -> str:
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


def _about_programs(controller: DashboardController, word: str) -> str:
    programs, runtime = controller.programs, controller.modes.runtime
    match word:
        case "running":
            return f"Program running: {str(runtime == Runtime.PLAYING).lower()}"
        case "programstate":
            return f"{runtime.name} {PROGRAM}"
        case "get loaded program":
            return f"Loaded program: /programs/{PROGRAM}"
        case "isprogramsaved":
            return f"true {PROGRAM}"
        case "stop":
            programs.stop("dashboard: stop", by="dashboard")
            return "Stopped"  # also when no program ran: ur-rtde's constructor asks for exactly this reply
        case "play":
            return "Starting program" if programs.play() else "Failed to execute: play"
        case "pause":
            return "Pausing program" if programs.pause() else "Failed to execute: pause"
    return ""


def _about_safety(controller: DashboardController, word: str) -> str:
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


def _of_generation(controller: DashboardController, command: str) -> str:
    """The reply to a command that only CB3 or only the e-Series has: the role of the pendant's user, and the operational mode."""
    identity, (word, _, value) = controller.identity, command.rpartition(" ")
    if controller.settings.polyscope.major < 5:
        if command.lower() == "getuserrole":
            return identity.user_role
        if word.lower() == "setuserrole":
            return _set(identity, "user_role", value, USER_ROLES)
        return ""
    if command.lower() == "get operational mode":
        return identity.operational_mode
    if command.lower() == "clear operational mode":
        identity.clear_operational_mode()
        return "operational mode is no longer controlled by Dashboard Server"
    if word.lower() == "set operational mode":
        return _set(identity, "operational_mode", value, OPERATIONAL_MODES)
    return ""


def _set(identity: Identity, attribute: str, value: str, known: Collection[str]) -> str:
    name = attribute.replace("_", " ")
    if value.upper() not in known:
        return f"Failed setting {name}: {_printable(value)}"
    setattr(identity, attribute, value.upper())
    return f"Setting {name}: {value}"


def _printable(text: str) -> str:
    return re.sub(r"[^ -~]", "?", text)[:200]
