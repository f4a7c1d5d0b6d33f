"""Recordings as files: our Parquet, and what others call a recording in CSV.

Reading never repairs: a torn row stays a row, its unreadable fields NaN, so that `identify.signals` can count and tell it.
"""

import json
import os
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from monitor.errors import BadInput, StoreError
from monitor.recording import JOINT_COLUMNS, Array, Context, Recording

SCALAR_COLUMNS = {
    "timestamp": "t_s",
    "robot_mode": "robot_mode",
    "safety_mode": "safety_mode",
    "runtime_state": "runtime_state",
    "speed_scaling": "speed_scaling",
}
_METADATA = b"joint-monitor.recording.v1"
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_INDEXED = re.compile(r"(.+?)_?\[?(\d+)\]?")


class Layout(NamedTuple):
    """Which field of a row goes where."""

    scalars: dict[str, int]  # field of Recording → column
    joints: dict[str, list[int]]  # field of Recording → its J columns
    width: int  # fields a row
    payload: int | None = None  # column of the payload register


def read_recording(path: str | Path, columns: str | None = None) -> Recording:
    """A recording from our Parquet or from CSV; `columns` says what a CSV without RTDE names holds.

    Raises BadInput for a file that is missing, unreadable, not a recording or not laid out as said.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise BadInput(f"{path}: is a folder; expected a recording (Parquet or CSV)")
        if path.exists() and not path.is_file():
            raise BadInput(f"{path}: is no file; expected a recording, CSV or Parquet")
        with path.open("rb") as file:
            parquet = file.read(4) == b"PAR1"
        return _from_parquet(path) if parquet else _from_text(path, columns)
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except OSError as wrong:
        raise BadInput(f"{path}: cannot be read: {wrong.strerror or wrong}") from None


def write_recording(path: str | Path, recording: Recording) -> None:
    """The recording as Parquet (zstd), whole or not at all: temporary file, fsync, rename, fsync of the folder.

    Raises StoreError where the disk does not take it.
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
            with suppress(OSError):  # the first error is the one to tell
                os.unlink(temporary)
        raise StoreError(f"{path}: the recording cannot be written: {wrong.strerror or wrong}") from wrong


class RecordingFolder:
    """The files of one history's recordings; the name alone leads back to the ledger."""

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
            leftover.unlink()  # never renamed, so never promised


# --- Parquet ------------------------------------------------------------------------------------------------------------


def _column_names() -> dict[str, str]:
    """RTDE's name of every field; where two names mean one field, the first."""
    names = {field: name for name, field in SCALAR_COLUMNS.items()}
    for name, field in JOINT_COLUMNS.items():
        names.setdefault(field, name)
    return names


def _table(recording: Recording) -> pa.Table:
    names = _column_names()
    columns: dict[str, Any] = {}
    for field, values in recording.signals.items():
        if values.ndim == 1:
            columns[names[field]] = pa.array(values)
        else:
            columns |= {f"{names[field]}_{j}": pa.array(np.ascontiguousarray(column)) for j, column in enumerate(values.T)}
    about = {"context": asdict(recording.context), "quality": dict(recording.quality), "source": recording.source}
    return pa.table(columns).replace_schema_metadata({_METADATA: json.dumps(about, default=_plain).encode()})


