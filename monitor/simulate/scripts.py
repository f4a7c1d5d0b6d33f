"""URScript as it arrives on a port: framing, and the little of the language that this controller understands.

It is no interpreter: it recognises ur-rtde's control script and runs the register machine that the script describes
(`program.py`); besides, single `movej`, `stopj` and the immediate commands. Everything else is refused by name.
"""

import ast
import math
import re
from dataclasses import dataclass

SCRIPT_MAX_BYTES = 1 << 20
_CALL = re.compile(r"^(movej|stopj)\s*\((.*)\)$")


@dataclass(frozen=True, slots=True)
class ControlScript:
    """ur-rtde's script; registers start at these offsets (0 or 24)."""

    int_offset: int = 0
    double_offset: int = 0


@dataclass(frozen=True, slots=True)
class MoveJ:
    """One joint move [rad, rad/s, rad/s²]."""

    q_rad: tuple[float, ...]
    speed: float = 1.05  # URScript's defaults
    acceleration: float = 1.4


@dataclass(frozen=True, slots=True)
class StopJ:
    """Joint deceleration [rad/s²]."""

    deceleration: float = 2.0


@dataclass(frozen=True, slots=True)
class Immediate:
    """A line that acts beside programs: `stop program`, `set unlock protective stop`."""

    line: str


@dataclass(frozen=True, slots=True)
class Refused:
    """A script that this controller does not understand, and why."""

    reason: str


Script = ControlScript | MoveJ | StopJ | Immediate | Refused


class Framer:
    """Cuts a stream of bytes into scripts: from `def ` or `sec ` in column 0 to `end` in column 0; other lines alone."""

    def __init__(self) -> None:
        self._buffer = b""
        self._lines: list[str] = []
        self._size = 0

    def feed(self, data: bytes) -> list[str]:
        """Scripts that are complete now."""
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
        if self._size + len(self._buffer) > SCRIPT_MAX_BYTES:  # an unending script is dropped, not kept
            self._buffer, self._lines, self._size = b"", [], 0
            complete.append(f"# more than {SCRIPT_MAX_BYTES} bytes without an end")
        return complete


def parse(text: str) -> Script:
    """What a complete script asks for."""
    if text.startswith(("def rtde_control()", "def rtde_control ")) and "NODE_CONTROL_LOOP_BEGINS" in text:
        return _control_script(text)
    if text.startswith(("def ", "sec ")):
        return Refused(
            f"the program {text.splitlines()[0][4:].rstrip(':')} is not ur-rtde's control script, and others are not interpreted"
        )
    if text in {"stop program", "halt", "set unlock protective stop"}:
        return Immediate(text)
    call = _CALL.match(text)
    return _single(call[1], call[2]) if call else Refused(f"the line {text[:80]!r} is not interpreted")


def _control_script(text: str) -> Script:
    offsets = {}
    for kind in ("float", "int"):
        found = re.search(rf"# {kind} register offset\s*\n?\s*(\d+)", text)
        offsets[kind] = int(found[1]) if found else 0
    if not set(offsets.values()) <= {0, 24}:
        return Refused(f"register offsets {offsets}; expected 0 or 24")
    _, marker, after = text.partition("# inject move path\n")
    if marker and after.lstrip().split("\n", 1)[0].strip() != "end":
        return Refused("paths (a list of moves in the control script) are not interpreted")
    return ControlScript(int_offset=offsets["int"], double_offset=offsets["float"])


def _single(name: str, arguments: str) -> Script:
    try:
        call = ast.parse(f"f({arguments})", mode="eval").body
        assert isinstance(call, ast.Call)
        args = [ast.literal_eval(argument) for argument in call.args]
        named = {keyword.arg: float(ast.literal_eval(keyword.value)) for keyword in call.keywords}
        if name == "stopj":
            return StopJ(deceleration=float(args[0] if args else named.get("a", 2.0)))
        q = tuple(float(value) for value in args[0])
        acceleration, speed = ([*args[1:3], None, None])[:2]
        move = MoveJ(
            q_rad=q,
            acceleration=float(named.get("a", 1.4) if acceleration is None else acceleration),
            speed=float(named.get("v", 1.05) if speed is None else speed),
        )
    except (SyntaxError, ValueError, TypeError, IndexError, AssertionError, RecursionError, MemoryError):
        return Refused(f"the arguments of {name}({arguments[:80]}) are not interpreted")
    if not all(math.isfinite(value) for value in (*q, move.speed, move.acceleration)) or min(move.speed, move.acceleration) <= 0.0:
        return Refused(f"{name}({arguments[:80]}): expected finite positions and positive speed and acceleration")
    return move
