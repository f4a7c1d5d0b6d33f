"""Identification of recordings from files into one document: shared by the commands `identify`, `base` and `energy`. I/O."""

import dataclasses
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.detectors import HeldOut, Predicted, warnings_of
from monitor.identify.document import document, gains_document, identification_from_document, payload_document
from monitor.identify.gains import Gains, payload_gains
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.payload import identify_payload
from monitor.identify.quality import not_of_the_arm, silent_drive
from monitor.identify.validate import Validation, validate
from monitor.model.robot import Mounting, Robot, load_robot, robot_from_document
from monitor.reason import Reason
from monitor.recording import Array, Recording
from monitor.store.formats.recordings import read_recording
from monitor.store.from_files.archived_files import local_file


@dataclass(frozen=True, slots=True, kw_only=True)
class PayloadPair:
    """The second of two runs, with a weighed mass at the flange."""

    file: Path
    payload_kg: float
    com_m: tuple[float, ...]  # in the flange's frame
    std_kg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Request:
    """The recordings to identify from, and how."""

    files: Sequence[Path]  # fitted together
    robot: Robot
    mounting: Mounting
    columns: str | None = None  # what the columns of the files are, as `layout_of` takes it
    rate_hz: float | None = None  # rows a second of files that tell no time
    gains: Array | None = None  # (J,) [N·m/A]
    pair: PayloadPair | None = None  # the gains are estimated from it; files[0] is the run without the mass
    method: str = "wls"
    friction: str = "paper"
    rigid_from: Path | None = None  # output of an earlier `identify --json`
    held_out: Sequence[Path] = ()
    loaded: Sequence[Path] = ()  # recordings with an unknown payload, which is estimated


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """The identification with its document and its recordings."""

    document: dict[str, Any]
    identification: Identification
    gains: Array | None
    recordings: Sequence[Recording]
    held_out: Sequence[Recording]


def arm(robot: str | None, urdf: Path | None) -> Robot:
    """The arm by its model's name, from a TOML like those of the models (`--export` writes one), or from a URDF.

    Raises BadInput unless exactly one of them is given, and where it is unknown or unreadable.
    """
    if (robot is None) == (urdf is None):
        raise BadInput(f"{'neither' if robot is None else 'both'} of --robot and --urdf given; expected one of them")
    if robot is not None:
        return _from_toml(Path(robot)) if robot.endswith(".toml") else load_robot(robot)
    return robot_from_urdf(str(urdf))


def robot_from_urdf(path: str | Path) -> Robot:
    """The arm in a URDF file, as `robot_from_urdf_text` reads it.

    Raises BadInput where the file is missing or unreadable, or is not one serial arm of 1 to 8 turning joints.
    """
    from monitor.model.urdf import robot_from_urdf_text

    path = Path(path)
    try:
        text = path.read_text("utf-8")
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as wrong:
        raise BadInput(f"{path}: cannot be read: {wrong}") from None
    return robot_from_urdf_text(text, str(path))


