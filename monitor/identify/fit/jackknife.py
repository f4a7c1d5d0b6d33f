"""The covariance of a least-squares solution by the delete-a-group jackknife, whose groups are blocks of time.

Residuals of real arms are correlated over about half a second and across joints, so the textbook covariance σ²(YᵀY)⁻¹ is 5–40 times too
small. Here one block of time after the other is left out, all joints together: CR3 of Bell and McCaffrey (2002), which keeps its
coverage down to a dozen blocks. The solution without block b differs from the full one by (G − G_b)⁻¹·g_b, so nothing is fitted anew.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from monitor.errors import Unidentifiable
from monitor.identify.fit.least_squares import Felt, Rows, Solution, residuals_of
from monitor.identify.signals.motion import Motion
from monitor.recording import Array, Indices

CORRELATED_S = 0.5  # time over which residuals of real arms are correlated: 0.4–0.55 s
WINDOW_STEPS = 6  # steps in a block: with six staggered partitions instead of one the covariance is smoother, and regular
LONG_STEPS = 36  # of the longer blocks, 4.8 s: what stays alike for seconds, as friction that depends on place or run-in, counts once
FEWEST_LONG = 8  # of the longer blocks
SHORT = 256  # samples whose rows stay in the processor's memory
HIGHEST_LEVERAGE = 1.0 - 1e-3  # of a block: the influence of a block that the rest cannot replace is limited to a thousandfold


def block_steps(moved: Motion, block_s: float) -> Indices:
    """(N,) number of the step that each sample lies in: six steps make a block of `block_s`, which the jackknife leaves out at once."""
    return moved.blocks(block_s / WINDOW_STEPS)


def jackknife_covariance(recordings: Sequence[Rows], weights: Array, solution: Solution) -> Array:
    """Covariance (B, B) of the solution's values. weights : (J,) of each joint's rows.

    It says how the residual of these recordings moves the parameters. It does not say what changes from one replay to the next.
    Raises Unidentifiable where the unbroken stretches are shorter than two blocks.
    """
    residuals = [residuals_of(recordings, solution.values)]
    (covariance,) = _covariances(recordings, _runs(recordings), weights, solution, residuals, [WINDOW_STEPS])[0]
    return covariance


class Covariances(NamedTuple):
    """Covariances (B, B) by each of S estimates of the noise."""

    usual: list[Array]  # with blocks of `WINDOW_STEPS`
    longer: list[Array]  # with blocks as long as the recordings allow, up to `LONG_STEPS`


def jackknife_covariances(
    recordings: Sequence[Rows], weights: Array, solution: Solution, residuals: Sequence[Sequence[Array]]
) -> Covariances:
    """`jackknife_covariance` for each of S estimates of the noise, with blocks of two lengths.

    residuals : [s][r] is (N, J) [N·m] of estimate s for recording r.
    """
    runs = _runs(recordings)
    longest = int(np.max(np.bincount(runs), initial=0))
    long = max(WINDOW_STEPS, min(LONG_STEPS, len(runs) // FEWEST_LONG, longest // 2))
    return Covariances(*_covariances(recordings, runs, weights, solution, residuals, [WINDOW_STEPS, long]))


def _covariances(
    recordings: Sequence[Rows],
    runs: Indices,
    weights: Array,
    solution: Solution,
    residuals: Sequence[Sequence[Array]],
    widths: Sequence[int],
) -> list[list[Array]]:
    """Of each width the S covariances with blocks of so many steps. Raises Unidentifiable where too few such blocks are unbroken.

    runs : `_runs` of the recordings.
    """
    T = solution.directions  # (B, r)
    # of longer blocks as many staggered partitions as of the usual ones
    windows = [_windows(runs, width)[:: width // WINDOW_STEPS] for width in widths]
    ends = [set((first + width).tolist()) for first, width in zip(windows, widths, strict=True)]
    moved: list[list[Array]] = [[] for _ in widths]  # of each block, (S, r)
    last = deque[Array](maxlen=max(widths) + 1)  # all sums of a long recording would fill the memory
    for k, sums in enumerate(_running_sums(recordings, weights, T, residuals)):
        last.append(sums)
        for width, ending, into in zip(widths, ends, moved, strict=True):
            if k in ending:
                into.append(_moved(last[-1 - width], sums, T.shape[1]))
    result = []
    for width, first, deltas in zip(widths, windows, moved, strict=True):
        blocks = len(runs) / width
        scale = blocks / len(first) * (blocks - 1.0) / blocks / HIGHEST_LEVERAGE**2
        result.append([scale * delta.T @ delta for delta in (one @ T.T for one in np.stack(deltas, axis=1))])  # (W, B) each
    return result


def _moved(before: Array, after: Array, r: int) -> Array:
    """(S, r) how far the solution moves in z without the rows between two of the `_running_sums`, whose lower triangles alone are read.

    The rows are orthonormal in z, so G of all blocks is the identity and the eigenvalues of G_b are leverages, 0 … 1.
    """
    block = before - after
    rest, scores = block[:r, :r] + np.eye(r) / HIGHEST_LEVERAGE, block[r:, :r].T
    _, moved, failed = scipy.linalg.lapack.dposv(rest, scores, lower=1)
    if failed:  # the rows are not quite orthonormal
        moved = np.linalg.solve(np.tril(rest) + np.tril(rest, -1).T, scores)
    return np.asarray(moved.T)


def _runs(recordings: Sequence[Rows]) -> Indices:
    """(K,) number of the unbroken stretch that each step lies in, from 0; a recording ends it too."""
    changes = []
    for rec in recordings:
        segments = rec.segments[_starts(rec)]
        changes.append(np.append(True, segments[1:] != segments[:-1])[: len(segments)])
    return np.cumsum(np.concatenate(changes)) - 1


def _starts(rec: Rows) -> Indices:
    """(K,) first sample of each step of one recording."""
    return np.flatnonzero(np.diff(rec.steps, prepend=-1))


def _running_sums(recordings: Sequence[Rows], weights: Array, T: Array, residuals: Sequence[Sequence[Array]]) -> Iterator[Array]:
    """Sums (r + S, r + S) of [Z e]ᵀ[Z e] over the steps before each step, and over all, of the rows Z = Y·T and residuals e, weighted.

    Only the lower triangles are formed.
    """
    r, size = T.shape[1], T.shape[1] + len(residuals)
    sums = np.zeros((size, size), order="F")
    yield sums
    for number, rec in enumerate(recordings):
        starts, scaled, Y = _starts(rec), rec.root_weight * weights, Felt.of(rec.Y)  # (K,), (N, J)
        left = np.stack([estimate[number] for estimate in residuals], axis=-1)  # (N, J, S)
        ends = np.append(starts[1:], len(rec.used))
        for piece, columns in Y.pieces(SHORT):
            Z = np.empty((piece.stop - piece.start, len(Y.places), size))
            for j, block in enumerate(columns):
                np.matmul(block * scaled[piece, j, None], T[Y.places[j]], out=Z[:, j, :r])
            np.multiply(left[piece], scaled[piece, :, None], out=Z[:, :, r:])
            within = (starts < piece.stop) & (ends > piece.start)
            for first, end in zip((starts[within] - piece.start).tolist(), (ends[within] - piece.start).tolist(), strict=True):
                rows = Z[max(0, first) : end].reshape(-1, size)
                sums = scipy.linalg.blas.dsyrk(1.0, rows.T, beta=1.0, c=sums, lower=1)
                if end <= len(Z):  # else the step goes on in the next piece
                    yield sums


def _windows(runs: Indices, width: int) -> Indices:
    """(W,) first steps of the blocks of `width` neighbouring steps; each block begins one step after the block before it.

    runs : `_runs`. No block reaches over a hole or into another recording.
    Raises Unidentifiable where there are fewer blocks than two partitions hold.
    """
    windows = np.flatnonzero(runs[: max(0, len(runs) - width + 1)] == runs[width - 1 :])
    if len(windows) < 2 * WINDOW_STEPS:
        raise Unidentifiable("the stretches without a gap are too short to say how sure the result is; expected several seconds unbroken")
    return windows
