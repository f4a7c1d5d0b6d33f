"""Values of this room as plain JSON and back, exactly: the shortest repr of a float is that float, and NaN becomes null."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import Field, fields, is_dataclass
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array


def plain(value: Any) -> Any:
    """A value as plain JSON: lists for arrays and tuples, objects for dataclasses and named tuples, null for NaN."""
    if isinstance(value, np.ndarray | np.generic):
        listed = value.tolist()
        # nearly every array is of numbers without NaN: a belief has thousands of them, and is written several times a replay
        whole = value.dtype.kind in "biu" or (value.dtype.kind == "f" and not np.isnan(value).any())
        return listed if whole else plain(listed)
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if is_dataclass(value) and not isinstance(value, type):
        return {key_of(f): plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {key: plain(part) for key, part in value._asdict().items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    return value


def key_of(field: "Field[Any]") -> str:
    """The key of a dataclass field in documents: `metadata["key"]` where documents keep an older name, else the field's own name."""
    key: str = field.metadata.get("key", field.name)
    return key


def entry(document: Any, key: str, *, where: str) -> Any:
    """The value under a key.

    Raises BadInput where the document is no object or lacks the key.
    """
    if not isinstance(document, Mapping) or key not in document:
        raise BadInput(f"{where}: the key {key!r} is missing")
    return document[key]


def array(document: Any, key: str, shape: tuple[int, ...], *, where: str) -> Array:
    """The numbers under a key, null as NaN; −1 in `shape` is any length.

    Raises BadInput naming the key, its shape and the shape expected.
    """
    try:
        value = np.array(entry(document, key, where=where), dtype=float)
    except (TypeError, ValueError):
        raise BadInput(f"{where}: {key} is not an array of numbers") from None
    if value.ndim != len(shape) or any(want not in (-1, have) for want, have in zip(shape, value.shape, strict=True)):
        raise BadInput(f"{where}: {key} has shape {value.shape}; expected {shape}")
    return value


def arrays(document: Any, names: Iterable[str], shape: tuple[int, ...], *, where: str) -> dict[str, Array]:
    """`array` of each name, all of one shape, e.g. the fields of a named tuple. Raises BadInput likewise."""
    return {name: array(document, name, shape, where=where) for name in names}
