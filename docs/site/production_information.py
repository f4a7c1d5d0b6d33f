"""Makes `docs/production-information.png`, and prints the table above it: what the programs of simulated cells tell of each joint.

The production of each simulated cell is recorded once, and `listen` judges longer and longer parts of it.
"""

import json
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from monitor.model.fourier import excitation_from_document
from monitor.model.robot import load_robot
from monitor.simulate.cells.catalogue import PRODUCTION, cell
from monitor.simulate.cells.cell import in_cell
from monitor.simulate.controller.controller import Controller
from monitor.simulate.production import ProductionSettings, record
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import write_recording, write_table
from monitor.store.from_files.production_files import ListenRequest, listen_to_files
from monitor.views.plots.picture import write_picture

ROOT = Path(__file__).parents[2]
SECONDS = (10, 20, 40, 80, 120)
COLOURS = ("#1b9e77", "#d95f02", "#7570b3", "#e7298a", "#66a61e", "#a6761d")
LEAST = 0.02  # shares below are drawn at the edge
TICKS = (0.2, 0.5, 1, 2, 5, 10, 20)


def told(name: str, folder: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """(K,) cycles, (K, J) held/needed, and seconds of a cycle."""
    arm = load_robot("ur5")
    controller = Controller(in_cell(SimulateSettings(robot="ur5", seed=1), cell(name, arm)))
    excitation = excitation_from_document(json.loads((ROOT / "config/excitation/ur5-ground.json").read_text("utf-8")))
    write_recording(folder / "replay.parquet", stepped_replay(controller, replace(excitation, repetitions=1)))
    production = record(ProductionSettings(cell=name, hours=SECONDS[-1] / 3600.0))
    cycle_s, shares = SECONDS[-1] / production.cycles, []
    for seconds in SECONDS:
        rows = round(seconds * 25.0)
        write_table(folder / "production.parquet", {key: values[:rows] for key, values in production.columns.items()}, production.context)
        request = ListenRequest(
            files=[folder / "production.parquet"], rigid=folder / "replay.parquet", history=None, robot=None, mounting=None
        )
        shares.append([joint["share"] for joint in listen_to_files(request, load_robot)["joints"]])
    return np.array(SECONDS) / cycle_s, np.array(shares), cycle_s


def main(path: Path) -> None:
    """Draw the picture and print the table."""
    figure = Figure(figsize=(13.0, 3.6), layout="constrained")
    panels = figure.subplots(1, len(PRODUCTION), sharey=True)
    sys.stdout.write("| program | a cycle | after 2 minutes [%]: joint 1 | 2 | 3 | 4 | 5 | 6 |\n|---|---|---|---|---|---|---|---|\n")
    for axes, name in zip(panels, PRODUCTION, strict=True):
        with tempfile.TemporaryDirectory() as folder:
            cycles, shares, cycle_s = told(name, Path(folder))
        for j, colour in enumerate(COLOURS):
            axes.plot(cycles, np.maximum(shares[:, j], LEAST), "o-", color=colour, markersize=3.5, label=f"joint {j + 1}", clip_on=False)
        axes.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
        axes.set(xscale="log", yscale="log", ylim=(LEAST, 20.0), title=name, xlabel=f"cycles of {cycle_s:.0f} s")
        ticks = [count for count in TICKS if 0.9 * cycles[0] <= count <= 1.1 * cycles[-1]]
        axes.set_xticks(ticks, [f"{count:g}" for count in ticks])
        axes.set_yticks([LEAST, 0.1, 1.0, 10.0], ["none", "0.1", "1", "10"])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=True, alpha=0.3)
        last = " | ".join("–" if share < LEAST else f"{5.0 / math.sqrt(share):.1f}" for share in shares[-1])
        sys.stdout.write(f"| {name} | {cycle_s:.0f} s | {last} |\n")
        sys.stdout.flush()
    panels[0].set_ylabel("information held / needed for 5 %")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    write_picture(path, figure, "what work tells")


if __name__ == "__main__":
    main(ROOT / "docs" / "production-information.png")
