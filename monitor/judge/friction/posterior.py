"""What is believed of any weighted sum of the states: a mixture over kinds of noise, and over "nothing changed" and every change.

Weights are E_h·{1, hazard·days_c·LR_hc}: changes are as frequent as `onsets_per_year` says, and those that were not told yet count too.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from monitor.judge.friction.changes import SHAPES, Bank, ChangePriors
from monitor.recording import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mixture:
    """K Gaussian components of N channels, (K, N) each; weights sum to 1."""

    weight: Array
    mean: Array
    var: Array

    def moments(self) -> tuple[Array, Array]:
        """Mean and variance, (N,) each."""
        return over_kinds(self.weight, self.mean, self.var)

    def below(self, value: Array) -> Array:
        """(N,) probability of less than value (N,)."""
        z = (value - self.mean) / np.sqrt(np.maximum(self.var, 1e-18))
        probability: Array = (self.weight * scipy.special.ndtr(z)).sum(axis=0)
        return probability

    def quantile(self, share: float) -> Array:
        """(N,) value below which so much of the mixture lies, by bisection."""
        std = np.sqrt(np.maximum(self.var, 1e-18))
        low, high = (self.mean - 9.0 * std).min(axis=0), (self.mean + 9.0 * std).max(axis=0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            under = self.below(middle) < share
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        value: Array = 0.5 * (low + high)
        return value


def over_kinds(p: Array, mean: Array, var: Array) -> tuple[Array, Array]:
    """Mean and variance (…,) of a mixture, over kinds of noise or other components, of (H, …) each."""
    centre = (p * mean).sum(axis=0)
    return centre, (p * (var + (mean - centre) ** 2)).sum(axis=0)


def mixture(row: Array, x: Array, P: Array, p: Array, bank: Bank, replays: Array, priors: ChangePriors, onsets_per_year: float) -> Mixture:
    """What is believed of row·states. row : (D, N), x : (H, D, N), P : (H, D, D, N), p : (H, N)."""
    N = row.shape[1]
    mean = np.einsum("hdn,dn->hn", x, row)
    var = np.einsum("hijn,in,jn->hn", P, row, row)
    size, v = bank.sizes(priors)
    lr = bank.evidence(replays, priors)
    effect = np.einsum("hdckn,dn->hckn", bank.B, row.astype(np.float32))[:, :, SHAPES]
    weight = (onsets_per_year / 365.0) * p[:, None, None] * np.exp(np.minimum(lr, 80.0))
    of_changes = weight, mean[:, None, None] + effect * size, var[:, None, None] + effect**2 * v
    each = [np.concatenate([unchanged, changed.reshape(-1, N)]) for unchanged, changed in zip((p, mean, var), of_changes, strict=True)]
    return Mixture(weight=each[0] / each[0].sum(axis=0), mean=each[1], var=each[2])
