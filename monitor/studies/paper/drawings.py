"""The figures of the paper, drawn from a campaign on a simulated arm."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from monitor.recording import Array
from monitor.studies.paper.campaign import Campaign
from monitor.studies.paper.printed import PRINTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RATE_HZ = 125.0  # of the drawn trajectories
SHOWN_S = 10.0  # of a curve over time: one period
EVERY = 3  # third sample is drawn: at some 40 Hz they are closer than the line is wide
MEASURED, BEFORE, MODEL = "#222222", "#c8781e", "#1f6fb4"
COLD, WARM = "#1f6fb4", "#b3261e"
MOUNTING_COLOURS = {"ground": "#1f6fb4", "ceiling": "#c8781e", "wall": "#3d8a4d"}


def _sheet(width: float, height: float) -> "Figure":
    """An empty figure of this size [inch]."""
    from matplotlib.figure import Figure  # 0.5 s; without pyplot, which would look for a screen

    return Figure(figsize=(width, height), layout="constrained")


def _joints(height: float) -> tuple["Figure", "list[Axes]"]:
    """A figure with a panel for each of six joints."""
    figure = _sheet(9.0, height)
    axes = figure.subplots(3, 2, sharex=True).T.ravel().tolist()
    for j, one in enumerate(axes):
        one.set_title(f"joint {j + 1}", fontsize="small", loc="left")
        one.grid(alpha=0.25)
        one.tick_params(labelsize="small")
    return figure, axes


def singular_values(found: Campaign) -> "Figure":
    """Figure 1: singular values of the regressor, and their cumulative energy."""
    figure = _sheet(9.0, 3.2)
    left, right = figure.subplots(1, 2)
    for (name, base), marker in zip(found.bases.items(), "ox^", strict=True):
        sigma = base.singular_values
        number = np.arange(1, len(sigma) + 1)
        left.semilogy(
            number, np.maximum(sigma, 1e-17), marker, ms=3.5, label=f"{name}: {base.count}", fillstyle="none", color=MOUNTING_COLOURS[name]
        )
        right.plot(number, 100 * base.cumulative_energy, lw=1.4, label=name, color=MOUNTING_COLOURS[name])
    left.axvline(52.5, color="0.5", lw=0.8, ls=":")
    left.axvline(54.5, color="0.5", lw=0.8, ls=":")
    left.set(xlabel="number", ylabel="singular value")
    right.set(xlabel="number", ylabel="cumulative energy [%]", xlim=(0, 30))
    for axes in (left, right):
        axes.grid(alpha=0.25)
        axes.legend(fontsize="small")
    return figure


def trajectories(found: Campaign) -> "Figure":
    """Figure 2: position, speed and acceleration of both excitations."""
    figure = _sheet(9.0, 5.2)
    grid = figure.subplots(3, 2, sharex=True, sharey="row")
    for k, mounting in enumerate(("ground", "ceiling")):
        excitation = found.trajectories[mounting]
        t = np.arange(round(excitation.period_s * RATE_HZ) + 1)[::EVERY] / RATE_HZ
        state = excitation.at(t)
        condition = (excitation.objectives or {}).get("condition_number")
        grid[0, k].set_title(f"{mounting}: condition number {condition:.0f}", fontsize="medium")
        for row, (signal, label) in enumerate(((state.q, "q [rad]"), (state.qd, "q̇ [rad/s]"), (state.qdd, "q̈ [rad/s²]"))):
            for j in range(found.robot.joints):
                grid[row, k].plot(t, signal[:, j], lw=1.1, color=f"C{j}", label=f"J{j + 1}")
            grid[row, k].grid(alpha=0.25)
            grid[row, 0].set_ylabel(label)
        grid[2, k].set_xlabel("t [s]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=6, loc="outside lower center", frameon=False, fontsize="small")
    return figure


def parameters(found: Campaign) -> "Figure":
    """Figure 3: identified base parameters, and the true ones, which only a simulated arm has."""
    figure = _sheet(9.0, 5.0)
    halves = figure.subplots(2, 1)
    identified = found.identified
    number = np.arange(len(identified.names))
    for axes, part in zip(halves, np.array_split(number, 2), strict=True):
        axes.errorbar(
            part,
            identified.values[part],
            yerr=3 * identified.std[part],
            fmt="o",
            ms=3.5,
            lw=1,
            capsize=2,
            color=MODEL,
            label="identified ± 3σ",
        )
        axes.plot(part, found.truth[part], "x", ms=5, color="#b3261e", label="the simulated arm's own")
        axes.set_xticks(part, [identified.names[k].split(" ")[0] for k in part], rotation=60, fontsize=7)
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_ylabel("SI units")
        axes.grid(alpha=0.25)
        shown = np.concatenate([identified.values[part] + sign * 3 * identified.std[part] for sign in (1, -1)])
        axes.set_ylim(min(2.0 * shown.min(), -0.15), 2.0 * shown.max())  # the largest value stays inside the frame
    halves[0].legend(fontsize="small", ncols=2)
    return figure


def validation(found: Campaign) -> "Figure":
    """Figures 4 to 6: torque along the validation trajectory, measured and predicted."""
    styles = (("before", BEFORE, 1.0, "manufacturer's data"), ("measured", MEASURED, 1.6, "measured"), ("LS", MODEL, 1.1, "identified, LS"))
    return _torques(found.validation_t_s, found.validation_nm, styles)


def cold_and_warm(found: Campaign) -> "Figure":
    """Figure 7: torque along the excitation by the cold and by the warm identification."""
    styles = (("cold", COLD, 1.2, "cold"), ("warm", WARM, 1.2, "warm"))
    return _torques(found.cold_warm_t_s, {"cold": found.cold_nm, "warm": found.warm_nm}, styles)


def transfer(found: Campaign) -> "Figure":
    """Figure 9: torque on the ceiling, simulated, and predicted with the regressor of either mounting."""
    styles = (
        ("ground regressor", BEFORE, 1.0, "with the ground's regressor"),
        ("measured", MEASURED, 1.6, "simulated, no friction"),
        ("ceiling", MODEL, 1.0, "with the ceiling's regressor"),
    )
    return _torques(found.transfer_t_s, found.transfer_nm, styles)


def _torques(t_s: Array, torques_nm: Mapping[str, Array], styles: tuple[tuple[str, str, float, str], ...]) -> "Figure":
    """One period of several torque curves (N, J). styles : name, colour, width and label of each."""
    figure, axes = _joints(6.2)
    shown = t_s <= SHOWN_S
    for j, one in enumerate(axes):
        for key, colour, width, label in styles:
            line = "--" if key == "warm" else "-"
            one.plot(t_s[shown][::EVERY], torques_nm[key][shown][::EVERY, j], color=colour, lw=width, ls=line, label=label)
        one.set_ylabel("torque [Nm]", fontsize="small")
    return _finished(figure, axes, "t [s]")


def viscous_over_temperature(found: Campaign) -> "Figure":
    """Figure 8: fv over joint temperature with a straight line; beside it the fall in the paper, where the paper prints temperatures."""
    figure, axes = _joints(6.0)
    printed = PRINTED[found.robot.name]
    for j, one in enumerate(axes):
        T, fv = found.temperature_c[:, j], found.viscous[:, j]
        one.plot(T, fv, "o", ms=4, color=MODEL, label="one replay")
        one.plot(T, _line(T, fv), lw=1.2, color=MODEL, label="line through them")
        if printed.cold_c is not None and printed.warm_c is not None:
            ends = np.array([printed.cold_c[j], printed.warm_c[j]])
            # the paper has another arm, so only the relative fall is drawn, from our cold end
            one.plot(ends, fv[0] * np.array([1.0, 1.0 + printed.viscous_change[j]]), "--", lw=1.2, color=BEFORE, label="fall in the paper")
        one.set_ylabel("fv [Nm·s/rad]", fontsize="small")
        one.sharex(axes[0])
    return _finished(figure, axes, "joint temperature [°C]")


def _line(x: Array, y: Array) -> Array:
    """The straight line through points, at their x; y itself where all x are equal."""
    return np.polyval(np.polyfit(x, y, 1), x).astype(float) if np.ptp(x) > 0 else y


def _finished(figure: "Figure", axes: "list[Axes]", xlabel: str) -> "Figure":
    """The figure with labels and one legend for all panels."""
    for one in (axes[2], axes[5]):
        one.set_xlabel(xlabel, fontsize="small")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=len(labels), loc="outside lower center", frameon=False, fontsize="small")
    return figure
