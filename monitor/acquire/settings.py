"""How a replay is allowed, announced, played, watched and given up: the settings of this room."""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

from annotated_types import Interval

from monitor.design.cell import Cell
from monitor.errors import BadInput

_WINDOW = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-(([01]\d|2[0-3]):([0-5]\d)|24:00)\Z")
_INPUT = re.compile(r"digital_input:([0-9]|1[0-7])\Z")  # 0–7 standard, 8–15 configurable, 16–17 tool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySettings:
    """How a replay approaches, plays, watches and gives up."""

    host: str
    allow_motion: bool = False
    windows_utc: tuple[str, ...] = ()  # "22:00-05:00": an arm moves only within one of these; empty: at any time
    permit: str = "none"  # who else must agree: none, zenoh (`permit/replay` is asked), or digital_input:N (must be on)
    permit_timeout_s: Annotated[float, Interval(ge=0.1, le=600.0)] = 5.0  # no answer by then is a no
    announce_s: Annotated[float, Interval(ge=0.0, le=600.0)] = 0.0  # from the announcement to the first motion
    first_pass: bool = True  # after a change of trajectory, cell, tool or payload, slowly and within a band of torque first
    first_pass_time_scale: Annotated[float, Interval(ge=0.05, le=0.5)] = 0.25  # of the replay's own pace
    first_pass_band: Annotated[float, Interval(ge=0.02, le=0.5)] = (
        0.25  # of a joint's largest torque, where no model of this arm is known yet
    )
    max_payload_error_kg: Annotated[float, Interval(ge=0.0, le=5.0)] = 0.05  # between the controller's payload and the configuration's
    max_gravity_error_deg: Annotated[float, Interval(ge=1.0, le=45.0)] = 5.0  # between the tool's accelerometer and the configured mounting
    rate_hz: float = 125.0  # rows and targets; e-Series is asked for every fourth tick
    lookahead_s: float = 0.03
    gain: float = 500.0
    watchdog_hz: float = 10.0  # the controller stops the program when no target came for 1/f
    approach_speed_rad_s: float = 0.5
    approach_acceleration_rad_s2: float = 1.5
    max_approach_rad: float = 2.5  # farther from the start than this in any joint: somebody parked the arm elsewhere
    max_timestamp_age_s: float = 0.1
    max_following_error_rad: float = 0.05  # outside the band of the targets of the last 0.2 s
    joint_temperature_range_c: tuple[float, float] = (0.0, 75.0)
    startup_timeout_s: Annotated[float, Interval(ge=1.0, le=60.0)] = 10.0  # interpreter, imports, connections, checks
    control_timeout_s: Annotated[float, Interval(ge=6.0, le=60.0)] = (
        12.0  # upload of the control script; ur-rtde itself waits 5 s for it to run
    )
    phase_grace_s: Annotated[float, Interval(ge=0.5, le=60.0)] = 4.0  # beyond a phase's own duration
    silence_timeout_s: Annotated[float, Interval(ge=0.2, le=1.5)] = (
        1.0  # the child tells something at least every 0.1 s while the arm moves
    )
    finish_timeout_s: Annotated[float, Interval(ge=1.0, le=60.0)] = 6.0
    cell: Cell | None = None  # what stands around the arm; None: nobody said, and no clearance is checked

    def __post_init__(self) -> None:
        """Raises BadInput naming the setting, its value and what would be right."""
        within = {
            "rate_hz": (25.0, 500.0),
            "lookahead_s": (0.03, 0.2),  # servoJ's own range
            "gain": (100.0, 2000.0),
            "watchdog_hz": (10.0, 60.0),  # slower leaves a dead client's arm moving, faster trips on a late packet
            "approach_speed_rad_s": (0.01, 1.5),
            "approach_acceleration_rad_s2": (0.05, 5.0),
            "max_approach_rad": (0.0, 2.0 * math.pi),
            "max_timestamp_age_s": (0.02, 0.1),
            "max_following_error_rad": (0.005, 0.5),
        }
        for name, (low, high) in within.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise BadInput(f"replay: {name} = {value!r}; expected {low:g} to {high:g}")
        coldest, hottest = self.joint_temperature_range_c
        if not coldest < hottest:
            raise BadInput(f"replay: joint_temperature_range_c = {self.joint_temperature_range_c!r}; expected lowest, highest")
        for window in self.windows_utc:
            if not _WINDOW.match(window):
                raise BadInput(f"replay: windows_utc = {window!r}; expected HH:MM-HH:MM in UTC, e.g. 22:00-05:00")
            if window[:5] == window[6:]:
                raise BadInput(f"replay: windows_utc = {window!r} is empty; expected another end, or 00:00-24:00 for the whole day")
        if self.permit not in {"none", "zenoh"} and not _INPUT.match(self.permit):
            raise BadInput(f"replay: permit = {self.permit!r}; expected none, zenoh or digital_input:N with N from 0 to 17")

    @property
    def permit_input(self) -> int | None:
        """The digital input that must be on; None where it is not an input that is asked."""
        match = _INPUT.match(self.permit)
        return int(match[1]) if match else None

    def minutes_left(self, unix_s: float) -> float | None:
        """Until the end of the window that is open at that time; inf where every time is allowed, None where none is open."""
        if not self.windows_utc:
            return math.inf
        at = datetime.fromtimestamp(unix_s, tz=UTC)
        minute = 60.0 * at.hour + at.minute + at.second / 60.0
        left = [_left(window, minute) for window in self.windows_utc]
        return max((each for each in left if each is not None), default=None)


def _left(window: str, minute: float) -> float | None:
    """Minutes from a minute of the day to the end of HH:MM-HH:MM, which may pass midnight; None outside."""
    begin, end = (60.0 * int(part[:2]) + int(part[3:]) for part in window.split("-"))
    if begin < end:
        return end - minute if begin <= minute < end else None
    if minute >= begin:
        return 1440.0 - minute + end
    return end - minute if minute < end else None
