"""Cell: the surroundings of an arm and its tool, as a TOML file of the site describes them.

The cell's frame has its origin in the robot's base and its z axis up; it is turned about z by the mounting's yaw. So the same file serves
a robot on the ground and one on the wall.
"""

import hashlib
import json
import math
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

import numpy as np

from monitor.design.shapes import Capsules
from monitor.errors import BadInput
from monitor.model.robot import Mounting
from monitor.recording import Array

Vector = tuple[float, float, float]
TOOL_KEYS = {
    "none": ("shape",),
    "capsule": ("shape", "start_m", "end_m", "radius_m"),
    "box": ("shape", "centre_m", "size_m", "rpy_deg"),
}
PLAIN_TABLE_BELOW_M = -2.0  # height of the assumed table-top, from the base of a robot that is not on the ground


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """A keep-out plane: the space behind it is forbidden."""

    name: str
    point_m: Vector  # any point of the plane
    normal: Vector  # towards the free side; any length


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A solid box, or a keep-out space."""

    name: str
    centre_m: Vector
    size_m: Vector  # full edge lengths
    rpy_deg: Vector = (0.0, 0.0, 0.0)  # Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """The tool at the flange, in DH frame 6 (z out of the flange): a capsule from start to end, or a box."""

    shape: str = "none"  # none, capsule or box
    start_m: Vector = (0.0, 0.0, 0.0)  # capsule: one end of its axis
    end_m: Vector = (0.0, 0.0, 0.1)
    radius_m: float = 0.05
    centre_m: Vector = (0.0, 0.0, 0.05)  # box: its centre
    size_m: Vector = (0.1, 0.1, 0.1)
    rpy_deg: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a trajectory must stay away from, and the margins."""

    name: str = "cell"
    margin_m: float = 0.03  # from everything in the cell
    self_margin_m: float = 0.01  # of the arm and its tool from itself
    mounting_surface: bool = True  # the surface under the base is an infinite plane
    table_top_m: float | None = None  # height of a table-top or floor in the cell's frame
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    tool: Tool = Tool()

    def __post_init__(self) -> None:
        """Raises BadInput naming the key, its value and what would be right."""
        for key in ("margin_m", "self_margin_m"):
            value = getattr(self, key)
            if not 0.0 <= value <= 1.0:
                raise BadInput(f"cell: {key} = {value!r}; expected 0 to 1 m")
        if self.table_top_m is not None and not math.isfinite(self.table_top_m):
            raise BadInput(f"cell: table_top_m = {self.table_top_m!r}; expected a finite height")
        for wall in self.walls:
            _finite(f"wall {wall.name!r}", wall.point_m, wall.normal)
            if math.hypot(*wall.normal) < 1e-9:
                raise BadInput(f"cell: wall {wall.name!r}: normal = {wall.normal!r} has no length")
        for box in self.boxes:
            _finite(f"box {box.name!r}", box.centre_m, box.size_m, box.rpy_deg)
            if min(box.size_m) <= 0.0:
                raise BadInput(f"cell: box {box.name!r}: size_m = {box.size_m!r}; expected three positive edge lengths")
        tool = self.tool
        if tool.shape not in TOOL_KEYS:
            raise BadInput(f"cell: tool.shape = {tool.shape!r}; expected none, capsule or box")
        _finite("tool", tool.start_m, tool.end_m, tool.centre_m, tool.size_m, tool.rpy_deg, (tool.radius_m, 0.0, 0.0))
        if tool.radius_m <= 0.0 or min(tool.size_m) <= 0.0:
            raise BadInput("cell: tool.radius_m and tool.size_m must be positive")
        names = [*(wall.name for wall in self.walls), *(box.name for box in self.boxes)]
        if len(set(names)) < len(names):
            raise BadInput(f"cell: two walls or boxes share a name: {', '.join(names)}")

    def planes(self, mounting: Mounting) -> tuple[tuple[str, Array, Array], ...]:
        """Name, point (3,) and unit normal (3,) of every half-space, in the cell's frame."""
        found = []
        if self.mounting_surface:
            found.append(("mounting surface", np.zeros(3), mounting.rotation[:, 2].copy()))
        if self.table_top_m is not None:
            found.append(("table-top", np.array([0.0, 0.0, self.table_top_m]), np.array([0.0, 0.0, 1.0])))
        for wall in self.walls:
            normal = np.array(wall.normal)
            found.append((wall.name, np.array(wall.point_m), normal / np.linalg.norm(normal)))
        return tuple(found)

    @property
    def tool_capsules(self) -> Capsules | None:
        """The tool in DH frame 6. A box is covered by capsules along its longest edge, so it counts as a little larger than it is."""
        tool = self.tool
        if tool.shape == "none":
            return None
        if tool.shape == "capsule":
            ends, radius = np.array([[tool.start_m, tool.end_m]]), tool.radius_m
        else:
            ends, radius = _cover(tool)
        names, link = ("tool",) * len(ends), np.full(len(ends), 6)
        return Capsules(names=names, link=link, ends_m=ends, radius_m=np.full(len(ends), radius))

    def as_document(self) -> dict[str, Any]:
        """The tables of the cell's TOML file; `cell_from_document` is the inverse."""
        plain = json.loads(json.dumps(asdict(self)))
        document: dict[str, Any] = {"cell": {key: value for key, value in plain.items() if key not in {"walls", "boxes", "tool"}}}
        if self.table_top_m is None:
            del document["cell"]["table_top_m"]
        tool = {key: plain["tool"][key] for key in TOOL_KEYS[self.tool.shape]}
        return document | {"wall": plain["walls"], "box": plain["boxes"], "tool": tool}

    @property
    def digest(self) -> str:
        """Identifies the obstacles and margins; names are not part of it."""
        document = self.as_document()
        for part in (document["cell"], *document["wall"], *document["box"]):
            del part["name"]
        return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:16]


