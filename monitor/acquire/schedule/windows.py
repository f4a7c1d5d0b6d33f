"""When to replay: settings, ledger, now → the window that is due, those that were missed, those to come. No clock, no thread, no I/O.

A window is a span of time in which one replay may begin, and a key that the ledger knows it by. Keys follow from the settings alone, so a
restart, a second process or a clock that jumps finds the same ones; the ledger, in SQL, lets each be used once.
"""

import hashlib
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from functools import cache
from typing import Annotated, Any, NamedTuple, Protocol
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from annotated_types import Interval

from monitor.errors import BadInput

DAY_S = 86_400.0
LOOK_BACK_S = 60 * DAY_S  # windows missed longer ago are not entered one by one
MOST_MISSED = 60
# two windows that begin at one moment are one window; these kinds have no moment of their own
COLD_START_KEY_S = 0.001  # after the day's beginning
EVIDENCE_KEY_S = 0.002  # after the beginning of a pause
_WEEKDAYS = ("sun", "mon", "tue", "wed", "thu", "fri", "sat")  # cron(5): 0 and 7 are Sunday; APScheduler counts from Monday
_SPAN = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-(([01]\d|2[0-3]):([0-5]\d)|24:00)\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleSettings:
    """When to replay."""

    timezone: str = "UTC"  # of cron, blackout and evidence_windows
    cron: str = "0 3 * * *"  # minute hour day month weekday; "" for none
    every_h: Annotated[float, Interval(ge=0.0, le=8784.0)] = 0.0  # [h] besides: so far apart, counted in UTC; 0: not
    grace_s: Annotated[float, Interval(ge=10.0, le=86400.0)] = 600.0  # a window stays open for so long; one missed is skipped, and said so
    jitter_s: Annotated[float, Interval(ge=0.0, le=43200.0)] = 0.0  # a window opens up to so much later, each by its own lot
    blackout: tuple[str, ...] = ()  # "2026-12-24..2027-01-02" or single days: no window opens
    after_warm_up: bool = False  # begin only while temperatures are steady
    warm_k_per_10_min: Annotated[float, Interval(ge=0.05, le=20.0)] = 0.5  # what is steady
    cold_start_after_h: Annotated[float, Interval(ge=0.0, le=168.0)] = (
        0.0  # a replay when the arm runs again after so long, once a day; 0: not
    )
    learning_days: Annotated[float, Interval(ge=0.0, le=90.0)] = 14.0  # from the first window on …
    learning_every_h: Annotated[float, Interval(ge=0.0, le=168.0)] = 0.0  # … a replay so often, to meet many temperatures; 0: as ever
    evidence_windows: tuple[str, ...] = ()  # "22:00-05:00": where a replay may be pulled forward to; empty: it is not
    evidence_pause_h: Annotated[float, Interval(ge=1.0, le=720.0)] = 24.0  # at most one pulled forward in so long

    def __post_init__(self) -> None:
        """Raises BadInput naming the setting, its value and what would be right."""
        self.zone()
        _fires(self.cron)
        if not self.jitter_s < self.grace_s:
            raise BadInput(
                f"schedule.jitter_s = {self.jitter_s:g}: expected less than grace_s = {self.grace_s:g}, or windows close unopened"
            )
        wrong = [text for text in self.blackout if not _is_days(text)]
        if wrong:
            raise BadInput(f"schedule.blackout = {_listed(wrong)}: expected a day or two, e.g. 2026-12-25 or 2026-12-24..2027-01-02")
        wrong = [text for text in self.evidence_windows if not _SPAN.match(text)]
        if wrong:
            raise BadInput(f"schedule.evidence_windows = {_listed(wrong)}: expected HH:MM-HH:MM, e.g. 22:00-05:00")

    def zone(self) -> ZoneInfo:
        """The time zone. Raises BadInput."""
        try:
            return ZoneInfo(self.timezone)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            raise BadInput(f"schedule.timezone = {self.timezone!r}: expected a name such as UTC or Europe/Berlin") from None


class Window(NamedTuple):
    """One span in which one replay may begin."""

    key_unix_s: float  # what the ledger knows it by
    opens_unix_s: float
    closes_unix_s: float
    why: str  # cron, every, learning, cold start, evidence


