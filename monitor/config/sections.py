"""One section of the file: its table checked against the types of a settings class, each mistake with the key that has it."""

import dataclasses
import difflib
from dataclasses import dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, StrictBool, StrictFloat, StrictInt, ValidationError, create_model

from monitor.errors import BadInput

# TOML's words for pydantic's types of error
_EXPECTED = {
    "string_type": "expected text in quotes",
    "tuple_type": "expected a list in square brackets",
    "bool_type": "expected true or false",
    "int_type": "expected a whole number",
    "float_type": "expected a number",
    "model_type": "expected a table",
}


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake of a configuration."""

    key: tuple[str, ...]  # its place: section, key, number of a table in a list; empty: a variable of the environment has it
    text: str  # with the key; the value is left out where it may be secret


def of_key(key: tuple[str, ...], reason: str) -> Mistake:
    """The mistake of one key, with its dotted name."""
    return Mistake(key, f"{'.'.join(key)}: {reason}")


def of_section(name: str, reason: str) -> Mistake:
    """The mistake of a section as a whole."""
    return Mistake((name,), f"[{name}]{reason}")


def read_section(name: str, cls: type, value: Any, mistakes: list[Mistake], left_out: frozenset[Any] = frozenset()) -> Any:
    """One room's settings from its TOML table; None, with the mistakes added, where it does not fit.

    left_out : keys whose mistakes are named already; the mistakes in the others are named as well.
    """
    if not isinstance(value, dict):
        mistakes.append(of_key((name,), f"expected a table [{name}]"))
        return None
    schema = _schema(cls)
    wrong: set[Any]
    try:
        return _made(cls, schema.model_validate(value))
    except ValidationError as error:
        problems = [problem for problem in error.errors() if not (problem["type"] == "missing" and problem["loc"][0] in left_out)]
        for problem in problems:
            key = tuple(str(part) for part in (name, *problem["loc"]))
            if problem["type"] == "extra_forbidden":
                mistakes.append(of_key(key, f"unknown key{nearest(key[-1], _keys(cls, problem['loc'][:-1]))}"))
            elif problem["type"] == "missing":
                mistakes.append(of_key(key, "missing"))
            else:
                reason = _EXPECTED.get(problem["type"], f"{problem['msg'][0].lower()}{problem['msg'][1:]}")
                shown = "" if is_secret(key) else f" = {problem['input']!r}"
                mistakes.append(Mistake(key, f"{'.'.join(key)}{shown}: {reason}"))
        wrong = {problem["loc"][0] for problem in problems}
    except (BadInput, ValueError) as error:  # a room may refuse a value or a combination that its types allow
        # a room names itself and, for one key's mistake, the key: `replay: gain = 5.0; expected …`, `schedule.cron = …`
        reason = str(error).removeprefix(f"{name}.").removeprefix(f"{name}:").strip()
        named = reason.partition(" = ")[0]
        if named in value or named in _keys(cls, ()):
            shown = reason.replace(repr(value.get(named)), "…") if is_secret((name, named)) else reason
            mistakes.append(Mistake((name, named), f"{name}.{shown}"))
            wrong = {named}
        else:
            mistakes.append(of_section(name, f" {reason}"))
            wrong = set()
    if wrong & value.keys():
        rest = {key: entry for key, entry in value.items() if key not in wrong}
        read_section(name, cls, rest, mistakes, left_out | wrong)
    return None


def is_secret(key: tuple[str, ...]) -> bool:
    """Whether the value of a key may be secret, by its name."""
    return any(word in part for part in key[1:] for word in ("password", "secret", "token", "database"))


# "yes" must never become allow_motion = true
_STRICT: dict[Any, Any] = {bool: StrictBool, int: StrictInt, float: StrictFloat}


def _strict(hint: Any) -> Any:
    """The strict type that pydantic checks, with its bounds; a list of tables has the model of its table."""
    if get_origin(hint) is Annotated:
        inner, *bounds = get_args(hint)
        return Annotated[_STRICT.get(inner, inner), *bounds]
    if get_origin(hint) in (Union, UnionType):
        return Union[tuple(_strict(each) for each in get_args(hint))]  # noqa: UP007 - made of parts
    table = _table_of(hint)
    return _STRICT.get(hint, hint) if table is None else tuple[_schema(table), ...]  # type: ignore[misc]


def _table_of(hint: Any) -> type | None:
    """The settings class of a list of tables, `tuple[Class, ...]`; None for any other type."""
    inner = get_args(hint)[0] if get_origin(hint) is tuple else None
    return inner if isinstance(inner, type) and dataclasses.is_dataclass(inner) else None


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return ... if field.default is dataclasses.MISSING else field.default


def _schema(cls: type) -> type[BaseModel]:
    """The pydantic model of a room's dataclass: the same fields, no others, no NaN."""
    hints = get_type_hints(cls, include_extras=True)
    fields: dict[str, Any] = {}
    for field in keys_of(cls):
        hint = hints[field.name]
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            nested = _schema(hint)
            fields[field.name] = (nested, nested())
        else:
            fields[field.name] = (_strict(hint), _default(field))
    return create_model(cls.__name__, __config__=ConfigDict(extra="forbid", allow_inf_nan=False), **fields)


@cache
def _hints(cls: type) -> dict[str, Any]:
    """The types of a settings class, bounds left out."""
    return get_type_hints(cls)


def _made(cls: type, checked: BaseModel) -> Any:
    values = {}
    for name, hint in _hints(cls).items():
        if name not in type(checked).model_fields:
            continue
        value = getattr(checked, name)
        if (table := _table_of(hint)) is not None:
            value = tuple(_made(table, each) for each in value)
        values[name] = _made(hint, value) if isinstance(hint, type) and dataclasses.is_dataclass(hint) else value
    return cls(**values)


def _keys(cls: type, place: tuple[int | str, ...]) -> list[str]:
    """The keys that a table may have, `place` levels down."""
    for step in place:
        if not isinstance(step, int):  # the number of a table in a list
            hint = _hints(cls)[step]
            cls = _table_of(hint) or hint
    return [field.name for field in keys_of(cls)]


def keys_of(cls: type) -> "list[dataclasses.Field[Any]]":
    """The fields of a settings class that are keys of the file: all but those with `NO_KEY`."""
    return [field for field in dataclasses.fields(cls) if field.metadata.get("toml", True)]


def nearest(word: str, known: list[str]) -> str:
    """The end of a mistake about an unknown word: the known word most like it, else all of them."""
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]}?)" if near else f"; since version 1.0 known are {', '.join(known)}"
