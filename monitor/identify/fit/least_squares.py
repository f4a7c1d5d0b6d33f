"""Weighted least squares by joint, from triangular factors.

Each joint's rows are reduced to a triangular factor once. Another weight for a joint then costs nothing, so weighted least squares costs
what plain least squares does. A dense weight matrix would cost minutes: Raviola et al. (2021), §4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.recording import Array, Indices, Mask

EXCITED = 1e-6  # of the largest singular value, columns scaled alike: a smaller one is rounding or encoder noise


FELT = 1e-9  # of the largest column's norm: a smaller column is rounding, as of joints that never move together


class Rows(NamedTuple):
    """The equations torque = Y·x of one recording."""

    Y: Array  # (N, J, B) regressor of the unknowns
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J) the rows that are fitted
    steps: Indices  # (N,) number of the step (a sixth of a jackknife block) that each sample lies in, from 0
    segments: Indices  # (N,) number of the stretch without a hole that each sample lies in
    robust_weight: Array | None = None  # (N, J) weight of each row's square, 0 … 1, from a robust fit; None: 1 for all

    @property
    def root_weight(self) -> Array:
        """(N, J) factor on each row before its joint's weight; 0 where the row is not used."""
        return np.where(self.used, 1.0 if self.robust_weight is None else np.sqrt(self.robust_weight), 0.0)


class Factor(NamedTuple):
    """All that least squares needs to know of one joint's rows: RᵀR = [Y τ]ᵀ[Y τ]."""

    R: Array  # (≤ B + 1, B + 1), last column the torque
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """The parameters, and the directions of parameter space that the data determine."""

    values: Array  # (B,)
    directions: Array  # (B, r) values − prior = directions · z, and the weighted rows are orthonormal in z
    excited: Mask  # (B,) False where the value is, in part or in whole, the prior's


def factors(recordings: Sequence[Rows]) -> list[Factor]:
    """One factor of each joint, over all recordings."""
    result = []
    for j in range(recordings[0].Y.shape[1]):
        rows = []
        for rec in recordings:
            on = rec.used[:, j]
            weight = 1.0 if rec.robust_weight is None else np.sqrt(rec.robust_weight[on, j, None])
            rows.append(weight * np.column_stack([rec.Y[on, j], rec.torque_nm[on, j]]))
        stacked = np.concatenate(rows)  # (n, B + 1)
        result.append(Factor(triangle(stacked), len(stacked)))
    return result


class Projected:
    """One joint's rows, triangulated once. Columns of the joint's own can then be added to the factor at little cost, many times."""

    def __init__(self, recordings: Sequence[Rows], j: int) -> None:
        on = [rec.used[:, j] for rec in recordings]
        self._on = on
        self._root = [
            1.0 if rec.robust_weight is None else np.sqrt(rec.robust_weight[used, j, None])
            for rec, used in zip(recordings, on, strict=True)
        ]
        Y = self._stacked([rec.Y[:, j] for rec in recordings])
        self._B, self._j, self.samples = Y.shape[1], j, len(Y)
        self._felt = np.flatnonzero(np.any(Y != 0.0, axis=0))
        self._Q, self._R = np.linalg.qr(Y[:, self._felt])
        self._torque = self._stacked([rec.torque_nm[:, j, None] for rec in recordings])

    def with_own(self, columns: Sequence[Array], joints: int) -> Factor:
        """The factor with (N, E) more columns of each recording, in the unknowns [Y's; joint 1's own; joint 2's own; …]."""
        more = np.concatenate([self._stacked(columns), self._torque], axis=1)  # (n, E + 1)
        along = self._Q.T @ more
        rest = np.linalg.qr(more - self._Q @ along, mode="r")
        E = more.shape[1] - 1
        places = np.append(self._B + self._j * E + np.arange(E), self._B + joints * E)
        R = np.zeros((len(along) + len(rest), self._B + joints * E + 1))
        R[: len(along), self._felt] = self._R
        R[: len(along), places], R[len(along) :, places] = along, rest
        return Factor(R, self.samples)

    def _stacked(self, parts: Sequence[Array]) -> Array:
        return np.concatenate([root * part[used] for root, part, used in zip(self._root, parts, self._on, strict=True)])


