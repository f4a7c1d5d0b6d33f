"""The regressor of a recording in the unknowns of a fit, as far as each joint feels them, in pieces.

A joint feels the links outward of it and its own friction, so a third of Y (N, J, X) is zero and is not formed. The rest of a long
recording would fill the memory: it is formed anew, piece by piece, whenever it is needed.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy

from monitor.recording import Array, Indices, Mask

PIECE = 16384  # samples; 20 MB for six joints. A shorter recording is formed once and kept

Make = Callable[[slice | Indices], list[Array]]  # samples → of each joint the columns that it feels, (n, K)


class Felt:
    """Y (N, J, X) of one recording. Where it is read like an array, samples come first, and only the samples asked for are formed."""

    def __init__(self, samples: int, unknowns: int, places: Sequence[Indices], make: Make) -> None:
        """From `make`, and `places`: of each joint, where the columns that it forms lie among the X unknowns."""
        self.samples, self.unknowns, self.places = samples, unknowns, tuple(places)
        # what is kept is not made again: `make` may hold this object's parent, which holds this one, and memory held in a circle stays
        kept = make(slice(0, samples)) if samples <= PIECE else None
        self._make: Make = make if kept is None else lambda at: [block[at] for block in kept]
        self._thinned: dict[tuple[int, int], Felt] = {}  # a fit asks for the same ones several times

    @classmethod
    def of(cls, Y: "Array | Felt") -> "Felt":
        """The same of an array (N, J, X)."""
        if isinstance(Y, Felt):
            return Y
        dense = Y
        places = [np.flatnonzero(np.any(dense[:, j] != 0.0, axis=0)) for j in range(dense.shape[1])]
        return cls(len(dense), dense.shape[2], places, lambda at: [dense[at, j][:, own] for j, own in enumerate(places)])

    @property
    def shape(self) -> tuple[int, int, int]:
        """N, J, X."""
        return self.samples, len(self.places), self.unknowns

    def __len__(self) -> int:
        return self.samples

    def at(self, samples: slice | Indices) -> list[Array]:
        """Of each joint the columns that it feels, (n, K), at these samples."""
        return self._make(samples)

    def pieces(self, length: int = PIECE) -> Iterator[tuple[slice, list[Array]]]:
        """The samples of each piece of at most this length, and `at` of them."""
        for first in range(0, self.samples, PIECE):  # formed at once
            whole = slice(first, min(first + PIECE, self.samples))
            blocks = self.at(whole)
            for start in range(whole.start, whole.stop, length):
                piece = slice(start, min(start + length, whole.stop))
                yield piece, [block[piece.start - first : piece.stop - first] for block in blocks]

    def __matmul__(self, values: Array) -> Array:
        """Y x (N, J) of values x (X,)."""
        product = np.empty(self.shape[:2], order="F")  # memory runs along the samples, as in the torque
        for piece, blocks in self.pieces():
            for j, block in enumerate(blocks):
                product[piece, j] = block @ values[self.places[j]]
        return product

    def __getitem__(self, key: Any) -> Array:
        """As an array (N, J, X) gives it; the first index names samples by a slice or by numbers."""
        samples, *rest = key if isinstance(key, tuple) else (key,)
        blocks = self.at(samples)
        if rest and isinstance(rest[0], int | np.integer):
            row = np.zeros((len(blocks[0]), self.unknowns))
            row[:, self.places[rest[0]]] = blocks[rest[0]]
            return row[(slice(None), *rest[1:])]
        dense = np.zeros((len(blocks[0]), len(blocks), self.unknowns))
        for j, block in enumerate(blocks):
            dense[:, j, self.places[j]] = block
        return dense[(slice(None), *rest)]

    def part(self, first: int, last: int) -> "Felt":
        """The samples from `first` to before `last`."""

        def make(at: slice | Indices) -> list[Array]:
            if not isinstance(at, slice):
                return self.at(first + at)
            start, stop, step = at.indices(last - first)
            return self.at(slice(first + start, first + stop, step))

        return Felt(last - first, self.unknowns, self.places, make)

    def thinned(self, step: int, unknowns: int) -> "Felt":
        """One sample of `step`, and the first unknowns alone."""
        if (step, unknowns) == (1, self.unknowns):
            return self
        if (step, unknowns) not in self._thinned:
            self._thinned[step, unknowns] = self._thinned_once(step, unknowns)
        return self._thinned[step, unknowns]

    def _thinned_once(self, step: int, unknowns: int) -> "Felt":
        stay = [np.flatnonzero(own < unknowns) for own in self.places]
        places = [own[some] for own, some in zip(self.places, stay, strict=True)]
        samples = len(range(0, self.samples, step))

        def make(at: slice | Indices) -> list[Array]:
            if isinstance(at, slice):
                first, last, stride = at.indices(samples)
                at = slice(first * step, last * step, stride * step)
            else:
                at = at * step
            blocks = (block if len(some) == block.shape[1] else block[:, some] for block, some in zip(self.at(at), stay, strict=True))
            return [np.asfortranarray(block) for block in blocks]  # memory runs along the samples

        return Felt(samples, unknowns, places, make)

    def only(self, kept: Mask) -> "Felt":
        """The same with zeros in the columns that are not in `kept` (X,)."""
        stay = [np.flatnonzero(kept[own]) for own in self.places]
        places = [own[some] for own, some in zip(self.places, stay, strict=True)]
        return Felt(
            self.samples,
            self.unknowns,
            places,
            lambda at: [block[:, some] for block, some in zip(self.at(at), stay, strict=True)],
        )

    def with_own(self, columns: Array) -> "Felt":
        """With (N, J, E) more columns, each felt by its joint alone: the unknowns [Y's; joint 1's own; joint 2's own; …]."""
        E = columns.shape[2]
        places = [np.append(own, self.unknowns + j * E + np.arange(E)) for j, own in enumerate(self.places)]
        return Felt(
            self.samples,
            self.unknowns + len(places) * E,
            places,
            lambda at: [np.concatenate([block, columns[at, j]], axis=1) for j, block in enumerate(self.at(at))],
        )


# --- Weighted least squares by joint, from triangular factors -------------------------------------------

EXCITED = 1e-6  # of the largest singular value, columns scaled alike: a smaller one is rounding or encoder noise

QR_PANEL = 8  # columns that the recursive QR takes together
FELT = 1e-9  # of the largest column's norm: a smaller column is rounding, as of joints that never move together


class Rows(NamedTuple):
    """The equations torque = Y·x of one recording."""

    Y: Array | Felt  # (N, J, B) regressor of the unknowns
    torque_nm: Array  # (N, J)
    used: Mask  # (N, J) the rows that are fitted
    steps: Indices  # (N,) number of the step (a sixth of a jackknife block) that each sample lies in, from 0
    segments: Indices  # (N,) number of the stretch without a hole that each sample lies in
    robust_weight: Array | None = None  # (N, J) weight of each row's square, 0 … 1, from a robust fit; None: 1 for all

    @property
    def root_weight(self) -> Array:
        """(N, J) factor on each row before its joint's weight; 0 where the row is not used."""
        return np.where(self.used, 1.0 if self.robust_weight is None else np.sqrt(self.robust_weight), 0.0)

    def thinned(self, every: int, unknowns: int | None = None) -> "Rows":
        """One of `every` rows; with `unknowns`, of so many unknowns alone."""
        Y = Felt.of(self.Y)
        weight = None if self.robust_weight is None else self.robust_weight[::every]
        fewer = Y.thinned(every, Y.unknowns if unknowns is None else unknowns)
        return Rows(fewer, self.torque_nm[::every], self.used[::every], self.steps[::every], self.segments[::every], weight)


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
    J, X = recordings[0].Y.shape[1:]
    triangles, samples = [np.zeros((0, X + 1))] * J, np.zeros(J, dtype=int)
    for rec in recordings:
        Y, root = Felt.of(rec.Y), rec.root_weight
        for piece, blocks in Y.pieces():
            for j, block in enumerate(blocks):
                rows = np.empty((len(block), block.shape[1] + 1), order="F")
                np.multiply(block, root[piece, j, None], out=rows[:, :-1])
                np.multiply(rec.torque_nm[piece, j], root[piece, j], out=rows[:, -1])
                new = scattered(reduced(rows), np.append(Y.places[j], X), X + 1)
                triangles[j] = triangle(np.concatenate([triangles[j], new])) if len(triangles[j]) else new
        samples += np.sum(rec.used, axis=0)
    return [Factor(R, int(count)) for R, count in zip(triangles, samples, strict=True)]


def with_own(recordings: Sequence[Rows], columns: Sequence[Array]) -> list[Rows]:
    """The rows with (N, J, E) more columns of each recording, in the unknowns [Y's; joint 1's own; joint 2's own; …]."""
    return [rec._replace(Y=Felt.of(rec.Y).with_own(own)) for rec, own in zip(recordings, columns, strict=True)]


def triangle(A: Array) -> Array:
    """R (r, B) with RᵀR = AᵀA, of A (n, B); r is the number of columns that are not all zero, or n if that is less."""
    felt = np.flatnonzero(np.any(A != 0.0, axis=0))  # a joint feels only the links outward of it, and its own friction
    return scattered(reduced(A[:, felt]), felt, A.shape[1])


def reduced(A: Array) -> Array:
    """R (min(n, K), K) of A (n, K), by LAPACK's recursive QR: half the time of `np.linalg.qr`."""
    if min(A.shape) == 0:
        return np.zeros((0, A.shape[1]))
    R, _, _ = scipy.linalg.lapack.dgeqrt(min(QR_PANEL, *A.shape), np.array(A, order="F"), overwrite_a=1)
    return np.triu(R[: A.shape[1]])


def _felt(norms: Array) -> Mask:
    """(B,) the columns whose norms are more than rounding."""
    felt: Mask = norms > FELT * np.max(norms, initial=0.0)
    return felt


def scattered(R: Array, places: Indices, columns: int) -> Array:
    """R with its columns at these places among so many."""
    whole = np.zeros((len(R), columns))
    whole[:, places] = R
    return whole


def _whitening(R: Array, norms: Array) -> Array | None:
    """R⁻¹ of a triangle (B, B) whose smallest singular value, columns scaled alike, is surely above `EXCITED` of the largest; else None.

    norms : (B,) of its columns. A tenth of the time of the singular values.
    """
    inverse, singular = scipy.linalg.lapack.dtrtri(R / norms)
    # Frobenius norms bound the singular values: ‖R‖ = √B of unit columns
    if singular or not np.linalg.norm(inverse) * np.sqrt(len(R)) < 1.0 / EXCITED:
        return None
    whitening: Array = inverse / norms[:, None]
    return whitening


def solve(joints: Sequence[Factor], weights: Array, prior: Array, penalty: Array | None = None) -> Solution:
    """Least squares with each joint's rows times its weight (J,). Directions that the data do not excite stay at the prior (B,).

    penalty : (B,) one over the standard deviation of each parameter about its prior, 0 for a parameter without one; None: 0 for all.
    """
    stacked = np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])
    if penalty is not None:
        stacked = np.concatenate([stacked, np.column_stack([np.diag(penalty), penalty * prior])[penalty > 0.0]])
    R = triangle(stacked) if len(stacked) >= stacked.shape[1] else stacked
    A, b = R[:, :-1], R[:, -1]
    norms, B = np.linalg.norm(A, axis=0), A.shape[1]
    norms = np.where(_felt(norms), norms, 0.0)
    whitening = _whitening(A[:B], norms) if len(R) == B + 1 and np.all(norms > 0.0) else None
    if whitening is not None:  # the usual case: everything is excited
        return Solution(values=whitening @ b[:B], directions=whitening, excited=np.ones(B, dtype=bool))
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


