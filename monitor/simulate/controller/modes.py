"""Modes of a controller as RTDE numbers them, and what is kept of a stop."""

from dataclasses import dataclass
from enum import IntEnum


class RobotMode(IntEnum):
    """As RTDE numbers them."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """As RTDE numbers them."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


class Runtime(IntEnum):
    """As RTDE numbers them."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


@dataclass(slots=True)
class Stop:
    """One stop of a program or of the arm, on the controller's clock."""

    at_s: float
    kind: str  # "watchdog" | "protective_stop" | "emergency_stop" | "program_stop" | "program_end"
    reason: str
    stood_at_s: float | None = None  # when the arm had come to rest
