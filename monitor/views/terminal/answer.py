"""What the command `query` prints: the rows of an answer as a table."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import typer
from rich.measure import Measurement
from rich.text import Text

from monitor.views.terminal.figures import standard_output, table_of

WIDEST = 10_000  # characters: as wide as the table would like to be
DIGITS = 6  # of a figure; --json and --csv have all of them


def print_answer(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print the rows of an answer, figures to the right; a line for each column of each row where a table would be too wide."""
    console = standard_output(120)
    figures = [all(value is None or _is_figure(value) for value in column) for column in zip(*rows, strict=True)] or [False] * len(columns)
    # a column's name may stand twice in an answer, and brackets in it are no markup
    table = table_of((), left=())
    for name, is_figure in zip(columns, figures, strict=True):
        table.add_column(Text(name), justify="right" if is_figure else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(_shown(value)) for value in row))
    if rows and Measurement.get(console, console.options.update(max_width=WIDEST), table).maximum > console.width:
        _print_upright(columns, rows)
    else:
        console.print(table)
    console.print(f"{len(rows)} rows" if len(rows) != 1 else "1 row", highlight=False)


def _print_upright(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    width = max(len(name) for name in columns)
    for number, row in enumerate(rows, start=1):
        typer.echo(f"── {number} {'─' * width}")
        for name, value in zip(columns, row, strict=True):
            typer.echo(f"{name:<{width}}  {_shown(value)}")


def _is_figure(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:z.{DIGITS}g}"
    if isinstance(value, datetime):
        utc = value if value.tzinfo is None else value.astimezone(UTC)
        return utc.replace(tzinfo=None).isoformat(sep=" ", timespec="seconds" if not utc.microsecond else "milliseconds")
    return str(value)
