"""What can go wrong, on command: each fault by its name, with the arguments that it takes, checked before anything happens."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.errors import BadInput
from monitor.simulate.arguments import Choice, Kind, Number, Text, check
from monitor.simulate.arm.sensors import SensorFaults
from monitor.simulate.controller.registers import INPUT_TYPES
from monitor.simulate.settings import Version

if TYPE_CHECKING:
    from monitor.simulate.controller.controller import Controller
    from monitor.simulate.server import Listeners
    from monitor.simulate.wire.ports import Ports

SERVICES = ("rtde", "dashboard", "primary", "secondary", "realtime")
STALL_MAX_S = 3600.0
NOBODY = -1  # owns the registers that are held over


@dataclass(slots=True)
class WireFaults:
    """What is wrong with the wire, on command."""

    muted_until_s: float = 0.0  # loop time: no RTDE data packets before
    mute: bool = False  # requests are read and not answered
    late_s: float = 0.0
    late_share: float = 0.0  # of the packets come late by `late_s`, with all that follow meanwhile
    skip_share: float = 0.0  # of the ticks are never sent
    text_at_connect: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where faults happen: a controller, and its wire where it has one."""

    controller: "Controller"
    ports: "Ports | None" = None
    listeners: "Listeners | None" = None
    now_s: float = 0.0  # of the event loop


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One thing that can go wrong."""

    about: str
    happen: Callable[[Place, dict[str, Any]], str]
    arguments: dict[str, Kind] = field(default_factory=dict)


def inject(name: str, given: dict[str, Any], place: Place) -> str:
    """Make one fault happen; what was done.

    Raises BadInput for an unknown name or argument, naming what is known, and for a fault of the wire where there is none.
    """
    arguments = checked(name, given, joints=place.controller.robot.joints)
    return FAULTS[name].happen(place, arguments)


def checked(name: str, given: dict[str, Any], *, joints: int = 6) -> dict[str, Any]:
    """The arguments of a fault, defaults filled in.

    Raises BadInput naming what is known, or the argument, its value and what would be right.
    """
    if name not in FAULTS:
        raise BadInput(f"fault {name!r} is not known; known are {', '.join(sorted(FAULTS))}")
    arguments = check(f"fault {name}", FAULTS[name].arguments, given, joints=joints)
    if name == "version":
        _version_of(arguments["version"])
    return arguments


def parse(text: str) -> tuple[str, dict[str, Any]]:
    """`NAME key=value …` as typed on a command line.

    Raises BadInput for a word without `=`, and for what `checked` does not like.
    """
    name, *words = text.split() or [""]
    pairs = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise BadInput(f"fault {name}: {word!r}; expected key=value")
        pairs[key] = value
    checked(name, pairs)
    return name, pairs


def _ports(place: Place) -> "Ports":
    if place.ports is None:
        raise BadInput("this fault is one of the wire, and there is none here: run `joint-monitor simulate`")
    return place.ports


def _listeners(place: Place) -> "Listeners":
    if place.listeners is None:
        raise BadInput("this fault is one of the wire, and there is none here: run `joint-monitor simulate`")
    return place.listeners


# --- the wire ------------------------------------------------------------------------------------------------


def _stall(place: Place, a: dict[str, Any]) -> str:
    _ports(place).faults.muted_until_s = place.now_s + a["seconds"]
    return f"no RTDE data for {a['seconds']:g} s"


def _close(place: Place, a: dict[str, Any], *, reset: bool = False) -> str:
    count = _ports(place).drop(a["service"], reset=reset)
    return f"{'reset' if reset else 'closed'} {count} connections of {a['service']}"


def _reset(place: Place, a: dict[str, Any]) -> str:
    return _close(place, a, reset=True)


def _listener_gone(place: Place, a: dict[str, Any]) -> str:
    _listeners(place).away(a["service"], a["seconds"])
    return f"nobody listens for {a['service']}" + (f" for {a['seconds']:g} s" if a["seconds"] else " until `clear`")


def _restart(place: Place, a: dict[str, Any]) -> str:
    _listeners(place).restart(a["seconds"])
    return f"the controller was killed and comes back in {a['seconds']:g} s, its clock at zero, power {a['power']}" + _power(place, a)


def _power(place: Place, a: dict[str, Any]) -> str:
    _listeners(place).powered = a["power"] == "on"
    return ""


def _freeze(place: Place, a: dict[str, Any]) -> str:
    _listeners(place).freeze(a["seconds"])
    return f"the whole controller stands still for {a['seconds']:g} s, its connections open"


def _late(place: Place, a: dict[str, Any]) -> str:
    faults = _ports(place).faults
    faults.late_s, faults.late_share = a["seconds"], a["share"]
    return f"{100 * a['share']:g} % of the packets come {1000 * a['seconds']:g} ms late, with those behind them"


def _skip(place: Place, a: dict[str, Any]) -> str:
    _ports(place).faults.skip_share = a["share"]
    return f"{100 * a['share']:g} % of the packets are never sent"


def _mute(place: Place, _: dict[str, Any]) -> str:
    _ports(place).faults.mute = True
    return "requests are read and never answered"


def _text_at_connect(place: Place, _: dict[str, Any]) -> str:
    _ports(place).faults.text_at_connect = True
    return "every new RTDE connection is greeted by a text message"


# --- the controller -------------------------------------------------------------------------------------------


def _registers(place: Place, _: dict[str, Any]) -> str:
    place.controller.inputs.seize(INPUT_TYPES, NOBODY)
    return "all inputs that were free belong to a connection that is gone"


def _version_of(text: str) -> Version:
    parts = text.split(".")
    if not 2 <= len(parts) <= 4 or not all(re.fullmatch(r"[0-9]{1,9}", part) for part in parts):
        raise BadInput(f"fault version: version = {text!r}; expected MAJOR.MINOR[.BUGFIX[.BUILD]]")
    version = Version(*([int(part) for part in parts] + [0, 0])[:4])
    if max(version[:2]) > 255:
        raise BadInput(f"fault version: version = {text!r}; expected MAJOR and MINOR up to 255: they are bytes on the primary port")
    return version


def _version(place: Place, a: dict[str, Any]) -> str:
    place.controller.reported_version = _version_of(a["version"])
    return f"reports version {a['version']}"


def outputs_of(controller: "Controller", names: str) -> list[str]:
    """Names of outputs, comma-separated. Raises BadInput naming those that this controller has not."""
    wanted = [name for name in names.split(",") if name]
    unknown = [name for name in wanted if name not in controller.variables or not controller.knows(name)]
    if unknown:
        raise BadInput(f"fault not_found: {', '.join(unknown)} is no output of this controller")
    return wanted


def _not_found(place: Place, a: dict[str, Any]) -> str:
    names = outputs_of(place.controller, a["names"])
    place.controller.missing.update(names)
    return f"does not know {', '.join(names)}"


def _remote(place: Place, a: dict[str, Any]) -> str:
    place.controller.remote_control = a["state"] == "on"
    return f"remote control is {a['state']}"


def _digital_input(place: Place, a: dict[str, Any]) -> str:
    bit = 1 << int(a["number"])
    on = a["state"] == "on"
    place.controller.digital_inputs = place.controller.digital_inputs | bit if on else place.controller.digital_inputs & ~bit
    return f"digital input {int(a['number'])} is {a['state']}"


def _program_stop(place: Place, _: dict[str, Any]) -> str:
    return "program stopped" if place.controller.stop_program("fault: stopped by somebody else") else "no program was running"


def _protective_stop(place: Place, a: dict[str, Any]) -> str:
    place.controller.protective_stop("fault: protective_stop", runtime=a["runtime"] or None)
    return "protective stop"


def _emergency_stop(place: Place, _: dict[str, Any]) -> str:
    place.controller.emergency_stop()
    return "emergency stop"


def _emergency_release(place: Place, _: dict[str, Any]) -> str:
    place.controller.release_emergency_stop()
    return "emergency stop released, power is off"


# --- the sensors ----------------------------------------------------------------------------------------------


def _frozen(place: Place, _: dict[str, Any]) -> str:
    place.controller.sensors.faults.frozen_c = place.controller.measured.temperature_c.copy()
    return "temperatures stay as they are"


def _glitch(place: Place, a: dict[str, Any]) -> str:
    place.controller.sensors.faults.glitch_c[a["joint"] - 1] = a["value"]
    return f"joint {a['joint']} says {a['value']:g} °C now and then"


def _stuck(place: Place, a: dict[str, Any]) -> str:
    joint = a["joint"] - 1
    value = float(place.controller.measured.current[joint])
    place.controller.sensors.faults.stuck_a[joint] = value
    return f"joint {a['joint']} goes on telling {value:.3f} A"


def _offset(place: Place, a: dict[str, Any]) -> str:
    offset = np.zeros(place.controller.robot.joints)
    offset[a["joint"] - 1] = a["value"]
    place.controller.shift_encoders(offset)
    return f"the encoder of joint {a['joint']} has moved by {a['value']:g} rad"


def _noise(place: Place, a: dict[str, Any]) -> str:
    place.controller.sensors.louder(a["factor"])
    return f"currents with {a['factor']:g} times their noise"


def _clear(place: Place, _: dict[str, Any]) -> str:
    controller = place.controller
    if place.ports is not None:
        place.ports.faults = WireFaults()
    if place.listeners is not None:
        place.listeners.back()
    controller.inputs.release(NOBODY)
    controller.reported_version, controller.remote_control = controller.settings.polyscope, controller.settings.remote_control
    controller.missing.clear()
    controller.digital_inputs = 0
    controller.sensors.louder(controller.settings.current_noise)
    offset = controller.sensors.faults.offset_rad
    controller.sensors.faults = SensorFaults(noisy=controller.settings.current_noise)
    if offset is not None:
        controller.sensors.faults.offset_rad = offset
        controller.shift_encoders(-offset)
    return "every lasting fault is over"


_SERVICE = Choice((*SERVICES, "all"), "rtde")
_JOINT = Number(1, 6)

FAULTS: dict[str, Fault] = {
    "stall": Fault(
        about="no RTDE data for so long, then on as if nothing had been", happen=_stall, arguments={"seconds": Number(1e-3, STALL_MAX_S)}
    ),
    "close": Fault(about="connections of a service end with FIN", happen=_close, arguments={"service": _SERVICE}),
    "reset": Fault(about="connections of a service end with RST", happen=_reset, arguments={"service": _SERVICE}),
    "listener_gone": Fault(
        about="connections refused; 0 s: until `clear`",
        happen=_listener_gone,
        arguments={"service": _SERVICE, "seconds": Number(0, 3600, 0)},
    ),
    "restart": Fault(
        about="controller killed and started again: all connections reset, clock at zero",
        happen=_restart,
        arguments={"seconds": Number(0, 600, 2), "power": Choice(("on", "off"), "off")},
    ),
    "freeze": Fault(about="the controller hangs, connections stay open", happen=_freeze, arguments={"seconds": Number(1e-3, 60)}),
    "late": Fault(
        about="packets held back and then in a bunch", happen=_late, arguments={"seconds": Number(0, 5), "share": Number(0, 1, 0.05)}
    ),
    "skip": Fault(about="packets never sent", happen=_skip, arguments={"share": Number(0, 1, 0.05)}),
    "mute": Fault(about="requests are read and not answered", happen=_mute),
    "text_at_connect": Fault(about="a text message before the first reply, as with an unconfirmed safety set-up", happen=_text_at_connect),
    "registers_in_use": Fault(about="every free input belongs to a connection that is gone", happen=_registers),
    "version": Fault(about="another version is reported", happen=_version, arguments={"version": Text()}),
    "not_found": Fault(about="outputs that this controller does not know", happen=_not_found, arguments={"names": Text()}),
    "remote": Fault(about="remote control off or on", happen=_remote, arguments={"state": Choice(("on", "off"), "off")}),
    "digital_input": Fault(
        about="somebody switches a digital input",
        happen=_digital_input,
        arguments={"number": Number(0, 17), "state": Choice(("on", "off"), "on")},
    ),
    "program_stop": Fault(about="somebody else stops the program", happen=_program_stop),
    "protective_stop": Fault(
        about="protective stop; the program pauses, stops or plays on",
        happen=_protective_stop,
        arguments={"runtime": Choice(("", "paused", "stopped", "playing"), "")},
    ),
    "emergency_stop": Fault(about="the button: halt, then power off", happen=_emergency_stop),
    "emergency_release": Fault(about="the button is pulled out; power stays off", happen=_emergency_release),
    "temperatures_frozen": Fault(about="temperatures stay as they are", happen=_frozen),
    "temperature_glitch": Fault(
        about="a joint's temperature is wrong in one tick of 32",
        happen=_glitch,
        arguments={"joint": _JOINT, "value": Number(-300, 1000, 0)},
    ),
    "current_stuck": Fault(about="a joint goes on telling its present current", happen=_stuck, arguments={"joint": _JOINT}),
    "encoder_offset": Fault(about="a joint's zero has moved", happen=_offset, arguments={"joint": _JOINT, "value": Number(-1, 1)}),
    "current_noise": Fault(about="louder currents", happen=_noise, arguments={"factor": Number(0, 100)}),
    "clear": Fault(about="ends every lasting fault", happen=_clear),
}
