"""Maintenance of joints, belief → belief: when it is declared, and when the replays after it have shown what it did."""

from dataclasses import replace

import numpy as np

from monitor.judge.belief import Belief
from monitor.judge.drift.channels import restart
from monitor.judge.drift.maintenance import NEW_JOINT, NEW_REFERENCE, REPLACED, Maintenance, may_have_moved, new_reference
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.step import new_joints
from monitor.judge.temperature.laws import TemperatureSettings


def begin_maintenance(belief: Belief, maintenance: tuple[Maintenance, ...]) -> tuple[Belief, tuple[Maintenance, ...]]:
    """The belief with this maintenance, before the next replay, and the maintenance as it stands in it.

    The wear of a joint that is the same one becomes uncertain. Maintenance that was still waiting on the same joint is superseded.
    """
    if not maintenance:
        return belief, ()
    begun = []
    for act in maintenance:
        j = act.joint - 1
        wear, change = float(belief.wear[j]), float(belief.filter_state.change[j])
        earlier = next((one for one in belief.maintenance if one.joint == act.joint and one.waiting), None)
        if earlier is not None:  # wear is uncertain already: what it was before both counts
            wear, change = earlier.wear_before, earlier.change_before
        outcome = NEW_JOINT if act.kind == REPLACED else None
        begun.append(act._replace(wear_before=wear, change_before=change, outcome=outcome))
    joints, new = {act.joint for act in begun}, {act.joint for act in begun if act.outcome == NEW_JOINT}
    kept = tuple(act for act in belief.maintenance if act.joint not in new and not (act.joint in joints and act.waiting))
    moved = _mask(belief, [act for act in begun if act.waiting])
    return replace(belief, maintenance=(*kept, *begun), filter_state=may_have_moved(belief.filter_state, moved)), tuple(begun)


def with_new_joints(belief: Belief, maintenance: tuple[Maintenance, ...], drift: DriftSettings, temperature: TemperatureSettings) -> Belief:
    """The belief where the joints that were replaced are other ones at once, and not only with the next replay."""
    new = _mask(belief, [act for act in maintenance if act.kind == REPLACED])
    if not new.any():
        return belief
    state = new_joints(belief.drift_state, new, drift, temperature)
    return replace(belief.with_drift_state(state), last_log_torque=np.where(new, np.nan, belief.last_log_torque))


def with_outcomes(belief: Belief, settled: tuple[Maintenance, ...], drift: DriftSettings) -> Belief:
    """The belief after a replay that judged this maintenance: where friction moved, wear counts from the level after it."""
    fresh = [act for act in settled if act.outcome == NEW_REFERENCE]
    which = _mask(belief, fresh)
    if which.any():
        replays = np.zeros(belief.joints)
        for act in fresh:
            replays[act.joint - 1] = act.replays
        state = new_reference(belief.filter_state, which, replays, drift.rate_std_per_day)
        if state.channels is not None:
            nothing = np.zeros(belief.joints, dtype=bool)
            state = replace(state, channels=restart(state.channels, belief.slot, nothing, which))
        belief = replace(
            belief,
            filter_state=state,
            first_log_torque=np.where(which, belief.last_log_torque, belief.first_log_torque),
            first_temperature_c=np.where(which, belief.temperature_c, belief.first_temperature_c),
        )
    # of each joint stays what waits, and the last from which its friction counts
    kept = []
    for act in belief.maintenance:
        later = [one for one in belief.maintenance if one.joint == act.joint and one.outcome in (NEW_JOINT, NEW_REFERENCE)]
        if act.waiting or (later and act is later[-1]):
            kept.append(act)
    return replace(belief, maintenance=tuple(kept))


def _mask(belief: Belief, maintenance: list[Maintenance]) -> np.ndarray:
    """(J,) the joints of this maintenance."""
    return np.isin(np.arange(1, belief.joints + 1), [act.joint for act in maintenance])
