"""Cell: what stands around an arm, and what it carries. A TOML file of the site.

The cell's frame is the world's at the robot's base: the base's origin, z up, turned about z as the mounting's yaw says. So the same
file fits a robot on the ground and one on the wall.
"""

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from monitor.design.shapes import Capsules
from monitor.errors import BadInput
from monitor.model.robot import Mounting
from monitor.recording import Array

Vector = tuple[float, float, float]
PLAIN_TABLE_BELOW_M = -2.0  # under a ceiling or beside a wall the table-top is so far below the base


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """A keep-out plane: everything behind it is forbidden."""

    name: str
    point_m: Vector  # any point of it
    normal: Vector  # to the free side; any length


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Something solid, or a keep-out space."""

    name: str
    centre_m: Vector
    size_m: Vector  # full edge lengths
    rpy_rad: Vector = (0.0, 0.0, 0.0)  # Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """What is at the flange, in DH frame 6 (z out of the flange): a capsule from start to end, or a box."""

    shape: str = "none"  # none, capsule or box
    start_m: Vector = (0.0, 0.0, 0.0)  # capsule: ends of its axis
    end_m: Vector = (0.0, 0.0, 0.1)
    radius_m: float = 0.05
    centre_m: Vector = (0.0, 0.0, 0.05)  # box
    size_m: Vector = (0.1, 0.1, 0.1)
    rpy_rad: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a trajectory must not touch, and by how much it must stay away."""

    name: str = "cell"
    margin_m: float = 0.03  # from everything of the cell
    self_margin_m: float = 0.01  # of the arm from itself, tool included
    mounting_surface: bool = True  # what the base is bolted to is a plane without end
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
            _finite(f"box {box.name!r}", box.centre_m, box.size_m, box.rpy_rad)
            if min(box.size_m) <= 0.0:
                raise BadInput(f"cell: box {box.name!r}: size_m = {box.size_m!r}; expected three positive edge lengths")
        tool = self.tool
        if tool.shape not in {"none", "capsule", "box"}:
            raise BadInput(f"cell: tool.shape = {tool.shape!r}; expected none, capsule or box")
        _finite("tool", tool.start_m, tool.end_m, tool.centre_m, tool.size_m, tool.rpy_rad, (tool.radius_m, 0.0, 0.0))
        if tool.radius_m <= 0.0 or min(tool.size_m) <= 0.0:
            raise BadInput("cell: tool.radius_m and tool.size_m must be positive")
        names = [part.name for part in (*self.walls, *self.boxes)]
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
        """The tool in DH frame 6; a box is covered by capsules along its longest edge, so it is taken for a little larger than it is."""
        tool = self.tool
        if tool.shape == "none":
            return None
        if tool.shape == "capsule":
            ends, radius = np.array([[tool.start_m, tool.end_m]]), tool.radius_m
        else:
            ends, radius = _cover(tool)
        return Capsules(
            names=("tool",) * len(ends), link=np.full(len(ends), 6), ends_m=ends, radius_m=np.full(len(ends), radius)
        )

    def as_document(self) -> dict[str, Any]:
        """Plain JSON or TOML; `cell_from_document` is its inverse."""
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        if self.table_top_m is None:
            del document["table_top_m"]
        return document

    @property
    def digest(self) -> str:
        """Identifies what there is to hit; names do not enter."""
        document = self.as_document()
        del document["name"]
        for part in (*document["walls"], *document["boxes"]):
            del part["name"]
        if self.tool.shape == "none":
            document["tool"] = {"shape": "none"}
        return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:16]


def plain_cell(mounting: Mounting) -> Cell:
    """Where nothing was said: the surface under the base, and if that is not the ground, a table-top two metres below."""
    upright = mounting.rotation[2, 2] > 0.99
    return Cell(name="plain", table_top_m=None if upright else PLAIN_TABLE_BELOW_M)


def rotation(rpy_rad: Vector) -> Array:
    """(3, 3) Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll)."""
    return Mounting(roll_rad=rpy_rad[0], pitch_rad=rpy_rad[1], yaw_rad=rpy_rad[2]).rotation


def _cover(tool: Tool) -> tuple[Array, float]:
    """(C, 2, 3) axes and the radius of capsules that together hold a box: strips of its cross-section, each in a circle."""
    size = np.array(tool.size_m)
    long, wide, thin = np.argsort(-size, kind="stable")
    strips = max(1, round(float(size[wide] / size[thin])))
    radius = float(0.5 * np.hypot(size[thin], size[wide] / strips))
    ends = np.zeros((strips, 2, 3))
    ends[:, :, wide] = (((np.arange(strips) + 0.5) / strips - 0.5) * size[wide])[:, None]
    ends[:, 0, long], ends[:, 1, long] = -0.5 * size[long], 0.5 * size[long]
    return ends @ rotation(tool.rpy_rad).T + np.array(tool.centre_m), radius


def _finite(what: str, *vectors: tuple[float, ...]) -> None:
    for vector in vectors:
        if len(vector) != 3 or not all(math.isfinite(part) for part in vector):
            raise BadInput(f"cell: {what}: {vector!r}; expected three finite numbers")
