"""Live torque: the model's prediction for the arm's present motion beside the drives' measurement, one sample at a time."""

from typing import Any

import numpy as np

from monitor.judge.prediction_error import MOVING_RAD_S
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import TorquePrediction, predictor_for
from monitor.model.robot import Robot
from monitor.recording import Array, Recording


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

    def document(self, q: Array, qd: Array, temperature_c: Array, predicted: TorquePrediction, measured: Array) -> dict[str, Any]:
        """The published document of one sample, without its time; arrays are (J,).

        `std_nm` is the deviation of the residual, from model and measurement; `torque_std_nm` that of the torque itself.
        """
        known = bool(np.all(np.isfinite(measured)))
        return {
            "q_rad": q,
            "qd_rad_s": qd,
            "temperature_c": temperature_c,
            "predicted_nm": predicted.torque[0],
            "std_nm": np.sqrt(predicted.measured_std[0] ** 2 + self._more_var),
            "torque_std_nm": predicted.std[0],
            "measured_nm": measured if known else None,
            "residual_nm": measured - predicted.torque[0] if known else None,
            "extrapolated": predicted.extrapolated[0],
            "model_revision": self.model.revision,
        }


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
