"""What the commands share: options, the reading of figures and configurations, JSON on standard output, signals."""

import json
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from monitor.errors import BadInput

if TYPE_CHECKING:
    from monitor.config.schema import Configuration
    from monitor.publish.client import Client
    from monitor.recording import Array

Commands = Mapping[str, Callable[..., None]]  # of one topic: name on the command line → function


class Group(NamedTuple):
    """A command with words of its own, as in `joint-monitor plant status`."""

    default: Callable[..., None]  # what it does without a further word
    words: Commands


LAWS = "{laws}"  # stands in the help of an option for the names of the friction laws: their registry imports numpy, which is slow
EXIT_CONFIG = 78  # EX_CONFIG of sysexits.h; the unit file tells systemd not to restart after it
FIGURES_HELP = "one figure a joint, comma-separated"
CONFIG_VARIABLE = "JOINT_MONITOR_CONFIG"  # names the configuration where --config does not
FOR_ALL = Path("/etc/joint-monitor")  # where the service looks for configurations, NAME.toml
CONFIG_HELP = f"The robot's TOML file, or NAME for {FOR_ALL}/NAME.toml."


def complete_model(incomplete: str) -> list[str]:
    """The models of arms that begin so; the shell asks."""
    from monitor.model.robot import robot_names

    return [name for name in robot_names() if name.startswith(incomplete)]


def complete_scenario(incomplete: str) -> list[str]:
    """The shipped scenarios that begin so; the shell asks."""
    from monitor.simulate.scenario import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


def complete_cell(incomplete: str) -> list[str]:
    """The simulated cells that begin so; the shell asks."""
    from monitor.simulate.cells.catalogue import CELLS

    return [name for name in CELLS if name.startswith(incomplete)]


