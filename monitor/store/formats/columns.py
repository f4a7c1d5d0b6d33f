"""The columns of a recording: RTDE's names of the signals, and the layout of a file in these names or as `--columns` says."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import SequenceMatcher
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.production.arm import EXTRA_COLUMNS, ProductionRows
from monitor.reason import Reason, Sentence
from monitor.recording import JOINT_COLUMNS, Array, Context, Recording

SCALAR_COLUMNS = {
    "timestamp": "t_s",
    "robot_mode": "robot_mode",
    "safety_mode": "safety_mode",
    "runtime_state": "runtime_state",
    "speed_scaling": "speed_scaling",
}
EXTRA_WIDTHS = dict(EXTRA_COLUMNS.values())
KNOWN = (*SCALAR_COLUMNS, *JOINT_COLUMNS, *EXTRA_COLUMNS)
# RTDE's names of columns for each joint or axis that no identification reads: they are no signal under another name
OTHERS = (
    "actual_TCP_pose", "actual_TCP_speed", "target_TCP_pose", "target_TCP_speed", "actual_joint_voltage", "actual_current_window",
    "joint_control_output", "joint_mode", "joint_position_deviation_ratio", "ft_raw_wrench", "payload_inertia",
)  # fmt: skip
NEAR = 0.8  # likeness of two names, of which one may be the other misspelt
_INDEXED = re.compile(r"(.+?)_?\[?(\d+)\]?")
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")
_BRACES = re.compile(r"\{([^{}]*)\}")
_RANGE = re.compile(r"(\d+)\.\.(\d+)")
EXAMPLE = "timestamp,actual_q:6,actual_qd:6,actual_current:6, or by names timestamp=time,actual_q=position_{1..6}"

SPEEDS = "actual_qd"
NAMES_NOT_READ = Sentence(
    "names_not_read",
    "{source}: {wanted} is not there, and columns of other names are not read: {names}. Where one is meant, say so, such as "
    "--columns {wanted}={example}",
)
NAMES_TAKEN = Sentence(
    "names_taken",
    "{source}: {wanted} is not there, and {names} are taken for it, which positions and clock must agree with; where they are something "
    "else, say --columns {wanted}=",
)
DISORDER = 0.1  # of the steps go back in time: the rows are in no order, or in the opposite one
ADJACENT = 3.0  # ticks between blocks of rows
FEWEST_STEPS = 20  # with fewer, a torn time is a large share
ROWS_SORTED = Sentence(
    "rows_sorted", "{source}: {share:.0%} of the rows are older than the row before them (newest first, or no order); sorted by time"
)
AS_WRITTEN = Sentence(
    "columns_as_written", "{source}: was written by this program and is read as it was written: --columns and --rate do not fit it"
)


class Layout(NamedTuple):
    """The position of each field in a row of a file."""

    scalars: dict[str, int]  # field of Recording → column
    joints: dict[str, list[int]]  # field of Recording → its J columns
    width: int  # fields a row
    production: Mapping[str, list[int]] = MappingProxyType({})  # field of ProductionRows → its column, or its columns
    rate_hz: float | None = None  # of rows without a time
    told: tuple[Reason, ...] = ()  # of the names

    @property
    def read(self) -> list[int]:
        """Every column that is read, once."""
        several = [*self.joints.values(), *self.production.values()]
        return list(dict.fromkeys([*self.scalars.values(), *(k for ks in several for k in ks)]))


def recorded(
    layout: Layout, column: Callable[[int], Array], rows: int, source: str, about: Mapping[str, Any] | None = None
) -> ProductionRows:
    """The recording, and the columns that only production needs. column : gives the numbers (N,) of one column of the file.

    about : the fields `context`, `quality` and `source`, where the file says them; else the payload is that of its register.
    """
    signals: dict[str, Any] = {field: column(k) for field, k in layout.scalars.items()}
    if layout.rate_hz is not None:
        signals["t_s"] = np.arange(rows) / layout.rate_hz
    signals |= {field: np.stack([column(k) for k in ks], axis=1) for field, ks in layout.joints.items()}
    extra = {
        field: np.stack([column(k) for k in ks], axis=1) if EXTRA_WIDTHS[field] else column(ks[0])
        for field, ks in layout.production.items()
    }
    missing = np.flatnonzero(~np.any(np.isfinite(signals["q"]), axis=0))
    if rows and (len(missing) or not np.any(np.isfinite(signals["t_s"]))):
        what = f"actual_q of joint {missing[0] + 1}" if len(missing) else "timestamp"
        raise BadInput(f"{source}: {what} holds no number in any row; expected every joint's position, and the time")
    foreign = about is None
    if about is None:
        payload = _constant_value(extra["payload_kg"]) if "payload_kg" in extra else None
        about = {"context": Context(payload_kg=payload), "source": source}
    found = ProductionRows(recording=Recording(**signals, **about, told=layout.told), **extra)
    return _in_order(found) if foreign else found


def _in_order(rows: ProductionRows) -> ProductionRows:
    """The rows in the order of their times, where the file has another one. Single torn times do not count, nor a clock that was set."""
    recording = rows.recording
    step = np.diff(recording.t_s[np.isfinite(recording.t_s)])
    back, ahead = np.count_nonzero(step < 0.0), np.count_nonzero(step > 0.0)
    if back + ahead < FEWEST_STEPS or not (back > DISORDER * (back + ahead) or _in_blocks(recording.t_s)):
        return rows
    # newest first: rows that have one time stand in the reverse order too
    order = np.arange(recording.samples)[::-1] if back > ahead else np.arange(recording.samples)
    place = np.argsort(recording.t_s[order], kind="stable")
    if back <= ahead and np.median(np.abs(place - np.arange(len(place)))) < FEWEST_STEPS:
        return rows  # in order, on a clock that shakes by more than its ticks: the times are wrong, not the rows
    order = order[place]
    sorted_rows = rows.part(order)
    told = (*recording.told, ROWS_SORTED(source=recording.source or "recording", share=back / (back + ahead)))
    return replace(sorted_rows, recording=replace(sorted_rows.recording, context=recording.context, told=told))


def _in_blocks(t_s: Array) -> bool:
    """Whether rows stand in blocks that continue each other in another order, as where a log is exported page by page, newest first.

    Times of a clock that was set do not continue each other.
    """
    place = np.argsort(t_s, kind="stable")
    joins, step = np.flatnonzero(np.diff(place) != 1), np.diff(t_s[place])
    moved = np.median(np.abs(place - np.arange(len(place)))) >= FEWEST_STEPS
    return bool(moved and len(joins) and np.nanmedian(step[joins]) < ADJACENT * np.nanmedian(step))


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


def layout_of(source: str, names: Sequence[str] | None, width: int, columns: str | None, rate_hz: float | None) -> Layout:
    """The layout of a file whose rows have `width` fields, under these names; None: it has no header.

    columns : as `--columns`. Either NAME or NAME:COUNT for every column in order, with `skip` for columns that are not read; or NAME=COLUMN
    by the file's names, with {1..6} or {a,b} for the joints, beside what stands under RTDE's names; NAME= is not read.
    rate_hz : of the rows of a file without a time. Raises BadInput where a name is unknown, missing, or means two columns.
    """
    if rate_hz is not None and not 0.0 < rate_hz < np.inf:
        raise BadInput(f"--rate {rate_hz:g}: expected the rows a second, e.g. 125")
    names = None if names is None else [name.strip() for name in names]
    counted = columns is not None and "=" not in columns
    if columns is not None and counted:
        layout = _counted(columns, names)
    elif names is None:
        raise BadInput(f"{source}: has no header; say what its {width} columns are, e.g. --columns {EXAMPLE}")
    else:
        layout = _named(source, names, columns or "")
    if rate_hz is not None and "t_s" in layout.scalars:
        raise BadInput(f"{source}: tells times, and --rate is for rows without one; to leave them out, say --columns timestamp=")
    if rate_hz is None and "t_s" not in layout.scalars:
        if counted:
            raise BadInput(f"--columns: timestamp and actual_q:N are needed, or --rate in the place of timestamp; e.g. {EXAMPLE}")
        shown = ", ".join(name for name in names or () if name)[:160]
        raise BadInput(
            f"{source}: holds no column timestamp; it names {shown}. Where the time has another name, say so, such as "
            f"--columns timestamp=time; where there is none, say the rows a second, such as --rate 125"
        )
    return layout._replace(rate_hz=rate_hz)


def layout_of_table(source: str, names: Sequence[str], columns: str | None, rate_hz: float | None) -> Layout:
    """`layout_of` a file whose columns all have names. Raises BadInput also where `columns` counts others."""
    layout = layout_of(source, names, len(names), columns, rate_hz)
    if columns is not None and "=" not in columns and layout.width != len(names):
        shown = ", ".join(names)[:200]
        raise BadInput(f"{source}: has {len(names)} columns, --columns {columns} names {layout.width}; they are {shown}")
    return layout


def layout_as_written(source: str, names: Sequence[str], columns: str | None, rate_hz: float | None) -> Layout:
    """The layout of a file of this program: as `columns` and `rate_hz` say where they fit, else as it was written, which is told.

    They may be for another file of the same command. Raises BadInput where `columns` can be of no file.
    """
    try:
        return layout_of_table(source, names, columns, rate_hz)
    except BadInput:
        if columns is None and rate_hz is None:
            raise
        if columns is not None and "=" not in columns:
            _counted(columns, None)
    layout = layout_of_table(source, names, None, None)
    return layout._replace(told=(*layout.told, AS_WRITTEN(source=source.rpartition("/")[2])))


def _named(source: str, names: Sequence[str], columns: str) -> Layout:
    """The layout by names: RTDE's, but for what `columns` says."""
    given = dict(_renamed(source, names, columns))
    of_name: dict[str, dict[int, int]] = {}  # RTDE's name → index of the joint → column
    for k, name in enumerate(names):
        match = _INDEXED.fullmatch(name)
        known, index = (name, 0) if name in SCALAR_COLUMNS else (match[1], int(match[2])) if match else ("", 0)
        if known in given or (known not in SCALAR_COLUMNS and known not in JOINT_COLUMNS):
            continue
        if index in (places := of_name.setdefault(known, {})):
            raise BadInput(
                f"{source}: names {name} twice, in the columns {places[index] + 1} and {k + 1}; expected each name once: say what every "
                f"column is, in order, by --columns with skip for the one that does not count"
            )
        places[index] = k
    of_name |= {name: dict(enumerate(ks)) for name, ks in given.items() if ks and name not in EXTRA_COLUMNS}
    fields: dict[str, str] = {}
    for name in of_name:
        field = SCALAR_COLUMNS.get(name) or JOINT_COLUMNS[name]
        if (other := fields.setdefault(field, name)) != name:
            raise BadInput(f"{source}: names {other} and {name}, which are one signal; leave one out by --columns {name}=")
    unread = set(range(len(names))) - {k for places in of_name.values() for k in places.values()}
    groups = _groups([names[k] for k in sorted(unread)])
    if "q" not in fields:
        raise BadInput(f"{source}: holds no joint positions (actual_q_0, actual_q_1, …), {_instead(names, groups)}")
    count = len(of_name[fields["q"]])
    joints: dict[str, list[int]] = {}
    for field, name in fields.items():
        if name not in SCALAR_COLUMNS:
            places = of_name[name]
            if sorted(places) != list(range(count)):
                numbers = ", ".join(str(j) for j in sorted(places))
                raise BadInput(
                    f"{source}: {name} has the indices {numbers}; expected 0 … {count - 1} as many as there are positions; "
                    f"others are said by --columns, such as {name}={name}_{{1..{count}}}"
                )
            joints[field] = [places[j] for j in range(count)]
    told = list(_not_read(source.rpartition("/")[2], set(fields), groups, count))
    speeds = [
        (pattern, own)
        for pattern, numbers in groups.items()
        if len(own := sorted(set(numbers))) == count == len(numbers) and _letters(pattern) == _letters(SPEEDS)
    ]
    speeds = [(pattern, own) for pattern, own in speeds if set(_names(pattern, own)) <= set(names)]  # none is written 01
    if "qd" not in fields and SPEEDS not in given and len(speeds) == 1:
        ((pattern, indices),) = speeds
        joints["qd"] = [names.index(name) for name in _names(pattern, indices)]
        told = [reason for reason in told if reason.parameters["wanted"] != SPEEDS]
        told.append(NAMES_TAKEN(source=source.rpartition("/")[2], wanted=SPEEDS, names=_braced(pattern, indices)))
    width = len(names)
    while width and not names[width - 1]:
        width -= 1  # separators that a spreadsheet left at the end of the line
    scalars = {SCALAR_COLUMNS[name]: places[0] for name, places in of_name.items() if name in SCALAR_COLUMNS}
    production = _production_columns(source, names, given)
    return Layout(scalars, joints, width, production, None, tuple(told))


