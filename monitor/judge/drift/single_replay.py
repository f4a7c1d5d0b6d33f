"""Friction from a single replay alone, at the reference temperature, to be shown beside the filter's estimate from all replays."""

import numpy as np

from monitor.judge.drift.filter_state import LAG, NOISE, saturating
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import DriftState
from monitor.recording import Array


def single_torque_nm(state: DriftState, observation: Observation, settings: DriftSettings) -> tuple[Array, Array]:
    """F(v*, T0) of one replay alone and its standard deviation, (N,) each [N·m].

    state : after the replay; its temperature law brings the replay to T0. observation : of the replay, with NaN in `log_torque` where
    nothing was learned; the torque is then NaN. The standard deviation contains the uncertainty within the replay, the noise between
    replays, and that of the law over the way to T0. Without a temperature it contains everything that temperature may have changed.
    """
    joints, T0 = state.filter_state, state.reference_temperature_c
    sensed = np.isfinite(observation.temperature_c)
    T = np.where(sensed, observation.temperature_c, T0)
    warming = np.where(np.isfinite(observation.warming_k_per_min), observation.warming_k_per_min, 0.0)
    here = joints.row(T - joints.origin_c, warming, state.slot)
    way = here - joints.row(T0 - joints.origin_c, np.zeros(state.joints), state.slot)  # (N, S): level, wear and noise cancel
    assert not way[:, NOISE].any()
    y = observation.log_torque - np.einsum("ja,ja->j", way, joints.mean)
    noise = joints.noise_var(state.joints_per_arm, settings)
    var = observation.variance + settings.between_floor**2 + noise + np.where(sensed, 0.0, joints.missed_var(settings))
    var = var + np.einsum("ja,jab,jb->j", way, joints.cov, way) + (settings.uneven_share * joints.mean[:, LAG] * saturating(warming)) ** 2
    torque: Array = np.exp(y)
    return torque, torque * np.sqrt(np.maximum(var, 0.0))
