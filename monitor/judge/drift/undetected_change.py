"""Changes that may have begun and are not detected yet: they belong to the mean and uncertainty that a person reads.

The filter assumes that nothing changed until one change explains its innovations far better than chance does. Until then, its standard
deviation is that of a joint that is known to be healthy, and a joint that has worn slowly for months is far outside of it. Nobody knows
that a joint is healthy. So the mean and uncertainty here are those of a joint that began to wear on a day nobody knows: every candidate of
the change bank is weighed by its likelihood, and none of the probability is kept for "nothing happened". That holds for a joint that
wears and for one that does not, whose wear is then estimated at about zero, within its ±. It raises no alert and clears none.
"""

from typing import NamedTuple

import numpy as np

from monitor.judge.drift.filter_state import KINDS, WEAR, WINDOW, FilterState
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.update.change_detection import RATES_PER_STEP, joint_noise, thresholds
from monitor.recording import Array

FRESH_DAYS = 10.0  # [d] a step of so many days ago is what `unseen_step` is about: replays since say something of it, and not yet enough
# Of the mixture's variance, so much is published. In full it is that of joints that did change, and healthy joints' 90 % intervals hold the
# truth in up to 97 %; weight for "nothing happened" raises that further and holds less of slow wear. This share is a compromise by trial:
# healthy joints' intervals hold 88–95 %, and those of 10 % a year 73–90 % until it is detected.
PUBLISHED_SHARE = 0.55
NOTHING_KNOWN = 1.0  # [log] where even a larger step may be unseen, the level itself is not known yet
FOUND_SIGMAS = 1.28  # a step so many standard deviations above the threshold is detected in nine of ten


class UnseenStep(NamedTuple):
    """The largest step that may still be unseen some days after it came, (N,) each; NaN where nothing is known of so short a time."""

    log_rise: Array  # a larger one is detected by then in nine of ten
    days: Array  # since the step: at least `FRESH_DAYS`, or as many as the fewest replays of a detection take


def undetected_change(state: FilterState, H: Array, settings: DriftSettings) -> tuple[Array, Array]:
    """Mean and variance, (N,) each, that undetected changes add to H·x; H is (N, S). With `onsets_per_year` 0 there are none.

    A mixture of every candidate change. The likelihood ratio of a candidate is integrated over its size, a priori Gaussian with mean 0 and
    standard deviation τ: exp(½·score²/precision)/(τ·√precision). Candidates from before the first replay, or from before a detection, have
    no effect and no evidence: they stand for "nothing happened since". To be called after a replay; 0 right after a detection.
    """
    N = state.joints
    if settings.onsets_per_year == 0.0:
        return np.zeros(N), np.zeros(N)
    usual = np.repeat([settings.unseen_step_std, settings.unseen_pace_std_per_day], WINDOW)  # (M,)
    kind = np.repeat([1.0, RATES_PER_STEP], WINDOW)
    # a candidate stands for every start up to the next older one
    span = np.tile(np.diff(state.ages, axis=1, append=state.ages[:, -1:] + 1.0), KINDS)  # (N, M) [replays]
    inflation = state.chance.of_starts().reshape(N, -1)
    glr_score, information = state.glr_scores.reshape(N, -1) / inflation, state.glr_informations.reshape(N, -1) / inflation
    effect = np.einsum("na,nkwa->nkw", H, state.responses).reshape(N, -1)  # (N, M) of a unit change
    precision = information + usual**-2.0
    size = glr_score / precision
    evidence = 0.5 * glr_score * size - np.log(usual * np.sqrt(precision))
    weight = kind * span * np.exp(evidence - evidence.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    moved = size * effect
    mean = np.sum(weight * moved, axis=1)
    var = np.sum(weight * (effect**2 / precision + (moved - mean[:, None]) ** 2), axis=1)
    # what the filter allows wear itself is in both
    return mean, PUBLISHED_SHARE * np.maximum(var - state.cov[:, WEAR, WEAR] * H[:, WEAR] ** 2, 0.0)


def unseen_step(state: FilterState, joints_per_arm: int, settings: DriftSettings) -> UnseenStep:
    """The largest step of the last days that may be unseen, by the threshold of detection at its age and the joint's own noise.

    The evidence of a step of size ν that came n replays ago has mean ν·√information and standard deviation 1, and the bank has the
    information of each age as this joint's noise and the uncertainty of its level left it.
    """
    N = state.joints
    days = state.ages * state.interval_days[:, None]  # (N, W)
    old_enough = (days > FRESH_DAYS - 0.5) & (state.ages >= settings.gate_run - 1)
    first = np.argmax(old_enough, axis=1)  # ages are ascending
    row = np.arange(N)
    information = state.glr_informations[row, 0, first] / state.chance.of_starts()[row, 0, first]
    noise = joint_noise(state, state.noise_var(joints_per_arm, settings), settings)
    needed = thresholds(state.ages, settings, noise, beside_production=state.sources is not None)
    threshold = np.sqrt(needed[row, 0, first])
    log_rise = (threshold + FOUND_SIGMAS) / np.sqrt(np.maximum(information, 1e-12))
    known = old_enough.any(axis=1) & (log_rise <= NOTHING_KNOWN)
    return UnseenStep(np.where(known, log_rise, np.nan), np.where(known, days[row, first], np.nan))
