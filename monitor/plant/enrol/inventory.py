"""The inventory: the arms of a plant as a CSV table that a person keeps, one row an arm. Pure.

Empty cells, and columns that are left out, have the default of the configuration.
"""

import csv
import io
import re
from collections import Counter
from dataclasses import MISSING, dataclass, fields
from typing import Any

from monitor.errors import BadInput
from monitor.model.robot import robot_names

LONGEST_NAME = 64 - len("cell@")  # characters of a certificate's common name (RFC 5280, ub-common-name)
PAGE_PORT = 8420  # of the first arm of a computer; each further arm has the next one
_ID = re.compile(r"[a-z0-9_-]+\Z")
_ADDRESS = re.compile(r"[A-Za-z0-9][A-Za-z0-9.:-]*\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """One row. An empty text or tuple: nothing is said, and the key is left out of the arm's configuration."""

    site: str
    id: str  # unique within the site
    model: str  # e.g. ur5e
    host: str  # address of the controller
    computer: str = ""  # where this arm's daemon runs; empty: one of its own
    mounting: str = ""
    payload_kg: float | None = None
    payload_cog_m: tuple[float, ...] = ()
    tcp_offset: tuple[float, ...] = ()
    tcp_speed_limit_m_s: float | None = None
    tool: str = ""
    serial: str = ""
    gains_nm_per_a: tuple[float, ...] = ()
    timezone: str = ""
    cron: str = ""
    windows_utc: tuple[str, ...] = ()
    cell: str = ""
    excitation: str = ""

    @property
    def name(self) -> str:
        """The arm in one word, which is also the common name of its certificate. A site and an id hold no full stop."""
        return f"{self.site}.{self.id}"


_COLUMNS = {field.name: field for field in fields(Arm)}
NEEDED = tuple(name for name, field in _COLUMNS.items() if field.default is MISSING)
_LENGTHS = {"payload_cog_m": 3, "tcp_offset": 6, "gains_nm_per_a": None}  # how many figures; None: one a joint, which check compares


def read_inventory(text: str, where: str) -> tuple[Arm, ...]:
    """The arms of a CSV table, in its order.

    Separated by commas or semicolons; figures of one cell are separated by spaces. `where` names the table in messages.
    Raises BadInput that lists every mistake with its line.
    """
    if not text.strip():
        raise BadInput(f"{where}: is empty; expected a header with at least {', '.join(NEEDED)}")
    lines = text.removeprefix("\ufeff")
    reader = csv.reader(io.StringIO(lines), delimiter=";" if lines.splitlines()[0].count(";") > lines.splitlines()[0].count(",") else ",")
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except csv.Error as error:
        raise BadInput(f"{where}:{reader.line_num}: is no CSV: {error}") from None
    rows = [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")]
    if not rows:
        raise BadInput(f"{where}: is empty; expected a header with at least {', '.join(NEEDED)}")
    header, mistakes = rows[0][1], []
    mistakes += [f"column {name!r}: unknown; known are {', '.join(_COLUMNS)}" for name in header if name not in _COLUMNS]
    mistakes += [f"column {name!r}: missing" for name in NEEDED if name not in header]
    mistakes += [f"column {name!r}: {count} times" for name, count in Counter(header).items() if count > 1]
    if mistakes:
        raise BadInput(_listed(f"{where}:{rows[0][0]}", mistakes))
    arms = []
    for line, row in rows[1:]:
        arm = _arm(header, row, f"line {line}", mistakes)
        if arm is not None:
            arms.append((line, arm))
    mistakes += _doubled(arms)
    if not rows[1:]:
        mistakes.append("holds no arm, only a header")
    if mistakes:
        raise BadInput(_listed(where, mistakes))
    return tuple(arm for _, arm in arms)


def page_ports(arms: tuple[Arm, ...]) -> dict[str, int]:
    """By name of an arm: the port of its page. The arms of one computer have different ones."""
    used: Counter[str] = Counter()
    ports = {}
    for arm in arms:
        computer = arm.computer or arm.name
        ports[arm.name] = PAGE_PORT + used[computer]
        used[computer] += 1
    return ports


def _arm(header: list[str], row: list[str], line: str, mistakes: list[str]) -> Arm | None:
    """The arm of one row; None, with the mistakes added, where it is none."""
    if len(row) > len(header):
        mistakes.append(f"{line}: {len(row)} cells, but {len(header)} columns; figures of one cell are separated by spaces")
        return None
    before = len(mistakes)
    values: dict[str, Any] = {}
    for name, cell in zip(header, row, strict=False):
        if not cell:
            continue
        try:
            values[name] = _value(name, cell)
        except BadInput as error:
            mistakes.append(f"{line}: {name} = {cell!r}: {error}")
    told = {name for name, cell in zip(header, row, strict=False) if cell}
    mistakes += [f"{line}: {name}: missing" for name in NEEDED if name not in told]
    if len(mistakes) > before:
        return None
    arm = Arm(**values)
    if len(arm.name) > LONGEST_NAME:
        mistakes.append(
            f"{line}: {arm.name}: site and id together have {len(arm.name) - 1} characters; expected at most {LONGEST_NAME - 1}"
        )
        return None
    return arm


def _value(name: str, cell: str) -> object:
    """A cell's content in the type of its column. Raises BadInput that says what would be right."""
    if name in {"site", "id"} and not _ID.match(cell):
        raise BadInput("expected only a–z, 0–9, _ and -")
    if name == "model" and cell not in robot_names():
        raise BadInput(f"unknown; known are {', '.join(robot_names())}")
    if name in {"host", "computer"} and not _ADDRESS.match(cell):
        raise BadInput("expected a name or an address")
    if name == "windows_utc":
        return tuple(cell.split())
    if name in _LENGTHS:
        figures = tuple(_figure(part) for part in cell.split())
        wanted = _LENGTHS[name]
        if wanted is not None and len(figures) != wanted:
            raise BadInput(f"expected {wanted} figures, separated by spaces")
        return figures
    return _figure(cell) if name in {"payload_kg", "tcp_speed_limit_m_s"} else cell


def _figure(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise BadInput("expected a figure with a decimal point, e.g. 1.25") from None
    if not abs(value) < float("inf"):
        raise BadInput("expected a finite figure")
    return value


def _doubled(arms: list[tuple[int, Arm]]) -> list[str]:
    """Arms that another row names already. Two rows with one controller would move it twice."""
    mistakes = []
    seen: dict[str, int] = {}
    for line, arm in arms:
        at_computer = f"id {arm.id} at computer {arm.computer}" if arm.computer else ""  # its files there are named by the id
        for key in (f"arm {arm.name}", f"host {arm.host}", at_computer):
            if key in seen:
                mistakes.append(f"line {line}: {key} stands in line {seen[key]} already")
            elif key:
                seen[key] = line
    return mistakes


def _listed(where: str, mistakes: list[str]) -> str:
    return f"{where}: {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join((f"{where}: {len(mistakes)} mistakes", *mistakes))
