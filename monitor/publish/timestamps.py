"""Conversion between seconds since 1970 and UTC in RFC 3339, the form in which all published times are."""

from datetime import UTC, date, datetime
from functools import lru_cache

DAY_S = 86_400
_FIRST_DAY = date(1970, 1, 1).toordinal()


def rfc3339(unix_s: float) -> str:
    """The time as RFC 3339 to the second: 2026-11-21T03:00:00Z."""
    day, second = divmod(round(unix_s), DAY_S)
    return f"{_date(day)}T{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}Z"


@lru_cache(maxsize=16)  # a history is converted day by day; a larger cache would only hold memory
def _date(day: int) -> str:
    return date.fromordinal(_FIRST_DAY + day).isoformat()


def utc(unix_s: float) -> datetime:
    """The time to the second, as documents carry it."""
    return datetime.fromtimestamp(round(unix_s), UTC)


def utc_if(unix_s: float | None) -> datetime | None:
    """The same; None where there is none."""
    return None if unix_s is None else utc(unix_s)


def written(at: datetime) -> str:
    """The time of a document as RFC 3339 to the second."""
    return rfc3339(at.timestamp())


def written_if(at: datetime | None) -> str | None:
    """The same; None where there is none."""
    return None if at is None else written(at)


def unix_s(text: str) -> float:
    """Seconds since 1970 of a day or a time in ISO 8601; UTC where no offset is given. Raises ValueError."""
    at = datetime.fromisoformat(text)
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


def outside(document: object) -> object:
    """The published form of a JSON document: every number `*_unix_s` becomes the text `*` in RFC 3339.

    Parameters of a reason stay as they are: its sentence needs them by their names.
    """
    if isinstance(document, dict):
        published: dict[str, object] = {}
        for key, value in document.items():
            if key[-7:] == "_unix_s" and (value is None or isinstance(value, int | float)):
                published[key[:-7]] = None if value is None else rfc3339(value)
            elif isinstance(value, dict | list | tuple) and key != "parameters":
                published[key] = outside(value)
            else:
                published[key] = value  # without a call for each of the 100 000 figures of five years
        return published
    if isinstance(document, list | tuple):
        return [outside(value) for value in document]
    return document
