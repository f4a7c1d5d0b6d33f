"""The picture of an identification's residuals: measured minus modelled torque over speed, load and position."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from monitor.recording import Array
from monitor.views.plots.picture import check_target, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from monitor.identify.identification import Identification
    from monitor.model.robot import Robot
    from monitor.recording import Recording

Mask = npt.NDArray[np.bool_]

BINS = 24  # of one axis: wide enough for a smooth median, narrow enough to show the course near standstill
MIN_SAMPLES_PER_BIN = 8  # quartiles of fewer samples are noise
MAX_POINTS = 4000  # of one recording in one panel; the bins use all samples
VIEW = 1.5  # the vertical axis ends at so many times the 99th percentile: a few samples at reversals would flatten the rest
ABSCISSAE = (("speed_rad_s", "speed [rad/s]"), ("load_nm", "load [Nm]"), ("position_rad", "position [rad]"))  # field, label of its axis
LEGEND = "Points: samples, grey at standstill. Line: median in bins; band: 25–75 %. A course that is not flat is what the model lacks."


class Residuals(NamedTuple):
    """What the model does not explain of one recording; every array is (N, J)."""

    label: str
    speed_rad_s: Array
    load_nm: Array  # modelled rigid torque, which the gear transmits
    position_rad: Array
    residual_nm: Array
    moving: Mask


def residuals_of(found: "Identification", arm: "Robot", recordings: "Sequence[Recording]", gains: Array | None = None) -> list[Residuals]:
    """What an identified model does not explain of each of these recordings. Raises BadInput where they are not of its arm."""
    from monitor.identify.signals.arm import joint_torque, motion_of
    from monitor.identify.validate import held_out_settings, predict_motion

    shown = []
    for recording in recordings:
        moved = motion_of(recording, arm, held_out_settings().signals)
        parts = predict_motion(found, arm, moved)
        residual = joint_torque(moved, arm, gains) - parts.torque
        shown.append(Residuals(Path(moved.source).name, moved.qd, parts.rigid, moved.q, residual, moved.moving()))
    return shown


def residual_plot(path: Path, title: str, recordings: Sequence[Residuals]) -> None:
    """Draw the residual of every joint over speed, load and position. A curve that is not flat shows what the model lacks.

    Points are samples, grey where the joint stands still. The line is the median of the moving samples in 24 bins; the band holds the
    middle half of them. Raises BadInput like `check_target`.
    """
    check_target(path)
    write_picture(path, residual_figure(title, recordings), title, LEGEND)


def residual_figure(title: str, recordings: Sequence[Residuals]) -> "Figure":
    """A row of panels for each joint, a column for each abscissa."""
    from matplotlib.figure import Figure  # 0.5 s; without pyplot, which would look for a screen

    J = recordings[0].residual_nm.shape[1]
    figure = Figure(figsize=(13.0, 2.1 * J + 0.9), layout="constrained")
    figure.suptitle(title)
    grid = figure.subplots(J, 3, squeeze=False, sharey="row")
    for j in range(J):
        for k, (field, label) in enumerate(ABSCISSAE):
            axes = grid[j, k]
            for number, recording in enumerate(recordings):
                _draw_recording(axes, recording, field, j, f"C{number}")
            axes.axhline(0.0, color="black", lw=0.6)
            largest = max((_percentile_99(one.residual_nm[one.moving[:, j], j]) for one in recordings), default=0.0)
            axes.set_ylim(-VIEW * largest - 1e-9, VIEW * largest + 1e-9)  # the term 1e-9 keeps the limits apart where all residuals are 0
            axes.grid(alpha=0.25)
            if k == 0:
                axes.set_ylabel(f"J{j + 1} residual [Nm]")
            if j == J - 1:
                axes.set_xlabel(label)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)), frameon=False)
    return figure


def _draw_recording(axes: "Axes", recording: Residuals, field: str, j: int, colour: str) -> None:
    """Draw joint j (from 0) of one recording into one panel: samples, and median and quartiles of the moving ones."""
    x, y = getattr(recording, field)[:, j], recording.residual_nm[:, j]
    every, moving = max(1, len(x) // MAX_POINTS), recording.moving[:, j]
    for shown, point_colour in ((~moving, "0.6"), (moving, colour)):
        axes.plot(x[shown][::every], y[shown][::every], ".", ms=1.5, alpha=0.25, color=point_colour, rasterized=True, zorder=1)
    middle, low, median, high = _quartiles_by_bin(x[moving], y[moving])
    axes.fill_between(middle, low, high, color=colour, alpha=0.3, lw=0, zorder=2)
    axes.plot(middle, median, color=colour, lw=1.8, label=recording.label, zorder=3)


def _percentile_99(residual_nm: Array) -> float:
    """The 99th percentile of |residual| [N·m]; 0 where there is no sample."""
    return float(np.percentile(np.abs(residual_nm), 99.0)) if len(residual_nm) else 0.0


def _quartiles_by_bin(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Middles of the bins of x (N,), and the three quartiles of y (N,) in each. Bins with too few samples are left out."""
    if not len(x):
        return x, x, x, x
    edges = np.linspace(np.min(x), np.max(x), BINS + 1)
    number = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    full = [k for k in range(BINS) if np.sum(number == k) >= MIN_SAMPLES_PER_BIN]
    quartiles = np.array([np.percentile(y[number == k], (25.0, 50.0, 75.0)) for k in full]).reshape(-1, 3)
    return 0.5 * (edges[:-1] + edges[1:])[full], quartiles[:, 0], quartiles[:, 1], quartiles[:, 2]
