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
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.errors import BadInput, StoreError
from monitor.identify.production.arm import ProductionRows
from monitor.recording import Array, Context, Recording
from monitor.store.formats.arrays import is_arrays, read_arrays
from monitor.store.formats.bags import bag_ends, read_bag
from monitor.store.formats.columns import layout_as_written, layout_of_table, named_columns, recorded
from monitor.store.formats.others import refuse_others, refuse_unpacked, unpacked
from monitor.store.formats.text_recordings import number, read_text, time_of

if TYPE_CHECKING:
    import pyarrow as pa

METADATA = b"joint-monitor.recording.v1"


def read_recording(path: str | Path, columns: str | None = None, rate_hz: float | None = None) -> Recording:
    """Read a recording from any format of `FORMATS`. columns, rate_hz : what its columns are, as `layout_of` takes them.

    Raises BadInput for a file that is missing, unreadable, no recording, or laid out otherwise.
    """
    return read_production(path, columns, rate_hz).recording


def read_production(path: str | Path, columns: str | None = None, rate_hz: float | None = None) -> ProductionRows:
    """`read_recording` with the columns that only production needs, as far as the file has them. Raises as `read_recording`."""
    path = Path(path)
    try:
        if path.is_dir() and not (path / "metadata.yaml").is_file():  # that of a bag
            raise BadInput(f"{path}: is a folder; expected a recording (Parquet or CSV)")
        if path.is_dir():
            return read_bag(path, columns, rate_hz)
        if path.exists() and not path.is_file():
            raise BadInput(f"{path}: is no file; expected a recording, CSV or Parquet")
        content = path.read_bytes()
        if (bag := bag_ends(content)) is not None:
            if path.suffix != bag:
                raise BadInput(f"{path}: is a bag of ROS by its content; expected a name that ends in {bag}")
            return read_bag(path, columns, rate_hz)
        return _read(unpacked(content, str(path)), str(path), columns, rate_hz)
    except FileNotFoundError:
        raise BadInput(f"{path}: no such file") from None
    except OSError as wrong:
        first, *_ = (wrong.strerror or str(wrong) or type(wrong).__name__).splitlines()
        raise BadInput(f"{path}: cannot be read: {first}") from None


def _read(content: bytes, where: str, columns: str | None, rate_hz: float | None) -> ProductionRows:
    if content.startswith(b"PAR1"):
        import pyarrow as pa

        return _of_parquet(pa.BufferReader(content), where, columns, rate_hz)
    if is_arrays(content):
        return read_arrays(content, where, columns, rate_hz)
    refuse_others(content, where)
    return read_text(content, where, columns, rate_hz)


def recording_of(content: bytes, where: str) -> Recording:
    """A recording from the bytes of our Parquet. where : its path or address, for messages. Raises BadInput as `read_recording`."""
    import pyarrow as pa

    return _of_parquet(pa.BufferReader(content), where).recording


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording as Parquet (zstd), whole or not at all: temporary file, fsync, rename, fsync of the folder.

    Raises StoreError where the disk refuses.
    """
    import pyarrow.parquet as pq  # 40 MB, and many processes touch no recording

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


def recorded_at_unix_s(content: bytes) -> float | None:
    """When a recording says that it was made, from the bytes of its file; None where it does not say, or is none of ours."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        about = (pq.read_schema(pa.BufferReader(content)).metadata or {}).get(METADATA)
        at = None if about is None else json.loads(about)["context"]["recorded_at_unix_s"]
        return None if at is None else float(at)
    except (pa.ArrowException, ValueError, KeyError, TypeError):
        return None


def _table(recording: Recording) -> "pa.Table":
    import pyarrow as pa

    columns = {name: pa.array(np.ascontiguousarray(values)) for name, values in named_columns(recording).items()}
    about = {"context": asdict(recording.context), "quality": dict(recording.quality), "source": recording.source}
    return pa.table(columns).replace_schema_metadata({METADATA: json.dumps(about, default=_plain).encode()})


def _plain(value: Any) -> Any:
    """JSON of numpy's numbers and arrays, which acquisition may have put into `quality`."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be kept in a recording's metadata")


def _of_parquet(source: Any, where: str, columns: str | None = None, rate_hz: float | None = None) -> ProductionRows:
    """A recording from Parquet, with the columns that only production needs."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(source) as file:  # one small file: threads and the search for a dataset take longer than they save
            refuse_unpacked(8 * file.metadata.num_rows * file.metadata.num_columns, source.size(), where)
            table = file.read(use_threads=False)
    except (pa.ArrowException, ValueError) as wrong:
        raise BadInput(f"{where}: is not readable Parquet: {str(wrong).splitlines()[0]}") from None
    return rows_of_table(table, where, columns, rate_hz)


