"""How much larger chance is, at every age of a change, than the filter's model of noise says: learnt from the arm's own past.

The filter whitens noise of one correlation time. Real noise has many: 1/f, humidity, the seasons. What matters to a change that began n
replays ago is how far chance alone moves the mean of n replays, and the bank of candidate changes measures just that: where nothing changed
and the model is true, score²/information of a candidate is χ² of one degree of freedom, with mean 1. Its mean over the past of the arm's
joints is the inflation of that age's variance, whatever causes it.

Wear must not excuse itself. A joint is measured by the other joints of its arm, and of its own by its falls only: wear never falls. And of
young ages a block of replays counts only when it is full, so that a change of all joints is found before it counts.

Shapes: N joints, J per arm, W starts of a change, 2 kinds of change (step, rate), 2 sides (fall, rise), G groups of starts of similar age.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from monitor.recording import Array

SIZES = (2, 2, 4, 8, 12, 6, 6, 8)  # number of starts in each group, W in all: about an octave of age each
GROUPS = len(SIZES)  # G
FIRST = np.cumsum((0, *SIZES))[:-1]  # (G,) index of the first start in each group
LAST = FIRST + SIZES - 1  # (G,) and of the last
MIDDLE = (FIRST + LAST + 1) // 2  # (G,) and of one in the middle
IN_BLOCKS = FIRST < 28  # (G,) ages whose replays count in blocks; of older ones one change is a small part of the past
AGES = np.array([0.0, 2.0, 4.0, 8.0, 16.0, 28.0, 50.0, 100.0])  # (G,) [replays] youngest age in each group, once a joint has 200 replays
LONGEST = 150.0  # [replays] length of the changes that the inflation of the oldest group is of
KINDS, SIDES = 2, 2
MEMORY_REPLAYS = 1000.0  # of the means: noise of years is learnt from years
LARGEST = 6.0  # [inflations] one score counts as no more: 1.4 % of those of healthy joints are larger
EXCESSES = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)  # of the variance at REFERENCE_AGE, for which inflation is computed …
POWERS = (1.0, 2.0)  # … with age to this power: noise that never averages out (1/f), and noise that wanders
REFERENCE_AGE = 22.0  # [replays]
PLAIN = 0.5  # prior probability that the model is true
OVERLAP = 0.5  # independent part of the scores of neighbouring ages, and of the two kinds
SPECTRUM_SCORES = 20.0  # [independent scores] weight of what the spectra above predict for an age against its own mean
LOPSIDED = 2.0  # times the rises the falls of an arm's joints are by chance at most, while joints may run in
TOGETHER = 0.8  # share of an arm's joints whose falls are above their rises, from which it runs in: no more falls than rises are chance
RATIO = 20.0  # [χ²] size of a likelihood ratio at the thresholds, where rarity matters: between 5.15² − 2·ln 10 and 4.95² − 2·ln 30, mostly
LEAST = 0.85  # least inflation: the model allows for wear that wanders, which makes it cautious at old ages


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chance:
    """Mean score²/information of candidate changes by age, and the inflation of variance that follows."""

    filling: Annotated[Array, "N 2 2 G"]  # sum over the block that is being filled
    filled: Annotated[Array, "N G"]  # [replays] in that block
    mean: Annotated[Array, "N 2 2 G"]  # over all full blocks
    replays: Annotated[Array, "N G"]  # [replays] that the mean is over
    inflation: Annotated[Array, "N 2 G"]  # of the variance of a change of this kind and age
    since: Annotated[Array, "N"]  # [replays] since the last change began, or since the first replay

    def of_starts(self) -> Array:
        """(N, 2, W) inflation of the variance of each candidate."""
        each: Array = np.repeat(self.inflation, SIZES, axis=2)
        return each

    def of_wear(self) -> Array:
        """(N,) inflation of the variance of wear, at least 1: that of a step since which wear was measured.

        Wear is measured over years, and the oldest candidate began `LONGEST` replays ago. Noise that shows at that age has not averaged
        out by then, and beyond it is assumed never to do so: its excess grows on with the length.
        """
        group = np.searchsorted(AGES, self.since, side="right") - 1
        shown: Array = np.maximum(self.inflation[np.arange(len(self.since)), 0, group], 1.0)
        return shown + (shown - 1.0) * np.maximum(self.since / LONGEST - 1.0, 0.0)

    def since_change(self, learnt: np.ndarray, changed: np.ndarray, agreeing: Array) -> "Chance":
        """After a replay that joints in `learnt` (N,) learned from; those in `changed` changed `agreeing` replays ago."""
        return replace(self, since=np.where(changed, agreeing, self.since + learnt))


def nothing_seen(joints: int) -> Chance:
    """Before the first replay: chance as the model says."""
    sums, counts = np.zeros((joints, KINDS, SIDES, GROUPS)), np.zeros((joints, GROUPS))
    return Chance(filling=sums, filled=counts, mean=sums, replays=counts, inflation=np.ones(sums[:, :, 0].shape), since=np.zeros(joints))


def learn_chance(
    chance: Chance, score: Array, information: Array, ages: Array, counts: np.ndarray, young: np.ndarray, joints_per_arm: int
) -> Chance:
    """After a replay. score, information : (N, 2, W) of the candidates, ages : (N, W), counts : (N,) whether the replay is evidence.

    young : (N,) joints that may run in now.
    """
    known = information > 0
    ratio = np.where(known, score**2 / np.where(known, information, 1.0), 0.0)
    ratio = np.minimum(ratio, LARGEST * chance.of_starts())
    number = np.maximum(np.add.reduceat(known, FIRST, axis=2, dtype=float), 1.0)
    fall, rise = (np.add.reduceat(np.where(side, ratio, 0.0), FIRST, axis=2) / number for side in (score < 0, score > 0))
    seen = counts[:, None] & np.logical_or.reduceat(known[:, 0], FIRST, axis=1)  # (N, G)
    filling = chance.filling + np.where(seen[:, None, None], np.stack([fall, rise], axis=2), 0.0)
    filled = chance.filled + seen
    full = filled > np.where(IN_BLOCKS, ages[:, LAST], 0.0)
    replays = np.where(full, np.minimum(chance.replays + filled, MEMORY_REPLAYS), chance.replays)
    share = np.where(full, 1.0 / np.maximum(replays, 1.0), 0.0)[:, None, None]
    learnt = replace(
        chance,
        filling=np.where(full[:, None, None], 0.0, filling),
        filled=np.where(full, 0.0, filled),
        mean=chance.mean + share * (filling - filled[:, None, None] * chance.mean),
        replays=replays,
    )
    falls = falls_by_chance(learnt.mean, young, joints_per_arm)
    learnt = replace(learnt, mean=np.stack([falls, learnt.mean[:, :, 1]], axis=2))
    return replace(learnt, inflation=inflation_of(learnt, ages[:, MIDDLE] + 1.0, joints_per_arm))


def inflation_of(chance: Chance, lengths: Array, joints_per_arm: int) -> Array:
    """(N, 2, G) inflation of the variance of changes; lengths : (N, G) [replays] of the groups' changes.

    The means are weighed against `spectrum`: at old ages a year holds few independent scores, and at young ones many.
    """
    number = (chance.replays / lengths)[:, None]  # (N, 1, G) independent scores of one joint
    both = chance.mean.sum(axis=2)
    weight = of_others(np.broadcast_to(number, both.shape), joints_per_arm) + 0.5 * number  # half of the own scores are falls …
    mean = of_others(number * both, joints_per_arm) + number * chance.mean[:, :, 0]  # … which add up to half of the own mean
    mean = mean / np.maximum(weight, 1e-9)
    expected = spectrum(mean, weight, lengths)
    inflated: Array = np.maximum((SPECTRUM_SCORES * expected + weight * mean) / (SPECTRUM_SCORES + weight), LEAST)
    return inflated


def falls_by_chance(mean: Array, young: np.ndarray, joints_per_arm: int) -> Array:
    """(N, 2, G) mean of the falls' scores, of the joints in `young` (N,) without what running-in makes.

    Chance has no side. In an arm that runs in, the falls of all joints together are far above their rises: no more of them than
    `LOPSIDED` times the rises is chance, and no more than the rises where nearly all joints fall.
    """
    fall, rise = (of_arm(mean[:, :, side], joints_per_arm) for side in (0, 1))
    falls_more = mean[:, :, 0] > np.maximum(mean[:, :, 1], 1.0 / SIDES)
    falling = of_arm(falls_more.astype(float), joints_per_arm)
    most = np.where(falling >= TOGETHER * joints_per_arm, 1.0, LOPSIDED) * np.maximum(rise, 0.5 * joints_per_arm)
    share = np.where(young[:, None, None], np.minimum(1.0, most / np.maximum(fall, 1e-9)), 1.0)
    falls: Array = mean[:, :, 0] * share
    return falls


def forget_chance(chance: Chance, which: np.ndarray) -> Chance:
    """The chance without what a change of the level left in the scores of the joints in `which` (N,).

    Chance has no side: of either, no more is kept than of the smaller one, or than the model of noise says.
    """
    mask, model = which[:, None, None, None], 1.0 / SIDES  # mean of χ² of one degree of freedom, on each side
    mean = np.maximum(chance.mean.min(axis=2, keepdims=True), model)
    filling = np.maximum(chance.filling.min(axis=2, keepdims=True), model * chance.filled[:, None, None])
    return replace(chance, filling=np.where(mask, filling, chance.filling), mean=np.where(mask, mean, chance.mean))


def spectrum(mean: Array, weight: Array, lengths: Array) -> Array:
    """(N, 1, G) inflation: a mixture over noise whose excess grows with age, by how well each explains the means of all ages.

    It is the inflation that makes a ratio at the threshold as rare as the mixture does, Σ p·exp(−RATIO/2/inflation), and not the mean
    inflation: false detections come from the arms whose noise of years does not show yet.

    mean, weight : (N, 2, G) mean of χ² of one degree of freedom times the inflation, and the number of independent ones in it.
    """
    shapes = [np.ones_like(lengths), *(1.0 + c * (lengths / REFERENCE_AGE) ** p for p in POWERS for c in EXCESSES)]
    inflation = np.stack(shapes)[:, :, None]  # (H, N, 1, G)
    prior = np.full((len(shapes), 1), np.log((1.0 - PLAIN) / (len(shapes) - 1)))
    prior[0] = np.log(PLAIN)
    likelihood = -0.5 * np.sum(weight * (np.log(inflation) + mean / inflation), axis=(2, 3))  # (H, N) logarithm
    log = prior + OVERLAP * likelihood / KINDS
    probability = np.exp(log - log.max(axis=0))
    probability /= probability.sum(axis=0)
    crossed = np.einsum("hn,hnkg->nkg", probability, np.exp(-0.5 * RATIO / inflation))
    expected: Array = -0.5 * RATIO / np.log(crossed)
    return expected


def of_arm(each: Array, joints_per_arm: int) -> Array:
    """The sum over the joints of the arm, shaped as `each` (N, …)."""
    arms = each.reshape(-1, joints_per_arm, *each.shape[1:])
    return np.repeat(arms.sum(axis=1), joints_per_arm, axis=0)


def of_others(each: Array, joints_per_arm: int) -> Array:
    """The sum over the other joints of the arm, shaped as `each` (N, …)."""
    arms = each.reshape(-1, joints_per_arm, *each.shape[1:])
    others: Array = (arms.sum(axis=1, keepdims=True) - arms).reshape(each.shape)
    return others
