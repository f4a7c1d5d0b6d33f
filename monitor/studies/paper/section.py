"""What a section of the reproduction is made of: checks, tables and drawings, as values."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.studies.paper.campaign import Campaign

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Expected = Literal["agree", "alike", "differ"]


class Check(NamedTuple):
    """One comparison in words: what must agree must hold, or the paper is not reproduced."""

    what: str
    paper: str
    ours: str
    expected: Expected
    holds: bool | None  # None: nothing to hold, it must differ
    why: str

    @property
    def document(self) -> dict[str, Any]:
        """Plain JSON."""
        return {**self._asdict(), "holds": None if self.holds is None else bool(self.holds)}


class Rows(NamedTuple):
    """A table: the first column holds words, the others figures."""

    columns: tuple[str, ...]
    rows: list[list[Any]]


@dataclass(slots=True)
class Section:
    """One figure or table of the paper."""

    key: str
    title: str
    text: str
    checks: list[Check] = field(default_factory=list)
    tables: list[tuple[str, Rows]] = field(default_factory=list)
    drawings: list[tuple[Callable[[Campaign], "Figure"], str]] = field(default_factory=list)


def span(values: Array, unit: str, digits: int = 1) -> str:
    """The least and the largest of some values, with their unit."""
    return f"{np.min(values):.{digits}f} … {np.max(values):.{digits}f} {unit}"


def r_squared(x: Array, y: Array) -> float:
    """Share of the variance of y (N,) that a straight line over x (N,) explains; NaN for fewer than three points or a constant y."""
    if len(x) < 3 or not np.ptp(y) > 0:
        return float("nan")
    residual = y - np.polyval(np.polyfit(x, y, 1), x)
    return float(1.0 - np.var(residual) / np.var(y))