def _from_toml(path: Path) -> Robot:
    try:
        return robot_from_document(tomllib.loads(path.read_text("utf-8")))
    except OSError as wrong:
        raise BadInput(f"--robot {path}: cannot be read: {wrong.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as wrong:
        raise BadInput(f"--robot {path}: not TOML: {wrong}") from None
    except BadInput as wrong:
        raise BadInput(f"--robot {path}: {wrong}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as wrong:
        why = f"{type(wrong).__name__}: {wrong}"
        raise BadInput(f"--robot {path}: is no arm ({why}); expected the keys of the shipped models, as --export writes them") from None


def named_recordings(paths: Sequence[Path], columns: str | None, rate_hz: float | None = None) -> list[Recording]:
    """Recordings whose source is the file's name as the user gave it, whatever source the file itself names."""
    return [dataclasses.replace(read_recording(local_file(path), columns, rate_hz), source=path.name) for path in paths]


def identify_files(request: Request) -> Outcome:
    """Everything that the command `identify` prints.

    Raises BadInput, also where the recordings do not fit into the memory, and Unidentifiable where the motion leaves parameters open.
    """
    try:
        return _identified(request)
    except MemoryError:
        raise BadInput(
            f"{', '.join(path.name for path in request.files)}: too long for the memory of this computer; expected recordings of minutes: "
            "give a part of the rows, or every second one"
        ) from None


def _identified(request: Request) -> Outcome:
    """`identify_files`, as far as the memory reaches."""
    robot, mounting = request.robot, request.mounting
    recordings, held_out, loaded = (
        named_recordings(paths, request.columns, request.rate_hz) for paths in (request.files, request.held_out, request.loaded)
    )
    gains, estimated = request.gains, None
    if request.pair is not None:
        estimated = _pair_gains(request, recordings[0])
        gains = _filled(estimated, request)
    earlier = None if request.rigid_from is None else _earlier(request.rigid_from, robot, mounting)
    found = identify(
        recordings, robot, mounting, method=request.method, friction=request.friction, gains=gains, rigid_from=earlier
    )  # fmt: skip
    validations: list[Validation] = [validate(found, recording, robot, gains) for recording in held_out]
    result = document(found, validations)
    told = warnings_of(HeldOut(recordings, held_out))
    for recording, validation in zip(held_out, validations, strict=True):
        told += _held_out(recording, validation, found, robot, gains)
    result["warnings"] += [warning.document() for warning in told]
    if estimated is not None:
        result["gains"] = gains_document(estimated)
    if loaded:
        result["payload"] = payload_document(identify_payload(loaded, found, robot, gains=gains))
        result["warnings"] += result["payload"].pop("warnings")
    return Outcome(document=result, identification=found, gains=gains, recordings=recordings, held_out=held_out)


def _held_out(recording: Recording, validation: Validation, found: Identification, robot: Robot, gains: Array | None) -> list[Reason]:
    """The warnings of a held-out recording: where it does not fit, what it is by itself is looked for."""
    predicted = Predicted(recording.source, validation.relative_rms, validation.relative_rms_all, found.relative_rms, None)
    told = warnings_of(predicted)
    if not told:
        return []
    try:
        alone = identify([recording], robot, found.mounting, gains=gains)
    except Unidentifiable:  # too little motion to say
        return told
    return warnings_of(predicted._replace(why=not_of_the_arm(alone) or silent_drive(alone)))


def check_export(path: Path, method: str) -> None:
    """Raises BadInput unless an arm can be written there. Commands call it before the identification runs."""
    if path.is_dir():
        raise BadInput(f"--export {path}: is a folder; expected the name of a file")
    if path.suffix not in {".urdf", ".toml"}:
        raise BadInput(f"--export {path}: expected a name that ends in .urdf or .toml")
    if not path.parent.is_dir():
        raise BadInput(f"--export {path}: the folder {path.parent} does not exist")
    if method != "consistent":
        raise BadInput(f"--export: --method {method} finds no masses of single links; expected --method consistent")


def export(path: Path, found: Identification) -> None:
    """Write the arm as a URDF or TOML. Raises BadInput as `check_export`."""
    check_export(path, found.method)
    if found.physical is not None:
        text = found.physical.urdf() if path.suffix == ".urdf" else found.physical.toml()
        try:
            path.write_text(text, "utf-8")
        except OSError as wrong:
            raise BadInput(f"--export {path}: cannot be written: {wrong.strerror}") from None


def _pair_gains(request: Request, unloaded: Recording) -> Gains:
    pair = request.pair
    if pair is None:
        raise BadInput("payload pair: no loaded run was given")
    loaded = named_recordings([pair.file], request.columns, request.rate_hz)[0]
    return payload_gains(
        unloaded, loaded, request.robot, request.mounting, pair.payload_kg, pair.com_m, payload_std_kg=pair.std_kg
    )  # fmt: skip


def _filled(estimated: Gains, request: Request) -> Array:
    """(J,) [N·m/A] the estimated gains; given or published ones where the pair does not determine a joint's gain.

    Raises BadInput naming the joints for which there is none.
    """
    known = request.gains if request.gains is not None else request.robot.drive_gain_nm_per_a
    gains: Array = np.where(np.isfinite(estimated.values), estimated.values, known)
    open_joints = np.flatnonzero(~np.isfinite(gains)) + 1
    if open_joints.size:
        raise BadInput(
            f"payload pair: says nothing of the gains of joints {', '.join(map(str, open_joints))}, and they are not published; "
            f"give --gains as well (the pair overrules them where it knows better)"
        )
    return gains


def _earlier(path: Path, robot: Robot, mounting: Mounting) -> Identification:
    try:
        result = json.loads(path.read_text("utf-8"))
    except OSError as wrong:
        raise BadInput(f"--rigid-from {path}: cannot be read: {wrong.strerror}") from None
    except (ValueError, RecursionError):
        raise BadInput(f"--rigid-from {path}: is not JSON; expected what `identify --json` printed") from None
    return identification_from_document(result, robot, mounting, str(path))
