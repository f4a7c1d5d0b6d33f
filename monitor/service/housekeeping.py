"""Housekeeping: backups, retention, and checks of disk, clock and stops. I/O."""

import logging
import threading
import time
from collections.abc import Callable, Collection
from typing import Any

from monitor.config.schema import StoreSettings
from monitor.errors import StoreError
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S
from monitor.service.left_arm import away
from monitor.service.problems import Problems
from monitor.service.scheduler import too_little_room
from monitor.store.backup import backups, lost, made_at_unix_s
from monitor.store.history.production import PINNED
from monitor.store.store import Store

log = logging.getLogger(__name__)


def going(store: Store, settings: StoreSettings, now_unix_s: float, among: Collection[int]) -> list[int]:
    """The windows whose recordings `prune` would remove, oldest first. Raises StoreError."""
    limits = _limits(store, settings)
    return [each.ledger_id for each in store.retention.going(at_unix_s=now_unix_s, among=among, **limits)]


def prune(store: Store, settings: StoreSettings, problems: Problems, now_unix_s: float, among: Collection[int] | None = None) -> None:
    """Remove recordings that are too old or too many; of `among` alone, where given: the windows whose recordings the archive has."""
    try:
        gone = store.retention.prune(at_unix_s=now_unix_s, among=among, **_limits(store, settings))
        if gone:
            log.info("let go of %d recordings, %s to %s", len(gone), gone[0], gone[-1])
        problems.clear("retention")
    except StoreError as error:
        problems.report("retention", error.reason)


def _limits(store: Store, settings: StoreSettings) -> dict[str, Any]:
    """What bounds the local recordings, by the names of `Retention`."""
    pinned = store.notes.get(PINNED)  # ordinary work is measured against this replay
    return {
        "days": settings.keep_local_days or settings.recordings_days,
        "most_bytes": 1e9 * settings.recordings_gb,
        "but": () if pinned is None else (int(pinned),),
    }


CHECK_EVERY_S = 10.0  # between two checks: short enough for a person who waits for a problem to end
FRESH_S = 3600.0  # a backup younger than this is not made again: a service that restarts often makes no backup each time
DAMAGED = Sentence("history_damaged", "the history is damaged: {why}; it is restored by the next start")
CLOCK_BEHIND = Sentence(
    "clock_behind",
    "the newest entry of the history is {hours:.1f} h in the future: the clock was set back; "
    "replays are recorded, and learnt from again once it has caught up",
)
WAITS_FOR_A_PERSON = Sentence(
    "waits_for_a_person", "{stop}; nothing moves until a person has looked at the arm and says so: joint-monitor allow"
)
BEHIND_S = 3600.0  # the newest entry of the history lies so far in the future: the clock was set back


class Housekeeping:
    """Call `check` often, or `run` in a thread of its own."""

    def __init__(
        self,
        store: Store,
        settings: Callable[[], StoreSettings],
        problems: Problems,
        now: Callable[[], float],
        observe_uploads: Callable[[], None] = lambda: None,
    ) -> None:
        self._store, self._settings, self._problems, self._now, self._observe_uploads = store, settings, problems, now, observe_uploads
        self._maintained: float | None = None  # monotonic: when backup and retention were last tried
        self.damaged: str | None = None  # damage found while running: the next start restores the history

    def run(self, stopping: threading.Event, beat: Callable[[], None]) -> None:
        """Check every ten seconds until `stopping`; `beat` is called before each check."""
        while not stopping.is_set():
            beat()
            try:
                self.check()
            except StoreError as error:
                self._problems.report("store", error.reason)
            except Exception:  # maintenance must go on after an error of this program; the log names it
                log.exception("upkeep met a fault")
            stopping.wait(CHECK_EVERY_S)

    def check(self) -> None:
        """Check disk, clock and stops now; back up and prune at the start and once a day. Raises StoreError."""
        short = too_little_room(self._store, self._settings().least_free_mb)
        self._problems.update("disk", short)
        self._problems.update("clock_behind", self._behind())
        self._problems.update("stop", self._stopped())
        self._problems.update("away", away(self._store))
        self._observe_uploads()
        if self._maintained is None or time.monotonic() - self._maintained >= (FRESH_S if "backup" in self._problems else DAY_S):
            self._maintained = time.monotonic()
            self.maintain()

    def maintain(self) -> None:
        """Check the history, back it up, and remove recordings that are too old or too many."""
        settings, now = self._settings(), self._now()
        try:
            wrong = lost(self._store.directory)
            if wrong is not None:
                self.damaged = wrong
                self._problems.report("store", DAMAGED(why=wrong))
                return
            newest = next(iter(backups(self._store.directory)), None)
            # by the host's own clock, which also names them; one from the future was made by a wrong clock
            if newest is None or not -FRESH_S < time.time() - made_at_unix_s(newest) < FRESH_S:
                made = self._store.back_up(settings.backups)
                log.info("backup %s, %.1f MB", made.name, made.stat().st_size / 1e6)
            self._problems.clear("backup")
        except StoreError as error:
            self._problems.report("backup", error.reason)
        if not settings.recordings:  # with an archive, the thread of the uploads does so, once it has seen what that has
            prune(self._store, settings, self._problems, now)

    def _behind(self) -> Reason | None:
        """The problem that the history holds later times than the clock; None where it does not."""
        newest = self._store.ledger.newest_unix_s()
        if newest is None or newest - self._now() < BEHIND_S:
            return None
        return CLOCK_BEHIND(hours=(newest - self._now()) / 3600.0)

    def _stopped(self) -> Reason | None:
        """The problem that a replay ended in a stop, after which a person must check the arm; None where nothing waits."""
        for motion in self._store.motions.give_up_left_over(self._now()):
            log.warning("%s; a person must look at the arm", motion.end_unknown)
        for stop in self._store.stops.waiting():
            return WAITS_FOR_A_PERSON(stop=stop.said)
        return None
