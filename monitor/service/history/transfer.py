"""Export of a history as tables, and import of recordings made elsewhere. I/O."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from monitor.config.schema import Configuration
from monitor.errors import BadInput, StoreError
from monitor.identify.signals.same_motion import with_motions
from monitor.publish.timestamps import rfc3339
from monitor.reason import Reason
from monitor.recording import Recording
from monitor.service.history.assess_and_store import assess_stored, load_state, state_after
from monitor.store.formats.columns import named_columns
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.from_files.series import Entry, Series, dated
from monitor.store.store import Store

AHEAD_S = 300.0  # [s] the clock of the host that made a recording may be so far ahead
LONGEST_S = 2e11  # [s] until the year 8307; `datetime` has no later dates
RECENT = 3  # assessed recordings of the history, with whose motions those of new ones are compared
QUANTILES = ("p10", "p50", "p90")  # of remaining life, as a list in documents
# each with the columns of an empty table, so that a reader finds a header
TABLES = {
    "friction": ("replay", "joint", "recorded_at"),
    "ledger": ("replay", "window", "kind", "state", "reason", "started_at", "ended_at", "recording", "recording_removed_at"),
    "events": ("seq", "at", "replay", "kind", "joint", "condition"),
    "assessments": ("replay", "recorded_at", "made_with", "document"),
}


def table(store: Store, what: str, from_unix_s: float | None = None, to_unix_s: float | None = None) -> pd.DataFrame:
    """One of `TABLES`, its times as UTC timestamps and its nested fields as columns joined by a dot.

    Raises BadInput for another name.
    """
    if what not in TABLES:
        raise BadInput(f"--what {what!r}: expected one of {', '.join(TABLES)}, or recording")
    rows: list[dict[str, Any]]
    if what == "friction":
        rows, after = [], 0
        while True:
            page, following = store.assessments.history(from_unix_s=from_unix_s, to_unix_s=to_unix_s, after=after, limit=10_000)
            rows += page
            if following is None:
                break
            after = following
        at = "recorded_at_unix_s"
    elif what == "ledger":
        rows = [
            {
                "replay": row.id, "window_unix_s": row.window_unix_s, "kind": row.kind, "state": row.state, "reason": row.reason_text,
                "started_at_unix_s": row.started_at_unix_s, "ended_at_unix_s": row.ended_at_unix_s, "recording": row.recording,
                "recording_removed_at_unix_s": row.removed_at_unix_s,
            }
            for row in store.ledger.rows()
        ]  # fmt: skip
        at = "window_unix_s"
    elif what == "events":
        rows = [
            {"seq": event.seq, "at_unix_s": event.at_unix_s, "replay": event.ledger_id, **event.document} for event in store.events.rows()
        ]
        at = "at_unix_s"
    else:
        rows = [
            {
                "replay": verdict.ledger_id, "recorded_at_unix_s": verdict.recorded_at_unix_s, "made_with": verdict.made_with,
                "document": json.dumps(verdict.document, ensure_ascii=False),
            }
            for verdict in store.assessments.rows()
        ]  # fmt: skip
        at = "recorded_at_unix_s"
    inside = [row for row in rows if _inside(row[at], from_unix_s, to_unix_s)]
    if not inside:
        return pd.DataFrame(columns=list(TABLES[what]))
    frame = pd.json_normalize(inside)
    for column in [name for name in frame.columns if name.endswith("_unix_s")]:
        times = pd.to_datetime(pd.to_numeric(frame[column]), unit="s", utc=True)
        frame = frame.assign(**{column: times}).rename(columns={column: column.removesuffix("_unix_s")})
    return frame


def write_table(frame: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV or Parquet, by the name's suffix. Raises BadInput for another suffix, StoreError where the disk refuses."""
    try:
        if path.suffix == ".parquet":
            frame.to_parquet(path, index=False, compression="zstd")
        elif path.suffix == ".csv":
            _without_lists(frame).to_csv(path, index=False, date_format="%Y-%m-%dT%H:%M:%S.%fZ")
        else:
            raise BadInput(f"{path}: expected a name that ends in .csv or .parquet")
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def _without_lists(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with a column for each element of its lists: a cell of a CSV is a figure or a text."""
    columns: dict[str, Any] = {}
    for name in frame.columns:
        width = max((len(cell) for cell in frame[name] if isinstance(cell, list)), default=None)
        if width is None:
            columns[name] = frame[name]
            continue
        parts = QUANTILES if str(name).startswith("remaining_") and width == len(QUANTILES) else [str(k + 1) for k in range(width)]
        for k, part in enumerate(parts):
            columns[f"{name}.{part}"] = [cell[k] if isinstance(cell, list) and k < len(cell) else None for cell in frame[name]]
    return pd.DataFrame(columns)


def export_recording(store: Store, replay: int, path: Path) -> Recording:
    """Write one recording as our Parquet, or as CSV with RTDE's names. Raises BadInput where there is no recording of the replay."""
    source = store.archived.path(replay)
    if not source.is_file():
        raise BadInput(f"replay {replay}: there is no recording of it (aborted, skipped, or let go of by [store] recordings_days)")
    recording = read_recording(source)
    if path.suffix == ".parquet":
        write_recording(path, recording)
    else:
        write_table(pd.DataFrame(named_columns(recording)), path)
    return recording


def import_recordings(
    store: Store, configuration: Configuration, entries: list[Entry], columns: str | None, rate_hz: float | None = None
) -> dict[str, Any]:
    """Assess recordings made elsewhere in the order of their times, and mark them as imported. Returns counts and rejections.

    Recordings that name no trajectory get a name by their motion, so that another motion has a baseline of its own.

    Raises BadInput and changes nothing where a recording is not later than the last assessed one, is dated in the future, was made with
    another mounting than this arm's, or is in the history under another date.
    """
    robot, mounting = configuration.robot_description, configuration.mounting
    found = dated(Series(entries=entries, robot=robot, mounting=mounting, columns=columns, rate_hz=rate_hz))
    known = load_state(store)
    last = None if known.belief is None else known.belief.at_unix_s
    for recording, hangs in found:
        at = recording.context.recorded_at_unix_s or 0.0
        if hangs.angles_rad != mounting.angles_rad:
            raise BadInput(f"{recording.source}: hangs otherwise than [robot] mounting = {configuration.robot.mounting!r}")
        if not 0.0 <= at <= time.time() + AHEAD_S:
            when = rfc3339(at) if abs(at) < LONGEST_S else f"{at:g} s after 1970"
            raise BadInput(f"{recording.source}: was made at {when}; expected a time between 1970 and now")
        known_as = store.assessments.replay_of(recording.samples_digest)
        if known_as is not None and known_as.recorded_at_unix_s != at:
            raise BadInput(
                f"{recording.source}: is replay {known_as.ledger_id} of {rfc3339(known_as.recorded_at_unix_s)} once more, under another "
                "date: it says nothing new; leave it out"
            )
        if last is not None and at <= last and at not in store.ledger.windows(at, at):
            raise BadInput(
                f"{recording.source}: was made at {rfc3339(at)}, before the last replay that was learnt from ({rfc3339(last)}); recordings "
                "are learnt in time order: import them before the first replay, or into a history of their own"
            )
    result: dict[str, Any] = {"assessed": 0, "known_already": 0, "rejected": []}
    for recording in _with_motions_of(store, [recording for recording, _ in found]):
        at = recording.context.recorded_at_unix_s or 0.0
        ledger_id = store.ledger.claim_import(at, time.time())
        if ledger_id is None:
            result["known_already"] += 1
            continue
        write_recording(store.recordings.path(ledger_id), recording)
        store.ledger.mark_recorded(ledger_id)
        entered = assess_stored(store, configuration, known, ledger_id, time.time)
        known = state_after(known, entered)
        if isinstance(entered.outcome, Reason):
            result["rejected"].append({"file": recording.source, "reason": entered.outcome.text})
        else:
            result["assessed"] += 1
    return result


def _with_motions_of(store: Store, recordings: Sequence[Recording]) -> Iterator[Recording]:
    """The recordings in their order, each with the name that the history has for its motion.

    A motion that the history holds without a name, as it was imported until 0.2.0, keeps none: a name would open another baseline.
    """
    paths = (store.recordings.path(row.id) for row in store.ledger.rows(limit=RECENT, states=("assessed",)))
    earlier = [read_recording(path) for path in paths if path.is_file()]
    named = list(with_motions([*earlier, *recordings]))
    nameless = {
        after.context.trajectory_digest for before, after in zip(earlier, named, strict=False) if before.context.trajectory_digest is None
    }
    for given, one in zip(recordings, named[len(earlier) :], strict=True):
        yield given if one.context.trajectory_digest in nameless else one


def _inside(at: float | None, from_unix_s: float | None, to_unix_s: float | None) -> bool:
    if at is None:
        return from_unix_s is None and to_unix_s is None
    return (from_unix_s is None or at >= from_unix_s) and (to_unix_s is None or at < to_unix_s)