def rows_of_table(table: "pa.Table", where: str, columns: str | None = None, rate_hz: float | None = None) -> ProductionRows:
    """The recording in a table, as `read_production` takes it from Parquet. where : its name, for messages. Raises BadInput."""
    import pyarrow as pa

    name = where.rpartition("/")[2]
    if any(pa.types.is_nested(field.type) for field in table.schema):
        table = _flat(table)
    laid_out = layout_as_written if METADATA in (table.schema.metadata or {}) else layout_of_table
    layout = laid_out(where, table.column_names, columns, rate_hz)
    time = layout.scalars.get("t_s")
    about = _about((table.schema.metadata or {}).get(METADATA), where, name)
    return recorded(layout, lambda k: _numbers(table.column(k).to_numpy(), k == time), table.num_rows, name, about)


def _numbers(values: np.ndarray, is_time: bool) -> Array:
    """The numbers (N,) of a column of Parquet; NaN where it holds text, as in CSV, but for numbers and times that are written as text."""
    if values.dtype.kind in "mM":
        return _seconds(values)
    try:
        return np.asarray(values, dtype=float)
    except (ValueError, TypeError):
        texts = [str(value) for value in values]
        return np.array([number(text) for text in texts] if not is_time else [time_of(text) for text in texts])


def table_of(data: object) -> "pa.Table":
    """A DataFrame, a mapping of arrays, or a table of another library as Arrow has it. Raises BadInput."""
    import pandas as pd
    import pyarrow as pa

    expected = "expected a file, a DataFrame, or a mapping of arrays, with RTDE's names such as timestamp and actual_q_0"
    try:
        if isinstance(data, pd.DataFrame):
            index = data.index
            if "timestamp" not in data and (index.name == "timestamp" or isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex)):
                data = data.rename_axis("timestamp").reset_index()
            return pa.Table.from_pandas(data, preserve_index=False)
        if isinstance(data, Mapping):
            columns: dict[str, Array] = {}
            for name, values in data.items():
                array = np.ma.filled(np.ma.asarray(values, dtype=float), np.nan) if np.ma.isMaskedArray(values) else np.asarray(values)
                columns |= {f"{name}_{j}": column for j, column in enumerate(array.T)} if array.ndim == 2 else {str(name): array}
            return pa.table({name: pa.array(column) for name, column in columns.items()})
        if hasattr(data, "__arrow_c_stream__"):
            return pa.table(data)
    except (pa.ArrowException, TypeError, ValueError) as wrong:
        raise BadInput(f"table: {str(wrong).splitlines()[0]}; {expected}") from None
    raise BadInput(f"{type(data).__name__} given; {expected}")


def _about(metadata: bytes | None, where: str, name: str) -> dict[str, Any] | None:
    """Context, quality and source as our own files hold them; None for another's file."""
    if metadata is None:
        return None
    try:
        document = json.loads(metadata)
        return {"context": _context(document["context"]), "quality": document["quality"], "source": document["source"] or name}
    except (ValueError, KeyError, TypeError) as wrong:
        raise BadInput(f"{where}: its metadata is not a joint-monitor recording's: {wrong!r}") from None


def _seconds(values: np.ndarray) -> Array:
    """Times of any unit, as data frames and databases write them, in seconds; dates in Unix time. NaN where there is none."""
    spans = values - np.datetime64(0, "s") if values.dtype.kind == "M" else values
    seconds: Array = spans / np.timedelta64(1, "s")
    return seconds


def _flat(table: "pa.Table") -> "pa.Table":
    """The table with one column a joint, in place of columns that hold a list in each row, as many loggers write them."""
    import pyarrow as pa
    import pyarrow.compute as pc

    flat: list[tuple[str, Any]] = []  # a name may stand in it twice
    for field, column in zip(table.schema, table.columns, strict=True):
        kind = field.type
        lists = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
        lengths = pc.unique(pc.list_value_length(column)).drop_null().to_pylist() if lists else []
        if len(lengths) == 1:
            flat += [(f"{field.name}_{j}", pc.list_element(column, j)) for j in range(lengths[0])]
        else:
            flat.append((field.name, column))
    names, columns = zip(*flat, strict=True)
    return pa.Table.from_arrays(list(columns), names=list(names)).replace_schema_metadata(table.schema.metadata)


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


# --- Tables of signals by RTDE's names as files: CSV as the manufacturer's own recorder writes it, or Parquet ---

SUFFIXES = (".csv", ".parquet")


def check_table(path: Path) -> None:
    """Check where a table is to be written. Raises BadInput for another suffix, or a folder that does not exist."""
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path}: expected a name that ends in {' or '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise BadInput(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; expected the name of a file")


def write_table(path: Path, columns: Mapping[str, Array], context: Context) -> None:
    """Write columns (N,) to a file: Parquet with the context, or CSV without. Raises as `check_table`, and StoreError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_table(path)
    try:
        if path.suffix.lower() == ".csv":
            with path.open("w", encoding="utf-8") as file:
                file.write(" ".join(columns) + "\n")
                np.savetxt(file, np.column_stack(list(columns.values())), fmt="%.9g")
            return
        about = {"context": asdict(context), "quality": {}, "source": path.name}
        table = pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()})
        pq.write_table(table.replace_schema_metadata({METADATA: json.dumps(about).encode()}), path, compression="zstd")
    except OSError as wrong:
        raise StoreError(f"{path}: cannot be written: {wrong.strerror or wrong}") from wrong
