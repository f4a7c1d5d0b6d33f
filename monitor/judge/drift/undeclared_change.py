"""Changes of an arm that nobody declared: a payload, a mounting or a drive gain.

The rigid base parameters of every replay are compared with their mean over the replays before in the same context. Wear changes no rigid
parameter, so a difference is not wear, and the filter learns nothing while it lasts.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.identify.identification import Identification
from monitor.judge.document import arrays, entry
from monitor.model.regressor import friction_columns
from monitor.model.robot import PER_JOINT
from monitor.recording import Array

MOUNTING, PAYLOAD, GAINS = "mounting_contradiction", "payload_contradiction", "gain_contradiction"  # what changed
MIN_REPLAYS = 3  # with fewer replays before, there is nothing to compare with
PRIOR_REPLAYS = 5.0  # [replays] weight of the prior scatter
PRIOR_STD = 2.0  # prior standard deviation from replay to replay, in standard deviations of the first fit
MEMORY = 50.0  # [replays] over which mean and scatter are averaged
EXPLAINED = 0.6  # share of the squared difference that a mass at the flange must explain to be called a payload
MASS_PARAMETERS = 4  # m, mx, my, mz of the last link: what a mass at the flange changes


class UndeclaredChange(NamedTuple):
    """What contradicts the declared context."""

    condition: str | None  # MOUNTING, PAYLOAD or GAINS; None: nothing
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
    """(B,) which base parameters are rigid: neither friction nor rotor inertia."""
    joints = len(identification.coulomb_nm)
    others = np.concatenate([*friction_columns(joints), np.arange(joints) * PER_JOINT + PER_JOINT - 1])
    rigid: np.ndarray = ~np.isin(identification.columns, others)
    return rigid


class RigidFit(NamedTuple):
    """The rigid base parameters that one replay identified, (R,) each."""

    columns: Array  # of the regressor
    names: tuple[str, ...]
    values: Array
    variance: Array  # within the replay
    of_mass: Array  # (R, 4) what m, mx, my, mz of the last link add to them


def rigid_fit(identification: Identification) -> RigidFit:
    """The rigid part of an identification."""
    rigid = rigid_of(identification)
    last_link = PER_JOINT * (len(identification.coulomb_nm) - 1)
    return RigidFit(
        columns=np.array(identification.columns, dtype=float)[rigid],
        names=tuple(np.array(identification.names)[rigid].tolist()),
        values=identification.values[rigid],
        variance=np.diag(identification.covariance)[rigid],
        of_mass=identification.combination[rigid][:, last_link : last_link + MASS_PARAMETERS],
    )


def find_undeclared_change(
    identification: Identification, estimate: MassEstimate | None, *, sigma: float, mass_kg: float
) -> UndeclaredChange:
    """What of a replay contradicts its declared context.

    estimate : of the replays before in the same context; None before the first. sigma : how many standard deviations are a contradiction.
    mass_kg : smallest mass at the flange that is called a payload.
    """
    for warning in identification.warnings:
        if warning.code == MOUNTING:
            return UndeclaredChange(MOUNTING, warning.text)
    return compare_weights(rigid_fit(identification), estimate, sigma=sigma, mass_kg=mass_kg)


def compare_weights(fit: RigidFit, estimate: MassEstimate | None, *, sigma: float, mass_kg: float) -> UndeclaredChange:
    """What of a replay's rigid parameters contradicts those of the replays before; arguments as in `find_undeclared_change`."""
    if estimate is None or estimate.replays < MIN_REPLAYS or not np.array_equal(estimate.columns, fit.columns):
        return NO_UNDECLARED_CHANGE
    var = fit.variance + estimate.var * (1.0 + 1.0 / estimate.replays)
    known = np.isfinite(var) & (var > 0)
    moved, std = (fit.values - estimate.mean)[known], np.sqrt(var[known])
    normalised = moved / std
    squares = float(normalised @ normalised)  # χ² of `degrees` if nothing changed
    degrees = len(normalised)
    X = fit.of_mass[known] / std[:, None]
    load, *_ = np.linalg.lstsq(X, normalised, rcond=1e-9)  # (m, mx, my, mz) of the mass that explains most of it
    left = normalised - X @ load
    squares_left = float(left @ left)
    explained = 1.0 - squares_left / max(squares, 1e-300)
    if squares - squares_left > sigma**2 and explained >= EXPLAINED and abs(load[0]) >= mass_kg:
        return _payload(float(load[0]))
    if explained < EXPLAINED and squares > degrees * sigma**2:
        worst = int(np.argmax(np.abs(normalised)))
        return _gains(np.sqrt(squares / degrees), str(np.array(fit.names)[known][worst]))
    return NO_UNDECLARED_CHANGE


def update_mass_estimate(estimate: MassEstimate | None, fit: RigidFit) -> MassEstimate:
    """The estimate after one more replay of the same context."""
    noise = np.nan_to_num(fit.variance)
    if estimate is None or not np.array_equal(estimate.columns, fit.columns):
        return MassEstimate(columns=fit.columns, mean=fit.values, var=noise * PRIOR_STD**2, replays=1)
    n = min(estimate.replays + 1.0, MEMORY)
    moved = fit.values - estimate.mean
    var = estimate.var + (np.maximum(moved**2 * (n - 1.0) / n - noise, 0.0) - estimate.var) / (n + PRIOR_REPLAYS)
    return MassEstimate(columns=fit.columns, mean=estimate.mean + moved / n, var=var, replays=estimate.replays + 1)


def _payload(kg: float) -> UndeclaredChange:
    """A mass at the flange, negative where it was taken off."""
    more = "more" if kg > 0 else "less"
    return UndeclaredChange(PAYLOAD, f"the arm carries about {abs(kg):.1f} kg {more} than in the replays before, and nobody declared it")


def _gains(sigmas: float, parameter: str) -> UndeclaredChange:
    """Weights that no mass explains; `parameter` differs most."""
    return UndeclaredChange(
        GAINS,
        f"weights differ from those of the replays before by {sigmas:.0f} standard deviations ({parameter} most), "
        "and no mass at the flange explains it: drive gains or the arm itself were changed",
    )


def mass_estimate_from_document(document: Any) -> MassEstimate | None:
    """A MassEstimate from its document, or None of null. Raises BadInput naming the key."""
    if document is None:
        return None
    parts = arrays(document, ("columns", "mean", "var"), (-1,), where="belief: weights")
    if len({len(part) for part in parts.values()}) > 1:
        raise BadInput("belief: weights: columns, mean and var differ in length; expected as many of each")
    return MassEstimate(**parts, replays=int(entry(document, "replays", where="belief: weights")))
