"""Loading a configuration: one TOML file becomes the settings that each room owns, and all mistakes are named at once. I/O."""

import dataclasses
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from annotated_types import Interval

from monitor.config.files import OF_PLANT, find_cell, find_excitation, find_prior
from monitor.config.schema import Configuration, RobotSettings, assess_sections, section_classes, text_keys
from monitor.config.sections import Mistake, nearest, of_key, of_section, read_section
from monitor.config.sources import Source
from monitor.errors import BadConfiguration, BadInput, StoreError
from monitor.judge.inspection import InspectionSettings
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, load_robot
from monitor.publish.session import BusSettings, check_syntax, prefix, read_as_session
from monitor.publish.timestamps import unix_s
from monitor.store.archive.places import FOLDER, authority_of, keys_of
from monitor.store.disk import refuse_network

Made = TypeVar("Made")

ETC, STATE = Path("/etc/joint-monitor"), Path("/var/lib/joint-monitor")  # of the shipped unit: NAME.toml and the history of NAME
HOST = re.compile(r"(?!.{254})[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*")  # an address, or a name of the network


def load(
    path: Path, environment: Mapping[str, str] | None = None, *, secrets_needed: bool = True, reads_files: bool = False
) -> Configuration:
    """Read and check one configuration. Variables JOINT_MONITOR__SECTION__KEY replace values of the file.

    environment : os.environ where not given. secrets_needed : where false, credentials are not read. reads_files : also the files that
    the service alone opens are read, as it will open them, and the credentials of [notify].
    Raises BadConfiguration that lists every mistake with its line and key.
    """
    environment = os.environ if environment is None else environment
    source = Source.read(path)
    source.override(environment, text_keys())
    _place_history(source.document, path, environment)
    if secrets_needed:
        source.take_credentials(environment.get("CREDENTIALS_DIRECTORY"), but=() if reads_files else ("notify",))
    configuration = _from_document(source.document, path, source.mistakes)
    if reads_files and configuration is not None:
        _read_files(configuration, source.mistakes, secrets_needed=secrets_needed)
    source.refuse()
    assert configuration is not None  # or there would be a mistake
    return dataclasses.replace(configuration, overrides=source.overrides)


def _place_history(document: dict[str, Any], path: Path, environment: Mapping[str, str]) -> None:
    """Where nothing is said of [store] directory, a service's history is in its state directory; commands find it there too."""
    store = document.setdefault("store", {})
    if not isinstance(store, dict) or "directory" in store:
        return
    of_service = environment.get("STATE_DIRECTORY", "").split(":")[0]
    if of_service:  # systemd.exec(5), StateDirectory=
        store["directory"] = of_service
    elif path.absolute().parent == ETC:
        store["directory"] = str(STATE / path.stem)


def from_document(document: dict[str, Any], path: Path) -> Configuration:
    """The configuration from a parsed document; relative names start from the folder of `path`.

    Raises BadConfiguration that lists every mistake with its key.
    """
    mistakes: list[Mistake] = []
    configuration = _from_document(document, path, mistakes)
    if configuration is None:
        raise BadConfiguration(f"{path}: " + "; ".join(mistake.text for mistake in mistakes))
    return configuration


@dataclass(frozen=True, slots=True, kw_only=True)
class _Named:
    """The keys of [replay] that choose the trajectory and the cell: names of files, and how the trajectory is played."""

    excitation: str = ""
    repetitions: Annotated[int, Interval(ge=1)] | None = None
    time_scale: Annotated[float, Interval(gt=0.0, le=1.0)] | None = None
    cell: str = "plain"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Prior:
    """The key of [drift] that names a file."""

    prior: str = ""


NAMING = {"replay": _Named, "drift": _Prior}  # keys of a section that name files; the section's settings hold what is in them