def _plain(value: Any) -> Any:
    """JSON of numpy's numbers and arrays, which acquisition may have put into `quality`."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be kept in a recording's metadata")


def _from_parquet(path: Path) -> Recording:
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, ValueError) as wrong:
        raise BadInput(f"{path}: is not readable Parquet: {str(wrong).splitlines()[0]}") from None
    layout = _layout_by_name(str(path), table.column_names)

    def column(k: int) -> Array:
        try:
            return np.asarray(table.column(k).to_numpy(), dtype=float)
        except (ValueError, TypeError):
            raise BadInput(f"{path}: column {table.column_names[k]} does not hold numbers") from None

    signals: dict[str, Any] = {field: column(k) for field, k in layout.scalars.items()}
    signals |= {field: np.stack([column(k) for k in ks], axis=1) for field, ks in layout.joints.items()}
    about = (table.schema.metadata or {}).get(_METADATA)
    if about is None:
        payload = None if layout.payload is None else _constant(column(layout.payload))
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


# --- CSV ----------------------------------------------------------------------------------------------------------------


def _from_text(path: Path, columns: str | None) -> Recording:
    text = path.read_text("utf-8-sig", errors="replace")
    if "\0" in text[:4096]:
        raise BadInput(f"{path}: is binary, and not Parquet; expected a recording as Parquet or CSV")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise BadInput(f"{path}: is empty")
    separator = _separator(lines[0])
    first = _split(lines[0], separator)
    headed = any(field and not _NUMBER.fullmatch(field) for field in first)
    body = lines[1:] if headed else lines
    if not body:
        raise BadInput(f"{path}: holds a header and no rows")
    if headed and separator != (of_body := _separator(body[0])) and len(_split(body[0], of_body)) == len(first):
        separator = of_body  # names with commas between them above numbers with other separators do exist
    usual, _ = Counter(len(_split(line, separator)) for line in body[:1000]).most_common(1)[0]
    if columns is not None:
        layout = parse_columns(columns)
    elif headed:
        layout = _layout_by_name(str(path), first)
    else:
        raise BadInput(
            f"{path}: has no header; say what its {usual} columns are, e.g. --columns timestamp,actual_q:6,actual_qd:6,actual_current:6"
        )
    if usual != layout.width and not (usual > layout.width and _only_padding(body, separator, layout.width)):
        told = f"--columns {columns} names {layout.width}" if columns is not None else f"its header names {layout.width}"
        raise BadInput(f"{path}: rows have {usual} columns, {told}")
    return _recording(path, layout, body, separator)


def _separator(line: str) -> str | None:
    """`;`, tab, `,`, or None for any white space."""
    for candidate in ";\t":
        if candidate in line:
            return candidate
    tokens = line.split()
    if "," in line and (len(tokens) == 1 or any(token.endswith(",") or token.count(",") > 1 for token in tokens)):
        return ","
    return None  # also 1,5 2,5: commas within the fields are decimal commas


def _split(line: str, separator: str | None) -> list[str]:
    return [field.strip().strip('"') for field in line.split(separator)]


def _only_padding(lines: Sequence[str], separator: str | None, width: int) -> bool:
    """Whether what stands beyond the expected columns is empty: separators that a spreadsheet left at the end."""
    return all(not any(_split(line, separator)[width:]) for line in lines[:100])


def _recording(path: Path, layout: Layout, lines: Sequence[str], separator: str | None) -> Recording:
    wanted = [*layout.scalars.values(), *(k for ks in layout.joints.values() for k in ks)]
    if layout.payload is not None:
        wanted.append(layout.payload)
    rows = np.full((len(lines), layout.width), np.nan)
    decimal_comma = separator != ","
    for row, line in zip(rows, lines, strict=True):
        parts = _split(line, separator)
        if len(parts) < layout.width or any(parts[layout.width :]):
            continue  # torn: which field stands where is not known, and the last one may be cut
        for k in wanted:
            row[k] = _number(parts[k], decimal_comma)
    signals: dict[str, Any] = {field: rows[:, k] for field, k in layout.scalars.items()}
    signals |= {field: rows[:, ks] for field, ks in layout.joints.items()}
    payload = None if layout.payload is None else _constant(rows[:, layout.payload])
    return Recording(**signals, context=Context(payload_kg=payload), source=path.name)


def _number(text: str, decimal_comma: bool) -> float:
    """A field as a number; NaN for what is none, so that the row is counted as torn."""
    try:
        return float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return float("nan")


def _constant(values: Array) -> float | None:
    """The one value of a register that did not change, else None."""
    known = np.unique(values[np.isfinite(values)])
    return float(known[0]) if len(known) == 1 else None


# --- Which column is what -------------------------------------------------------------------------------------------------


def _layout_by_name(source: str, names: Sequence[str]) -> Layout:
    """The layout of a header in RTDE's names, `actual_q_0` … `actual_q_5`.

    Raises BadInput where positions, or the time, are not among them.
    """
    scalars = {SCALAR_COLUMNS[name]: k for k, name in enumerate(names) if name in SCALAR_COLUMNS}
    found: dict[str, dict[int, int]] = {}
    for k, name in enumerate(names):
        match = _INDEXED.fullmatch(name)
        if match and match[1] in JOINT_COLUMNS:
            found.setdefault(match[1], {})[int(match[2])] = k
    if "actual_q" not in found:
        shown = ", ".join(name for name in names if name)[:160]
        raise BadInput(
            f"{source}: holds no joint positions (actual_q_0, actual_q_1, …), so nothing can be identified from it; it names {shown}. "
            "Where they stand under other names, say so with --columns"
        )
    if "t_s" not in scalars:
        raise BadInput(f"{source}: holds no column timestamp; where the time has another name, say so with --columns")
    count = len(found["actual_q"])
    joints: dict[str, list[int]] = {}
    for name, places in found.items():
        if sorted(places) != list(range(count)):
            numbers = ", ".join(str(j) for j in sorted(places))
            raise BadInput(f"{source}: {name} has the indices {numbers}; expected 0 … {count - 1} as many as there are positions")
        joints.setdefault(JOINT_COLUMNS[name], [places[j] for j in range(count)])
    width = len(names)
    while width and not names[width - 1]:
        width -= 1  # separators that a spreadsheet left at the end of the line
    return Layout(scalars, joints, width, names.index("payload") if "payload" in names else None)


def parse_columns(spec: str) -> Layout:
    """The layout of a `--columns` text: names in order, `name:N` for one column a joint, `skip` or `skip:N` for what is not read.

    Raises BadInput for a name that is not known, a count that is none, or where time or positions are missing.
    """
    scalars: dict[str, int] = {}
    joints: dict[str, list[int]] = {}
    width = 0
    for name, count in _spec_parts(spec):
        if name in SCALAR_COLUMNS:
            if count != 1 or SCALAR_COLUMNS[name] in scalars:
                raise BadInput(f"--columns: {name} is one column, once; found {name}:{count} or a second one")
            scalars[SCALAR_COLUMNS[name]] = width
        elif name in JOINT_COLUMNS:
            joints.setdefault(JOINT_COLUMNS[name], []).extend(range(width, width + count))
        elif name != "skip":
            raise BadInput(f"--columns: {name!r} is not known; known are {', '.join([*SCALAR_COLUMNS, *JOINT_COLUMNS, 'skip'])}")
        width += count
    if "t_s" not in scalars or "q" not in joints:
        raise BadInput("--columns: timestamp and actual_q:N are needed, e.g. timestamp,actual_q:6,actual_qd:6,actual_current:6")
    for field, places in joints.items():
        if len(places) != len(joints["q"]):
            raise BadInput(
                f"--columns: {_column_names()[field]} has {len(places)} columns, actual_q has {len(joints['q'])}; expected as many"
            )
    return Layout(scalars, joints, width)


def _spec_parts(spec: str) -> Iterator[tuple[str, int]]:
    """Name and number of columns of each part; `actual_q_0,actual_q_1` counts as two of actual_q."""
    for part in spec.split(","):
        name, colon, number = (text.strip() for text in part.partition(":"))
        if colon and not (number.isascii() and number.isdigit() and 1 <= int(number) <= 1000):
            raise BadInput(f"--columns: {part.strip()!r}; expected NAME or NAME:COUNT, e.g. actual_q:6")
        indexed = _INDEXED.fullmatch(name)
        if not colon and indexed and indexed[1] in JOINT_COLUMNS:
            name = indexed[1]
        yield name, int(number) if colon else 1
