"""How long nothing was learnt: a monitor whose replays all fail must say so, because silence looks like health."""

import functools
from collections import Counter
from itertools import pairwise

from monitor.acquire.schedule.settings import ScheduleSettings
from monitor.acquire.schedule.windows import upcoming
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S
from monitor.store.store import Store

INTERVALS = 3.0  # so many windows in a row without a verdict are no chance
LEAST_DAYS = 2.0  # a monitor that replays every hour is not late after three hours of production
COMING_WINDOWS = 15  # the longest pause between them is the schedule's interval: two weeks of a daily one, with its weekends
COUNTED = 1000  # newest windows of which the text counts how they ended


def limit_days(settings: ScheduleSettings, now_unix_s: float, began_unix_s: float | None) -> float | None:
    """After so many days without a verdict something is wrong; None where the schedule names no windows."""
    if settings.learn_within_days > 0.0:
        return settings.learn_within_days
    interval_days = _interval_days(settings, began_unix_s, int(now_unix_s // 3600.0))
    return None if interval_days is None else max(LEAST_DAYS, INTERVALS * interval_days)


@functools.lru_cache(maxsize=4)  # it is asked every minute, and a rare schedule is searched 400 days ahead
def _interval_days(settings: ScheduleSettings, began_unix_s: float | None, hour: int) -> float | None:
    """The longest pause between coming windows, by the hour since 1970; None where fewer than two are coming."""
    opens = [window.opens_unix_s for window in upcoming(settings, 3600.0 * hour, COMING_WINDOWS, began_unix_s)]
    return max(((b - a) / DAY_S for a, b in pairwise(opens)), default=None)


def nothing_learnt(settings: ScheduleSettings, store: Store, now_unix_s: float) -> str | None:
    """For how long nothing was learnt, and why, where that is too long; else None. Raises StoreError."""
    began = store.ledger.began_unix_s()
    since = store.ledger.learnt_at_unix_s() or began
    limit = limit_days(settings, now_unix_s, began)
    if since is None or limit is None or now_unix_s - since < limit * DAY_S:
        return None
    windows = [row for row in store.ledger.rows(limit=COUNTED) if row.started_at_unix_s >= since and row.state != "assessed"]
    counts = ", ".join(f"{count} {state}" for state, count in Counter(row.state for row in windows).most_common()) or "none"
    newest = next((row.reason for row in reversed(windows) if row.reason), None)
    text = (
        f"nothing was learnt of this arm for {(now_unix_s - since) / DAY_S:.0f} days, since {rfc3339(since)}; windows since then: {counts}"
    )
    return text if newest is None else f"{text}; the last one: {newest}"
