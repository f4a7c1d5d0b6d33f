"""Which joints are suspected of wear: a change that is likelier than chance, and not yet sure.

Production is observed daily and replays are rare, and what production shows may be a change of the production. So replays are asked for
while a change is suspected, and not only once production alone has found it: they confirm it, or end the suspicion.

Of a joint that production never moves, rare replays alone tell. One of them proves nothing, and the next one may be a month away. So a
replay that is doubtful asks for another one soon: nearly all doubts of healthy joints end with it, and a step is followed daily from then
on.
"""

import numpy as np

from monitor.judge.drift.filter_state import FilterState
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.update.change_detection import joint_noise, likelihood_ratios

PRODUCTION_TELLS_DAYS = 7.0  # [d] since production told of a joint: from then on replays alone tell of it
DOUBT_SIGMA = 2.0  # of a step since one of the last replays
DOUBT_REPLAYS = 8  # so many of them: an older step is what `suspected_rise` is for
SUSPICIOUS = 0.33  # of the likelihood ratio from which replays find a change: 2.8 σ of 4.95. In healthy arms it asks for 34 replays a year


def suspected_rise(state: FilterState, settings: DriftSettings) -> np.ndarray:
    """(N,) whether a rise of friction is suspected after an observation, by the generalised likelihood ratio of `change_detection`."""
    enough = (state.ages >= settings.gate_run - 1) & (state.ages <= (state.replays - settings.baseline_replays)[:, None])
    information = state.glr_informations
    expected = information * state.chance.of_starts()
    rises = np.maximum(state.glr_scores, 0.0)
    noise = joint_noise(state, np.zeros(state.joints), settings)  # where production is observed its variance has no effect
    # what only asks for a replay may be production's noise of some days: `of_production`
    _, relative = likelihood_ratios(
        rises, expected, information, state.ages, enough, settings, noise, beside_production=True, of_production=0.0
    )
    suspected: np.ndarray = np.max(relative, axis=(1, 2)) > SUSPICIOUS
    return suspected


def doubted_rise(state: FilterState) -> np.ndarray:
    """(N,) whether the last replays make a step likely in a joint of which replays alone tell. An outlier counts in full."""
    alone = np.ones(state.joints, dtype=bool)
    if state.sources is not None:
        alone = (state.sources.other_number == 0) | (state.sources.other_since_days > PRODUCTION_TELLS_DAYS)
    expected = state.glr_informations[:, 0] * state.chance.of_starts()[:, 0]  # (N, W)
    young = (state.ages < DOUBT_REPLAYS) & (expected > 0)
    sigmas = np.where(young, state.raw_glr_scores[:, 0] / np.sqrt(np.where(young, expected, 1.0)), 0.0)
    doubted: np.ndarray = alone & (np.max(sigmas, axis=1) > DOUBT_SIGMA)
    return doubted
