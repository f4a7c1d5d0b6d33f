"""How long nothing was learnt: a monitor whose replays all fail must say so, because silence looks like health."""

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
    opens = [window.opens_unix_s for window in upcoming(settings, now_unix_s, COMING_WINDOWS, began_unix_s)]
    pauses_days = [(b - a) / DAY_S for a, b in pairwise(opens)]
    return max(LEAST_DAYS, INTERVALS * max(pauses_days)) if pauses_days else None


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
