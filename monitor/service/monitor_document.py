"""The document `monitor`: how the monitor itself is, for the bus, for metrics and for `joint-monitor status`."""

import os
import resource
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from monitor import __version__
from monitor.errors import StoreError
from monitor.publish.documents import (
    ArchiveState,
    ArmLink,
    Borrowed,
    DueReplay,
    HistoryState,
    LastReplay,
    Monitor,
    Process,
    Reload,
    Waiting,
    encoded,
    worded,
)
from monitor.publish.timestamps import utc, utc_if, written
from monitor.reason import Reason, Sentence
from monitor.recording import DAY_S
from monitor.service.problems import Problems
from monitor.store.backup import HISTORY, backups, made_at_unix_s
from monitor.store.history.ledger import Borrow, LedgerRow
from monitor.store.provenance import provenance
from monitor.store.store import Store

FILE = "monitor.json"
SILENT_S = 60.0  # the document is written every ten seconds; an older one is from a monitor that no longer runs


class OfOthers(NamedTuple):
    """The fields that other parts of the daemon know."""

    reload: Reload | None
    next_replay_due: datetime | None
    next_replay_why: str | None
    due: DueReplay | None
    lag_s: float | None
    arm: ArmLink
    bus: Waiting
    workers: dict[str, float]
    overrides: list[str]


class MonitorDocument:
    """Collects the document from the history, the process and the problems."""

    def __init__(self, store: Store, problems: Problems, now: Callable[[], float], *, trial: bool = False) -> None:
        """`trial`: the clock is not the host's, and the file says so."""
        self._store, self._problems, self._now, self._trial = store, problems, now, trial
        self._began_unix_s = now()
        self._began = time.monotonic()

    def collect(self, of_others: OfOthers) -> Monitor:
        """The document; `of_others`: what other parts know."""
        store = self._store
        last: LedgerRow | None = None
        borrow: Borrow | None = None
        try:
            last = next(iter(store.ledger.rows(limit=1)), None)
            borrow = None if last is None else store.borrows.of([last]).get(last.id)
        except StoreError as error:  # the other fields are all the more useful
            self._problems.report("store", error.reason)
        return Monitor(
            version=__version__,
            programs=provenance(),
            started_at=utc(self._began_unix_s),
            uptime_s=round(time.monotonic() - self._began, 1),
            said_at=utc(self._now()),
            troubles=self._problems.listed(),
            last_replay=None if last is None else _last_replay(last, borrow),
            store=_store(store.directory).model_copy(update={**self._cursors(), "archive": self._archive()}),
            process=_process(),
            trial=self._trial,
            **of_others._asdict(),
        )

    def _cursors(self) -> dict[str, str | int | None]:
        """How far the history is."""
        try:
            kept = self._store.events.range()
            return {
                "history_id": self._store.changes.history_id(),
                "last_event": kept[1] if kept else 0,
                "last_change": self._store.changes.last(),
            }
        except StoreError:
            return {}  # reported above

    def _archive(self) -> ArchiveState | None:
        archived = self._store.archived
        if archived.settings is None:
            return None
        try:
            waiting, since = archived.waits()
            return ArchiveState(
                address=archived.settings.address, recordings=archived.count(), waiting=waiting, waiting_since=utc_if(since)
            )
        except StoreError:
            return None

    def write_end(self) -> None:
        """Write that the monitor was stopped: whoever asks `joint-monitor status` next sees it at once."""
        document = read_monitor_document(self._store.directory)
        if document is not None:
            self.write(document.model_copy(update={"stopped_at": utc(self._now())}))

    def write(self, document: Monitor) -> None:
        """Write the file for `joint-monitor status`, whole or not at all; where the disk refuses, the old one stays."""
        path = self._store.directory / FILE
        temporary = path.with_suffix(".tmp")
        with suppress(OSError):  # housekeeping reports a full or read-only disk
            temporary.write_bytes(encoded(document))
            os.replace(temporary, path)


def read_monitor_document(directory: Path) -> Monitor | None:
    """The document that the daemon of a state directory wrote last; None where there is none."""
    try:
        return Monitor.model_validate_json((directory / FILE).read_bytes())
    except (OSError, ValueError):  # a file that somebody has edited is none
        return None


def present_unix_s(document: Monitor | None, now_unix_s: float) -> float:
    """The time by the monitor's own clock: the host's, unless the monitor is a trial, whose clock runs fast."""
    return document.said_at.timestamp() if document is not None and document.trial else now_unix_s


def silent_s(document: Monitor, now_unix_s: float) -> float | None:
    """For how long a monitor has written no document [s]; None where it runs."""
    age_s = now_unix_s - document.said_at.timestamp()
    return age_s if abs(age_s) > SILENT_S else None