def triangle(A: Array) -> Array:
    """R (r, B) with RᵀR = AᵀA, of A (n, B); r is the number of columns that are not all zero, or n if that is less."""
    felt = np.flatnonzero(np.any(A != 0.0, axis=0))  # a joint feels only the links outward of it, and its own friction
    part = np.linalg.qr(A[:, felt], mode="r")
    R = np.zeros((len(part), A.shape[1]))
    R[:, felt] = part
    return R


def solve(joints: Sequence[Factor], weights: Array, prior: Array, penalty: Array | None = None) -> Solution:
    """Least squares with each joint's rows times its weight (J,). Directions that the data do not excite stay at the prior (B,).

    penalty : (B,) one over the standard deviation of each parameter about its prior, 0 for a parameter without one; None: 0 for all.
    """
    stacked = np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])
    if penalty is not None:
        stacked = np.concatenate([stacked, np.column_stack([np.diag(penalty), penalty * prior])[penalty > 0.0]])
    A, b = stacked[:, :-1], stacked[:, -1]
    norms = np.linalg.norm(A, axis=0)
    norms = np.where(norms > FELT * np.max(norms, initial=0.0), norms, 0.0)
    A = np.where(norms > 0.0, A, 0.0)
    scale = np.where(norms > 0.0, norms, 1.0)  # kg, kg·m and N·m made comparable
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    keep = s > EXCITED * s[0]
    directions = Vt[keep].T / s[keep] / scale[:, None]  # (B, r)
    values = prior + directions @ (U[:, keep].T @ (b - A @ prior))
    hidden = np.sum(Vt[keep] ** 2, axis=0) < 1.0 - 1e-6  # part of this column lies outside what was kept
    return Solution(values=values, directions=directions, excited=~hidden & (norms > 0.0))


def residual_rms(joints: Sequence[Factor], values: Array) -> Array:
    """(J,) root mean square of each joint's residual [N·m]; 0 where a joint has no rows."""
    x = np.append(values, -1.0)
    return np.array([np.linalg.norm(factor.R @ x) / np.sqrt(max(factor.samples, 1)) for factor in joints])


def condition_number(joints: Sequence[Factor], columns: Indices) -> float:
    """cond(Ȳ_B) of these columns of the fitted rows, unweighted and in SI units: Raviola et al. (2021), table 3."""
    s = np.linalg.svd(np.concatenate([factor.R[:, :-1][:, columns] for factor in joints]), compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")


def best_condition(joints: Sequence[Factor], combination: Array, rows: Indices) -> float:
    """Condition number of the motion itself, whatever base was chosen: of the best columns, each scaled to unit length.

    combination : (B, P) base = combination · standard parameters; rows : of the base parameters that are fitted. The columns of all
    standard parameters are Y·combination, of which QR with pivoting chooses as many as there are base parameters.
    """
    Y = np.concatenate([factor.R[:, :-1][:, rows] for factor in joints]) @ combination[rows]
    norms = np.linalg.norm(Y, axis=0)
    felt = norms > FELT * np.max(norms, initial=0.0)
    if np.sum(felt) < len(rows):
        return float("inf")
    from scipy.linalg import qr

    scaled = Y[:, felt] / norms[felt]
    _, order = qr(scaled, mode="r", pivoting=True)
    s = np.linalg.svd(scaled[:, order[: len(rows)]], compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")


def residuals_of(recordings: Sequence[Rows], values: Array) -> list[Array]:
    """(N, J) of each recording [N·m]: measured torque less the torque of the parameters (B,)."""
    return [rec.torque_nm - rec.Y @ values for rec in recordings]
