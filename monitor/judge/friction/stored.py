"""A state as one text and back, exactly: its arrays as they lie in memory, compressed, for a history that keeps the newest ones.

A hundred thousand numbers make a document of megabytes, and take longer to write than to reckon. Most of them are zeros.
"""

import base64
import json
import zlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import TEXTS
from monitor.judge.friction.changes import Bank
from monitor.judge.friction.decision import Crossing
from monitor.judge.friction.found import Found
from monitor.judge.friction.step import FrictionState

PARTS = {"bank": Bank, "found": Found}
NUMBERS = {"joints_per_arm": int, "number": int, "of_production": bool}


def text_of(state: FrictionState) -> str:
    """The state as text: a line that names its arrays, and their bytes; `state_of` is the exact inverse."""
    arrays = _arrays(state, "")
    columns = {name: np.isfortran(value) for name, value in arrays.items()}  # whose order in memory is that of columns: sums follow it
    head = [[name, value.dtype.str, value.shape, columns[name]] for name, value in arrays.items()]
    body = b"".join(value.tobytes("F" if columns[name] else "C") for name, value in arrays.items())
    return base64.b64encode(zlib.compress(json.dumps(head).encode() + b"\n" + body)).decode("ascii")


def state_of(text: Any, where: str) -> FrictionState:
    """The state of a text. Raises BadInput where it is none, or lacks a part."""
    try:
        head, _, body = zlib.decompress(base64.b64decode(text, validate=True)).partition(b"\n")
        arrays: dict[str, Any] = {}
        at = 0
        for name, dtype, shape, columns in json.loads(head):
            flat = np.frombuffer(body, np.dtype(dtype), int(np.prod(shape)), at)
            arrays[name] = flat.reshape(shape, order="F" if columns else "C").copy("K")
            at += flat.nbytes
    except (TypeError, ValueError, zlib.error) as wrong:
        raise BadInput(f"{where}: is no state of the judge: {wrong}") from None
    try:
        parts = {name: kind(**{f.name: arrays[f"{name}.{f.name}"] for f in fields(kind)}) for name, kind in PARTS.items()}
        told = Crossing(*(arrays[f"told.{name}"] for name in Crossing._fields))
        numbers = {name: kind(arrays[name]) for name, kind in NUMBERS.items()}
        rest = {f.name: arrays[f.name] for f in fields(FrictionState) if f.name not in (*PARTS, *NUMBERS, "told")}
    except KeyError as missing:
        raise BadInput(f"{where}: the part {missing} is missing") from None
    return FrictionState(**rest, **numbers, **parts, told=told)


def _arrays(value: Any, before: str) -> dict[str, Any]:
    """The arrays of a value by their names, parts before a dot."""
    names = value._fields if isinstance(value, Crossing) else [f.name for f in fields(value)]
    found: dict[str, Any] = {}
    for name in names:
        part = getattr(value, name)
        nested = is_dataclass(part) or isinstance(part, Crossing)
        found |= _arrays(part, f"{before}{name}.") if nested else {before + name: np.asarray(part)}
    return found


TEXTS[FrictionState] = (text_of, state_of)
