"""Temperature sensors that are stuck: their value does not change while the arm's other joints warm and cool.

A stuck value is not a temperature. If it were used, every season would look like wear of that joint, or hide it.
"""

from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated

import numpy as np

from monitor.recording import Array

SAME_K = 1.0 / 32.0  # [K] half a step of a UR's sensor: the mean over a replay varies by more
REPLAYS = 5  # in a row with the same value …
MOVED_K = 3.0  # [K] … while the median of the other joints varied by so much
SUSPECT_REPLAYS, SUSPECT_MOVED_K = 3, 1.0  # the same of a value that is not used until it changes, and that nobody is told of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorHistory:
    """For how long each joint's sensor has had its present value, (N,) each; NaN before the first replay."""

    value_c: Annotated[Array, "N"]
    replays: Annotated[Array, "N"]  # in a row with this value
    others_low_c: Annotated[Array, "N"]  # lowest median of the arm's other joints in these replays
    others_high_c: Annotated[Array, "N"]  # and the highest


def update_sensors(before: SensorHistory | None, temperature_c: Array, joints_per_arm: int) -> SensorHistory:
    """The history after one more replay at temperatures (N,) [°C]. A sensor without a value keeps its history."""
    T, N = temperature_c, len(temperature_c)
    unknown = np.full(N, np.nan)
    was = before or SensorHistory(value_c=unknown, replays=np.zeros(N), others_low_c=unknown, others_high_c=unknown)
    known = np.isfinite(T)
    others = median_of_others(T, joints_per_arm)
    same = known & (np.abs(T - was.value_c) < SAME_K)
    return SensorHistory(
        value_c=np.where(known & ~same, T, was.value_c),
        replays=np.where(same, was.replays + 1.0, np.where(known, 1.0, was.replays)),
        others_low_c=np.where(same, np.fmin(was.others_low_c, others), np.where(known, others, was.others_low_c)),
        others_high_c=np.where(same, np.fmax(was.others_high_c, others), np.where(known, others, was.others_high_c)),
    )


def forget_sensors(sensors: SensorHistory, new: np.ndarray) -> SensorHistory:
    """The history where the joints in `new` (N,) have another sensor."""
    fresh = {f.name: np.where(new, 0.0 if f.name == "replays" else np.nan, getattr(sensors, f.name)) for f in fields(SensorHistory)}
    return SensorHistory(**fresh)


def stuck_sensors(sensors: SensorHistory) -> np.ndarray:
    """(N,) which sensors are stuck."""
    moved = sensors.others_high_c - sensors.others_low_c
    stuck: np.ndarray = (sensors.replays >= REPLAYS) & (moved >= MOVED_K)
    return stuck


def suspect_sensors(sensors: SensorHistory) -> np.ndarray:
    """(N,) which sensors may be stuck: until that is sure, a temperature that they missed would look like friction."""
    moved = sensors.others_high_c - sensors.others_low_c
    suspect: np.ndarray = (sensors.replays >= SUSPECT_REPLAYS) & (moved >= SUSPECT_MOVED_K)
    return suspect


def median_of_others(values: Array, joints_per_arm: int) -> Array:
    """(N,) for each joint, the median of the finite values (N,) of the arm's other joints; NaN where fewer than two are finite."""
    J = joints_per_arm
    if J < 3:
        return np.full(len(values), np.nan)
    known = np.where(np.isfinite(values), values, np.nan).reshape(-1, J)[:, _others(J)]
    ordered = np.sort(known, axis=-1)  # (A, J, J − 1), NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    lower, upper = (np.take_along_axis(ordered, np.maximum(k, 0), axis=-1) for k in ((count - 1) // 2, count // 2))
    return np.where(count >= 2, (lower + upper) / 2.0, np.nan).ravel()


@cache
def _others(joints: int) -> np.ndarray:
    """(J, J − 1) the other joints of each joint."""
    return np.array([[k for k in range(joints) if k != j] for j in range(joints)])
