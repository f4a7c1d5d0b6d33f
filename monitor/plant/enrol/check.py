"""What an arm lacks: by the files of the plant's folder, and by what its monitor says on the bus."""

import json
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import zenoh
from pydantic import BaseModel, ValidationError

from monitor import __version__
from monitor.errors import BadConfiguration, BadInput, BusError
from monitor.plant.enrol.access import Tls, client_document
from monitor.plant.enrol.authority import Issued, belongs, describe
from monitor.plant.enrol.files import RENEW_DAYS, ROOT_FILES, Plant, computer_of, encrypted, loaded
from monitor.plant.enrol.inventory import Arm
from monitor.publish.documents import Info, Monitor
from monitor.publish.registry import kind_of
from monitor.publish.session import ROOT, session_config

NOT_ENROLLED = "not_enrolled"
QUIET = timedelta(seconds=60)  # a monitor says how it is every ten seconds


class Said(NamedTuple):
    """What an arm's monitor says of itself; None where it did not answer."""

    info: Info | None = None
    monitor: Monitor | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """One thing that an arm lacks, and what to do."""

    cause: str
    text: str


def lacks_of_files(plant: Plant, folder: Path, now: datetime) -> dict[str, list[Lack]]:
    """By name of an arm: what its files lack.

    Behind a router without certificates (tcp/) none is looked for, and nobody need have enrolled.
    """
    if not any(encrypted(endpoint) for endpoint in plant.routers.values()):
        return {arm.name: [lack for lack in _configuration(arm, folder) if lack.cause != NOT_ENROLLED] for arm in plant.arms}
    try:
        root = (folder / ROOT_FILES[0]).read_bytes()
    except OSError as error:
        raise BadInput(f"{folder / ROOT_FILES[0]}: {error.strerror}; joint-monitor plant enrol writes this folder") from None
    return {
        arm.name: [*_configuration(arm, folder), *(_certificate(arm, folder, root, now) if encrypted(plant.routers[arm.site]) else ())]
        for arm in plant.arms
    }


def lacks_on_bus(plant: Plant, said: Mapping[str, Said], now: datetime) -> dict[str, list[Lack]]:
    """By name of an arm: what its monitor says it lacks. An arm that is not in `said` did not answer."""
    return {arm.name: _of_documents(arm, said.get(arm.name, Said()), now) for arm in plant.arms}


def _configuration(arm: Arm, folder: Path) -> list[Lack]:
    """Its TOML file: whether it is there, loads, says the same as the inventory, and what a person has still to do in it."""
    path = folder / "computers" / computer_of(arm) / f"{arm.id}.toml"
    try:
        found = loaded(tomllib.loads(path.read_text("utf-8")), path)
    except FileNotFoundError:
        return [Lack(cause=NOT_ENROLLED, text="has no configuration here: joint-monitor plant enrol")]
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, BadConfiguration) as error:
        return [Lack(cause="configuration", text=str(error))]
    lacks = []
    differs = [
        f"{name} is {getattr(found.robot, name)!r} there and {value!r} in the inventory"
        for name in ("site", "id", "model", "host", "mounting", "payload_kg", "tool", "serial", "gains_nm_per_a")
        if (value := getattr(arm, name)) not in ("", (), None) and getattr(found.robot, name) != value
    ]
    if differs:
        lacks.append(Lack(cause="differs", text=f"{path.name}: {'; '.join(differs)}"))
    if not found.robot.gains_nm_per_a and not np.all(np.isfinite(found.robot_description.drive_gain_nm_per_a)):
        text = f"no torque per ampere of a {found.robot.model} is published: joint-monitor init finds the six figures at the arm"
        lacks.append(Lack(cause="no_gains", text=f"{text}, for gains_nm_per_a"))
    if not found.robot.serial:
        lacks.append(
            Lack(cause="no_serial", text="no serial number: another arm at its address would not be noticed before the first replay")
        )
    return lacks


def _certificate(arm: Arm, folder: Path, root: bytes, now: datetime) -> list[Lack]:
    place = folder / "computers" / computer_of(arm) / "tls" / f"{arm.id}.pem"
    try:
        issued = Issued(place.read_bytes(), place.with_suffix(".key").read_bytes())
        told = describe(issued.certificate, str(place), root=root)
        if not belongs(issued):
            raise BadInput(f"{place.with_suffix('.key')}: is not the key of {place.name}")
    except OSError as error:
        return [Lack(cause="certificate", text=f"{error.filename}: {error.strerror}")]
    except BadInput as error:
        return [Lack(cause="certificate", text=str(error))]
    if told.name != arm.name:
        return [Lack(cause="certificate", text=f"its certificate is that of {told.name}")]
    left = (told.until - now).days
    if left < 0:
        return [Lack(cause="certificate", text=f"its certificate ended on {told.until:%Y-%m-%d}: enrol again, and copy it to the computer")]
    if left < RENEW_DAYS:
        return [Lack(cause="certificate_ends", text=f"its certificate ends in {left} days: enrol again, and copy it to the computer")]
    return []


