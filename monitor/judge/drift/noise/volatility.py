"""How the noise of one joint waxes and wanes beside that of its arm.

What all joints of an arm do together `size.follow` learns from six joints within two weeks. A single joint says too little about its noise
in so short a time to be believed on its word. Over its past, though, an arm tells whether such a word was worth anything: how far the
squared noise of a replay follows the mean of the squares before it. That is the coefficient of a regression, 0 where noise has one size
however long its tails are, and near 1 where calm and rough weeks alternate (conditional heteroscedasticity: Engle, Econometrica 50, 1982).
What `size.follow` is late with, where all joints change within days, is in the squares of each as well, and counts.

Shapes: N joints, J per arm.
"""

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np

from monitor.judge.drift.noise.size import LARGEST_SQUARE
from monitor.recording import Array

RECENT_REPLAYS = 12.0  # memory of a joint's present squares: 8 does about as well
MEMORY_REPLAYS = 1000.0  # of what the arm's past says of them
USUAL_REPLAYS = 200.0  # memory of the usual square: noise that is larger for good is usual after half a year
FIRST_REPLAYS = 12  # before, what is usual is too uncertain for a square to be large or small
# Variance of relative squares from which they say nothing of the noise between replays: 2 of Gaussian noise, 3 to 4 of t₃ and of noise that
# swells; of squares that the noise within the replays or an unknown level makes, 10 to 80
UNTOLD_VAR = 8.0
STEADY_SQUARES = 60.0  # weight of b = 0: four joints are believed by half a fortnight after the first
TRIMMED = 4  # number of joints from which the largest and the smallest coefficient are left out
SURE = 1.0  # standard deviations by which the coefficient is taken for less than it seems: hardly an arm of steady noise has one by chance
LEAST = 0.25  # least factor: a replay or two of a joint that was calm may be far beyond what it was
# Times b²·(1 − b), by so much the variance is taken for larger: of what was seen, only the share b is foreseen, and noise taken for too
# small raises alerts (see `size.UNSURE`). By trial, where σ of each joint walks within a factor of two for weeks: 1.3 false alerts a
# robot-year become 0.24, and a step of 5 % is found after 15 days instead of 10; 14 gives 0.19 and 17 days.
UNSURE = 8.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Volatility:
    """What an arm's past says of the size of a joint's noise, (N,) each.

    A square is half the squared difference of two successive noises, over the arm's activity; relative to the joint's usual one, it is 1 on
    average.
    """

    usual: Annotated[Array, "N"]  # [log²] mean of the squares, without a prior: one that fades would look like noise that swells
    level: Annotated[Array, "N"]  # running mean of relative squares …
    last: Annotated[
        Array, "N"
    ]  # … without the last one: the next difference shares a replay with it, and is like it by chance; NaN before the first
    square_mean: Annotated[Array, "N"]  # mean of the relative squares: not 1 where their size changed since
    level_mean: Annotated[Array, "N"]  # and of the levels
    product: Annotated[Array, "N"]  # covariance of relative squares and levels
    level_var: Annotated[Array, "N"]  # variance of the levels
    square_var: Annotated[Array, "N"]  # variance of the relative squares
    replays: Annotated[Array, "N"]  # number of squares in the usual one
    pairs: Annotated[Array, "N"]  # number of relative squares in the means after `last`

    def coefficient(self, joints_per_arm: int) -> Array:
        """(N,) b: share of what `level` says that the next square does, by all joints of the arm; 0 … 1."""
        J = joints_per_arm
        number = self.pairs.reshape(-1, J)
        product, level_var, square_var = (mean.reshape(-1, J) for mean in (self.product, self.level_var, self.square_var))
        told = (number > 0) & (level_var > 0) & (square_var < UNTOLD_VAR)
        level_var = np.where(told, level_var, 1.0)
        each, error = product / level_var, square_var / level_var  # of n pairs, the variance of `each` is `error`/n
        # one joint may have become noisier for good: neither the largest nor the smallest counts
        weight = np.where(told, number, 0.0)
        rank = np.argsort(np.argsort(np.where(told, each, np.inf), axis=1), axis=1)
        joints = told.sum(axis=1, keepdims=True)
        weight[(joints >= TRIMMED) & ((rank == 0) | (rank >= joints - 1))] = 0.0
        pairs = np.maximum(weight.sum(axis=1), 1.0)
        mean, var = ((weight * value).sum(axis=1) / pairs for value in (each, error))
        sure = np.clip(mean - SURE * np.sqrt(var / pairs), 0.0, 1.0) * pairs / (pairs + STEADY_SQUARES)
        b: Array = np.repeat(sure, J)
        return b

    def factor(self, joints_per_arm: int) -> Array:
        """(N,) of the variance of the noise at present, beyond what the arm's activity says."""
        b = self.coefficient(joints_per_arm)
        expected: Array = np.maximum(1.0 + b * (self.level - 1.0), LEAST) * (1.0 + UNSURE * b**2 * (1.0 - b))
        return expected

    def after(self, square: Array, floor: Array) -> "Volatility":
        """After a replay. square : (N,) [log²] of it; NaN where there is none.

        floor : (N,) [log²] of no larger a usual square is anything told, as where noise within the replay hides that between replays.
        """
        known = np.isfinite(square)
        replays = np.where(known, np.minimum(self.replays + 1.0, MEMORY_REPLAYS), self.replays)
        begun = known & (replays > FIRST_REPLAYS) & (self.usual > floor)
        relative = np.clip(np.where(begun, square / np.where(begun, self.usual, 1.0), 1.0), -LARGEST_SQUARE, LARGEST_SQUARE)
        limited = np.where(begun, relative * self.usual, square)
        pairs = np.where(begun, np.minimum(self.pairs + 1.0, MEMORY_REPLAYS), self.pairs)
        share = np.where(begun, 1.0 / np.maximum(pairs, 1.0), 0.0)
        of_square, of_level = relative - self.square_mean, self.level - self.level_mean
        kept = 1.0 - share  # Welford (1962): deviations from the old mean and from the new one
        return Volatility(
            usual=np.where(known, self.usual + (limited - self.usual) / np.clip(replays, 1.0, USUAL_REPLAYS), self.usual),
            level=np.where(begun & np.isfinite(self.last), self.level + (self.last - self.level) / RECENT_REPLAYS, self.level),
            last=np.where(begun, relative, self.last),
            square_mean=self.square_mean + share * of_square,
            level_mean=self.level_mean + share * of_level,
            product=kept * (self.product + share * of_square * of_level),
            level_var=kept * (self.level_var + share * of_level**2),
            square_var=kept * (self.square_var + share * of_square**2),
            replays=replays,
            pairs=pairs,
        )

    def of_new_joints(self, new: np.ndarray) -> "Volatility":
        """With nothing seen of the joints in `new` (N,)."""
        fresh = steady(len(new))
        return Volatility(**{f.name: np.where(new, getattr(fresh, f.name), getattr(self, f.name)) for f in fields(Volatility)})


def steady(joints: int) -> Volatility:
    """Before the first replay: no joint does anything of its own."""
    none, one = np.zeros(joints), np.ones(joints)
    return Volatility(
        usual=none,
        level=one,
        last=np.full(joints, np.nan),
        square_mean=one,
        level_mean=one,
        product=none,
        level_var=none,
        square_var=none,
        replays=none,
        pairs=none,
    )
