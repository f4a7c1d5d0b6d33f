"""An event loop that wakes once in each control period.

A real controller too checks its sockets once in each period. Fewer wakes halve the load of the processor.
"""

import select
import selectors
from collections.abc import Callable

Ready = list[tuple[selectors.SelectorKey, int]]


class TickSelector(selectors.EpollSelector):
    """While a condition holds, events between two expirations of the timer wait for the next one, and come before the timer's own event."""

    def __init__(self) -> None:
        super().__init__()
        self._waits: Callable[[], bool] = lambda: False
        self._timer = -1
        self._tick = select.poll()

    def follow(self, timer: int, waits: Callable[[], bool]) -> None:
        """Follow a file descriptor that becomes readable in every control period; `waits` is the condition."""
        self._timer, self._waits = timer, waits
        self._tick.register(timer, select.POLLIN)

    def forget(self) -> None:
        """Follow the timer no longer: it is about to be closed."""
        self._tick.unregister(self._timer)
        self._timer = -1

    def select(self, timeout: float | None = None) -> Ready:
        """See `selectors.BaseSelector.select`."""
        if self._timer < 0 or (timeout is not None and timeout <= 0) or not self._waits():
            return self._tick_last(super().select(timeout))
        # rounded up: a timeout rounded to zero would poll without rest
        self._tick.poll(None if timeout is None else int(1000.0 * timeout) + 1)
        return self._tick_last(super().select(0))

    def _tick_last(self, found: Ready) -> Ready:
        if len(found) > 1:
            found.sort(key=lambda each: each[0].fd == self._timer)  # stable: a target that has arrived counts in this control period
        return found
