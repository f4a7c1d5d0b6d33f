"""Values of many variables at once: each packet's are gathered from few sources with few calls, then put in order by one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from monitor.recording import Array
from monitor.simulate.controller.registers import FORMAT

Values = Sequence[float]


class Sort(Enum):
    """How a source gives its numbers: those of one sort are fetched together."""

    CONSTANT = auto()  # never changes
    NUMBER = auto()  # at a path from the controller
    ARRAY = auto()  # at a path from the controller
    COMPUTED = auto()  # an array, by a call
    LISTED = auto()  # a list or a tuple, by a call


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Gives so many numbers, maybe those of several variables."""

    sort: Sort
    width: int
    get: Callable[[], Any]
    path: str = ""


class Variable(NamedTuple):
    """RTDE's type name, and where in a source its values begin."""

    kind: str
    source: Source
    at: int = 0

    @property
    def width(self) -> int:
        """How many numbers it is."""
        return int(FORMAT[self.kind][:-1] or 1)

    def read(self) -> tuple[float, ...]:
        """Its values now, alone."""
        given = self.source.get()
        if self.source.sort is Sort.NUMBER:
            return (given,)
        values: Values = given.tolist() if isinstance(given, np.ndarray) else given
        return tuple(values[self.at : self.at + self.width])


def constant(kind: str, *values: float) -> Variable:
    """What never changes."""
    return Variable(kind, Source(Sort.CONSTANT, len(values), lambda: values))


def number(kind: str, of: object, path: str) -> Variable:
    """An attribute of the controller, or of what it has."""
    get = attrgetter(path)
    return Variable(kind, Source(Sort.NUMBER, 1, lambda: get(of), path))


def array(of: object, path: str) -> Variable:
    """The same, (6,)."""
    get = attrgetter(path)
    return Variable("VECTOR6D", Source(Sort.ARRAY, 6, lambda: get(of), path))


def computed(kind: str, get: Callable[[], Array]) -> Variable:
    """An array that is worked out."""
    return Variable(kind, Source(Sort.COMPUTED, int(FORMAT[kind][:-1]), get))


def listed(kind: str, get: Callable[[], Values]) -> Variable:
    """Numbers that are worked out."""
    return Variable(kind, Source(Sort.LISTED, int(FORMAT[kind][:-1] or 1), get))


def reader(of: object, variables: Sequence[Variable], *first: float) -> Callable[[], tuple[float, ...]]:
    """Reads all of these at once, in their order, after what always comes `first`; paths begin at `of`."""
    sources = list(dict.fromkeys(variable.source for variable in variables))
    sorts = {sort: [source for source in sources if source.sort is sort] for sort in Sort}
    begins, end = {}, len(first)
    for source in (source for sort in Sort for source in sorts[sort]):  # as `read` gathers them
        begins[source] = end
        end += source.width
    places = [*range(len(first)), *(begins[v.source] + v.at + i for v in variables for i in range(v.width))]
    pick: Callable[[list[float]], Any] = itemgetter(*places) if len(places) > 1 else lambda values: tuple(values[place] for place in places)

    fixed = [*first, *(value for source in sorts[Sort.CONSTANT] for value in source.get())]
    numbers, arrays = _all_at(sorts[Sort.NUMBER]), _all_at(sorts[Sort.ARRAY])
    by_call, by_list = [source.get for source in sorts[Sort.COMPUTED]], [source.get for source in sorts[Sort.LISTED]]
    any_array = bool(sorts[Sort.ARRAY] or by_call)

    def read() -> tuple[float, ...]:
        values = fixed.copy()
        values += numbers(of)
        if any_array:
            values += np.concatenate((*arrays(of), *[get() for get in by_call])).tolist()
        for get in by_list:
            values += get()
        in_order: tuple[float, ...] = pick(values)
        return in_order

    return read


def _all_at(sources: list[Source]) -> Callable[[object], tuple[Any, ...]]:
    paths = [source.path for source in sources]
    if len(paths) > 1:
        return attrgetter(*paths)  # all in C: there are a dozen of them in every packet
    return lambda of: tuple(attrgetter(path)(of) for path in paths)