def _renamed(source: str, names: Sequence[str], columns: str) -> Iterator[tuple[str, list[int]]]:
    """RTDE's name and the columns that it stands for, of each part NAME=COLUMN."""
    for part in re.split(r",(?![^{}]*\})", columns) if columns else ():
        name, equals, column = (text.strip() for text in part.partition("="))
        if not equals:
            raise BadInput(f"--columns: {name!r} stands beside parts with =; expected NAME=COLUMN in every part, or in none")
        if name not in KNOWN:
            raise BadInput(f"--columns: {name!r} is not known; known are {', '.join(KNOWN)}")
        wanted = _expanded(column) if column else []
        for each in wanted:
            found = [k for k, own in enumerate(names) if own == each]
            if len(found) != 1:
                close = sorted((own for own in names if own), key=lambda own: -SequenceMatcher(None, own, each).ratio())[:3]
                how = "is there twice" if found else f"is not there; most like it are {', '.join(close)}"
                raise BadInput(f"{source}: --columns {part.strip()}: the column {each!r} {how}")
        _no_target(name, wanted)
        yield name, [names.index(each) for each in wanted]


def _expanded(text: str) -> list[str]:
    """The names that a text with braces stands for, as a shell expands it: q_{1..3} is q_1, q_2, q_3, and {a,b}_q is a_q, b_q."""
    parts = _BRACES.split(text)
    choices = []
    for within, part in enumerate(parts):
        counted = _RANGE.fullmatch(part) if within % 2 else None
        if counted:
            first, last = int(counted[1]), int(counted[2])
            if abs(last - first) > 1000:
                raise BadInput(f"--columns: {{{part}}} are too many; expected the joints, such as {{1..6}}")
            step = 1 if last >= first else -1
            choices.append([str(number).zfill(len(counted[1])) for number in range(first, last + step, step)])
        else:
            choices.append([each.strip() for each in part.split(",")] if within % 2 else [part])
    return ["".join(each) for each in product(*choices)]


