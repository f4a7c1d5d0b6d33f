"""Loading a configuration: one TOML file becomes the settings that each room owns, and all mistakes are named at once. I/O."""

import dataclasses
import math
import os
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from monitor.acquire.settings import ReplaySettings
from monitor.config.files import find_cell, find_excitation, find_prior
from monitor.config.schema import Configuration, RobotSettings, StoreSettings, assess_sections, retired_keys, section_classes, text_keys
from monitor.config.sections import nearest, read_section
from monitor.config.sources import PREFIX, overridden, placed, with_credentials, without_secrets
from monitor.errors import BadConfiguration, BadInput
from monitor.judge.assess import AssessSettings
from monitor.judge.inspection import InspectionSettings
from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting, load_robot
from monitor.publish.session import BusSettings, prefix
from monitor.publish.timestamps import unix_s

Made = TypeVar("Made")

ETC, STATE = Path("/etc/joint-monitor"), Path("/var/lib/joint-monitor")  # of the shipped unit: NAME.toml and the history of NAME


def load(path: Path, environment: Mapping[str, str] | None = None, *, secrets_needed: bool = True) -> Configuration:
    """Read and check one configuration. Variables JOINT_MONITOR__SECTION__KEY replace values of the file.

    environment : os.environ where not given. secrets_needed : where false, credentials are not read.
    Raises BadConfiguration that lists every mistake with its line and key.
    """
    environment = os.environ if environment is None else environment
    try:
        text = path.read_text("utf-8-sig")  # some editors put a byte order mark before the first letter
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
    overrides = overridden(document, environment, mistakes, text_keys())
    _place_history(document, path, environment)
    if secrets_needed:
        document = with_credentials(document, environment.get("CREDENTIALS_DIRECTORY"), mistakes, secrets)
    configuration = _from_document(document, path, mistakes)
    if configuration is None:
        placed_mistakes = [placed(without_secrets(_by_variable(mistake, overrides, in_file), secrets), path, text) for mistake in mistakes]
        listed = "\n  ".join((f"{path}: {len(placed_mistakes)} mistakes", *placed_mistakes))
        raise BadConfiguration(placed_mistakes[0] if len(placed_mistakes) == 1 else listed)
    return dataclasses.replace(configuration, overrides=tuple(overrides))


def _place_history(document: dict[str, Any], path: Path, environment: Mapping[str, str]) -> None:
    """Where nothing is said of [store] directory, a service's history is in its state directory; commands find it there too."""
    store = document.setdefault("store", {})
    if not isinstance(store, dict) or "directory" in store:
        return
    if os.path.exists(path.parent / StoreSettings().directory / "history.sqlite"):
        return  # an earlier version began it beside the file, and it goes on there
    of_service = environment.get("STATE_DIRECTORY", "").split(":")[0]
    if of_service:  # systemd.exec(5), StateDirectory=
        store["directory"] = of_service
    elif path.absolute().parent == ETC:
        store["directory"] = str(STATE / path.stem)


def _by_variable(mistake: str, overrides: Sequence[str], in_file: Collection[str]) -> str:
    """The mistake with the name of the environment's variable that has set this key, or alone has made this section."""
    for name in overrides:
        keys = name.removeprefix(PREFIX).lower().split("__")
        places = [".".join(keys[:k]) for k in range(2, len(keys) + 1)]
        if keys[0] not in in_file:
            places.append(f"[{keys[0]}]")
        if mistake.startswith(tuple(f"{place}{sign}" for place in places for sign in (":", " ="))):
            return f"environment {name}: {mistake}"
    return mistake


def from_document(document: dict[str, Any], path: Path) -> Configuration:
    """The configuration from a parsed document; relative names start from the folder of `path`.

    Raises BadConfiguration that lists every mistake with its key.
    """
    mistakes: list[str] = []
    configuration = _from_document(document, path, mistakes)
    if configuration is None:
        raise BadConfiguration(f"{path}: " + "; ".join(mistakes))
    return configuration


class _Trajectory(NamedTuple):
    """The keys of [replay] that choose the trajectory and the cell; they are no settings of the replay itself."""

    excitation: Any = ""  # text, once it is checked
    repetitions: Any = None
    time_scale: Any = None
    cell: Any = "plain"


