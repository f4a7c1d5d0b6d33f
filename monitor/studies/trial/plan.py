"""What a trial plays."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What is tried."""

    robot: str
    scenario: str
    speed: float
    days: float | None  # ends after so many; None: when a person says so
    seed: int
    keep: Path | None  # folder of history and configuration; None: a temporary one
    config: Path | None  # a configuration of the person's own