def _no_target(name: str, columns: Sequence[str]) -> None:
    """Raises BadInput where a target's column is said to be what the arm did."""
    targets = [column for column in columns if column.startswith("target_")]
    if targets and name.startswith("actual_"):
        raise BadInput(f"--columns: {targets[0]} is what the controller wanted, and {name} what the arm did: friction shows only there")


def _groups(names: Sequence[str]) -> dict[str, list[int]]:
    """Names that differ in one number alone, as NAME_{} → the numbers, but for what RTDE names and nothing reads."""
    found: dict[str, list[int]] = {}
    for name in names:
        match = _NUMBERED.fullmatch(name)
        if match and match[1].rstrip("_[") not in (*OTHERS, *EXTRA_COLUMNS):
            found.setdefault(f"{match[1]}{{}}{match[3]}", []).append(int(match[2]))
    return found


def _braced(pattern: str, numbers: Sequence[int]) -> str:
    """The names of a group as `--columns` takes them, actual_dq_{0..5}."""
    return pattern.format(f"{{{min(numbers)}..{max(numbers)}}}")


def _instead(names: Sequence[str], groups: Mapping[str, Sequence[int]]) -> str:
    """Why a file without positions is refused, and what would help."""
    targets = [name for name in names if name.startswith("target_")]
    if targets and all(pattern.startswith("target_") for pattern, numbers in groups.items() if len(numbers) > 1):
        return f"only targets such as {targets[0]}: these are what the controller wanted, and friction shows only in what the arm did"
    pattern_of: dict[str, str] = {}
    for pattern, numbers in groups.items():
        if len(numbers) > 1:
            pattern_of |= dict.fromkeys(_names(pattern, numbers), _braced(pattern, numbers))
    shown = ", ".join(dict.fromkeys(pattern_of.get(name, name) for name in names if name))[:300]
    return f"so nothing can be identified from it; it names {shown}. Where they stand under other names, say so with --columns {EXAMPLE}"


