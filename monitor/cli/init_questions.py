"""What `joint-monitor init` asks: a person, by question and answer; the cell around the arm; and the controller."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import typer

from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.acquire.survey import Survey
    from monitor.design.cell import Cell, Tool

Answer = TypeVar("Answer")
_PLACE = re.compile(r"(?P<name>[^=]+)=(?P<first>[^/]+)/(?P<second>[^/]+)\Z")


class Questions:
    """Asks what no option has answered. With `ask` false nothing is asked: the default counts."""

    def __init__(self, ask: bool) -> None:
        self.asks = ask

    def say(self, text: str = "") -> None:
        """A sentence before a question; silent where nothing is asked."""
        if self.asks:
            typer.echo(text)

    def answer(self, option: str, given: Any, question: str, default: Any, read: Callable[[str], Answer]) -> Answer:
        """The answer to one question: the option's, else the person's, else the default.

        read : makes the answer of a text; raises BadInput where it is none. default : as text; None: there is none.

        Raises BadInput where the option is wrong, where there is no answer, and where nobody is there to give one.
        """
        if given is not None:
            return _of_option(option, str(given), read)
        if not self.asks:
            if default is None:
                raise BadInput(f"{option} is missing ({question}), and --no-input asks nobody; nothing was written")
            return _of_option(option, str(default), read)
        try:
            text: Answer = typer.prompt(question, default=default, value_proc=lambda text: _checked(text, read))
        except typer.Abort:
            typer.echo(err=True)
            raise BadInput(f"no answer to {question!r}, nothing was written; {option} answers it, --no-input asks nothing") from None
        return text

    def confirm(self, option: str, given: bool | None, question: str, *, default: bool) -> bool:
        """A yes or a no. Raises BadInput where nobody is there to give one."""
        if given is not None or not self.asks:
            return default if given is None else given
        try:
            return typer.confirm(question, default=default)
        except typer.Abort:
            typer.echo(err=True)
            raise BadInput(f"no answer to {question!r}, nothing was written; {option} answers it, --no-input asks nothing") from None


def _of_option(option: str, text: str, read: Callable[[str], Answer]) -> Answer:
    try:
        return read(text)
    except BadInput as error:
        raise BadInput(f"{option}: {error}") from None


def _checked(text: str, read: Callable[[str], Answer]) -> Answer:
    """The answer, or an error after which the question is asked again."""
    try:
        return read(text)
    except BadInput as error:
        raise typer.BadParameter(str(error)) from None


def text_of(allowed: Callable[[str], object] | None = None) -> Callable[[str], str]:
    """Reads a text. allowed : raises BadInput for a text that is not."""

    def read(text: str) -> str:
        text = text.strip()
        if allowed is not None:
            allowed(text)
        return text

    return read


def number_from(least: float, most: float) -> Callable[[str], float]:
    """Reads a number from least to most."""

    def read(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            raise BadInput(f"{text!r} is no number; expected {least:g} to {most:g}") from None
        if not least <= number <= most:
            raise BadInput(f"{text} is outside of {least:g} to {most:g}")
        return number

    return read


def numbers(count: int, what: str) -> Callable[[str], tuple[float, ...]]:
    """Reads so many comma-separated numbers, or none at all."""

    def read(text: str) -> tuple[float, ...]:
        from monitor.cli.options import figures

        return () if text.strip() in {"", "-"} else tuple(figures(text, "the answer", count, what).tolist())

    return read


def listed(values: tuple[float, ...]) -> str:
    """Figures as an answer that can be typed; - for none."""
    return ",".join(f"{value:g}" for value in values) or "-"


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


def cell_of(answers: CellAnswers, ask: Questions, folder: Path) -> "str | Cell":
    """`plain`, the name of a cell's file in the configuration's folder, or a cell that has no file yet.

    Raises BadInput where an answer is no cell.
    """
    if answers.cell is not None and answers.describe:
        raise BadInput("--cell names a file or plain; --table-top, --wall, --box and --tool-length describe another cell: give one of both")
    if answers.describe:
        return _described(answers)
    ask.say("\nWhat stands around the arm? `plain` is the surface below its base and nothing else; `describe` asks for it;")
    ask.say("the path of a cell's TOML file names one that you have (config/cell/example.toml shows everything that can be said).")

    def known(text: str) -> None:
        if text not in {"plain", "describe"} and not (folder / text).is_file():
            raise BadInput(f"{text!r} is no file in the configuration's folder; expected plain, describe or the path of a cell's TOML file")

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


def reached(host: str | None, ask: Questions, *, simulated: bool, robot_api_port: int) -> tuple[str, "Survey"]:
    """The address of the controller, and what it says. One that a person gives and that does not answer is asked for once more.

    host : the option; None where it is not given. robot_api_port : of a PolyScope X. Raises BadInput where it is no address.
    """
    read, default = text_of(_address), "127.0.0.1" if simulated else "-"
    address = ask.answer("--host", host, "Address of the controller (- for none yet)", default, read)
    found = _survey(address, ask.asks, robot_api_port)
    while ask.asks and host is None and address != "-" and found.identity is None:
        again = ask.answer("--host", None, f"Address of the controller (Enter keeps {address}, - for none yet)", address, read)
        if again == address:
            break
        address, found = again, _survey(again, ask.asks, robot_api_port)
    return address, found


def _address(text: str) -> None:
    """Raises BadInput where a text is no address at which an arm would be moved; - is none yet."""
    from monitor.acquire.safety.of_configuration import local_address
    from monitor.errors import MotionRefused

    if text == "-":
        return
    try:
        local_address(text)
    except MotionRefused as error:
        raise BadInput(str(error)) from None


def _survey(address: str, asks: bool, robot_api_port: int) -> "Survey":
    """What the arm says, and a line for a person about it."""
    from monitor.acquire.driver import driver_of
    from monitor.acquire.survey import Survey, survey
    from monitor.views.terminal.progress import status

    if address == "-":
        return Survey()
    with status(f"asking {address}"):
        found = survey(address, driver=driver_of("universal_robots", robot_api_port=robot_api_port))
    if found.identity is not None:
        said = [found.model or "model unknown", f"serial {found.serial or 'unknown'}", f"software {found.identity.firmware or 'unknown'}"]
        typer.echo(f"{address} answers: {', '.join(said)}")
    if found.problem is not None:
        typer.echo(f"{found.problem}\nWhat it does not say {'is asked' if asks else 'needs an option, or has its default'}.", err=True)
    return found
