"""Files that a configuration names: trajectories and cells, shipped ones or the site's own; files written as a whole. I/O."""

import contextlib
import hashlib
import json
import os
import tempfile
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from monitor.design.cell import Cell, cell_from_document, plain_cell
from monitor.errors import BadInput
from monitor.judge.friction.prior import FleetPrior, prior_from_document
from monitor.model.fourier import Excitation, excitation_from_document
from monitor.model.robot import Mounting, load_robot

OF_PLANT = "plant"  # [drift] prior: no file; the daemon asks the plant


def shared_file(name: str) -> Path:
    """A file of `config/`, from the checkout or from the installed wheel.

    Raises BadInput where there is none.
    """
    package = Path(str(files("monitor")))
    for folder in (package / "_config", package.parent / "config"):
        if (folder / name).is_file():
            return folder / name
    raise BadInput(f"{name}: not among the files that joint-monitor ships")


def find_excitation(name: str, folder: Path) -> Excitation:
    """A trajectory by its shipped name (`ur5-ground`) or by the path of its file.

    Raises BadInput naming the shipped ones where it is neither, or what is wrong in the file.
    """
    path = folder / name
    if not path.is_file():
        try:
            path = shared_file(f"excitation/{name}.json")
        except BadInput:
            shipped = sorted(entry.stem for entry in shared_file("monitor.toml").parent.glob("excitation/*.json"))
            raise BadInput(f"{name!r} is no file in the configuration's folder and not shipped; shipped are {', '.join(shipped)}") from None
    try:
        return excitation_from_document(json.loads(path.read_text("utf-8")))
    except RecursionError:
        raise BadInput(f"{path}: is nested too deeply; expected an excitation's JSON object") from None
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: {error}") from None


def find_cell(name: Any, mounting: Mounting, folder: Path) -> Cell | None:
    """A site's cell: `plain` is the table-top of the mounting, `unchecked` is None, anything else the path of a TOML file.

    Raises BadInput where it is none of these, or naming every mistake in the file.
    """
    if name == "unchecked":
        return None
    if name == "plain":
        return plain_cell(mounting)
    if not isinstance(name, str) or not (folder / name).is_file():
        raise BadInput(f"{name!r} is no file in the configuration's folder; expected plain, unchecked or the path of a cell's TOML file")
    return load_cell(folder / name)


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


def find_prior(name: Any, model: str, reference_speed_rad_s: float, folder: Path) -> FleetPrior | None:
    """A fleet's prior for a robot model, by the path of its file; None for the empty name.

    Raises BadInput where there is no such file, or it holds no prior of this model at this speed.
    """
    if name == "":
        return None
    if not isinstance(name, str):
        raise BadInput(f"{name!r}: expected the path of a file that `joint-monitor prior` has written")
    path = folder / name
    try:
        content = path.read_bytes()
        document = json.loads(content)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: {error}") from None
    except RecursionError:
        raise BadInput(f"{path}: is nested too deeply; expected a fleet prior") from None
    try:
        digest = hashlib.sha256(content).hexdigest()[:16]
        return prior_from_document(document, model, load_robot(model).joints, reference_speed_rad_s, digest=digest)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def write_whole(path: Path, content: bytes, *, mode: int) -> None:
    """Write a file as a whole or not at all, also over an older one, with these permissions. Raises BadInput where it cannot be written."""
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, mode)
            os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