def _names(pattern: str, numbers: Sequence[int]) -> list[str]:
    return [pattern.format(number) for number in numbers]


def _not_read(source: str, fields: set[str], groups: Mapping[str, list[int]], count: int) -> Iterator[Reason]:
    """What may be a signal that is not there: for the speeds any group of the joints' size, else groups of a name that is like it."""
    of_joints = {
        pattern: numbers for pattern, numbers in groups.items() if sorted(set(numbers)) == list(range(min(numbers), min(numbers) + count))
    }
    drive = {"current", "torque"} & fields
    for wanted, field in JOINT_COLUMNS.items():
        if field in fields or field not in {"qd", "current", "torque", "temperature_c"}:
            continue
        any_name = field == "qd" or (not drive and field == "current")
        like = [_braced(*group) for group in of_joints.items() if any_name or _alike(group[0], wanted)]
        if like:
            likest = max(like, key=lambda name: SequenceMatcher(None, name, wanted).ratio())
            yield NAMES_NOT_READ(source=source, wanted=wanted, names=like, example=likest)


def _letters(pattern: str) -> list[str]:
    """The letters of a name in the order of the alphabet: actual_dq, Actual.QD and qd_actual have those of actual_qd."""
    return sorted(letter for letter in pattern.format("").lower() if letter.isalpha())


