"""URScript as it arrives on a port: framing, and the part of the language that this controller understands.

This is not an interpreter. It recognises four kinds of scripts: ur-rtde's control script with the path of moves that ur-rtde injects
into it (`control.py` runs what that script describes); programs that are a list of moves, waits and register writes; single moves;
and immediate commands. It refuses every other script and names the line.
"""

import ast
import math
import re
from dataclasses import dataclass
from typing import Any

from monitor.simulate.controller.moves import Move, StopMotion

SCRIPT_MAX_BYTES = 1 << 20
STEPS_MAX = 10_000
INTEGER = 2**31  # an integer register holds −INTEGER … INTEGER − 1
_CALL = re.compile(r"^(\w+)\s*\((.*)\)$")
_POSE = re.compile(r"\bp(?=\[)")
PATH_MARK = "# inject move path\n"


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
    """A sleep."""

    seconds: float


Step = Move | StopMotion | Write | PathProgress | Wait


@dataclass(frozen=True, slots=True)
class ControlScript:
    """ur-rtde's control script: the offsets of its registers (0 or 24), and the path that ur-rtde injected into it."""

    int_offset: int = 0
    double_offset: int = 0
    path: tuple[Step, ...] = ()


@dataclass(frozen=True, slots=True)
class Steps:
    """A program that is a list of steps: a custom script of ur-rtde or a single line."""

    steps: tuple[Step, ...]
    secondary: bool = False  # a secondary program does not end the one that runs


@dataclass(frozen=True, slots=True)
class Immediate:
    """A line that acts at once and is no program: `stop program`, `halt` or `set unlock protective stop`."""

    line: str


@dataclass(frozen=True, slots=True)
class Refused:
    """A script that this controller does not run, with the reason."""

    reason: str


Script = ControlScript | Steps | Immediate | Refused


