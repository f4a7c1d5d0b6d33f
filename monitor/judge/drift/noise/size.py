"""The size of the noise between replays, from all joints of an arm: how alike they are, and how noisy the last weeks were.

Shapes: N joints, J per arm.
"""

import numpy as np

from monitor.judge.drift.noise.shrinkage import shrunk
from monitor.recording import Array

RECENT_REPLAYS = 15.0  # memory of the present noise: six joints then tell its variance to 13 %
RISING_REPLAYS = 8.0  # the same while it rises: noise that grows, as in every autumn, raises alerts as long as it is taken for what it was
STEADY = 1.10  # activity of noise that does not change, by the two memories: 1.14 where it is Gaussian, 0.94 where it is t₃
LARGEST_SQUARE = 9.0  # [γ₁] one replay of a joint says no more about the present noise
QUIETER = 4.0  # times the variance of chance that weeks of less noise must exceed: noise taken for too small raises alerts
# Times the relative variance of that estimate: by so much noise is taken for larger. Noise that is taken for too small by chance raises
# more alerts than noise taken for too large avoids: with a threshold z², E[exp(−z²/2·(1 + e))] of an error e of variance v is
# exp(−z²/2·(1 − z²·v/4)). So z²/4 of 5.15² keeps alerts as rare as if the variance were known.
UNSURE = 6.5
DIFFERENCES = 3.0  # variance of a mean of n half squared differences of successive noises, times n, over γ₁² (von Neumann, 1941)
ALIKE_VAR, ALIKE_JOINTS = 0.1, 2.0  # prior variance of log γ₁ between the joints of an arm, and its weight in joints


# How long the tails of the noise are, all joints of the arm tell by their outliers. A replay of Gaussian noise counts with up to 3 σ; the
# score of Student's t is bounded by (ν+1)/(2√ν): 3 of ν = 34, and 1.8 of ν = 10 and of the t₃ whose σ is learnt without its outliers.
MOST_SIGMA, LEAST_SIGMA = 3.0, 1.8  # [σ] bounds of what one replay counts with
USUAL_OUTLIERS, OUTLIER_REPLAYS = 0.001, 200.0  # prior share of outliers, and its weight [replays]
TAIL_POWER = 0.18  # so that 2 % of outliers, as t₃ noise has them, lead to the smallest bound


def counted_sigma(outliers: Array, replays: Array, joints_per_arm: int) -> Array:
    """(N,) [σ] with how much one replay counts for a change at most, by the outliers among the replays of the arm's joints, (N,) each."""
    seen, of = (np.repeat(each.reshape(-1, joints_per_arm).sum(axis=1), joints_per_arm) for each in (outliers, replays + outliers))
    share = (seen + USUAL_OUTLIERS * OUTLIER_REPLAYS) / (of + OUTLIER_REPLAYS)
    counted: Array = np.clip(MOST_SIGMA * (USUAL_OUTLIERS / share) ** TAIL_POWER, LEAST_SIGMA, MOST_SIGMA)
    return counted


def alike(step_var: Array, replays: Array, joints_per_arm: int) -> Array:
    """(N,) γ₁ of each joint, nearer to the arm's the less the joints of this arm differ beyond chance."""
    J = joints_per_arm
    log = np.log(step_var).reshape(-1, J)
    chance = (DIFFERENCES / replays).reshape(-1, J)
    mean = log.mean(axis=1, keepdims=True)
    each: Array = np.exp(mean + shrunk(log - mean, chance, prior_var=ALIKE_VAR, prior_joints=ALIKE_JOINTS)).ravel()
    return each


def follow(activity: Array, square: Array, joints_per_arm: int) -> Array:
    """(N,) the activity after a replay. square : (N,) half the squared difference of two noises over γ₁; NaN where it is none."""
    square = np.clip(square, 0.0, LARGEST_SQUARE).reshape(-1, joints_per_arm)
    known = np.isfinite(square)
    number = known.sum(axis=1)
    mean = np.where(known, square, 0.0).sum(axis=1) / np.maximum(number, 1)
    before = activity.reshape(-1, joints_per_arm)[:, 0]
    # as many joints as replayed say something
    memory = np.where(mean > before, RISING_REPLAYS, RECENT_REPLAYS)
    return np.repeat(before + (mean - before) * number / (joints_per_arm * memory), joints_per_arm)


def present(activity: Array, joints_per_arm: int) -> Array:
    """(N,) factor of the usual variance at present: 1 unless the last weeks differ from it by more than chance (James and Stein, 1961)."""
    chance = DIFFERENCES / (joints_per_arm * 2.0 * RECENT_REPLAYS)
    away = activity / STEADY - 1.0
    clear = np.where(away < 0.0, QUIETER, 1.0) * chance
    believed = np.maximum(1.0 - clear / np.maximum(away**2, 1e-12), 0.0)
    factor: Array = (1.0 + away * believed) * (1.0 + UNSURE * chance * believed**2)
    return factor
