"""What may have begun to wear that the evidence does not show yet: it belongs into the ± that a person reads.

The filter believes that nothing happened until one change explains its surprises far better than chance. Until then its own standard
deviation is that of a joint that is well. Here the changes that are looked for anyway are weighed as they are, each with how often
joints begin to wear: mostly nothing; now and then, before an alert, half a suspicion. Nothing is raised by it, and no alert cleared.
"""

import numpy as np

from monitor.judge.evidence import DriftSettings
from monitor.judge.track import WINDOW, Track
from monitor.recording import Array

PACES_OF_ALL = 0.75  # of changes, as `follow` has it: joints wear more often than they jump


def unseen(track: Track, H: Array, settings: DriftSettings) -> tuple[Array, Array]:
    """What a change not yet believed adds to H·x: its mean and its variance, (N,) each; H is (N, S).

    A mixture over "nothing" and every change of the bank, with its likelihood ratio integrated over its size, a priori normal about 0:
    exp(½·score²/precision)/(τ·√precision). To be asked after a replay; 0 right after a change was found.
    """
    prior_std = np.repeat([settings.unseen_step_std, settings.unseen_pace_std_per_day], WINDOW)  # (M,)
    kind = np.repeat([1.0 - PACES_OF_ALL, PACES_OF_ALL], WINDOW)
    # one candidate stands for all starts up to the next older one
    span = np.tile(np.diff(track.ages, axis=1, append=track.ages[:, -1:] + 1.0), 2) * track.cadence_days[:, None]  # (N, M) [d]
    scores, informations = (part.reshape(track.joints, -1) for part in (track.scores, track.informations))
    precision = informations + prior_std**-2
    size, log_ratio = scores / precision, 0.5 * scores**2 / precision - np.log(prior_std * np.sqrt(precision))
    odds = settings.onsets_per_year / 365.0 * kind * span * np.exp(np.minimum(log_ratio, 50.0))
    weight = odds / (1.0 + odds.sum(axis=1, keepdims=True))  # of what is left, nothing happened
    effect = np.einsum("na,nkwa->nkw", H, track.responses).reshape(track.joints, -1)  # (N, M) of a unit change
    mean = np.sum(weight * size * effect, axis=1)
    square = np.sum(weight * (1.0 / precision + size**2) * effect**2, axis=1)
    return mean, np.maximum(square - mean**2, 0.0)
