"""Requests for a replay beside the schedule: from a person, or from evidence in production work. Any thread may make one."""

import queue
import threading


class ReplayRequests:
    """Requests for a replay, passed safely between threads. The daemon adds them, the scheduler takes them."""

    def __init__(self) -> None:
        self._requested: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._evidence: queue.SimpleQueue[float] = queue.SimpleQueue()
        self._awake = threading.Event()

    def request(self, why: str = "asked for") -> None:
        """Request one replay as soon as possible, whatever the schedule says."""
        self._requested.put(why)
        self.wake()

    def evidence(self, unix_s: float) -> None:
        """Production work at this time indicates more friction: the next replay may be moved forward within what the site allows."""
        self._evidence.put(unix_s)

    def take_request(self) -> bool:
        """Whether a replay was requested since the last call; several requests become one replay."""
        found = not self._requested.empty()
        while not self._requested.empty():
            self._requested.get()
        return found

    def take_evidence(self) -> float | None:
        """The time of the newest evidence since the last call; None where there is none."""
        newest = None
        while not self._evidence.empty():
            newest = self._evidence.get()
        return newest

    def wake(self) -> None:
        """End the scheduler's present wait."""
        self._awake.set()

    def wait(self, timeout_s: float) -> None:
        """Wait until `wake`, at most so long."""
        self._awake.wait(timeout_s)
        self._awake.clear()
