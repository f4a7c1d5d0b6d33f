"""Arguments of faults and of scenarios: their kinds and their checks."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from monitor.errors import BadInput
from monitor.simulate.arm.damage import DAMAGES
from monitor.simulate.polyscope import Version


class Number(NamedTuple):
    """A number from low to high. It is required if the default is None."""

    low: float
    high: float
    default: float | None = None


class Choice(NamedTuple):
    """One of several words. It is required if the default is None."""

    words: tuple[str, ...]
    default: str | None = None


class Text(NamedTuple):
    """A text that is not empty. It is required if the default is None."""

    default: str | None = None


class Flag(NamedTuple):
    """A truth value."""

    default: bool


Kind = Number | Choice | Text | Flag


def check(what: str, known: Mapping[str, Kind], given: Mapping[str, Any], *, joints: int = 6) -> dict[str, Any]:
    """Check given values and fill in defaults. `what` begins every message. Numbers may be text, as from a command line.

    An argument named `joint` is a whole number up to `joints`. Raises BadInput with the argument, its value and what is expected.
    """
    unknown = sorted(key for key, value in given.items() if key not in known and value is not None)
    if unknown:
        raise BadInput(f"{what}: {', '.join(unknown)} is not an argument of it; known are {', '.join(known) or 'none'}")
    result: dict[str, Any] = {}
    for key, kind in known.items():
        value = given.get(key)
        value = kind.default if value is None else value
        where = f"{what}: {key} = {value!r}" if value is not None else f"{what}: {key} is missing"
        match kind:
            case Number(low, high):
                high = joints if key == "joint" else high
                number = _figure(value)
                if number is None or not low <= number <= high or (key == "joint" and number != int(number)):
                    raise BadInput(f"{where}; expected a {'whole number' if key == 'joint' else 'number'} from {low:g} to {high:g}")
                result[key] = int(number) if key == "joint" else number
            case Choice(words):
                if value not in words:
                    raise BadInput(f"{where}; expected one of {', '.join(word or '(nothing)' for word in words)}")
                result[key] = value
            case Text():
                if not isinstance(value, str) or not value:
                    raise BadInput(f"{where}; expected a text")
                result[key] = value
            case Flag():
                if not isinstance(value, bool):
                    raise BadInput(f"{where}; expected true or false")
                result[key] = value
    return result


def _figure(value: Any) -> float | None:
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return None
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) else None


# --- The faults that can be injected: names, arguments and their checks. `controller/faults.py` and `wire/robot.py` make them happen ---

SERVICES = ("rtde", "dashboard", "robot_api", "primary", "secondary", "realtime")
STALL_MAX_S = 3600.0
CONNECTIONS_MAX = 64  # per service


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One thing that can go wrong."""

    about: str
    arguments: Mapping[str, Kind] = field(default_factory=dict)


def checked(name: str, given: Mapping[str, Any], *, joints: int = 6) -> dict[str, Any]:
    """The arguments of a fault, with defaults filled in.

    Raises BadInput for an unknown fault with the known ones, and for a wrong argument with its value and what is expected.
    """
    if name not in FAULTS:
        raise BadInput(f"fault {name!r} is not known; known are {', '.join(sorted(FAULTS))}")
    arguments = check(f"fault {name}", FAULTS[name].arguments, given, joints=joints)
    if name == "version":
        parsed_version(arguments["version"])
    return arguments


