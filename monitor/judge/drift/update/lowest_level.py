"""Wear counts from the lowest level of friction that was surely held: a fall that is sure is moved out of wear into the levels.

The map is exact: with a the levels and w the wear, a + w and every later observation stay as they are. Nothing is plugged in, so the lowest
of many noisy estimates is not taken for the level: the level's uncertainty stays with it, and the replays that follow teach it.
"""

from dataclasses import replace

import numpy as np

from monitor.judge.drift.filter_state import LEVELS, PRODUCTION_LEVEL, RATE, STATES, WEAR, FilterState
from monitor.judge.drift.kalman import symmetric
from monitor.judge.drift.noise.chance import forget_chance
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.slots import SLOTS
from monitor.recording import Array

SURE = 2.0  # [σ] by which wear must lie below 0 to be a fall
LEAST_FALL = 0.01  # [log] smallest fall that is moved: less is no reason to move the level, as a rise of less is no advisory
SUSPECTED = 2.0  # [σ] of evidence for a rise that is not detected yet: until it is decided, the level is not known to be held
RUN_IN_DAYS = 180.0  # [d] a slow fall of the first half year is running-in: seals and grease settle in weeks to months
AT_ONCE, AT_ONCE_DAYS = 0.05, 10.0  # [log], [d] a fall of so much in so few days is none: something was done to the joint


def count_from_lowest(state: FilterState, days: Array, settings: DriftSettings, awaiting_proof: np.ndarray | None = None) -> FilterState:
    """The state after a replay, with wear counted from the lowest level held. days : (N,) since the replay before.

    awaiting_proof : (N,) joints with maintenance that is not judged yet: a fall of theirs is not known to be held; None: no joint.
    """
    reference = replace(state.counted_from, held_days=state.counted_from.held_days + days)
    state = replace(state, counted_from=reference)
    fallen = state.wear < -np.maximum(SURE * state.wear_std, LEAST_FALL)
    fallen &= state.learnt_from
    if awaiting_proof is not None:
        fallen &= ~awaiting_proof
    if fallen.any():  # on few days
        fallen &= ~_rise_suspected(state)
    if not fallen.any():
        return state
    moved = np.where(fallen, state.wear, 0.0)
    slow = fallen & running_in(state, moved, state.agreeing)
    reference = replace(
        reference,
        fallen=reference.fallen + np.where(slow, 0.0, moved),
        run_in=reference.run_in + np.where(slow, moved, 0.0),
        fallen_var=reference.fallen_var + np.where(fallen, state.wear_std**2, 0.0),
        held_days=np.where(fallen, 0.0, reference.held_days),
    )
    return replace(begin_here(state, fallen, settings.rate_std_per_day), counted_from=reference)


def running_in(state: FilterState, fall: Array, agreeing: Array) -> np.ndarray:
    """(N,) whether a change by `fall` (N,) is running-in: downwards, slow, and in the joint's first months.

    agreeing : (N,) replays that it took; 1 where it was detected earlier.
    """
    at_once = (fall <= -AT_ONCE) & (agreeing * state.interval_days <= AT_ONCE_DAYS) & (agreeing > 1.0)
    slow: np.ndarray = (fall < 0) & may_run_in(state) & ~at_once
    return slow


def may_run_in(state: FilterState) -> np.ndarray:
    """(N,) whether the joint is in its first months."""
    young: np.ndarray = state.replays * state.interval_days <= RUN_IN_DAYS
    return young


def begin_here(state: FilterState, which: np.ndarray, rate_std_per_day: float) -> FilterState:
    """The state with w = 0 and the wear rate of a healthy joint in the joints of `which` (N,).

    What w was is in the levels of every slot, with its covariance. The rate at which friction fell is not that of wear to come, and its
    uncertainty would make the next rise uncertain. If friction falls on, that is detected again. So the change bank is empty.
    """
    n = np.flatnonzero(which)
    S = state.mean.shape[1]
    M = np.tile(np.eye(S), (len(n), 1, 1))
    M[:, LEVELS : LEVELS + SLOTS, WEAR] = 1.0
    if S > STATES:
        M[:, PRODUCTION_LEVEL, WEAR] = 1.0
    M[:, WEAR, WEAR] = M[:, RATE, RATE] = 0.0
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[n] = np.einsum("nab,nb->na", M, mean[n])
    cov[n] = symmetric(M @ cov[n] @ np.swapaxes(M, 1, 2))
    cov[n, RATE, RATE] = rate_std_per_day**2

    def emptied(array: Array) -> Array:
        empty = array.copy()
        empty[n] = 0.0
        return empty

    return replace(
        state,
        mean=mean,
        cov=cov,
        stepped=emptied(state.stepped),
        responses=emptied(state.responses),
        glr_scores=emptied(state.glr_scores),
        raw_glr_scores=emptied(state.raw_glr_scores),
        glr_informations=emptied(state.glr_informations),
        chance=forget_chance(state.chance, which),
        history=emptied(state.history),  # of another level: wear to come has a path of its own
    )


def _rise_suspected(state: FilterState) -> np.ndarray:
    """(N,) whether a change that is not detected yet speaks for a rise."""
    z = state.glr_scores / np.sqrt(np.maximum(state.glr_informations, 1e-12))
    suspected: np.ndarray = np.max(z, axis=(1, 2)) > SUSPECTED
    return suspected
