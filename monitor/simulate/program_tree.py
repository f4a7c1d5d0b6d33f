"""A production program as a tree of nodes, and the URScript that PolyScope makes of it at Play.

A node that hands the arm over ("External Control") asks another host for its text when the script is made, and not when the node is
reached. The part of that text between HEADER_BEGIN and HEADER_END stands once at the top of the program, the rest at every such node.
Where the host does not answer, the node becomes a popup that blocks the program; on a PolyScope X it does nothing, and says nothing.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import BadInput

HEADER_BEGIN, HEADER_END = "# HEADER_BEGIN", "# HEADER_END"
DEFAULT_PORT = 50002  # where the manufacturer's External Control asks
SPEED_RAD_S, ACCELERATION_RAD_S2 = 1.05, 1.4  # URScript's defaults of a movej


class Host(NamedTuple):
    """Where a node asks for its text."""

    address: str
    port: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One step of a program; exactly one field is given."""

    move: tuple[float, ...] | None = None  # (6,) joint positions [rad]
    wait: float | None = None  # [s]
    message: str | None = None
    script: str | None = None  # text of a script node, as a file on the controller
    external_control: Host | None = None
    speed: float = SPEED_RAD_S
    acceleration: float = ACCELERATION_RAD_S2


@dataclass(frozen=True, slots=True)
class ProgramTree:
    """A program: its nodes are played in order, and again and again if it loops."""

    name: str
    nodes: tuple[Node, ...]
    loop: bool = True

    @property
    def hosts(self) -> tuple[Host, ...]:
        """The hosts that are asked at Play, each once."""
        return tuple(dict.fromkeys(node.external_control for node in self.nodes if node.external_control is not None))

    def script(self, served: Mapping[Host, str | None], *, silent: bool = False) -> str:
        """The URScript of the program. `served` holds the text of each host; None where it did not answer: popup, or `silent`."""
        headers, body = [], []
        for host in self.hosts:
            header, _ = _parts(served.get(host) or "")
            headers += header
        for node in self.nodes:
            body += _lines(node, served, silent=silent)
        inner = [f"  {line}" for line in body]
        if self.loop:
            inner = ["while True:", *inner, "  sync()", "end"]
        return "\n".join([f"def {self.name}():", *headers, *inner, "end"])


def load_tree(file: Path) -> ProgramTree:
    """Read a program from TOML: `name`, `loop`, and a list of `[[node]]` with one of move, wait, message, script and external_control.

    Raises BadInput with the file, the node and what is expected.
    """
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as wrong:
        raise BadInput(f"program {file}: {wrong}") from None
    name, loop, nodes = document.get("name", file.stem), document.get("loop", True), document.get("node", [])
    unknown = sorted(set(document) - {"name", "loop", "node"})
    if unknown:
        raise BadInput(f"program {file}: {', '.join(unknown)} is not known; known are name, loop and [[node]]")
    if not isinstance(name, str) or not name.isidentifier():
        raise BadInput(f"program {file}: name = {name!r}; expected letters, digits and _")
    if not isinstance(loop, bool):
        raise BadInput(f"program {file}: loop = {loop!r}; expected true or false")
    if not isinstance(nodes, list) or not nodes:
        raise BadInput(f"program {file}: expected one or more [[node]]")
    return ProgramTree(name, tuple(_node(f"program {file}: node {i}", node, file.parent) for i, node in enumerate(nodes, start=1)), loop)


KINDS = ("move", "wait", "message", "script", "external_control")


def _node(where: str, given: Any, folder: Path) -> Node:
    """One node. Raises BadInput."""
    if not isinstance(given, dict) or sum(kind in given for kind in KINDS) != 1:
        raise BadInput(f"{where}: expected exactly one of {', '.join(KINDS)}")
    unknown = sorted(set(given) - {*KINDS, "speed", "acceleration"})
    if unknown:
        raise BadInput(f"{where}: {', '.join(unknown)} is not known; known are {', '.join(KINDS)}, speed and acceleration")
    speed = _number(where, given, "speed", SPEED_RAD_S)
    acceleration = _number(where, given, "acceleration", ACCELERATION_RAD_S2)
    if "move" in given:
        q = given["move"]
        if not isinstance(q, list) or len(q) != 6 or not all(isinstance(value, int | float) for value in q):
            raise BadInput(f"{where}: move = {q!r}; expected 6 joint positions [rad]")
        return Node(move=tuple(map(float, q)), speed=speed, acceleration=acceleration)
    if "wait" in given:
        return Node(wait=_number(where, given, "wait", 0.0))
    if "message" in given:
        return Node(message=_text(where, given, "message").replace('"', "'"))
    if "script" in given:
        file = folder / _text(where, given, "script")
        try:
            return Node(script=file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as wrong:
            raise BadInput(f"{where}: script: {wrong}") from None
    address, _, port = _text(where, given, "external_control").partition(":")
    if port and not port.isdigit():
        raise BadInput(f"{where}: external_control = {given['external_control']!r}; expected ADDRESS or ADDRESS:PORT")
    return Node(external_control=Host(address, int(port or DEFAULT_PORT)))


def _number(where: str, given: Mapping[str, Any], key: str, default: float) -> float:
    value = given.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e6:
        raise BadInput(f"{where}: {key} = {value!r}; expected a number that is not negative")
    return float(value)


def _text(where: str, given: Mapping[str, Any], key: str) -> str:
    if not isinstance(given[key], str) or not given[key]:
        raise BadInput(f"{where}: {key} = {given[key]!r}; expected a text")
    return str(given[key])


def _lines(node: Node, served: Mapping[Host, str | None], *, silent: bool) -> list[str]:
    """The lines of one node at its place."""
    if node.move is not None:
        return [f"movej({list(node.move)}, a={node.acceleration!r}, v={node.speed!r})"]
    if node.wait is not None:
        return [f"sleep({node.wait!r})"]
    if node.message is not None:
        return [f'textmsg("{node.message}")']
    if node.script is not None:
        return node.script.splitlines()
    assert node.external_control is not None
    text = served.get(node.external_control)
    if text is None and silent:
        return []
    if text is None:
        address, port = node.external_control
        return [f'popup("The connection to the remote PC at {address}:{port} could not be established", blocking=True)']
    return _parts(text)[1]


def _parts(text: str) -> tuple[list[str], list[str]]:
    """The lines of the header and those of the node of a served text; a text without marks is all node."""
    before, begin, after = text.partition(HEADER_BEGIN)
    header, end, body = after.partition(HEADER_END)
    return (header.splitlines(), body.splitlines()) if begin and end else ([], before.splitlines())
