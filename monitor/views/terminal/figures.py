"""How figures look on a terminal: numbers with their standard deviation, percentages, colours of states and tiers, tables."""

import re
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, tzinfo
from typing import Any

from rich.console import Console
from rich.table import Table

# of a NAMUR NE 107 state
STATE_STYLE = {
    "NORMAL": "green",
    "CHECK_FUNCTION": "yellow",
    "OFF_SPEC": "yellow",
    "MAINTENANCE_REQUIRED": "bold magenta",
    "FAILURE": "bold red",
}
# of a tier, and of an alert that has cleared
TIER_STYLE = {"advisory": "yellow", "wear": "bold magenta", "limit": "bold red", "cleared": "green"}


def standard_output(width: int, *, highlight: bool = False) -> Console:
    """Standard output, as wide as its terminal; `width` characters wide where it is no terminal."""
    return Console(width=None if sys.stdout.isatty() else width, highlight=highlight)


def table_of(titles: Sequence[str], *, left: Sequence[str] = (), title: str | None = None) -> Table:
    """An empty table. Columns are aligned to the right, as figures are, except those in `left`."""
    made = Table(title=title, title_justify="left")
    for name in titles:
        made.add_column(name, justify="left" if name in left else "right")
    return made


def number(value: float | None, form: str) -> str:
    """A figure in the format `form` of Python; a dash where it is unknown."""
    return "–" if value is None else format(value, form)


def whole_percent(share: float | None) -> str:
    """A fraction as per cent without decimals; a dash where it is unknown."""
    return "–" if share is None else f"{100 * share:.0f} %"


def pair(value: float | None, std: float | None) -> str:
    """A figure with its standard deviation; a dash where it is unknown."""
    return "–" if value is None else f"{value:.3f} ± {number(std, '.3f')}"


def percent(fraction: float | None) -> str:
    """A fraction as per cent with one decimal; a dash where it is unknown."""
    return "–" if fraction is None else f"{100 * fraction:.1f} %"


def remaining_life(life: dict[str, float | None] | None) -> str:
    """Median and P10–P90 of remaining life [days]; `no trend` where there is none."""
    if not life or life.get("p50_days") is None:
        return "no trend"
    return f"{life['p50_days']:.0f} d ({number(life.get('p10_days'), '.0f')}–{number(life.get('p90_days'), '.0f')})"


# --- Times of documents, which are UTC, in the time zone of the schedule, for a person ------------------

_STAMP = re.compile(r"\b(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.\d+)?Z")


def local_times(document: Any, zone: tzinfo) -> Any:
    """The same document with every time of its texts in the zone, e.g. 2026-11-22 04:00:00 CET; unchanged where the zone is UTC."""
    if str(zone) == "UTC":
        return document
    if isinstance(document, dict):
        return {key: local_times(value, zone) for key, value in document.items()}
    if isinstance(document, list):
        return [local_times(value, zone) for value in document]
    return _STAMP.sub(lambda match: _local(match[1], zone), document) if isinstance(document, str) else document


def _local(stamp: str, zone: tzinfo) -> str:
    return datetime.fromisoformat(stamp).replace(tzinfo=UTC).astimezone(zone).strftime("%Y-%m-%d %H:%M:%S %Z")
