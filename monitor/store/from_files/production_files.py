"""Recordings of production from files → what they tell of friction: what the command `listen` asks. I/O."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.detectors import CURRENT_IS_TARGET, REJECTED_ROWS, of_simulator, warnings_of
from monitor.identify.document import identification_from_document
from monitor.identify.identification import Identification
from monitor.identify.identify import identify
from monitor.identify.production.arm import ProductionArm, ProductionRows, windows
from monitor.identify.production.cut import CAUSES
from monitor.identify.production.estimate import ProductionEstimate, estimate
from monitor.identify.production.gather import WINDOW_S, gather, initial
from monitor.identify.production.information import ProductionInformation
from monitor.identify.quality import not_of_the_arm, silent_drive
from monitor.identify.settings import ProductionSettings
from monitor.identify.signals.arm import refuse_other_arm, refuse_twice
from monitor.identify.signals.motion import FEWEST_ROWS
from monitor.identify.signals.rows import HARMLESS, sound_rows
from monitor.identify.signals.units import in_si
from monitor.model.robot import Mounting, Robot
from monitor.reason import Sentence
from monitor.recording import DAY_S, Array, Recording, known_or_none
from monitor.store.formats.recordings import read_production, read_recording
from monitor.store.from_files.archived_files import local_file
from monitor.store.store import Store

DURING = Sentence("in_recordings", "in these recordings")
CLEAR = 2.0  # deviations from which friction is another than in the replay


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ListenRequest:
    """The recordings of production, and the arm that they are of."""

    files: Sequence[Path]
    rigid: Path | None  # of the replay: its recording, or its `identify --json`
    history: Path | None  # instead of `rigid`: the folder of a daemon's history, whose last replay is taken
    robot: Robot | None  # None: as the replay's recording says
    mounting: Mounting | None  # None: likewise, else the ground
    columns: str | None = None
    rate_hz: float | None = None  # rows a second of files that tell no time
    gains: Array | None = None  # (J,) [N·m/A]
    settings: ProductionSettings = field(default_factory=ProductionSettings)


def listen_to_files(
    request: ListenRequest, load_robot: Callable[[str], Robot], show: Callable[[str, float, float], None] = lambda *_: None
) -> dict[str, Any]:
    """The document of the command `listen`.

    show : is called with the file, the seconds of it that were judged, and its length. Raises BadInput, of which Unidentifiable is one,
    where a file is no recording, or replay, arm and production do not belong together.
    """
    arm, source = _arm(request, load_robot)
    listened = [read_production(local_file(path), request.columns, request.rate_hz) for path in request.files]
    listened = [
        replace(production, recording=replace(production.recording, source=path.name))
        for production, path in zip(listened, request.files, strict=True)
    ]
    for production in listened:
        refuse_other_arm(production.recording, arm.robot)
    refuse_twice([production.recording for production in listened])
    total, files, warnings = initial(arm, request.settings), [], []
    known_times = [
        production.recording.context.recorded_at_unix_s
        for production in listened
        if production.recording.context.recorded_at_unix_s is not None
    ]
    for production in listened:
        name = production.recording.source
        if of_simulator(production.recording):
            warnings.append(CURRENT_IS_TARGET(source=name).document())
        in_units = in_si(production.recording)
        warnings += [warning.document() for warning in warnings_of(in_units)]
        repaired = in_units.recording
        repeated = {reason: count for reason, count in sound_rows(repaired).why.items() if reason in HARMLESS}  # no time is lost by them
        if repeated:
            why = [f"{count} {reason}" for reason, count in repeated.items()]
            rejected = sum(repeated.values())
            warnings.append(REJECTED_ROWS(source=name, rejected=rejected, recorded=repaired.samples, why=why).document())
        _refuse_other_columns(replace(production, recording=repaired), arm)
        if repaired.context.recorded_at_unix_s is None and known_times:
            repaired = replace(repaired, context=replace(repaired.context, recorded_at_unix_s=known_times[0]))
        told = _told(replace(production, recording=repaired), arm, request.settings, total, show)
        files.append(_file_document(name, repaired, told))
        total = total + told
    now = max((sums.end_unix_s for sums in total.cells.values()), default=0.0)
    days = 1.0 + (now - min((sums.begin_unix_s for sums in total.cells.values()), default=now)) / DAY_S
    found = estimate(total, arm.identification, replace(request.settings, period_days=max(days, 1.0)), now, during=DURING())
    return {
        "robot": arm.robot.name,
        "replay": _replay_document(source, arm, request.settings),
        "files": files,
        **found.to_document(),
        "changes": _changes(found, arm.identification),
        "causes": {cause: CAUSES.get(cause, "at another temperature than most") for cause in found.left_out_s},
        "warnings": warnings,
    }


def _refuse_other_columns(production: ProductionRows, arm: ProductionArm) -> None:
    """Raises BadInput where the first window with enough motion says by itself that it is not what it was given as."""
    for window in windows(production, WINDOW_S):
        if window.recording.samples < FEWEST_ROWS:
            continue
        try:
            found = identify([window.recording], arm.robot, arm.mounting, gains=arm.gains)
        except Unidentifiable:
            continue
        if (other := not_of_the_arm(found) or silent_drive(found)) is not None:
            name = f"{production.recording.source}: "
            raise BadInput(f"{name}{other.text.removeprefix(name)}; expected the columns and units of the replay, every joint measured")
        return


def _told(
    production: ProductionRows,
    arm: ProductionArm,
    settings: ProductionSettings,
    before: ProductionInformation,
    show: Callable[[str, float, float], None],
) -> ProductionInformation:
    """What one file tells, window by window."""
    name, duration_s = production.recording.source, production.recording.duration_s
    total = initial(arm, settings)
    for number, window in enumerate(windows(production, WINDOW_S)):
        show(name, min(number * WINDOW_S, duration_s), duration_s)
        total = total + gather(window, arm, settings, before + total)
    return total


def _arm(request: ListenRequest, load_robot: Callable[[str], Robot]) -> tuple[ProductionArm, str]:
    """The arm with the identification of its replay, and where that comes from."""
    if (request.rigid is None) == (request.history is None):
        which = "neither" if request.rigid is None else "both"
        raise BadInput(f"{which} of --rigid and --history given; expected one: the replay that tells the weight of the arm")
    path = request.rigid if request.history is None else _last_replay(request.history)
    assert path is not None
    try:
        text = path.read_text("utf-8") if path.suffix == ".json" else None
    except (OSError, UnicodeDecodeError) as wrong:
        raise BadInput(f"--rigid {path}: cannot be read: {wrong}") from None
    if text is not None:
        try:
            plain = json.loads(text)
        except (ValueError, RecursionError):
            raise BadInput(f"--rigid {path}: is not JSON; expected what `identify --json` printed") from None
        robot = request.robot or load_robot(str(plain.get("robot")) if isinstance(plain, dict) else "")
        mounting = request.mounting or _mounting_of(plain)
        found, payload_kg = identification_from_document(plain, robot, mounting, str(path)), None
    else:
        recording = read_recording(path, request.columns, request.rate_hz)
        if request.robot is None and recording.context.robot is None:
            raise BadInput(f"{path}: does not say of which robot it is; say so with --robot")
        robot = request.robot or load_robot(str(recording.context.robot))
        angles = recording.context.mounting_rad
        mounting = request.mounting or (Mounting() if angles is None else Mounting.of(angles))
        found = identify([recording], robot, mounting, gains=request.gains, residual_friction=True)
        payload_kg = recording.context.payload_kg
    return ProductionArm(robot=robot, mounting=mounting, identification=found, gains=request.gains, payload_kg=payload_kg), str(path)


def _mounting_of(plain: Any) -> Mounting:
    """The mounting in a document of `identify --json`."""
    try:
        angles = plain["mounting"]
        return Mounting.of([np.deg2rad(float(angles[f"{axis}_deg"])) for axis in ("roll", "pitch", "yaw")])
    except (KeyError, TypeError, ValueError):
        return Mounting()


def _last_replay(history: Path) -> Path:
    """The recording of the last replay that was assessed. Raises BadInput where there is none."""
    with Store.reader(history) as store:
        for number in reversed(store.assessments.replays()):
            if (path := store.archived.path(number)).exists():
                return path
    raise BadInput(f"--history {history}: has no recording of an assessed replay; expected one at least")


def _file_document(name: str, recording: Recording, told: ProductionInformation) -> dict[str, Any]:
    """One file: its length, what counted of it, what not."""
    left, seen = told.left_out(), sum(told.seen_s.values())
    step = np.diff(recording.t_s[np.isfinite(recording.t_s)])
    step = step[step > 0.0]
    return {
        "file": name,
        "samples": recording.samples,
        "rate_hz": 1.0 / float(np.median(step)) if len(step) else None,
        "duration_s": seen,
        "counted_s": max(0.0, seen - sum(left.values())),
        "left_out_s": left,
    }


def _replay_document(source: str, arm: ProductionArm, settings: ProductionSettings) -> dict[str, Any]:
    """The replay from which the difference is measured."""
    torque, _ = arm.identification.friction_at(settings.reference_speed_rad_s)
    temperature = arm.identification.temperature_c
    return {
        "source": source,
        "friction_nm": [known_or_none(value) for value in torque],
        "temperature_c": None if temperature is None else [known_or_none(value) for value in temperature],
    }


def _changes(found: ProductionEstimate, replay: Identification) -> list[dict[str, Any]]:
    """The change of each joint's friction since the replay, as a fraction, and whether it is clear. Temperature is part of it."""
    before, _ = replay.friction_at(found.reference_speed_rad_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        change, std = found.friction_nm / before - 1.0, found.deviation_nm / before
    return [
        {"joint": j + 1, "change": known_or_none(change[j]), "std": known_or_none(std[j]), "clear": bool(abs(change[j]) > CLEAR * std[j])}
        for j in range(len(change))
    ]