class Framer:
    """Cuts a stream of bytes into scripts.

    A script begins with `def ` or `sec ` in column 0 and ends with `end` in column 0. Every other line is a script of its own.
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._lines: list[str] = []
        self._size = 0

    def feed(self, data: bytes) -> list[str]:
        """Add bytes to the stream. Returns the scripts that are now complete."""
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        complete = []
        for raw in lines:
            line = raw.decode("utf-8", "replace").rstrip("\r")
            self._size += len(raw) + 1
            if self._lines:
                self._lines.append(line)
                if line.rstrip() == "end":
                    complete.append("\n".join(self._lines))
                    self._lines, self._size = [], 0
            elif line.startswith(("def ", "sec ")):
                self._lines = [line]
            else:
                self._size = 0
                if line.strip():
                    complete.append(line.strip())
        if self._size + len(self._buffer) > SCRIPT_MAX_BYTES:  # a script without an end would fill the memory
            self._buffer, self._lines, self._size = b"", [], 0
            complete.append(f"more than {SCRIPT_MAX_BYTES} bytes without an end")
        return complete


class _UnknownLine(Exception):
    """The controller does not understand a line."""


def parse(text: str) -> Script:
    """Parse one complete script."""
    try:
        if text.startswith(("def rtde_control()", "def rtde_control ")) and "NODE_CONTROL_LOOP_BEGINS" in text:
            return _control_script(text)
        if text.startswith(("def ", "sec ")):
            name, *body = text.splitlines()
            try:
                steps = _steps(body[:-1])
                if text.startswith("sec ") and not all(isinstance(step, Write) for step in steps):
                    return Refused(f"the secondary program {name[4:].rstrip(':')[:80]} moves or waits; it may take no time")
                return Steps(steps, secondary=text.startswith("sec "))
            except _UnknownLine as wrong:
                return Refused(
                    f"the program {name[4:].rstrip(':')[:80]} is not ur-rtde's control script, and of others only lists of moves: {wrong}"
                )
        if text in {"stop program", "halt", "set unlock protective stop"}:
            return Immediate(text)
        steps = _steps([text])
        return Steps(steps) if steps else Refused(f"the line {text[:80]!r} does nothing")
    except _UnknownLine as wrong:
        return Refused(str(wrong))


def _control_script(text: str) -> Script:
    offsets = {}
    for kind in ("float", "int"):
        found = re.search(rf"# {kind} register offset\s*\n?\s*(\d+)", text)
        offsets[kind] = int(found[1]) if found else 0
    if not set(offsets.values()) <= {0, 24}:
        return Refused(f"register offsets {offsets}; expected 0 or 24")
    _, marker, after = text.partition(PATH_MARK)
    path = re.split(r"^\s*end\s*$", after, maxsplit=1, flags=re.MULTILINE)[0] if marker else ""
    return ControlScript(int_offset=offsets["int"], double_offset=offsets["float"], path=_steps(path.splitlines()))


def _steps(lines: list[str]) -> tuple[Step, ...]:
    steps = []
    for raw in lines:
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        call = _CALL.match(line)
        if call is None:
            raise _UnknownLine(f"the line {line[:80]!r} is not interpreted")
        step = _step(call[1], call[2])
        if step is not None:
            steps.append(step)
        if len(steps) > STEPS_MAX:
            raise _UnknownLine(f"more than {STEPS_MAX} steps")
    return tuple(steps)


def _step(name: str, arguments: str) -> Step | None:
    """One call as a step; None if the call has no effect here. Raises _UnknownLine."""
    if name in {"textmsg", "sync"}:
        return None
    pose = _POSE.match(arguments.strip()) is not None
    try:
        args, named = _arguments(_POSE.sub("", arguments))
        match name:
            case "movej" | "movel":
                target = tuple(float(value) for value in args[0])
                straight = name == "movel"
                given = (*args[1:3], None, None)
                acceleration = named.get("a", given[0] if given[0] is not None else 1.2 if straight else 1.4)  # the defaults of URScript
                speed = named.get("v", given[1] if given[1] is not None else 0.25 if straight else 1.05)
                step: Step = Move(target, pose, straight, float(speed), float(acceleration))
                if float(named.get("t", args[3] if len(args) > 3 else 0.0)) != 0.0:
                    raise _UnknownLine(f"{name}({arguments[:80]}): a time t is not interpreted; give speed and acceleration")
                figures = [*target, float(speed), float(acceleration)]
                if len(target) != 6 or min(figures[6:]) <= 0.0:
                    raise _UnknownLine(f"{name}({arguments[:80]}): expected 6 finite figures and positive speed and acceleration")
            case "stopj" | "stopl":
                figures = [float(args[0] if args else named.get("a", 2.0))]
                step = StopMotion(figures[0], name == "stopl")
            case "write_output_integer_register" | "write_output_float_register":
                register, figures = int(args[0]), [float(args[1])]
                step = Write(register, figures[0], "integer" in name)
                if not 0 <= register < 48:
                    raise _UnknownLine(f"{name}: register {register}; expected 0 … 47")
                if step.whole and not -INTEGER <= figures[0] < INTEGER:
                    raise _UnknownLine(f"{name}: {figures[0]:g}; expected a whole number of 32 bits")
            case "signal_async_progress":
                step, figures = PathProgress(int(args[0])), []
            case "sleep":
                figures = [float(args[0])]
                step = Wait(figures[0])
            case _:
                raise _UnknownLine(f"the line {name}({arguments[:80]}) is not interpreted")
    except (SyntaxError, ValueError, TypeError, IndexError, KeyError, OverflowError, RecursionError, MemoryError):
        raise _UnknownLine(f"the arguments of {name}({arguments[:80]}) are not interpreted") from None
    if not all(math.isfinite(figure) for figure in figures):
        raise _UnknownLine(f"{name}({arguments[:80]}): expected finite figures")
    return step


def _arguments(text: str) -> tuple[list[Any], dict[str, float]]:
    """The positional and named arguments of a call. A sum of two numbers counts as a number, since ur-rtde writes `0 +24`."""
    call = ast.parse(f"f({text})", mode="eval").body
    if not isinstance(call, ast.Call):
        raise ValueError(text)

    def value(node: ast.expr) -> Any:
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            return ast.literal_eval(node.left) + ast.literal_eval(node.right)
        return ast.literal_eval(node)

    return [value(node) for node in call.args], {str(keyword.arg): float(ast.literal_eval(keyword.value)) for keyword in call.keywords}