def _from_document(document: dict[str, Any], path: Path, mistakes: list[str]) -> Configuration | None:
    """The checked configuration; None, with the mistakes added in the order in which they are reported."""
    document = {name: dict(section) if isinstance(section, dict) else section for name, section in document.items()}
    classes = section_classes()
    names = [*classes, "replay"]
    for unknown in [name for name in document if name not in names]:
        mistakes.append(f"[{unknown}]: unknown section{nearest(unknown, names)}")
    replay = document.get("replay", {})
    chosen = _taken_from(replay, mistakes) if isinstance(replay, dict) else _Trajectory()
    drift = document.get("drift", {})
    prior = drift.pop("prior", "") if isinstance(drift, dict) else ""
    sections = {name: read_section(name, cls, document.get(name, {}), mistakes) for name, cls in classes.items()}
    robot: RobotSettings | None = sections["robot"]
    sections["replay"] = _replay_section(replay, robot, mistakes)
    excitation = None
    if robot:
        shipped = f"{robot.model}-{robot.mounting}"
        _check_robot(robot, mistakes)
        if chosen.excitation or not any(mistake.startswith(("robot.model:", "robot.mounting:")) for mistake in mistakes):
            excitation = _checked(mistakes, "replay.excitation", lambda: find_excitation(chosen.excitation or shipped, path.parent))
        if sections["drift"] and not any(mistake.startswith("robot.model:") for mistake in mistakes):
            speed = sections["drift"].reference_speed_rad_s
            found = _checked(mistakes, "drift.prior", lambda: find_prior(prior, robot.model, speed, path.parent))
            sections["drift"] = dataclasses.replace(sections["drift"], prior=found)
    if sections["store"] and ("\0" in sections["store"].directory or not sections["store"].directory.strip()):
        mistakes.append(f"store.directory = {sections['store'].directory!r}: expected the path of a folder")
    if excitation is not None:
        excitation = _adapted(excitation, chosen, mistakes)
    if robot and sections["replay"] is not None:
        cell = _checked(mistakes, "replay.cell", lambda: find_cell(chosen.cell, Mounting.parse(robot.mounting), path.parent))
        sections["replay"] = dataclasses.replace(sections["replay"], cell=cell)
        if sections["replay"].allow_motion is True:
            _check_gains(robot, mistakes)
    if excitation is not None and robot and excitation.robot != robot.model:
        mistakes.append(f"replay.excitation: made for a {excitation.robot}, but robot.model is {robot.model}")
    if sections["inspection"]:
        _check_inspection(sections["inspection"], mistakes)
    sections["bus"] = _with_zenoh_files(sections["bus"], path, mistakes)
    if mistakes:
        return None
    assert excitation is not None  # or there would be a mistake
    assert robot is not None  # likewise
    rooms = ("schedule", "store", "replay", "bus", "metrics", "page", "production", "inspection")
    assess = AssessSettings(method=sections["assess"].method, **{name: sections[name] for name in assess_sections()})
    made = {name: sections[name] for name in rooms}
    return Configuration(path=path, robot=robot, assess=assess, excitation=excitation, notices=_notices(document), **made)


def _notices(document: dict[str, Any]) -> tuple[str, ...]:
    """A sentence for each key of the file that is read and not documented any more."""
    retired = retired_keys()
    present = [f"{section}.{key}" for section, table in document.items() if isinstance(table, dict) for key in table]
    return tuple(f"{key} is no longer needed ({retired[key]})" for key in present if key in retired)


def _taken_from(replay: dict[str, Any], mistakes: list[str]) -> _Trajectory:
    """Take the trajectory's keys out of the table [replay]."""
    chosen = _Trajectory(**{name: replay.pop(name) for name in _Trajectory._fields if name in replay})
    if not isinstance(chosen.excitation, str):
        mistakes.append(f"replay.excitation = {chosen.excitation!r}: expected the name of a shipped trajectory, or the path of a file")
        chosen = chosen._replace(excitation="")
    return chosen


def _replay_section(replay: Any, robot: RobotSettings | None, mistakes: list[str]) -> ReplaySettings | None:
    """The settings of [replay], with the controller's address from [robot]."""
    if isinstance(replay, dict):
        if "host" in replay:
            mistakes.append("replay.host: belongs into [robot]")
        replay = {**replay, "host": robot.host if robot else "127.0.0.1"}
    return cast("ReplaySettings | None", read_section("replay", ReplaySettings, replay, mistakes))