def together(joints: Sequence[Factor]) -> Array:
    """The triangle of all joints' rows, unweighted and in SI units, without the torque."""
    return triangle(np.concatenate([factor.R for factor in joints]))[:, :-1]


def condition_number(Y: Array, columns: Indices) -> float:
    """cond(Ȳ_B) of these columns of the fitted rows: Raviola et al. (2021), table 3. Y : `together`."""
    if len(Y) < len(columns):
        return float("inf")
    s = np.linalg.svd(Y[:, columns], compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")


def best_condition(Y: Array, combination: Array, rows: Indices) -> float:
    """Condition number of the motion itself, whatever base was chosen: of the best columns, each scaled to unit length.

    Y : `together`. combination : (B, P) base = combination · standard parameters; rows : of the base parameters that are fitted. The
    columns of all standard parameters are Y·combination, of which QR with pivoting chooses as many as there are base parameters.
    """
    standard = Y[:, rows] @ combination[rows]
    norms = np.linalg.norm(standard, axis=0)
    felt = _felt(norms)
    if len(Y) < len(rows) or np.sum(felt) < len(rows):
        return float("inf")
    R, _ = scipy.linalg.qr(standard[:, felt] / norms[felt], mode="r", pivoting=True)
    s = np.linalg.svd(R[: len(rows), : len(rows)], compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")


def residuals_of(recordings: Sequence[Rows], values: Array) -> list[Array]:
    """(N, J) of each recording [N·m]: measured torque less the torque of the parameters (B,)."""
    return [rec.torque_nm - rec.Y @ values for rec in recordings]
