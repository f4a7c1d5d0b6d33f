"""Whether a change that was detected in one joint is that joint's own: before it is blamed, the other joints are looked at.

A new current scale of the controller, a supply, a payload that nobody declared changes the friction of most joints in one replay. Some
joint shows it first, by chance or because it carries more. So the evidence for the same change at the same age is pooled over the others.
"""

import math

import numpy as np

from monitor.judge.drift.noise.chance import of_arm
from monitor.recording import Array

MOST = 2.0 / 3.0  # share of an arm's joints that a common change is in
TOGETHER_SIGMA = 2.5  # [σ] of pooled evidence in the weakest of them: by chance 1 in 160 where the others do not change
BOUNDED = 2.5  # [σ] one joint counts for no more: two or three joints that wear at a time are no common change
FEWEST_JOINTS = 4  # with fewer, the weakest are too few to show it
LOADED = (1, 2)  # shoulder and elbow, from 0: what the arm carries loads their gears most
LOADED_SIGMA, ALIKE = 2.0, 3.0  # [σ] of evidence in both of them; and how many times the smaller change the larger one may be
LOAD_MOST = 0.07  # [log] largest change that is taken for one of load: a tool that makes more is heavier than what is left undeclared


def common_changes(
    found: np.ndarray,
    relative: Array,
    glr_score: Array,
    expected: Array,
    wear: Array,
    usable: np.ndarray,
    joints_per_arm: int,
    same_mass: np.ndarray | None = None,
) -> np.ndarray:
    """(N,) joints of arms whose detected change is one of most joints, those included in which it was not detected yet.

    found : (N,) joints with a change detected now. relative : (N, 2, W) each candidate's likelihood ratio over its threshold. glr_score,
    expected : (N, 2, W) its score, and the mean square of that where nothing changed. wear : (N, 2, W) [log] that a score of 1 stands for.
    usable : (N,) whether this replay and its bank say something of the joint. same_mass : (N,) whether the arm was weighed and carries
    what it did before; None: no arm was weighed.

    The kind and the age are those of the arm's clearest change; its sign gives the side. Of the joints, the strongest third does not count,
    so that one or two joints that wear do not make it common. A small change of shoulder and elbow at one time is what a payload makes: the
    other joints hardly show it. Where weighing excludes a payload, it is wear of both.
    """
    J = joints_per_arm
    common = np.zeros(len(found), dtype=bool)
    if J < FEWEST_JOINTS:
        return common
    arms = np.flatnonzero(found.reshape(-1, J).any(axis=1))
    if not len(arms):
        return common
    joints = arms[:, None] * J + np.arange(J)  # (a, J)
    flat = len(relative[0].ravel())
    strength = np.where(found[joints][..., None], relative[joints].reshape(len(arms), J, flat), -np.inf)
    best = np.argmax(strength.reshape(len(arms), -1), axis=1)
    first, candidate = best // flat, best % flat
    row = np.arange(len(arms))
    s = glr_score[joints].reshape(len(arms), J, flat)[row, :, candidate]  # (a, J)
    chance = expected[joints].reshape(len(arms), J, flat)[row, :, candidate]
    z = s / np.sqrt(np.maximum(chance, 1e-12)) * np.sign(s[row, first])[:, None]
    here = usable[joints] & (chance > 0)
    z = np.where(here, np.minimum(z, BOUNDED), np.inf)
    weakest = np.sort(z, axis=1)  # unusable joints last
    strongest = J - math.ceil(MOST * J - 1e-9)  # as many of them do not count, however few joints are usable
    count = np.maximum(here.sum(axis=1) - strongest, 0)
    counts = np.arange(J) < count[:, None]
    pooled = np.where(counts, np.where(np.isfinite(weakest), weakest, 0.0), 0.0).sum(axis=1) / np.sqrt(np.maximum(count, 1))
    together = (pooled >= TOGETHER_SIGMA) & (here.sum(axis=1) >= FEWEST_JOINTS)
    size = wear[joints].reshape(len(arms), J, flat)[row, :, candidate] * s
    may_be_load = np.ones(len(arms), dtype=bool) if same_mass is None else ~same_mass[joints[:, 0]]
    together |= may_be_load & _loaded(z, size * np.sign(s[row, first])[:, None], here)
    common[joints] = together[:, None] & here
    return common


def _loaded(z: Array, size: Array, here: np.ndarray) -> np.ndarray:
    """(a,) whether a change is what a payload makes, from its evidence [σ] and its size [log] towards its side, (a, J) each."""
    pair = list(LOADED)
    if z.shape[1] <= max(pair):
        return np.zeros(len(z), dtype=bool)
    smaller, larger = size[:, pair].min(axis=1), size[:, pair].max(axis=1)
    both = (
        here[:, pair].all(axis=1)
        & (z[:, pair].min(axis=1) >= LOADED_SIGMA)
        & (z[:, pair].max(axis=1) >= z.max(axis=1, where=here, initial=0.0))
    )
    loaded: np.ndarray = both & (larger <= ALIKE * smaller) & (larger <= LOAD_MOST)
    return loaded


def pool_over_arms(ratios: Array, common: np.ndarray, joints_per_arm: int) -> Array:
    """The likelihood ratios (N, 2, W), of the joints in `common` (N,) summed over those of their arm: which change it was, all show."""
    if not common.any():
        return ratios
    pooled = of_arm(np.where(common[:, None, None], ratios, 0.0), joints_per_arm)
    return np.where(common[:, None, None], pooled, ratios)
