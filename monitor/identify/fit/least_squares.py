"""Least squares by joint: triangular factors, the solution where the data support one, and a covariance that can be believed.

Every joint's rows are reduced to a triangular factor once; scaling a joint's rows by another weight then costs nothing, so weighted
least squares costs what plain least squares does (a dense weight matrix costs minutes: Raviola et al. (2021), §4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.signals.motion import Indices, Mask
from monitor.recording import Array

EXCITED = 1e-6  # of the largest singular value, columns scaled alike: below it a direction is rounding or encoder noise
WINDOW_STEPS = 6  # steps in a block: six staggered partitions instead of one make the covariance smoother, and regular
HIGHEST_LEVERAGE = 1.0 - 1e-3  # a block without which the rest says next to nothing counts a thousandfold, not infinitely


class Rows(NamedTuple):
    """Equations of one recording."""

    Y: Array  # (N, J, B) base regressor
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J)
    steps: Indices  # (N,) number of the step of 1/6 block each sample lies in, from 0
    segments: Indices  # (N,) number of the stretch without a hole
    robust_weight: Array | None = None  # (N, J) weight of each row's square, 0 … 1, from a robust fit; None: all alike

    @property
    def root_weight(self) -> Array:
        """(N, J) what each row is multiplied by, before its joint's weight; 0 where it is not used."""
        return np.where(self.used, 1.0 if self.robust_weight is None else np.sqrt(self.robust_weight), 0.0)


class Factor(NamedTuple):
    """Everything that least squares needs to know of one joint's rows: RᵀR = [Y τ]ᵀ[Y τ]."""

    R: Array  # (≤ B + 1, B + 1), last column the torque
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """The parameters, and the directions of parameter space that the data speak of."""

    values: Array  # (B,)
    directions: Array  # (B, r): values − prior = directions · z, and the weighted rows are orthonormal in z
    excited: Mask  # (B,) False where the value is, in part or in whole, the prior's


def factors(recordings: Sequence[Rows]) -> list[Factor]:
    """One factor a joint over all recordings."""
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
    """One joint's rows, triangulated for good; columns of its own are added to the factor at little cost, time and again."""

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
        """The factor with (N, E) columns of each recording, unknowns [Y's; joint 1's own; …]."""
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


def merged(one: Sequence[Factor], other: Sequence[Factor]) -> list[Factor]:
    """The factors of both sets of rows together: recordings may come one after the other, and none has to be kept."""
    return [Factor(triangle(np.concatenate([a.R, b.R])), a.samples + b.samples) for a, b in zip(one, other, strict=True)]


def triangle(A: Array) -> Array:
    """R (r, B) with RᵀR = AᵀA, of A (n, B); r is the number of columns that are not all zero, or n if that is less."""
    felt = np.flatnonzero(np.any(A != 0.0, axis=0))  # a joint feels only the links outward of it, and its own friction
    part = np.linalg.qr(A[:, felt], mode="r")
    R = np.zeros((len(part), A.shape[1]))
    R[:, felt] = part
    return R


def solve(joints: Sequence[Factor], weights: Array, prior: Array, penalty: Array | None = None) -> Solution:
    """Least squares with each joint's rows times its weight (J,); what the data do not excite stays at the prior (B,).

    penalty : (B,) or None, one over the standard deviation with which each parameter is expected at its prior; 0 for no opinion.
    """
    stacked = np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])
    if penalty is not None:
        stacked = np.concatenate([stacked, np.column_stack([np.diag(penalty), penalty * prior])[penalty > 0.0]])
    A, b = stacked[:, :-1], stacked[:, -1]
    norms = np.linalg.norm(A, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)  # kg, kg·m and N·m made comparable
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    keep = s > EXCITED * s[0]
    directions = Vt[keep].T / s[keep] / scale[:, None]  # (B, r)
    values = prior + directions @ (U[:, keep].T @ (b - A @ prior))
    hidden = np.sum(Vt[keep] ** 2, axis=0) < 1.0 - 1e-6  # part of this column lies outside what was kept
    return Solution(values=values, directions=directions, excited=~hidden & (norms > 0.0))


