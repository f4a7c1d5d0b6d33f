"""Problems of the monitor itself: logged once when one begins and once when it ends, and listed in between."""

import logging
import threading
import time
from collections.abc import Callable

from monitor.publish.documents import Trouble
from monitor.publish.timestamps import utc
from monitor.reason import Reason, reason_of

log = logging.getLogger(__name__)


class Problems:
    """The present problems by name: disk, clock, store, arm, … Any thread may call it."""

    def __init__(self, now: Callable[[], float], monotonic: Callable[[], float] = time.monotonic) -> None:
        self._now, self._monotonic = now, monotonic
        self._lock = threading.Lock()
        self._present: dict[str, tuple[float, Reason]] = {}
        self._found: dict[str, float] = {}  # when, by a clock that nobody sets

    def report(self, name: str, why: str | Reason) -> None:
        """The problem is present; logged when it is new."""
        with self._lock:
            since = self._present[name][0] if name in self._present else self._now()
            new = name not in self._present
            self._found.setdefault(name, self._monotonic())
            self._present[name] = (since, reason_of(why))
        if new:
            log.warning("trouble=%s: %s", name, why, extra={"trouble": name})

    def clear(self, name: str) -> None:
        """The problem is not present; logged when it was."""
        with self._lock:
            was, found = self._present.pop(name, None), self._found.pop(name, 0.0)
        if was is not None:
            log.info("trouble=%s is over, after %.0f s", name, self._monotonic() - found, extra={"trouble": name})

    def update(self, name: str, why: str | Reason | None) -> None:
        """Report the problem where there is a reason, clear it where there is none."""
        if why is None:
            self.clear(name)
        else:
            self.report(name, why)

    def __contains__(self, name: str) -> bool:
        with self._lock:
            return name in self._present

    def listed(self) -> list[Trouble]:
        """The present problems, the oldest first."""
        with self._lock:
            present = sorted(self._present.items(), key=lambda entry: entry[1][0])
        return [Trouble(name=name, since=utc(since), **reason.document()) for name, (since, reason) in present]
