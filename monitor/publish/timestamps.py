"""Seconds since 1970 ↔ what people and other programs read: UTC, RFC 3339."""

from datetime import UTC, date, datetime
from functools import lru_cache

DAY_S = 86_400
_FIRST_DAY = date(1970, 1, 1).toordinal()


def rfc3339(unix_s: float) -> str:
    """2026-11-21T03:00:00Z, to the second."""
    day, second = divmod(round(unix_s), DAY_S)
    return f"{_date(day)}T{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}Z"


@lru_cache(maxsize=16)  # a history is told day by day; more would only lie about, one here and one there, in memory that is free else
def _date(day: int) -> str:
    return date.fromordinal(_FIRST_DAY + day).isoformat()


def unix_s(text: str) -> float:
    """Seconds since 1970 of a day or a time in ISO 8601; UTC where no offset is given. Raises ValueError."""
    at = datetime.fromisoformat(text)
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


def outside(document: object) -> object:
    """The same JSON document with every `*_unix_s` number told as `*` in RFC 3339, as documents leave the house."""
    if isinstance(document, dict):
        told: dict[str, object] = {}
        for key, value in document.items():
            if key[-7:] == "_unix_s" and (value is None or isinstance(value, int | float)):
                told[key[:-7]] = None if value is None else rfc3339(value)
            elif isinstance(value, dict | list | tuple):
                told[key] = outside(value)
            else:
                told[key] = value  # no call for each of the 100 000 numbers of five years
        return told
    if isinstance(document, list | tuple):
        return [outside(value) for value in document]
    return document
