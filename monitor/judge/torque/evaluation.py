"""The prediction error of a compensated model in one recording: the model and its predictor against what the arm measured."""

import numpy as np

from monitor.judge.prediction_error import MIN_PAIRS, MOVING_RAD_S, PredictionError, measure
from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import predictor_for
from monitor.model.robot import Robot
from monitor.recording import Array, Recording


def measure_prediction_error(recording: Recording, model: CompensatedModel, robot: Robot, gains: Array | None) -> PredictionError | None:
    """Prediction error of a model in a replay that the model was not fitted to; None where the recording lacks a signal for it.

    gains : (J,) drive gains [N·m/A], or None for the gains of the robot's description. Only moving samples inside the temperature range
    of the model count.
    """
    qd, qdd, current, temperature_c = recording.qd, recording.target_qdd, recording.current, recording.temperature_c
    if qd is None or qdd is None or current is None or temperature_c is None or recording.samples < MIN_PAIRS:
        return None
    predicted = predictor_for(model, robot).torque(recording.q, qd, qdd, temperature_c)
    gain = robot.drive_gain_nm_per_a if gains is None else gains
    usable = (np.abs(qd) > MOVING_RAD_S) & ~predicted.extrapolated & (np.ptp(current, axis=0) > 0.0)  # (N, J); a silent drive is none
    return measure(recording.t_s, qd, np.where(usable, current * gain - predicted.torque, np.nan))
