"""What is told: one threshold, that follows from the false alarms a year that are wanted.

Shiryaev–Roberts: R± = Σ_h p_h Σ_c days_c·LR_hc·P(± effect of c now > least). While nothing changes E[R] is at most the days passed,
so a rise is found at R₊ ≥ A = 365·channels/((1 − falls)·α), and by chance at most once in A days; α false alarms an arm and year, over all
channels (Pollak, 1985). The bound is loose: R overshoots. What was found is wear from then on, and told while it is likely above `least`.

The mean of the arm's joints is one channel more. A change of it is common where most joints have a good part of it, and that of one joint
where this one accounts for it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from monitor.judge.friction.changes import Bank, ChangePriors
from monitor.recording import Array

LEAST_SHARE = 1e-4  # of R, below which the sign of a candidate's effect is not looked at: there are some 800


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionSettings:
    """The operating point."""

    false_alarms_per_year: float = 0.25  # α of an arm, by the bound; healthy arms have a third of it
    falls: float = 0.1  # share of them that may be falls
    least: float = 0.02  # [log] smaller rises are not told …
    cleared: float = 0.6  # … and one that was told is, until it is likely below this share of that
    most: float = 2.0 / 3.0  # share of the joints that a common change is of
    learning_replays: int = 10  # before so many nothing is told
    chance: float = 0.75  # power of what chance did, as a multiple of the arm's age, which R is on average …
    chance_days: float = 60.0  # … of arms that are younger, as a multiple of this
    suspicions_per_year: float = 30.0  # of an arm, by the bound, that ask for a replay and tell nothing
    forgotten_days: float = 365.0  # in which what chance did counts e times less

    def limits(self, joints_per_arm: int) -> Array:
        """(2,) A of rises and of falls [days]."""
        share = np.array([1.0 - self.falls, self.falls])
        limits: Array = 365.0 * (joints_per_arm + 1) / (self.false_alarms_per_year * share)
        return limits

    def suspicious(self, joints_per_arm: int) -> float:
        """R from which a change is likely enough to be looked at, and not to be told [days]."""
        return 365.0 * joints_per_arm / self.suspicions_per_year

    def by_chance(self, peaks: Array, counted: np.ndarray, age: Array) -> Array:
        """(2, A, J) factors of A: what chance did to an arm, which is more than A allows for where its noise has no name in the model.

        peaks : (2, A, J) highest R of rises and of falls that were not told. counted : (A, J) joints that are not known to be worn.
        age : of them [days]. A change is to stand out from the other joints' changes of its sign, and from those of the other sign, the
        joint's own among them. One other joint may rise as well: two that one blow has worn must not hide each other.
        """
        shown = np.where(counted, peaks, 0.0)
        order = np.sort(np.concatenate([np.zeros((*shown.shape[:2], 2)), shown], axis=2), axis=2)[..., ::-1]  # the highest first
        k = np.array([1, 0])[:, None, None]  # of others' rises, and of their falls, so many do not count
        least = np.take_along_axis(order, np.broadcast_to(k, order[..., :1].shape), axis=2)
        beyond = np.take_along_axis(order, np.broadcast_to(k + 1, order[..., :1].shape), axis=2)
        others = np.where(shown >= least, beyond, least)  # without the joint itself
        factors: Array = np.maximum(np.maximum(others, order[::-1, :, :1]) / np.maximum(age, self.chance_days), 1.0) ** self.chance
        return factors

    def needed(self, peaks: Array, counted: np.ndarray, joints_per_arm: int, age: Array) -> Array:
        """(2, N) R from which a rise and a fall are found [days]. peaks : (2, N); counted : (A, J); age : (N,) [days]."""
        J = joints_per_arm
        A = np.broadcast_to(self.limits(J)[:, None, None], (2, len(counted), J + 1)).copy()
        A[..., :J] *= self.by_chance(peaks.reshape(2, -1, J + 1)[..., :J], counted, age.reshape(1, -1, J + 1)[..., :J])
        each: Array = A.reshape(2, -1)
        return each


class Crossing(NamedTuple):
    """Whose change was found with this replay."""

    rises: np.ndarray  # (N,) joints of their own; the channels of the mean are False
    falls: np.ndarray  # (N,)
    common: np.ndarray  # (2, A) rises and falls of the arm's joints together


class Odds(NamedTuple):
    """For a change against none."""

    R: Array  # (2, N) of a rise and of a fall [days]
    change: Array  # (N,) what it comes to by now, if there is one [log]; 0 where R is far from any limit
    unchanged: Array  # (H, N) probability that nothing changed, by kind of noise


def odds(p: Array, bank: Bank, replays: Array, use: Array, joints_per_arm: int, priors: ChangePriors, settings: DecisionSettings) -> Odds:
    """R and the change by now. p : (H, N) of the kinds of noise; replays : (N,) ν; use : (N,) usual days so far."""
    J = joints_per_arm
    weight = bank.evidence(replays, priors)
    np.exp(np.minimum(weight, 80.0, out=weight), out=weight)
    unchanged = 1.0 / (1.0 + priors.a_year / 365.0 * weight.sum(axis=(1, 2)))
    weight *= p[:, None, None].astype(np.float32)
    most = weight.sum(axis=(0, 1, 2), dtype=float)
    R, change = np.stack([most, most]) / 2.0, np.zeros(len(most))
    near = np.repeat((most.reshape(-1, J + 1) >= settings.chance_days).any(axis=1), J + 1)  # elsewhere the sign is not worth its time
    if near.any():
        h, c, k, n = np.nonzero(weight > np.where(near, LEAST_SHARE * most, np.inf).astype(np.float32))
        size, v = bank.sizes_at(h, c, k, n, priors)
        by_now, w = bank.effect_now(use)[c, k, n], weight[h, c, k, n]
        effect, std = size * by_now, np.sqrt(v) * by_now
        for sign, row in ((1.0, 0), (-1.0, 1)):
            told = np.bincount(n, w * scipy.special.ndtr((sign * effect - settings.least) / std), len(most))
            R[row, near] = told[near]
        change[near] = (np.bincount(n, w * effect, len(most)) / most)[near]
    return Odds(R, change, unchanged)


def crossings(
    odds: Odds, needed: Array, learnt: np.ndarray, counted: np.ndarray, joints_per_arm: int, settings: DecisionSettings
) -> Crossing:
    """Whose change it is. needed : (2, N) R from which it is found; learnt : (N,) channels that are no longer new; counted : (A, J) joints
    that the mean is of.
    """
    J = joints_per_arm
    needed, reached = needed.reshape(2, -1, J + 1), (odds.R * learnt).reshape(2, -1, J + 1)
    A, crossed = needed[..., :J], reached[..., J] >= needed[..., J]
    R, change, of = odds.R.reshape(2, -1, J + 1), odds.change.reshape(-1, J + 1), counted.sum(axis=1)
    part = change[:, :J] * np.sign(change[:, J:]) * counted
    half = 0.5 * np.abs(change[:, J:])  # of the mean's change
    shared = ((part >= half).sum(axis=1) >= settings.most * of) & (of > 2)
    one = half <= part / np.maximum(of, 1)[:, None]  # this joint accounts for the mean's change
    common = crossed & shared
    beyond = part >= 2.0 * np.abs(change[:, J:])  # as much again as all have
    apart = ~shared[:, None] | beyond | ((R[..., :J] > R[..., J:]) & ~common.any(axis=0)[:, None])
    own = (reached[..., :J] >= A) & apart
    own |= (reached[..., J:] >= A) & one & ~shared[:, None] & (of > 2)[:, None]
    joints = np.concatenate([own, np.zeros_like(own[..., :1])], axis=2).reshape(2, -1)
    return Crossing(joints[0], joints[1], common)
