"""Times of the wall clock: five cron fields, the days of a blackout, the spans of a day, and what they mean in UTC."""

import io
import re
from collections.abc import Iterator
from datetime import UTC, date, datetime, time, timedelta
from functools import cache, lru_cache
from typing import Protocol
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from monitor.errors import BadInput

_SPAN = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-(([01]\d|2[0-3]):([0-5]\d)|24:00)\Z")

_UTC = b"TZif" + bytes(16) + bytes(16) + b"\0\0\0\1" + b"\0\0\0\4" + bytes(6) + b"UTC\0"  # RFC 8536, version 1: one type, no transition


def time_zone(name: str, where: str) -> ZoneInfo:
    """The zone of that name; UTC also on a computer that knows no zones. where : what names it, for messages.

    Raises BadInput where no zone has that name, or the computer knows none.
    """
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        if name == "UTC":
            return ZoneInfo.from_file(io.BytesIO(_UTC), key="UTC")
    try:
        ZoneInfo("UTC")
    except (ZoneInfoNotFoundError, OSError):
        raise BadInput(
            f"{where} = {name!r}: this computer knows no time zones but UTC; install them, by pip install tzdata, or tzdata of the system"
        ) from None
    raise BadInput(f"{where} = {name!r}: expected a name such as UTC or Europe/Berlin")


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


WEEKDAYS = ("sun", "mon", "tue", "wed", "thu", "fri", "sat")  # cron(5): 0 and 7 are Sunday; APScheduler counts from Monday
LONGEST_SHIFT = timedelta(hours=3)  # no zone shifts its wall clock by more at once


class Trigger(Protocol):
    """What is used of APScheduler's trigger."""

    def get_next_fire_time(self, previous: datetime | None, now: datetime) -> datetime | None:
        """The first time at or after now that the fields name; None where there is none."""


@cache  # a trigger holds no state, and costs more to make than to ask
def cron_trigger(expression: str) -> Trigger | None:
    """The trigger of five cron fields, None for an empty text. Raises BadInput."""
    from apscheduler.triggers.cron import CronTrigger

    if not expression.strip():
        return None
    fields = expression.split()
    try:
        if len(fields) != 5:
            raise ValueError(f"{len(fields)} field{'s' * (len(fields) != 1)}")
        trigger: Trigger = CronTrigger.from_crontab(" ".join((*fields[:4], _weekdays(fields[4]))), timezone=UTC)
    except ValueError as error:
        reason = re.sub(r"[.]$", "", str(error))
        raise BadInput(f"schedule.cron = {expression!r}: {reason}; expected five fields, e.g. '0 3 * * *' for 03:00 every day") from None
    return trigger


def _weekdays(field: str) -> str:
    """The fifth field with names in place of numbers, as cron(5) counts them. Raises ValueError."""
    names = []
    for part in field.lower().split(","):
        span, slash, step = part.partition("/")
        if not (span.replace("-", "").isdigit() or (span == "*" and slash)):
            names.append(part)
            continue
        first, _, last = ("0", "-", "6") if span == "*" else span.partition("-")
        low, high = int(first), int(last or first)
        if not 0 <= low <= high <= 7 or (slash and not (step.isdigit() and int(step) > 0)):
            raise ValueError(f"weekday {part!r}: expected 0 to 7, or names such as mon-fri")
        names += [WEEKDAYS[day % 7] for day in range(low, high + 1, int(step) if slash else 1)]
    return ",".join(dict.fromkeys(names))


def cron_times(expression: str, zone: ZoneInfo, from_unix_s: float, to_unix_s: float) -> Iterator[float]:
    """Every time [s, UTC] in [from, to] that the fields name on the zone's wall clock, once.

    An hour that comes twice in autumn counts the first time; an hour that spring leaves out is taken an hour later, as cron does.
    """
    if cron_trigger(expression) is None:
        return
    # the trigger runs over the wall clock's readings as if they were UTC, where every one of them exists exactly once
    begin = (datetime.fromtimestamp(from_unix_s, tz=zone) - LONGEST_SHIFT).replace(tzinfo=UTC)
    end = (datetime.fromtimestamp(to_unix_s, tz=zone) + LONGEST_SHIFT).replace(tzinfo=UTC)
    seen: set[float] = set()
    reading = begin.replace(hour=0, minute=0, second=0, microsecond=0)  # every question of a day then asks for the same times
    while (at := _next_time(expression, reading)) is not None and at <= end:
        reading = at + timedelta(microseconds=1)
        if at < begin:
            continue
        key = unix_s(at.replace(tzinfo=None), zone)
        if from_unix_s <= key <= to_unix_s and key not in seen:
            seen.add(key)
            yield key


@lru_cache(maxsize=8192)  # the schedule is asked for the next days again and again, and each time costs a tenth of a millisecond
def _next_time(expression: str, reading: datetime) -> datetime | None:
    """The first time of five cron fields at or after a reading; None where there is none."""
    trigger = cron_trigger(expression)
    return None if trigger is None else trigger.get_next_fire_time(None, reading)
