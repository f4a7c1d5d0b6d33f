"""Changes that may have begun and are not detected yet: they belong to the mean and uncertainty that a person reads.

The filter assumes that nothing changed until one change explains its innovations far better than chance does. Until then, its standard
deviation is that of a healthy joint. Here every candidate of the change bank is weighed by its likelihood and by how often joints begin to
wear. Usually the posterior says "no change"; before a detection it is partial. It raises no alert and clears none.
"""

import numpy as np

from monitor.judge.drift.change_detection import RATES_PER_STEP
from monitor.judge.drift.filter_state import KINDS, WINDOW, FilterState
from monitor.judge.drift.settings import DriftSettings
from monitor.recording import Array

DAYS_PER_YEAR = 365.0
LARGEST_LOG_RATIO = 50.0  # keeps the exponential finite: e^50 already means certainty
SCALES = ((0.9, 1.0), (0.1, 4.0))  # probability of a prior standard deviation of the change's size, and its factor on the usual one


def undetected_change(state: FilterState, H: Array, settings: DriftSettings) -> tuple[Array, Array]:
    """Mean and variance, (N,) each, that undetected changes add to H·x; H is (N, S).

    A mixture of "nothing" and every candidate change. The likelihood ratio of a candidate is integrated over its size, a priori Gaussian
    with mean 0 and standard deviation τ: exp(½·score²/precision)/(τ·√precision). To be called after a replay; 0 right after a detection.
    """
    N = state.joints
    usual = np.repeat([settings.unseen_step_std, settings.unseen_pace_std_per_day], WINDOW)  # (M,)
    kind = np.repeat([1.0, RATES_PER_STEP], WINDOW) / (1.0 + RATES_PER_STEP)
    # a candidate stands for every start up to the next older one
    span = np.tile(np.diff(state.ages, axis=1, append=state.ages[:, -1:] + 1.0), KINDS) * state.interval_days[:, None]  # (N, M) [d]
    begins = settings.onsets_per_year / DAYS_PER_YEAR * kind * span
    glr_score, information = state.glr_scores.reshape(N, -1), state.glr_informations.reshape(N, -1)
    effect = np.einsum("na,nkwa->nkw", H, state.responses).reshape(N, -1)  # (N, M) of a unit change
    odds, first, second = np.zeros(N), np.zeros(N), np.zeros(N)
    for share, times in SCALES:
        precision = information + (times * usual) ** -2.0
        size = glr_score / precision
        log_ratio = 0.5 * glr_score * size - np.log(times * usual * np.sqrt(precision))
        weight = share * begins * np.exp(np.minimum(log_ratio, LARGEST_LOG_RATIO))
        odds += weight.sum(axis=1)
        first += np.sum(weight * size * effect, axis=1)
        second += np.sum(weight * (1.0 / precision + size**2) * effect**2, axis=1)
    mean = first / (1.0 + odds)  # with the remaining probability nothing happened
    return mean, np.maximum(second / (1.0 + odds) - mean**2, 0.0)
