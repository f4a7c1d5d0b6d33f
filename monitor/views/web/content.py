"""What the page shows beside the bus's last values: the history thinned for a screen, windows and events, and the monitor's own state."""

import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from monitor import __version__
from monitor.acquire.schedule.needed import WHEN_NEEDED
from monitor.acquire.schedule.windows import ScheduleSettings, expected
from monitor.errors import BadInput
from monitor.publish.timestamps import rfc3339, unix_s
from monitor.reason import with_reasons
from monitor.store.store import Store
from monitor.views.history import Mark, mark_text, marks, runs
from monitor.views.web.page_content import EVENTS, MAX_REPLAYS, NEWEST_REPLAYS, BusAccess, columns, thinned

log = logging.getLogger(__name__)

MOST_LETTERS = 2000  # of a name or a reason
PAST_WINDOWS = 400  # newest windows, of which the page lists those that ended alike as one
COMING_WINDOWS = 5
COUNTED_WINDOWS = 200  # newest windows of which the page counts how they ended


@dataclass(slots=True)
class Content:
    """The documents behind the page's addresses. Its methods may be called from any thread."""

    store: Store
    bus: BusAccess
    about: dict[str, Any]  # the robot's names, alert conditions and geometry
    schedule_settings: ScheduleSettings = field(default_factory=ScheduleSettings)
    now: Callable[[], float] = time.time
    language: str = "browser"  # setting [page] language
    report: Callable[[str], str] | None = None  # the report as HTML, in the language of a code
    table: Callable[[str], str] | None = None  # the history as CSV
    file_name: str = "friction"  # of the table, without its ending
    _began: float = field(default_factory=time.monotonic)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _history_of: tuple[int, int, int] = (-1, -1, -1)  # number and newest one of the replays, and number of the works, in `_history`
    _history: dict[str, Any] = field(default_factory=dict)

    def history(self) -> dict[str, Any]:
        """The history of every joint as columns: old replays thinned, the newest complete. It is read again only after a replay or work."""
        ids = self.store.assessments.replays()
        maintenance = self.store.maintenance.rows()
        history_of = (len(ids), ids[-1] if ids else 0, len(maintenance) + sum(not row.in_force for row in maintenance))
        with self._lock:
            if history_of != self._history_of:
                shown = thinned(ids, MAX_REPLAYS, NEWEST_REPLAYS)
                self._history = columns(self.store.assessments.friction_of(shown)) | {
                    "replays": len(ids),
                    "shown": len(shown),
                    "marks": self._marks(),
                }
                self._history_of = history_of
            return self._history

    def began_unix_s(self, joint: int | None = None) -> float | None:
        """Since when friction is compared: the first replay, or the newest work that began it anew; None without a replay."""
        past = self.history()
        renewed = [mark["t"] for mark in past["marks"] if mark["renews"] and mark["joint"] == joint and joint is not None]
        return max(renewed, default=float(past["t"][0]) if past["t"] else None)

    def newest_unix_s(self) -> float | None:
        """When the last replay was recorded; None without one."""
        times = self.history()["t"]
        return float(times[-1]) if times else None

    def act(self, command: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
        """What a person asks for. Motion is allowed here, everything else over the bus. Raises BadInput where it is refused."""
        if command != "allow":
            return self.bus.ask(f"cmd/{command}", document)
        by, why = (str(document.get(name) or "").strip() for name in ("by", "why"))
        for name, text in (("by", by), ("why", why)):
            if not text or len(text) > MOST_LETTERS:
                raise BadInput(f"{name}: expected 1 to {MOST_LETTERS} letters: it is kept in the history, and somebody will ask")
        allowed = self.store.stops.allow(by, why, self.now())
        if not allowed:
            raise BadInput("allow: no stop is waiting for a person")
        log.info("motion allowed by=%r why=%r: %s", by, why, "; ".join(stop.text for stop in allowed))
        return {"done": "allowed", "stops": [stop.said.document() for stop in allowed]}

    def _marks(self) -> list[dict[str, Any]]:
        """What happened to the arm, for the charts."""
        state = self.store.assessments.state()
        maintenance = [row.document for row in self.store.maintenance.rows() if row.in_force]
        found: list[Mark] = marks(maintenance, (state.belief if state else {}).get("contexts", ()))
        return [mark._asdict() for mark in found]

    def schedule(self) -> dict[str, Any]:
        """The next windows; the last windows and transitions of alerts, newest first."""
        past = self.store.ledger.rows(limit=PAST_WINDOWS)
        tries, borrows = self.store.ledger.tries(past), self.store.borrows.of(past)
        rows = [
            with_reasons(
                {
                    "replay": run[-1].id,
                    "window": rfc3339(run[-1].window_unix_s),
                    "from": rfc3339(run[0].window_unix_s),
                    "count": len(run),
                    "kind": run[-1].kind,
                    "state": run[-1].state,
                    "tries": [with_reasons({"at": rfc3339(one.ended_at_unix_s)}, reason=one.reason) for one in tries[run[-1].id]],
                    "borrowed": None if (lent := borrows.get(run[-1].id)) is None else {"program": lent.program, "waited_s": lent.waited_s},
                },
                reason=run[-1].reason,
            )
            for run in reversed(runs(past))
        ]
        events = [
            {
                "seq": event.seq,
                "at": rfc3339(event.at_unix_s),
                **{key: event.document.get(key) for key in ("kind", "joint", "condition", "tier")},
                "text": mark_text(event.document),
            }
            for event in reversed(self.store.events.rows(limit=EVENTS))
        ]
        return {"coming": self._coming(), "timezone": self.schedule_settings.timezone, "windows": rows, "events": events}

    def _coming(self) -> list[dict[str, Any]]:
        """The next windows with the reason of each; that of a window that waits for the arm says so."""
        since = self.now()
        payload = self.bus.last_payloads().get("from_production") if self.schedule_settings.replay == WHEN_NEEDED else None
        needed_from = None if payload is None else json.loads(payload)["next_replay"]["needed_from"]
        if needed_from is not None:
            since = max(since, unix_s(needed_from) - self.schedule_settings.grace_s)
        found = expected(self.schedule_settings, since, COMING_WINDOWS, self.store.ledger, str(self.about.get("key_prefix", "")))
        return [{"opens": rfc3339(w.opens_unix_s), "closes": rfc3339(w.closes_unix_s), "why": w.why} for w in found]

    def monitor(self) -> dict[str, Any]:
        """The monitor's own state: version, memory, disk, how windows ended, stops that wait for a person."""
        disk = shutil.disk_usage(self.store.directory)
        history = self.store.directory / "history.sqlite"
        counts: dict[str, int] = {}
        for row in self.store.ledger.rows(limit=COUNTED_WINDOWS):
            counts[row.state] = counts.get(row.state, 0) + 1
        return {
            "version": __version__,
            "now": rfc3339(self.now()),
            "up_s": round(time.monotonic() - self._began),
            "resident_mb": _resident_mb(),
            "disk_free_gb": round(disk.free / 1e9, 1),
            "disk_free_share": round(disk.free / disk.total, 3),
            "history_mb": round(history.stat().st_size / 1e6, 2) if history.is_file() else None,
            "documents_dropped": self.bus.dropped,
            "last_windows": counts,
            "stops": [stop.said.document() for stop in self.store.stops.waiting()],
        }


def _resident_mb() -> float | None:
    """Memory of this process [MB]; None where the system has no /proc."""
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)
