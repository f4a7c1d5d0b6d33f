"""What a task takes: its parts by the clock, the processor's time, bytes and memory."""

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

PARTS = ("read", "decode", "compute", "write")


class Cost(NamedTuple):
    """What a task took. Times by the clock, but for `processor_s`; sums over tasks, but for `peak_mb`."""

    recordings: int = 0  # that were identified or judged; not those of a result that was there already
    bytes_read: int = 0
    read_s: float = 0.0  # to bring bytes here and to check them
    decode_s: float = 0.0  # bytes to signals
    compute_s: float = 0.0  # identification, or verdicts
    write_s: float = 0.0
    task_s: float = 0.0
    processor_s: float = 0.0
    peak_mb: float = 0.0  # of the worker's memory, so far

    def plus(self, other: "Cost") -> "Cost":
        """Both together."""
        parts: list[Any] = [mine + theirs for mine, theirs in zip(self, other, strict=True)]
        summed = Cost(*parts)
        return summed._replace(peak_mb=max(self.peak_mb, other.peak_mb))


class Meter:
    """Measures one task."""

    def __init__(self) -> None:
        self._began, self._processor = time.perf_counter(), time.process_time()
        self._parts = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """What happens inside counts as this part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._parts[name] += time.perf_counter() - began

    def cost(self, recordings: int, bytes_read: int) -> Cost:
        """What the task took until now."""
        return Cost(
            recordings=recordings,
            bytes_read=bytes_read,
            **{f"{name}_s": seconds for name, seconds in self._parts.items()},
            task_s=time.perf_counter() - self._began,
            processor_s=time.process_time() - self._processor,
            peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        )
