"""Recordings as text: CSV with any separator, with RTDE's names in a header or with columns that the caller names."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Context, Recording
from monitor.store.columns import Layout, constant_value, layout_by_name, parse_columns

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)


def read_text(path: Path, columns: str | None) -> Recording:
    """A recording from text. `columns` names what stands in a file without RTDE's names. Raises BadInput where the file is none."""
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
        separator = of_body  # some files have commas in the header and another separator below it
    usual, _ = Counter(len(_split(line, separator)) for line in body[:1000]).most_common(1)[0]
    if columns is not None:
        layout = parse_columns(columns)
    elif headed:
        layout = layout_by_name(str(path), first)
    else:
        raise BadInput(
            f"{path}: has no header; say what its {usual} columns are, e.g. --columns timestamp,actual_q:6,actual_qd:6,actual_current:6"
        )
    if usual != layout.width and not (usual > layout.width and _only_padding(body, separator, layout.width)):
        expected = f"--columns {columns} names {layout.width}" if columns is not None else f"its header names {layout.width}"
        raise BadInput(f"{path}: rows have {usual} columns, {expected}")
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
    """Whether all fields beyond the expected columns are empty: a spreadsheet leaves separators at the end of a line."""
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
            continue  # torn: the fields' positions are unknown, and the last field may be cut
        for k in wanted:
            row[k] = _number(parts[k], decimal_comma)
    signals: dict[str, Any] = {field: rows[:, k] for field, k in layout.scalars.items()}
    signals |= {field: rows[:, ks] for field, ks in layout.joints.items()}
    payload = None if layout.payload is None else constant_value(rows[:, layout.payload])
    return Recording(**signals, context=Context(payload_kg=payload), source=path.name)


def _number(text: str, decimal_comma: bool) -> float:
    """A field as a number; NaN where it is none, so that the row counts as torn."""
    try:
        return float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return float("nan")
