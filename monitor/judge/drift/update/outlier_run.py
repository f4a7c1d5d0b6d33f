"""What outliers in a row say together of a change, when one is found by them.

The filter keeps its prediction during outliers, so their innovations share the noise that lasts from one replay to the next. The bank of
candidates counts them as independent: of a step, three of them would say 1.7 times what they say at ρ = 0.5, and twice at ρ = 0.9. What is
new in one, given the one before, is e = ν − ψ·ν₋₁ of variance S − ψ²·S₋₁, with ψ the regression of the two (Särkkä, 2013, ch. 4: prediction
from the last value). A change that adds G to ν and G₋₁ to ν₋₁ adds G − ψ·G₋₁ to e.

Shapes: N joints, W starts of a change, 2 kinds of change.
"""

from typing import NamedTuple

import numpy as np

from monitor.judge.drift.filter_state import NOISE, RATE
from monitor.judge.drift.update.innovation import Innovation, Noise
from monitor.recording import Array

MOST_EXPLAINED = 0.95  # of an innovation's standard deviation, and of the variance of noise that is left when all other states are known
LEAST_RHO, MOST_FADED = 0.05, 1e3  # noise that lasts less than the one, or faded by more than the other, is gone
LEAST_LEFT = 0.1  # share of a candidate's information that is left: starts before the run are corrected to first order


class ChangeSums(NamedTuple):
    """What the bank has summed of each candidate, (N, 2, W)."""

    score: Array  # Σ G·ν/S, with ν in full
    information: Array  # Σ G²/S

    def of_joints(self, n: np.ndarray) -> "ChangeSums":
        """The sums of the joints n."""
        return ChangeSums(self.score[n], self.information[n])

    def each_outlier(self, count: int) -> tuple[Array, Array]:
        """ν and S of the youngest `count` replays from which the filter has not learned, (N, count) by age.

        A step is in each of them in full, so the scores of two successive starts differ by ν/S.
        """
        score, information = (np.diff(sums[:, 0, :count], axis=1, prepend=0.0) for sums in self)
        information = np.maximum(information, 1e-12)
        return score / information, 1.0 / information


class OutlierRun(NamedTuple):
    """What the outliers before this replay say less than the bank counts, and what the last of them says of the noise now."""

    before: ChangeSums  # to be added to the sums of the replays before this one …
    now: ChangeSums  # … and to those with this one
    nu: Array  # (N,) ν₋₁; 0 where there is no outlier before in the run
    var: Array  # (N,) S₋₁
    phi: Array  # (N,) φ: the noise that ν₋₁ leads to expect now, over ν₋₁
    last_effect: Array  # (N, 2, W) G₋₁
    length: Array  # (N,) number of outliers; 0 or 1 where there is nothing to be said

    def left_of(self, sums: ChangeSums, more: ChangeSums) -> ChangeSums:
        """The sums with `before` or `now` added."""
        information = np.maximum(sums.information + more.information, LEAST_LEFT * sums.information)
        return ChangeSums(sums.score + more.score, information)

    def with_noise_seen(self, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Mean (N, S) and covariance (N, S, S) where the outlier before has shown the noise of friction that has not changed."""
        if not self.phi.any():  # most changes are found by no outliers
            return mean, cov
        mean, cov = mean.copy(), cov.copy()
        mean[:, NOISE] += self.phi * self.nu
        others = np.delete(np.arange(mean.shape[1]), NOISE)
        cross = cov[:, NOISE, others]
        inverse = np.linalg.pinv(cov[:, others[:, None], others], hermitian=True)
        alone = cov[:, NOISE, NOISE] - np.einsum("na,nab,nb->n", cross, inverse, cross)
        cov[:, NOISE, NOISE] -= np.minimum(self.phi**2 * self.var, MOST_EXPLAINED * np.maximum(alone, 0.0))
        return mean, cov


def outlier_run(
    bank: ChangeSums,
    effect: Array,
    responses: Array,
    ages: Array,
    innovation: Innovation,
    noise: Noise,
    length: Array,
    interval_days: Array,
) -> OutlierRun:
    """The outliers in a row of which this replay is the last.

    bank : of the replays before this one. effect : (N, 2, W) of a unit change on this replay; responses : (N, 2, W, S); ages : (N, W).
    length : (N,) number of outliers, at most as many as there are starts without a gap; 0 or 1 where there is nothing to be said.

    Innovation and variance of each are read from the bank. What belongs to a replay alone is taken to be as large as in the present one.
    """
    most = max(int(length.max(initial=0.0)), 2)
    nu, S = bank.each_outlier(most + 1)
    nu[:, 0], S[:, 0] = innovation.value, innovation.var
    level = np.maximum(innovation.level_var, 0.0)[:, None]
    lasting = noise.rho[:, None] * np.clip(S - innovation.within_var[:, None] - level, 0.0, noise.var[:, None])
    there = (np.arange(most + 1) >= 1) & (np.arange(most + 1) < length[:, None])  # outliers before this one
    faded = responses[..., NOISE]  # what the filter has taken for noise of a change that began before the run
    use = responses[..., RATE] * interval_days[:, None, None]

    def added(age: int) -> Array:
        """(N, 2, W) G of the replay so many replays ago."""
        faded_since = np.minimum(np.maximum(noise.rho, LEAST_RHO) ** -age, MOST_FADED)[:, None, None]
        return np.where(ages[:, None, :] >= age, effect + (faded_since - 1.0) * faded - age * use, 0.0)

    before, now = (ChangeSums(np.zeros_like(effect), np.zeros_like(effect)) for _ in range(2))
    for age in range(most - 1, -1, -1):
        joined = there[:, age + 1] & (there[:, age] | (age == 0))
        explained = np.minimum((lasting[:, age + 1] + level[:, 0]) / S[:, age + 1], MOST_EXPLAINED * np.sqrt(S[:, age] / S[:, age + 1]))
        psi = np.where(joined, np.minimum(explained, MOST_EXPLAINED), 0.0)
        new, var = nu[:, age] - psi * nu[:, age + 1], S[:, age] - psi**2 * S[:, age + 1]
        G = added(age)
        G_new = G - psi[:, None, None] * added(age + 1)
        here = joined[:, None, None]
        before = now
        now = ChangeSums(
            before.score + np.where(here, G_new * (new / var)[:, None, None] - G * (nu / S)[:, age, None, None], 0.0),
            before.information + np.where(here, G_new**2 / var[:, None, None] - G**2 / S[:, age, None, None], 0.0),
        )
    last = there[:, 1]
    return OutlierRun(
        before=before,
        now=now,
        nu=np.where(last, nu[:, 1], 0.0),
        var=np.where(last, S[:, 1], 0.0),
        phi=np.where(last, np.minimum(lasting[:, 1] / S[:, 1], MOST_EXPLAINED * np.sqrt(innovation.var / S[:, 1])), 0.0),
        last_effect=added(1),
        length=length,
    )
