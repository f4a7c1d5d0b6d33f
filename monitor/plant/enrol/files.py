"""The folder of a plant: what enrolment writes for each router, computer and person, and what it leaves as it is. I/O.

    authority/                     the root; its key signs, and belongs to nobody's host
    routers/SITE/, core/           router.json5 and tls/ of each site's router and of the core
    computers/NAME/                what belongs in /etc/joint-monitor of an arm's computer: ID.toml, zenoh/, tls/
    people/NAME/                   the same of those who look and act; cells/SITE.ID/ of the programs that permit a motion

A file that people may have changed (a configuration) and a certificate that is still good are kept; what is derived is written anew.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from monitor.config.files import write_whole
from monitor.config.first_file import toml_text
from monitor.config.load import from_document
from monitor.config.schema import Configuration
from monitor.errors import BadConfiguration, BadInput
from monitor.plant.enrol.access import (
    CORE,
    PEOPLE,
    Tls,
    cell_name,
    client_document,
    core_router_document,
    router_name,
    site_router_document,
)
from monitor.plant.enrol.authority import Authority, Issued, belongs, describe, new_root
from monitor.plant.enrol.inventory import Arm, page_ports

ETC = "/etc/joint-monitor"
PAGES = "which `joint-monitor deploy-files DIR` writes."
RENEW_DAYS = 60  # a certificate that ends within this time is replaced
ROOT_FILES = ("authority/ca.pem", "authority/ca.key")


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """What is enrolled: the arms, the routers by site, and how long certificates hold."""

    arms: tuple[Arm, ...]
    routers: Mapping[str, str]  # site → endpoint of its router, e.g. tls/hall-1.example:7447
    core: str = ""  # endpoint of the core router; empty: none, and one router a site is all
    days: int = 825  # of a certificate

    def __post_init__(self) -> None:
        """Raises BadInput where a site has no router, or a router no site."""
        sites = {arm.site for arm in self.arms}
        if missing := sorted(sites - self.routers.keys()):
            raise BadInput(f"no router for the site {missing[0]}; give --router {missing[0]}=tls/HOST:7447")
        if unknown := sorted(self.routers.keys() - sites):
            raise BadInput(f"--router {unknown[0]}=…: the inventory holds no arm of this site; it has {', '.join(sorted(sites))}")
        if len(sites) > 1 and not self.core and any(map(encrypted, self.routers.values())):
            raise BadInput(f"{len(sites)} sites meet in a core router; give --core tls/HOST:7447")
        for endpoint in (*self.routers.values(), *([self.core] if self.core else [])):
            host_of(endpoint)
        if not 1 <= self.days <= 3650:
            raise BadInput(f"--days {self.days}: expected 1 to 3650")


@dataclass(slots=True)
class Written:
    """What was done, by kind; names of files are relative to the folder."""

    new: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)  # differ from the inventory, and people may have changed them
    same: int = 0
    gone: list[str] = field(
        default_factory=list
    )  # arms with files here that are no longer in the inventory; their certificate opens nothing


class _Bearer(NamedTuple):
    """Who gets a certificate, and where it is put."""

    name: str  # common name
    folder: str  # whose tls/ it belongs in
    file: str
    addresses: tuple[str, ...] = ()


def host_of(endpoint: str) -> str:
    """The host of a router's endpoint. Raises BadInput for any other than tls/HOST:PORT and tcp/HOST:PORT."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in {"tls", "tcp"} or not host or not port.isdigit():
        raise BadInput(f"{endpoint!r}: expected a router's endpoint tls/HOST:PORT, e.g. tls/hall-1.example:7447, or tcp/HOST:PORT")
    return host.strip("[]")


def encrypted(endpoint: str) -> bool:
    """Whether both ends of this way show certificates."""
    return endpoint.startswith("tls/")


