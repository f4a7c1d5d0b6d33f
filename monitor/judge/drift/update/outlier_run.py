"""What an outlier says beside the one before it, from which the filter has not learned.

The filter keeps its prediction during outliers in a row, so their innovations share the noise that lasts from one replay to the next. Taken
as independent, three of them would say 1.7 times of a step what they say at ρ = 0.5, and twice at ρ = 0.9. What is new in one, given the
one before, is e = ν − ψ·ν₋₁ of variance S − ψ²·S₋₁, with ψ the regression of the two (Särkkä, 2013, ch. 4: prediction from the last value).
"""

from typing import NamedTuple

import numpy as np

from monitor.judge.drift.filter_state import NOISE, OUTLIER, RATE, FilterState
from monitor.judge.drift.update.innovation import Gate, Innovation
from monitor.recording import Array

LEAST_RHO = 0.05  # below, noise of the last replay is gone
MOST_EXPLAINED = 0.95  # of an innovation's standard deviation, and of the variance of noise that is left when all other states are known


class OutlierRun(NamedTuple):
    """Each joint's innovation beside that of the outlier before it; 0 where there was none on the same side, (N,) each."""

    before: Array  # ν₋₁
    before_var: Array  # S₋₁
    psi: Array  # ψ: how much of the innovation it explains, with the level that both share
    phi: Array  # φ: how much of the noise
    rho: Array  # the noise's correlation
    value: Array  # e
    var: Array  # its variance

    def last_effect(self, effect: Array, responses: Array, interval_days: Array) -> Array:
        """(N, 2, W) what a unit change added to the innovation before, from what it adds to this one; responses : (N, 2, W, S)."""
        decay = np.maximum(self.rho, LEAST_RHO)[:, None, None]
        return effect - responses[..., RATE] * interval_days[:, None, None] + responses[..., NOISE] * (1.0 / decay - 1.0)

    def with_noise_seen(self, mean: Array, cov: Array, n: np.ndarray) -> tuple[Array, Array]:
        """Mean and covariance of the joints n, whose noise the outlier before has shown where friction has not changed."""
        mean, cov = mean[n].copy(), cov[n].copy()
        mean[:, NOISE] += self.phi[n] * self.before[n]
        others = np.delete(np.arange(mean.shape[1]), NOISE)
        cross = cov[:, NOISE, others]
        inverse = np.linalg.pinv(cov[:, others[:, None], others], hermitian=True)
        alone = cov[:, NOISE, NOISE] - np.einsum("na,nab,nb->n", cross, inverse, cross)
        cov[:, NOISE, NOISE] -= np.minimum(self.phi[n] ** 2 * self.before_var[n], MOST_EXPLAINED * np.maximum(alone, 0.0))
        return mean, cov


def outlier_run(state: FilterState, innovation: Innovation, gate: Gate, rho: Array) -> OutlierRun:
    """The innovations beside those of the outliers before them. rho : (N,) correlation of the noise of successive replays.

    Where work is observed beside replays, the last innovation may be the other source's, and nothing is taken off.
    """
    joined = gate.gated & (np.abs(gate.run) >= 2.0) & (state.event == OUTLIER) & (state.normalised != 0.0) & (state.sources is None)
    before = np.where(joined, state.innovation, 0.0)
    before_var = np.where(joined, (before / np.where(joined, state.normalised, 1.0)) ** 2, 0.0)
    level = innovation.level_var
    lasting = rho * np.maximum(before_var - innovation.within_var - level, 0.0)
    safe = np.where(joined, before_var, 1.0)
    most = MOST_EXPLAINED * np.sqrt(innovation.var / safe)  # what is believed of noise may have changed in between
    psi, phi = (np.where(joined, np.minimum(shared / safe, most), 0.0) for shared in (lasting + level, lasting))
    return OutlierRun(before, before_var, psi, phi, rho, innovation.value - psi * before, innovation.var - psi**2 * before_var)
