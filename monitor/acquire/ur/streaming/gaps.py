"""How late this process sent its targets, and which failures that explains. Values only: the caller reads the clock."""

from monitor.acquire.ur.streaming.failures import StreamFailure

RECENT_S = 0.5  # a failure so soon after late targets is taken for their consequence
MOST_TICKS = 2.5  # between two rows: one tick that is left out is made up for, a longer gap interrupts the stream of targets
LATE_SHARE = 0.5  # of the longest gap: a process that slept so long without a check was late itself
WATCHDOG_SHARE = 0.5  # of the watchdog's time: after a longer gap, the watchdog may have stopped the program because of us


class CycleGaps:
    """The gaps between two cycles: the longest of the last half second, and the longest of all."""

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._recent_s, self._recent_at_s = 0.0, float("-inf")

    def add(self, now_s: float, gap_s: float) -> None:
        """Take note of a gap that ended now, on the host's clock."""
        if gap_s >= self._recent_s or now_s - self._recent_at_s > RECENT_S:
            self._recent_s, self._recent_at_s = gap_s, now_s
        self.longest_s = max(self.longest_s, gap_s)

    def clear(self) -> None:
        """Forget every gap: what took long before the arm moved explains nothing."""
        self.longest_s = self._recent_s = 0.0

    def were_late(self, now_s: float, tick_s: float) -> bool:
        """Whether the stream of targets was interrupted within the last half second."""
        return self._recent_s >= MOST_TICKS * tick_s and now_s - self._recent_at_s <= RECENT_S

    def explain(self, failure: StreamFailure, now_s: float, *, tick_s: float, watchdog_s: float) -> StreamFailure:
        """The failure by its true cause: `late` where late targets just before it can have caused it, else the failure itself.

        `watchdog_s` is the time after which the controller's watchdog stops a program that receives no target.
        """
        enough_s = {
            "bad_target": MOST_TICKS * tick_s,
            "program_stopped": WATCHDOG_SHARE * watchdog_s,
            "servo_refused": WATCHDOG_SHARE * watchdog_s,
        }.get(failure.cause)
        if enough_s is None or self._recent_s < enough_s or now_s - self._recent_at_s > RECENT_S:
            return failure
        return StreamFailure(
            "late", f"targets came late, {1000 * self._recent_s:.0f} ms between two cycles; then {failure.cause}: {failure}"
        )


def gap_failure(age_s: float, slept_s: float, limit_s: float) -> StreamFailure:
    """The failure after so long without a row, where this process did not check for slept_s of it."""
    if slept_s >= LATE_SHARE * limit_s:
        return StreamFailure("late", f"this process got no processor time for {1000 * slept_s:.0f} ms")
    return StreamFailure("stalled", f"no new data from the controller for {1000 * age_s:.0f} ms")
