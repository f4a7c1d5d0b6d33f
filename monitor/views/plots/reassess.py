"""Pictures of a reassessment: the friction and the alerts of an arm as they were, and as they would be."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.errors import StoreError
from monitor.judge.alerts.health import TIERS
from monitor.reason import joint_text
from monitor.views.plots.picture import write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

THEN, NOW = "0.55", "C0"  # colours
LINES = dict(zip(TIERS, (":", "--", "-"), strict=True))


def draw_arms(folder: Path, document: Mapping[str, Any]) -> list[Path]:
    """Draw each arm of which something else would be said, one PNG an arm; returns their paths. Raises StoreError."""
    drawn = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for arm, friction in document["friction"].items():
            rows = [row for row in document["changed_alerts"] if row["arm"] == arm]
            path = folder / (re.sub(r"[^\w.=-]+", "_", arm) + ".png")
            _draw(path, arm, friction, rows)
            drawn.append(path)
    except OSError as wrong:
        raise StoreError(f"--pictures {folder}: cannot be written: {wrong.strerror or wrong}") from None
    return drawn


def _draw(path: Path, arm: str, friction: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> None:
    from matplotlib.figure import Figure

    joints = sorted({row["joint"] for row in rows if row["joint"] is not None}) or [1]
    figure = Figure(figsize=(9.0, 1.0 + 2.4 * len(joints)), layout="constrained")
    axes = figure.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0]
    for joint, one in zip(joints, axes, strict=True):
        _joint(one, joint, friction, [row for row in rows if row["joint"] in (joint, None)])
    axes[0].legend(loc="upper left", fontsize="small")
    figure.suptitle(f"{arm}: then and once more")
    write_picture(path, figure, arm)


def _joint(axes: "Axes", joint: int, friction: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> None:
    for name, colour in (("then", THEN), ("now", NOW)):
        wear = np.array([np.nan if each[joint - 1] is None else each[joint - 1] for each in friction[name]["wear"]], dtype=float)
        axes.plot(_times(friction[name]["at_unix_s"]), 100.0 * wear, color=colour, label={"then": "then", "now": "once more"}[name])
        for row in rows:
            if (at := row[f"{name}_unix_s"]) is not None:
                axes.axvline(_times([at])[0], color=colour, linestyle=LINES[row["tier"]], linewidth=1.0)
                text = f"{row['tier']} {'' if name == 'then' else row['change']}"
                height = 0.98 if name == "then" else 0.02
                alignment = "top" if name == "then" else "bottom"
                axes.annotate(
                    text, (_times([at])[0], height), xycoords=("data", "axes fraction"), rotation=90, va=alignment, ha="right",
                    fontsize="x-small", color=colour,
                )  # fmt: skip
    axes.set_ylabel(f"{joint_text(joint)}\nfriction [%]")
    axes.grid(visible=True, alpha=0.3)


def _times(at_unix_s: Sequence[float]) -> Any:
    return np.array([int(at) for at in at_unix_s], dtype="datetime64[s]").astype(object)
