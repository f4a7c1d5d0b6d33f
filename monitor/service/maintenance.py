"""The monitor looks after itself: backups, retention, disk, clock; and says how it is, on the bus, in a file and in metrics."""

import json
import logging
import os
import resource
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.config.load import StoreSettings
from monitor.errors import StoreError
from monitor.publish.timestamps import outside
from monitor.service.problems import Problems
from monitor.service.scheduler import too_little_room
from monitor.store.backup import HISTORY, backups, lost, made_at_unix_s
from monitor.store.provenance import provenance
from monitor.store.store import Store

log = logging.getLogger(__name__)

LOOK_EVERY_S = 10.0
DAY_S = 86_400.0
FRESH_S = 3600.0  # a service that is started again and again makes no backup each time
BEHIND_S = 3600.0  # the newest entry of the history lies so far in the future: the clock was set back
SAID = "monitor.json"
SILENT_S = 60.0  # it speaks every ten seconds


class Maintenance:
    """Call `look` often, or `run` in a thread."""

    def __init__(self, store: Store, settings: Callable[[], StoreSettings], problems: Problems, now: Callable[[], float]) -> None:
        self._store, self._settings, self._problems, self._now = store, settings, problems, now
        self._began_unix_s = now()
        self._began = time.monotonic()
        self._cared: float | None = None  # monotonic: when it was last backed up and tidied, or that was tried
        self.reload: dict[str, Any] | None = None
        self.damaged: str | None = None  # found while running: the service must be started again to restore it

    def run(self, stopping: threading.Event, beat: Callable[[], None]) -> None:
        """Until `stopping`."""
        while not stopping.is_set():
            beat()
            try:
                self.look()
            except StoreError as error:
                self._problems.found("store", str(error))
            except Exception:  # what looks after the others must outlive a fault of ours; the stack says which
                log.exception("upkeep met a fault")
            stopping.wait(LOOK_EVERY_S)

    def look(self) -> None:
        """Disk and clock now; backup and retention at the start and once a day."""
        short = too_little_room(self._store, self._settings().least_free_mb)
        self._problems.said("disk", None if short is None else short.removeprefix("disk: "))
        self._problems.said("clock_behind", self._behind())
        self._problems.said("stop", self._stopped())
        if self._cared is None or time.monotonic() - self._cared >= (FRESH_S if "backup" in self._problems else DAY_S):
            self._cared = time.monotonic()
            self.care()

    def care(self) -> None:
        """Check, back up, let go of what is too old or too much."""
        settings, now = self._settings(), self._now()
        try:
            wrong = lost(self._store.directory)
            if wrong is not None:
                self.damaged = wrong
                self._problems.found("store", f"the history is damaged: {wrong}; it is restored by the next start")
                return
            newest = next(iter(backups(self._store.directory)), None)
            # by the host's own clock, which also names them; one from the future was made by a wrong clock
            if newest is None or not -FRESH_S < time.time() - made_at_unix_s(newest) < FRESH_S:
                made = self._store.back_up(settings.backups)
                log.info("backup %s, %.1f MB", made.name, made.stat().st_size / 1e6)
            self._problems.over("backup")
        except StoreError as error:
            self._problems.found("backup", str(error))
        try:
            gone = self._store.retention.prune(days=settings.recordings_days, most_bytes=1e9 * settings.recordings_gb, at_unix_s=now)
            if gone:
                log.info("let go of %d recordings, %s to %s", len(gone), gone[0], gone[-1])
            self._problems.over("retention")
        except StoreError as error:
            self._problems.found("retention", str(error))

    def _behind(self) -> str | None:
        """Whether the history knows of later times than the clock."""
        newest = self._store.ledger.newest_unix_s()
        if newest is None or newest - self._now() < BEHIND_S:
            return None
        return (
            f"the newest entry of the history is {(newest - self._now()) / 3600.0:.1f} h in the future: the clock was set back; "
            "replays are recorded, and learnt from again once it has caught up"
        )

    def _stopped(self) -> str | None:
        """Whether a replay ended in a way that a person must look at before anything moves again."""
        for stop in self._store.stops.waiting():
            return f"{stop.told}; nothing moves until a person has looked at the arm and says so: joint-monitor allow"
        return None

    def document(self, more: dict[str, Any]) -> dict[str, Any]:
        """How the monitor is, with `more` from those who know it."""
        store = self._store
        try:
            last = store.ledger.rows(limit=1)
        except StoreError as error:  # the rest is worth telling all the more
            self._problems.found("store", str(error))
            last = []
        newest = next(iter(backups(store.directory)), None)
        usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        free = None
        with suppress(OSError):
            about = os.statvfs(store.directory)
            free = about.f_bavail * about.f_frsize
        return {
            "version": __version__,
            "programs": provenance(),
            "started_at_unix_s": self._began_unix_s,
            "uptime_s": round(time.monotonic() - self._began, 1),
            "said_at_unix_s": self._now(),
            "troubles": self._problems.listed(),
            "last_replay": None
            if not last
            else {
                "replay": last[0].id,
                "window_unix_s": last[0].window_unix_s,
                "state": last[0].state,
                "reason": last[0].reason,
                "ended_at_unix_s": last[0].ended_at_unix_s,
            },
            "store": {
                "history_bytes": _size(store.directory / HISTORY),
                "last_backup_at_unix_s": None if newest is None else made_at_unix_s(newest),
                "free_bytes": free,
                "sqlite": sqlite3.sqlite_version,
            },
            "process": {
                "resident_bytes": _resident(),
                "cpu_s": round(sum(each.ru_utime + each.ru_stime for each in usage), 1),
                "threads": threading.active_count(),
            },
            "reload": self.reload,
            **more,
        }

    def write(self, document: dict[str, Any]) -> None:
        """For `joint-monitor status`, which needs no bus: the file, whole or not at all; no disk is no reason to end."""
        path = self._store.directory / SAID
        temporary = path.with_suffix(".tmp")
        with suppress(OSError):  # a full or read-only disk is told as such
            temporary.write_text(json.dumps(outside(document)), "utf-8")
            os.replace(temporary, path)


def said(directory: Path) -> dict[str, Any] | None:
    """What the daemon of a state directory said last of itself; None where none ever ran."""
    try:
        document: dict[str, Any] = json.loads((directory / SAID).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return document


def silent_s(document: dict[str, Any], now_unix_s: float) -> float | None:
    """For how long a monitor has said nothing that should have; None where it runs."""
    age_s = now_unix_s - datetime.fromisoformat(document["said_at"]).timestamp()
    return age_s if abs(age_s) > SILENT_S else None


def _size(path: Path) -> int:
    return sum(each.stat().st_size for each in (path, path.with_name(f"{path.name}-wal")) if each.is_file())


def _resident() -> int | None:
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None
