"""Recording: the signals of one replay, or of one file from elsewhere, and the context of its measurement.

The letters of shapes are the same in all rooms: N samples, J joints, P parameters (13 for each joint), B base parameters.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from monitor.errors import BadInput
from monitor.reason import Reason

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

DAY_S = 86_400.0  # seconds in a day of UTC
FOREIGN_MOTION = "motion-"  # `Context.trajectory_digest` of a recording that names no trajectory begins so: a fingerprint of its motion

# RTDE's names of the columns with one value for each joint, and the field of `Recording` that each becomes
JOINT_COLUMNS = {
    "actual_q": "q",
    "actual_qd": "qd",
    "actual_qdd": "qdd",
    "actual_current": "current",
    "actual_torque": "torque",
    "actual_current_as_torque": "torque",
    "joint_temperatures": "temperature_c",
    "target_q": "target_q",
    "target_qd": "target_qd",
    "target_qdd": "target_qdd",
    "target_current": "target_current",
    "target_moment": "target_moment",
}


def known_or_none(value: float) -> float | None:
    """A float for a document, or None for a value that is not finite."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """The conditions that must be equal for two replays to be comparable, and the origin of the measurement.

    `None` means unknown. An unknown value is not equal to a known value.
    """

    robot: str | None = None  # the model, e.g. "ur5"
    serial: str | None = None
    firmware: str | None = None
    mounting_rad: tuple[float, float, float] | None = None  # roll, pitch, yaw [rad]
    payload_kg: float | None = None
    tool: str | None = None
    trajectory_digest: str | None = None
    software: str | None = None
    recorded_at_unix_s: float | None = None  # the host's clock (UTC) at the first sample [s]
    note: str | None = None
    joint_serials: tuple[str, ...] | None = None  # from the type plates, as a person entered them: RTDE does not give them
    maintenance: str | None = None  # the last work on the arm that may have changed its friction, in a person's words
    revolutions: tuple[float, ...] | None = None  # of each joint, from a counter whose zero is arbitrary: only differences have a meaning


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """Signals as the controller sent them, one row for each tick, neither filtered nor corrected."""

    t_s: Array  # (N,) the controller's clock [s]
    q: Array  # (N, J) [rad]
    qd: Array | None = None  # (N, J) [rad/s]
    qdd: Array | None = None  # (N, J) [rad/s²]
    current: Array | None = None  # (N, J) [A]
    torque: Array | None = None  # (N, J) [N·m], where the source gives torque
    temperature_c: Array | None = None  # (N, J) [°C]
    target_q: Array | None = None  # (N, J) [rad]
    target_qd: Array | None = None  # (N, J) [rad/s]
    target_qdd: Array | None = None  # (N, J) [rad/s²]
    target_current: Array | None = None  # (N, J) [A]
    target_moment: Array | None = None  # (N, J) [N·m]
    robot_mode: Array | None = None  # (N,)
    safety_mode: Array | None = None  # (N,)
    runtime_state: Array | None = None  # (N,)
    speed_scaling: Array | None = None  # (N,)
    context: Context = field(default_factory=Context)
    quality: Mapping[str, Any] = field(default_factory=dict)  # counts of the acquisition: missed_ticks, duplicated_ticks, …
    source: str = ""  # the file's name, for messages
    told: tuple[Reason, ...] = ()  # what a reader of the file is to know, beside its signals

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises BadInput naming the signal, its shape and the shape that was expected.
        """
        if self.t_s.ndim != 1 or self.q.ndim != 2 or len(self.q) != len(self.t_s):
            raise BadInput(f"{self.source or 'recording'}: t is {self.t_s.shape}, q is {self.q.shape}; expected (N,) and (N, J)")
        for name in set(JOINT_COLUMNS.values()):
            signal = getattr(self, name)
            if signal is not None and signal.shape != self.q.shape:
                raise BadInput(f"{self.source or 'recording'}: {name} is {signal.shape}; expected {self.q.shape} like q")

    @property
    def samples(self) -> int:
        """N."""
        return len(self.t_s)

    @property
    def joints(self) -> int:
        """J."""
        return int(self.q.shape[1])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample on the controller's clock [s]."""
        return float(self.t_s[-1] - self.t_s[0]) if self.samples else 0.0

    @property
    def signals(self) -> dict[str, Array]:
        """Every signal of the recording, by the name of its field."""
        present = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in {"context", "quality", "source", "told"}}
        return {name: value for name, value in present.items() if value is not None}

    @property
    def samples_digest(self) -> str:
        """32 hexadecimal digits that two recordings share where they are one, whenever their clocks begin: of positions and drives."""
        digest = hashlib.sha256()
        for signal in (self.q, self.current, self.torque):
            if signal is not None:
                digest.update(str(signal.shape).encode())
                digest.update(np.where(np.isnan(signal), np.nan, signal + 0.0).tobytes())  # one NaN, no −0
        return digest.hexdigest()[:32]

    def changed(self, names: Iterable[str], change: Callable[[Array], Array]) -> "Recording":
        """The recording with the signals of these names changed, where it has them."""
        found: dict[str, Any] = {name: change(signal) for name in names if (signal := getattr(self, name)) is not None}
        return replace(self, **found)

    @property
    def mean_temperature_c(self) -> Array | None:
        """(J,) mean over the samples [°C]; None without temperatures."""
        if self.temperature_c is None or not self.samples:
            return None
        mean: Array = np.mean(self.temperature_c, axis=0)
        return mean