def enrol(plant: Plant, folder: Path, *, root: Issued | None = None, force: bool = False, now: datetime | None = None) -> Written:
    """Write the folder of a plant, or bring it up to date: what the inventory gained is added, certificates near their end are renewed.

    root : an authority of yours, whose key is then not copied; None for the folder's own, made where there is none.
    force : configurations that differ from the inventory are replaced. Raises BadInput, and has then written nothing.
    """
    for endpoint in (*plant.routers.values(), *([plant.core] if plant.core else [])):
        if not encrypted(endpoint):
            raise BadInput(
                f"{endpoint!r}: plant enrol writes certificates, which need tls/HOST:PORT; behind tcp/ nothing has to be enrolled"
            )
    now = now or datetime.now(UTC)
    files: dict[str, bytes] = {}
    configurations = _configurations(plant)
    if root is None:
        root = _own_root(folder, now)
        files |= dict(zip(ROOT_FILES, root, strict=True))
    else:
        files[ROOT_FILES[0]] = root.certificate
    authority = Authority(root, str(folder / "authority"))
    for bearer in _bearers(plant):
        files |= _certificate(bearer, authority, folder, now, plant.days)
    files |= {name: _json(document) for name, document in _access(plant).items()}
    configurations["people/plant/joint-monitor-plant.toml"] = _plant_configuration(plant)
    return _write(folder, files, configurations, force=force)


def computer_of(arm: Arm) -> str:
    """The name of the folder of an arm's computer."""
    return arm.computer or arm.name


def loaded(document: Mapping[str, Any], where: Path) -> Configuration:
    """An arm's configuration as its daemon will load it; its Zenoh files need not lie there yet. Raises BadConfiguration."""
    bus = document.get("bus", {})
    return from_document({**document, "bus": {**bus, "zenoh": "", "client_zenoh": ""} if isinstance(bus, dict) else bus}, where)


def _configurations(plant: Plant) -> dict[str, bytes]:
    """The TOML files of all arms, each checked as the daemon will. Raises BadInput that names every arm whose row makes none."""
    ports = page_ports(plant.arms)
    made, mistakes = {}, []
    for arm in plant.arms:
        document = _configuration(arm, plant.routers[arm.site], ports[arm.name])
        name = f"computers/{computer_of(arm)}/{arm.id}.toml"
        try:
            loaded(document, Path(arm.name))
        except BadConfiguration as error:
            mistakes.append(str(error))
        about = (
            f"The monitor of one arm, written by `joint-monitor plant enrol`. Put it into {ETC}. Every key: docs/configuration.md, {PAGES}"
        )
        made[name] = toml_text(document, about).encode()
    if mistakes:
        raise BadInput("\n  ".join(("the inventory makes no configuration of every arm; nothing was written", *mistakes)))
    return made


def _configuration(arm: Arm, router: str, page_port: int) -> dict[str, Any]:
    """The document of one arm's TOML file. It moves nothing: a person allows that, arm by arm, at the arm."""
    told = {
        name: list(value) if isinstance(value, tuple) else value
        for name in ("mounting", "payload_kg", "payload_cog_m", "tcp_offset", "tcp_speed_limit_m_s", "tool", "serial", "gains_nm_per_a")
        if (value := getattr(arm, name)) not in ("", (), None)
    }
    replay = {name: value for name in ("cell", "excitation") if (value := getattr(arm, name))}
    windows = {"windows_utc": list(arm.windows_utc)} if arm.windows_utc else {}
    schedule = {name: value for name in ("timezone", "cron") if (value := getattr(arm, name))}
    zenoh = f"zenoh/{arm.id}.json5"
    return {
        "robot": {"model": arm.model, "site": arm.site, "id": arm.id, "host": arm.host, **told},
        "replay": {"allow_motion": False, **replay, **windows},
        **({"schedule": schedule} if schedule else {}),
        "store": {"directory": f"/var/lib/joint-monitor/{arm.id}"},
        "bus": {"listen": [], "connect": [router], "zenoh": zenoh, "client_zenoh": zenoh},
        "page": {"listen": f"127.0.0.1:{page_port}"},
    }


def _plant_configuration(plant: Plant) -> bytes:
    """The TOML file of `joint-monitor plant`, as its service reads it."""
    ways = [plant.core] if plant.core else list(plant.routers.values())
    about = f"The plant, written by `joint-monitor plant enrol`. Put it into /etc. Every key: docs/plant.md, {PAGES}"
    return toml_text({"plant": {"connect": ways, "zenoh": f"{ETC}/zenoh/plant.json5"}}, about).encode()


