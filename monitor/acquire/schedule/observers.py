"""What the schedule must know of the arm: whether it ran again after a long rest, and whether its temperatures are steady."""

from collections.abc import Iterable

GAP_S = 60.0  # temperatures that were not observed for so long are not known to be steady


class ColdStart:
    """When the arm ran again after a long rest."""

    def __init__(self, last_running_unix_s: float | None) -> None:
        self.last_running_unix_s = last_running_unix_s  # from before this process, where it is known
        self.at_unix_s: float | None = None  # the last cold start
        self._rested = False  # this process has observed the rest: a gap in our own listening is no rest of the arm

    def observe(self, running: bool, now_unix_s: float, after_h: float) -> None:
        """Take note of whether the arm runs now; one that cannot be heard does not. A rest counts from `after_h` on; 0: no rest counts."""
        if not running:
            self._rested = True
            return
        last = self.last_running_unix_s
        if self._rested and after_h > 0 and last is not None and now_unix_s - last >= 3600.0 * after_h:
            self.at_unix_s = now_unix_s
        self._rested, self.last_running_unix_s = False, now_unix_s


class WarmUp:
    """Whether the joints' temperatures are steady: warm from work, or as cold as the room."""

    SPAN_S, STEP_S = 600.0, 10.0  # temperatures of the last 10 min, one every 10 s

    def __init__(self) -> None:
        self._seen: list[tuple[float, tuple[float, ...]]] = []

    def observe(self, temperature_c: Iterable[float], now_unix_s: float) -> None:
        """Take note of the joints' temperatures [°C] now."""
        if self._seen and now_unix_s - self._seen[-1][0] < self.STEP_S:
            if now_unix_s < self._seen[-1][0]:
                self._seen.clear()  # the clock was set back
            return
        self._seen.append((now_unix_s, tuple(temperature_c)))
        while now_unix_s - self._seen[0][0] > self.SPAN_S + 2 * self.STEP_S:
            del self._seen[0]

    def steady(self, now_unix_s: float, within_k: float) -> bool:
        """Whether no joint's temperature changed by more than within_k in SPAN_S, without a gap of GAP_S in the observations."""
        times = [at for at, _ in self._seen]
        if not times or now_unix_s - times[0] < self.SPAN_S:
            return False
        if any(after - before > GAP_S for before, after in zip(times, [*times[1:], now_unix_s], strict=True)):
            return False
        return all(max(joint) - min(joint) <= within_k for joint in zip(*(values for _, values in self._seen), strict=True))
