"""How a replay is allowed, announced, played, supervised and ended: the settings of this room."""

import ipaddress
import math
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Self

import numpy as np
from annotated_types import Interval

from monitor.design.cell import Cell
from monitor.errors import BadInput
from monitor.judge.bounds import NO_KEY
from monitor.model.robot import Robot
from monitor.recording import Array

NONE = "none"
WAYS = ("external_control", "script_node")  # the program's node asks our server at Play; or the same text lies on the controller as a file


@dataclass(frozen=True, slots=True, kw_only=True)
class HandOver:
    """How a production program lends the arm."""

    by: str  # one of WAYS
    bind: str  # IPv4 address of this host on which the server of `external_control` listens; 0.0.0.0: on every one
    port: int
    wait_s: float  # how long one replay waits for a node at which every condition holds

    @property
    def serves(self) -> bool:
        """Whether a server must answer on `bind` and `port` while the service runs: without it the program's node blocks at Play."""
        return self.by == "external_control"

    @classmethod
    def of(cls, by: str, listen: str, wait_h: float) -> Self | None:
        """The value of the three keys; None where no program lends the arm. Raises BadInput naming the key."""
        address, _, port = listen.partition(":")
        try:
            bind = str(ipaddress.IPv4Address(address))
        except ValueError:
            bind = ""
        if not bind or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise BadInput(f"replay: hand_over_listen = {listen!r}; expected an IPv4 address of this host and a port, e.g. 0.0.0.0:50002")
        if by == NONE:
            return None
        if by not in WAYS:
            raise BadInput(f"replay: hand_over = {by!r}; expected {NONE}, {' or '.join(WAYS)}")
        return cls(by=by, bind=bind, port=int(port), wait_s=3600.0 * wait_h)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductionListenSettings:
    """How the arm is listened to at work."""

    listen: bool = False  # whether friction is estimated from ordinary work; off: work counts revolutions and residuals alone
    rate_hz: Annotated[float, Interval(ge=10.0, le=125.0)] = 25.0  # [Hz] rows a second, where that is more than robot.listen_hz
    deviation: Annotated[float, Interval(ge=0.01, le=0.5)] = 0.05  # fraction of friction: one standard deviation at which a joint is known
    period_days: Annotated[float, Interval(ge=1.0, le=30.0)] = 7.0  # [d] work of so many days may be added up until a joint is known


_WINDOW = re.compile(r"([01]\d|2[0-3]):([0-5]\d)-(([01]\d|2[0-3]):([0-5]\d)|24:00)\Z")
_INPUT = re.compile(r"digital_input:([0-9]|1[0-7])\Z")  # 0–7 standard, 8–15 configurable, 16–17 tool


