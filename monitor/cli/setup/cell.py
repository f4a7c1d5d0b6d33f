"""The cell of `init`: what stands around the arm, as a file of the cells' format."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from monitor.cli.setup.questions import Questions, number_from, numbers, text_of
from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.design.cell import Cell, Tool

_PLACE = re.compile(r"(?P<name>[^=]+)=(?P<first>[^/]+)/(?P<second>[^/]+)\Z")


class CellAnswers(NamedTuple):
    """What the options of `init` say of the cell; None and empty lists where they say nothing."""

    cell: str | None  # plain, or a file
    table_top_m: float | None
    walls: list[str]  # NAME=X,Y,Z/NX,NY,NZ
    boxes: list[str]  # NAME=X,Y,Z/DX,DY,DZ
    tool_length_m: float | None
    tool_radius_m: float | None

    @property
    def describe(self) -> bool:
        """Whether one of the options describes something."""
        return bool(self.walls or self.boxes) or self.table_top_m is not None or self.tool_length_m is not None


def cell_of(answers: CellAnswers, ask: Questions, beside: Path) -> "str | Cell":
    """`plain`, the name of a cell's file beside the configuration, or a cell that has no file yet.

    Raises BadInput where an answer is no cell.
    """
    if answers.cell is not None and answers.describe:
        raise BadInput("--cell names a file or plain; --table-top, --wall, --box and --tool-length describe another cell: give one of both")
    if answers.describe:
        return _described(answers)
    ask.say("\nWhat stands around the arm? `plain` is the surface below its base and nothing else; `describe` asks for it;")
    ask.say("the path of a cell's TOML file names one that you have (config/cell/example.toml shows everything that can be said).")

    def known(text: str) -> None:
        if text not in {"plain", "describe"} and not (beside / text).is_file():
            raise BadInput(f"{text!r} is no file beside the configuration; expected plain, describe or the path of a cell's TOML file")

    chosen = ask.answer("--cell", answers.cell, "Cell", "plain", text_of(known))
    if chosen != "describe":
        return chosen
    if not ask.asks:
        raise BadInput("--cell describe asks for the cell, and --no-input asks nothing; expected plain or the path of a cell's TOML file")
    return _asked(answers, ask)


def _described(answers: CellAnswers) -> "Cell":
    """The cell of the options alone."""
    from monitor.design.cell import Box, Cell, Wall

    walls = [Wall(name=name, point_m=first, normal=second) for name, first, second in map(_wall, answers.walls)]
    boxes = [Box(name=name, centre_m=first, size_m=second) for name, first, second in map(_box, answers.boxes)]
    return Cell(name="cell", table_top_m=answers.table_top_m, walls=tuple(walls), boxes=tuple(boxes), tool=_tool(answers))


def _asked(answers: CellAnswers, ask: Questions) -> "Cell":
    """The cell from answers, obstacle by obstacle."""
    from monitor.design.cell import Box, Cell, Wall

    ask.say("The origin is the robot's base, z points up; metres. An empty answer is none.")
    top = ask.answer("--table-top", None, "Height of the table-top or floor below the base, e.g. -0.4", "", numbers(1, "height"))
    walls: list[Wall] = []
    boxes: list[Box] = []
    while name := ask.answer("--wall", None, f"Name of wall {len(walls) + 1}", "", text_of()):
        point = ask.answer("--wall", None, "  a point of it X,Y,Z", None, numbers(3, "coordinates"))
        normal = ask.answer("--wall", None, "  its normal to the arm's side X,Y,Z", None, numbers(3, "coordinates"))
        walls.append(Wall(name=name, point_m=_three(point), normal=_three(normal)))
    while name := ask.answer("--box", None, f"Name of box {len(boxes) + 1}, something solid", "", text_of()):
        centre = ask.answer("--box", None, "  its centre X,Y,Z", None, numbers(3, "coordinates"))
        size = ask.answer("--box", None, "  its edge lengths X,Y,Z", None, numbers(3, "lengths"))
        boxes.append(Box(name=name, centre_m=_three(centre), size_m=_three(size)))
    length = ask.answer("--tool-length", None, "Length of the tool from the flange (0: none)", "0", number_from(0.0, 2.0))
    radius = ask.answer("--tool-radius", None, "Its radius", "0.05", number_from(0.001, 1.0)) if length else None
    tool = _tool(answers._replace(tool_length_m=length or None, tool_radius_m=radius))
    return Cell(name="cell", table_top_m=top[0] if top else None, walls=tuple(walls), boxes=tuple(boxes), tool=tool)


def _tool(answers: CellAnswers) -> "Tool":
    from monitor.design.cell import Tool

    if answers.tool_length_m is None:
        return Tool()
    radius = 0.05 if answers.tool_radius_m is None else answers.tool_radius_m
    return Tool(shape="capsule", start_m=(0.0, 0.0, 0.0), end_m=(0.0, 0.0, answers.tool_length_m), radius_m=radius)


def _wall(text: str) -> tuple[str, tuple[float, float, float], tuple[float, float, float]]:
    return _place(text, "--wall", "NAME=X,Y,Z/NX,NY,NZ: a point of the wall, and its normal to the arm's side")


def _box(text: str) -> tuple[str, tuple[float, float, float], tuple[float, float, float]]:
    return _place(text, "--box", "NAME=X,Y,Z/DX,DY,DZ: its centre, and its edge lengths")


def _place(text: str, option: str, expected: str) -> tuple[str, tuple[float, float, float], tuple[float, float, float]]:
    from monitor.cli.options import figures

    match = _PLACE.match(text)
    if match is None:
        raise BadInput(f"{option} {text!r}: expected {expected} [m]")
    first, second = (tuple(figures(match[part], f"{option} {match['name']}", 3, "coordinates").tolist()) for part in ("first", "second"))
    return match["name"].strip(), _three(first), _three(second)


def _three(values: tuple[float, ...]) -> tuple[float, float, float]:
    if len(values) != 3:
        raise BadInput(f"{values}: expected X,Y,Z")
    return values[0], values[1], values[2]
