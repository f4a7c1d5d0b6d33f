"""Signals of a recording that are there by name alone: without numbers, or one number throughout beside motion. They are left out."""

from dataclasses import replace
from typing import Any

import numpy as np

from monitor.reason import Reason, Sentence
from monitor.recording import Array, Mask, Recording

MOST_MISSING = 0.2  # of the rows may lack a number, as in `SignalSettings.max_rejected_share`: with more the recording would be refused
TURNED_RAD = 0.1  # of a joint whose speed cannot be one number

SIGNAL_EMPTY = Sentence("signal_empty", "{source}: {signal} holds no number in {share:.0%} of the rows; it is left out, and {instead:word}")
SIGNAL_CONSTANT = Sentence(
    "signal_constant", "{source}: {signal} is {value:.4g} throughout in joints {joints}; it is left out, and {instead:word}"
)
FROM_POSITIONS = "speeds are the change of the positions"
FROM_CURRENT, FROM_TORQUE = "the current is taken", "the torque is taken"
FROM_SPEEDS = "accelerations are the change of the speeds"


def usable(recording: Recording) -> tuple[Recording, tuple[Reason, ...]]:
    """The recording without such signals, as far as another one stands for them; and what is left out."""
    told: list[Reason] = []
    rows = np.isfinite(recording.t_s) & np.all(np.isfinite(recording.q), axis=1)
    if not rows.any():
        return recording, ()
    turned = np.ptp(recording.q[rows], axis=0) > TURNED_RAD
    for field, name, instead in (
        ("qd", "actual_qd", FROM_POSITIONS),
        ("qdd", "actual_qdd", FROM_SPEEDS),
        ("torque", "actual_torque", FROM_CURRENT),
        ("current", "actual_current", FROM_TORQUE),
    ):
        values = getattr(recording, field)
        other = {"torque": recording.current, "current": recording.torque}.get(field)
        if values is None or (field in {"torque", "current"} and (other is None or not _measured(other[rows], turned))):
            continue
        missing = float(np.max(np.mean(~np.isfinite(values[rows]), axis=0)))
        still = turned & _constant(values[rows])
        if missing > MOST_MISSING:
            told.append(SIGNAL_EMPTY(source=recording.source or "recording", signal=name, share=missing, instead=instead))
        elif field != "qdd" and still.any():
            value = float(np.nanmedian(values[rows][:, still][:, 0]))
            joints = np.flatnonzero(still) + 1
            told.append(SIGNAL_CONSTANT(source=recording.source or "recording", signal=name, value=value, joints=joints, instead=instead))
        else:
            continue
        nothing: dict[str, Any] = {field: None}
        recording = replace(recording, **nothing)
    return recording, tuple(told)


def _measured(values: Array, turned: Mask) -> bool:
    """Whether a current or torque (N, J) is there in most rows and changes in every joint that turned."""
    return bool(np.mean(~np.isfinite(values), axis=0).max() <= MOST_MISSING and not np.any(turned & _constant(values)))


def _constant(values: Array) -> Mask:
    """(J,) columns (N, J) that hold one number in all rows that hold one."""
    constant: Mask = np.array([len(np.unique(column[np.isfinite(column)])) <= 1 for column in values.T])
    return constant
