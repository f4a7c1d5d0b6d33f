"""Configuration: one TOML file a robot → the settings that each room owns, every mistake named at once."""

import dataclasses
import difflib
import json
import os
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Interval
from pydantic import BaseModel, ConfigDict, StrictBool, StrictFloat, StrictInt, ValidationError, create_model

from monitor.acquire.schedule.windows import ScheduleSettings
from monitor.acquire.settings import ReplaySettings
from monitor.assess import AssessSettings
from monitor.config.sources import PREFIX, overridden, placed, with_credentials, without_secrets
from monitor.design.cell import Cell, cell_from_document, plain_cell
from monitor.errors import BadConfiguration, BadInput
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import Mounting, Robot, load_robot
from monitor.publish.metrics import MetricsSettings
from monitor.publish.session import BusSettings, prefix
from monitor.recording import Array, Context
from monitor.views.web.settings import PageSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSettings:
    """Which arm this is, where it is, and what it carries."""

    model: str  # a name from monitor/model/robots, e.g. "ur5"
    site: str  # part of the Zenoh keys: a–z, 0–9, _ and -
    id: str  # the same; unique within the site
    host: str = "127.0.0.1"  # address of the controller
    listen_hz: Annotated[float, Interval(ge=1.0, le=125.0)] = 10.0  # how often its state is received between replays
    mounting: str = "ground"  # ground, ceiling, wall, or "ROLL,PITCH,YAW" in degrees
    payload_kg: Annotated[float, Interval(ge=0.0, le=100.0)] = 0.0  # as set in the controller
    tool: str = "none"
    serial: str | None = None
    joint_serials: tuple[str, ...] = ()  # base to wrist, as on the type plates; one that changes is a joint without wear
    maintenance: str = ""  # the last work that may have changed friction, in your words; a change of it opens a new baseline
    gains_nm_per_a: tuple[float, ...] = ()  # joint torque per ampere; empty: the published torque constants


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreSettings:
    """Where the history lives."""

    directory: str = "var/joint-monitor"  # relative to the configuration file
    backups: Annotated[int, Interval(ge=1, le=365)] = 14  # of so many days the newest backup is kept
    recordings_days: Annotated[float, Interval(ge=0.0, le=36500.0)] = 1825.0  # older ones are let go of; their verdicts stay; 0: none is
    recordings_gb: Annotated[float, Interval(ge=0.0, le=1e6)] = 20.0  # the oldest beyond this are let go of; 0: none is
    least_free_mb: Annotated[float, Interval(ge=1.0, le=1e6)] = 500.0  # with less left on the disk nothing is replayed


@dataclass(frozen=True, slots=True, kw_only=True)
class _FlowSettings:
    """What of `AssessSettings` belongs to no single room."""

    method: Literal["ls", "wls"] = "wls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """Everything `joint-monitor run` needs, checked."""

    path: Path
    robot: RobotSettings
    schedule: ScheduleSettings
    store: StoreSettings
    replay: ReplaySettings
    bus: BusSettings
    metrics: MetricsSettings
    page: PageSettings
    assess: AssessSettings
    excitation: Excitation
    overrides: tuple[str, ...] = ()  # variables of the environment that stand in for the file

    @property
    def robot_description(self) -> Robot:
        """The robot's published parameters."""
        return load_robot(self.robot.model)

    @property
    def mounting(self) -> Mounting:
        """How the base stands in the world."""
        return Mounting.parse(self.robot.mounting)

    @property
    def gains_nm_per_a(self) -> Array | None:
        """(J,) joint torque per ampere, where the configuration says so; else the robot's published ones hold."""
        return np.array(self.robot.gains_nm_per_a) if self.robot.gains_nm_per_a else None

    @property
    def key_prefix(self) -> str:
        """Where this robot is found on the bus."""
        return prefix(self.robot.site, self.robot.id)

    @property
    def state_directory(self) -> Path:
        """Where the history lives, absolute."""
        return (self.path.parent / self.store.directory).resolve()

    @property
    def context(self) -> Context:
        """What every recording of this robot shares."""
        return Context(
            robot=self.robot.model,
            serial=self.robot.serial,
            mounting_rad=self.mounting.angles_rad,
            payload_kg=self.robot.payload_kg,
            tool=self.robot.tool,
            joint_serials=self.robot.joint_serials or None,
            maintenance=self.robot.maintenance or None,
            trajectory_digest=self.excitation.digest,
        )


