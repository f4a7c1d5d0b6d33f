"""The covariance of a least-squares solution by the delete-a-group jackknife, whose groups are blocks of time.

Residuals of real arms are correlated over about half a second and across joints, so the textbook covariance σ²(YᵀY)⁻¹ is 5–40 times too
small. Here one block of time after the other is left out, all joints together: CR3 of Bell and McCaffrey (2002), which keeps its
coverage down to a dozen blocks. The solution without block b differs from the full one by (G − G_b)⁻¹·g_b, so nothing is fitted anew.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from monitor.errors import Unidentifiable
from monitor.identify.fit.felt import Felt
from monitor.identify.fit.least_squares import Rows, Solution, residuals_of
from monitor.identify.signals.motion import Motion
from monitor.recording import Array, Indices

CORRELATED_S = 0.5  # time over which residuals of real arms are correlated: 0.4–0.55 s
WINDOW_STEPS = 6  # steps in a block: with six staggered partitions instead of one the covariance is smoother, and regular
LONG_STEPS = 36  # of the longer blocks, 4.8 s: what stays alike for seconds, as friction that depends on place or run-in, counts once
FEWEST_LONG = 8  # of the longer blocks
HIGHEST_LEVERAGE = 1.0 - 1e-3  # of a block: the influence of a block that the rest cannot replace is limited to a thousandfold


def block_steps(moved: Motion, block_s: float) -> Indices:
    """(N,) number of the step that each sample lies in: six steps make a block of `block_s`, which the jackknife leaves out at once."""
    return moved.blocks(block_s / WINDOW_STEPS)


def jackknife_covariance(recordings: Sequence[Rows], weights: Array, solution: Solution) -> Array:
    """Covariance (B, B) of the solution's values. weights : (J,) of each joint's rows.

    It says how the residual of these recordings moves the parameters. It does not say what changes from one replay to the next.
    Raises Unidentifiable where the unbroken stretches are shorter than two blocks.
    """
    return jackknife_covariances(recordings, weights, solution, [residuals_of(recordings, solution.values)])[0]


def jackknife_covariances(
    recordings: Sequence[Rows], weights: Array, solution: Solution, residuals: Sequence[Sequence[Array]]
) -> list[Array]:
    """`jackknife_covariance` for each of S estimates of the noise: residuals[s][r] is (N, J) [N·m] for recording r."""
    return Blocks(recordings, weights, solution, residuals).covariances(WINDOW_STEPS)


class Blocks:
    """What each step of the recordings contributes, from which blocks of any length are left out.

    residuals : as for `jackknife_covariances`.
    """

    def __init__(self, recordings: Sequence[Rows], weights: Array, solution: Solution, residuals: Sequence[Sequence[Array]]) -> None:
        self._T = solution.directions  # (B, r)
        self._sums, self._runs = _running_sums(recordings, weights, self._T, residuals)

    def covariances(self, width: int) -> list[Array]:
        """The S covariances with blocks of `width` steps. Raises Unidentifiable where too few such blocks are unbroken."""
        # of longer blocks as many staggered partitions as of the usual ones
        windows = _windows(self._runs, width)[:: width // WINDOW_STEPS]
        r, sums = self._T.shape[1], self._sums
        moved = sums[windows + width, r:, :r] - sums[windows, r:, :r]  # (W, S, r)
        rest = np.empty((r, r))
        for first, scores in zip(windows, moved, strict=True):
            # the rows are orthonormal in z, so G of all blocks is the identity and the eigenvalues of G_b are leverages, 0 … 1
            np.subtract(sums[first, :r, :r], sums[first + width, :r, :r], out=rest)
            rest.ravel()[:: r + 1] += 1.0 / HIGHEST_LEVERAGE
            _, solved, failed = scipy.linalg.lapack.dposv(rest.T, scores.T)
            scores[:] = solved.T if not failed else np.linalg.solve(rest, scores.T).T  # failed: the rows are not quite orthonormal
        blocks = len(self._runs) / width
        scale = blocks / len(windows) * (blocks - 1.0) / blocks / HIGHEST_LEVERAGE**2
        return [scale * delta.T @ delta for delta in np.swapaxes(moved, 0, 1) @ self._T.T]

    def longer_covariances(self) -> list[Array]:
        """The S covariances with blocks as long as the recordings allow, up to `LONG_STEPS`; with blocks of the usual length at least."""
        width = min(LONG_STEPS, len(self._runs) // FEWEST_LONG)
        longest = int(np.max(np.bincount(_run_numbers(self._runs))))
        return self.covariances(max(WINDOW_STEPS, min(width, longest // 2)))


def _running_sums(
    recordings: Sequence[Rows], weights: Array, T: Array, residuals: Sequence[Sequence[Array]]
) -> tuple[Array, list[tuple[int, int]]]:
    """Sums (K + 1, r + S, r + S) of `_add_steps` over the steps before each, and the recording and stretch that each step lies in."""
    starts = [np.flatnonzero(np.diff(rec.steps, prepend=-1)) for rec in recordings]
    size = T.shape[1] + len(residuals)
    sums = np.zeros((1 + sum(map(len, starts)), size, size))
    runs: list[tuple[int, int]] = []
    for number, (rec, first) in enumerate(zip(recordings, starts, strict=True)):
        into = sums[1 + len(runs) : 1 + len(runs) + len(first)]
        _add_steps(into, rec, weights, T, np.stack([estimate[number] for estimate in residuals], axis=-1), first)
        runs += [(number, int(rec.segments[row])) for row in first]
    for k in range(1, len(sums)):  # row by row, in place: numpy's own running sum takes many times as long
        sums[k] += sums[k - 1]
    return sums, runs


def _add_steps(sums: Array, rec: Rows, weights: Array, T: Array, residuals: Array, starts: Indices) -> None:
    """Add [Z e]ᵀ[Z e] to sums (steps, r + S, r + S), of each step's rows Z = Y·T and residuals e, weighted.

    residuals : (N, J, S) [N·m]. starts : first sample of each step.
    """
    scaled, ends = rec.root_weight * weights, np.append(starts[1:], len(rec.used))  # (N, J), (steps,)
    Y, r, size = Felt.of(rec.Y), T.shape[1], sums.shape[1]
    for piece, columns in Y.pieces():
        Z = np.empty((piece.stop - piece.start, len(Y.places), size))
        for j, block in enumerate(columns):
            np.matmul(block, T[Y.places[j]], out=Z[:, j, :r])
        Z[:, :, r:] = residuals[piece]
        Z *= scaled[piece, :, None]
        for k in np.flatnonzero((starts < piece.stop) & (ends > piece.start)):
            rows = Z[max(0, starts[k] - piece.start) : ends[k] - piece.start].reshape(-1, size)
            if starts[k] < piece.start:
                sums[k] += rows.T @ rows
            else:
                np.matmul(rows.T, rows, out=sums[k])


def _run_numbers(runs: Sequence[tuple[int, int]]) -> Indices:
    """(K,) number of the unbroken stretch of each step, from 0."""
    return np.cumsum([k > 0 and runs[k] != runs[k - 1] for k in range(len(runs))])


def _windows(runs: Sequence[tuple[int, int]], width: int) -> Indices:
    """(W,) first steps of the blocks of `width` neighbouring steps; each block begins one step after the block before it.

    runs : the recording and the unbroken stretch of each step. No block reaches over a hole or into another recording.
    Raises Unidentifiable where there are fewer blocks than two partitions hold.
    """
    windows = [k for k in range(len(runs) - width + 1) if runs[k] == runs[k + width - 1]]
    if len(windows) < 2 * WINDOW_STEPS:
        raise Unidentifiable("the stretches without a gap are too short to say how sure the result is; expected several seconds unbroken")
    return np.array(windows)
