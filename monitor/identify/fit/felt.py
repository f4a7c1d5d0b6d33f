"""The regressor of a recording in the unknowns of a fit, as far as each joint feels them, in pieces.

A joint feels the links outward of it and its own friction, so a third of Y (N, J, X) is zero and is not formed. The rest of a long
recording would fill the memory: it is formed anew, piece by piece, whenever it is needed.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

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
