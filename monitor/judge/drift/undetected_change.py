"""What may have begun to wear that the evidence does not show yet: it belongs into the ± that a person reads.

The filter believes that nothing happened until one change explains its surprises far better than chance. Until then its own standard
deviation is that of a joint that is well. Here the changes that are looked for anyway are weighed as they are, each with how often
joints begin to wear: mostly nothing; now and then, before an alert, half a suspicion. Nothing is raised by it, and no alert cleared.
"""

import numpy as np

from monitor.judge.drift.change_detection import RATES_PER_STEP
from monitor.judge.drift.filter_state import KINDS, WINDOW, FilterState
from monitor.judge.drift.observation import DriftSettings
from monitor.recording import Array

SCALES = ((0.9, 1.0), (0.1, 4.0))  # of how large a change is: mostly as set, one in ten from a prior four times as wide


def undetected_change(state: FilterState, H: Array, settings: DriftSettings) -> tuple[Array, Array]:
    """What a change not yet believed adds to H·x: its mean and its variance, (N,) each; H is (N, S).

    A mixture over "nothing" and every change of the bank, with its likelihood ratio integrated over its size, a priori normal about 0 with
    τ, or now and then a wider one: exp(½·score²/precision)/(τ·√precision). To be asked after a replay; 0 right after a change was found.
    """
    N = state.joints
    usual = np.repeat([settings.unseen_step_std, settings.unseen_pace_std_per_day], WINDOW)  # (M,)
    kind = np.repeat([1.0, RATES_PER_STEP], WINDOW) / (1.0 + RATES_PER_STEP)
    # one candidate stands for all starts up to the next older one
    span = np.tile(np.diff(state.ages, axis=1, append=state.ages[:, -1:] + 1.0), KINDS) * state.interval_days[:, None]  # (N, M) [d]
    begins = settings.onsets_per_year / 365.0 * kind * span
    scores, informations = state.glr_scores.reshape(N, -1), state.glr_informations.reshape(N, -1)
    effect = np.einsum("na,nkwa->nkw", H, state.responses).reshape(N, -1)  # (N, M) of a unit change
    odds, first, second = np.zeros(N), np.zeros(N), np.zeros(N)
    for share, times in SCALES:
        precision = informations + (times * usual) ** -2.0
        size = scores / precision
        log_ratio = 0.5 * scores * size - np.log(times * usual * np.sqrt(precision))
        weight = share * begins * np.exp(np.minimum(log_ratio, 50.0))
        odds += weight.sum(axis=1)
        first += np.sum(weight * size * effect, axis=1)
        second += np.sum(weight * (1.0 / precision + size**2) * effect**2, axis=1)
    mean = first / (1.0 + odds)  # of what is left, nothing happened
    return mean, np.maximum(second / (1.0 + odds) - mean**2, 0.0)