def _check_robot(robot: RobotSettings, mistakes: list[str]) -> None:
    """Model, mounting, ids and gains are such that the rooms can use them."""
    _checked(mistakes, "robot.model", lambda: load_robot(robot.model))
    _checked(mistakes, "robot.mounting", lambda: Mounting.parse(robot.mounting))
    _checked(mistakes, "robot", lambda: prefix(robot.site, robot.id))
    if robot.gains_nm_per_a and (len(robot.gains_nm_per_a) != 6 or min(robot.gains_nm_per_a) <= 0):
        mistakes.append("robot.gains_nm_per_a: expected one positive figure for each of 6 joints")
    if len(robot.payload_cog_m) not in (0, 3):
        mistakes.append(f"robot.payload_cog_m = {list(robot.payload_cog_m)}: expected x, y, z in metres")
    if len(robot.tcp_offset) not in (0, 6):
        mistakes.append(f"robot.tcp_offset = {list(robot.tcp_offset)}: expected x, y, z in metres and rx, ry, rz in radians")
    for plane in robot.safety_planes:
        if len(plane) != 4 or not abs(math.hypot(*plane[:3]) - 1.0) <= 1e-3:
            mistakes.append(f"robot.safety_planes: {list(plane)}: expected a, b, c, d with a² + b² + c² = 1; a·x + b·y + c·z ≤ d is free")


def _check_inspection(inspection: InspectionSettings, mistakes: list[str]) -> None:
    """Each last time of a check is a date."""
    for item in inspection.items:
        try:
            unix_s(item.last_done or "1970-01-01")
        except ValueError:
            mistakes.append(f'inspection.items: last_done = {item.last_done!r} of {item.name!r}; expected a date, e.g. "2026-01-31"')


def _check_gains(robot: RobotSettings, mistakes: list[str]) -> None:
    """An arm that may move has its gains: without them no collision is noticed, and no replay can be judged."""
    try:
        published = load_robot(robot.model).drive_gain_nm_per_a
    except BadInput:
        return  # the model is a mistake of its own
    if not robot.gains_nm_per_a and not np.all(np.isfinite(published)):
        mistakes.append(
            f"robot.gains_nm_per_a: missing, and the torque per ampere of a {robot.model} is not published by its manufacturer; without it "
            "no collision is noticed and no replay can be judged. `joint-monitor init` finds the six figures and says from where; "
            "until then set replay.allow_motion = false"
        )


def _adapted(excitation: Excitation, chosen: _Trajectory, mistakes: list[str]) -> Excitation:
    """The trajectory with the repetitions and the time scale of [replay]."""
    repetitions, time_scale = chosen.repetitions, chosen.time_scale
    if repetitions is not None:
        if isinstance(repetitions, int) and not isinstance(repetitions, bool) and repetitions >= 1:
            excitation = dataclasses.replace(excitation, repetitions=repetitions)
        else:
            mistakes.append(f"replay.repetitions: {repetitions!r} is not a whole number of 1 or more")
    if time_scale is not None:
        if isinstance(time_scale, int | float) and not isinstance(time_scale, bool) and 0 < time_scale <= 1:
            excitation = dataclasses.replace(excitation, time_scale=float(time_scale))
        else:
            mistakes.append(f"replay.time_scale: {time_scale!r}; expected more than 0, at most 1")
    return excitation


def _with_zenoh_files(bus: BusSettings | None, path: Path, mistakes: list[str]) -> BusSettings | None:
    """The same with absolute paths of Zenoh's configuration files, each of which must exist."""
    for name in ("zenoh", "client_zenoh") if bus else ():
        if value := getattr(bus, name):
            if not (path.parent / value).is_file():
                mistakes.append(f"bus.{name}: {path.parent / value} does not exist")
            bus = dataclasses.replace(bus, **{name: str((path.parent / value).resolve())})  # type: ignore[type-var]
    return bus


def _checked(mistakes: list[str], key: str, make: Callable[[], Made]) -> Made | None:
    """Calls `make`. Where it raises BadInput, adds `key: message` to `mistakes` and returns None."""
    try:
        return make()
    except BadInput as error:
        mistakes.append(f"{key}: {error}")
        return None
