"""Assess a series of recordings from files in the order of their times, as the daemon would. I/O."""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import BadInput
from monitor.identify.signals.arm import refuse_twice
from monitor.identify.signals.same_motion import of_one_trajectory, with_motions
from monitor.judge.alerts.health import alert_document
from monitor.judge.alerts.rules import why_not_alerting
from monitor.judge.assess import Rejected, assess
from monitor.judge.assessment import Assessment
from monitor.judge.document import plain
from monitor.judge.settings import AssessSettings
from monitor.model.robot import Mounting, Robot
from monitor.publish.timestamps import unix_s
from monitor.recording import Array, Recording
from monitor.store.formats.recordings import read_recording
from monitor.store.from_files.archived_files import local_file

UNDATED_START_UNIX_S = 946_684_800.0  # 2000-01-01: the time of the first file where files have no times of their own
MANIFEST_COLUMNS = ("file", "recorded_at", "payload_kg", "mounting", "note", "maintenance", "joint_serials", "revolutions")
_INTERVAL = re.compile(r"(\d+(?:\.\d+)?)\s*([smhdw])")
_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0, "w": 604_800.0}


class Entry(NamedTuple):
    """One recording, and what the user declares about it beside its own metadata."""

    file: Path
    recorded_at_unix_s: float | None = None
    payload_kg: float | None = None
    mounting: Mounting | None = None
    note: str | None = None
    maintenance: str | None = None
    joint_serials: tuple[str, ...] | None = None
    revolutions: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """The recordings to assess, with the arm and the settings."""

    entries: Sequence[Entry]
    robot: Robot
    mounting: Mounting = field(default_factory=Mounting)
    columns: str | None = None
    rate_hz: float | None = None  # rows a second of files that tell no time
    gains: Array | None = None
    settings: AssessSettings = field(default_factory=AssessSettings)
    trajectory: str | None = None  # the recordings are of one trajectory of this name, some of them stopped early


def interval_s(text: str) -> float:
    """`1d`, `6h`, `30m`, `90s` or `1w` in seconds. Raises BadInput."""
    match = _INTERVAL.fullmatch(text.strip())
    if match is None or not float(match[1]) > 0:
        raise BadInput(f"--interval {text!r}: expected a number and a unit of s, m, h, d or w, e.g. 1d")
    return float(match[1]) * _SECONDS[match[2]]


def spaced(files: Sequence[Path], interval: str) -> list[Entry]:
    """Entries for files without times of their own, one interval apart in the order given. Raises BadInput."""
    step = interval_s(interval)
    return [Entry(file, UNDATED_START_UNIX_S + k * step) for k, file in enumerate(files)]