def parse(text: str) -> tuple[str, dict[str, Any]]:
    """Parse a fault as it is typed on a command line: `NAME[:severity] key=value …`. Returns its name and its arguments.

    Raises BadInput for a word without `=`, and for whatever `checked` refuses.
    """
    name, *words = text.split() or [""]
    name, colon, severity = name.partition(":")
    pairs = {"severity": severity} if colon else {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise BadInput(f"fault {name}: {word!r}; expected key=value")
        pairs[key] = value
    checked(name, pairs)
    return name, pairs


def parsed_version(text: str) -> Version:
    """The version that the fault `version` reports. Raises BadInput if the text is not a version."""
    parts = text.split(".")
    if not 2 <= len(parts) <= 4 or not all(re.fullmatch(r"[0-9]{1,9}", part) for part in parts):
        raise BadInput(f"fault version: version = {text!r}; expected MAJOR.MINOR[.BUGFIX[.BUILD]]")
    version = Version(*([int(part) for part in parts] + [0, 0])[:4])
    if max(version[:2]) > 255:
        raise BadInput(f"fault version: version = {text!r}; expected MAJOR and MINOR up to 255: they are bytes on the primary port")
    return version


_SERVICE = Choice((*SERVICES, "all"), "rtde")
_CONNECTION: dict[str, Kind] = {"service": _SERVICE, "connection": Number(0, CONNECTIONS_MAX, 0)}  # 0: all of them
_JOINT = Number(1, 6)
_DAMAGE: dict[str, Kind] = {"severity": Number(0, 1, 0.5), "joint": Number(1, 6, 3)}

FAULTS: dict[str, Fault] = {
    "stall": Fault(about="no RTDE data for so long, then on as if nothing had been", arguments={"seconds": Number(1e-3, STALL_MAX_S)}),
    "close": Fault(about="connections of a service end with FIN; one alone, if numbered from the oldest", arguments=_CONNECTION),
    "reset": Fault(about="connections of a service end with RST; one alone, if numbered from the oldest", arguments=_CONNECTION),
    "listener_gone": Fault(
        about="connections refused; 0 s: until `clear`",
        arguments={"service": _SERVICE, "seconds": Number(0, 3600, 0)},
    ),
    "restart": Fault(
        about="controller killed and started again: all connections reset, clock at zero",
        arguments={"seconds": Number(0, 600, 2), "power": Choice(("on", "off"), "off")},
    ),
    "power_cut": Fault(
        about="the main switch: arm braked, controller gone, connections silent or reset; it comes back without power",
        arguments={"seconds": Number(0.1, 600, 5), "connections": Choice(("silent", "reset"), "silent")},
    ),
    "freeze": Fault(about="the controller hangs, connections stay open", arguments={"seconds": Number(1e-3, 60)}),
    "late": Fault(about="packets held back and then in a bunch", arguments={"seconds": Number(0, 5), "share": Number(0, 1, 0.05)}),
    "skip": Fault(about="packets never sent", arguments={"share": Number(0, 1, 0.05)}),
    "mute": Fault(about="requests are read and not answered"),
    "robot_api": Fault(
        about="the Robot API of a PolyScope X answers every request wrongly or not at all, until `clear`",
        arguments={"answer": Choice(("unauthorized", "forbidden", "failing", "garbage", "elsewhere", "silent"))},
    ),
    "manual_mode": Fault(
        about="the pendant of a PolyScope X is in manual mode, which ends remote control", arguments={"state": Choice(("on", "off"), "on")}
    ),
    "text_at_connect": Fault(about="a text message before the first reply, as with an unconfirmed safety set-up"),
    "registers_in_use": Fault(about="every free input belongs to a connection that is gone"),
    "version": Fault(about="another version is reported", arguments={"version": Text()}),
    "not_found": Fault(about="outputs that this controller does not know", arguments={"names": Text()}),
    "remote": Fault(about="remote control off or on", arguments={"state": Choice(("on", "off"), "off")}),
    "digital_input": Fault(
        about="somebody switches a digital input",
        arguments={"number": Number(0, 17), "state": Choice(("on", "off"), "on")},
    ),
    "foreign_program": Fault(
        about="somebody else starts a program: now, after ours has ended, or while ours uploads, which then starts late by the delay",
        arguments={
            "when": Choice(("now", "after_ours", "during_upload"), "now"),
            "delay": Number(0, 3600, 0),
            "seconds": Number(0.01, 3600, 5),
            "moves": Choice(("on", "off"), "on"),
        },
    ),
    "teach_button": Fault(about="the freedrive button is held", arguments={"state": Choice(("on", "off"), "on")}),
    "speed_slider": Fault(about="somebody moves the speed slider", arguments={"fraction": Number(0, 1)}),
    "tcp_changed": Fault(
        about="the tool centre point is changed at the pendant [m, rad]",
        arguments={name: Number(-5, 5, 0) for name in ("x", "y", "z", "rx", "ry", "rz")},
    ),
    "payload_changed": Fault(
        about="mass and centre of the payload are changed at the pendant [kg, m]",
        arguments={"kg": Number(0, 100, 0), **{name: Number(-2, 2, 0) for name in ("x", "y", "z")}},
    ),
    "wrist_turned": Fault(about="a joint is turned by whole turns", arguments={"joint": Number(1, 6, 6), "turns": Number(-4, 4, 1)}),
    "reduced": Fault(about="the safety mode is reduced; the arm moves on", arguments={"state": Choice(("on", "off"), "on")}),
    "stuck": Fault(about="a joint sticks mechanically", arguments={"joint": _JOINT}),
    "brake": Fault(about="the brake of one joint closes", arguments={"joint": _JOINT}),
    "watchdog_dead": Fault(about="the watchdog is acknowledged and does nothing"),
    "never_ready": Fault(about="the control program never says that it takes a command, although it plays"),
    "clock_jump": Fault(about="the published clock jumps", arguments={"seconds": Number(-1e6, 1e6)}),
    "program_stop": Fault(about="somebody else stops the program"),
    "protective_stop": Fault(
        about="protective stop; the program pauses, stops or plays on",
        arguments={"runtime": Choice(("", "paused", "stopped", "playing"), "")},
    ),
    "safeguard_stop": Fault(
        about="somebody opens the guard: halt and pause; when it closes, the program plays on; 0 s: at `clear`",
        arguments={"seconds": Number(0, 3600, 0)},
    ),
    "emergency_stop": Fault(about="the button: halt, then power off"),
    "emergency_release": Fault(about="the button is pulled out; power stays off"),
    "temperatures_frozen": Fault(about="temperatures stay as they are"),
    "temperature_glitch": Fault(
        about="a joint's temperature is wrong in one tick of 32",
        arguments={"joint": _JOINT, "value": Number(-300, 1000, 0)},
    ),
    "current_stuck": Fault(about="a joint goes on telling its present current", arguments={"joint": _JOINT}),
    "encoder_offset": Fault(about="a joint's zero has moved", arguments={"joint": _JOINT, "value": Number(-1, 1)}),
    "current_noise": Fault(about="louder currents", arguments={"factor": Number(0, 100)}),
    "obstacle": Fault(
        about="a torque on a joint against its motion, or with stiffness [N·m/rad] an elastic wall before it; 0 s: until `clear`",
        arguments={
            "joint": _JOINT,
            "torque": Number(-1000, 1000, 0),
            "stiffness": Number(0, 100_000, 0),
            "seconds": Number(0, 3600, 0),
        },
    ),
    **{name: Fault(about=about, arguments=_DAMAGE) for name, about in DAMAGES.items()},
    "clear": Fault(about="ends every lasting fault; a stop stays until somebody ends it"),
    "recover": Fault(about="somebody at the pendant: every lasting fault and every stop is over, power on, brakes released"),
}
