"""Values of this room as plain JSON and back, exactly: the shortest repr of a float is that float, and NaN becomes null.

The type of a value says how it is read back: `typed` is the inverse of `plain` for every dataclass and named tuple of these rooms. A field
`Annotated[Array, "N S"]` names its dimensions; a name has one length in a value and in its parts.
"""

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from monitor.errors import BadInput
from monitor.reason import Reason, reason_at, reason_from, reason_of, with_reasons
from monitor.recording import Array

T = TypeVar("T")
Sizes = dict[str, int]  # the lengths of named dimensions
# types whose values are one text in a document: what makes it, and what reads it and says where it stands
TEXTS: dict[type, tuple[Callable[[Any], str], Callable[[Any, str], Any]]] = {}


def plain(value: Any) -> Any:
    """A value as plain JSON: lists for arrays and tuples, objects for dataclasses and named tuples, null for NaN."""
    if isinstance(value, np.ndarray | np.generic):
        listed = value.tolist()
        # nearly every array is of numbers without NaN: a belief has thousands of them, and is written several times a replay
        whole = value.dtype.kind in "biu" or (value.dtype.kind == "f" and not np.isnan(value).any())
        return listed if whole else plain(listed)
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, Reason):
        return value.document()
    if type(value) in TEXTS:
        return TEXTS[type(value)][0](value)
    if is_dataclass(value) and not isinstance(value, type):
        return _object({f.name: getattr(value, f.name) for f in fields(value)})
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return _object(value._asdict())
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    return value


def _object(parts: Mapping[str, Any]) -> dict[str, Any]:
    """An object; of a reason the English text stands under the key, as `with_reasons` has it."""
    reasons = {key: part for key, part in parts.items() if isinstance(part, Reason)}
    document = {key: part.text if isinstance(part, Reason) else plain(part) for key, part in parts.items()}
    return with_reasons(document, **reasons) if reasons else document


def typed(cls: type[T], document: Any, *, where: str, sizes: Sizes | None = None, complete: bool = True) -> T:
    """The value of a dataclass or named tuple from its plain JSON, which may hold more.

    where : what the document is, for messages. sizes : dimensions whose length is known; others are taken from the first array that names
    them. complete : whether every key must be there, so that no state is read in part; else a missing one has its field's default.
    Raises BadInput naming the key that is missing, is of another type, or has another shape.
    """
    sizes = dict(sizes or {})  # what a part binds does not bind its neighbours
    if not isinstance(document, Mapping):
        raise BadInput(f"{where}: expected a JSON object, not {type(document).__name__}")
    values = {}
    for name, (hint, required) in _fields_of(cls).items():  # type: ignore[arg-type]  # a class is hashable
        if name in document and hint in (Reason, Reason | None):
            values[name] = reason_at(document, name)
        elif name in document:
            values[name] = _value(hint, document[name], f"{where}: {name}", sizes, complete)
        elif required or complete:
            raise BadInput(f"{where}: the key {name!r} is missing")
    try:
        return cls(**values)
    except (TypeError, ValueError) as wrong:  # the value's own checks
        raise BadInput(f"{where}: {wrong}") from None


@cache
def _fields_of(cls: type) -> dict[str, tuple[Any, bool]]:
    """Of each field its type, and whether it has no default."""
    hints = get_type_hints(cls, include_extras=True)
    if is_dataclass(cls):
        return {f.name: (hints[f.name], f.default is MISSING and f.default_factory is MISSING) for f in fields(cls) if f.init}
    defaults = getattr(cls, "_field_defaults", {})
    return {name: (hints[name], name not in defaults) for name in cls._fields}  # type: ignore[attr-defined]  # a named tuple


def _value(hint: Any, given: Any, where: str, sizes: Sizes, complete: bool) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        if get_origin(arguments[0]) is np.ndarray:
            return array(given, str(arguments[1]), where, sizes)
        return _value(arguments[0], given, where, sizes, complete)
    if origin is np.ndarray:
        return array(given, None, where, sizes)
    if origin is Literal:
        if given in arguments:
            return given
        raise BadInput(f"{where} is {given!r}; expected one of {', '.join(map(str, arguments))}")
    if origin in (Union, types.UnionType):
        if given is None and type(None) in arguments:
            return None
        return _value(next(each for each in arguments if each is not type(None)), given, where, sizes, complete)
    if origin is tuple:
        if not isinstance(given, list | tuple):
            raise BadInput(f"{where}: expected a list")
        kinds = [arguments[0]] * len(given) if arguments[-1] is Ellipsis else list(arguments)
        if len(kinds) != len(given):
            raise BadInput(f"{where}: expected {len(kinds)} entries, not {len(given)}")
        return tuple(_value(kind, each, f"{where}[{k}]", sizes, complete) for k, (kind, each) in enumerate(zip(kinds, given, strict=True)))
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(given, Mapping):
            raise BadInput(f"{where}: expected a JSON object")
        return {str(key): _value(arguments[1], each, f"{where}: {key}", sizes, complete) for key, each in given.items()}
    if hint is Reason:
        return reason_from(given) if isinstance(given, Mapping) else reason_of(given)  # a release before 1.0 kept the text
    if isinstance(hint, type) and hint in TEXTS:
        return TEXTS[hint][1](given, where)
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return typed(hint, given, where=where, sizes=sizes, complete=complete)
    if hint is float:
        given = math.nan if given is None else given
        if isinstance(given, int | float) and not isinstance(given, bool):
            return float(given)
    elif hint is int:
        if isinstance(given, int | float) and not isinstance(given, bool) and given == int(given):
            return int(given)
    elif hint is Any or isinstance(given, hint):
        return given
    raise BadInput(f"{where} is {given!r}; expected {getattr(hint, '__name__', hint)}")


def array(given: Any, dimensions: str | None, where: str, sizes: Sizes) -> Array:
    """Numbers, null as NaN, whose dimensions have the lengths that their names have."""
    try:
        value: Array = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(f"{where} is not an array of numbers") from None
    if dimensions is None:
        return value
    names = dimensions.split()
    expected = tuple(int(name) if name.isdecimal() else sizes.get(name, have) for name, have in zip(names, value.shape, strict=False))
    if value.ndim != len(names) or value.shape != expected:
        lengths = ", ".join(f"{name} = {sizes[name]}" if name in sizes else name for name in names)
        raise BadInput(f"{where} has shape {value.shape}; expected ({lengths})")
    sizes.update((name, have) for name, have in zip(names, value.shape, strict=True) if not name.isdecimal())
    return value


def entry(document: Any, key: str, *, where: str) -> Any:
    """The value under a key.

    Raises BadInput where the document is no object or lacks the key.
    """
    if not isinstance(document, Mapping) or key not in document:
        raise BadInput(f"{where}: the key {key!r} is missing")
    return document[key]
