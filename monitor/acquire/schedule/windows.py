"""When to replay: the settings, the windows that they open, what opens one beside the clock, and what is due or missed now.

A window is a span of time in which one replay may begin. Its key follows from the settings alone: a restart, a second process, or a clock
that jumps finds the same keys, and the ledger lets each of them be used once.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple, Protocol
from zoneinfo import ZoneInfo

from annotated_types import Interval

from monitor.acquire.schedule.times import blackout, cron_times, cron_trigger, is_blackout, is_span, midnight_before, spans_from, time_zone
from monitor.errors import BadInput
from monitor.recording import DAY_S


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleSettings:
    """When to replay."""

    timezone: str = "UTC"  # of cron, blackout and evidence_windows
    cron: str = "0 3 * * *"  # minute, hour, day, month, weekday; empty: no such windows
    every_h: Annotated[float, Interval(ge=0.0, le=8784.0)] = 0.0  # [h] between further windows, counted in UTC; 0: no such windows
    replay: Literal["always", "when_needed"] = "always"  # in every window; or only where the arm's ordinary work does not tell enough
    at_most_days: Annotated[float, Interval(ge=1.0, le=365.0)] = 30.0  # [d] without a replay, where replay is when_needed
    unobserved_days: Annotated[float, Interval(ge=1.0, le=90.0)] = 7.0  # [d] without an observation of a joint, likewise
    grace_s: Annotated[float, Interval(ge=10.0, le=86400.0)] = 600.0  # [s] a window stays open; one without a replay is logged as skipped
    tries: Annotated[int, Interval(ge=1, le=10)] = 3  # replays begun in one window where this machine or the network ended the one before
    try_again_after_s: Annotated[float, Interval(ge=1.0, le=3600.0)] = 60.0  # [s] before the next of them
    learn_within_days: Annotated[float, Interval(ge=0.0, le=3660.0)] = (
        0.0  # [d] without a verdict are a problem; 0: three windows, at least 2 d
    )
    heard_within_days: Annotated[float, Interval(ge=0.0, le=3660.0)] = 0.0  # [d] an arm may be unheard; 0: two windows, at least 1 d
    jitter_s: Annotated[float, Interval(ge=0.0, le=43200.0)] = 0.0  # [s] each window opens later by a share of this, its own for each robot
    blackout: tuple[str, ...] = ()  # "2026-12-24..2027-01-02" or single days on which no window opens
    after_warm_up: bool = False  # begin only while the joints' temperatures are steady
    warm_k_per_10_min: Annotated[float, Interval(ge=0.05, le=20.0)] = 0.5  # [K] temperatures that change by less in 10 min are steady
    cold_start_after_h: Annotated[float, Interval(ge=0.0, le=168.0)] = 0.0  # [h] of rest before a cold start opens a window; 0: none does
    learning_days: Annotated[float, Interval(ge=0.0, le=90.0)] = 14.0  # [d] the learning phase, from the first window on
    learning_every_h: Annotated[float, Interval(ge=0.0, le=168.0)] = 0.0  # [h] between windows in that phase; 0: as at any time
    evidence_windows: tuple[str, ...] = ()  # "22:00-05:00": when a replay may be pulled forward; empty: never
    evidence_pause_h: Annotated[float, Interval(ge=1.0, le=720.0)] = 24.0  # [h] at most one replay is pulled forward in this time
    seek_temperatures: bool = False  # in evidence_windows, a window of its own at each temperature without a replay for a week

    def __post_init__(self) -> None:
        """Raises BadInput naming the setting, its value and what would be right."""
        self.zone()
        cron_trigger(self.cron)
        if not self.jitter_s < self.grace_s:
            raise BadInput(
                f"schedule.jitter_s = {self.jitter_s:g}: expected less than grace_s = {self.grace_s:g}, or windows close unopened"
            )
        if self.unobserved_days > self.at_most_days:
            raise BadInput(f"schedule.unobserved_days = {self.unobserved_days:g}: expected at most at_most_days = {self.at_most_days:g}")
        wrong = [text for text in self.blackout if not is_blackout(text)]
        if wrong:
            raise BadInput(f"schedule.blackout = {_listed(wrong)}: expected a day or two, e.g. 2026-12-25 or 2026-12-24..2027-01-02")
        wrong = [text for text in self.evidence_windows if not is_span(text)]
        if wrong:
            raise BadInput(f"schedule.evidence_windows = {_listed(wrong)}: expected HH:MM-HH:MM, e.g. 22:00-05:00")

        if self.seek_temperatures and not self.evidence_windows:
            raise BadInput("schedule.seek_temperatures = true: expected evidence_windows, which say when a replay may be pulled forward")

    def zone(self) -> ZoneInfo:
        """The time zone. Raises BadInput."""
        return time_zone(self.timezone, "schedule.timezone")


def _listed(texts: Iterable[str]) -> str:
    return ", ".join(repr(text) for text in texts)


HORIZONS_DAYS = (2, 40, 400)  # coming windows are searched so far ahead, step by step until there are enough


class Window(NamedTuple):
    """One span in which one replay may begin."""

    key_unix_s: float  # what the ledger knows it by
    opens_unix_s: float
    closes_unix_s: float
    why: str  # cron, every, learning, cold start, evidence or missing temperature


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


# two windows with one key are one window; these offsets keep the keys of cold start and evidence apart from those of the clock
COLD_START_KEY_S = 0.001  # after the beginning of the day
EVIDENCE_KEY_S = 0.002  # after the beginning of a pause
SOUGHT_KEY_S = 0.01  # likewise, and so much again for each row of temperatures
COLD_START, EVIDENCE, MISSING = "cold start", "evidence", "missing temperature"
PULLED_FORWARD = frozenset({EVIDENCE, MISSING})  # they are needed whatever else is


class Sought(NamedTuple):
    """The joints are at a temperature at which no replay was made of late."""

    at_unix_s: float  # since when, or since the last look
    row: int  # of the temperatures that are told apart, from 0


class Triggers(NamedTuple):
    """When something opened a window beside the clock; None: nothing did."""

    cold_start_unix_s: float | None = None  # the arm ran again after a long rest
    evidence_unix_s: float | None = None  # production motion indicated more friction
    sought: Sought | None = None


def triggered_windows(settings: ScheduleSettings, triggers: Triggers) -> Iterator[Window]:
    """The windows that the triggers open, as far as no blackout forbids them."""
    dark = blackouts(settings)
    for made in (
        cold_start_window(settings, triggers.cold_start_unix_s),
        evidence_window(settings, triggers.evidence_unix_s),
        sought_window(settings, triggers.sought),
    ):
        if made is not None and (left := before_blackouts(dark, made)) is not None:
            yield left


def cold_start_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """The window of an arm that ran again at that time, after a rest; its key allows one such window a day."""
    if at_unix_s is None or not settings.cold_start_after_h:
        return None
    key = midnight_before(at_unix_s, settings.zone()) + COLD_START_KEY_S
    return Window(key, at_unix_s, at_unix_s + settings.grace_s, COLD_START)


def evidence_window(settings: ScheduleSettings, at_unix_s: float | None) -> Window | None:
    """The window of evidence that was seen at that time: the first allowed span; its key allows one such window a pause."""
    if at_unix_s is None or not settings.evidence_windows:
        return None
    pause_s = 3600.0 * settings.evidence_pause_h
    key = at_unix_s // pause_s * pause_s + EVIDENCE_KEY_S
    zone = settings.zone()
    opens, closes = min(span for text in settings.evidence_windows for span in spans_from(text, at_unix_s, zone))
    return Window(key, max(opens, at_unix_s), closes, EVIDENCE)


def sought_window(settings: ScheduleSettings, sought: Sought | None) -> Window | None:
    """The window of a missing temperature, in an allowed span; its key allows one such window a pause and row of temperatures."""
    if sought is None or not settings.seek_temperatures:
        return None
    at, pause_s, zone = sought.at_unix_s, 3600.0 * settings.evidence_pause_h, settings.zone()
    closes = max((end for text in settings.evidence_windows for begin, end in spans_from(text, at, zone) if begin <= at), default=at)
    if closes <= at:
        return None
    return Window(at // pause_s * pause_s + SOUGHT_KEY_S * (sought.row + 1), at, min(closes, at + settings.grace_s), MISSING)


LOOK_BACK_S = 60 * DAY_S  # windows missed longer ago are not entered one by one
MOST_MISSED = 60  # windows that are reported as missed at once, the latest ones
LONGEST_DAY_S = DAY_S + 2 * 3600.0  # a day on which the wall clock is set back, with an hour to spare


class WindowCheck(NamedTuple):
    """What the schedule says at one moment."""

    due: Window | None
    merged: tuple[Window, ...]  # open too: one replay serves them all
    missed: tuple[Window, ...]  # closed without a replay


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

    `since_unix_s` is the time until which the schedule was watched: windows that closed later, and whose keys are not `entered` in the
    ledger, were missed. `began_unix_s` is the ledger's first window, from which the learning phase is counted.
    """
    since = max(min(since_unix_s, now_unix_s), now_unix_s - LOOK_BACK_S)
    used = set(entered)
    of_the_clock = windows(settings, since - settings.grace_s, now_unix_s, began_unix_s, salt)
    known = [window for window in (*of_the_clock, *triggered_windows(settings, triggers or Triggers())) if window.key_unix_s not in used]
    open_now = sorted((each for each in known if each.opens_unix_s <= now_unix_s < each.closes_unix_s), key=lambda each: each.key_unix_s)
    missed = sorted(each for each in known if since < each.closes_unix_s <= now_unix_s)
    return WindowCheck(open_now[-1] if open_now else None, tuple(open_now[:-1]), tuple(missed[-MOST_MISSED:]))


def reach_back_s(settings: ScheduleSettings) -> float:
    """How long before `since_unix_s` a window that matters now may have its key: so far back the ledger must be asked."""
    return settings.grace_s + max(LONGEST_DAY_S, 3600.0 * settings.evidence_pause_h)
