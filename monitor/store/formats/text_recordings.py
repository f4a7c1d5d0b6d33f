"""Recordings as text: CSV with any separator, with RTDE's names in a header or with columns that the caller names."""

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from monitor.errors import BadInput
from monitor.identify.production.arm import ProductionRows
from monitor.store.formats.columns import Layout, layout_of, recorded

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)  # Excel reads its separator from such a first line
_NO_DECIMAL = re.compile(r"(?<!\d),|,(?!\d)")  # a comma that stands in no number
_QUOTED = re.compile(r'"[^"]*"')
_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d*)?)")  # of a day, or since the beginning
_UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE


def read_text(content: bytes, where: str, columns: str | None, rate_hz: float | None = None) -> ProductionRows:
    """A recording from text, with the columns that only production needs.

    where : its path, for messages. columns, rate_hz : as `layout_of` takes them. Raises BadInput where the file is none.
    """
    # Excel's "Unicode text" is UTF-16
    text = content.decode("utf-16" if content.startswith(_UTF_16) else "utf-8-sig", errors="replace")
    if "\0" in text[:4096]:
        raise BadInput(
            f"{where}: is binary, and not Parquet; expected a recording as Parquet or CSV: export it as CSV, or as Parquet, with one "
            f"column a joint and signal"
        )
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if lines and _SEPARATOR.fullmatch(lines[0].strip()):
        del lines[0]
    if not lines:
        raise BadInput(f"{where}: is empty")
    if lines[0].lstrip().startswith("'"):
        lines = [line.replace("'", '"') for line in lines]
    if _QUOTED.fullmatch(lines[0].strip()) and _separator(lines[0].strip().strip('"')):  # quotes around each line
        lines = [line.strip().strip('"') for line in lines]
    separator = _separator(lines[0])
    first = _split(lines[0], separator)
    headed = any(field and not _NUMBER.fullmatch(field) for field in first)
    body = lines[1:] if headed else lines
    if not body:
        raise BadInput(f"{where}: holds a header and no rows")
    if headed and separator != (of_body := _separator(body[0])) and len(_split(body[0], of_body)) == len(first):
        separator = of_body  # some files have commas in the header and another separator below it
    usual, _ = Counter(len(_split(line, separator)) for line in body[:1000]).most_common(1)[0]
    layout = layout_of(where, first if headed else None, usual, columns, rate_hz)
    if usual != layout.width and not (usual > layout.width and _only_padding(body, separator, layout.width)):
        counted = columns is not None and "=" not in columns
        expected = f"--columns {columns} names {layout.width}" if counted else f"its header names {layout.width}"
        raise BadInput(f"{where}: rows have {usual} columns, {expected}")
    return _recording(where, layout, body, separator)


def _separator(line: str) -> str | None:
    """`;`, tab, `|`, `,`, or None for any white space; what stands in quotes does not count."""
    line = _QUOTED.sub('""', line)
    for candidate in ";\t|":
        if candidate in line:
            return candidate
    tokens = line.split()
    if "," in line and (len(tokens) == 1 or _NO_DECIMAL.search(line) or any(token.count(",") > 1 for token in tokens)):
        return ","
    return None  # also 1,5 2,5: commas within the fields are decimal commas


def _split(line: str, separator: str | None) -> list[str]:
    """The fields of one line, none of a torn one that is no CSV. A quote that is torn open ends with its line, not with the file."""
    try:
        (fields,) = csv.reader((line if separator else " ".join(line.split()),), delimiter=separator or " ", skipinitialspace=True)
    except csv.Error:
        return []
    return [field.strip() for field in fields]


def _only_padding(lines: Sequence[str], separator: str | None, width: int) -> bool:
    """Whether all fields beyond the expected columns are empty: a spreadsheet leaves separators at the end of a line."""
    return all(not any(_split(line, separator)[width:]) for line in lines[:100])


def _recording(where: str, layout: Layout, lines: Sequence[str], separator: str | None) -> ProductionRows:
    wanted, time = layout.read, layout.scalars.get("t_s")
    rows = np.full((len(lines), len(wanted)), np.nan)
    place = {k: at for at, k in enumerate(wanted)}
    for row, line in zip(rows, lines, strict=True):
        parts = _split(line, separator)
        if len(parts) < layout.width or any(parts[layout.width :]):
            continue  # torn: the fields' positions are unknown, and the last field may be cut
        for k, at in place.items():
            row[at] = number(parts[k]) if k != time else time_of(parts[k])

    if time is not None and not np.any(np.isfinite(rows[:, place[time]])):
        written = [parts[time] for parts in (_split(line, separator) for line in lines[:100]) if len(parts) >= layout.width]
        if written and written[0] and not _NUMBER.fullmatch(written[0]):
            raise BadInput(f"{where}: the times are no numbers, such as {written[0]!r}; expected seconds, or date and time")
    return recorded(layout, lambda k: rows[:, place[k]], len(rows), Path(where).name)


def number(text: str) -> float:
    """A field as a number, with a decimal point or comma; NaN where it is none, so that the row counts as torn."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


def time_of(text: str) -> float:
    """A field as a time [s]: a number, a date and time as databases and spreadsheets write it, `2026-11-23T06:04:15.250Z`, or 08:53:23.5.

    Without a zone it counts as UTC: only differences matter. NaN where it is none.
    """
    seconds = number(text)
    if math.isnan(seconds):
        try:
            at = datetime.fromisoformat(text)
        except ValueError:
            clock = _CLOCK.fullmatch(text)
            return float("nan") if clock is None else 3600.0 * float(clock[1] or 0) + 60.0 * float(clock[2]) + number(clock[3])
        return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()
    return seconds
