"""No silence: whoever waits for the demo sees every few seconds what it does. It imports nothing heavy, so that it speaks at once."""

import threading
import time
from collections.abc import Callable
from types import TracebackType

SILENCE_S = 2.0  # without a line; a busy machine may wake us seconds later


class Ticker:
    """A context manager: while it lasts, a line says what is done whenever nothing else was printed for SILENCE_S."""

    def __init__(self, write: Callable[[str], None], activity: str) -> None:
        """`write` prints one line, and flushes it."""
        self.activity: Callable[[], str] = lambda: activity  # what is done now
        self._write = write
        self._spoke = time.monotonic()
        self._quiet = self._done = False
        self._doing, self._since = "", self._spoke
        self._wake = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="ticker", daemon=True)

    def __enter__(self) -> "Ticker":
        self._write(self.activity())
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._wake:
            self._done = True
            self._wake.notify()
        self._thread.join()

    def spoke(self) -> None:
        """Somebody else has printed a line."""
        self._spoke = time.monotonic()

    def quiet(self, quiet: bool) -> None:
        """Whether a screen that is redrawn all the time says it instead."""
        self._quiet = quiet
        self.spoke()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait(0.25)
                if self._done:
                    return
            now, doing = time.monotonic(), self.activity().split(":")[0]
            if doing != self._doing:
                self._doing, self._since = doing, now
            if not self._quiet and now - self._spoke >= SILENCE_S:
                self._spoke = now
                self._write(f"  … {self.activity()}, {now - self._since:.0f} s")
