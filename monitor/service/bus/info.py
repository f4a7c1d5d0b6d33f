"""Who watches which arm, with what, and since when: the document `info`."""

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

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")  # Linux: another one after every boot of the host, proc(5)
PACKAGES = ("eclipse-zenoh", "numpy", "pin", "ur-rtde")  # whose versions decide what is on the wire and in the numbers


def info(configuration: Configuration, *, started_at_unix_s: float, context: Context | None) -> dict[str, Any]:
    """The document, before times are told. `context` is that of the last replay: serial and firmware as the controller said them."""
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
    """16 hexadecimal digits of every setting in force, defaults included; where the file lies and how it is laid out do not count."""
    settings = {field.name: getattr(configuration, field.name) for field in dataclasses.fields(configuration)}
    del settings["path"], settings["excitation"]
    told = plain(settings) | {"trajectory": configuration.excitation.digest, "repetitions": configuration.excitation.repetitions}
    told["replay"].pop("cell", None)
    told["replay"]["cell"] = configuration.replay.cell.digest if configuration.replay.cell else None
    for name in ("zenoh", "client_zenoh"):  # what is in these files is Zenoh's; where they lie differs from host to host
        told["bus"][name] = Path(told["bus"][name]).name
    return hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode()).hexdigest()[:16]


def boot_id() -> str | None:
    """Of the host; None where the system has none."""
    try:
        return BOOT_ID.read_text("ascii").strip()
    except OSError:
        return None


def versions() -> dict[str, str]:
    """Of Python and of the packages that matter; one that is not installed is left out."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