def cell_from_document(document: Any) -> Cell:
    """The cell in the tables [cell], [[wall]], [[box]], [tool]; a `digest` beside them is ignored.

    Raises BadInput that names every key that is unknown or wrong.
    """
    if not isinstance(document, dict):
        raise BadInput(f"cell: {type(document).__name__}; expected the tables cell, wall, box, tool")
    mistakes = [f"unknown table {key!r}; known are cell, wall, box, tool" for key in document if key not in {*_TABLES, "digest"}]
    cell = _made(Cell, document.get("cell", {}), "cell", ("walls", "boxes", "tool"), mistakes)
    walls, boxes = (_several(kind, document.get(key, []), key, mistakes) for kind, key in ((Wall, "wall"), (Box, "box")))
    tool = _made(Tool, document.get("tool", {}), "tool", (), mistakes)
    if mistakes:
        raise BadInput("cell: " + "; ".join(mistakes))
    return Cell(**cell, walls=tuple(Wall(**wall) for wall in walls), boxes=tuple(Box(**box) for box in boxes), tool=Tool(**tool))


_TABLES = ("cell", "wall", "box", "tool")


def _several(kind: type, tables: Any, key: str, mistakes: list[str]) -> list[dict[str, Any]]:
    """`_made` for each table of a list; mistakes are added to the list."""
    if not isinstance(tables, list):
        mistakes.append(f"{key}: expected tables [[{key}]]")
        return []
    return [_made(kind, table, f"{key} {number}", (), mistakes) for number, table in enumerate(tables, 1)]


def _made(kind: type, table: Any, where: str, apart: tuple[str, ...], mistakes: list[str]) -> dict[str, Any]:
    """Checked keyword arguments of a dataclass. Fields in `apart` come from elsewhere. Mistakes are added to the list."""
    if not isinstance(table, dict):
        mistakes.append(f"{where}: expected a table")
        return {}
    known = {field.name: field for field in fields(kind) if field.name not in apart}
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in known:
            mistakes.append(f"{where}: unknown key {key!r}; known are {', '.join(known)}")
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if known[key].type is Vector or known[key].type == "Vector":
            good = isinstance(value, list | tuple) and all(isinstance(part, int | float) and not isinstance(part, bool) for part in value)
            values[key] = tuple(float(part) for part in value) if good else value
        elif known[key].type is bool or known[key].type is str:
            good = isinstance(value, bool if known[key].type is bool else str)
            values[key] = value
        else:
            good = number
            values[key] = float(value) if number else value
        if not good:
            mistakes.append(f"{where}: {key} = {value!r} is not of the right kind")
    missing = [name for name, field in known.items() if field.default is MISSING and name not in table]
    mistakes += [f"{where}: {name} is missing" for name in missing]
    return values


def plain_cell(mounting: Mounting) -> Cell:
    """The cell without a file: the surface under the base, and, for a base that is not on the ground, a table-top two metres below."""
    upright = mounting.rotation[2, 2] > 0.99
    return Cell(name="plain", table_top_m=None if upright else PLAIN_TABLE_BELOW_M)


def rotation(rpy_deg: Vector) -> Array:
    """(3, 3) Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll)."""
    return Mounting.of([math.radians(angle) for angle in rpy_deg]).rotation


def _cover(tool: Tool) -> tuple[Array, float]:
    """Axes (C, 2, 3) and the radius of capsules that together hold a box: strips of its cross-section, each within a circle."""
    size = np.array(tool.size_m)
    long, wide, thin = np.argsort(-size, kind="stable")
    strips = max(1, round(float(size[wide] / size[thin])))
    radius = float(0.5 * np.hypot(size[thin], size[wide] / strips))
    ends = np.zeros((strips, 2, 3))
    ends[:, :, wide] = (((np.arange(strips) + 0.5) / strips - 0.5) * size[wide])[:, None]
    ends[:, 0, long], ends[:, 1, long] = -0.5 * size[long], 0.5 * size[long]
    return ends @ rotation(tool.rpy_deg).T + np.array(tool.centre_m), radius


def _finite(what: str, *vectors: tuple[float, ...]) -> None:
    """Raises BadInput where a vector is not three finite numbers."""
    for vector in vectors:
        if len(vector) != 3 or not all(math.isfinite(part) for part in vector):
            raise BadInput(f"cell: {what}: {vector!r}; expected three finite numbers")
