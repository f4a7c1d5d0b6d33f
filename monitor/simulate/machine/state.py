"""The clock of a controller, and the age of its arm."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol


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


# --- Error codes of the manufacturer's list that this controller reports on the primary port ------------


class ErrorCode(NamedTuple):
    """A code of the manufacturer's list, and how grave it is: 2 a warning, 3 a violation."""

    number: int
    level: int


DEVIATES = ErrorCode(153, 3)  # "position deviates from path": what the supervision of the arm reports, whatever the reason
ASKED = ErrorCode(209, 2)  # "a protective stop was triggered": by a program


# --- The modes of a controller, numbered as RTDE numbers them, and who may change them for a program ----


class RobotMode(IntEnum):
    """The robot's mode, with RTDE's numbers."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """The safety mode, with RTDE's numbers."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    ROBOT_EMERGENCY_STOP = 7


class Runtime(IntEnum):
    """The state of the program, with RTDE's numbers."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


@dataclass(slots=True)
class Modes:
    """The present modes of one controller."""

    robot: RobotMode = RobotMode.RUNNING
    safety: SafetyMode = SafetyMode.NORMAL
    runtime: Runtime = Runtime.STOPPED
    popup: str = ""  # the text of the popup on the pendant; empty if there is none
    teach_button: bool = False  # the freedrive button is held
    braked: frozenset[int] = frozenset()  # joints 0 … J−1 whose brakes are closed although the arm is running

    @property
    def powered(self) -> bool:
        """Whether the arm has electric power."""
        return self.robot > RobotMode.POWER_OFF

    @property
    def unstopped(self) -> bool:
        """Whether no safety stop is active."""
        return self.safety in (SafetyMode.NORMAL, SafetyMode.REDUCED)

    @property
    def obstacle(self) -> str:
        """The mode that keeps the arm from moving; an empty text if the arm may move."""
        if not self.unstopped:
            return f"safety mode is {self.safety.name}"
        return "" if self.robot == RobotMode.RUNNING else f"robot mode is {self.robot.name}"

    @property
    def may_move(self) -> bool:
        """Whether the drives are on and no safety stop is active."""
        return not self.obstacle


class Supervisor(Protocol):
    """What a part may ask of its controller: end the program, or stop the arm."""

    def raise_exception(self, text: str) -> None:
        """End the program by a runtime exception."""

    def protective_stop(self, reason: str, code: ErrorCode = DEVIATES, joint: int | None = None) -> None:
        """Halt the arm in a protective stop, which is reported with this code. joint : that noticed it, from 1; None: any."""

    def acknowledge(self) -> None:
        """Unlock a protective stop and let the program play on, as a person does at the pendant."""