def _own_root(folder: Path, now: datetime) -> Issued:
    """The folder's authority; a new one where there is none yet. Raises BadInput where half of one is there."""
    certificate, key = (folder / name for name in ROOT_FILES)
    if not certificate.exists() and not key.exists():
        return new_root(f"joint-monitor plant {now:%Y-%m-%d}", now)
    missing = [str(path) for path in (certificate, key) if not path.exists()]
    if missing:
        raise BadInput(f"{missing[0]}: is missing; bring it back, or give the authority with --authority CERTIFICATE KEY")
    return Issued(_read(certificate), _read(key))


def _bearers(plant: Plant) -> list[_Bearer]:
    bearers = [_Bearer(person.name, f"people/{person.name}", person.name) for person in PEOPLE]
    bearers += [_Bearer(router_name(site), f"routers/{site}", "router", (host_of(at),)) for site, at in plant.routers.items()]
    if plant.core:
        bearers.append(_Bearer(CORE, CORE, "router", (host_of(plant.core),)))
    bearers += [_Bearer(arm.name, f"computers/{computer_of(arm)}", arm.id) for arm in plant.arms]
    bearers += [_Bearer(cell_name(arm), f"cells/{arm.name}", "cell") for arm in plant.arms]
    return bearers


def _certificate(bearer: _Bearer, authority: Authority, folder: Path, now: datetime, days: int) -> dict[str, bytes]:
    """The certificate files of one bearer: those that are there where they are still good, else new ones."""
    inside = f"{bearer.folder}/tls"
    names = (f"{inside}/{bearer.file}.pem", f"{inside}/{bearer.file}.key")
    issued = _still_good(bearer, authority, [folder / name for name in names], now)
    issued = issued or authority.issue(bearer.name, bearer.addresses, now, days)
    return {f"{inside}/ca.pem": authority.pem, names[0]: issued.certificate, names[1]: issued.key}


def _still_good(bearer: _Bearer, authority: Authority, paths: Sequence[Path], now: datetime) -> Issued | None:
    try:
        issued = Issued(*(path.read_bytes() for path in paths))
        told = describe(issued.certificate, str(paths[0]), root=authority.pem)
        good = belongs(issued)
    except (OSError, BadInput):
        return None
    soon = told.until - now < timedelta(days=RENEW_DAYS)
    return issued if good and not soon and told.name == bearer.name and told.addresses == bearer.addresses else None


def _access(plant: Plant) -> dict[str, dict[str, Any]]:
    """Zenoh's configurations of all, by file."""
    tls = f"{ETC}/tls"
    documents = {}
    for site, endpoint in plant.routers.items():
        arms = [arm for arm in plant.arms if arm.site == site]
        documents[f"routers/{site}/router.json5"] = site_router_document(site, arms, endpoint, plant.core, Tls(tls, "router"))
    if plant.core:
        documents[f"{CORE}/router.json5"] = core_router_document(list(plant.routers), plant.core, Tls(tls, "router"))
    for arm in plant.arms:
        documents[f"computers/{computer_of(arm)}/zenoh/{arm.id}.json5"] = client_document(Tls(tls, arm.id))
        documents[f"cells/{arm.name}/zenoh/cell.json5"] = client_document(Tls(tls, "cell"))
    for person in PEOPLE:
        documents[f"people/{person.name}/zenoh/{person.name}.json5"] = client_document(Tls(tls, person.name))
    return documents


def _json(document: Mapping[str, Any]) -> bytes:
    return f"// Written by `joint-monitor plant enrol`, which replaces it.\n{json.dumps(document, indent=2)}\n".encode()


def _write(folder: Path, files: Mapping[str, bytes], configurations: Mapping[str, bytes], *, force: bool) -> Written:
    written = Written()
    for name, content in {**files, **configurations}.items():
        path = folder / name
        before = _read(path) if path.exists() else None
        if before == content:
            written.same += 1
        elif before is not None and name in configurations and not force:
            written.kept.append(name)
        else:
            (written.new if before is None else written.changed).append(name)
            _put(path, content, secret=name.endswith(".key"))
    here = {path.relative_to(folder).as_posix() for path in folder.glob("computers/*/*.toml")}
    written.gone = sorted(here - configurations.keys())
    return written


def _put(path: Path, content: bytes, *, secret: bool) -> None:
    """Write a file and the folders above it; a secret is its owner's alone. Raises BadInput where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{path.parent}: cannot be made: {error.strerror}") from None
    write_whole(path, content, mode=0o600 if secret else 0o644)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
