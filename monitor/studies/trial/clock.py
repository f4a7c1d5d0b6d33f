"""The clock of a trial: UTC that runs faster than the host's, waits at each window, and stands while the arm moves."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from monitor.service.scheduler import Clocks


class TrialClock:
    """Time that passes `speed` times as fast as the host's, but never beyond `stop_at` and never while somebody holds it."""

    def __init__(self, start_unix_s: float, speed: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._lock = threading.Lock()
        self._monotonic, self._speed = monotonic, speed
        self._begin_unix_s = self._unix_s = start_unix_s
        self._since = monotonic()
        self._held = 0
        self._stop_at_unix_s = start_unix_s  # nothing passes before somebody says until when

    def now(self) -> float:
        """UTC [s since 1970]."""
        with self._lock:
            self._pass()
            return self._unix_s

    def monotonic(self) -> float:
        """Seconds since the trial began; nobody sets them."""
        return self.now() - self._begin_unix_s

    def stop_at(self, unix_s: float) -> None:
        """Let time pass up to this moment, and wait there."""
        with self._lock:
            self._pass()
            self._stop_at_unix_s = unix_s

    def add(self, seconds: float) -> None:
        """Let so much pass at once, also while the clock is held: a motion that was computed has lasted so long."""
        with self._lock:
            self._pass()
            self._unix_s += seconds

    @contextmanager
    def held(self) -> Iterator[None]:
        """The clock stands while the context lasts."""
        with self._lock:
            self._pass()
            self._held += 1
        try:
            yield
        finally:
            with self._lock:
                self._pass()
                self._held -= 1

    @property
    def clocks(self) -> Clocks:
        """Both clocks as the scheduler takes them."""
        return Clocks(now=self.now, monotonic=self.monotonic)

    def _pass(self) -> None:
        now = self._monotonic()
        passed_s, self._since = (now - self._since) * self._speed, now
        if not self._held:
            self._unix_s = max(self._unix_s, min(self._unix_s + passed_s, self._stop_at_unix_s))
