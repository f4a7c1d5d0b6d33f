"""The columns of a recording: RTDE's names of the signals, and the layout of a file in these names or as `--columns` says."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.production.arm import EXTRA_COLUMNS, ProductionRows
from monitor.recording import JOINT_COLUMNS, Array, Context, Recording

SCALAR_COLUMNS = {
    "timestamp": "t_s",
    "robot_mode": "robot_mode",
    "safety_mode": "safety_mode",
    "runtime_state": "runtime_state",
    "speed_scaling": "speed_scaling",
}
EXTRA_WIDTHS = dict(EXTRA_COLUMNS.values())
_INDEXED = re.compile(r"(.+?)_?\[?(\d+)\]?")


class Layout(NamedTuple):
    """The position of each field in a row of a file."""

    scalars: dict[str, int]  # field of Recording → column
    joints: dict[str, list[int]]  # field of Recording → its J columns
    width: int  # fields a row
    payload: int | None = None  # column of the payload register
    production: Mapping[str, list[int]] = MappingProxyType({})  # field of ProductionRows → its column, or its columns

    @property
    def read(self) -> list[int]:
        """Every column that is read."""
        payload = [] if self.payload is None else [self.payload]
        several = [*self.joints.values(), *self.production.values()]
        return [*self.scalars.values(), *(k for ks in several for k in ks), *payload]


def recorded(layout: Layout, column: Callable[[int], Array], source: str, about: Mapping[str, Any] | None = None) -> ProductionRows:
    """The recording, and the columns that only production needs. column : gives the numbers (N,) of one column of the file.

    about : the fields `context`, `quality` and `source`, where the file says them; else the payload is that of its register.
    """
    signals: dict[str, Any] = {field: column(k) for field, k in layout.scalars.items()}
    signals |= {field: np.stack([column(k) for k in ks], axis=1) for field, ks in layout.joints.items()}
    extra = {
        field: np.stack([column(k) for k in ks], axis=1) if EXTRA_WIDTHS[field] else column(ks[0])
        for field, ks in layout.production.items()
    }
    if about is None:
        payload = None if layout.payload is None else _constant_value(column(layout.payload))
        about = {"context": Context(payload_kg=payload), "source": source}
    return ProductionRows(recording=Recording(**signals, **about), **extra)


def column_names() -> dict[str, str]:
    """RTDE's name of every field of a Recording; where two names mean one field, the first one."""
    names = {field: name for name, field in SCALAR_COLUMNS.items()}
    for name, field in JOINT_COLUMNS.items():
        names.setdefault(field, name)
    return names


def named_columns(recording: Recording) -> dict[str, Array]:
    """(N,) columns by RTDE's names: one a signal, or one a joint with its index, `actual_q_0` … `actual_q_5`."""
    names = column_names()
    columns: dict[str, Array] = {}
    for field, values in recording.signals.items():
        if values.ndim == 1:
            columns[names[field]] = values
        else:
            columns |= {f"{names[field]}_{j}": column for j, column in enumerate(values.T)}
    return columns


def layout_by_name(source: str, names: Sequence[str]) -> Layout:
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
    return Layout(scalars, joints, width, names.index("payload") if "payload" in names else None, _production_columns(names))


def _production_columns(names: Sequence[str]) -> dict[str, list[int]]:
    """The columns that only production needs, of a header: those of a field are all there, or the field is left out."""
    found = {}
    for name, (field, count) in EXTRA_COLUMNS.items():
        wanted = [name] if not count else [f"{name}_{k}" for k in range(count)]
        if all(each in names for each in wanted):
            found[field] = [names.index(each) for each in wanted]
    return found


def parse_columns(spec: str) -> Layout:
    """The layout of a `--columns` text: names in order, `name:N` for one column a joint, `skip` or `skip:N` for columns that are not read.

    Raises BadInput for an unknown name, an invalid count, or where time or positions are missing.
    """
    scalars: dict[str, int] = {}
    joints: dict[str, list[int]] = {}
    production: dict[str, list[int]] = {}
    width = 0
    for name, count in _spec_parts(spec):
        if name in SCALAR_COLUMNS:
            if count != 1 or SCALAR_COLUMNS[name] in scalars:
                raise BadInput(f"--columns: {name} is one column, once; found {name}:{count} or a second one")
            scalars[SCALAR_COLUMNS[name]] = width
        elif name in JOINT_COLUMNS:
            joints.setdefault(JOINT_COLUMNS[name], []).extend(range(width, width + count))
        elif name in EXTRA_COLUMNS:
            field, expected = EXTRA_COLUMNS[name]
            if count != max(expected, 1) or field in production:
                raise BadInput(f"--columns: {name} has {max(expected, 1)} columns, once; found {name}:{count} or a second one")
            production[field] = list(range(width, width + count))
        elif name != "skip":
            raise BadInput(
                f"--columns: {name!r} is not known; known are {', '.join([*SCALAR_COLUMNS, *JOINT_COLUMNS, *EXTRA_COLUMNS, 'skip'])}"
            )
        width += count
    if "t_s" not in scalars or "q" not in joints:
        raise BadInput("--columns: timestamp and actual_q:N are needed, e.g. timestamp,actual_q:6,actual_qd:6,actual_current:6")
    for field, places in joints.items():
        if len(places) != len(joints["q"]):
            raise BadInput(
                f"--columns: {column_names()[field]} has {len(places)} columns, actual_q has {len(joints['q'])}; expected as many"
            )
    return Layout(scalars, joints, width, production["payload_kg"][0] if "payload_kg" in production else None, production)


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


def _constant_value(values: Array) -> float | None:
    """The one value of a register that did not change; None where it did."""
    known = np.unique(values[np.isfinite(values)])
    return float(known[0]) if len(known) == 1 else None