def manifest(path: Path) -> list[Entry]:
    """The entries of a manifest (CSV); file names are relative to its folder.

    Columns `file, recorded_at` (RFC 3339, UTC where no offset is given) and optionally `payload_kg, mounting, note, maintenance`, and
    `joint_serials` and `revolutions`, one a joint with blanks between. Raises BadInput naming line and column.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as lines:
            rows = list(csv.DictReader(lines, skipinitialspace=True))
    except OSError as wrong:
        raise BadInput(f"--manifest {path}: cannot be read: {wrong.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as wrong:
        raise BadInput(f"--manifest {path}: is not CSV: {wrong}") from None
    if not rows:
        raise BadInput(f"--manifest {path}: names no recording; expected a header {', '.join(MANIFEST_COLUMNS[:2])} and a line a file")
    unknown = [str(name) for name in rows[0] if name not in MANIFEST_COLUMNS]
    missing = [name for name in MANIFEST_COLUMNS[:2] if name not in rows[0]]
    if unknown or missing:
        mistake = f"column {unknown[0]!r} is not known" if unknown else f"column {missing[0]!r} is missing"
        raise BadInput(f"--manifest {path}: {mistake}; expected file, recorded_at and, where known, {', '.join(MANIFEST_COLUMNS[2:])}")
    return [_entry(path, number, row) for number, row in enumerate(rows, start=2)]


def _entry(path: Path, line: int, row: dict[str, str]) -> Entry:
    where = f"--manifest {path}, line {line}"
    if not (row["file"] or "").strip():
        raise BadInput(f"{where}: no file")
    payload, mounting, note = ((row.get(name) or "").strip() for name in ("payload_kg", "mounting", "note"))
    try:
        payload_kg = float(payload) if payload else None
    except ValueError:
        raise BadInput(f"{where}: payload_kg is {payload!r}; expected kilograms") from None
    if payload_kg is not None and not 0 <= payload_kg < 1000:
        raise BadInput(f"{where}: payload_kg is {payload!r}; expected 0 or more kilograms")
    at = when((row["recorded_at"] or "").strip(), f"{where}: recorded_at")
    try:
        revolutions = tuple(float(count) for count in (row.get("revolutions") or "").split())
    except ValueError:
        raise BadInput(f"{where}: revolutions is {row['revolutions']!r}; expected figures, one a joint, with blanks between") from None
    return Entry(
        file=path.parent / row["file"].strip(),
        recorded_at_unix_s=at,
        payload_kg=payload_kg,
        mounting=Mounting.parse(mounting) if mounting else None,
        note=note or None,
        maintenance=(row.get("maintenance") or "").strip() or None,
        joint_serials=tuple((row.get("joint_serials") or "").split()) or None,
        revolutions=revolutions or None,
    )


def when(text: str, where: str) -> float:
    """Seconds since 1970 from RFC 3339; UTC where no offset is given. Raises BadInput."""
    try:
        return unix_s(text)
    except ValueError:
        raise BadInput(f"{where} is {text!r}; expected a time like 2026-01-31T03:00:00Z") from None


def assess_series(series: Series) -> dict[str, Any]:
    """All assessments as one document, the recordings taken in the order of their times.

    Recordings that name no trajectory are compared where their motion is the same.

    Raises BadInput where a file cannot be read, does not say when it was made, or two were made at the same time.
    """
    last: Assessment | None = None
    friction: list[dict[str, Any]] = []
    files: list[dict[str, Any]] = []
    alerts: dict[tuple[int | None, str], dict[str, Any]] = {}
    warnings: list[dict[str, Any]] = []
    for recording, outcome in judged(dated(series), series.robot, series.gains, series.settings):
        at = recording.context.recorded_at_unix_s
        if isinstance(outcome, Rejected):
            files.append({"file": recording.source, "recorded_at_unix_s": at, "verdict": "rejected", "reason": outcome.reason.document()})
            continue
        files.append({"file": recording.source, "recorded_at_unix_s": at, "verdict": "assessed", "reason": None})
        friction += [{"file": recording.source, "recorded_at_unix_s": at, **plain(joint)} for joint in outcome.friction]
        warnings += [{"file": recording.source, **plain(warning)} for warning in outcome.warnings]
        for transition in outcome.transitions:
            raised_in = alerts.get(transition.alert.key, {}).get("file") if transition.kind != "raised" else None
            alerts[transition.alert.key] = {**alert_document(transition.alert), "file": raised_in or recording.source}
        last = outcome
    if last is None:
        reasons = "; ".join(f"{row['file']}: {row['reason']['text']}" for row in files)
        raise BadInput(f"assess: no recording could be judged: {reasons}")
    return {
        "robot": last.robot,
        "recordings": files,
        "health": {"arm": last.health.state, "joints": [joint.state for joint in last.health.joints]},
        "why": {"arm": last.health.why.document(), "joints": [joint.why.document() for joint in last.health.joints]},
        "alerts": list(alerts.values()),
        "not_alerting": [
            {
                "joint": joint.joint,
                "reasons": [each.document() for each in why_not_alerting(last.health, last.belief, joint.joint, series.settings)],
            }
            for joint in last.health.joints
        ],
        "temperature": plain(last.temperature),
        "friction": friction,
        "contexts": plain(last.belief.contexts),
        "warnings": warnings,
    }


def judged(
    given: Sequence[tuple[Recording, Mounting]], robot: Robot, gains: Array | None, settings: AssessSettings
) -> Iterator[tuple[Recording, Assessment | Rejected]]:
    """The verdict of each recording with its mounting, in the order of their times, as `dated` gives them. Raises as `assess`."""
    last: Assessment | None = None
    mountings = [mounting for _, mounting in given]
    for recording, mounting in zip(with_motions([recording for recording, _ in given]), mountings, strict=True):
        outcome = assess(
            recording,
            robot=robot,
            mounting=mounting,
            belief=None if last is None else last.belief,
            health=None if last is None else last.health,
            model=None if last is None else last.model,
            gains=gains,
            settings=settings,
        )
        yield recording, outcome
        if not isinstance(outcome, Rejected):
            last = outcome


def given_entries(files: Sequence[Path], manifest_file: Path | None, interval: str | None) -> list[Entry]:
    """The entries that a command's arguments name. Raises BadInput."""
    if manifest_file is not None and (files or interval):
        raise BadInput("--manifest names the files and their times; expected it alone, without FILE… and --interval")
    if manifest_file is not None:
        return manifest(manifest_file)
    if not files:
        raise BadInput("no recording was given; expected FILE… or --manifest")
    return spaced(files, interval) if interval is not None else [Entry(file) for file in files]


