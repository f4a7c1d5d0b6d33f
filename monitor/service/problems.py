"""Problems of the monitor itself: logged once when one begins and once when it ends, and listed in between."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)


class Problems:
    """The present problems by name: disk, clock, store, arm, … Any thread may call it."""

    def __init__(self, now: Callable[[], float], monotonic: Callable[[], float] = time.monotonic) -> None:
        self._now, self._monotonic = now, monotonic
        self._lock = threading.Lock()
        self._present: dict[str, tuple[float, str]] = {}
        self._found: dict[str, float] = {}  # when, by a clock that nobody sets

    def report(self, name: str, text: str) -> None:
        """The problem is present; logged when it is new."""
        with self._lock:
            since = self._present.get(name, (self._now(), ""))[0]
            new = name not in self._present
            self._found.setdefault(name, self._monotonic())
            self._present[name] = (since, text)
        if new:
            log.warning("trouble=%s: %s", name, text, extra={"trouble": name})

    def clear(self, name: str) -> None:
        """The problem is not present; logged when it was."""
        with self._lock:
            was, found = self._present.pop(name, None), self._found.pop(name, 0.0)
        if was is not None:
            log.info("trouble=%s is over, after %.0f s", name, self._monotonic() - found, extra={"trouble": name})

    def update(self, name: str, text: str | None) -> None:
        """Report the problem where there is a text, clear it where there is none."""
        if text is None:
            self.clear(name)
        else:
            self.report(name, text)

    def __contains__(self, name: str) -> bool:
        with self._lock:
            return name in self._present

    def listed(self) -> list[dict[str, Any]]:
        """The present problems as plain JSON, the oldest first."""
        with self._lock:
            present = sorted(self._present.items(), key=lambda entry: entry[1][0])
        return [{"name": name, "since_unix_s": since, "text": text} for name, (since, text) in present]
