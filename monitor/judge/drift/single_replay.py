"""What a single replay says of friction by itself, so that it can be shown beside what the filter makes of all of them."""

import numpy as np

from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import LAG, NOISE, SLOPE
from monitor.judge.drift.observation import DriftSettings, Observation
from monitor.recording import Array


def single_torque_nm(belief: Belief, seen: Observation, settings: DriftSettings) -> tuple[Array, Array]:
    """F(v*) of the belief's last replay alone, brought to T0 by the temperature law held after it, and its std, (J,) each [N·m].

    seen : of that replay. NaN where nothing was learnt of the joint's friction from it. The std holds the doubt within the replay, what
    one replay differs from the next, and the law's doubt over the way to T0; without a temperature, all that temperature may have done.
    """
    state, slot, J = belief.filter_state, belief.slot, belief.joints
    sensed = np.isfinite(seen.temperature_c)
    T = np.where(sensed, seen.temperature_c, belief.reference_temperature_c)
    warming = np.where(np.isfinite(seen.warming_k_per_min), seen.warming_k_per_min, 0.0)
    here = state.row(T - state.origin_c, warming, slot)
    way = here - state.row(belief.reference_temperature_c - state.origin_c, np.zeros(J), slot)  # (J, S): level, wear, noise cancel
    assert not way[:, NOISE].any()
    y = belief.last_log_torque - np.einsum("ja,ja->j", way, state.mean)  # NaN where unseen or contradicted
    blind = (state.mean[:, SLOPE] ** 2 + state.cov[:, SLOPE, SLOPE]) * settings.unknown_temperature_std_k**2
    var = seen.variance + settings.between_floor**2 + state.noise_var(J, settings) + np.where(sensed, 0.0, blind)
    var = var + np.einsum("ja,jab,jb->j", way, state.cov, way) + (settings.uneven_share * state.mean[:, LAG] * warming) ** 2
    torque: Array = np.exp(y)
    return torque, torque * np.sqrt(np.maximum(var, 0.0))
