"""What the page shows besides the bus's last values: the past, thinned for a screen, the ledger, and the monitor's own condition."""

import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from monitor import __version__
from monitor.acquire.schedule.settings import ScheduleSettings
from monitor.acquire.schedule.windows import expected
from monitor.publish.timestamps import rfc3339
from monitor.store.store import Store

MOST_REPLAYS = 400  # of a joint's line: more would be less than three pixels apart
NEWEST = 60  # never thinned
EVENTS = 60
WINDOWS = 40
COMING = 5
DIGITS = 5  # of a figure that becomes a pixel
SERIES = (
    "wear", "wear_std", "viscous_nm_s_per_rad", "temperature_c", "reference_torque_nm", "replay_torque_nm", "replay_torque_std_nm",
)  # fmt: skip


class Ask(Protocol):
    """What the page asks of the bus."""

    dropped: int

    def last_payloads(self) -> dict[str, bytes]:
        """Last values as they were sent, by key."""

    def ask(self, key: str, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """What a query on a key would be answered."""


@dataclass(slots=True)
class Content:
    """Everything behind the page's addresses. Called from several threads."""

    past: Store
    bus: Ask
    about: dict[str, Any]  # who, and the arm's geometry
    schedule_settings: ScheduleSettings = field(default_factory=ScheduleSettings)
    now: Callable[[], float] = time.time
    _began: float = field(default_factory=time.monotonic)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _made_of: tuple[int, int] = (-1, -1)
    _history: dict[str, Any] = field(default_factory=dict)

    def history(self) -> dict[str, Any]:
        """Every joint's past as columns; old replays thinned, the newest all there. Made anew only after a replay."""
        ids = self.past.assessments.replays()
        made_of = (len(ids), ids[-1] if ids else 0)
        with self._lock:
            if made_of != self._made_of:
                shown = thinned(ids, MOST_REPLAYS, NEWEST)
                self._history = columns(self.past.assessments.friction_of(shown)) | {"replays": len(ids), "shown": len(shown)}
                self._made_of = made_of
            return self._history

    def schedule(self) -> dict[str, Any]:
        """What is to come, and what was attempted, the newest first."""
        rows = [
            {"replay": row.id, "window": rfc3339(row.window_unix_s), "kind": row.kind, "state": row.state, "reason": row.reason}
            for row in reversed(self.past.ledger.rows(limit=WINDOWS))
        ]
        events = [
            {
                "seq": event.seq,
                "at": rfc3339(event.at_unix_s),
                **{key: event.document.get(key) for key in ("kind", "joint", "condition", "tier")},
            }
            for event in reversed(self.past.events.rows(limit=EVENTS))
        ]
        return {"coming": self._coming(), "timezone": self.schedule_settings.timezone, "windows": rows, "events": events}

    def _coming(self) -> list[dict[str, Any]]:
        """The next windows, why each is there; one that waits for the arm says so by its `why`."""
        found = expected(self.schedule_settings, self.now(), COMING, self.past.ledger, str(self.about.get("key_prefix", "")))
        return [{"opens": rfc3339(w.opens_unix_s), "closes": rfc3339(w.closes_unix_s), "why": w.why} for w in found]

    def monitor(self) -> dict[str, Any]:
        """The monitor's own condition."""
        disk = shutil.disk_usage(self.past.directory)
        history = self.past.directory / "history.sqlite"
        counts: dict[str, int] = {}
        for row in self.past.ledger.rows(limit=200):
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
            "stops": [stop.text for stop in self.past.stops.waiting()],
        }


def thinned(ids: Sequence[int], most: int, newest: int) -> list[int]:
    """At most about `most` of them in order: evenly spaced, the first always, and the `newest` all."""
    old, new = ids[:-newest], ids[-newest:]
    every = max(1, math.ceil(len(old) / max(1, most - newest)))
    return [*old[::every], *new]


def columns(rows: Sequence[tuple[int, int, float, dict[str, Any]]]) -> dict[str, Any]:
    """Rows of (replay, joint, when, document) → times, and for every joint a column of each figure."""
    at: dict[int, int] = {}
    times: list[float] = []
    for replay, _, when, _ in rows:
        if replay not in at:
            at[replay] = len(times)
            times.append(round(when))
    joints: dict[int, dict[str, list[float | None]]] = {}
    for replay, joint, _, document in rows:
        own = joints.setdefault(joint, {name: [None] * len(times) for name in SERIES})
        for name in SERIES:
            value = document.get(name)
            own[name][at[replay]] = None if value is None else float(f"{value:.{DIGITS}g}")
    return {"t": times, "joints": {str(joint): joints[joint] for joint in sorted(joints)}}


def _resident_mb() -> float | None:
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)