def _alike(pattern: str, wanted: str) -> bool:
    name = pattern.format("").strip("_[] ").lower()
    return SequenceMatcher(None, name, wanted).ratio() > NEAR


def _production_columns(source: str, names: Sequence[str], given: Mapping[str, list[int]]) -> dict[str, list[int]]:
    """The columns that only production needs: those of a field are all there, or the field is left out."""
    found = {}
    for name, (field, count) in EXTRA_COLUMNS.items():
        wanted = [name] if not count else [f"{name}_{k}" for k in range(count)]
        if name in given:
            if given[name] and len(given[name]) != max(count, 1):
                raise BadInput(f"--columns: {name} has {max(count, 1)} columns; found {len(given[name])}")
            found[field] = given[name]
        elif all(each in names for each in wanted):
            if twice := [each for each in wanted if list(names).count(each) > 1]:
                raise BadInput(f"{source}: names {twice[0]} twice; expected each name once")
            found[field] = [names.index(each) for each in wanted]
    return {field: places for field, places in found.items() if places}


def _counted(spec: str, names: Sequence[str] | None) -> Layout:
    """The layout of a `--columns` text that counts every column in order."""
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
            raise BadInput(f"--columns: {name!r} is not known; known are {', '.join([*KNOWN, 'skip'])}")
        _no_target(name, (names or ())[width : width + count])
        width += count
    if "q" not in joints:
        raise BadInput(f"--columns: timestamp and actual_q:N are needed, e.g. {EXAMPLE}")
    for field, places in joints.items():
        if len(places) != len(joints["q"]):
            raise BadInput(
                f"--columns: {column_names()[field]} has {len(places)} columns, actual_q has {len(joints['q'])}; expected as many"
            )
    return Layout(scalars, joints, width, production)


def _spec_parts(spec: str) -> Iterator[tuple[str, int]]:
    """Name and number of columns of each part; `actual_q_0,actual_q_1` counts as two of actual_q. Raises BadInput."""
    following: dict[str, int] = {}
    for part in spec.split(","):
        name, colon, number = (text.strip() for text in part.partition(":"))
        if colon and not (number.isascii() and number.isdigit() and 1 <= int(number) <= 1000):
            raise BadInput(f"--columns: {part.strip()!r}; expected NAME or NAME:COUNT, e.g. actual_q:6")
        indexed = _INDEXED.fullmatch(name)
        count = int(number) if colon else 1
        if not colon and indexed and indexed[1] in JOINT_COLUMNS:
            name, expected = indexed[1], following.get(indexed[1], 0)
            if int(indexed[2]) != expected:
                raise BadInput(
                    f"--columns: {part.strip()!r} stands where {name}_{expected} was expected; other orders are said by names, NAME=COLUMN"
                )
        following[name] = following.get(name, 0) + count
        yield name, count


def _constant_value(values: Array) -> float | None:
    """The one value of a register that did not change; None where it did."""
    known = np.unique(values[np.isfinite(values)])
    return float(known[0]) if len(known) == 1 else None
