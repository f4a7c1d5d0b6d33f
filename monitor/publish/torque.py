"""Torque by the model: answers to `torque`, and `torque/live`, the prediction of the present motion with the drives' measurement.

The bus and `predict` share the query: its JSON, checked for shape, finiteness and range, becomes arrays.
"""

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np

from monitor.errors import BadInput
from monitor.judge.prediction_error import MOVING_RAD_S
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import TorquePrediction, predictor_for
from monitor.model.robot import Robot
from monitor.publish.documents import Torque, TorqueLive
from monitor.recording import Array, Recording

MOST_SAMPLES = 10_000
RANGES = {
    "q": (-4 * math.pi, 4 * math.pi),  # [rad]
    "qd": (-10.0, 10.0),  # [rad/s]
    "qdd": (-1000.0, 1000.0),  # [rad/s²]
    "temperature_c": (-40.0, 120.0),  # [°C] a value beyond it is a mistake
}
_PARTS = ("torque_nm", "rigid_nm", "friction_nm", "std_nm", "extrapolated", "measured_std_nm", "temperature_c")
Rows = list[list[float]]


def torque_answer(model: CompensatedModel, robot: Robot, temperature_c: Array | None, request: Mapping[str, Any]) -> Torque:
    """Temperature-corrected joint torque of one sample or of N, in the shape of the request; several thousand figures stay arrays.

    `q` and `qd` [rad, rad/s] are required; `qdd` [rad/s²] is 0 where it is missing, `temperature_c` the present one. Raises BadInput that
    names the wrong argument.
    """
    unknown = sorted(name for name, value in request.items() if value is not None and name not in RANGES)
    if unknown:
        raise BadInput(f"torque: unknown argument {unknown[0]!r}; known are {', '.join(sorted(RANGES))}")
    predictor = predictor_for(model, robot)
    rows = {name: _rows(name, request.get(name), robot.joints, temperature_c) for name in RANGES}
    N = len(rows["q"])
    for name, given in rows.items():
        if len(given) not in (1, N):
            raise BadInput(f"torque: {name} has {len(given)} rows but q has {N}")
    if not isinstance(request["q"][0], list):
        sample = [given[0] for given in rows.values()]
        parts: tuple[Any, ...] = (*predictor.sample(*sample), sample[-1])
    else:
        state = [np.broadcast_to(np.array(given, dtype=float), (N, robot.joints)) for given in rows.values()]
        parts = (*predictor.torque(*state), np.array(state[-1]))
    return Torque.model_construct(**dict(zip(_PARTS, parts, strict=True)), model_revision=model.revision)


def _rows(name: str, value: Any, joints: int, temperature_c: Array | None) -> Rows:
    """The rows of an argument, J numbers each: one where it is one sample, or stands for all samples."""
    if value is None:
        if name == "qdd":
            return [[0.0] * joints]
        if name != "temperature_c":
            raise BadInput(f"torque: {name} is missing; expected {joints} numbers, or N rows of {joints}")
        if temperature_c is None:
            raise BadInput("torque: temperature_c is missing, and the arm's present temperatures are not known; give one a joint [°C]")
        value = temperature_c.tolist()
    rows = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    if len(rows) > MOST_SAMPLES:
        raise BadInput(f"torque: {name} has {len(rows)} rows; at most {MOST_SAMPLES} are answered in one query")
    low, high = RANGES[name]
    for row in rows:
        # by exact type: Python counts `true` as an int
        if not (isinstance(row, list) and len(row) == joints and _NUMBERS.issuperset(map(type, row))):
            raise BadInput(f"torque: {name} is not {joints} numbers or N rows of {joints}")
        for j, figure in enumerate(row):
            if not low <= figure <= high:
                raise BadInput(f"torque: {name} of joint {j + 1} is {figure:g}; expected {low:g} … {high:g}")
    return rows


_NUMBERS = {int, float}


# --- live torque -----------------------------------------------------------------------------------


class LiveTorque:
    """Compares single unfiltered samples; their noise is known from the model, or from the last replay."""

    def __init__(self, model: CompensatedModel, robot: Robot, gains: Array | None, more_var: Array | None = None) -> None:
        """more_var : `sample_var` of the replay that updated the model last, where the model has no figure of its own."""
        self._predictor = predictor_for(model, robot)
        self.model = model
        self._gains = robot.drive_gain_nm_per_a if gains is None else gains
        self._more_var = np.zeros(model.joints) if more_var is None else more_var  # [N²·m²]

    def compared(self, q: Array, qd: Array, qdd: Array, current: Array, temperature_c: Array) -> tuple[TorquePrediction, Array]:
        """The model's prediction, (1, J), and the drives' torque, (J,) [N·m], of one sample; inputs are (J,)."""
        predicted = self._predictor.sample(q.tolist(), qd.tolist(), qdd.tolist(), temperature_c.tolist())
        return TorquePrediction(*(np.array([part]) for part in predicted)), current * self._gains

    def document(self, at: datetime, q: Array, qd: Array, temperature_c: Array, predicted: TorquePrediction, measured: Array) -> TorqueLive:
        """The published document of one sample; arrays are (J,), and stay arrays.

        `std_nm` is the deviation of the residual, from model and measurement; `torque_std_nm` that of the torque itself.
        """
        known = bool(np.all(np.isfinite(measured)))
        figures: dict[str, Any] = {
            "q_rad": q,
            "qd_rad_s": qd,
            "temperature_c": temperature_c,
            "predicted_nm": predicted.torque[0],
            "std_nm": np.sqrt(predicted.measured_std[0] ** 2 + self._more_var),
            "torque_std_nm": predicted.std[0],
            "measured_nm": measured if known else None,
            "residual_nm": measured - predicted.torque[0] if known else None,
            "extrapolated": predicted.extrapolated[0],
        }
        return TorqueLive.model_construct(at=at, model_revision=self.model.revision, **figures)


def sample_var(model: CompensatedModel, robot: Robot, gains: Array | None, recording: Recording) -> Array | None:
    """(J,) [N²·m²] variance of one raw sample beyond the model's own figure, from a replay.

    None where the model has a figure for samples, or the recording has no such signals.
    """
    gains = robot.drive_gain_nm_per_a if gains is None else gains
    qd, qdd, current, temperature_c = recording.qd, recording.target_qdd, recording.current, recording.temperature_c
    if model.measured_rms_nm is not None or qd is None or qdd is None or current is None or temperature_c is None:
        return None
    residual: Array = current * gains - predictor_for(model, robot).torque(recording.q, qd, qdd, temperature_c).torque
    residual = np.where(np.abs(qd) > MOVING_RAD_S, residual, np.nan)
    with np.errstate(invalid="ignore"):
        count = np.isfinite(residual).sum(axis=0)
        rms: Array = np.sqrt(np.nansum(residual**2, axis=0) / np.maximum(count, 1))
    rms = np.where(count > 0, rms, np.nan)
    return np.nan_to_num(np.maximum(rms**2 - model.residual_rms_nm**2, 0.0))
