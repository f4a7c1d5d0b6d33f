"""How the noise of one joint waxes and wanes beside that of its arm.

What all joints of an arm do together `size.follow` learns from six joints within two weeks. A single joint says too little about its noise
in so short a time to be believed on its word. Over its past, though, an arm tells whether such a word was worth anything: how far the
squared noise of a replay follows the mean of the squares before it. That is the coefficient of a regression, 0 where noise has one size
however long its tails are, and near 1 where calm and rough weeks alternate (conditional heteroscedasticity: Engle, Econometrica 50, 1982).

Shapes: N joints, J per arm.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from monitor.judge.document import array
from monitor.judge.drift.noise.chance import of_arm
from monitor.judge.drift.noise.size import LARGEST_SQUARE
from monitor.recording import Array

RECENT_REPLAYS = 12.0  # memory of a joint's present squares: 8 and 16 do as well
MEMORY_REPLAYS = 1000.0  # of what the arm's past says of them
FIRST_REPLAYS = 30.0  # weight of 1 in the usual square
STEADY_SQUARES = 240.0  # weight of b = 0: six joints are believed by half after 40 replays, and by a sixth after a week
SURE = 1.5  # standard deviations by which the coefficient is taken for less than it seems: an arm of steady noise has none by chance
LEAST = 0.25  # least factor: a replay or two of a joint that was calm may be far beyond what it was
# Times b²·(1 − b), by so much the variance is taken for larger: of what was seen, only the share b is foreseen, and noise taken for too
# small raises alerts (see `size.UNSURE`). By trial, where σ of each joint walks within a factor of two for weeks: 1.3 false alerts a
# robot-year become 0.2, and a step of 5 % is found after 18 days instead of 10; 12 gives 0.16 and 21 days.
UNSURE = 8.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Volatility:
    """What an arm's past says of the size of a joint's noise, (N,) each.

    Squares are half squared differences of successive noises, over what the arm's activity says; 1 where they are as usual.
    """

    level: Array  # running mean of the joint's squares …
    last: Array  # … without the last one: the next difference shares a replay with it, and is like it by chance; NaN before the first
    usual: Array  # mean of the squares over the joint's past
    product: Array  # mean of (square − usual)·(level − usual)
    level_var: Array  # mean of (level − usual)²
    square_var: Array  # mean of (square − usual)²
    replays: Array  # number of squares in these means

    def coefficient(self, joints_per_arm: int) -> Array:
        """(N,) b: share of what `level` says that the next square does, by all joints of the arm; 0 … 1."""
        number = of_arm(self.replays, joints_per_arm)
        means = (self.product, self.level_var, self.square_var)
        product, level_var, square_var = (of_arm(self.replays * mean, joints_per_arm) for mean in means)
        told = level_var > 0
        level_var = np.where(told, level_var, 1.0)
        # of a regression of n pairs: σ²(square)/(n·σ²(level))
        std = np.sqrt(square_var / np.maximum(number * level_var, 1e-12))
        sure = np.clip(product / level_var - SURE * std, 0.0, 1.0)
        b: Array = np.where(told, sure, 0.0) * number / (number + STEADY_SQUARES)
        return b

    def factor(self, joints_per_arm: int) -> Array:
        """(N,) of the variance of the noise at present, beyond what the arm's activity says."""
        b = self.coefficient(joints_per_arm)
        expected: Array = np.maximum(1.0 + b * (self.level / self.usual - 1.0), LEAST) * (1.0 + UNSURE * b**2 * (1.0 - b))
        return expected

    def after(self, square: Array) -> "Volatility":
        """After a replay. square : (N,) of it; NaN where there is none."""
        known = np.isfinite(square)
        new = np.where(known, np.clip(square, 0.0, LARGEST_SQUARE), 0.0)
        replays = np.where(known, np.minimum(self.replays + 1.0, MEMORY_REPLAYS), self.replays)
        share = np.where(known, 1.0 / np.maximum(replays, 1.0), 0.0)
        of_square, of_level = new - self.usual, self.level - self.usual
        return Volatility(
            level=np.where(known & np.isfinite(self.last), self.level + (self.last - self.level) / RECENT_REPLAYS, self.level),
            last=np.where(known, new, self.last),
            usual=self.usual + np.where(known, of_square / (replays + FIRST_REPLAYS), 0.0),
            product=self.product + share * (of_square * of_level - self.product),
            level_var=self.level_var + share * (of_level**2 - self.level_var),
            square_var=self.square_var + share * (of_square**2 - self.square_var),
            replays=replays,
        )

    def of_new_joints(self, new: np.ndarray) -> "Volatility":
        """With nothing seen of the joints in `new` (N,)."""
        fresh = nothing_seen(len(new))
        return Volatility(**{f.name: np.where(new, getattr(fresh, f.name), getattr(self, f.name)) for f in fields(Volatility)})


def nothing_seen(joints: int) -> Volatility:
    """Before the first replay."""
    usual, none = np.ones(joints), np.zeros(joints)
    return Volatility(level=usual, last=np.full(joints, np.nan), usual=usual, product=none, level_var=none, square_var=none, replays=none)


def volatility_from_document(document: Any, joints: int) -> Volatility:
    """A Volatility from its document; that of a new arm from None, as in beliefs of releases without it."""
    if document is None:
        return nothing_seen(joints)
    return Volatility(**{f.name: array(document, f.name, (joints,), where="belief: track: volatility") for f in fields(Volatility)})
