"""Friction from a single replay alone, at the reference temperature, to be shown beside the estimate from all replays."""

import numpy as np

from monitor.judge.drift.step import DriftState
from monitor.judge.friction.figures import expected, expected_row, missed_var, noise_var, uneven_std
from monitor.judge.friction.observation import Observation
from monitor.judge.friction.step import LEAST_VARIANCE, FrictionModel
from monitor.recording import Array


def single_torque_nm(state: DriftState, observation: Observation, model: FrictionModel) -> tuple[Array, Array]:
    """F(v*, T0) of one replay alone and its standard deviation, (N,) each [N·m].

    state : after the replay; its temperature law brings the replay to T0. observation : of the replay, with NaN in `log_torque` where
    nothing was learned; the torque is then NaN. The standard deviation contains the uncertainty within the replay, the noise between
    replays, and that of the law over the way to T0. Without a temperature it contains everything that temperature may have changed.
    """
    friction, T0 = state.friction, state.reference_temperature_c
    sensed = np.isfinite(observation.temperature_c)
    warming = np.nan_to_num(observation.warming_k_per_min)
    here = expected_row(friction, np.where(sensed, observation.temperature_c, T0), warming, model)
    way, way_var = expected(friction, here - expected_row(friction, T0, np.zeros(state.joints), model))  # level and wear cancel
    var = observation.variance + LEAST_VARIANCE + noise_var(friction, model) + np.where(sensed, 0.0, missed_var(friction))
    var = var + way_var + uneven_std(friction, warming, model) ** 2
    torque: Array = np.exp(observation.log_torque - way)
    return torque, torque * np.sqrt(np.maximum(var, 0.0))
