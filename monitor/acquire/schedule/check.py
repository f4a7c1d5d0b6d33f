"""What the schedule says at one moment: the window that is due, and those that were missed."""

from collections.abc import Iterable
from typing import NamedTuple

from monitor.acquire.schedule.settings import ScheduleSettings
from monitor.acquire.schedule.triggers import Triggers, triggered_windows
from monitor.acquire.schedule.windows import Window, windows
from monitor.recording import DAY_S

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
