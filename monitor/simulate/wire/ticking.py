"""An event loop that wakes once a tick, as the controller itself looks at its sockets once a tick: half the wakes, half the price."""

import select
import selectors
from collections.abc import Callable

Ready = list[tuple[selectors.SelectorKey, int]]


class TickSelector(selectors.EpollSelector):
    """While `ticking` says so, what comes between two ticks waits for the next; it is seen before the timer's own event."""

    def __init__(self) -> None:
        super().__init__()
        self.ticking: Callable[[], bool] = lambda: False
        self._timer = -1
        self._tick = select.poll()

    def follow(self, timer: int) -> None:
        """The file descriptor that becomes readable every tick."""
        self._timer = timer
        self._tick.register(timer, select.POLLIN)

    def forget(self) -> None:
        """The timer is about to be closed."""
        self._tick.unregister(self._timer)
        self._timer = -1
        self.ticking = lambda: False

    def select(self, timeout: float | None = None) -> Ready:
        """As selectors.BaseSelector says."""
        if self._timer < 0 or (timeout is not None and timeout <= 0) or not self.ticking():
            return self._tick_last(super().select(timeout))
        # rounded up: a timeout cut to nothing would spin
        self._tick.poll(None if timeout is None else int(1000.0 * timeout) + 1)
        return self._tick_last(super().select(0))

    def _tick_last(self, found: Ready) -> Ready:
        if len(found) > 1:
            found.sort(key=lambda each: each[0].fd == self._timer)  # stable: a target that has come counts in this tick
        return found