def dated(series: Series) -> list[tuple[Recording, Mounting]]:
    """The recordings with their declarations and their mountings, in the order of their times.

    Raises BadInput where a file cannot be read, does not say when it was made, or two were made at the same time, and as
    `of_one_trajectory`.
    """
    given = in_order([_read(series, entry) for entry in series.entries])
    if series.trajectory is None:
        return given
    recordings = of_one_trajectory([recording for recording, _ in given], series.trajectory)
    return [(recording, mounting) for recording, (_, mounting) in zip(recordings, given, strict=True)]


def in_order(given: Sequence[tuple[Recording, Mounting]]) -> list[tuple[Recording, Mounting]]:
    """Dated recordings in the order of their times. Raises BadInput where two were made at the same time, or one is given twice."""
    found = sorted(given, key=lambda pair: pair[0].context.recorded_at_unix_s or 0.0)
    for (one, _), (other, _) in pairwise(found):
        if one.context.recorded_at_unix_s == other.context.recorded_at_unix_s:
            raise BadInput(f"{one.source} and {other.source} were recorded at the same time; expected one recording at a time")
    refuse_twice([recording for recording, _ in found])
    return found


def _read(series: Series, entry: Entry) -> tuple[Recording, Mounting]:
    """The recording with its declarations, and its mounting: the entry's, else the file's own, else the series'."""
    recording = replace(read_recording(local_file(entry.file), series.columns, series.rate_hz), source=entry.file.name)
    context = recording.context
    mounting = entry.mounting or series.mounting
    if entry.mounting is None and context.mounting_rad is not None:
        mounting = Mounting.of(context.mounting_rad)
    at = entry.recorded_at_unix_s if entry.recorded_at_unix_s is not None else context.recorded_at_unix_s
    if at is None:
        raise BadInput(f"{entry.file}: does not say when it was made; give --manifest with a column recorded_at, or --interval 1d")
    declared = replace(
        context,
        robot=context.robot or series.robot.name,
        recorded_at_unix_s=at,
        payload_kg=entry.payload_kg if entry.payload_kg is not None else context.payload_kg,
        mounting_rad=mounting.angles_rad,
        note=entry.note or context.note,
        maintenance=entry.maintenance or context.maintenance,
        joint_serials=entry.joint_serials or context.joint_serials,
        revolutions=entry.revolutions or context.revolutions,
    )
    return replace(recording, context=declared), mounting
