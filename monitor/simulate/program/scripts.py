"""URScript as it arrives on a port: framing, and what a script is.

A script is one of four kinds: ur-rtde's control script with the path of moves that ur-rtde injects into it (`control.py` runs what that
script describes); a program in the part of the language that `language.py` understands; an immediate line; and everything else, which is
refused with the line and the reason. A program that names what the controller's version does not know is refused whole, as a real one is:
reported of functions in public (for example "Compile error: name 'str_cat' is not defined"), assumed of a function's parameters.
"""

import re
from dataclasses import dataclass

from monitor.simulate.polyscope import Version, unknown_names
from monitor.simulate.program.interpreter import FUNCTIONS, NeedsMachine, run
from monitor.simulate.program.language import ScriptError, Source, parsed
from monitor.simulate.program.steps import STEPS, Step, takes_time

SCRIPT_MAX_BYTES = 1 << 20
STEPS_MAX = 10_000
PATH_MARK = "# inject move path\n"
CONTROL_NAME = "rtde_control"  # the name of ur-rtde's control script
LINE_NAME = "unnamed"  # the name of a program that is a single line
IMMEDIATE = frozenset(  # lines that act at once and are no program
    (
        "stop program",
        "halt",
        "set unlock protective stop",
        "power on",
        "power off",
        "set robotmode run",
        "close popup",
        "close safety popup",
    )
)


@dataclass(frozen=True, slots=True)
class ControlScript:
    """ur-rtde's control script: the offsets of its registers (0 or 24), and the path that ur-rtde injected into it."""

    int_offset: int = 0
    double_offset: int = 0
    path: tuple[Step, ...] = ()
    name: str = CONTROL_NAME


@dataclass(frozen=True, slots=True)
class Immediate:
    """A line that acts at once and is no program."""

    line: str


@dataclass(frozen=True, slots=True)
class Refused:
    """A script that this controller does not run: why, and what a controller reports at which place of the script."""

    reason: str
    report: str = ""
    line: int = 1
    column: int = 1


Script = ControlScript | Source | Immediate | Refused


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


def parse(text: str, *, recognise: bool = True, version: Version | None = None) -> Script:
    """Parse one complete script.

    `recognise` tells whether ur-rtde's control script becomes a ControlScript, or a program as any other. `version` is that whose names a
    program may use; None: those of every version.
    """
    try:
        if version is not None:
            _check_names(text, version)
        if recognise and text.startswith(("def rtde_control()", "def rtde_control ")) and "NODE_CONTROL_LOOP_BEGINS" in text:
            return _control_script(text)
        if text in IMMEDIATE:
            return Immediate(text)
        return _program(text)
    except ScriptError as wrong:
        where = "" if "\n" not in text else f"the program {text.split(chr(10), maxsplit=1)[0][4:].rstrip(':')[:80]}, line {wrong.line}: "
        return Refused(f"{where}{wrong.text}", wrong.text, wrong.line, wrong.column)


def _check_names(text: str, version: Version) -> None:
    """Raises ScriptError where a line calls what this version does not know, and the program does not define itself."""
    unknown = unknown_names(version)
    for found in unknown.finditer(text) if unknown else ():
        name, at = found[found.lastindex or 0], found.start(found.lastindex or 0)
        line_at = text.rfind("\n", 0, at) + 1
        function = re.match(r"\w+", found[0])
        own = function is not None and re.search(rf"^\s*def\s+{function[0]}\s*\(", text, re.MULTILINE) is not None
        if not own and "#" not in text[line_at:at]:
            raise ScriptError(f"compile_error_name_not_found:{name}:", text.count("\n", 0, at) + 1, at - line_at + 1)


def _program(text: str) -> Source:
    """A program, or a single line. Raises ScriptError for what is not understood, and for what cannot be run wherever the arm is."""
    program = parsed(text, LINE_NAME, {*STEPS, *FUNCTIONS})
    if program.straight:
        try:
            steps = _steps(program)
        except NeedsMachine:
            return program
        if program.secondary and any(map(takes_time, steps)):
            raise ScriptError("a secondary program may take no time; this one moves or waits")
    return program


def _control_script(text: str) -> Script:
    offsets = {}
    for kind in ("float", "int"):
        found = re.search(rf"# {kind} register offset\s*\n?\s*(\d+)", text)
        offsets[kind] = int(found[1]) if found else 0
    if not set(offsets.values()) <= {0, 24}:
        return Refused(f"register offsets {offsets}; expected 0 or 24")
    _, marker, after = text.partition(PATH_MARK)
    path = re.split(r"^\s*end\s*$", after, maxsplit=1, flags=re.MULTILINE)[0] if marker else ""
    steps = _steps(parsed(path, CONTROL_NAME, STEPS)) if path.strip() else ()
    return ControlScript(int_offset=offsets["int"], double_offset=offsets["float"], path=steps)


def _steps(program: Source) -> tuple[Step, ...]:
    """The steps of a program that does not ask for the state of the controller. Raises ScriptError, or NeedsMachine if it asks."""
    steps = []
    for step in run(program, None):
        steps.append(step)
        if len(steps) > STEPS_MAX:
            raise ScriptError(f"more than {STEPS_MAX} steps")
    return tuple(steps)
