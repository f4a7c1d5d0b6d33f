"""A temperature sensor that stands still while the other joints warm and cool: what it tells is no temperature.

Left alone, every season would look like wear of that joint, or hide it.
"""

from typing import Any, NamedTuple

import numpy as np

from monitor.judge.document import arrays
from monitor.recording import Array

SAME_K = 1.0 / 32.0  # half a step of a UR's sensor: the mean of a replay moves by more
REPLAYS = 5  # in a row that tell the same …
MOVED_K = 3.0  # … while the other joints' median went up and down by so much


class Sensors(NamedTuple):
    """Since when every joint's sensor tells what it tells, (J,) each; NaN before the first replay."""

    told_c: Array
    replays: Array
    others_low_c: Array  # of the other joints' median meanwhile
    others_high_c: Array


def update_sensors(before: Sensors | None, temperature_c: Array, joints_per_arm: int) -> Sensors:
    """The history after one more replay at temperatures (N,) [°C]. A sensor without a value keeps its history."""
    T = temperature_c
    N = len(T)
    unknown = np.full(N, np.nan)
    was = before or Sensors(unknown, np.zeros(N), unknown, unknown)
    known = np.isfinite(T)
    others = median_of_others(T, joints_per_arm)
    same = known & (np.abs(T - was.told_c) < SAME_K)
    return Sensors(
        told_c=np.where(known & ~same, T, was.told_c),
        replays=np.where(same, was.replays + 1.0, np.where(known, 1.0, was.replays)),
        others_low_c=np.where(same, np.fmin(was.others_low_c, others), np.where(known, others, was.others_low_c)),
        others_high_c=np.where(same, np.fmax(was.others_high_c, others), np.where(known, others, was.others_high_c)),
    )


def stuck_sensors(sensors: Sensors) -> np.ndarray:
    """(J,) which sensors stand still though they should not."""
    moved = sensors.others_high_c - sensors.others_low_c
    still: np.ndarray = (sensors.replays >= REPLAYS) & (np.nan_to_num(moved) >= MOVED_K)
    return still


def sensors_from_document(document: Any, J: int) -> Sensors | None:
    """Raises BadInput naming what is missing or wrong; None of null."""
    return None if document is None else Sensors(**arrays(document, Sensors._fields, (J,), where="belief: sensors"))


def median_of_others(values: Array, joints_per_arm: int) -> Array:
    """(N,) for each joint, the median of the finite values (N,) of the arm's other joints; NaN where fewer than two are finite."""
    J = joints_per_arm
    if J < 3:
        return np.full(len(values), np.nan)
    others = np.array([[k for k in range(J) if k != j] for j in range(J)])  # (J, J − 1)
    known = np.where(np.isfinite(values), values, np.nan).reshape(-1, J)[:, others]
    ordered = np.sort(known, axis=-1)  # (A, J, J − 1), NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    lower, upper = (np.take_along_axis(ordered, np.maximum(k, 0), axis=-1) for k in ((count - 1) // 2, count // 2))
    return np.where(count >= 2, (lower + upper) / 2.0, np.nan).ravel()
