"""The steps of a program: what takes time or has an effect. A call of URScript becomes a step here."""

import math
from dataclasses import dataclass
from typing import Any

from monitor.simulate.machine.moves import Comply, Move, StopMotion
from monitor.simulate.program.language import TEXT_MAX, ScriptError

INTEGER = 2**31  # an integer register holds −INTEGER … INTEGER − 1
REGISTERS = 48


@dataclass(frozen=True, slots=True)
class Write:
    """A write_output_integer_register or a write_output_float_register."""

    register: int
    value: float
    whole: bool


@dataclass(frozen=True, slots=True)
class PathProgress:
    """A signal_async_progress, which ur-rtde inserts into its paths."""

    value: int


@dataclass(frozen=True, slots=True)
class Wait:
    """A sleep; `sync()` waits for the next control period."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Say:
    """A textmsg."""

    text: str


@dataclass(frozen=True, slots=True)
class Declare:
    """A set_payload, set_target_payload, set_tcp or set_gravity: what the controller computes with from now on."""

    what: str
    figures: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Output:
    """A set_standard_digital_out, or one of a configurable or a tool output; outputs count as in RTDE's bits."""

    number: int
    on: bool


@dataclass(frozen=True, slots=True)
class ProtectiveStop:
    """A protective_stop()."""


@dataclass(frozen=True, slots=True)
class Servo:
    """A servoj: the joints follow a target (J,) [rad] for a time [s]; the look-ahead time [s] and the gain smooth the way."""

    target: tuple[float, ...]
    seconds: float
    lookahead_s: float
    gain: float


@dataclass(frozen=True, slots=True)
class Speed:
    """A speedj [rad/s, rad/s²] or, if straight, a speedl of the tool [m/s and rad/s, m/s²], for a time [s]."""

    speed: tuple[float, ...]
    acceleration: float
    seconds: float
    straight: bool


@dataclass(frozen=True, slots=True)
class Watch:
    """An rtde_set_watchdog: what happens when an input arrives less often than `min_frequency_hz`: "stop", "pause" or "ignore"."""

    variable: str
    min_frequency_hz: float
    action: str


@dataclass(frozen=True, slots=True)
class Popup:
    """A popup; a blocking one holds its thread until it is closed."""

    text: str
    blocking: bool


@dataclass(frozen=True, slots=True)
class Run:
    """The start of a thread. The one who plays the program answers with the number of the thread."""

    thread: str


@dataclass(frozen=True, slots=True)
class Kill:
    """The end of a thread; a number that no thread has ends nothing."""

    number: int


@dataclass(frozen=True, slots=True)
class Join:
    """The wait for the end of a thread."""

    number: int


@dataclass(frozen=True, slots=True)
class Critical:
    """The beginning or the end of a section in which no other thread of the program runs."""

    begins: bool


@dataclass(frozen=True, slots=True)
class ForceMode:
    """The beginning of force control, or its end with None."""

    comply: Comply | None


@dataclass(frozen=True, slots=True)
class Freedrive:
    """The beginning or the end of freedrive."""

    begins: bool


Threading = Run | Kill | Join | Critical
Acting = Write | PathProgress | Say | Declare | Output | ProtectiveStop | Watch | ForceMode | Freedrive
Step = Move | StopMotion | Servo | Speed | Wait | Popup | Acting | Threading

STEPS = frozenset(  # the calls that make a step
    (
        *("movej", "movel", "servoj", "speedj", "speedl", "stopj", "stopl", "sleep", "sync", "textmsg", "popup", "protective_stop"),
        *("rtde_set_watchdog", "run", "kill", "join", "enter_critical", "exit_critical"),
        *("write_output_integer_register", "write_output_float_register", "signal_async_progress"),
        *("set_payload", "set_target_payload", "set_tcp", "set_gravity"),
        *("set_standard_digital_out", "set_configurable_digital_out", "set_tool_digital_out", "set_digital_out"),
    )
)
WATCHDOG_ACTIONS = ("stop", "pause", "ignore")
OUTPUTS = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2), "digital": (0, 8)}  # first bit and number of outputs


def takes_time(step: Step) -> bool:
    """Whether time passes in this step."""
    return isinstance(step, Move | StopMotion | Servo | Speed | Wait | Join | Popup)


def step_of(name: str, arguments: list[Any], named: dict[str, Any]) -> Step:
    """The step that a call makes. Raises ScriptError for arguments that no real controller accepts, or that are not simulated."""
    try:
        step, figures = _step(name, arguments, named)
    except (TypeError, ValueError, IndexError, KeyError, OverflowError):
        raise ScriptError(f"runtime_error: the arguments of {name}({str(arguments)[1 : TEXT_MAX + 1]}) are wrong") from None
    if not all(map(math.isfinite, figures)):
        raise ScriptError(f"runtime_error: {name} expects finite figures")
    return step


