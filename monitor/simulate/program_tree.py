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
from monitor.simulate.faults import Flag, Kind, Number, Text, check

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
    nodes = document.pop("node", [])
    known: dict[str, Kind] = {"name": Text(file.stem), "loop": Flag(default=True)}
    program = check(f"program {file}", known, document)
    if not program["name"].isidentifier():
        raise BadInput(f"program {file}: name = {program['name']!r}; expected letters, digits and _")
    if not isinstance(nodes, list) or not nodes:
        raise BadInput(f"program {file}: expected one or more [[node]]")
    made = tuple(_node(f"program {file}: node {i}", node, file.parent) for i, node in enumerate(nodes, start=1))
    return ProgramTree(program["name"], made, program["loop"])


NOT_NEGATIVE = Number(0.0, 1e6)
NODES: dict[str, Kind] = {"wait": NOT_NEGATIVE, "message": Text(), "script": Text(), "external_control": Text()}  # besides `move`


def _node(where: str, given: Any, folder: Path) -> Node:
    """One node. Raises BadInput."""
    if not isinstance(given, dict) or sum(kind in given for kind in ("move", *NODES)) != 1:
        raise BadInput(f"{where}: expected exactly one of move, {', '.join(NODES)}")
    q = given.pop("move", None)
    own: dict[str, Kind] = {name: kind for name, kind in NODES.items() if name in given}
    pace: dict[str, Kind] = {
        "speed": NOT_NEGATIVE._replace(default=SPEED_RAD_S),
        "acceleration": NOT_NEGATIVE._replace(default=ACCELERATION_RAD_S2),
    }
    values = check(where, {**own, **pace}, given)
    if q is not None:
        if not isinstance(q, list) or len(q) != 6 or not all(isinstance(value, int | float) for value in q):
            raise BadInput(f"{where}: move = {q!r}; expected 6 joint positions [rad]")
        return Node(move=tuple(map(float, q)), **values)
    if "wait" in values:
        return Node(wait=values["wait"])
    if "message" in values:
        return Node(message=values["message"].replace('"', "'"))
    if "script" in values:
        try:
            return Node(script=(folder / values["script"]).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as wrong:
            raise BadInput(f"{where}: script: {wrong}") from None
    address, _, port = values["external_control"].partition(":")
    if port and not port.isdigit():
        raise BadInput(f"{where}: external_control = {given['external_control']!r}; expected ADDRESS or ADDRESS:PORT")
    return Node(external_control=Host(address, int(port or DEFAULT_PORT)))


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
