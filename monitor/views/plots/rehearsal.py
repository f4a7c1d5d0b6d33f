"""The picture of a rehearsal: how many days pass until wear is detected, over the wear rate."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from monitor.views.plots.picture import check_target, write_picture


def rehearsal_plot(path: Path, document: Mapping[str, Any]) -> None:
    """Draw the days from the onset of wear to the first tier over the wear rate: for half of the arms, and for nine of ten.

    document : of `rehearse`. Raises BadInput like `check_target`.
    """
    check_target(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    rows = [row for row in document["detection"] if row["per_year"] > 0]
    rate_percent_per_year = [100 * row["per_year"] for row in rows]
    for key, label, style in (("median_days", "half of the arms", "o-"), ("p90_days", "nine of ten", "s--")):
        axes.plot(rate_percent_per_year, [np.nan if row[key] is None else row[key] for row in rows], style, label=label)
    axes.set(xscale="log", yscale="log", xlabel="wear of one joint [% a year]", ylabel="days from onset to the first tier")
    alarms = document["false_alarms"]["all"]
    axes.set_title(f"{alarms['per_year']:.3f} alerts a robot-year that mean nothing (at most {alarms['at_most']:.3f}, 95 %)")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    write_picture(path, figure, "rehearsal", "Days from the onset of wear in one joint to the first tier, on simulated arms.")
