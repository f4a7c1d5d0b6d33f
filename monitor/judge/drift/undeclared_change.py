"""Does a recording contradict what was declared of it? Weights that changed without a word are a payload, a mounting or a gain.

The rigid parameters of every replay are compared with the mean of those before in the same context. Wear does not weigh anything:
a change of them is none, and while it lasts nothing is learnt of wear.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.judge.alerts.settings import HealthSettings
from monitor.judge.document import arrays, entry
from monitor.model.regressor import friction_columns
from monitor.model.robot import PER_JOINT
from monitor.recording import Array

FEWEST = 3  # replays before, or there is nothing to compare with
PRIOR_REPLAYS = 5.0  # how many replays the first guess of the scatter is worth
PRIOR_STD = 2.0  # of its own standard deviation a parameter differs from replay to replay, until that is known
MEMORY = 50.0  # replays
EXPLAINED = 0.6  # of the surprise, by a mass at the flange: then it is called a payload

MOUNTING, PAYLOAD, GAINS = "mounting_contradiction", "payload_contradiction", "gain_contradiction"  # what changed


class UndeclaredChange(NamedTuple):
    """Which condition, if any, and in words."""

    condition: str | None
    text: str


NO_UNDECLARED_CHANGE = UndeclaredChange(None, "")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MassEstimate:
    """The rigid base parameters in one context, (R,) each."""

    columns: Array  # of the regressor
    mean: Array
    var: Array  # between replays
    replays: int


def rigid_of(identification: Identification) -> np.ndarray:
    """(B,) which base parameters are rigid: neither friction nor rotor, and known."""
    joints = len(identification.coulomb_nm)
    others = np.concatenate([*friction_columns(joints), np.arange(joints) * PER_JOINT + PER_JOINT - 1])
    rigid: np.ndarray = ~np.isin(identification.columns, others)
    return rigid


def find_undeclared_change(identification: Identification, weights: MassEstimate | None, settings: HealthSettings) -> UndeclaredChange:
    """What of the recording contradicts its context. `weights` are those of the replays before in the same context."""
    for warning in identification.warnings:
        if warning.code == MOUNTING:
            return UndeclaredChange(MOUNTING, warning.text)
    rigid = rigid_of(identification)
    if weights is None or weights.replays < FEWEST or not np.array_equal(weights.columns, np.array(identification.columns)[rigid]):
        return NO_UNDECLARED_CHANGE
    var = np.diag(identification.covariance)[rigid] + weights.var * (1.0 + 1.0 / weights.replays)
    known = np.isfinite(var) & (var > 0)
    moved, std = (identification.values[rigid] - weights.mean)[known], np.sqrt(var[known])
    surprise = moved / std
    whole = float(surprise @ surprise)
    degrees = len(surprise)
    # a mass at the flange adds m, mx, my, mz to the last link
    last = PER_JOINT * (len(identification.coulomb_nm) - 1)
    X = identification.combination[rigid][known][:, last : last + 4] / std[:, None]
    load, *_ = np.linalg.lstsq(X, surprise, rcond=1e-9)
    left = surprise - X @ load
    explained = 1.0 - float(left @ left) / max(whole, 1e-300)
    found = whole - float(left @ left) > settings.contradiction_sigma**2
    if found and explained >= EXPLAINED and abs(load[0]) >= settings.contradiction_kg:
        return UndeclaredChange(
            PAYLOAD,
            f"the arm carries about {abs(load[0]):.1f} kg {'more' if load[0] > 0 else 'less'} than in the replays before, "
            "and nobody declared it",
        )
    if explained < EXPLAINED and whole > degrees * settings.contradiction_sigma**2:
        worst = int(np.argmax(np.abs(surprise)))
        name = np.array(identification.names)[rigid][known][worst]
        return UndeclaredChange(
            GAINS,
            f"weights differ from those of the replays before by {np.sqrt(whole / degrees):.0f} standard deviations ({name} most), "
            "and no mass at the flange explains it: drive gains or the arm itself were changed",
        )
    return NO_UNDECLARED_CHANGE


def update_mass_estimate(weights: MassEstimate | None, identification: Identification) -> MassEstimate:
    """The weights after one more replay of the same context."""
    rigid = rigid_of(identification)
    columns, values = np.array(identification.columns, dtype=float)[rigid], identification.values[rigid]
    if weights is None or not np.array_equal(weights.columns, columns):
        var = np.nan_to_num(np.diag(identification.covariance)[rigid]) * PRIOR_STD**2
        return MassEstimate(columns=columns, mean=values, var=var, replays=1)
    n = min(weights.replays + 1.0, MEMORY)
    moved = values - weights.mean
    noise = np.nan_to_num(np.diag(identification.covariance)[rigid])
    var = weights.var + (np.maximum(moved**2 * (n - 1.0) / n - noise, 0.0) - weights.var) / (n + PRIOR_REPLAYS)
    return MassEstimate(columns=columns, mean=weights.mean + moved / n, var=var, replays=weights.replays + 1)


def mass_estimate_from_document(document: Any) -> MassEstimate | None:
    """Weights from their document, or None. Raises BadInput naming the key."""
    if document is None:
        return None
    parts = arrays(document, ("columns", "mean", "var"), (-1,), where="belief: weights")
    if len({len(part) for part in parts.values()}) > 1:
        raise BadInput("belief: weights: columns, mean and var differ in length; expected as many of each")
    return MassEstimate(**parts, replays=int(entry(document, "replays", where="belief: weights")))
