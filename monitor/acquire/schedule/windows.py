"""Windows: spans of time in which one replay may begin, each with a key that the ledger knows it by.

Keys follow from the settings alone. So a restart, a second process, or a clock that jumps finds the same keys, and the ledger lets each
of them be used once.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple, Protocol

from monitor.acquire.schedule.cron import cron_times
from monitor.acquire.schedule.local_time import blackout
from monitor.acquire.schedule.settings import ScheduleSettings
from monitor.recording import DAY_S

HORIZONS_DAYS = (2, 40, 400)  # coming windows are searched so far ahead, step by step until there are enough


class Window(NamedTuple):
    """One span in which one replay may begin."""

    key_unix_s: float  # what the ledger knows it by
    opens_unix_s: float
    closes_unix_s: float
    why: str  # cron, every, learning, cold start or evidence


def windows(settings: ScheduleSettings, from_unix_s: float, to_unix_s: float, began_unix_s: float | None, salt: str = "") -> list[Window]:
    """The windows of the clock with a key in [from, to], in order, without those of blackout days.

    `began_unix_s` is the beginning of the learning phase; None: it has not begun. `salt` makes the jitter differ between robots.
    """
    found: dict[float, str] = {}
    for key in cron_times(settings.cron, settings.zone(), from_unix_s, to_unix_s):
        found.setdefault(key, "cron")
    for key in _regular_times(settings.every_h, from_unix_s, to_unix_s):
        found.setdefault(key, "every")
    if settings.learning_every_h and settings.learning_days:
        began = to_unix_s if began_unix_s is None else began_unix_s
        end = min(to_unix_s, began + DAY_S * settings.learning_days)
        for key in _regular_times(settings.learning_every_h, max(from_unix_s, began), end):
            found.setdefault(key, "learning")
    dark = blackouts(settings)
    every = (Window(key, key + settings.jitter_s * _share(salt, key), key + settings.grace_s, found[key]) for key in sorted(found))
    return [left for window in every if not _within(dark, window.key_unix_s) and (left := before_blackouts(dark, window)) is not None]


def upcoming(settings: ScheduleSettings, now_unix_s: float, count: int, began_unix_s: float | None, salt: str = "") -> list[Window]:
    """The next windows that open, at most `count`, within the last of HORIZONS_DAYS."""
    for days in HORIZONS_DAYS:
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
        """When the first window was entered; None where the ledger is empty."""

    def windows(self, from_unix_s: float, to_unix_s: float) -> set[float]:
        """The keys in [from, to] that the ledger holds."""


def expected(settings: ScheduleSettings, now_unix_s: float, count: int, ledger: Ledger | None, salt: str = "") -> list[Window]:
    """The next windows that the ledger does not hold yet, at most `count`; None is a history that has not begun."""
    taken = set() if ledger is None else ledger.windows(now_unix_s - DAY_S, now_unix_s + HORIZONS_DAYS[-1] * DAY_S)
    found = upcoming(settings, now_unix_s, count + len(taken), None if ledger is None else ledger.began_unix_s(), salt)
    return [window for window in found if window.key_unix_s not in taken][:count]


def blackouts(settings: ScheduleSettings) -> list[tuple[float, float]]:
    """Beginning and end [s, UTC] of each blackout."""
    zone = settings.zone()
    return [blackout(text, zone) for text in settings.blackout]


def before_blackouts(dark: Collection[tuple[float, float]], window: Window) -> Window | None:
    """The part of a window before the next blackout: a window that is open at midnight closes then. None where nothing is left of it."""
    closes = min((begin for begin, _ in dark if window.opens_unix_s < begin < window.closes_unix_s), default=window.closes_unix_s)
    return None if _within(dark, window.opens_unix_s) else window._replace(closes_unix_s=closes)


def _within(spans: Iterable[tuple[float, float]], unix_s: float) -> bool:
    return any(begin <= unix_s < end for begin, end in spans)


def _regular_times(every_h: float, from_unix_s: float, to_unix_s: float) -> Iterator[float]:
    """The multiples of an interval since 1970 in [from, to]; none for an interval of 0."""
    if every_h <= 0:
        return
    step_s = 3600.0 * every_h
    k = -(-from_unix_s // step_s)
    while k * step_s <= to_unix_s:
        yield k * step_s
        k += 1


def _share(salt: str, key: float) -> float:
    """A window's own number in [0, 1): the same after every restart, another for every robot."""
    return int.from_bytes(hashlib.sha256(f"{salt} {key!r}".encode()).digest()[:6]) / 2**48