class Triggers(NamedTuple):
    """What else may open a window: the arm ran again after a long rest; something was seen in production."""

    cold_start_unix_s: float | None = None
    evidence_unix_s: float | None = None


class WindowCheck(NamedTuple):
    """What the schedule says at one moment."""

    due: Window | None
    merged: tuple[Window, ...]  # open too: one replay serves them all
    missed: tuple[Window, ...]  # closed without one


def check_windows(
    settings: ScheduleSettings,
    *,
    now_unix_s: float,
    since_unix_s: float,
    entered: Iterable[float],
    began_unix_s: float | None,
    salt: str = "",
    triggers: Triggers | None = None,
) -> WindowCheck:
    """What is due now, and what was missed.

    since_unix_s : until when the schedule was watched; windows that closed later and are not `entered` (keys in the ledger) were missed.
    began_unix_s : the history's first window; the learning phase is counted from it.
    """
    since = max(min(since_unix_s, now_unix_s), now_unix_s - LOOK_BACK_S)
    have = set(entered)
    longest = settings.grace_s
    known = [
        window
        for window in (
            *windows(settings, since - longest, now_unix_s, began_unix_s, salt),
            *_triggered_windows(settings, triggers or Triggers()),
        )
        if window.key_unix_s not in have
    ]
    open_now = sorted((each for each in known if each.opens_unix_s <= now_unix_s < each.closes_unix_s), key=lambda each: each.key_unix_s)
    missed = sorted(each for each in known if since < each.closes_unix_s <= now_unix_s)
    return WindowCheck(open_now[-1] if open_now else None, tuple(open_now[:-1]), tuple(missed[-MOST_MISSED:]))


def reach_back_s(settings: ScheduleSettings) -> float:
    """How long ago a window that matters now may have its key: what the ledger must be asked for, beyond `since`."""
    return settings.grace_s + max(DAY_S + 2 * 3600.0, 3600.0 * settings.evidence_pause_h)


def windows(settings: ScheduleSettings, from_unix_s: float, to_unix_s: float, began_unix_s: float | None, salt: str = "") -> list[Window]:
    """The windows with a key in [from, to], in order; those of blackout days are left out."""
    found: dict[float, str] = {}
    for key in _cron_keys(settings, from_unix_s, to_unix_s):
        found.setdefault(key, "cron")
    for key in _regular(settings.every_h, from_unix_s, to_unix_s):
        found.setdefault(key, "every")
    if settings.learning_every_h and settings.learning_days:
        began = to_unix_s if began_unix_s is None else began_unix_s
        for key in _regular(settings.learning_every_h, max(from_unix_s, began), min(to_unix_s, began + DAY_S * settings.learning_days)):
            found.setdefault(key, "learning")
    dark = _dark(settings)
    every = (Window(key, key + settings.jitter_s * _lot(salt, key), key + settings.grace_s, found[key]) for key in sorted(found))
    return [lit for window in every if not _within(dark, window.key_unix_s) and (lit := _lit(dark, window)) is not None]


def upcoming(settings: ScheduleSettings, now_unix_s: float, count: int, began_unix_s: float | None, salt: str = "") -> list[Window]:
    """The next windows that open, at most `count`, within the next 400 days."""
    for days in (2, 40, 400):
        found = [
            window
            for window in windows(settings, now_unix_s - settings.jitter_s, now_unix_s + days * DAY_S, began_unix_s, salt)
            if window.opens_unix_s > now_unix_s
        ]
        if len(found) >= count:
            break
    return found[:count]


class Ledger(Protocol):
    """What is asked of the history."""

    def began_unix_s(self) -> float | None:
        """When the first window was entered."""

    def windows(self, from_unix_s: float, to_unix_s: float) -> set[float]:
        """Keys of the windows that it has."""


def expected(settings: ScheduleSettings, now_unix_s: float, count: int, ledger: Ledger | None, salt: str = "") -> list[Window]:
    """The next windows that the ledger does not have yet; None is a history that has not begun."""
    taken = set() if ledger is None else ledger.windows(now_unix_s - DAY_S, now_unix_s + 400 * DAY_S)
    found = upcoming(settings, now_unix_s, count + len(taken), None if ledger is None else ledger.began_unix_s(), salt)
    return [window for window in found if window.key_unix_s not in taken][:count]


