"""Which rows of production count, how long they count, and how well friction must be known."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.model.friction import CONCAVE, FC, FV
from monitor.model.regressor import Felt, felt_columns, felt_regressor, friction_columns
from monitor.model.robot import PER_JOINT, Mounting, Robot
from monitor.recording import JOINT_COLUMNS, Array, Context, Indices, Recording

# --- ProductionRows: signals of the arm in production, with what tells contact, load and the way of control. Live and from files ---

SCALARS = ("robot_mode", "safety_mode", "runtime_state", "speed_scaling")  # RTDE's names, which are the fields of `Recording` too
# RTDE's name of a column that only production needs, the field of `ProductionRows` and its width; 0 for (N,)
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
    """Rows of production, N samples; `recording.context.recorded_at_unix_s` is the time of the first. An unknown column is None."""

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
                raise BadInput(f"{self.recording.source or 'rows of production'}: {field_name} is {value.shape}; expected {expected}")

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
            raise BadInput(f"rows of production: hold no {needed}; expected timestamp and actual_q at least")
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
    """The rows in windows of about this length, in which production is judged; a clock that leaps, or a longer pause, begins a new one."""
    t_s = rows.recording.t_s
    if not len(t_s):
        return []
    step = np.diff(t_s, prepend=t_s[:1])
    ahead = np.where((step > 0.0) & (step < length_s), step, 0.0)
    leaps = (np.nan_to_num(step) < 0.0) | (np.nan_to_num(step) >= length_s)  # after a night the rows are of another day
    number = np.floor(np.cumsum(np.nan_to_num(ahead)) / length_s) + np.cumsum(leaps)
    edges = np.flatnonzero(np.diff(number)) + 1
    return [rows.part(slice(int(a), int(b))) for a, b in zip([0, *edges], [*edges, len(t_s)], strict=True)]


# --- The arm in production: its model from the last replay, and the columns by which torque is explained ---

LOADS = 4  # unknowns of a load at the flange: m [kg], mx, my, mz [kg·m]
LEAST_RMS_NM, RMS_SHARE = 1e-3, 0.01  # of a residual that is not known: of the joint's largest torque
LAW = CONCAVE  # the friction of the last replay, from which production measures the difference; its first two terms are fc and fv


class Torques(NamedTuple):
    """What explains the torque of n rows: torque = rigid·p + friction·f + load·(what is at the flange beyond the replay's)."""

    rigid: Array  # (n, J, R)
    friction: Array  # (n, J, K) columns of `LAW`
    load: Array  # (n, J, 4)


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: what does not change with the rows is made once
class ProductionArm:
    """One arm with the identification of its last replay."""

    robot: Robot
    mounting: Mounting
    identification: Identification
    gains: Array | None = None  # (J,) [N·m/A]; None: the published torque constants
    payload_kg: float | None = None  # in the hand during that replay; None: nothing, or not known
    payload_com_m: tuple[float, float, float] | None = None  # None: where that of the production is

    def __post_init__(self) -> None:
        """Raises BadInput where the identification is of another robot."""
        if self.identification.robot != self.robot.name:
            raise BadInput(f"the identification is of a {self.identification.robot}, the robot is a {self.robot.name}")

    @property
    def joints(self) -> int:
        """J."""
        return self.robot.joints

    @cached_property
    def rigid_columns(self) -> tuple[int, ...]:
        """(R,) columns of the regressor that are rigid base parameters."""
        friction = np.concatenate(friction_columns(self.joints))
        return tuple(int(c) for c in self.identification.columns if c not in set(friction.tolist()))

    @cached_property
    def _felt(self) -> tuple[tuple[int, ...], Felt]:
        last = PER_JOINT * (self.joints - 1)
        columns = tuple(sorted({*self.identification.columns, *(last + k for k in range(LOADS))}))
        return columns, felt_columns(columns, self.joints, self.robot.innermost)

    @cached_property
    def rigid(self) -> Array:
        """(R,) rigid parameters of the last replay."""
        return rigid_parameters(self.identification, self.rigid_columns)

    @cached_property
    def residual_nm(self) -> Array:
        """(J,) RMS of what the replay's fit does not explain."""
        found = self.identification
        rms = found.rms_nm if found.residual_friction is None else found.residual_friction.rms_nm
        stand_in = RMS_SHARE * np.where(np.isfinite(self.robot.max_torque_nm), self.robot.max_torque_nm, 50.0)
        known: Array = np.maximum(np.where(np.isfinite(rms), rms, stand_in), LEAST_RMS_NM)
        return known

    @cached_property
    def friction(self) -> Array:
        """(J, K) terms of `LAW` by the last replay; 0 where unknown."""
        return friction_terms(self.identification)

    def torques(self, q: Array, qd: Array, qdd: Array, direction: Array) -> Torques:
        """The columns at states (n, J). direction : s(q̇) through the filter of the torque."""
        columns, felt = self._felt
        n, J = q.shape
        Y = np.zeros((n, J, len(columns)))
        for j, block in enumerate(felt_regressor(self.robot, self.mounting, felt, q, qd, qdd, direction)):
            Y[:, j, felt.places[j]] = block
        places = np.searchsorted(columns, self.rigid_columns)
        last = PER_JOINT * (J - 1)
        load = Y[:, :, np.searchsorted(columns, [last + k for k in range(LOADS)])]
        rigid = Y[:, :, places]
        gear = np.array([self.rigid_columns[k] % PER_JOINT != PER_JOINT - 1 for k in range(len(places))])
        through = rigid @ np.where(gear, self.rigid, 0.0)  # (n, J)
        terms = [term.column(direction, qd, through) for term in LAW.terms]
        return Torques(rigid, np.stack(terms, axis=-1), load)


def rigid_places(found: Identification, columns: tuple[int, ...]) -> Indices:
    """(R,) places of these rigid columns among the base parameters of an identification. Raises BadInput where one is missing."""
    places = np.searchsorted(found.columns, columns)
    if np.any(places >= len(found.columns)) or not np.array_equal(np.array(found.columns)[places], columns):
        raise BadInput(f"the base parameters of this {found.robot} are others than those of production; expected the same kind of mounting")
    return places


def rigid_parameters(found: Identification, columns: tuple[int, ...]) -> Array:
    """(R,) rigid parameters of a replay, those that were fitted beside `LAW` where it was."""
    values = found.values if found.residual_friction is None else found.residual_friction.rigid
    rigid: Array = values[rigid_places(found, columns)]
    return rigid


def friction_terms(found: Identification) -> Array:
    """(J, K) terms of `LAW` by a replay: those of its residual friction where that has this law, else fc and fv alone; 0 where unknown."""
    J = len(found.coulomb_nm)
    terms = np.zeros((J, len(LAW.terms)))
    terms[:, 0], terms[:, 1] = found.coulomb_nm, found.viscous_nm_s_per_rad
    richer = found.residual_friction
    if richer is not None and richer.law == LAW:
        known = np.all(np.isfinite(richer.friction), axis=1)
        terms[known] = richer.friction[known]
    elif found.friction is not None and found.friction.law == LAW:
        terms = found.friction.values.copy()
    assert LAW.terms[:2] == (FC, FV)
    return np.nan_to_num(terms)
