"""The picture of a designed trajectory: its motion, its clearance, and the standard deviations that it promises for each joint."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monitor.design.clearance import surroundings
from monitor.design.proof import cell_of
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.views.plots.picture import check_target, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RATE_HZ = 125.0  # of the drawn points: as many as the CB3 controller is sent


def design_plot(path: Path, robot: Robot, excitation: Excitation) -> None:
    """Draw one repetition: q, q̇ and q̈ of every joint as in Raviola et al. (2021), figure 2; clearance; expected standard deviations.

    Raises BadInput like `check_target`.
    """
    check_target(path)
    write_picture(path, _figure(robot, excitation), f"{excitation.robot}: {excitation.source}")


def _figure(robot: Robot, excitation: Excitation) -> "Figure":
    from matplotlib.figure import Figure  # 0.5 s; without pyplot, which would look for a screen

    t_s = np.arange(round(excitation.pass_s * RATE_HZ) + 1) / RATE_HZ
    figure = Figure(figsize=(11.0, 13.0), layout="constrained")
    figure.suptitle(f"{robot.name}, {np.round(np.degrees(excitation.mounting.angles_rad)).astype(int).tolist()}°: {excitation.source}")
    axes = figure.subplots(5, 1, height_ratios=(2, 2, 2, 1.6, 1.4)).tolist()
    _draw_motion(axes[:3], robot, excitation, t_s)
    _draw_clearance(axes[3], robot, excitation, t_s)
    _draw_deviations(axes[4], robot, excitation)
    for panel in axes[:4]:
        panel.set_xlim(t_s[0], t_s[-1])
    return figure


def _draw_motion(axes: "list[Axes]", robot: Robot, excitation: Excitation, t_s: Array) -> None:
    """Draw position, speed and acceleration of every joint, and the robot's speed limits."""
    state = excitation.at(t_s)
    panels = (("q [rad]", state.q, None), ("q̇ [rad/s]", state.qd, robot.max_speed_rad_s), ("q̈ [rad/s²]", state.qdd, None))
    for panel, (label, signal, limit) in zip(axes, panels, strict=True):
        for j in range(robot.joints):
            panel.plot(t_s, signal[:, j], lw=1.3, color=f"C{j}", label=f"J{j + 1}")
        if limit is not None:
            for level in sorted(set(limit.round(6).tolist())):
                panel.axhline(level, color="0.6", lw=0.8, ls=":")
                panel.axhline(-level, color="0.6", lw=0.8, ls=":")
        panel.set_ylabel(label)
        panel.grid(alpha=0.25)
    axes[0].legend(ncols=robot.joints, loc="upper right", fontsize="small", framealpha=0.85)


def _draw_clearance(panel: "Axes", robot: Robot, excitation: Excitation, t_s: Array) -> None:
    """Draw the distance of the arm to itself and to the cell, each with its margin; nothing where the trajectory names no cell."""
    cell = cell_of(excitation)
    if cell is not None:
        gaps = surroundings(robot, excitation.mounting, cell).gaps(excitation.at(t_s).q)
        curves = ((gaps.to_itself_m, cell.self_margin_m, "to itself"), (gaps.to_cell_m, cell.margin_m, f"to the cell {cell.name!r}"))
        for number, (gap_m, margin_m, label) in enumerate(curves):
            panel.plot(t_s, 1000.0 * gap_m, color=f"C{number}", lw=1.3, label=label)
            panel.axhline(1000.0 * margin_m, color=f"C{number}", lw=0.9, ls="--", label="its margin")
        panel.legend(ncols=4, loc="upper right", fontsize="small", framealpha=0.85)
        panel.set_ylim(bottom=0.0)
    panel.set_ylabel("clearance [mm]")
    panel.grid(alpha=0.25)
    panel.set_xlabel("t [s]")


def _draw_deviations(panel: "Axes", robot: Robot, excitation: Excitation) -> None:
    """Draw the expected standard deviations of fc, and of fv at 1 rad/s, as shares of each joint's torque limit."""
    if excitation.objectives is not None:
        place = np.arange(robot.joints)
        bars = (("coulomb_std_nm", "fc"), ("viscous_std_nm_s_per_rad", "fv at 1 rad/s"))
        for shift, (key, label) in zip((-0.2, 0.2), bars, strict=True):
            std = np.array([np.nan if value is None else value for value in excitation.objectives[key]])
            panel.bar(place + shift, 100.0 * std / robot.max_torque_nm, 0.38, label=f"std of {label}")
        panel.legend(ncols=2, loc="upper right", fontsize="small", framealpha=0.85)
        panel.set_xticks(place, [f"J{j + 1}" for j in range(robot.joints)])
    panel.set_ylabel("std [% of torque limit]")
    panel.grid(alpha=0.25, axis="y")
