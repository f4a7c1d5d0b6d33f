"""What is wrong with the monitor itself: told once when it begins and once when it is over, and listed in between."""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)


class Problems:
    """By name: disk, clock, store, arm, …"""

    def __init__(self, now: Callable[[], float], monotonic: Callable[[], float] = time.monotonic) -> None:
        self._now, self._monotonic = now, monotonic
        self._lock = threading.Lock()
        self._present: dict[str, tuple[float, str]] = {}
        self._found: dict[str, float] = {}  # when, by a clock that nobody sets

    def found(self, name: str, text: str) -> None:
        """It is so now; told when it is new."""
        with self._lock:
            since = self._present.get(name, (self._now(), ""))[0]
            new = name not in self._present
            self._found.setdefault(name, self._monotonic())
            self._present[name] = (since, text)
        if new:
            log.warning("trouble=%s: %s", name, text, extra={"trouble": name})

    def over(self, name: str) -> None:
        """It is not so, or not any more; told when it was."""
        with self._lock:
            was, found = self._present.pop(name, None), self._found.pop(name, 0.0)
        if was is not None:
            log.info("trouble=%s is over, after %.0f s", name, self._monotonic() - found, extra={"trouble": name})

    def said(self, name: str, text: str | None) -> None:
        """Found where there is a text, over where there is none."""
        if text is None:
            self.over(name)
        else:
            self.found(name, text)

    def __contains__(self, name: str) -> bool:
        with self._lock:
            return name in self._present

    def listed(self) -> list[dict[str, Any]]:
        """Those that are present, the oldest first."""
        with self._lock:
            present = sorted(self._present.items(), key=lambda entry: entry[1][0])
        return [{"name": name, "since_unix_s": since, "text": text} for name, (since, text) in present]
