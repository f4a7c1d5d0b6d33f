"""Pictures of an identification, as a PNG or as one HTML file that needs no network."""

import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from monitor.errors import BadInput
from monitor.recording import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Mask = npt.NDArray[np.bool_]

BINS = 24
FEWEST_IN_BIN = 8  # fewer have no quartiles worth drawing
SHOWN = 4000  # points of one recording; the bins are of all


class Residuals(NamedTuple):
    """What one recording leaves unexplained, each (N, J)."""

    label: str
    speed_rad_s: Array
    load_nm: Array  # rigid torque through the gear, as the model has it
    position_rad: Array
    residual_nm: Array
    moving: Mask


def check_target(path: Path) -> None:
    """Raises BadInput unless a picture can be written there; to be asked before the work is done."""
    if path.suffix.lower() not in {".png", ".html"}:
        raise BadInput(f"--plot {path}: expected a name that ends in .png or .html")
    if path.is_dir():
        raise BadInput(f"--plot {path}: is a folder; expected the name of a file")
    if not path.parent.is_dir():
        raise BadInput(f"--plot {path}: the folder {path.parent} does not exist")


def residual_plot(path: Path, title: str, recordings: Sequence[Residuals]) -> None:
    """Residual against speed, load and position of every joint: what shows a course here, the model lacks.

    Points are samples, grey where the joint stands still; the line is the median of the moving ones in 24 bins, the band the quarter
    either side. Raises BadInput as `check_target`.
    """
    check_target(path)
    try:
        _draw(path, title, recordings)
    except OSError as wrong:
        raise BadInput(f"--plot {path}: cannot be written: {wrong.strerror}") from None


def _draw(path: Path, title: str, recordings: Sequence[Residuals]) -> None:
    figure = _figure(title, recordings)
    _written(
        path,
        figure,
        title,
        "Points: samples, grey at standstill. Line: median in bins; band: 25–75 %. A course that is not flat is what the model lacks.",
    )


def rehearsal_plot(path: Path, document: dict[str, Any]) -> None:
    """Days to the first tier against the pace of wear: median, and nine of ten. Raises BadInput as `check_target`."""
    check_target(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    rows = [row for row in document["detection"] if row["per_year"] > 0]
    pace = [100 * row["per_year"] for row in rows]
    for key, label, style in (("median_days", "half of the arms", "o-"), ("p90_days", "nine of ten", "s--")):
        axes.plot(pace, [np.nan if row[key] is None else row[key] for row in rows], style, label=label)
    axes.set(xscale="log", yscale="log", xlabel="wear of one joint [% a year]", ylabel="days from onset to the first tier")
    rate = document["false_alarms"]["all"]
    axes.set_title(f"{rate['per_year']:.3f} alerts a robot-year that mean nothing (at most {rate['at_most']:.3f}, 95 %)")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    _written(path, figure, "rehearsal", "Days from the onset of wear in one joint to the first tier, on simulated arms.")


def _written(path: Path, figure: "Figure", title: str, legend: str) -> None:
    """As PNG, or as SVG within one HTML file."""
    if path.suffix.lower() == ".png":
        figure.savefig(path, dpi=110)
        return
    drawing = io.StringIO()
    figure.savefig(drawing, format="svg", dpi=110)  # points are rasterised within: 100 000 circles would stall a browser
    picture = drawing.getvalue()
    picture = picture[picture.index("<svg") :]
    path.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>\n'
        "<style>body{font-family:sans-serif;margin:1em}svg{width:100%;height:auto}</style></head>\n"
        f"<body>\n{picture}\n<p>{html.escape(legend)}</p>\n</body></html>\n",
        encoding="utf-8",
    )


def _figure(title: str, recordings: Sequence[Residuals]) -> "Figure":
    from matplotlib.figure import Figure  # 0.5 s; no pyplot: it would look for a screen

    J = recordings[0].residual_nm.shape[1]
    figure = Figure(figsize=(13.0, 2.1 * J + 0.9), layout="constrained")
    figure.suptitle(title)
    grid = figure.subplots(J, 3, squeeze=False, sharey="row")
    for j in range(J):
        for k, (name, unit) in enumerate((("speed_rad_s", "speed [rad/s]"), ("load_nm", "load [Nm]"), ("position_rad", "position [rad]"))):
            axes = grid[j, k]
            for number, recording in enumerate(recordings):
                x, y = getattr(recording, name)[:, j], recording.residual_nm[:, j]
                every, moves = max(1, len(x) // SHOWN), recording.moving[:, j]
                for which, colour in ((~moves, "0.6"), (moves, f"C{number}")):
                    axes.plot(x[which][::every], y[which][::every], ".", ms=1.5, alpha=0.25, color=colour, rasterized=True, zorder=1)
                middle, low, median, high = _course(x[moves], y[moves])
                axes.fill_between(middle, low, high, color=f"C{number}", alpha=0.3, lw=0, zorder=2)
                axes.plot(middle, median, color=f"C{number}", lw=1.8, label=recording.label, zorder=3)
            axes.axhline(0.0, color="black", lw=0.6)
            largest = max((_reach(one.residual_nm[one.moving[:, j], j]) for one in recordings), default=0.0)
            axes.set_ylim(-1.5 * largest - 1e-9, 1.5 * largest + 1e-9)  # a few samples at reversals would flatten the rest
            axes.grid(alpha=0.25)
            if k == 0:
                axes.set_ylabel(f"J{j + 1} residual [Nm]")
            if j == J - 1:
                axes.set_xlabel(unit)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)), frameon=False)
    return figure


def _reach(y: Array) -> float:
    return float(np.percentile(np.abs(y), 99.0)) if len(y) else 0.0


def _course(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Middles of bins of x, and quartiles of y in each; bins with too few samples are left out."""
    if not len(x):
        return x, x, x, x
    edges = np.linspace(np.min(x), np.max(x), BINS + 1)
    number = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    full = [k for k in range(BINS) if np.sum(number == k) >= FEWEST_IN_BIN]
    quartiles = np.array([np.percentile(y[number == k], (25.0, 50.0, 75.0)) for k in full]).reshape(-1, 3)
    return 0.5 * (edges[:-1] + edges[1:])[full], quartiles[:, 0], quartiles[:, 1], quartiles[:, 2]
