"""The causes of a joint's change of friction: temperature, payload, wear, and the noise of one replay."""

import math

import numpy as np

from monitor.judge.alerts.health import Attribution
from monitor.judge.belief import Belief


def attribute_change(belief: Belief, j: int) -> Attribution | None:
    """The causes of the change of joint j (from 0) since its first replays; None before there is a change to attribute."""
    y0, y = belief.first_log_torque[j], belief.last_log_torque[j]
    if not (math.isfinite(y0) and math.isfinite(y)):
        return None
    filter_state, J = belief.filter_state, belief.joints
    T0 = belief.reference_temperature_c[j] if not math.isfinite(belief.first_temperature_c[j]) else belief.first_temperature_c[j]
    T = belief.temperature_c[j] if math.isfinite(belief.temperature_c[j]) else T0
    now, first = np.full(J, belief.contexts[-1].slot or 0), np.full(J, _first_slot(belief))
    at = [filter_state.reference(np.full(J, t), slot)[0][j] for t, slot in ((T0, first), (T0, now), (T, now))]
    temperature, payload, wear = float(at[2] - at[1]), float(at[1] - at[0]), float(belief.filter_state.change[j])
    whole = float(y - y0)
    return Attribution(whole=whole, temperature=temperature, payload=payload, wear=wear, rest=whole - temperature - payload - wear)


def _first_slot(belief: Belief) -> int:
    """The slot of the oldest baseline that is still kept."""
    kept = [context for context in belief.contexts if context.slot is not None]
    return min(kept, key=lambda context: context.opened_at_unix_s).slot or 0
