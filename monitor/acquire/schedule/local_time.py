"""Times of the wall clock: the days of a blackout, the spans of a day, and what they mean in UTC."""

import re
from collections.abc import Iterator
from datetime import date, datetime, time, timedelta
from zoneinfo import ZoneInfo

_SPAN = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-(([01]\d|2[0-3]):([0-5]\d)|24:00)\Z")


def unix_s(reading: datetime, zone: ZoneInfo) -> float:
    """The time [s, UTC] at which the zone's wall clock shows that reading: the first time where it shows it twice."""
    return reading.replace(tzinfo=zone, fold=0).timestamp()


def midnight_before(at_unix_s: float, zone: ZoneInfo) -> float:
    """The time [s, UTC] at which the zone's day of that moment begins."""
    return unix_s(datetime.combine(datetime.fromtimestamp(at_unix_s, tz=zone).date(), time()), zone)


def blackout(text: str, zone: ZoneInfo) -> tuple[float, float]:
    """Beginning and end [s, UTC] of the days of a text such as 2026-12-25 or 2026-12-24..2027-01-02. Raises ValueError."""
    first, last = _days(text)
    return unix_s(datetime.combine(first, time()), zone), unix_s(datetime.combine(last, time.max), zone)


def is_blackout(text: str) -> bool:
    """Whether a text names a day, or two days in their order."""
    try:
        first, last = _days(text)
    except ValueError:
        return False
    return first <= last


def _days(text: str) -> tuple[date, date]:
    first, _, last = (part.strip() for part in text.partition(".."))
    return date.fromisoformat(first), date.fromisoformat(last or first)


def is_span(text: str) -> bool:
    """Whether a text is a span of a day such as 22:00-05:00; the end 24:00 is midnight."""
    return _SPAN.match(text) is not None


def spans_from(text: str, at_unix_s: float, zone: ZoneInfo) -> Iterator[tuple[float, float]]:
    """Beginning and end [s, UTC] of that span on the days around a moment, as far as it has not ended by then."""
    today = datetime.fromtimestamp(at_unix_s, tz=zone).date()
    first, _, last = text.partition("-")
    for day in (today - timedelta(days=1), today, today + timedelta(days=1)):
        opens = unix_s(datetime.combine(day, time.fromisoformat(first)), zone)
        if last == "24:00" or last <= first:
            closes = unix_s(datetime.combine(day + timedelta(days=1), time() if last == "24:00" else time.fromisoformat(last)), zone)
        else:
            closes = unix_s(datetime.combine(day, time.fromisoformat(last)), zone)
        if closes > at_unix_s:
            yield opens, closes
