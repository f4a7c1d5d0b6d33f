"""What the monitor knows of itself between replays: since when nothing moves, nothing was learnt, and the arm is not heard.

A monitor whose replays all fail must say so, because silence looks like health.
"""

import functools
import time
from collections import Counter
from collections.abc import Callable

from monitor.acquire.schedule.needed import WHEN_NEEDED
from monitor.acquire.schedule.windows import ScheduleSettings, upcoming
from monitor.config.schema import Configuration
from monitor.judge.alerts.condition import Allowed, ServiceSituation, Standing
from monitor.publish.timestamps import rfc3339
from monitor.reason import Reason, Sentence, reason_of
from monitor.recording import DAY_S
from monitor.service.lending import DueReplay
from monitor.service.scheduler import NO_REFUSAL
from monitor.store.store import Store

WINDOWS = 3  # so many in a row without a verdict are no chance
LEAST_DAYS = 2.0  # a monitor that replays every hour is not late after three hours of production
UNHEARD_WINDOWS, UNHEARD_DAYS = 2, 1.0  # an arm that is switched off for a night or a shift is not lost
WITHOUT_WINDOWS_DAYS = 3.0  # an arm that is not heard, where the schedule names no windows
COUNTED = 1000  # newest windows of which the text counts how they ended
HEARD = "arm_heard_at"  # name of the note with the time at which the arm was heard last, or was listened for first
_NOTHING = "nothing was learnt of this arm for {days:.0f} days, since {since}; windows since then: {counts}"
NOTHING_LEARNT = Sentence("learnt_nothing", _NOTHING)
NOTHING_LEARNT_LAST = Sentence("learnt_nothing_last", _NOTHING + "; the last one: {last}")
NOTHING_LEARNT_DUE = Sentence("learnt_nothing_due", _NOTHING + "; a replay is {due}")
NOTE_EVERY_S = 600.0  # between two writes of that note
TRIED_S = 60.0  # so long after the start an arm that answers has been heard


def late_at(settings: ScheduleSettings, since_unix_s: float, began_unix_s: float | None) -> float | None:
    """When something is wrong if nothing was learnt since a time; None where the schedule names no windows."""
    if settings.learn_within_days > 0.0:
        return since_unix_s + DAY_S * settings.learn_within_days
    if settings.replay == WHEN_NEEDED:  # windows without a replay are as they should be
        since_unix_s += DAY_S * settings.at_most_days
    return _after_windows(settings, since_unix_s, began_unix_s, WINDOWS, LEAST_DAYS)


@functools.lru_cache(maxsize=8)  # it is asked every ten seconds, and a rare schedule is searched 400 days ahead
def _after_windows(settings: ScheduleSettings, since: float, began: float | None, count: int, least_days: float) -> float | None:
    """When so many windows have closed since a time, and so many days have passed; None where fewer are to come."""
    found = upcoming(settings, since, count, began)
    return max(found[-1].closes_unix_s, since + DAY_S * least_days) if len(found) == count else None


def unlearnt(configuration: Configuration, store: Store) -> Standing | None:
    """Since when nothing was learnt, and until when that is as it should be; None before the first window. Raises StoreError."""
    began = store.ledger.began_unix_s()
    learnt = store.ledger.learnt_at_unix_s()
    since = began if learnt is None else learnt
    if since is None:
        return None
    until = late_at(configuration.schedule, since, began)
    if until is None and learnt is not None:  # replays come on request alone: a joint is STALE then
        until = learnt + DAY_S * configuration.assess.health.stale_days
    rows = [row for row in store.ledger.rows(limit=1) if row.started_at_unix_s >= since and row.state != "assessed"]
    return Standing(since, next((row.reason for row in rows if row.reason), None), until)


def nothing_learnt(configuration: Configuration, store: Store, now_unix_s: float, due: DueReplay | None = None) -> Reason | None:
    """For how long nothing was learnt, and why, where that is too long; else None. Raises StoreError."""
    standing = unlearnt(configuration, store)
    if standing is None or standing.until_unix_s is None or now_unix_s < standing.until_unix_s:
        return None
    since = standing.since_unix_s
    windows = [row for row in store.ledger.rows(limit=COUNTED) if row.started_at_unix_s >= since and row.state != "assessed"]
    counts = ", ".join(f"{count} {state}" for state, count in Counter(row.state for row in windows).most_common()) or "none"
    newest = next((row.reason for row in reversed(windows) if row.reason), None)
    facts = {"days": (now_unix_s - since) / DAY_S, "since": rfc3339(since), "counts": counts}
    if due is not None:
        return NOTHING_LEARNT_DUE(**facts, due=due.due)
    return NOTHING_LEARNT(**facts) if newest is None else NOTHING_LEARNT_LAST(**facts, last=newest)


class ArmHeard:
    """When the arm was heard last, also before this start of the service."""

    def __init__(self, store: Store, now: Callable[[], float], monotonic: Callable[[], float] = time.monotonic) -> None:
        self._store, self._now, self._monotonic = store, now, monotonic
        note = store.notes.get(HEARD)
        self._at = now() if note is None else float(note)
        self._began = monotonic()
        self._noted = 0.0 if note is None else self._at
        self._problem: Reason | None = None

    def observe(self, heard: bool, problem: Reason | None) -> None:
        """Take whether the arm is heard now, and why it is not. Raises StoreError."""
        now, self._problem = self._now(), problem
        if heard:
            self._at = now
        if abs(self._at - self._noted) >= NOTE_EVERY_S:
            self._noted = self._at
            self._store.notes.set(HEARD, repr(self._at))

    @property
    def _why(self) -> Reason | None:
        return reason_of(self._problem) if self._problem else None

    def standing(self, settings: ScheduleSettings, began_unix_s: float | None) -> Standing | None:
        """Since when the arm is not heard, and for how long that may be; None where it may still be found after the start."""
        if self._monotonic() - self._began < TRIED_S:
            return None
        now = self._now()
        since = min(self._at, now)  # a clock that was set back
        if settings.heard_within_days <= 0.0 and now - since < UNHEARD_DAYS * DAY_S:
            return Standing(since, self._why)  # no search for windows while the arm is heard
        if settings.heard_within_days > 0.0:
            until: float | None = since + DAY_S * settings.heard_within_days
        else:
            until = _after_windows(settings, since, began_unix_s, UNHEARD_WINDOWS, UNHEARD_DAYS)
        return Standing(since, self._why, since + DAY_S * WITHOUT_WINDOWS_DAYS if until is None else until)


def situation(
    configuration: Configuration, store: Store, now_unix_s: float, heard: ArmHeard | None = None, due: DueReplay | None = None
) -> ServiceSituation:
    """What the conditions of the service read. Raises StoreError.

    heard : None where nobody listens to the arm. due : the replay that waits for the program's node.
    """
    waiting = store.stops.waiting()
    allowed = [Allowed(at, stop.allowed_by or "", stop.allowed_why or "") for stop in store.stops.rows() if (at := stop.allowed_at_unix_s)]
    refused = store.ledger.refused_in_a_row(NO_REFUSAL)
    return ServiceSituation(
        now_unix_s=now_unix_s,
        stop=Standing(waiting[0].at_unix_s, waiting[-1].said) if waiting else None,
        refused=None if refused is None else Standing(refused[1], refused[2], windows=refused[0]),
        unlearnt=unlearnt(configuration, store),
        unheard=None if heard is None else heard.standing(configuration.schedule, store.ledger.began_unix_s()),
        allowed=max(allowed, default=None),
        due=None if due is None else Standing(due.since_unix_s, due.waits_for),
    )
