"""The document `monitor`: how the monitor itself is, for the bus, for metrics and for `joint-monitor status`."""

import json
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
from monitor.errors import StoreError
from monitor.publish.documents import Monitor
from monitor.publish.timestamps import outside, rfc3339
from monitor.recording import DAY_S
from monitor.service.problems import Problems
from monitor.store.backup import HISTORY, backups, made_at_unix_s
from monitor.store.history.ledger import Borrow, LedgerRow
from monitor.store.provenance import provenance
from monitor.store.store import Store

FILE = "monitor.json"
SILENT_S = 60.0  # the document is written every ten seconds; an older one is from a monitor that no longer runs


class MonitorDocument:
    """Collects the document from the history, the process and the problems."""

    def __init__(self, store: Store, problems: Problems, now: Callable[[], float], *, trial: bool = False) -> None:
        """`trial`: the clock is not the host's, and the file says so."""
        self._store, self._problems, self._now, self._trial = store, problems, now, trial
        self._began_unix_s = now()
        self._began = time.monotonic()

    def collect(self, reload: dict[str, Any] | None, more: dict[str, Any]) -> dict[str, Any]:
        """The document before its times become text. `reload`: the outcome of the last one; `more`: what other parts know."""
        store = self._store
        last: LedgerRow | None = None
        borrow: Borrow | None = None
        try:
            last = next(iter(store.ledger.rows(limit=1)), None)
            borrow = None if last is None else store.borrows.of([last]).get(last.id)
        except StoreError as error:  # the other fields are all the more useful
            self._problems.report("store", str(error))
        return {
            "version": __version__,
            "programs": provenance(),
            "started_at_unix_s": self._began_unix_s,
            "uptime_s": round(time.monotonic() - self._began, 1),
            "said_at_unix_s": self._now(),
            "troubles": self._problems.listed(),
            "last_replay": None if last is None else _last_replay(last, borrow),
            "store": _store(store.directory) | self._cursors() | self._archive(),
            "process": _process(),
            "reload": reload,
            **more,
        }

    def _cursors(self) -> dict[str, Any]:
        """How far the history is: whoever copies it sees without a question whether there is something new."""
        try:
            kept = self._store.events.range()
            return {
                "history_id": self._store.changes.history_id(),
                "last_event": kept[1] if kept else 0,
                "last_change": self._store.changes.last(),
            }
        except StoreError:
            return {}  # reported above

    def _archive(self) -> dict[str, Any]:
        """How many recordings the archive has, and how many wait for it."""
        archived = self._store.archived
        if archived.settings is None:
            return {}
        try:
            waiting, since = archived.waits()
            about = {
                "address": archived.settings.address,
                "recordings": archived.count(),
                "waiting": waiting,
                "waiting_since_unix_s": since,
            }
        except StoreError:
            return {}
        return {"archive": about}

    def write_end(self) -> None:
        """Write that the monitor was stopped: whoever asks `joint-monitor status` next sees it at once."""
        document = read_monitor_document(self._store.directory)
        if document is not None:
            self.write({**document, "stopped_at_unix_s": self._now()})

    def write(self, document: dict[str, Any]) -> None:
        """Write the file for `joint-monitor status`, whole or not at all; where the disk refuses, the old one stays."""
        path = self._store.directory / FILE
        temporary = path.with_suffix(".tmp")
        with suppress(OSError):  # maintenance reports a full or read-only disk
            temporary.write_text(json.dumps(outside(document | ({"trial": True} if self._trial else {}))), "utf-8")
            os.replace(temporary, path)


def read_monitor_document(directory: Path) -> dict[str, Any] | None:
    """The document that the daemon of a state directory wrote last; None where there is none."""
    try:
        document: dict[str, Any] = json.loads((directory / FILE).read_text("utf-8"))
        Monitor.model_validate(document)  # a file that somebody has edited is none
    except (OSError, ValueError):
        return None
    return document


def present_unix_s(document: dict[str, Any] | None, now_unix_s: float) -> float:
    """The time by the monitor's own clock: the host's, unless the monitor is a trial, whose clock runs fast."""
    return datetime.fromisoformat(document["said_at"]).timestamp() if document is not None and document.get("trial") else now_unix_s


