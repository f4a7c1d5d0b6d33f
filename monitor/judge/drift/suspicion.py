"""Which joints are suspected of wear by ordinary work: a change that is likelier than chance, and not yet sure.

Work is observed daily and replays are rare, and what work shows may be a change of the work. So replays are asked for while a change is
suspected, and not only once work alone has found it: they confirm it, or end the suspicion.
"""

import numpy as np

from monitor.judge.drift.filter_state import FilterState
from monitor.judge.drift.settings import DriftSettings
from monitor.judge.drift.update.change_detection import likelihood_ratios

SUSPICIOUS = 0.4  # of the likelihood ratio from which a change is found: 3.1 σ of 4.85. In healthy arms it asks for 20 replays a year


def suspected_rise(state: FilterState, settings: DriftSettings) -> np.ndarray:
    """(N,) whether a rise of friction is suspected after an observation, by the generalised likelihood ratio of `change_detection`."""
    enough = (state.ages >= settings.gate_run - 1) & (state.ages <= (state.replays - settings.baseline_replays)[:, None])
    expected = state.glr_informations * state.chance.of_starts()
    rises = np.maximum(state.glr_scores, 0.0)
    _, relative = likelihood_ratios(rises, expected, state.glr_informations, state.ages, enough, settings)
    suspected: np.ndarray = np.max(relative, axis=(1, 2)) > SUSPICIOUS
    return suspected