def _step(name: str, arguments: list[Any], named: dict[str, Any]) -> tuple[Step, list[float]]:
    match name:
        case "movej" | "movel":
            return _move(name, arguments, named)
        case "servoj" | "speedj" | "speedl":
            return _stream(name, arguments, named)
        case "rtde_set_watchdog":
            return _watch(*arguments, **named)
        case "run":
            return Run(str(arguments[0])), []
        case "kill" | "join":
            number = int(arguments[0])
            return (Kill if name == "kill" else Join)(number), []
        case "enter_critical" | "exit_critical":
            return Critical(name == "enter_critical"), []
        case "stopj" | "stopl":
            deceleration = float(arguments[0] if arguments else named.get("a", 2.0))
            return StopMotion(deceleration, name == "stopl"), [deceleration]
        case "write_output_integer_register" | "write_output_float_register":
            return _write(name, int(arguments[0]), float(arguments[1]))
        case "signal_async_progress":
            return PathProgress(int(arguments[0])), []
        case "sleep":
            seconds = float(arguments[0])
            return Wait(seconds), [seconds]
        case "sync":
            return Wait(0.0), []
        case "textmsg":
            return Say("".join(map(text_of, arguments))), []
        case "popup":
            shown = dict(zip(("s", "title", "warning", "error", "blocking"), arguments, strict=False)) | named
            return Popup(text_of(shown["s"]), bool(shown.get("blocking", False))), []
        case "protective_stop":
            return ProtectiveStop(), []
        case "set_payload" | "set_target_payload" | "set_tcp" | "set_gravity":
            given = [*arguments, *named.values()]
            figures = [float(figure) for value in given for figure in (value if isinstance(value, list) else [value])]
            return Declare(name, tuple(figures)), figures
        case _:
            first, count = OUTPUTS[name.split("_")[1]]
            number = int(arguments[0])
            if not 0 <= number < count:
                raise ScriptError(f"runtime_error: {name}: output {number}; expected 0 … {count - 1}")
            return Output(first + number, bool(arguments[1])), []


def _move(name: str, arguments: list[Any], named: dict[str, Any]) -> tuple[Step, list[float]]:
    straight = name == "movel"
    pose = getattr(arguments[0], "is_pose", False)
    target = tuple(float(value) for value in arguments[0])
    given = (*arguments[1:3], None, None)
    acceleration = float(named.get("a", given[0] if given[0] is not None else 1.2 if straight else 1.4))  # the defaults of URScript
    speed = float(named.get("v", given[1] if given[1] is not None else 0.25 if straight else 1.05))
    if float(named.get("t", arguments[3] if len(arguments) > 3 else 0.0)) != 0.0:
        raise ScriptError(f"not simulated: {name} with a time t; give speed and acceleration")
    if len(target) != 6 or min(speed, acceleration) <= 0.0:
        raise ScriptError(f"runtime_error: {name} expects 6 finite figures and positive speed and acceleration")
    return Move(target, pose, straight, speed, acceleration), [*target, speed, acceleration]


def _stream(name: str, arguments: list[Any], named: dict[str, Any]) -> tuple[Step, list[float]]:
    """A servoj, speedj or speedl. The defaults are those of URScript."""
    target = tuple(float(value) for value in arguments[0])
    if len(target) != 6:
        raise ScriptError(f"runtime_error: {name} expects 6 figures")
    if name == "servoj":  # servoj(q, a, v, t, lookahead_time, gain): a and v have no effect
        given = dict(zip(("a", "v", "t", "lookahead_time", "gain"), arguments[1:], strict=False)) | named
        time_s, lookahead_s = float(given.get("t", 0.002)), float(given.get("lookahead_time", 0.1))
        # a target that is not a number is a protective stop, and no wrong argument
        return Servo(target, time_s, lookahead_s, float(given.get("gain", 300.0))), []
    given = dict(zip(("a", "t", "aRot"), arguments[1:], strict=False)) | named
    acceleration, time_s = float(given.get("a", 1.4 if name == "speedj" else 1.2)), float(given.get("t", 0.0))
    return Speed(target, acceleration, time_s, name == "speedl"), [time_s]


def _watch(variable: str, min_frequency: float, action: str = "pause") -> tuple[Step, list[float]]:
    if action not in WATCHDOG_ACTIONS:
        raise ScriptError(f"runtime_error: rtde_set_watchdog: action {action!r}; expected one of {', '.join(WATCHDOG_ACTIONS)}")
    if action != "ignore" and float(min_frequency) <= 0.0:
        raise ScriptError(f"runtime_error: rtde_set_watchdog: {min_frequency:g} Hz; expected more than 0")
    return Watch(str(variable), float(min_frequency), action), [float(min_frequency)]


def _write(name: str, register: int, value: float) -> tuple[Step, list[float]]:
    step = Write(register, value, "integer" in name)
    if not 0 <= register < REGISTERS:
        raise ScriptError(f"runtime_error: {name}: register {register}; expected 0 … {REGISTERS - 1}")
    if step.whole and not -INTEGER <= value < INTEGER:
        raise ScriptError(f"runtime_error: {name}: {value:g}; expected a whole number of 32 bits")
    return step, [value]


def text_of(value: Any) -> str:
    """A value as textmsg and to_str write it."""
    if isinstance(value, list):
        return ("p[" if getattr(value, "is_pose", False) else "[") + ",".join(map(text_of, value)) + "]"
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
