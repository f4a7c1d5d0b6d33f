"""An event loop that wakes once in each control period.

A real controller too checks its sockets once in each period. Fewer wakes halve the load of the processor. While nobody watches the arm it
wakes more rarely still: nine tenths of what a standing arm costs is to wake up.
"""

import select
import selectors
from collections.abc import Callable

Ready = list[tuple[selectors.SelectorKey, int]]
REST_S = 0.1  # while nobody watches, the loop wakes so often for the control periods that are due


class TickSelector(selectors.EpollSelector):
    """While `waits` holds, events between two expirations of the timer wait for the next one, and come before the timer's own event.

    While `rests` holds, the timer alone wakes nobody before REST_S; its event comes first then: whoever connects finds the present state.
    """

    def __init__(self) -> None:
        super().__init__()
        self._waits: Callable[[], bool] = lambda: False
        self._rests = self._waits
        self._timer = -1
        self._tick = select.poll()

    def follow(self, timer: int, waits: Callable[[], bool], rests: Callable[[], bool]) -> None:
        """Follow a file descriptor that becomes readable in every control period; `waits` and `rests` are the conditions."""
        self._timer, self._waits, self._rests = timer, waits, rests
        self._tick.register(timer, select.POLLIN)

    def forget(self) -> None:
        """Follow the timer no longer: it is about to be closed."""
        self._tick.unregister(self._timer)
        self._timer = -1

    def select(self, timeout: float | None = None) -> Ready:
        """See `selectors.BaseSelector.select`."""
        if self._timer < 0 or (timeout is not None and timeout <= 0):
            return self._tick_last(super().select(timeout))
        if not self._waits():
            return self._rested(timeout) if self._rests() else self._tick_last(super().select(timeout))
        # rounded up: a timeout rounded to zero would poll without rest
        self._tick.poll(None if timeout is None else int(1000.0 * timeout) + 1)
        return self._tick_last(super().select(0))

    def _rested(self, timeout: float | None) -> Ready:
        key = self.get_key(self._timer)
        self.unregister(self._timer)
        try:
            super().select(REST_S if timeout is None else min(timeout, REST_S))
        finally:
            self.register(key.fileobj, key.events, key.data)
        found = super().select(0)  # the same again, and the timer
        found.sort(key=lambda each: each[0].fd != self._timer)
        return found

    def _tick_last(self, found: Ready) -> Ready:
        if len(found) > 1:
            found.sort(key=lambda each: each[0].fd == self._timer)  # stable: a target that has arrived counts in this control period
        return found
