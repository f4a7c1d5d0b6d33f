"""Five cron fields: what they mean, and the times that they name."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import cache, lru_cache
from typing import Protocol
from zoneinfo import ZoneInfo

from monitor.acquire.schedule.local_time import unix_s
from monitor.errors import BadInput

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