def silent_s(document: dict[str, Any], now_unix_s: float) -> float | None:
    """For how long a monitor has written no document [s]; None where it runs."""
    age_s = now_unix_s - datetime.fromisoformat(document["said_at"]).timestamp()
    return age_s if abs(age_s) > SILENT_S else None


def not_watched(document: dict[str, Any] | None, now_unix_s: float) -> str | None:
    """Why nobody watches the arm now, from the document that was written last; None where the monitor runs."""
    if document is None:
        return f"no monitor has run with this history, or its {FILE} cannot be read"
    if document.get("stopped_at"):
        return f"the monitor was stopped at {document['stopped_at']}"
    silent = silent_s(document, now_unix_s)
    if silent is None:
        ended = _has_ended(document["process"])
        return f"the monitor was killed, or its host restarted, after {document['said_at']}" if ended else None
    if silent < 0.0:
        return f"the monitor wrote last at {document['said_at']}, in the future: the clock was set back, or the monitor does not run"
    return f"the monitor does not run, or cannot write: it wrote last at {document['said_at']}, {_span(silent)} ago"


def _has_ended(process: dict[str, Any]) -> bool:
    """Whether the monitor's process is known to have ended: a process of another container or host cannot be seen from here."""
    pid = process.get("pid")
    if not isinstance(pid, int) or pid <= 0 or process.get("pid_namespace") is None or process["pid_namespace"] != _pid_namespace():
        return False
    try:
        os.kill(pid, 0)
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


def status_line(health: str | None, document: dict[str, Any]) -> str:
    """The line that `systemctl status` shows."""
    last, due = document["last_replay"], document["next_replay_due_unix_s"]
    parts = [
        health or "no replay assessed yet",
        f"last replay {last['replay']} {last['state']}" if last else "no replay yet",
        *([f"due since {rfc3339(waits['since_unix_s'])}, {waits['text']}"] if (waits := document.get("due")) else []),
        f"next {rfc3339(due)}" if due else "none scheduled",
        "arm heard" if document["arm"]["heard"] else "arm not heard",
    ]
    if (reload := document.get("reload")) and not reload["done"]:
        parts.insert(0, f"RELOAD REFUSED at {rfc3339(reload['at_unix_s'])}, the old configuration is in force: {reload['told']}")
    parts += [f"{problem['name']}: {problem['text']}" for problem in document["troubles"] if problem["name"] != "arm"]
    return "; ".join(parts).replace("\n", " ")[:500]


def borrowed_document(borrow: Borrow) -> dict[str, Any]:
    """From whom a replay had its arm, its times not yet text."""
    return {
        "program": borrow.program,
        "due_since_unix_s": borrow.due_since_unix_s,
        "taken_at_unix_s": borrow.taken_at_unix_s,
        "waited_s": borrow.waited_s,
        "given_back": borrow.given_back,
    }


def _last_replay(row: LedgerRow, borrow: Borrow | None) -> dict[str, Any]:
    return {
        "replay": row.id,
        "window_unix_s": row.window_unix_s,
        "state": row.state,
        "reason": row.reason_text,
        "ended_at_unix_s": row.ended_at_unix_s,
        "borrowed": None if borrow is None else borrowed_document(borrow),
    }


def _store(directory: Path) -> dict[str, Any]:
    newest = next(iter(backups(directory)), None)
    free = None
    with suppress(OSError):
        about = os.statvfs(directory)
        free = about.f_bavail * about.f_frsize
    history = directory / HISTORY
    files = [each for each in (history, history.with_name(f"{history.name}-wal")) if each.is_file()]
    return {
        "history_bytes": sum(each.stat().st_size for each in files),
        "last_backup_at_unix_s": None if newest is None else made_at_unix_s(newest),
        "free_bytes": free,
        "sqlite": sqlite3.sqlite_version,
    }


def _process() -> dict[str, Any]:
    """Memory, processor time with that of ended children, and threads of this process."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    resident = None
    with suppress(OSError):  # /proc is Linux's, proc_pid_statm(5)
        resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return {
        "resident_bytes": resident,
        "cpu_s": round(sum(each.ru_utime + each.ru_stime for each in usage), 1),
        "threads": threading.active_count(),
        "pid": os.getpid(),
        "pid_namespace": _pid_namespace(),
    }
