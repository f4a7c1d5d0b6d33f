"""The scheduler's thread: performs each window once, when it is due. One replay runs at a time, and no window runs twice.

`check_windows` decides what is due, the guards decide what may move, and the ledger records what happened.
"""

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from monitor.acquire.schedule.needed import ColdStart, Need, WarmUp, needed_windows
from monitor.acquire.schedule.windows import PULLED_FORWARD, Sought, Triggers, Window, check_windows, reach_back_s, upcoming, windows
from monitor.errors import MonitorError
from monitor.publish.timestamps import rfc3339
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S
from monitor.service.history.needed import NOT_NEEDED, not_needed
from monitor.service.lending import SERVED, Lender, Lending
from monitor.service.problems import Problems
from monitor.service.replay import UNREACHABLE
from monitor.service.shared_state import ReplayRequests
from monitor.store.history.ledger import Kind, LedgerRow
from monitor.store.store import Store

log = logging.getLogger(__name__)

NOT_STEADY = Sentence("temperatures_not_steady", "the arm's temperatures are not steady")
MISSED_NOT_STEADY = Sentence("missed_not_steady", "missed: the arm's temperatures were not steady while the window was open")
MISSED = Sentence("missed", "missed: the monitor or its host was not running, or had another replay under way")
SERVED_BY_REQUEST = Sentence("window_served_by_request", "one replay serves this window and the request of {at}")
DISK_FAILS = Sentence("disk_fails", "disk: {folder}: {error}")
DISK_READ_ONLY = Sentence("disk_read_only", "disk: {folder} can only be read")
DISK_FULL = Sentence("disk_full", "disk: {free_mb:.0f} MB are free in {folder}; {least_mb:.0f} MB are wanted before an arm moves")
FAULT = Sentence("schedule_fault", "{error}: {text}")
CLOCK_NEVER_SET = Sentence("clock_never_set", "the clock says {at}; nothing is replayed before it has been set right")
CLOCK_SET_FORWARD = Sentence(
    "clock_set_forward", "the clock was set forward by {days:.1f} days; nothing is replayed for an hour, then it is believed"
)
CANNOT_TAKE_BACK = Sentence("future_stays", "replays dated in the future cannot be taken back: older recordings are gone")
# windows that neither the arm nor its cell has refused
NO_REFUSAL_SENTENCES = (MISSED, MISSED_NOT_STEADY, NOT_STEADY, SERVED, SERVED_BY_REQUEST, NOT_NEEDED, DISK_FAILS, DISK_READ_ONLY, DISK_FULL)
NO_REFUSAL = (*(each.code for each in NO_REFUSAL_SENTENCES), UNREACHABLE.code)
TICK_S = 1.0
WAIT_AT_MOST_S = 600.0  # for a program's node at a time: then the schedule and the clocks are looked at again
CHECK_EVERY_S = 30.0  # [s] also where nothing is due: it notes until when the schedule was watched
NOTICED_JUMP_S = 60.0  # between two ticks, UTC against the monotonic clock: a larger difference means that the clock was set
SUSPICIOUS_JUMP_S = DAY_S  # a larger jump forward may be a mistake: nothing moves for `JUMP_WAIT_S`, in which somebody may correct it
JUMP_WAIT_S = 3600.0  # after a suspicious jump
NEVER_SET_UNIX_S = 978_307_200.0  # 2001-01-01: an earlier clock was never set since the host started in 1970, 1980 or 2000
_WATCHED, _RUNNING, _NOT_BEFORE = "schedule_watched_until", "arm_running_until", "schedule_not_before"
_FORWARD = "clock_was_set_forward"  # JSON: the times before and after a suspicious jump


class Performer(Lender, Protocol):
    """What performs windows: the replay cycle."""

    def perform(self, window_unix_s: float, kind: Kind = "scheduled", closes_unix_s: float | None = None) -> LedgerRow | None:
        """Perform one window with all that follows; None where the ledger has it already."""

    def recover(self) -> None:
        """Finish what a failing disk left half-way. Raises StoreError."""

    def roll_back(self) -> bool:
        """Take back every assessment dated in the future; False where that is not possible."""

    def needed(self) -> Need:
        """From when the next replay is needed, and why."""

    def missing_row(self, temperature_c: Sequence[float]) -> int | None:
        """Of which row of the document `compensation` these (J,) temperatures [°C] are, where it lacks replays of late; else None."""

    def next_due(self, unix_s: float | None) -> None:
        """Publish when the next window opens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clocks:
    """The host's clocks: UTC, and a monotonic one that nobody sets."""

    now: Callable[[], float] = time.time
    monotonic: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_BOOTTIME)