def _from_document(document: dict[str, Any], path: Path, mistakes: list[Mistake]) -> Configuration | None:
    """The checked configuration; None, with the mistakes added in the order in which they are reported."""
    classes = section_classes()
    mistakes += [of_section(name, f": unknown section{nearest(name, list(classes))}") for name in document if name not in classes]
    sections, named = {}, {}
    for name, cls in classes.items():
        table = document.get(name, {})
        if name in NAMING and isinstance(table, dict):
            ours = {field.name for field in dataclasses.fields(NAMING[name])}
            named[name] = read_section(name, NAMING[name], {key: value for key, value in table.items() if key in ours}, mistakes)
            table = {key: value for key, value in table.items() if key not in ours}
        sections[name] = read_section(name, cls, table, mistakes)
    robot: RobotSettings | None = sections["robot"]
    chosen: _Named | None = named.get("replay")
    excitation = None
    if robot:
        sound = len(mistakes)
        _check_robot(robot, mistakes)
        known = not {("robot", "model"), ("robot", "mounting")} & {mistake.key for mistake in mistakes[sound:]}
        if chosen is not None and (chosen.excitation or known):
            name = chosen.excitation or f"{robot.model}-{robot.mounting}"
            excitation = _checked(mistakes, ("replay", "excitation"), lambda: find_excitation(name, path.parent))
        drift, prior = sections["drift"], named.get("drift")
        if drift and prior and known and prior.prior != OF_PLANT:
            of_file = _checked(
                mistakes, ("drift", "prior"), lambda: find_prior(prior.prior, robot.model, drift.reference_speed_rad_s, path.parent)
            )
            sections["drift"] = dataclasses.replace(drift, prior=of_file)
        if sections["replay"] and chosen is not None:
            mounted = Mounting.parse(robot.mounting) if known else Mounting.parse("ground")
            cell = _checked(mistakes, ("replay", "cell"), lambda: find_cell(chosen.cell, mounted, path.parent))
            sections["replay"] = dataclasses.replace(sections["replay"], cell=cell, host=robot.host)
            if sections["replay"].allow_motion is True:
                _check_gains(robot, mistakes)
        if excitation is not None and excitation.robot != robot.model:
            mistakes.append(of_key(("replay", "excitation"), f"made for a {excitation.robot}, but robot.model is {robot.model}"))
    if excitation is not None and chosen is not None:
        repetitions, time_scale = chosen.repetitions or excitation.repetitions, chosen.time_scale or excitation.time_scale
        excitation = dataclasses.replace(excitation, repetitions=repetitions, time_scale=time_scale)
    if sections["store"] and ("\0" in sections["store"].directory or not sections["store"].directory.strip()):
        mistakes.append(of_key(("store", "directory"), f"{sections['store'].directory!r}: expected the path of a folder"))
    elif sections["store"] and sections["store"].directory.startswith(("~", "$")):
        given, whole = sections["store"].directory, str(STATE / path.stem)
        reason = f"{given!r}: ~ and $ stand for nothing here; expected the whole path, e.g. {whole!r}"
        mistakes.append(of_key(("store", "directory"), reason))
    if sections["inspection"]:
        _check_inspection(sections["inspection"], mistakes)
    sections["bus"] = _with_zenoh_files(sections["bus"], path, mistakes)
    if mistakes:
        return None
    assert excitation is not None  # or there would be a mistake
    of_assess = {name: sections.pop(name) for name in assess_sections()}
    assess = AssessSettings(method=sections.pop("assess").method, **of_assess)
    asks_plant = named["drift"] is not None and named["drift"].prior == OF_PLANT
    return Configuration(path=path, assess=assess, excitation=excitation, prior_of_plant=asks_plant, **sections)


def _check_robot(robot: RobotSettings, mistakes: list[Mistake]) -> None:
    """Model, mounting, ids and gains are such that the rooms can use them."""

    def wrong(key: str, reason: str) -> None:
        mistakes.append(of_key(("robot", key), reason))

    _checked(mistakes, ("robot", "model"), lambda: load_robot(robot.model))
    _checked(mistakes, ("robot", "mounting"), lambda: Mounting.parse(robot.mounting))
    if not HOST.fullmatch(robot.host):
        wrong("host", f"{robot.host!r}: expected the controller's address alone, e.g. '192.168.0.10'")
    _checked(mistakes, ("robot",), lambda: prefix(robot.site, robot.id))
    if robot.gains_nm_per_a and (len(robot.gains_nm_per_a) != 6 or min(robot.gains_nm_per_a) <= 0):
        wrong("gains_nm_per_a", "expected one positive figure for each of 6 joints")
    if len(robot.payload_cog_m) not in (0, 3):
        wrong("payload_cog_m", f"{list(robot.payload_cog_m)}: expected x, y, z in metres")
    if len(robot.tcp_offset) not in (0, 6):
        wrong("tcp_offset", f"{list(robot.tcp_offset)}: expected x, y, z in metres and rx, ry, rz in radians")
    for plane in robot.safety_planes:
        if len(plane) != 4 or not abs(math.hypot(*plane[:3]) - 1.0) <= 1e-3:
            wrong("safety_planes", f"{list(plane)}: expected a, b, c, d with a² + b² + c² = 1; a·x + b·y + c·z ≤ d is free")


