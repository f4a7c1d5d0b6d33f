"""A row: everything that one tick of the controller reports, in the order in which it travels from a session to its parent.

The names are those of the RTDE variables of Universal Robots; the driver of another make fills the same columns.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from monitor.recording import Array, Context, Recording

EACH_JOINT = 0  # in place of a width: as many values as the arm has joints
WIDTHS = {
    "timestamp": 1,  # [s] controller's clock
    "actual_q": EACH_JOINT,  # [rad]
    "actual_qd": EACH_JOINT,  # [rad/s]
    "actual_current": EACH_JOINT,  # [A]
    "joint_temperatures": EACH_JOINT,  # [°C]
    "target_q": EACH_JOINT,  # [rad]
    "target_qd": EACH_JOINT,  # [rad/s]
    "target_qdd": EACH_JOINT,  # [rad/s²]
    "target_current": EACH_JOINT,  # [A]
    "target_moment": EACH_JOINT,  # [N·m]
    "robot_mode": 1,
    "safety_mode": 1,
    "runtime_state": 1,
    "safety_status_bits": 1,
    "speed_scaling": 1,  # share of full speed, the trajectory limiter's
    "target_speed_fraction": 1,  # share of full speed, the slider's
    "payload": 1,  # [kg]
    "payload_cog": 3,  # [m] centre of gravity, in the flange's frame
    "actual_tool_accelerometer": 3,  # [m/s²] in the flange's frame
    "actual_digital_input_bits": 1,
    "robot_status_bits": 1,  # bit 0 power on, bit 1 program running, bit 2 teach button (freedrive), bit 3 power button
    "joint_mode": EACH_JOINT,
    "actual_TCP_pose": 6,  # position [m] and rotation vector [rad] in the base's frame
    "actual_TCP_force": 6,  # [N, N·m] at the TCP; measured from the e-Series on, computed from currents on a CB3
    "commanded_q": EACH_JOINT,  # [rad] the target sent for this row; NaN where none was sent
    "host_monotonic_s": 1,  # [s] host's clock when the session read the row
}


class Layout(NamedTuple):
    """Where each variable stands in a row of an arm with so many joints."""

    column: dict[str, slice]
    width: int


@cache
def layout(joints: int) -> Layout:
    """The layout of an arm's rows."""
    column, at = {}, 0
    for name, width in WIDTHS.items():
        column[name] = slice(at, at := at + (width or joints))
    return Layout(column, at)


@cache
def layout_of(width: int) -> Layout:
    """The layout of rows of this width."""
    joints, rest = divmod(width - sum(WIDTHS.values()), sum(each == EACH_JOINT for each in WIDTHS.values()))
    if rest or joints < 1:
        raise ValueError(f"a row of {width} values is none of an arm")
    return layout(joints)


def columns(rows: Array) -> dict[str, Array]:
    """Rows (N, WIDTH) by the name of the variable: (N,) or (N, J)."""
    found = layout_of(rows.shape[1]).column
    return {name: rows[:, column.start] if WIDTHS[name] == 1 else rows[:, column] for name, column in found.items()}


def tick_quality(table: Mapping[str, Array], rate_hz: float) -> dict[str, int]:
    """How many ticks are missing between the rows of `columns`, and how many rows belong to a tick that has one already."""
    ticks = np.diff(table["timestamp"]) * rate_hz  # (N−1,)
    return {"missed_ticks": int(np.sum(np.maximum(np.round(ticks) - 1, 0))), "duplicated_ticks": int(np.sum(ticks < 0.5))}


def latency_p99_ms(table: Mapping[str, Array]) -> float:
    """The 99 % quantile of the rows' latency [ms]: host's clock minus controller's clock, above the smallest difference."""
    latency_s = table["host_monotonic_s"] - table["timestamp"]  # (N,)
    return float(np.quantile(1000.0 * (latency_s - np.min(latency_s)), 0.99))


def recording_from_columns(table: Mapping[str, Array], *, context: Context, quality: dict[str, Any], source: str) -> Recording:
    """The recording with the signals of `columns`."""
    return Recording(
        t_s=table["timestamp"],
        q=table["actual_q"],
        qd=table["actual_qd"],
        current=table["actual_current"],
        temperature_c=table["joint_temperatures"],
        target_q=table["target_q"],
        target_qd=table["target_qd"],
        target_qdd=table["target_qdd"],
        target_current=table["target_current"],
        target_moment=table["target_moment"],
        robot_mode=table["robot_mode"],
        safety_mode=table["safety_mode"],
        runtime_state=table["runtime_state"],
        speed_scaling=table["speed_scaling"],
        context=context,
        quality=quality,
        source=source,
    )
