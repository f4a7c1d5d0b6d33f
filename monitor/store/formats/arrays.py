"""Recordings as arrays of numpy (.npy, .npz) and of MATLAB up to version 7 (.mat)."""

import io
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.identify.production.arm import ProductionRows
from monitor.recording import Array
from monitor.store.formats.columns import layout_of_table, recorded
from monitor.store.formats.others import refuse_unpacked

NPY, MAT = b"\x93NUMPY", b"MATLAB 5.0"


def is_arrays(content: bytes) -> bool:
    """Whether the content is of numpy or MATLAB."""
    return content.startswith((NPY, MAT)) or (content.startswith(b"PK") and b".npy" in content[:400])


def read_arrays(content: bytes, where: str, columns: str | None, rate_hz: float | None) -> ProductionRows:
    """A recording from arrays, with the columns that only production needs.

    An array (N,) or (N, 1) is a column of its name; of an array (N, J) or (J, N), each joint is one: q_0, q_1, … N is the length that most
    arrays have. Fields of a structure are arrays named structure.field. columns, rate_hz : as `layout_of` takes them. Raises BadInput.
    """
    try:
        arrays = dict(_matlab(content, where) if content.startswith(MAT) else _numpy(content, where))
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, NotImplementedError, KeyError, TypeError) as wrong:
        raise BadInput(f"{where}: is not readable: {wrong}") from None
    table = _columns(arrays)
    if not table:
        shown = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())[:200]
        raise BadInput(f"{where}: holds no arrays of numbers with a row a sample; found {shown or 'nothing'}")
    names, values = list(table), list(table.values())
    layout = layout_of_table(where, names, columns, rate_hz)
    return recorded(layout, lambda k: values[k], len(values[0]), where.rpartition("/")[2])


def _numpy(content: bytes, where: str) -> Iterator[tuple[str, np.ndarray]]:
    if content.startswith(NPY):
        array = np.load(io.BytesIO(content), allow_pickle=False)
        named = array.dtype.names
        yield from [("column", array)] if named is None else ((name, array[name]) for name in named)
        return
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        refuse_unpacked(sum(member.file_size for member in file.infolist()), len(content), where)
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                yield name, arrays[name]
            except ValueError:  # pickled objects: parameters, names; never signals
                continue


def _matlab(content: bytes, where: str) -> Iterator[tuple[str, np.ndarray]]:
    from scipy.io import loadmat, whosmat

    file: Any = io.BytesIO(content)  # which its types do not name
    refuse_unpacked(sum(8 * int(np.prod(shape)) for _, shape, _ in whosmat(file)), len(content), where)
    file.seek(0)

    def flat(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
        if isinstance(value, Mapping):
            for key, inner in value.items():
                yield from flat(f"{name}.{key}", inner)
        elif isinstance(value, np.ndarray):
            yield name, value

    for name, value in loadmat(file, simplify_cells=True).items():
        yield from flat(name, value)


def _columns(arrays: Mapping[str, np.ndarray]) -> dict[str, Array]:
    """The columns (N,) of the arrays that hold numbers."""
    numbers = {name: np.squeeze(array) for name, array in arrays.items() if array.dtype.kind in "fiub"}
    lengths = [max(array.shape) for array in numbers.values() if 1 <= array.ndim <= 2 and array.size > 1]
    if not lengths:
        return {}
    rows = max(lengths, key=lengths.count)
    found: dict[str, Array] = {}
    for name, array in numbers.items():
        if array.shape == (rows,):
            found[name] = array.astype(float)
        elif array.ndim == 2 and rows in array.shape:
            joints = array if array.shape[0] == rows else array.T
            found |= {f"{name}_{j}": column.astype(float) for j, column in enumerate(joints.T)}
    return found
