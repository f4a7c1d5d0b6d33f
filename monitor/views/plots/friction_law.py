"""The picture of the temperature law: fv(T) of every joint beside the replays from which it was learned."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from monitor.judge.assessment import Assessment, JointFriction
    from monitor.judge.temperature.laws import Line
    from monitor.publish.documents import HistoryRow

BAND = 2.0  # standard deviations to each side of the law
POINTS = 50  # along a law
COLUMNS = 3  # panels beside each other


def friction_figure(title: str, course: "Sequence[Assessment]") -> "Figure":
    """A panel a joint: fv(T) as known at the end of a course of one or more, its band, and each replay, wear divided out."""
    J = course[-1].belief.joints
    return law_figure(title, course[-1].model.viscous, [[each.friction[j] for each in course] for j in range(J)])


def law_figure(
    title: str, viscous: "Line", rows: "Sequence[Sequence[JointFriction | HistoryRow]]", range_c: tuple[float, float] | None = None
) -> "Figure":
    """The same by the law and the estimates of each joint, and over `range_c` [°C] where it is given."""
    from matplotlib.figure import Figure

    J = len(rows)
    figure = Figure(figsize=(11.0, 3.0 * -(-J // COLUMNS)), layout="constrained")
    figure.suptitle(title)
    panels = np.ravel(figure.subplots(-(-J // COLUMNS), COLUMNS, squeeze=False))
    for j, axes in enumerate(panels):
        axes.set_visible(j < J)
        if j >= J:
            continue
        seen = np.array([row.temperature_c for row in rows[j]], dtype=float)
        fresh = np.array([row.viscous_nm_s_per_rad for row in rows[j]], dtype=float) / (1.0 + np.array([row.wear for row in rows[j]]))
        axes.plot(seen, fresh, ".")
        if np.isfinite(seen).any():
            low, high = range_c or (float(np.nanmin(seen)), float(np.nanmax(seen)))
            T = np.linspace(low, high, POINTS)
            law = viscous.at(np.repeat(T[:, None], J, axis=1))
            value, std = law.value[:, j], law.std[:, j]
            axes.fill_between(T, value - BAND * std, value + BAND * std, alpha=0.2)
            axes.plot(T, value)
        axes.set(title=f"joint {j + 1}", xlabel="T [°C]", ylabel="fv [N·m·s/rad]")
    return figure
