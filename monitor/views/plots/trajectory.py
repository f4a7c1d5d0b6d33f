"""A picture of a designed trajectory: its curves, how clear it stays over time, and what it tells of each joint."""

import html
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor.design.clearance import surroundings
from monitor.design.proof import cell_of
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.views.plots.residuals import check_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATE_HZ = 125.0


def design_plot(path: Path, robot: Robot, excitation: Excitation) -> None:
    """One repetition: q, q̇, q̈ of every joint, Raviola et al. (2021), figure 2; clearance; the deviations to expect.

    Raises BadInput where a picture cannot be written there.
    """
    check_target(path)
    figure = _figure(robot, excitation)
    if path.suffix.lower() == ".png":
        figure.savefig(path, dpi=110)
        return
    drawing = io.StringIO()
    figure.savefig(drawing, format="svg")
    picture = drawing.getvalue()
    title = html.escape(f"{excitation.robot}: {excitation.source}")
    path.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f"<style>body{{font-family:sans-serif}}svg{{width:100%;height:auto}}</style></head>\n<body>\n{picture[picture.index('<svg') :]}\n"
        "</body></html>\n",
        encoding="utf-8",
    )


def _figure(robot: Robot, excitation: Excitation) -> "Figure":
    from matplotlib.figure import Figure  # 0.5 s; no pyplot: it would look for a screen

    t = np.arange(round(excitation.pass_s * RATE_HZ) + 1) / RATE_HZ
    state = excitation.at(t)
    figure = Figure(figsize=(11.0, 13.0), layout="constrained")
    figure.suptitle(f"{robot.name}, {np.round(np.degrees(excitation.mounting.angles_rad)).astype(int).tolist()}°: {excitation.source}")
    axes = figure.subplots(5, 1, height_ratios=(2, 2, 2, 1.6, 1.4))
    panels = (("q [rad]", state.q, None), ("q̇ [rad/s]", state.qd, robot.max_speed_rad_s), ("q̈ [rad/s²]", state.qdd, None))
    for panel, (label, signal, limit) in zip(axes, panels, strict=False):
        for j in range(robot.joints):
            panel.plot(t, signal[:, j], lw=1.3, color=f"C{j}", label=f"J{j + 1}")
        if limit is not None:
            for level in sorted(set(limit.round(6).tolist())):
                panel.axhline(level, color="0.6", lw=0.8, ls=":")
                panel.axhline(-level, color="0.6", lw=0.8, ls=":")
        panel.set_ylabel(label)
        panel.grid(alpha=0.25)
    axes[0].legend(ncols=robot.joints, loc="upper right", fontsize="small", framealpha=0.85)
    cell = cell_of(excitation)
    if cell is not None:
        gaps = surroundings(robot, excitation.mounting, cell).gaps(state.q)
        curves = ((gaps.to_itself_m, cell.self_margin_m, "to itself"), (gaps.to_cell_m, cell.margin_m, f"to the cell {cell.name!r}"))
        for number, (gap, margin, label) in enumerate(curves):
            axes[3].plot(t, 1000.0 * gap, color=f"C{number}", lw=1.3, label=label)
            axes[3].axhline(1000.0 * margin, color=f"C{number}", lw=0.9, ls="--", label="its margin")
        axes[3].legend(ncols=4, loc="upper right", fontsize="small", framealpha=0.85)
        axes[3].set_ylim(bottom=0.0)
    axes[3].set_ylabel("clearance [mm]")
    axes[3].grid(alpha=0.25)
    for panel in axes[:4]:
        panel.set_xlim(t[0], t[-1])
    axes[3].set_xlabel("t [s]")
    if excitation.objectives is not None:
        place, merits = np.arange(robot.joints), excitation.objectives
        bars = (("coulomb_std_nm", "fc"), ("viscous_std_nm_s_per_rad", "fv at 1 rad/s"))
        for shift, (key, label) in zip((-0.2, 0.2), bars, strict=True):
            std = np.array([np.nan if value is None else value for value in merits[key]])
            axes[4].bar(place + shift, 100.0 * std / robot.max_torque_nm, 0.38, label=f"std of {label}")
        axes[4].legend(ncols=2, loc="upper right", fontsize="small", framealpha=0.85)
        axes[4].set_xticks(place, [f"J{j + 1}" for j in range(robot.joints)])
    axes[4].set_ylabel("std [% of torque limit]")
    axes[4].grid(alpha=0.25, axis="y")
    return figure