NEVER_RUN = Sentence("monitor_never_ran", "no monitor has run with this history, or its {file} cannot be read")
STOPPED_AT = Sentence("monitor_stopped", "the monitor was stopped at {at}")
KILLED = Sentence("monitor_killed", "the monitor was killed, or its host restarted, after {at}")
IN_FUTURE = Sentence(
    "monitor_in_future",
    "the monitor wrote last at {at}, in the future: the clock was set back, or the monitor does not run",
)
SILENT = Sentence("monitor_silent", "the monitor does not run, or cannot write: it wrote last at {at}, {span} ago")


def not_watched(document: Monitor | None, now_unix_s: float) -> Reason | None:
    """Why nobody watches the arm now, from the document that was written last; None where the monitor runs."""
    if document is None:
        return NEVER_RUN(file=FILE)
    at = written(document.said_at)
    if document.stopped_at is not None:
        return STOPPED_AT(at=written(document.stopped_at))
    silent = silent_s(document, now_unix_s)
    if silent is None:
        return KILLED(at=at) if _has_ended(document.process) else None
    return IN_FUTURE(at=at) if silent < 0.0 else SILENT(at=at, span=_span(silent))


def _has_ended(process: Process) -> bool:
    """Whether the monitor's process is known to have ended: a process of another container or host cannot be seen from here."""
    if process.pid <= 0 or process.pid_namespace is None or process.pid_namespace != _pid_namespace():
        return False
    try:
        os.kill(process.pid, 0)
    except ProcessLookupError:
        return True
    except OSError:  # it is another user's
        return False
    return False


def _pid_namespace() -> str | None:
    """What tells processes apart that may have the same number; None where the system has no /proc."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return None


def _span(seconds: float) -> str:
    days, hours = seconds / DAY_S, seconds / 3600.0
    return f"{days:.0f} days" if days >= 2.0 else f"{hours:.0f} hours" if hours >= 2.0 else f"{seconds / 60.0:.0f} min"


def status_line(health: str | None, document: Monitor) -> str:
    """The line that `systemctl status` shows."""
    last, due, waits = document.last_replay, document.next_replay_due, document.due
    parts = [
        health or "no replay assessed yet",
        f"last replay {last.replay} {last.state}" if last else "no replay yet",
        *([f"due since {written(waits.since)}, {waits.text}"] if waits else []),
        f"next {written(due)}" if due else "none scheduled",
        "arm heard" if document.arm.heard else "arm not heard",
    ]
    if (reload := document.reload) and not reload.done:
        parts.insert(0, f"RELOAD REFUSED at {written(reload.at)}, the old configuration is in force: {reload.text}")
    parts += [f"{trouble.name}: {trouble.text}" for trouble in document.troubles if trouble.name != "arm"]
    return "; ".join(parts).replace("\n", " ")[:500]


def borrowed_document(borrow: Borrow) -> Borrowed:
    """From whom a replay had its arm."""
    return Borrowed(
        program=borrow.program,
        due_since=utc(borrow.due_since_unix_s),
        taken_at=utc(borrow.taken_at_unix_s),
        waited_s=borrow.waited_s,
        given_back=borrow.given_back,
    )


def _last_replay(row: LedgerRow, borrow: Borrow | None) -> LastReplay:
    return LastReplay(
        replay=row.id,
        window=utc(row.window_unix_s),
        state=row.state,
        ended_at=utc_if(row.ended_at_unix_s),
        borrowed=None if borrow is None else borrowed_document(borrow),
        **worded(reason=row.reason),
    )


def _store(directory: Path) -> HistoryState:
    newest = next(iter(backups(directory)), None)
    free = None
    with suppress(OSError):
        about = os.statvfs(directory)
        free = about.f_bavail * about.f_frsize
    history = directory / HISTORY
    files = [each for each in (history, history.with_name(f"{history.name}-wal")) if each.is_file()]
    return HistoryState(
        history_bytes=sum(each.stat().st_size for each in files),
        last_backup_at=None if newest is None else utc(made_at_unix_s(newest)),
        free_bytes=free,
        sqlite=sqlite3.sqlite_version,
    )


def _process() -> Process:
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    resident = None
    with suppress(OSError):  # /proc is Linux's, proc_pid_statm(5)
        resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return Process(
        resident_bytes=resident,
        cpu_s=round(sum(each.ru_utime + each.ru_stime for each in usage), 1),
        threads=threading.active_count(),
        pid=os.getpid(),
        pid_namespace=_pid_namespace(),
    )
