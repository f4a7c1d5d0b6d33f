"""The document `info`: who watches which arm, with which programs, and since when."""

import dataclasses
import hashlib
import json
import platform
import socket
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.config.schema import Configuration
from monitor.judge.document import plain
from monitor.recording import Context

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")  # Linux makes another identifier at every boot of the host, proc(5)
PACKAGES = ("eclipse-zenoh", "numpy", "pin", "ur-rtde")  # their versions decide what is on the wire and in the figures


def info(configuration: Configuration, *, started_at_unix_s: float, context: Context | None) -> dict[str, Any]:
    """The document before its times become text. `context`: of the last replay, with serial and firmware as reported by the controller."""
    seen = context or configuration.context
    return {
        "robot": dataclasses.asdict(configuration.robot),
        "serial": seen.serial or configuration.robot.serial,
        "firmware": seen.firmware,
        "mounting": configuration.robot.mounting,
        "version": __version__,
        "versions": versions(),
        "host": socket.gethostname(),
        "boot_id": boot_id(),
        "started_at_unix_s": started_at_unix_s,
        "configuration_digest": digest(configuration),
        "trajectory_digest": configuration.excitation.digest,
    }


def digest(configuration: Configuration) -> str:
    """16 hexadecimal digits of every setting in force, defaults included. The file's place and layout have no influence."""
    settings = {field.name: getattr(configuration, field.name) for field in dataclasses.fields(configuration)}
    del settings["path"], settings["excitation"]
    plain_settings = plain(settings) | {"trajectory": configuration.excitation.digest, "repetitions": configuration.excitation.repetitions}
    plain_settings["replay"].pop("cell", None)
    plain_settings["replay"]["cell"] = configuration.replay.cell.digest if configuration.replay.cell else None
    for name in ("zenoh", "client_zenoh"):  # their content belongs to Zenoh, and their folder differs from host to host
        plain_settings["bus"][name] = Path(plain_settings["bus"][name]).name
    return hashlib.sha256(json.dumps(plain_settings, sort_keys=True, default=str).encode()).hexdigest()[:16]


def boot_id() -> str | None:
    """The identifier of the host's present boot; None where the system has none."""
    try:
        return BOOT_ID.read_text("ascii").strip()
    except OSError:
        return None


def versions() -> dict[str, str]:
    """Versions of Python and of `PACKAGES`; a package that is not installed is left out."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