def _of_documents(arm: Arm, said: Said, now: datetime) -> list[Lack]:
    info, monitor = said
    if info is None or monitor is None:
        return [Lack(cause="silent", text="no monitor of it answers: is its daemon up, and does it reach the router?")]
    lacks = []
    if now - monitor.said_at > QUIET:
        text = f"its monitor said nothing since {monitor.said_at:%Y-%m-%d %H:%M} UTC, by the clock of its computer; is that right?"
        lacks.append(Lack(cause="silent", text=text))
    elif monitor.said_at - now > QUIET:
        text = f"its computer's clock, {monitor.said_at:%Y-%m-%d %H:%M} UTC, is ahead of this one: is NTP on at both?"
        lacks.append(Lack(cause="clock", text=text))
    if info.version != __version__:
        lacks.append(Lack(cause="version", text=f"runs version {info.version}; this is {__version__}"))
    if info.robot.get("host") != arm.host:
        lacks.append(
            Lack(cause="differs", text=f"its monitor watches the controller {info.robot.get('host')}, the inventory says {arm.host}")
        )
    if arm.serial and info.serial and info.serial != arm.serial:
        lacks.append(Lack(cause="differs", text=f"the controller says serial {info.serial}, the inventory {arm.serial}"))
    if monitor.next_replay_due is None:
        lacks.append(Lack(cause="no_replay", text=f"no replay is due: {monitor.next_replay_why or 'allow_motion is false'}"))
    lacks += [Lack(cause=trouble.name, text=trouble.text) for trouble in monitor.troubles]
    return lacks


def joined(arms: Sequence[Arm], *parts: Mapping[str, Sequence[Lack]]) -> dict[str, list[Lack]]:
    """All that each arm lacks, the arms in the inventory's order."""
    return {arm.name: [lack for part in parts for lack in part.get(arm.name, ())] for arm in arms}


# --- Asking all monitors of a plant at once what they say of themselves, with the plant's own certificate

Content = TypeVar("Content", bound=BaseModel)
ANSWERS_S = 5.0  # [s] for all arms behind one router


def ask_all(plant: Plant, folder: Path, *, timeout_s: float = ANSWERS_S) -> dict[str, Said]:
    """By name of an arm: what its monitor says; arms that do not answer are left out.

    The core is asked, or each site's router where there is no core. Raises BusError where one of them is not reached.
    """
    endpoints = [plant.core] if plant.core else list(plant.routers.values())
    said: dict[str, Said] = {}
    for endpoint in endpoints:
        said |= _ask(endpoint, folder, timeout_s)
    return said


def _ask(endpoint: str, folder: Path, timeout_s: float) -> dict[str, Said]:
    tls = client_document(Tls(str(folder.resolve() / "people" / "plant" / "tls"), "plant"))
    with tempfile.NamedTemporaryFile("w", suffix=".json5") as file:
        json.dump(tls if encrypted(endpoint) else {}, file)
        file.flush()
        config = session_config(mode="client", connect=(endpoint,), zenoh_file=file.name)
    config.insert_json5("connect/timeout_ms", json.dumps(int(timeout_s * 1000)))
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        shown = ", or not to the certificate people/plant/tls/plant.pem; is it up, with its newest router.json5?"
        raise BusError(
            f"{endpoint}: no router answers{shown if encrypted(endpoint) else '; is it up, and does it listen there?'}"
        ) from None
    with session:
        infos, monitors = _documents(session, Info, timeout_s), _documents(session, Monitor, timeout_s)
    return {name: Said(infos.get(name), monitors.get(name)) for name in {*infos, *monitors}}


def _documents(session: zenoh.Session, kind: type[Content], timeout_s: float) -> dict[str, Content]:
    """By name of an arm, its document of one kind. One that cannot be read is left out: its arm counts as silent."""
    key = kind_of(kind).key()
    found = {}
    for reply in session.get(f"{ROOT}/*/*/{key}", timeout=timeout_s):
        if reply.ok is None:
            continue
        site, robot = _arm_of(str(reply.ok.key_expr))
        try:
            found[f"{site}.{robot}"] = kind.model_validate_json(reply.ok.payload.to_bytes())
        except ValidationError:
            continue
    return found


def _arm_of(key: str) -> Sequence[str]:
    return key.removeprefix(f"{ROOT}/").split("/")[:2]