def residual_rms(joints: Sequence[Factor], values: Array) -> Array:
    """(J,) root mean square of each joint's residual; 0 where a joint has no rows [N·m]."""
    x = np.append(values, -1.0)
    return np.array([np.linalg.norm(factor.R @ x) / np.sqrt(max(factor.samples, 1)) for factor in joints])


def condition_number(joints: Sequence[Factor], columns: Indices) -> float:
    """cond(Ȳ_B) of these columns of the rows used, unweighted and in SI units, as the paper quotes it."""
    s = np.linalg.svd(np.concatenate([factor.R[:, :-1][:, columns] for factor in joints]), compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")


def residuals_of(recordings: Sequence[Rows], values: Array) -> list[Array]:
    """(N, J) of each recording: torque less what the parameters (B,) say [N·m]."""
    return [rec.torque_nm - rec.Y @ values for rec in recordings]


def jackknife_covariance(recordings: Sequence[Rows], weights: Array, solution: Solution) -> Array:
    """Covariance (B, B) from leaving out one block of time after the other, all joints together.

    Residuals are correlated over about half a second and across joints, so σ²(YᵀY)⁻¹ is 5–40 times too small. The estimate
    without block b differs from the full one by (G − G_b)⁻¹·g_b, without having to be computed anew; the sum of the squares of those
    differences is the delete-a-group jackknife (CR3 of Bell and McCaffrey (2002)), which keeps its coverage down to a dozen blocks.
    It says how what the model left of this recording moves the parameters, not what changes from one replay to the next.
    """
    return jackknife_covariances(recordings, weights, solution, [residuals_of(recordings, solution.values)])[0]


def jackknife_covariances(
    recordings: Sequence[Rows], weights: Array, solution: Solution, residuals: Sequence[Sequence[Array]]
) -> list[Array]:
    """`jackknife_covariance` for each of several opinions of what the noise was: (N, J) of each recording [N·m]."""
    T = solution.directions  # (B, r)
    grams, scores, runs = [], [], []
    for number, rec in enumerate(recordings):
        scaled = rec.root_weight * weights  # (N, J)
        A = rec.Y * scaled[:, :, None]  # (N, J, B)
        e = np.stack([opinion[number] * scaled for opinion in residuals], axis=-1)  # (N, J, S)
        starts = np.flatnonzero(np.diff(rec.steps, prepend=-1))
        for first, last in zip(starts, [*starts[1:], len(e)], strict=True):
            Z = A[first:last].reshape(-1, A.shape[2]) @ T  # (n·J, r)
            grams.append(Z.T @ Z)
            scores.append(Z.T @ e[first:last].reshape(-1, len(residuals)))  # (r, S)
            runs.append((number, int(rec.segments[first])))
    windows = _windows(runs)
    within = windows[:, None] + np.arange(WINDOW_STEPS)  # (W, 6) steps of each block
    G, g = np.sum(np.array(grams)[within], axis=1), np.sum(np.array(scores)[within], axis=1)  # (W, r, r), (W, r, S)
    # the rows are orthonormal in z, so G of all blocks is the identity and the eigenvalues of G_b are leverages, 0 … 1
    moved = np.linalg.solve(np.eye(T.shape[1]) - HIGHEST_LEVERAGE * G, g)  # (W, r, S)
    blocks = len(runs) / WINDOW_STEPS
    factor = blocks / len(windows) * (blocks - 1.0) / blocks
    return [factor * (delta.T @ delta) for delta in (moved[:, :, k] @ T.T for k in range(len(residuals)))]


def _windows(runs: Sequence[tuple[int, int]]) -> Indices:
    """(W,) first steps of blocks of six neighbouring ones, each block one step on; none reaches over a hole or into another recording.

    Raises Unidentifiable where no stretch is a block long.
    """
    windows = [k for k in range(len(runs) - WINDOW_STEPS + 1) if runs[k] == runs[k + WINDOW_STEPS - 1]]
    if len(windows) < 2 * WINDOW_STEPS:
        raise Unidentifiable("the stretches without a gap are too short to say how sure the result is; expected several seconds unbroken")
    return np.array(windows)
