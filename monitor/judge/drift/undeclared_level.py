"""The level of friction of an arm whose weights contradict what is declared, in replay after replay by the same.

Nothing is learnt from a replay that contradicts its declaration. Where nobody ever declares the change, no wear would be found for good. So
replays that contradict the declaration and agree with each other have, from the twentieth on, a level of friction of their own, as a
declared context has. The contradiction stands until it is declared, or until the arm weighs again what it weighed before.
"""

from typing import Any, NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.judge.document import entry
from monitor.judge.drift.undeclared_change import (
    PAYLOAD,
    MassEstimate,
    RigidFit,
    UndeclaredChange,
    compare_weights,
    mass_estimate_from_document,
    misfit,
    update_mass_estimate,
    what_is_left,
)

LEVEL_REPLAYS = 20  # that agree with each other: an integrator who means to declare the change has done so in as many days


class UndeclaredLevel(NamedTuple):
    """Replays that contradict the declaration and agree with each other."""

    estimate: MassEstimate
    condition: str  # by which they contradict it
    text: str  # what the change is
    kg: float | None  # mass at the flange beyond the declared one; None where no mass explains it
    since_unix_s: float | None  # when it had enough replays for a level of its own; None: not yet


class Weights(NamedTuple):
    """What the arm weighs in the context that is declared."""

    declared: MassEstimate | None = None  # in the replays that contradict nothing
    level: UndeclaredLevel | None = None  # that has a level of friction of its own
    candidate: UndeclaredLevel | None = None  # that has not enough replays yet


class Weighed(NamedTuple):
    """The weights after one more replay, and what the replay contradicts."""

    weights: Weights
    undeclared: UndeclaredChange


def weigh(weights: Weights, fit: RigidFit, at_unix_s: float, *, sigma: float, mass_kg: float, declared_kg: float | None = None) -> Weighed:
    """What the weights of one more replay contradict, and the weights after it.

    sigma, mass_kg : as in `compare_weights`. declared_kg : payload as declared, for the text; None where nobody declares one.
    """
    left = None if weights.declared is None else what_is_left(fit, weights.declared)
    found = compare_weights(fit, weights.declared, sigma=sigma, mass_kg=mass_kg, left=left)
    level = weights.level
    nearer = level is not None and (found.condition is not None or misfit(fit, level.estimate) < misfit(fit, weights.declared))
    if level is not None and nearer and _is_of(level, fit, sigma=sigma, mass_kg=mass_kg):
        level = level._replace(estimate=update_mass_estimate(level.estimate, fit))
        return Weighed(weights._replace(level=level), _standing(level, declared_kg))
    if found.condition is None:
        return Weighed(weights._replace(declared=update_mass_estimate(weights.declared, fit, left)), found)
    before = weights.candidate
    agree = before is not None and before.condition == found.condition and _is_of(before, fit, sigma=sigma, mass_kg=mass_kg)
    estimate = update_mass_estimate(before.estimate if agree and before is not None else None, fit)
    candidate = UndeclaredLevel(estimate, str(found.condition), found.text, found.kg, None)
    if estimate.replays < LEVEL_REPLAYS:
        return Weighed(weights._replace(candidate=candidate), found)
    mean = compare_weights(fit._replace(values=estimate.mean), weights.declared, sigma=sigma, mass_kg=mass_kg)
    if mean.condition == found.condition:  # the mean of so many replays says it better than the last one
        candidate = candidate._replace(text=mean.text, kg=mean.kg)
    level = candidate._replace(since_unix_s=at_unix_s)
    return Weighed(weights._replace(level=level, candidate=None), _standing(level, declared_kg)._replace(begins=True))


def declares_level(weights: Weights, fit: RigidFit, *, sigma: float, mass_kg: float) -> bool:
    """Whether the first replay of a context with another payload weighs what the undeclared level does: then they are the same."""
    level = weights.level
    return level is not None and level.condition == PAYLOAD and _is_of(level, fit, sigma=sigma, mass_kg=mass_kg)


def _is_of(level: UndeclaredLevel, fit: RigidFit, *, sigma: float, mass_kg: float) -> bool:
    """Whether a replay weighs what those of a level do."""
    same_columns = np.array_equal(level.estimate.columns, fit.columns)
    return same_columns and compare_weights(fit, level.estimate, sigma=sigma, mass_kg=mass_kg).condition is None


def _standing(level: UndeclaredLevel, declared_kg: float | None) -> UndeclaredChange:
    """The contradiction of a replay that belongs to a level of its own."""
    text = level.text
    if level.kg is not None and declared_kg is not None:
        text += f": payload_kg says {declared_kg:.1f} kg, and it weighs about {max(declared_kg + level.kg, 0.0):.1f} kg"
    day = np.datetime64(int(level.since_unix_s or 0.0), "s").astype("datetime64[D]")
    text += f"; wear is judged against a level of its own since {day}"
    return UndeclaredChange(level.condition, text, level.kg, own_level=True)


def undeclared_level_from_document(document: Any) -> UndeclaredLevel | None:
    """An UndeclaredLevel from its document, or None of null. Raises BadInput naming the key."""
    if document is None:
        return None
    where = "belief: undeclared level"
    estimate = mass_estimate_from_document(entry(document, "estimate", where=where))
    if estimate is None:
        raise BadInput(f"{where}: estimate is null; expected the weights of its replays")
    kg, since = (entry(document, key, where=where) for key in ("kg", "since_unix_s"))
    return UndeclaredLevel(
        estimate,
        str(entry(document, "condition", where=where)),
        str(entry(document, "text", where=where)),
        None if kg is None else float(kg),
        None if since is None else float(since),
    )
