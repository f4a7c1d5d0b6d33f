"""WorkRows: signals of the arm at work, with what tells contact, load and the way of control. Live and from files."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.recording import JOINT_COLUMNS, Array, Context, Indices, Recording

SCALARS = ("robot_mode", "safety_mode", "runtime_state", "speed_scaling")  # RTDE's names, which are the fields of `Recording` too
# RTDE's name of a column that only work needs, the field of `WorkRows` and its width; 0 for (N,)
EXTRA_COLUMNS: Mapping[str, tuple[str, int]] = {
    "payload": ("payload_kg", 0),
    "payload_cog": ("payload_com_m", 3),
    "actual_TCP_force": ("tcp_force", 6),
    "robot_status_bits": ("status_bits", 0),
    "force_mode": ("force_mode", 0),
    "tool": ("tool", 0),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProductionRows:
    """Rows of work, N samples; the time of the first is `recording.context.recorded_at_unix_s`. A column is None where it is unknown."""

    recording: Recording
    payload_kg: Array | None = None  # (N,) as the controller was told
    payload_com_m: Array | None = None  # (N, 3) its centre in the flange's frame
    tcp_force: Array | None = None  # (N, 6) [N, N·m]
    status_bits: Array | None = None  # (N,) bit 2: the teach button (freedrive)
    force_mode: Array | None = None  # (N,) not 0 where the program controls force, as far as the caller knows
    tool: Array | None = None  # (N,) a number that changes with the tool, as far as the caller knows

    def __post_init__(self) -> None:
        """Raises BadInput naming a column whose shape does not fit."""
        for field_name, width in EXTRA_COLUMNS.values():
            value, N = getattr(self, field_name), self.recording.samples
            expected = (N, width) if width else (N,)
            if value is not None and value.shape != expected:
                raise BadInput(f"{self.recording.source or 'rows of work'}: {field_name} is {value.shape}; expected {expected}")

    @property
    def at_unix_s(self) -> float:
        """Time of the first row; 0 where it is unknown."""
        at = self.recording.context.recorded_at_unix_s
        return 0.0 if at is None else at

    def part(self, rows: Indices | slice) -> "ProductionRows":
        """Some of the rows, with their time."""
        recording = self.recording
        t_s = recording.t_s[rows]
        began = recording.context.recorded_at_unix_s
        if began is not None and len(t_s):
            began += float(t_s[0] - recording.t_s[0])
        signals: dict[str, Any] = {name: value[rows] for name, value in recording.signals.items()}
        chosen = Recording(
            **signals, context=replace(recording.context, recorded_at_unix_s=began), quality=recording.quality, source=recording.source
        )
        extra = {f.name: value[rows] for f in fields(self) if f.name != "recording" and (value := getattr(self, f.name)) is not None}
        return ProductionRows(recording=chosen, **extra)


def rows_of_columns(table: Mapping[str, Array], *, at_unix_s: float | None) -> ProductionRows:
    """The rows of a table by RTDE's names, (N,) or (N, J) each, as live rows come. Other columns are not read.

    at_unix_s : the host's time of the first row. Raises BadInput where time or positions are missing, or a shape does not fit.
    """
    for needed in ("timestamp", "actual_q"):
        if needed not in table:
            raise BadInput(f"rows of work: hold no {needed}; expected timestamp and actual_q at least")
    signals: dict[str, Any] = {}
    for name, field_name in JOINT_COLUMNS.items():
        if name in table:
            signals.setdefault(field_name, np.asarray(table[name], dtype=float))
    signals |= {name: np.asarray(table[name], dtype=float) for name in SCALARS if name in table}
    recording = Recording(
        t_s=np.asarray(table["timestamp"], dtype=float),
        context=Context(recorded_at_unix_s=at_unix_s),
        **signals,
    )
    extra = {field_name: np.asarray(table[name], dtype=float) for name, (field_name, _) in EXTRA_COLUMNS.items() if name in table}
    return ProductionRows(recording=recording, **extra)


def windows(rows: ProductionRows, length_s: float) -> list[ProductionRows]:
    """The rows in windows of about this length, in which work is judged; a clock that leaps, or a longer pause, begins a new one."""
    t_s = rows.recording.t_s
    if not len(t_s):
        return []
    step = np.diff(t_s, prepend=t_s[:1])
    ahead = np.where((step > 0.0) & (step < length_s), step, 0.0)
    leaps = (np.nan_to_num(step) < 0.0) | (np.nan_to_num(step) >= length_s)  # after a night the rows are of another day
    number = np.floor(np.cumsum(np.nan_to_num(ahead)) / length_s) + np.cumsum(leaps)
    edges = np.flatnonzero(np.diff(number)) + 1
    return [rows.part(slice(int(a), int(b))) for a, b in zip([0, *edges], [*edges, len(t_s)], strict=True)]
