"""Pictures of an identification, as a PNG or as one HTML file that needs no network."""

import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
        f"<body>\n{picture}\n"
        "<p>Points: samples, grey at standstill. Line: median in bins; band: 25–75 %. "
        "A course that is not flat is what the model lacks.</p>\n"
        "</body></html>\n",
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
