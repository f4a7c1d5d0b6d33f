"""The clock of a controller, and the age of its arm."""


class Clock:
    """Counts control periods since the controller started."""

    def __init__(self, tick_s: float, lived_before_s: float = 0.0) -> None:
        """`tick_s` is the control period; `lived_before_s` is the age of the arm when the controller started."""
        self.tick_s = tick_s
        self.ticks = 0
        self._lived_before_s = lived_before_s
        self._leapt_s = 0.0  # time that has passed without control periods
        self._jumped_s = 0.0  # a fault of the published clock

    def tick(self) -> None:
        """Advance by one control period."""
        self.ticks += 1

    def leap(self, seconds: float) -> None:
        """Advance without control periods."""
        self._leapt_s += seconds

    def jump(self, seconds: float) -> None:
        """Shift the clock that is published, and nothing else."""
        self._jumped_s += seconds

    @property
    def published_s(self) -> float:
        """What RTDE publishes as `timestamp` [s]: the time since the controller started, and the jumps of the published clock."""
        return self.now_s + self._jumped_s

    @property
    def now_s(self) -> float:
        """Time since the controller started [s]."""
        return self.ticks * self.tick_s + self._leapt_s

    @property
    def lived_s(self) -> float:
        """Age of the arm since its scenario began [s]. A restart of the controller does not reset it."""
        return self._lived_before_s + self.now_s
