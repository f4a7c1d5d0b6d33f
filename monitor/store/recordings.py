"""Recordings as files: our own Parquet, and text in the formats of others.

Reading repairs nothing: a torn row stays a row with NaN in its unreadable fields, so that `identify.signals` can count and report it.
"""

import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from monitor.errors import BadInput, StoreError
from monitor.recording import Array, Context, Recording
from monitor.store.columns import constant_value, layout_by_name, named_columns
from monitor.store.text_recordings import read_text

_METADATA = b"joint-monitor.recording.v1"


def read_recording(path: str | Path, columns: str | None = None) -> Recording:
    """Read a recording from our Parquet or from CSV. columns : the layout of a CSV without RTDE's names, as `parse_columns` takes it.

    Raises BadInput for a file that is missing, unreadable, no recording, or laid out otherwise.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise BadInput(f"{path}: is a folder; expected a recording (Parquet or CSV)")
        if path.exists() and not path.is_file():
            raise BadInput(f"{path}: is no file; expected a recording, CSV or Parquet")
        with path.open("rb") as file:
            parquet = file.read(4) == b"PAR1"
        return _read_parquet(path) if parquet else read_text(path, columns)
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except OSError as wrong:
        raise BadInput(f"{path}: cannot be read: {wrong.strerror or wrong}") from None


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording as Parquet (zstd), whole or not at all: temporary file, fsync, rename, fsync of the folder.

    Raises StoreError where the disk refuses.
    """
    path = Path(path)
    table = _table(recording)
    temporary: str | None = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            pq.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the rename itself must survive a power cut
        finally:
            os.close(folder)
    except OSError as wrong:
        if temporary is not None:
            with suppress(OSError):  # the first error is the one to report
                os.unlink(temporary)
        raise StoreError(f"{path}: the recording cannot be written: {wrong.strerror or wrong}") from wrong


class RecordingFolder:
    """The files of one history's recordings. Each name holds the id of its window in the ledger."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def path(self, ledger_id: int) -> Path:
        """Where the recording of a window belongs."""
        return self.directory / f"replay-{ledger_id:06d}.parquet"

    def first_pass_path(self, ledger_id: int) -> Path:
        """Where the recording of a window's first pass belongs."""
        return self.directory / f"replay-{ledger_id:06d}-first-pass.parquet"

    def numbered(self) -> list[tuple[int, Path]]:
        """All recordings on disk with the ids of their windows, ascending; first passes are left out."""
        found = self.directory.glob("replay-" + "[0-9]" * 6 + ".parquet")
        return sorted((int(path.stem.removeprefix("replay-")), path) for path in found)

    def remove_temporary(self) -> None:
        """Remove what a crash left of recordings that were being written."""
        for leftover in self.directory.glob(".*.tmp*"):
            leftover.unlink()  # it was never renamed, so nothing relies on it


def _table(recording: Recording) -> pa.Table:
    columns = {name: pa.array(np.ascontiguousarray(values)) for name, values in named_columns(recording).items()}
    about = {"context": asdict(recording.context), "quality": dict(recording.quality), "source": recording.source}
    return pa.table(columns).replace_schema_metadata({_METADATA: json.dumps(about, default=_plain).encode()})


def _plain(value: Any) -> Any:
    """JSON of numpy's numbers and arrays, which acquisition may have put into `quality`."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be kept in a recording's metadata")


def _read_parquet(path: Path) -> Recording:
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, ValueError) as wrong:
        raise BadInput(f"{path}: is not readable Parquet: {str(wrong).splitlines()[0]}") from None
    layout = layout_by_name(str(path), table.column_names)

    def column(k: int) -> Array:
        try:
            return np.asarray(table.column(k).to_numpy(), dtype=float)
        except (ValueError, TypeError):
            raise BadInput(f"{path}: column {table.column_names[k]} does not hold numbers") from None

    signals: dict[str, Any] = {field: column(k) for field, k in layout.scalars.items()}
    signals |= {field: np.stack([column(k) for k in ks], axis=1) for field, ks in layout.joints.items()}
    about = (table.schema.metadata or {}).get(_METADATA)
    if about is None:
        payload = None if layout.payload is None else constant_value(column(layout.payload))
        return Recording(**signals, context=Context(payload_kg=payload), source=path.name)
    try:
        document = json.loads(about)
        return Recording(
            **signals, context=_context(document["context"]), quality=document["quality"], source=document["source"] or path.name
        )
    except (ValueError, KeyError, TypeError) as wrong:
        raise BadInput(f"{path}: its metadata is not a joint-monitor recording's: {wrong!r}") from None


def _context(document: Mapping[str, Any]) -> Context:
    known = {field.name for field in fields(Context)}
    values = {key: value for key, value in document.items() if key in known}  # a later version may have added some
    if values.get("mounting_rad") is not None:
        roll, pitch, yaw = values["mounting_rad"]
        values["mounting_rad"] = (roll, pitch, yaw)
    for key in ("joint_serials", "revolutions"):
        if values.get(key) is not None:
            values[key] = tuple(values[key])
    return Context(**values)