# --- what opens a window beside the clock ----------------------------------------------------------------------------


def _triggered_windows(settings: ScheduleSettings, triggers: Triggers) -> Iterator[Window]:
    dark = _dark(settings)
    for made in (cold_start_window(settings, triggers.cold_start_unix_s), evidence_window(settings, triggers.evidence_unix_s)):
        if made is not None and (lit := _lit(dark, made)) is not None:
            yield lit


def _dark(settings: ScheduleSettings) -> list[tuple[float, float]]:
    """The blackouts as spans of time."""
    zone = settings.zone()
    days = [_days(text) for text in settings.blackout]
    return [(_unix_s(datetime.combine(first, time()), zone), _unix_s(datetime.combine(last, time.max), zone)) for first, last in days]


def _within(spans: Iterable[tuple[float, float]], unix_s: float) -> bool:
    return any(begin <= unix_s < end for begin, end in spans)


def _lit(dark: Collection[tuple[float, float]], window: Window) -> Window | None:
    """A window as far as it lies before a blackout: one that is open at midnight closes then. None where nothing is left of it."""
    closes = min((begin for begin, _ in dark if window.opens_unix_s < begin < window.closes_unix_s), default=window.closes_unix_s)
    return None if _within(dark, window.opens_unix_s) else window._replace(closes_unix_s=closes)


def cold_start_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """The arm ran again at that time, after a rest: once a day, from then on."""
    if at_unix_s is None or not settings.cold_start_after_h:
        return None
    zone = settings.zone()
    midnight = _unix_s(datetime.combine(datetime.fromtimestamp(at_unix_s, tz=zone).date(), time()), zone)
    return Window(midnight + COLD_START_KEY_S, at_unix_s, at_unix_s + settings.grace_s, "cold start")


def evidence_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """Something was seen at that time: the first span that allows it to be looked into, at most once a pause."""
    if at_unix_s is None or not settings.evidence_windows:
        return None
    pause_s = 3600.0 * settings.evidence_pause_h
    key = at_unix_s // pause_s * pause_s + EVIDENCE_KEY_S
    opens, closes = min(_spans(settings, at_unix_s))
    return Window(key, max(opens, at_unix_s), closes, "evidence")


def _spans(settings: ScheduleSettings, at_unix_s: float) -> Iterator[tuple[float, float]]:
    """The spans that are open at that time or open after it, each for the days around."""
    zone = settings.zone()
    today = datetime.fromtimestamp(at_unix_s, tz=zone).date()
    for text in settings.evidence_windows:
        first, _, last = text.partition("-")
        for day in (today - timedelta(days=1), today, today + timedelta(days=1)):
            opens = _unix_s(datetime.combine(day, time.fromisoformat(first)), zone)
            if last == "24:00" or last <= first:
                closes = _unix_s(datetime.combine(day + timedelta(days=1), time() if last == "24:00" else time.fromisoformat(last)), zone)
            else:
                closes = _unix_s(datetime.combine(day, time.fromisoformat(last)), zone)
            if closes > at_unix_s:
                yield opens, closes


class ColdStart:
    """When the arm ran again after a long rest, from what is heard of it."""

    def __init__(self, last_running_unix_s: float | None) -> None:
        self.last_running_unix_s = last_running_unix_s  # from before this process, where it is known
        self.at_unix_s: float | None = None
        self._rested = False  # seen at rest by this process: a gap in our own listening is no rest of the arm's

    def observe(self, running: bool, now_unix_s: float, after_h: float) -> None:
        """What is heard now; also that nothing is."""
        if not running:
            self._rested = True
            return
        last = self.last_running_unix_s
        if self._rested and after_h > 0 and last is not None and now_unix_s - last >= 3600.0 * after_h:
            self.at_unix_s = now_unix_s
        self._rested, self.last_running_unix_s = False, now_unix_s


