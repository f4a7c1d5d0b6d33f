"""The innovation of one replay: how far it is from the filter's prediction of it, and whether it is an outlier."""

from typing import NamedTuple

import numpy as np

from monitor.judge.drift.filter_state import LAG, NOISE, FilterState, saturating
from monitor.judge.drift.observation import Observation
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array

BLIND_ALIKE = 30.0  # successive replays without a temperature, which all miss the same season and weather: together they say what one does
SETTLING_SHARE = 2.0  # the level's variance over that of noise, above which an innovation is no evidence of noise or of changes


class Innovation(NamedTuple):
    """One replay against its prediction, (N,) each unless a comment says otherwise."""

    resolved: np.ndarray  # whether the replay has a friction torque of the joint; where not, the other fields mean nothing
    sensed: np.ndarray  # whether its temperature is known
    row: Array  # (N, S) H
    log_torque: Array  # y
    within_var: Array  # R: variance of y within the replay, with what temperature leaves uncertain
    value: Array  # ν = y − H·x
    state_cov: Array  # (N, S) P·Hᵀ
    var: Array  # S = H·P·Hᵀ + R
    normalised: Array  # ν/√S
    level_var: Array  # variance of the predicted level, without the noise
    shared: Array  # covariance of the predicted level and the noise
    settling: np.ndarray  # whether the level is so uncertain that ν is no evidence of noise or of changes


class Noise(NamedTuple):
    """What lasts from one replay to the next, (N,) each."""

    rho: Array  # its correlation over the usual interval
    var: Array


class Gate(NamedTuple):
    """Which joints' innovations are outliers, (N,) each."""

    gated: np.ndarray  # |ν| exceeds `gate_sigma` of its standard deviation
    run: Array  # signed count of gated replays in a row on one side, this one included
    in_a_row: np.ndarray  # as many of them as a step needs

    @property
    def run_before(self) -> Array:
        """(N,) number of outliers in the run before this replay."""
        before: Array = np.maximum(np.abs(self.run) - 1.0, 0.0)
        return before


def innovate(state: FilterState, observation: Observation, slot: Array, noise_var: Array, settings: DriftSettings) -> Innovation:
    """The innovation of a replay, by the state predicted to its time. slot : (N,) of the replay's context; noise_var : (N,) the state's."""
    resolved = np.isfinite(observation.log_torque)
    sensed = np.isfinite(observation.temperature_c)
    t = np.where(sensed, observation.temperature_c - state.origin_c, 0.0)
    warming = np.where(np.isfinite(observation.warming_k_per_min), observation.warming_k_per_min, 0.0)
    # a joint that warms fast has no single temperature: the lag that the filter estimates is wrong by a third at most
    uneven = (settings.uneven_share * state.mean[:, LAG] * saturating(warming)) ** 2
    y = np.where(resolved, observation.log_torque, 0.0)

    H = state.row(t, warming, slot)
    nu = y - np.einsum("na,na->n", H, state.mean)
    PH = np.einsum("nab,nb->na", state.cov, H)
    explained = np.einsum("na,na->n", H, PH)
    shared = PH[:, NOISE] - state.cov[:, NOISE, NOISE]
    level_var = explained - 2.0 * shared - state.cov[:, NOISE, NOISE]
    missed = np.where(sensed, 0.0, blind_var(state, level_var, settings))
    within = np.where(resolved, observation.variance + settings.between_floor**2 + uneven + missed, 1.0)
    S = explained + within
    quiet = noise_var + within
    return Innovation(
        resolved=resolved,
        sensed=sensed,
        row=H,
        log_torque=y,
        within_var=within,
        value=nu,
        state_cov=PH,
        var=S,
        normalised=nu / np.sqrt(S),
        level_var=level_var,
        shared=shared,
        settling=level_var > SETTLING_SHARE * quiet,
    )


def blind_var(state: FilterState, level_var: Array, settings: DriftSettings) -> Array:
    """(N,) variance of log F of a replay whose temperature is unknown.

    The replays of a season miss the same temperature, so their errors do not average out. The first one of a joint that is hardly known
    says what it can; where the level is better known than that, `BLIND_ALIKE` of them say what one does.
    """
    one = state.missed_var(settings)
    new = 1.0 - one / np.maximum(level_var, 1e-12)  # so that the level is as uncertain afterwards as one such replay leaves it
    return one / np.clip(new, 1.0 / BLIND_ALIKE, 1.0)


def gate_outliers(state: FilterState, innovation: Innovation, settings: DriftSettings) -> Gate:
    """Which innovations are outliers, and how many in a row there are on the same side."""
    z, resolved = innovation.normalised, innovation.resolved
    gated = np.abs(z) > settings.gate_sigma
    side = np.where(z >= 0, 1.0, -1.0)
    longer = np.where(state.gate_run * side > 0, state.gate_run + side, side)
    run = np.where(gated & resolved, longer, np.where(resolved, 0.0, state.gate_run))
    return Gate(gated, run, gated & (np.abs(run) >= settings.gate_run))