class Scheduler:
    """Call `tick` often, or `run` in a thread of its own; `observe` and `reconsider` from any thread."""

    def __init__(
        self, monitor: Performer, store: Store, problems: Problems, requests: ReplayRequests, clocks: Clocks | None = None
    ) -> None:
        self._monitor, self._store, self._problems = monitor, store, problems
        self._requests, self._clocks = requests, clocks or Clocks()
        self._salt = monitor.configuration.key_prefix
        self._evidence_unix_s: float | None = None
        self._last: tuple[float, float] | None = None  # both clocks at the last tick
        self._wait_until = 0.0  # monotonic
        self._next_check = 0.0  # UTC
        self._reconsidered = False  # since a wait for a program's node began
        self._noted = 0.0  # monotonic
        self.lag_s: float | None = None  # of the last replay, from the opening of its window
        self._warmth = WarmUp()
        self._temperature_c: tuple[float, ...] | None = None  # of an arm that is ready to move
        self._sought: Sought | None = None
        now = self._clocks.now()
        running = store.notes.get(_RUNNING)
        self._cold = ColdStart(None if running is None else float(running))
        watched = store.notes.get(_WATCHED)
        self._watched = min(now, float(watched)) if watched is not None else now
        self._not_before = float(store.notes.get(_NOT_BEFORE) or 0.0)
        self._lending = Lending(monitor, store)
        if store.restored is not None:
            # the ledger of the hours before the backup is lost: a window that was open then may have been used
            self._not_before = now
            store.notes.set(_NOT_BEFORE, repr(now))

    # --- from other threads ----------------------------------------------------------------------

    def observe(self, running: bool, temperature_c: tuple[float, ...] | None) -> None:
        """Take the arm's present state: whether it is ready to move, and its (J,) temperatures [°C], where they are known."""
        now = self._clocks.now()
        before = self._cold.at_unix_s
        self._cold.observe(running, now, self._monitor.configuration.schedule.cold_start_after_h)
        if self._cold.at_unix_s != before:
            self._next_check = 0.0
        self._temperature_c = temperature_c if running else None
        if temperature_c is not None:
            self._warmth.observe(temperature_c, now)

    def reconsider(self) -> None:
        """Consider the schedule anew: the configuration has changed."""
        self._next_check = 0.0
        self._reconsidered = True
        self._requests.wake()

    # --- the thread ------------------------------------------------------------------------------

    def run(self, stopping: threading.Event, beat: Callable[[], None]) -> None:
        """Tick once a second until `stopping`. An error is reported as a problem, and the next tick tries again."""
        while not stopping.is_set():
            beat()
            try:
                self.tick()
            except MonitorError as error:
                self._problems.report("store", error.reason)
            except Exception as error:  # the thread must survive an error of this program; the log names it
                log.exception("the schedule met a fault")
                self._problems.report("fault", FAULT(error=type(error).__name__, text=str(error)))
            self._requests.wait(TICK_S)

    def tick(self) -> None:
        """Compare the clocks, and check the schedule where it is time to.

        Raises StoreError where the ledger cannot be written: then nothing has moved.
        """
        now, monotonic = self._clocks.now(), self._clocks.monotonic()
        self._take_evidence()
        self._compare_clocks(now, monotonic)
        if "store" in self._problems or self._store.ledger.unfinished():
            self._store.notes.set(_WATCHED, repr(self._watched))  # what can be read may still be locked, or full
            self._monitor.recover()
            self._problems.clear("store")
        if now < NEVER_SET_UNIX_S:
            self._problems.report("clock", CLOCK_NEVER_SET(at=rfc3339(now)))
            return
        if self._requests.take_request():
            self._requested()
        if monotonic < self._wait_until:
            return
        self._problems.clear("clock")
        self._check_in_time(now, monotonic)
        if self._lending.due is not None:
            self._lend(now)

    def _lend(self, now: float) -> None:
        """Wait for the program's node, and replay there. Meanwhile the clocks are compared and the schedule is checked as ever."""
        due, until = self._lending.due, self._clocks.monotonic() + WAIT_AT_MOST_S
        assert due is not None
        self._reconsidered = False

        def waits() -> bool:
            now, monotonic = self._clocks.now(), self._clocks.monotonic()
            self._look(now, monotonic)
            if monotonic < self._wait_until or monotonic >= until or self._reconsidered:
                return False
            self._check_in_time(now, monotonic)
            return now < due.until_unix_s and self._hindered(now) is None

        row = self._lending.at_a_node(now, self._hindered(now), waits)
        if row is None:
            return
        self.lag_s = row.started_at_unix_s - due.since_unix_s
        if row.kind == "requested" and row.state == "assessed":
            self._serve_windows_beside(self._clocks.now())

    def _hindered(self, now: float) -> Reason | None:
        """Why a program is not asked for its arm now."""
        settings = self._monitor.configuration.schedule
        if settings.after_warm_up and not self._warmth.steady(now, settings.warm_k_per_10_min):
            return NOT_STEADY()
        return too_little_room(self._store, self._monitor.configuration.store.least_free_mb) or self._lending.hindered(now)

    def _look(self, now: float, monotonic: float) -> None:
        """What has happened beside the schedule: evidence, a clock that was set, a request."""
        self._take_evidence()
        self._compare_clocks(now, monotonic)
        if now >= NEVER_SET_UNIX_S and self._requests.take_request():
            self._requested()

    def _check_in_time(self, now: float, monotonic: float) -> None:
        if now < self._next_check and now - self._watched < CHECK_EVERY_S:
            return
        self._check(now)
        after = self._clocks.now()
        upcoming = self._tell_next(after)
        self._next_check = min(after + CHECK_EVERY_S if upcoming is None else upcoming, after + CHECK_EVERY_S)
        if monotonic - self._noted >= 10 * CHECK_EVERY_S or not self._noted:
            self._noted = monotonic
            self._store.notes.set(_WATCHED, repr(now))
            if self._cold.last_running_unix_s is not None:
                self._store.notes.set(_RUNNING, repr(self._cold.last_running_unix_s))

    def _take_evidence(self) -> None:
        evidence_unix_s = self._requests.take_evidence()
        if evidence_unix_s is not None:
            self._evidence_unix_s = evidence_unix_s
            self._next_check = 0.0

    def _requested(self) -> None:
        now = self._clocks.now()
        if self._lending.lent:
            self._lending.open(Window(now, now, now, "asked for"), "requested")
            return
        short = too_little_room(self._store, self._monitor.configuration.store.least_free_mb)
        if short is None:
            self._tell_next(now)  # told while it lasts, too
            row = self._monitor.perform(now, "requested", now + self._monitor.configuration.schedule.grace_s)
            if row is not None and row.state == "assessed":
                self._serve_windows_beside(now)
        else:
            self._monitor.skip(now, short, "requested")

    def _serve_windows_beside(self, asked_unix_s: float) -> None:
        """What is open when a replay is asked for, and the next window if it opens soon, need no replay of their own."""
        settings, began = self._monitor.configuration.schedule, self._store.ledger.began_unix_s()
        reach_s = settings.grace_s + settings.jitter_s
        near = sorted(
            windows(settings, asked_unix_s - reach_s, asked_unix_s + reach_s, began, self._salt), key=lambda each: each.opens_unix_s
        )
        is_open = [each for each in near if each.opens_unix_s <= asked_unix_s < each.closes_unix_s]
        ahead = [each for each in near if asked_unix_s < each.opens_unix_s <= asked_unix_s + settings.grace_s]
        for window in (*is_open, *ahead[:1]):  # of a dense schedule, those after it have replays of their own
            if window.opens_unix_s >= self._not_before:
                self._monitor.skip(window.key_unix_s, SERVED_BY_REQUEST(at=rfc3339(asked_unix_s)))

    def _tell_next(self, now: float, but: Window | None = None) -> float | None:
        """Tell when the next window opens that is not `but`; returns it."""
        opens = next((window.opens_unix_s for window in self.coming(2, now) if but is None or window.key_unix_s != but.key_unix_s), None)
        self._monitor.next_due(opens)
        return opens

    def coming(self, count: int, now: float | None = None) -> list[Window]:
        """The next `count` windows that the ledger does not have yet. Raises StoreError."""
        now = self._clocks.now() if now is None else now
        settings, began = self._monitor.configuration.schedule, self._store.ledger.began_unix_s()
        if now < NEVER_SET_UNIX_S:
            return []
        known = self._store.ledger.windows(now - settings.jitter_s, now + 400 * DAY_S)
        trusted_unix_s = now + max(0.0, self._wait_until - self._clocks.monotonic())
        needed = self._monitor.needed()
        since = max(trusted_unix_s, self._not_before, needed.from_unix_s - settings.grace_s)
        more = needed_windows(upcoming(settings, since, count + min(len(known), 50), began, self._salt), needed)
        return [window for window in more if window.key_unix_s not in known][:count]

    def _seek(self, now: float) -> Sought | None:
        """The temperature that is missing and there now; the same until its window has closed."""
        settings, temperature_c = self._monitor.configuration.schedule, self._temperature_c
        row = self._monitor.missing_row(temperature_c) if settings.seek_temperatures and temperature_c is not None else None
        if row is None:
            return None
        before = self._sought
        return before if before is not None and before.row == row and now - before.at_unix_s < settings.grace_s else Sought(now, row)

    def _check(self, now: float) -> None:
        configuration = self._monitor.configuration
        self._sought = self._seek(now)
        since = min(self._watched, now)
        entered = self._store.ledger.windows(since - reach_back_s(configuration.schedule), now + DAY_S)
        found = check_windows(
            configuration.schedule,
            now_unix_s=now,
            since_unix_s=since,
            entered=entered,
            began_unix_s=self._store.ledger.began_unix_s(),
            salt=self._salt,
            triggers=Triggers(self._cold.at_unix_s, self._evidence_unix_s, self._sought),
        )
        needed = self._monitor.needed()
        for window in found.missed:
            if window.opens_unix_s >= self._not_before and not self._lending.joined(window):
                self._monitor.skip(window.key_unix_s, not_needed(window.closes_unix_s, needed) or self._why_missed(window))
        self._watched = now
        if found.due is None or found.due.opens_unix_s < self._not_before:
            return
        wanted = self._sought is not None or found.due.why in PULLED_FORWARD
        unneeded = None if wanted else not_needed(found.due.closes_unix_s, needed)
        if unneeded is not None:
            for window in (*found.merged, found.due):
                self._monitor.skip(window.key_unix_s, unneeded)
            return
        if self._lending.lent:
            for window in (*found.merged, found.due):
                if not self._lending.joined(window):
                    self._lending.open(window)
            return
        if configuration.schedule.after_warm_up and not self._warmth.steady(now, configuration.schedule.warm_k_per_10_min):
            return  # the window stays open; it is missed where it closes before temperatures are steady
        for window in found.merged:
            self._monitor.skip(window.key_unix_s, SERVED(window=rfc3339(found.due.key_unix_s)))
        short = too_little_room(self._store, configuration.store.least_free_mb)
        if short is not None:
            self._monitor.skip(found.due.key_unix_s, short)
            return
        self.lag_s = now - found.due.opens_unix_s
        log.debug("window=%s opens a replay: %s", rfc3339(found.due.key_unix_s), found.due.why)
        self._tell_next(now, but=found.due)  # while it lasts, the next one is that after it
        self._monitor.perform(found.due.key_unix_s, closes_unix_s=found.due.closes_unix_s)

    def _why_missed(self, window: Window) -> Reason:
        if self._monitor.configuration.schedule.after_warm_up and self._last_seen_before(window):
            return MISSED_NOT_STEADY()
        return MISSED()

    def _last_seen_before(self, window: Window) -> bool:
        return self._watched >= window.opens_unix_s

    def _compare_clocks(self, now: float, monotonic: float) -> None:
        if self._last is not None:
            jump = (now - self._last[0]) - (monotonic - self._last[1])
            if abs(jump) > NOTICED_JUMP_S:
                self._next_check = 0.0
                log.warning("the host's clock was set by %+.0f s, to %s", jump, rfc3339(now))
                # a clock that stood before the history's newest entry, or before this program existed, was corrected
                if jump > SUSPICIOUS_JUMP_S and self._last[0] >= max(
                    NEVER_SET_UNIX_S, (self._store.ledger.newest_unix_s() or 0.0) - SUSPICIOUS_JUMP_S
                ):
                    self._store.notes.set(_FORWARD, json.dumps([self._last[0], now]))
                    self._wait_until = monotonic + JUMP_WAIT_S
                    self._problems.report("clock", CLOCK_SET_FORWARD(days=jump / DAY_S))
                elif jump < 0:
                    self._wait_until = 0.0
        noted = self._store.notes.get(_FORWARD) if self._last is None or now < self._last[0] else None
        self._last = (now, monotonic)
        if not noted:
            return
        # The clock is back where it was before the jump, plus the time since: what was dated in between is wrong. A clock set back without
        # an earlier jump forward, or to where every boot begins, is a wrong clock itself, and nothing is taken back.
        before, after = json.loads(noted)
        watched = max(self._watched, float(self._store.notes.get(_WATCHED) or 0.0))
        newest, lasted = max(watched, self._store.ledger.newest_unix_s() or 0.0), max(0.0, watched - after)
        if before + lasted - SUSPICIOUS_JUMP_S <= now < newest - SUSPICIOUS_JUMP_S:
            self._store.notes.set(_FORWARD, "")
            if self._monitor.roll_back():
                log.warning("the clock is back from the future: what was learnt there is taken back")
            else:
                self._problems.report("rewind", CANNOT_TAKE_BACK())


def too_little_room(store: Store, least_free_mb: float) -> Reason | None:
    """Why the disk has no room for a recording; None where it has."""
    try:
        about = os.statvfs(store.directory)
    except OSError as error:
        return DISK_FAILS(folder=str(store.directory), error=error.strerror)
    free_mb = about.f_bavail * about.f_frsize / 1e6
    if about.f_flag & os.ST_RDONLY:
        return DISK_READ_ONLY(folder=str(store.directory))
    if free_mb < least_free_mb:
        return DISK_FULL(free_mb=free_mb, folder=str(store.directory), least_mb=least_free_mb)
    return None
