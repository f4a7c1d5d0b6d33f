"""The values that a section of the reproduction is made of: checks, tables and drawings."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.studies.paper.campaign import Campaign

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORDER = 5.0  # two figures whose ratio is within this factor have the same order of magnitude
Expected = Literal["agree", "alike", "differ"]  # to the last figure or sign, in order of magnitude, not at all


class Check(NamedTuple):
    """One statement of the paper beside ours. The paper is reproduced where every check holds that can."""

    what: str
    paper: str
    ours: str
    expected: Expected
    holds: bool | None  # None: the figures must differ, as the arm is another one
    why: str

    @property
    def document(self) -> dict[str, Any]:
        """The check as plain JSON."""
        return {**self._asdict(), "holds": None if self.holds is None else bool(self.holds)}


class Rows(NamedTuple):
    """A table. The first column holds words, the others figures."""

    columns: tuple[str, ...]
    rows: list[list[Any]]


@dataclass(slots=True)
class Section:
    """One figure or table of the paper, and its comparison. `drawings` are functions of the campaign, each with a caption."""

    key: str
    title: str
    text: str
    checks: list[Check] = field(default_factory=list)
    tables: list[tuple[str, Rows]] = field(default_factory=list)
    drawings: list[tuple[Callable[[Campaign], "Figure"], str]] = field(default_factory=list)

    def as_document(self) -> dict[str, Any]:
        """Checks and tables as plain JSON."""
        return {
            "section": self.key,
            "title": self.title,
            "checks": [check.document for check in self.checks],
            "tables": [{"title": title, "columns": list(rows.columns), "rows": rows.rows} for title, rows in self.tables],
        }


def span(values: Array, unit: str, digits: int = 1) -> str:
    """The least and the largest of the values, with their unit."""
    return f"{np.min(values):.{digits}f} … {np.max(values):.{digits}f} {unit}"


def r_squared(x: Array, y: Array) -> float:
    """Share of the variance of y (N,) that a straight line over x (N,) explains; NaN for fewer than three points or a constant y."""
    if len(x) < 3 or not np.ptp(y) > 0:
        return float("nan")
    residual = y - np.polyval(np.polyfit(x, y, 1), x)
    return float(1.0 - np.var(residual) / np.var(y))
