"""The causes of a joint's change of friction: temperature, payload, wear, and the noise of one replay."""

import math

import numpy as np

from monitor.judge.alerts.health import Attribution
from monitor.judge.belief import Belief
from monitor.judge.drift.filter_state import LEVELS

KNOWN_VAR = 1.0  # [log²] a level that any replay has taught is far better known, one of no replay far worse


def attribute_changes(belief: Belief) -> tuple[Attribution | None, ...]:
    """The causes of the change of every joint since its first replays; None before there is a change to attribute."""
    filter_state = belief.filter_state
    whole = belief.last_log_torque - belief.first_log_torque  # (J,) as all below
    T0 = np.where(np.isfinite(belief.first_temperature_c), belief.first_temperature_c, belief.reference_temperature_c)
    T = np.where(np.isfinite(belief.temperature_c), belief.temperature_c, T0)
    slot = belief.contexts[-1].slot or 0
    now, first = np.full(belief.joints, slot), np.array([_first_slot(belief, j, slot) for j in range(belief.joints)])
    at_first, at_now, at_last = (filter_state.steady_mean(t, slot) for t, slot in ((T0, first), (T0, now), (T, now)))
    temperature, payload, wear = at_last - at_now, at_now - at_first, filter_state.change
    parts = np.stack([whole, temperature, payload, wear, whole - temperature - payload - wear], axis=1)  # (J, 5)
    return tuple(Attribution(*of_joint) if math.isfinite(of_joint[0]) else None for of_joint in parts.tolist())


def _first_slot(belief: Belief, j: int, slot: int) -> int:
    """The slot of the oldest baseline that is still kept and known of joint j; that in force where none is.

    A level that is not known, as after a replacement, is no reference: the difference to it would be the logarithm of a torque.
    """
    state = belief.filter_state
    known = [
        context
        for context in belief.contexts
        if context.slot is not None and state.cov[j, LEVELS + context.slot, LEVELS + context.slot] < KNOWN_VAR
    ]
    return (min(known, key=lambda context: context.opened_at_unix_s).slot or 0) if known else slot