@dataclass(frozen=True, slots=True, kw_only=True)
class Installation:
    """What the configuration says of the controller's installation and of the drives, beyond `Context`. An empty tuple: nothing is said."""

    gains_nm_per_a: tuple[float, ...] = ()  # (J,) joint torque per ampere; empty: the published ones hold, where there are any
    payload_cog_m: tuple[float, ...] = ()  # (3,) centre of gravity of the payload, in the flange's frame
    tcp_offset: tuple[float, ...] = ()  # (6,) tool centre point in the flange's frame: position [m], rotation vector [rad]
    tcp_speed_limit_m_s: float = 0.0  # of the installation's safety settings; 0: nothing is said
    safety_planes: tuple[tuple[float, ...], ...] = ()  # (a, b, c, d) each: a·x + b·y + c·z ≤ d is free, base's frame [m]

    def drive_gains(self, robot: Robot) -> Array | None:
        """(J,) joint torque per ampere [N·m/A]: the configured, else the published; None where a joint's gain is in neither."""
        gains = np.array(self.gains_nm_per_a) if self.gains_nm_per_a else robot.drive_gain_nm_per_a
        return gains if np.all(np.isfinite(gains)) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySettings:
    """How a replay is allowed, played and supervised."""

    host: str = field(default="127.0.0.1", metadata=NO_KEY)  # that of [robot]
    allow_motion: bool = False  # nothing moves unless this is true
    windows_utc: tuple[str, ...] = ()  # "22:00-05:00": the arm moves only within one of these spans; empty: at any time
    permit: str = "none"  # who else must agree: none; zenoh: `permit/replay` is asked; digital_input:N: this input must be on
    permit_timeout_s: Annotated[float, Interval(ge=0.1, le=600.0)] = 5.0  # a permit that has not come by then counts as refused
    announce_s: Annotated[float, Interval(ge=0.0, le=600.0)] = 0.0  # from the announcement to the first motion
    # who lends the arm: none; external_control: a program that plays, at its node, whose text our server gives it at Play; script_node: the
    # same, with the text of `joint-monitor script-node` as a file on the controller
    hand_over: str = "none"
    hand_over_listen: str = "0.0.0.0:50002"  # where the server for external_control listens on this host
    hand_over_wait_h: Annotated[float, Interval(ge=0.001, le=8784.0)] = 168.0  # [h] a replay that is due waits so long for a node
    allow_untested_software: bool = False  # whether an arm moves whose software is not in the table of tested versions
    first_pass: bool = True  # after a change of trajectory, cell, tool or payload, play slowly first
    first_pass_time_scale: Annotated[float, Interval(ge=0.05, le=0.5)] = 0.25  # speed of a first pass, as a share of the replay's own
    first_pass_band: Annotated[float, Interval(ge=0.02, le=0.5)] = (
        0.25  # share of a joint's largest torque that the band allows without a model
    )
    max_payload_error_kg: Annotated[float, Interval(ge=0.0, le=5.0)] = 0.05  # between the controller's payload and the configuration's
    max_gravity_error_deg: Annotated[float, Interval(ge=1.0, le=45.0)] = 5.0  # between the tool's accelerometer and the configured mounting
    rate_hz: float = 125.0  # [Hz] of rows and of targets; an e-Series controller, which runs at 500 Hz, is asked for every fourth tick
    lookahead_s: float = 0.03  # servoJ's lookahead time: a larger one makes the motion smoother and later
    gain: float = 500.0  # servoJ's proportional gain: a larger one follows more stiffly
    watchdog_hz: float = 10.0  # the controller stops the program when no target has come for 1/watchdog_hz
    approach_speed_rad_s: float = 0.5
    approach_acceleration_rad_s2: float = 1.5
    max_approach_rad: float = 2.5  # an arm with a joint farther from the start than this was parked elsewhere on purpose
    max_timestamp_age_s: float = 0.1  # without a new row for so long the replay ends
    max_following_error_rad: float = 0.05  # largest distance of a joint from the range of the targets of the last 0.2 s
    max_tracking_error_rad: float = 0.005  # largest distance of a joint from the controller's own target, beyond a lag of 40 ms
    joint_temperature_range_c: tuple[float, float] = (0.0, 75.0)  # lowest and highest temperature with which a joint may move
    startup_timeout_s: Annotated[float, Interval(ge=1.0, le=60.0)] = 10.0  # for interpreter, imports, connections and checks together
    control_timeout_s: Annotated[float, Interval(ge=6.0, le=60.0)] = (
        12.0  # upload of the control program; ur-rtde waits up to 5 s for its start
    )
    phase_grace_s: Annotated[float, Interval(ge=0.5, le=60.0)] = 4.0  # a phase may last so much longer than planned
    silence_timeout_s: Annotated[float, Interval(ge=0.03, le=1.5)] = 0.06  # while the arm moves something comes in every tick
    finish_timeout_s: Annotated[float, Interval(ge=1.0, le=60.0)] = 6.0  # for the end of the control program
    confirm_timeout_s: Annotated[float, Interval(ge=1.0, le=120.0)] = (
        10.0  # after a motion the arm must be seen in order within this time, or a person must look at it
    )
    # what stands around the arm, from the file that the key names; None: it is unknown, and no clearance is checked
    cell: Cell | None = field(default=None, metadata=NO_KEY)

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
            "max_tracking_error_rad": (0.002, 0.05),  # real arms stay within 0.001
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

        _ = self.lent

    @property
    def lent(self) -> HandOver | None:
        """How a program that plays lends the arm; None where replays begin only while no program runs."""
        return HandOver.of(self.hand_over, self.hand_over_listen, self.hand_over_wait_h)

    @property
    def permit_input(self) -> int | None:
        """The number of the digital input that gives the permit; None where no input does."""
        match = _INPUT.match(self.permit)
        return int(match[1]) if match else None

    def minutes_left(self, unix_s: float) -> float | None:
        """Minutes until the window that is open at that time closes; inf where every time is allowed, None where no window is open."""
        if not self.windows_utc:
            return math.inf
        at = datetime.fromtimestamp(unix_s, tz=UTC)
        minute = 60.0 * at.hour + at.minute + at.second / 60.0
        left = [_left(window, minute) for window in self.windows_utc]
        return max((each for each in left if each is not None), default=None)


def _left(window: str, minute: float) -> float | None:
    """Minutes from a minute of the day to the end of HH:MM-HH:MM, which may pass midnight; None outside the window."""
    begin, end = (60.0 * int(part[:2]) + int(part[3:]) for part in window.split("-"))
    if begin < end:
        return end - minute if begin <= minute < end else None
    if minute >= begin:
        return 1440.0 - minute + end
    return end - minute if minute < end else None
