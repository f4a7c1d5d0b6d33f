"""Reads many variables at once: the values of a packet come from few sources with few calls, and one call puts them in order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.simulate.machine.registers import width

Values = Sequence[float]


class SourceKind(Enum):
    """How a source gives its numbers. Sources of one kind are read together."""

    CONSTANT = auto()  # never changes
    NUMBER = auto()  # a number at a path of attributes
    ARRAY = auto()  # an array at a path of attributes
    COMPUTED = auto()  # a function that returns an array
    LISTED = auto()  # a function that returns a list or a tuple


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Gives a fixed count of numbers, which may belong to several variables."""

    kind: SourceKind
    width: int
    get: Callable[[], Any]
    path: str = ""  # attributes from the root object of `reader` on, separated by dots


class Variable(NamedTuple):
    """A variable: its RTDE type, its source, and the index of its first number in the source."""

    type: str
    source: Source
    at: int = 0

    @property
    def width(self) -> int:
        """How many numbers the variable has."""
        return width(self.type)

    def read(self) -> tuple[float, ...]:
        """The present value of this variable alone."""
        given = self.source.get()
        if self.source.kind is SourceKind.NUMBER:
            return (given,)
        values: Values = given.tolist() if isinstance(given, np.ndarray) else given
        return tuple(values[self.at : self.at + self.width])


def constant(*values: float) -> Source:
    """Numbers that never change."""
    return Source(SourceKind.CONSTANT, len(values), lambda: values)


def number(root: object, path: str) -> Source:
    """The number at a path of attributes from the root object on."""
    get = attrgetter(path)
    return Source(SourceKind.NUMBER, 1, lambda: get(root), path)


def array(root: object, path: str) -> Source:
    """The array (6,) at a path of attributes from the root object on."""
    get = attrgetter(path)
    return Source(SourceKind.ARRAY, 6, lambda: get(root), path)


def computed(size: int, get: Callable[[], Array]) -> Source:
    """An array of this size that a function computes."""
    return Source(SourceKind.COMPUTED, size, get)


def listed(size: int, get: Callable[[], Values]) -> Source:
    """A list or tuple of this size that a function computes."""
    return Source(SourceKind.LISTED, size, get)


def reader(root: object, variables: Sequence[Variable], *first: float) -> Callable[[], tuple[float, ...]]:
    """A function that reads these variables in their order, after the constant numbers `first`. Paths begin at the root object."""
    sources = list(dict.fromkeys(variable.source for variable in variables))
    by_kind = {kind: [source for source in sources if source.kind is kind] for kind in SourceKind}
    begins, end = {}, len(first)
    for source in (source for kind in SourceKind for source in by_kind[kind]):  # in the order in which `read` appends them
        begins[source] = end
        end += source.width
    indices = [*range(len(first)), *(begins[v.source] + v.at + i for v in variables for i in range(v.width))]
    pick: Callable[[list[float]], Any] = itemgetter(*indices) if len(indices) > 1 else lambda values: tuple(values[i] for i in indices)

    fixed = [*first, *(value for source in by_kind[SourceKind.CONSTANT] for value in source.get())]
    numbers, arrays = _all_at(by_kind[SourceKind.NUMBER]), _all_at(by_kind[SourceKind.ARRAY])
    computing, listing = [source.get for source in by_kind[SourceKind.COMPUTED]], [source.get for source in by_kind[SourceKind.LISTED]]
    any_array = bool(by_kind[SourceKind.ARRAY] or computing)

    def read() -> tuple[float, ...]:
        values = fixed.copy()
        values += numbers(root)
        if any_array:
            values += np.concatenate((*arrays(root), *[get() for get in computing])).tolist()
        for get in listing:
            values += get()
        in_order: tuple[float, ...] = pick(values)
        return in_order

    return read


def _all_at(sources: list[Source]) -> Callable[[object], tuple[Any, ...]]:
    paths = [source.path for source in sources]
    if len(paths) > 1:
        return attrgetter(*paths)  # one call in C: every packet has a dozen of them
    return lambda root: tuple(attrgetter(path)(root) for path in paths)
