"""The covariance of a least-squares solution by the delete-a-group jackknife, whose groups are blocks of time.

Residuals of real arms are correlated over about half a second and across joints, so the textbook covariance σ²(YᵀY)⁻¹ is 5–40 times too
small. Here one block of time after the other is left out, all joints together: CR3 of Bell and McCaffrey (2002), which keeps its
coverage down to a dozen blocks. The solution without block b differs from the full one by (G − G_b)⁻¹·g_b, so nothing is fitted anew.
"""

from collections.abc import Sequence

import numpy as np

from monitor.errors import Unidentifiable
from monitor.identify.fit.felt import Felt
from monitor.identify.fit.least_squares import Rows, Solution, residuals_of
from monitor.identify.signals.motion import Motion
from monitor.recording import Array, Indices

CORRELATED_S = 0.5  # time over which residuals of real arms are correlated: 0.4–0.55 s
WINDOW_STEPS = 6  # steps in a block: with six staggered partitions instead of one the covariance is smoother, and regular
LONG_STEPS = 36  # of the longer blocks, 4.8 s: what stays alike for seconds, as friction that depends on place or run-in, counts once
FEWEST_LONG = 8  # of the longer blocks
BATCH = 256  # blocks that are left out together: a bound on memory
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
        self._grams, self._scores, self._runs = _steps(recordings, weights, self._T, residuals)

    def covariances(self, width: int) -> list[Array]:
        """The S covariances with blocks of `width` steps. Raises Unidentifiable where too few such blocks are unbroken."""
        T, runs = self._T, self._runs
        windows = _windows(runs, width)[:: width // WINDOW_STEPS]  # of longer blocks as many staggered partitions as of the usual ones
        total = np.zeros((self._scores.shape[2], len(T), len(T)))
        for first in range(0, len(windows), BATCH):
            here = windows[first : first + BATCH]
            near = slice(here[0], here[-1] + width)
            G, g = (_moving_sum(part[near], width)[here - here[0]] for part in (self._grams, self._scores))  # (W, r, r), (W, r, S)
            # the rows are orthonormal in z, so G of all blocks is the identity and the eigenvalues of G_b are leverages, 0 … 1
            moved = np.linalg.solve(np.eye(T.shape[1]) - HIGHEST_LEVERAGE * G, g)  # (W, r, S)
            for k in range(len(total)):
                delta = moved[:, :, k] @ T.T
                total[k] += delta.T @ delta
        blocks = len(runs) / width
        return list(blocks / len(windows) * (blocks - 1.0) / blocks * total)

    def longer_covariances(self) -> list[Array]:
        """The S covariances with blocks as long as the recordings allow, up to `LONG_STEPS`; with blocks of the usual length at least."""
        width = min(LONG_STEPS, len(self._runs) // FEWEST_LONG)
        longest = int(np.max(np.bincount(_run_numbers(self._runs))))
        return self.covariances(max(WINDOW_STEPS, min(width, longest // 2)))


def _steps(
    recordings: Sequence[Rows], weights: Array, T: Array, residuals: Sequence[Sequence[Array]]
) -> tuple[Array, Array, list[tuple[int, int]]]:
    """Gram (K, r, r) and score (K, r, S) of each step, and the recording and unbroken stretch that it lies in."""
    grams, scores, runs = [], [], []
    for number, rec in enumerate(recordings):
        starts = np.flatnonzero(np.diff(rec.steps, prepend=-1))
        gram, score = _steps_of(rec, weights, T, np.stack([estimate[number] for estimate in residuals], axis=-1), starts)
        grams.append(gram)
        scores.append(score)
        runs += [(number, int(rec.segments[first])) for first in starts]
    return np.concatenate(grams), np.concatenate(scores), runs


def _steps_of(rec: Rows, weights: Array, T: Array, residuals: Array, starts: Indices) -> tuple[Array, Array]:
    """ZᵀZ (steps, r, r) and Zᵀe (steps, r, S) of each step's rows, Z = Y·T and e weighted. residuals : (N, J, S) [N·m].

    starts : first sample of each step.
    """
    scaled, ends = rec.root_weight * weights, np.append(starts[1:], len(rec.used))  # (N, J), (steps,)
    Y, r, S = Felt.of(rec.Y), T.shape[1], residuals.shape[2]
    J = len(Y.places)
    gram, score = np.zeros((len(starts), r, r)), np.zeros((len(starts), r, S))
    for piece, columns in Y.pieces():
        Z = np.empty((piece.stop - piece.start, J, r))
        for j, block in enumerate(columns):
            np.multiply(block @ T[Y.places[j]], scaled[piece, j, None], out=Z[:, j])
        e = residuals[piece] * scaled[piece, :, None]
        for k in np.flatnonzero((starts < piece.stop) & (ends > piece.start)):
            within = slice(max(0, starts[k] - piece.start), ends[k] - piece.start)
            rows = Z[within].reshape(-1, r)
            gram[k] += rows.T @ rows
            score[k] += rows.T @ e[within].reshape(-1, S)
    return gram, score


def _moving_sum(parts: Array, width: int) -> Array:
    """(K − width + 1, …) sums of `width` neighbours of parts (K, …), in as many additions as the width has binary digits."""
    half = width // 2
    if not half:
        return parts
    sums = _moving_sum(parts, half)
    both: Array = sums[: len(sums) - half] + sums[half:]  # of 2·half neighbours
    return both[: len(both) - 1] + parts[width - 1 :] if width % 2 else both


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
