"""Tables of signals by RTDE's names as files: CSV as the manufacturer's own recorder writes it, or Parquet."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from monitor.errors import BadInput, StoreError
from monitor.recording import Array, Context
from monitor.store.formats.recordings import METADATA

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
    """Write columns (N,) to a file: Parquet with the context, or CSV without. Raises as `check_table`, and StoreError where it cannot."""
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