def load(path: Path, environment: Mapping[str, str] | None = None) -> Configuration:
    """Read and check one configuration; variables JOINT_MONITOR__SECTION__KEY stand in for what the file says.

    environment : os.environ where not given. Raises BadConfiguration that lists every mistake with its line and key.
    """
    environment = os.environ if environment is None else environment
    try:
        text = path.read_text("utf-8-sig")  # an editor on another system may have put a mark before the first letter
        document = tomllib.loads(text)
    except OSError as error:
        raise BadConfiguration(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise BadConfiguration(f"{path}:{line}: {error.object[error.start : error.end]!r} is no UTF-8; save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise BadConfiguration(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise BadConfiguration(f"{path}: is nested too deeply; expected tables of keys") from None
    mistakes: list[str] = []
    secrets: dict[str, str] = {}
    in_file = set(document)
    overrides = overridden(document, environment, mistakes, _text_keys())
    document = with_credentials(document, environment.get("CREDENTIALS_DIRECTORY"), mistakes, secrets)
    configuration = _from_document(document, path, mistakes)
    if configuration is None:
        told = [placed(without_secrets(_by_variable(mistake, overrides, in_file), secrets), path, text) for mistake in mistakes]
        raise BadConfiguration(told[0] if len(told) == 1 else "\n  ".join((f"{path}: {len(told)} mistakes", *told)))
    return dataclasses.replace(configuration, overrides=tuple(overrides))


def _by_variable(mistake: str, overrides: Sequence[str], in_file: Collection[str]) -> str:
    """A mistake in a key that a variable of the environment has set, or in a section that only one has, is the variable's."""
    for name in overrides:
        keys = name.removeprefix(PREFIX).lower().split("__")
        places = [".".join(keys[:k]) for k in range(2, len(keys) + 1)]
        if keys[0] not in in_file:
            places.append(f"[{keys[0]}]")
        if mistake.startswith(tuple(f"{place}{sign}" for place in places for sign in (":", " ="))):
            return f"environment {name}: {mistake}"
    return mistake


def _text_keys() -> set[str]:
    """Every key that holds text, whatever stands in it: a serial number is all digits."""
    keys: set[str] = set()

    def collect(cls: type, place: str) -> None:
        for name, hint in get_type_hints(cls).items():
            if isinstance(hint, type) and dataclasses.is_dataclass(hint):
                collect(hint, f"{place}.{name}")
            elif hint is str or hint == str | None:
                keys.add(f"{place}.{name}")

    for name, cls in {**_rooms(), "replay": ReplaySettings}.items():
        collect(cls, name)
    return keys | {"replay.excitation", "replay.cell"}


def _rooms() -> dict[str, type]:
    """The sections that are one room's settings each."""
    rooms: dict[str, type] = {"robot": RobotSettings, "schedule": ScheduleSettings, "store": StoreSettings, "bus": BusSettings}
    rooms |= {"metrics": MetricsSettings, "page": PageSettings}
    return rooms | _assess_sections() | {"assess": _FlowSettings}


def from_document(document: dict[str, Any], path: Path) -> Configuration:
    """The same from a parsed document; `path` anchors relative names.

    Raises BadConfiguration that lists every mistake with its key.
    """
    mistakes: list[str] = []
    configuration = _from_document(document, path, mistakes)
    if configuration is None:
        raise BadConfiguration(f"{path}: " + "; ".join(mistakes))
    return configuration


def _from_document(document: dict[str, Any], path: Path, mistakes: list[str]) -> Configuration | None:
    document = {name: dict(section) if isinstance(section, dict) else section for name, section in document.items()}
    sections: dict[str, Any] = {}
    rooms = _rooms()
    names = [*rooms, "replay"]
    for unknown in [name for name in document if name not in names]:
        mistakes.append(f"[{unknown}]: unknown section{_nearest(unknown, names)}")
    excitation_name, repetitions, time_scale, cell_name = "", None, None, "plain"
    replay = document.get("replay", {})
    if isinstance(replay, dict):
        excitation_name = replay.pop("excitation", "")
        repetitions = replay.pop("repetitions", None)
        time_scale = replay.pop("time_scale", None)
        cell_name = replay.pop("cell", "plain")
        if not isinstance(excitation_name, str):
            mistakes.append(f"replay.excitation = {excitation_name!r}: expected the name of a shipped trajectory, or the path of a file")
            excitation_name = ""
    for name, cls in rooms.items():
        sections[name] = _section(name, cls, document.get(name, {}), mistakes)
    robot = sections["robot"]
    if "host" in (replay if isinstance(replay, dict) else {}):
        mistakes.append("replay.host: belongs into [robot]")
    host = {"host": robot.host} if robot else {"host": "127.0.0.1"}
    sections["replay"] = _section("replay", ReplaySettings, {**replay, **host} if isinstance(replay, dict) else replay, mistakes)
    excitation = None
    if robot:
        excitation = _checked(
            mistakes, "replay.excitation", lambda: find_excitation(excitation_name or f"{robot.model}-{robot.mounting}", path.parent)
        )
        _checked(mistakes, "robot.model", lambda: load_robot(robot.model))
        _checked(mistakes, "robot.mounting", lambda: Mounting.parse(robot.mounting))
        _checked(mistakes, "robot", lambda: prefix(robot.site, robot.id))
        if robot.gains_nm_per_a and (len(robot.gains_nm_per_a) != 6 or min(robot.gains_nm_per_a) <= 0):
            mistakes.append("robot.gains_nm_per_a: expected one positive figure for each of 6 joints")
    if sections["store"] and ("\0" in sections["store"].directory or not sections["store"].directory.strip()):
        mistakes.append(f"store.directory = {sections['store'].directory!r}: expected the path of a folder")
    if repetitions is not None and excitation is not None:
        if isinstance(repetitions, int) and not isinstance(repetitions, bool) and repetitions >= 1:
            excitation = dataclasses.replace(excitation, repetitions=repetitions)
        else:
            mistakes.append(f"replay.repetitions: {repetitions!r} is not a whole number of 1 or more")
    if time_scale is not None and excitation is not None:
        if isinstance(time_scale, int | float) and not isinstance(time_scale, bool) and 0 < time_scale <= 1:
            excitation = dataclasses.replace(excitation, time_scale=float(time_scale))
        else:
            mistakes.append(f"replay.time_scale: {time_scale!r}; expected more than 0, at most 1")
    if robot and sections["replay"] is not None:
        cell = _checked(mistakes, "replay.cell", lambda: find_cell(cell_name, Mounting.parse(robot.mounting), path.parent))
        sections["replay"] = dataclasses.replace(sections["replay"], cell=cell)
    if excitation is not None and robot and excitation.robot != robot.model:
        mistakes.append(f"replay.excitation: made for a {excitation.robot}, but robot.model is {robot.model}")
    bus = sections["bus"]
    for name in ("zenoh", "client_zenoh") if bus else ():
        if value := getattr(bus, name):
            if not (path.parent / value).is_file():
                mistakes.append(f"bus.{name}: {path.parent / value} does not exist")
            bus = dataclasses.replace(bus, **{name: str((path.parent / value).resolve())})
    if mistakes:
        return None
    assess = AssessSettings(method=sections["assess"].method, **{name: sections[name] for name in _assess_sections()})
    assert excitation is not None  # or there would be a mistake
    return Configuration(
        path=path,
        robot=robot,
        schedule=sections["schedule"],
        store=sections["store"],
        replay=sections["replay"],
        bus=bus,
        metrics=sections["metrics"],
        page=sections["page"],
        assess=assess,
        excitation=excitation,
    )


def shared_file(name: str) -> Path:
    """A file of `config/`, from the checkout or from the installed wheel.

    Raises BadInput where there is none.
    """
    package = Path(str(files("monitor")))
    for folder in (package / "_config", package.parent / "config"):
        if (folder / name).is_file():
            return folder / name
    raise BadInput(f"{name}: not among the files that joint-monitor ships")


def find_excitation(name: str, beside: Path) -> Excitation:
    """A trajectory by its shipped name (`ur5-ground`) or by the path of its file.

    Raises BadInput naming the shipped ones where it is neither, or what is wrong in the file.
    """
    path = beside / name
    if not path.is_file():
        try:
            path = shared_file(f"excitation/{name}.json")
        except BadInput:
            shipped = sorted(entry.stem for entry in shared_file("monitor.toml").parent.glob("excitation/*.json"))
            raise BadInput(f"{name!r} is no file beside the configuration and not shipped; shipped are {', '.join(shipped)}") from None
    try:
        return excitation_from_document(json.loads(path.read_text("utf-8")))
    except RecursionError:
        raise BadInput(f"{path}: is nested too deeply; expected an excitation's JSON object") from None
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: {error}") from None


def find_cell(name: Any, mounting: Mounting, beside: Path) -> Cell | None:
    """A site's cell: `plain` is the table-top of the mounting, `unchecked` is None, anything else the path of a TOML file.

    Raises BadInput where it is none of these, or naming every mistake in the file.
    """
    if name == "unchecked":
        return None
    if name == "plain":
        return plain_cell(mounting)
    if not isinstance(name, str) or not (beside / name).is_file():
        raise BadInput(f"{name!r} is no file beside the configuration; expected plain, unchecked or the path of a cell's TOML file")
    return load_cell(beside / name)


def load_cell(path: Path) -> Cell:
    """A cell from its TOML file.

    Raises BadInput naming every mistake.
    """
    try:
        return cell_from_document(tomllib.loads(path.read_text("utf-8")))
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not TOML: {error}") from None
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _assess_sections() -> dict[str, type]:
    hints = get_type_hints(AssessSettings)
    return {field.name: hints[field.name] for field in dataclasses.fields(AssessSettings) if dataclasses.is_dataclass(hints[field.name])}


# in the words of TOML, for what pydantic says in those of Python
_EXPECTED = {
    "string_type": "expected text in quotes",
    "tuple_type": "expected a list in square brackets",
    "bool_type": "expected true or false",
    "int_type": "expected a whole number",
    "float_type": "expected a number",
    "model_type": "expected a table",
}


def _section(name: str, cls: type, value: Any, mistakes: list[str], left_out: frozenset[Any] = frozenset()) -> Any:
    """One room's settings from its TOML table; None, with the mistakes added, where it does not fit.

    left_out : keys that were wrong, and told; what is wrong besides is told as well.
    """
    if not isinstance(value, dict):
        mistakes.append(f"{name}: expected a table [{name}]")
        return None
    schema = _schema(cls)
    wrong: set[Any]
    try:
        return _made(cls, schema.model_validate(value))
    except ValidationError as error:
        problems = [problem for problem in error.errors() if not (problem["type"] == "missing" and problem["loc"][0] in left_out)]
        for problem in problems:
            key = ".".join(str(part) for part in (name, *problem["loc"]))
            if problem["type"] == "extra_forbidden":
                mistakes.append(f"{key}: unknown key{_nearest(str(problem['loc'][-1]), _keys(cls, problem['loc'][:-1]))}")
            elif problem["type"] == "missing":
                mistakes.append(f"{key}: missing")
            else:
                said = _EXPECTED.get(problem["type"], f"{problem['msg'][0].lower()}{problem['msg'][1:]}")
                mistakes.append(f"{key} = {problem['input']!r}: {said}")
        wrong = {problem["loc"][0] for problem in problems}
    except (BadInput, ValueError) as error:  # a room may refuse a figure, or a combination, that its type allows
        # a room says its name and, where it is one key's, the key: `replay: gain = 5.0; expected …`, `schedule.cron = …`
        said = re.sub(rf"\A\[?{re.escape(name)}\]?[.:] *", "", str(error))
        named = re.match(r"\w+(?= = )", said)
        mistakes.append(f"{name}.{said}" if named else f"[{name}] {said}")
        wrong = {named[0]} if named else set()
    if wrong & value.keys():
        rest = {key: entry for key, entry in value.items() if key not in wrong}
        _section(name, cls, rest, mistakes, left_out | wrong)
    return None


# "yes" must never become allow_motion = true
_STRICT: dict[Any, Any] = {bool: StrictBool, int: StrictInt, float: StrictFloat}


def _strict(hint: Any) -> Any:
    """The type that pydantic checks, bounds kept."""
    if get_origin(hint) is Annotated:
        inner, *bounds = get_args(hint)
        return Annotated[_STRICT.get(inner, inner), *bounds]
    return _STRICT.get(hint, hint)


def _schema(cls: type) -> type[BaseModel]:
    """What pydantic checks for a room's dataclass: the same fields, nothing more, no NaN."""
    hints = get_type_hints(cls, include_extras=True)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        if hint == Cell | None:  # named in the file, and read from another
            continue
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            nested = _schema(hint)
            fields[field.name] = (nested, nested())
        else:
            fields[field.name] = (_strict(hint), ... if field.default is dataclasses.MISSING else field.default)
    return create_model(cls.__name__, __config__=ConfigDict(extra="forbid", allow_inf_nan=False), **fields)


def _made(cls: type, checked: BaseModel) -> Any:
    values = {}
    for name, hint in get_type_hints(cls).items():
        if name not in type(checked).model_fields:
            continue
        value = getattr(checked, name)
        values[name] = _made(hint, value) if isinstance(hint, type) and dataclasses.is_dataclass(hint) else value
    return cls(**values)


def _keys(cls: type, place: tuple[int | str, ...]) -> list[str]:
    """The keys that a table may have, `place` levels down."""
    for step in place:
        cls = get_type_hints(cls)[str(step)]
    return [field.name for field in dataclasses.fields(cls)]


def _nearest(word: str, known: list[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]}?)" if near else f"; known are {', '.join(known)}"


def _checked(mistakes: list[str], key: str, make: Any) -> Any:
    try:
        return make()
    except BadInput as error:
        mistakes.append(f"{key}: {error}")
        return None