ConfigOption = Annotated[Path, typer.Option("--config", "-c", help=CONFIG_HELP, envvar=CONFIG_VARIABLE, show_default=False)]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace a file that exists.")]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
RobotOption = Annotated[
    str | None,
    typer.Option(help="Model, e.g. ur5, or a .toml of an arm of yours.", autocompletion=complete_model, show_default=False),
]
UrdfOption = Annotated[Path | None, typer.Option(help="Instead of a model: any serial arm of 1 to 8 turning joints.", show_default=False)]
MountingOption = Annotated[str, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees.")]
MountingOrNoneOption = Annotated[str | None, typer.Option(help="ground, ceiling, wall or ROLL,PITCH,YAW in degrees.", show_default=False)]
ColumnsOption = Annotated[
    str | None,
    typer.Option(help="What columns are: NAME:COUNT,… in order, or NAME=COLUMN,… by names, as q_{1..6}.", show_default=False),
]
RateOption = Annotated[float | None, typer.Option("--rate", help="Rows a second of files that tell no time.", show_default=False)]
GainsOption = Annotated[str | None, typer.Option(help=f"Joint torque per ampere [N·m/A]: {FIGURES_HELP}.", show_default=False)]
FilesArgument = Annotated[list[Path] | None, typer.Argument(metavar="[FILE…]", help="Recordings of one arm.", show_default=False)]
MANIFEST_HELP = "CSV: file, recorded_at[, payload_kg, mounting, note, maintenance, joint_serials, revolutions]."
ManifestOption = Annotated[Path | None, typer.Option(help=MANIFEST_HELP, show_default=False)]
IntervalOption = Annotated[str | None, typer.Option(help="Files say no time: they are so far apart, e.g. 1d.", show_default=False)]
TRAJECTORY_HELP = "All are of one trajectory, some stopped early: what they share is compared, under this name."
TrajectoryNameOption = Annotated[str | None, typer.Option(help=TRAJECTORY_HELP, show_default=False)]
RecordingOutputOption = Annotated[Path, typer.Option("--output", "-o", help="Where the recording goes (Parquet).", show_default=False)]
ReportOutputOption = Annotated[Path | None, typer.Option("--output", "-o", help="The report (.html), one file.", show_default=False)]
FromOption = Annotated[str | None, typer.Option("--from", help="Time, e.g. 2026-01-31 or 2026-01-31T03:00:00Z.", show_default=False)]
ToOption = Annotated[str | None, typer.Option("--to", help="Time, not included.", show_default=False)]


def load_configuration(path: Path, *, secrets_needed: bool = True, reads_files: bool = False) -> "Configuration":
    """Read the configuration of one robot from its TOML file, or from NAME.toml of the service's folder where only a name is given.

    secrets_needed, reads_files : as of `load`. Raises BadConfiguration, which names every mistake.
    """
    from monitor.config.load import load

    return load(named_configuration(path), secrets_needed=secrets_needed, reads_files=reads_files)


def named_configuration(path: Path) -> Path:
    """The file of a configuration: the path itself, or NAME.toml of the service's folder where `path` is a name and no file."""
    is_name = path.name == str(path) and not path.suffix and not path.exists()
    return FOR_ALL / f"{path}.toml" if is_name else path


def joint_number(text: str, joints: int, option: str = "--joint") -> int:
    """The number of a joint, from 1, by its number, J3, or the name that PolyScope shows. Raises BadInput.

    joints : of the arm.
    """
    given = " ".join(text.casefold().replace("-", " ").replace("_", " ").split())
    number = given.removeprefix("joint ").removeprefix("j")
    if number.isascii() and number.isdigit() and 1 <= int(number) <= joints:
        return int(number)
    from monitor.reason import JOINT_NAMES

    names = [name.casefold() for name in JOINT_NAMES[:joints]]
    if given.replace(" ", "") in (squeezed := [name.replace(" ", "") for name in names]):
        return squeezed.index(given.replace(" ", "")) + 1
    raise BadInput(f"{option} {text!r}: expected 1 to {joints}, or one of {', '.join(names)}")


def refuse_no_time(option: str, text: str) -> None:
    """Raises BadInput where the text is no date or time, before any history or daemon is asked."""
    from monitor.publish.timestamps import unix_s

    try:
        unix_s(text)
    except ValueError:
        raise BadInput(f"{option} {text!r}: not a date or time; expected e.g. 2026-01-31 or 2026-01-31T14:00:00Z") from None


def refuse_overwriting(path: Path | None, force: bool) -> None:
    """Raises BadInput where an output exists already and nobody asked for it to be replaced."""
    if path is not None and path.exists() and not force:
        raise BadInput(f"{path} exists; nothing was done. Give another name, or --force to replace it")


def client_of(configuration: "Configuration") -> "Client":
    """A bus client for the daemon of this configuration. Raises BusError where nobody answers."""
    from monitor.publish.client import Client

    endpoint = (configuration.bus.connect or configuration.bus.listen)[0]
    return Client(endpoint, configuration.robot.site, configuration.robot.id, zenoh_file=configuration.bus.client_zenoh)


def print_json(document: object, *, indent: int | None = 1) -> None:
    """Print one JSON document on standard output. Raises ValueError for NaN, which JSON does not have."""
    typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False, indent=indent))


def figures(text: str, option: str, count: int, what: str = "figures, one a joint") -> "Array":
    """Read the comma-separated figures of an option as an array (count,).

    what : names the figures in an error message. Raises BadInput where they are not `count` finite numbers.
    """
    import numpy as np

    expected = f"expected {count} {what}, finite and comma-separated"
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise BadInput(f"{option} {text!r}: not numbers; {expected}") from None
    if len(numbers) != count:
        raise BadInput(f"{option} {text!r}: {len(numbers)} given; {expected}")
    if not np.all(np.isfinite(numbers)):
        raise BadInput(f"{option} {text!r}: not finite; {expected}")
    return numbers


def optional_figures(text: str | None, option: str, count: int) -> "Array | None":
    """Like `figures`; None where the option is absent."""
    return None if text is None else figures(text, option, count)


class StopRequest:
    """Counts how often a person or the system has asked the command to stop.

    A threading.Event could block: a second signal inside the first one's handler would wait for the event's lock for ever.
    """

    def __init__(self) -> None:
        self.count = 0

    def ask(self, *_: object) -> None:
        """Count one more request. This is the signal handler."""
        self.count += 1

    def is_set(self) -> bool:
        """Whether a request has come."""
        return self.count > 0


@contextmanager
def stop_on(*signals: signal.Signals) -> Iterator[StopRequest]:
    """While the context lasts, these signals request a stop and do not end the process. Afterwards the earlier handlers are in place."""
    request = StopRequest()
    before = {number: signal.signal(number, request.ask) for number in signals}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
