"""The settings of the plant, and their file: strict, every mistake at once, as of a robot's configuration. I/O."""

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

from annotated_types import Interval

from monitor.config.sections import nearest, of_section, read_section
from monitor.config.sources import PREFIX, Source
from monitor.errors import BadInput
from monitor.plant.screen.settings import ScreenSettings
from monitor.publish.session import BusSettings, MetricsSettings

FOR_ALL = Path("/etc/joint-monitor-plant.toml")  # of the shipped unit
EMBEDDED = "plant.sqlite"
DRIVER, OF_FILE = "postgresql+psycopg", "sqlite:///"
OF_SERVICE = ("screen", "metrics")  # sections that the running plant alone reads
OF_GATEWAY = ("gateway", "notify", "tickets", "mqtt", "opcua", "ros2")  # sections that `joint-monitor gateway` reads in the same file


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSettings:
    """Where the arms are, and where their histories go."""

    connect: tuple[str, ...] = ("tcp/127.0.0.1:7447",)  # routers behind which arms are, or arms themselves
    zenoh: str = ""  # path of a Zenoh configuration (JSON5): certificates or passwords for the routers
    directory: str = "var/joint-monitor-plant"  # of the embedded database; relative to this file
    database: str = ""  # "postgresql+psycopg://USER@HOST/NAME"; empty: SQLite in the directory
    workers: Annotated[int, Interval(ge=1, le=32)] = 4  # arms whose histories are copied at the same time
    silent_s: Annotated[float, Interval(ge=15.0, le=3600.0)] = 60.0  # [s] an arm that says nothing for longer is shown as silent
    # [d] of older replays what they were identified of is taken away, their verdicts stay; as an arm's recordings_days; 0: no limit
    identified_days: Annotated[float, Interval(ge=0.0, le=36500.0)] = 1825.0

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong. A database's address is not repeated: it may hold a password."""
        if not self.connect:
            raise BadInput('connect = []: no arm can be reached; expected an endpoint, e.g. ["tcp/router.example:7447"]')
        BusSettings(connect=self.connect)  # refuses what is no endpoint
        if len(set(self.connect)) != len(self.connect):
            raise BadInput("connect names an endpoint twice")
        if self.database and not re.match(rf"{re.escape(DRIVER)}://[^\s]*/[^/\s?]+(\?\S*)?\Z|sqlite:///[^?\0]+\Z", self.database):
            raise BadInput(f'database: expected "{DRIVER}://USER@HOST/NAME", "sqlite:///PATH", or nothing for SQLite in the directory')
        for name in ("directory", "zenoh"):
            if "\0" in getattr(self, name):
                raise BadInput(f"{name} = {getattr(self, name)!r}: no name of a file holds the sign NUL")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantConfiguration:
    """The checked configuration of the plant."""

    path: Path | None  # None: there is no file, and everything has its default
    plant: PlantSettings
    screen: ScreenSettings = field(default_factory=ScreenSettings)
    metrics: MetricsSettings = field(default_factory=MetricsSettings)
    overrides: tuple[str, ...] = ()  # variables of the environment that replace values of the file

    @property
    def folder(self) -> Path:
        """From which relative paths start."""
        return Path.cwd() if self.path is None else self.path.absolute().parent

    @property
    def directory(self) -> Path:
        """The absolute path of the plant's own folder: a service's state directory where the file names none."""
        of_service = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
        if of_service and self.plant.directory == PlantSettings().directory:
            return Path(of_service)
        if self.path == FOR_ALL and self.plant.directory == PlantSettings().directory:
            return Path("/var/lib/joint-monitor-plant")  # commands find it where the service has it
        return (self.folder / self.plant.directory).resolve()

    @property
    def database(self) -> str | Path:
        """The address of the database, which may hold a password, or the path of the embedded one: a relative one begins at this file."""
        if self.plant.database.startswith(OF_FILE):
            return self.folder / self.plant.database.removeprefix(OF_FILE)
        return self.plant.database or self.directory / EMBEDDED

    @property
    def zenoh_file(self) -> str:
        """The absolute path of the Zenoh configuration; empty: there is none."""
        return str(self.folder / self.plant.zenoh) if self.plant.zenoh else ""


def default_path(folder: Path = Path()) -> Path | None:
    """The file that is meant where none is named: plant.toml in this folder, else the service's; None where there is neither."""
    return next((path for path in (folder / "plant.toml", FOR_ALL) if os.path.isfile(path)), None)


def load_plant(path: Path | None, environment: Mapping[str, str] | None = None, *, database_alone: bool = False) -> PlantConfiguration:
    """Read and check the configuration of the plant. JOINT_MONITOR__PLANT__KEY replaces a value of the file.

    path : None means that everything has its default. database_alone : for whoever reads the database and needs no credential of screen
    or metrics. Raises BadConfiguration that lists every mistake with its line and key.
    """
    running = {} if database_alone else {"screen": ScreenSettings, "metrics": MetricsSettings}
    read = load_sections(path, {"plant": PlantSettings, **running}, (*OF_SERVICE, *OF_GATEWAY), environment)
    return PlantConfiguration(path=path, overrides=read.overrides, **read.settings)


class Sections(NamedTuple):
    """What a file of the plant says."""

    settings: dict[str, Any]  # by section
    overrides: tuple[str, ...]  # variables of the environment that replace values of the file
    secrets: dict[str, str]  # the texts of the credentials, by name


def load_sections(
    path: Path | None, own: Mapping[str, type], others: Collection[str], environment: Mapping[str, str] | None = None
) -> Sections:
    """Read and check sections of a file of the plant.

    own : the settings class of each section. others : sections that the file may have for another program; they are not read, so that
    no program needs another one's credentials. Raises BadConfiguration that lists every mistake with its line and key.
    """
    environment = os.environ if environment is None else environment
    source = Source(Path("environment"), "", {}) if path is None else Source.read(path)
    prefixes = tuple(f"{PREFIX}{name.upper()}__" for name in own)
    source.override({name: value for name, value in environment.items() if name.startswith(prefixes)}, _text_keys(own))
    source.document = {name: value for name, value in source.document.items() if name in own or name not in others}
    source.take_credentials(environment.get("CREDENTIALS_DIRECTORY"))
    known = list(dict.fromkeys((*own, *others)))
    source.mistakes += [of_section(name, f": unknown section{nearest(name, known)}") for name in source.document if name not in own]
    settings = {name: read_section(name, cls, source.document.get(name, {}), source.mistakes) for name, cls in own.items()}
    source.refuse()
    return Sections(settings, source.overrides, source.secrets)


def _text_keys(own: Mapping[str, type]) -> set[str]:
    """The keys whose value is text, also where it looks like a number."""
    return {f"{section}.{name}" for section, cls in own.items() for name, hint in get_type_hints(cls).items() if hint is str}
