"""Asking all monitors of a plant at once what they say of themselves, with the plant's own certificate. I/O."""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

from monitor.errors import BusError
from monitor.plant.enrol.access import Tls, client_document
from monitor.plant.enrol.check import Said
from monitor.plant.enrol.files import Plant
from monitor.publish.documents import Info, Monitor
from monitor.publish.registry import kind_of
from monitor.publish.session import ROOT, session_config

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
        json.dump(tls, file)
        file.flush()
        config = session_config(mode="client", connect=(endpoint,), zenoh_file=file.name)
    config.insert_json5("connect/timeout_ms", json.dumps(int(timeout_s * 1000)))
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        raise BusError(
            f"{endpoint}: no router answers, or not to the certificate people/plant/tls/plant.pem; is it up, with its newest router.json5?"
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