class WarmUp:
    """Whether the joints' temperatures are steady: warm from work, or as cold as the room."""

    SPAN_S, STEP_S = 600.0, 10.0

    def __init__(self) -> None:
        self._seen: list[tuple[float, tuple[float, ...]]] = []

    def observe(self, temperature_c: Iterable[float], now_unix_s: float) -> None:
        """Temperatures [°C] now."""
        if self._seen and now_unix_s - self._seen[-1][0] < self.STEP_S:
            if now_unix_s < self._seen[-1][0]:
                self._seen.clear()  # the clock was set back
            return
        self._seen.append((now_unix_s, tuple(temperature_c)))
        while now_unix_s - self._seen[0][0] > self.SPAN_S + 2 * self.STEP_S:
            del self._seen[0]

    def steady(self, now_unix_s: float, within_k: float) -> bool:
        """Heard for ten minutes without a hole of a minute, and no joint moved by more than that."""
        times = [at for at, _ in self._seen]
        if not times or now_unix_s - times[0] < self.SPAN_S:
            return False
        if any(after - before > 60.0 for before, after in zip(times, [*times[1:], now_unix_s], strict=True)):
            return False
        return all(max(joint) - min(joint) <= within_k for joint in zip(*(values for _, values in self._seen), strict=True))


# --- keys ------------------------------------------------------------------------------------------------------------


def _cron_keys(settings: ScheduleSettings, from_unix_s: float, to_unix_s: float) -> Iterator[float]:
    """Every time of the wall clock that cron names, once: an hour that comes twice in autumn counts the first time.

    An hour that spring leaves out is taken an hour later, as cron does.
    """
    trigger = _fires(settings.cron)
    if trigger is None:
        return
    zone = settings.zone()
    # the trigger runs over the wall clock's readings as if they were UTC, where every one of them exists exactly once
    reading = (datetime.fromtimestamp(from_unix_s, tz=zone) - timedelta(hours=3)).replace(tzinfo=UTC)
    end = (datetime.fromtimestamp(to_unix_s, tz=zone) + timedelta(hours=3)).replace(tzinfo=UTC)
    seen: set[float] = set()
    while (at := trigger.get_next_fire_time(None, reading)) is not None and at <= end:
        key = _unix_s(at.replace(tzinfo=None), zone)
        if from_unix_s <= key <= to_unix_s and key not in seen:
            seen.add(key)
            yield key
        reading = at + timedelta(microseconds=1)


def _regular(every_h: float, from_unix_s: float, to_unix_s: float) -> Iterator[float]:
    if every_h <= 0:
        return
    step_s = 3600.0 * every_h
    k = -(-from_unix_s // step_s)
    while k * step_s <= to_unix_s:
        yield k * step_s
        k += 1


def _unix_s(reading: datetime, zone: ZoneInfo) -> float:
    return reading.replace(tzinfo=zone, fold=0).timestamp()


def _lot(salt: str, key: float) -> float:
    """A window's own number in [0, 1): the same after every restart, another for every robot."""
    return int.from_bytes(hashlib.sha256(f"{salt} {key!r}".encode()).digest()[:6]) / 2**48


@cache  # a trigger holds no state, and costs more to make than to ask
def _fires(expression: str) -> Any:
    """The trigger of five cron fields, None for none. Raises BadInput."""
    from apscheduler.triggers.cron import CronTrigger

    if not expression.strip():
        return None
    fields = expression.split()
    try:
        if len(fields) != 5:
            raise ValueError(f"{len(fields)} fields")
        return CronTrigger.from_crontab(" ".join((*fields[:4], _weekdays(fields[4]))), timezone=UTC)
    except ValueError as error:
        said = re.sub(r"[.]$", "", str(error))
        raise BadInput(f"schedule.cron = {expression!r}: {said}; expected five fields, e.g. '0 3 * * *' for 03:00 every day") from None


def _weekdays(field: str) -> str:
    """The fifth field with names for numbers, as cron(5) counts them."""
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
        names += [_WEEKDAYS[day % 7] for day in range(low, high + 1, int(step) if slash else 1)]
    return ",".join(dict.fromkeys(names))


def _days(text: str) -> tuple[date, date]:
    """The first and the last day of a blackout. Raises ValueError."""
    first, _, last = (part.strip() for part in text.partition(".."))
    return date.fromisoformat(first), date.fromisoformat(last or first)


def _is_days(text: str) -> bool:
    try:
        first, last = _days(text)
    except ValueError:
        return False
    return first <= last


def _listed(texts: Iterable[str]) -> str:
    return ", ".join(repr(text) for text in texts)