def _check_inspection(inspection: InspectionSettings, mistakes: list[Mistake]) -> None:
    """Each last time of a check is a date."""
    for item in inspection.items:
        try:
            unix_s(item.last_done or "1970-01-01")
        except ValueError:
            reason = f'last_done = {item.last_done!r} of {item.name!r}; expected a date, e.g. "2026-01-31"'
            mistakes.append(of_key(("inspection", "items"), reason))


def _check_gains(robot: RobotSettings, mistakes: list[Mistake]) -> None:
    """An arm that may move has its gains: without them no collision is noticed, and no replay can be judged."""
    try:
        published = load_robot(robot.model).drive_gain_nm_per_a
    except BadInput:
        return  # the model is a mistake of its own
    if not robot.gains_nm_per_a and not np.all(np.isfinite(published)):
        reason = (
            f"missing, and the torque per ampere of a {robot.model} is not published by its manufacturer; without it "
            "no collision is noticed and no replay can be judged. `joint-monitor init` finds the six figures and says from where; "
            "until then set replay.allow_motion = false"
        )
        mistakes.append(of_key(("robot", "gains_nm_per_a"), reason))


def _with_zenoh_files(bus: BusSettings | None, path: Path, mistakes: list[Mistake]) -> BusSettings | None:
    """The same with absolute paths of Zenoh's configuration files, each of which must exist."""
    for name in ("zenoh", "client_zenoh") if bus else ():
        if value := getattr(bus, name):
            if not (path.parent / value).is_file():
                mistakes.append(of_key(("bus", name), f"{path.parent / value} does not exist"))
            bus = dataclasses.replace(bus, **{name: str((path.parent / value).resolve())})  # type: ignore[type-var]
    return bus


def _read_files(configuration: Configuration, mistakes: list[Mistake], *, secrets_needed: bool) -> None:
    """Read what the service opens later: Zenoh's configurations with their certificates, the page's token, keys of the archive."""
    bus, page, archive = configuration.bus, configuration.page, configuration.archive
    _checked(mistakes, ("bus", "zenoh"), lambda: read_as_session(bus.zenoh, bus.listen, secrets_needed=secrets_needed))
    if bus.client_zenoh and os.access(bus.client_zenoh, os.R_OK, effective_ids=True):  # of the commands, which others call
        _checked(mistakes, ("bus", "client_zenoh"), lambda: check_syntax(bus.client_zenoh))
    if page.listen and (secrets_needed or not page.token_file.startswith(FOLDER)):
        _checked(mistakes, ("page", "token_file"), lambda: page.token(configuration.path.parent))
    _checked(mistakes, ("store", "directory"), lambda: _refuse_file(configuration.state_directory))
    _checked(mistakes, ("store", "directory"), lambda: refuse_network(configuration.state_directory))
    if archive is not None:
        if secrets_needed or not archive.keys_file.startswith(FOLDER):
            _checked(mistakes, ("store", "recordings_keys_file"), lambda: keys_of(archive))
        _checked(mistakes, ("store", "recordings_ca_file"), lambda: authority_of(archive))


def _refuse_file(directory: Path) -> None:
    """Raises BadInput where the history's folder, or one above it, is a file."""
    there = next(path for path in (directory, *directory.parents) if os.path.lexists(path))
    if there.exists() and not there.is_dir():
        raise BadInput(f"{there} is a file; expected a folder, or a path that does not exist yet")


def _checked(mistakes: list[Mistake], key: tuple[str, ...], make: Callable[[], Made]) -> Made | None:
    """Calls `make`. Where it raises BadInput or StoreError, adds its message to `mistakes` and returns None."""
    try:
        return make()
    except (BadInput, StoreError) as error:
        mistakes.append(of_key(key, str(error)))
        return None
