"""Maintenance of joints, belief → belief: when it is declared, and when the replays after it have shown what it did."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np

from monitor.judge.belief import Belief
from monitor.judge.drift.maintenance import NEW_JOINT, NEW_REFERENCE, REPLACED, UNCHANGED, Maintenance
from monitor.judge.drift.step import new_joints
from monitor.judge.friction.beside import model_beside
from monitor.judge.friction.step import FrictionState, count_from_here, has_not_moved, may_have_moved
from monitor.judge.settings import AssessSettings


def begin_maintenance(
    belief: Belief, maintenance: tuple[Maintenance, ...], settings: AssessSettings
) -> tuple[Belief, tuple[Maintenance, ...]]:
    """The belief with this maintenance, before the next replay, and the maintenance as it stands in it.

    The wear of a joint that is the same one becomes uncertain. Maintenance that was still waiting on the same joint is superseded.
    """
    if not maintenance:
        return belief, ()
    begun = []
    for act in maintenance:
        j = act.joint - 1
        wear, change = float(belief.wear[j]), float(belief.change[j])
        earlier = next((one for one in belief.maintenance if one.joint == act.joint and one.waiting), None)
        if earlier is not None:  # wear is uncertain already: what it was before both counts
            wear, change = earlier.wear_before, earlier.change_before
        outcome = NEW_JOINT if act.kind == REPLACED else None
        begun.append(act._replace(wear_before=wear, change_before=change, outcome=outcome))
    joints, new = {act.joint for act in begun}, {act.joint for act in begun if act.outcome == NEW_JOINT}
    kept = tuple(act for act in belief.maintenance if act.joint not in new and not (act.joint in joints and act.waiting))
    moved = _mask(belief, [act for act in begun if act.waiting])
    n = belief.friction.channels_of(moved)
    after = replace(belief, maintenance=(*kept, *begun))
    if n.size:
        after = _with_states(after, lambda state, name: may_have_moved(state, n, settings.friction if name is None else model_beside(name)))
    return after, tuple(begun)


def with_new_joints(belief: Belief, maintenance: tuple[Maintenance, ...], settings: AssessSettings) -> Belief:
    """The belief where the joints that were replaced are other ones at once, and not only with the next replay."""
    new = _mask(belief, [act for act in maintenance if act.kind == REPLACED])
    if not new.any():
        return belief
    state = new_joints(belief.drift_state, new, settings)
    return replace(belief.with_drift_state(state), last_log_torque=np.where(new, np.nan, belief.last_log_torque))


def with_outcomes(belief: Belief, settled: tuple[Maintenance, ...]) -> Belief:
    """The belief after a replay that judged this maintenance: where friction moved, wear counts from the level after it."""
    fresh = [act for act in settled if act.outcome == NEW_REFERENCE]
    which = _mask(belief, fresh)
    if which.any():
        n = belief.friction.channels_of(which)
        belief = replace(
            _with_states(belief, lambda state, _: count_from_here(state, n)),
            first_log_torque=np.where(which, belief.last_log_torque, belief.first_log_torque),
            first_temperature_c=np.where(which, belief.temperature_c, belief.first_temperature_c),
        )
    unmoved = _mask(belief, [act for act in settled if act.outcome == UNCHANGED and not act.wear_before])
    if unmoved.any():
        n = belief.friction.channels_of(unmoved)
        belief = _with_states(belief, lambda state, _: has_not_moved(state, n[~state.risen[n]]))
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


def _with_states(belief: Belief, change: Callable[[FrictionState, str | None], None]) -> Belief:
    """The belief with copies of its states that `change` has changed in place; it takes the name of a series, None of friction itself."""
    friction, beside = deepcopy(belief.friction), {name: deepcopy(state) for name, state in belief.beside.items()}
    change(friction, None)
    for name, state in beside.items():
        change(state, name)
    return replace(belief, friction=friction, beside=beside)
