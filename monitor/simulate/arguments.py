"""Arguments of faults and of scenarios: their kinds and their checks."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from monitor.errors import BadInput


class Number(NamedTuple):
    """A number from low to high. It is required if the default is None."""

    low: float
    high: float
    default: float | None = None


class Choice(NamedTuple):
    """One of several words. It is required if the default is None."""

    words: tuple[str, ...]
    default: str | None = None


class Text(NamedTuple):
    """A text that is not empty. It is required if the default is None."""

    default: str | None = None


class Flag(NamedTuple):
    """A truth value."""

    default: bool


Kind = Number | Choice | Text | Flag


def check(what: str, known: Mapping[str, Kind], given: Mapping[str, Any], *, joints: int = 6) -> dict[str, Any]:
    """Check given values and fill in defaults. `what` begins every message. Numbers may be text, as from a command line.

    An argument named `joint` is a whole number up to `joints`. Raises BadInput with the argument, its value and what is expected.
    """
    unknown = sorted(key for key, value in given.items() if key not in known and value is not None)
    if unknown:
        raise BadInput(f"{what}: {', '.join(unknown)} is not an argument of it; known are {', '.join(known) or 'none'}")
    result: dict[str, Any] = {}
    for key, kind in known.items():
        value = given.get(key)
        value = kind.default if value is None else value
        where = f"{what}: {key} = {value!r}" if value is not None else f"{what}: {key} is missing"
        match kind:
            case Number(low, high):
                high = joints if key == "joint" else high
                number = _figure(value)
                if number is None or not low <= number <= high or (key == "joint" and number != int(number)):
                    raise BadInput(f"{where}; expected a {'whole number' if key == 'joint' else 'number'} from {low:g} to {high:g}")
                result[key] = int(number) if key == "joint" else number
            case Choice(words):
                if value not in words:
                    raise BadInput(f"{where}; expected one of {', '.join(word or '(nothing)' for word in words)}")
                result[key] = value
            case Text():
                if not isinstance(value, str) or not value:
                    raise BadInput(f"{where}; expected a text")
                result[key] = value
            case Flag():
                if not isinstance(value, bool):
                    raise BadInput(f"{where}; expected true or false")
                result[key] = value
    return result


def _figure(value: Any) -> float | None:
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return None
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) else None
