"""What a robot says of itself: who it is, and one snapshot of its state.

This module is the one place that says what the numbers of the modes mean. They are those of Universal Robots, because recordings and
published documents carry them; the driver of another make translates its own modes into these numbers.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from monitor.acquire.rows import layout_of
from monitor.reason import Reason, Sentence
from monitor.recording import Array

ROBOT_MODE_RUNNING = 7
SAFETY_MODE_NORMAL = 1
SAFETY_BITS_NORMAL = 0b1  # bit 0 alone; every other bit means reduced mode, a stop or a fault
RUNTIME_STOPPING = 0
RUNTIME_STOPPED = 1
RUNTIME_PLAYING = 2
RUNTIME_PAUSING = 3
RUNTIME_PAUSED = 4
JOINT_MODE_RUNNING = 253
STATUS_BIT_TEACH_BUTTON = 0b100  # of robot_status_bits: somebody holds the freedrive button

FULL_SPEED = 0.999  # share: 100 % on the slider, with rounding
STANDSTILL_RAD_S = 0.02  # the measured speed of an arm at rest stays below this noise level

RUNTIME_STATES = {0: "stopping", 1: "stopped", 2: "playing", 3: "pausing", 4: "paused", 5: "resuming"}
ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}
SAFETY_MODES = {
    1: "normal",
    2: "reduced",
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "system emergency stop",
    7: "robot emergency stop",
    8: "violation",
    9: "fault",
}
JOINT_MODES = {
    235: "reset",
    236: "shutting down",
    237: "part D calibration",
    238: "back-drive",
    239: "power off",
    240: "ready for power off",
    245: "not responding",
    246: "motor initialisation",
    247: "booting",
    248: "part D calibration error",
    249: "bootloader",
    250: "calibration",
    251: "violation",
    252: "fault",
    253: "running",
    255: "idle",
}
POWERED = range(4, 8)  # robot modes of an arm under power: power on, idle, backdrive, running
STOPS = {3: "protective_stop", 8: "violation", 9: "fault"}  # safety modes that the safety system enters by itself
EMERGENCY_MODES, PROTECTIVE_MODE, SAFEGUARD_MODE = {6, 7}, 3, 5  # safety modes
EMERGENCY_BITS, PROTECTIVE_BIT, SAFEGUARD_BIT = 0b1110_0000, 0b100, 0b1_0000  # of the safety bits

SAFETY_NOT_NORMAL = Sentence("safety_mode_not_normal", "safety mode is {mode} ({name:word}), bits {bits:#x}; expected 1 (normal), bits 0x1")
NOT_RUNNING = Sentence("robot_mode_not_running", "robot mode is {mode} ({name:word}); expected 7 (running)")
JOINT_NOT_RUNNING = Sentence(
    "joint_not_running", "{joint:joint} is in mode {mode:g} ({name:word}); expected {running} (running, its brake released)"
)
TEACH_BUTTON_HELD = Sentence("teach_button_held", "somebody holds the freedrive button; expected nobody at the arm")
NOT_FINITE = Sentence("values_not_finite", "the controller reports values that are not finite")
SLIDER_LOW = Sentence(
    "slider_low", "the speed slider is at {share_percent:.0f} %; expected 100 %: at less the arm plays another trajectory"
)
PROGRAM_SLOW = Sentence("program_slow", "the program plays at {share_percent:.0f} % of its speed: the arm plays another trajectory")
ANOTHER_PAYLOAD = Sentence(
    "another_payload",
    "the controller reckons with {payload_kg:.3f} kg, the configuration says {configured_kg:.3f} kg; at most {limit_kg:g} kg apart",
)
TEMPERATURE_OUTSIDE = Sentence("temperature_outside", "{joint:joint} is at {temperature_c:.1f} °C; allowed are {low_c:g} to {high_c:g} °C")
TEMPERATURE_NOT_TOLD = Sentence("temperature_not_told", "{joint:joint} tells no temperature; allowed are {low_c:g} to {high_c:g} °C")


def program_name(runtime_state: int) -> str:
    """What the program is doing, in a word."""
    return RUNTIME_STATES.get(runtime_state, "unknown")


class JointLimits(NamedTuple):
    """The limits of each joint that a controller's installation sets."""

    lowest_rad: tuple[float, ...]  # (J,)
    highest_rad: tuple[float, ...]  # (J,)
    speed_rad_s: tuple[float, ...]  # (J,)


class Services(NamedTuple):
    """The services of a controller that a motion needs, each with its port, as somebody looks for them."""

    open: tuple[str, ...]
    closed: tuple[str, ...] = ()
    switch: str = ""  # where the controller switches them on


class Software(NamedTuple):
    """What the driver knows of the controller's software."""

    drivable: bool = True  # it can be driven at all
    tested: bool = False  # replays on it are tested
    reason: str = ""  # why, where the version is known
    expected: str = ""  # the tested versions, for a person
    client_library: str = ""  # the client library that drives it, with its version
    expected_client_library: str = ""  # the same with the tested version


class Identity(NamedTuple):
    """Who the controller says it is, and what its driver knows of such a controller; None where it does not say."""

    model: str | None  # for example "UR5"
    serial: str | None
    firmware: str | None  # for example "3.15.8.106339"
    remote_control: bool | None  # whether the controller takes commands over the network
    joint_limits: JointLimits | None = None  # of its installation
    automatic: bool | None = None  # whether it is in automatic mode
    robot_api: bool = False  # it has a Robot API in place of a dashboard
    sources: str = ""  # who told what that server does not tell; empty: it told everything
    generation: str | None = None  # of arms that its software drives, as `Robot.generation`; None: unknown
    software: Software = Software()
    no_remote_control: str = ""  # what it means where `remote_control` is not reported


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmState:
    """One snapshot of the controller. NaN stands for a value that the controller does not report.

    What may be wrong with it is a reason, None where it is not so: the conditions before a motion, its checks and the look after it ask
    the same questions.
    """

    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime_state: int
    q: Array  # (J,) [rad]
    qd: Array  # (J,) [rad/s]
    target_q: Array  # (J,) [rad]
    target_qd: Array  # (J,) [rad/s]
    temperature_c: Array  # (J,)
    speed_scaling: float = math.nan  # share of full speed that the controller's trajectory limiter allows
    speed_fraction: float = math.nan  # share of full speed at which the operator's slider stands
    payload_kg: float = math.nan
    payload_cog_m: tuple[float, ...] = ()  # (3,) its centre of gravity in the flange's frame; empty where none was read
    accelerometer_m_s2: tuple[float, float, float] = (math.nan, math.nan, math.nan)  # of the flange, in the flange's frame
    digital_inputs: float = math.nan  # a bit for each input, as a number
    status_bits: float = math.nan  # robot_status_bits, as a number
    controller_s: float = math.nan  # controller's clock
    host_s: float = math.nan  # this host's monotonic clock when the row was read
    joint_modes: tuple[float, ...] = ()  # (J,) numbers of JOINT_MODES; empty where none was read
    tcp_pose: tuple[float, ...] = ()  # (6,) position [m], rotation vector [rad] in the base's frame; empty where none was read

    @property
    def not_safe(self) -> Reason | None:
        """What the safety system says where it is not in its normal mode, without any stop or fault."""
        if self.safety_mode == SAFETY_MODE_NORMAL and self.safety_bits == SAFETY_BITS_NORMAL:
            return None
        return SAFETY_NOT_NORMAL(mode=self.safety_mode, name=SAFETY_MODES.get(self.safety_mode, "unknown"), bits=self.safety_bits)

    @property
    def safety_cause(self) -> str:
        """The kind of stop, where `not_safe`."""
        if self.safety_mode in EMERGENCY_MODES or self.safety_bits & EMERGENCY_BITS:
            return "emergency_stop"
        if self.safety_mode == PROTECTIVE_MODE or self.safety_bits & PROTECTIVE_BIT:
            return "protective_stop"
        if self.safety_mode == SAFEGUARD_MODE or self.safety_bits & SAFEGUARD_BIT:
            return "safeguard_stop"
        return "safety"

    @property
    def not_running(self) -> Reason | None:
        """The robot mode where the robot is not powered on and running."""
        if self.robot_mode == ROBOT_MODE_RUNNING:
            return None
        return NOT_RUNNING(mode=self.robot_mode, name=ROBOT_MODES.get(self.robot_mode, "unknown"))

    @property
    def joint_not_running(self) -> Reason | None:
        """The first joint whose drive is off or whose brake is closed; a mode that is not reported (NaN) says nothing."""
        for j, mode in enumerate(self.joint_modes):
            if not (math.isnan(mode) or mode == JOINT_MODE_RUNNING):
                name = JOINT_MODES.get(int(mode), "unknown") if math.isfinite(mode) else "unknown"
                return JOINT_NOT_RUNNING(joint=j + 1, mode=mode, name=name, running=JOINT_MODE_RUNNING)
        return None

    @property
    def teach_button(self) -> Reason | None:
        """Somebody holds the freedrive button, or the bits are no number; None where they are not reported."""
        if math.isnan(self.status_bits) or (math.isfinite(self.status_bits) and not int(self.status_bits) & STATUS_BIT_TEACH_BUTTON):
            return None
        return TEACH_BUTTON_HELD()

    @property
    def no_position(self) -> Reason | None:
        """A position, or the controller's own target, is no number."""
        return None if np.all(np.isfinite(self.q)) and np.all(np.isfinite(self.target_q)) else NOT_FINITE()

    def other_payload(self, configured_kg: float | None, limit_kg: float) -> Reason | None:
        """The controller reckons with another payload than the configured one; None where one of the two is not known."""
        if configured_kg is None or math.isnan(self.payload_kg) or abs(self.payload_kg - configured_kg) <= limit_kg:
            return None
        return ANOTHER_PAYLOAD(payload_kg=self.payload_kg, configured_kg=configured_kg, limit_kg=limit_kg)

    def temperature_outside(self, allowed_c: tuple[float, float]) -> Reason | None:
        """The joint whose temperature is the farthest from the range, or the first one whose temperature is not known."""
        low_c, high_c = allowed_c
        off_k = np.maximum(low_c - self.temperature_c, self.temperature_c - high_c)  # (J,)
        j = int(np.argmax(off_k))  # a NaN counts as the largest
        if off_k[j] <= 0.0:
            return None
        if np.isnan(off_k[j]):
            return TEMPERATURE_NOT_TOLD(joint=j + 1, low_c=low_c, high_c=high_c)
        return TEMPERATURE_OUTSIDE(joint=j + 1, temperature_c=self.temperature_c[j], low_c=low_c, high_c=high_c)

    @property
    def slider_full(self) -> bool:
        """Whether the operator's slider stands at 100 %, with rounding; False where it is not reported."""
        return FULL_SPEED <= self.speed_fraction <= 2.0 - FULL_SPEED

    @property
    def slider_low(self) -> Reason | None:
        """The operator's slider is not at 100 %; None where it is not reported."""
        if math.isnan(self.speed_fraction) or self.slider_full:
            return None
        return SLIDER_LOW(share_percent=100.0 * self.speed_fraction)

    @property
    def speed(self) -> float:
        """Share of full speed at which a program plays: limiter times slider; NaN where neither is reported.

        A real controller's limiter stands at 0 while no program plays, and for some ticks after one has started.
        """
        reported = [share for share in (self.speed_scaling, self.speed_fraction) if not math.isnan(share)]
        return math.prod(reported) if reported else math.nan

    @property
    def at_full_speed(self) -> bool:
        """Whether a program plays at 100 %, with rounding; False where that is not reported."""
        return FULL_SPEED <= self.speed <= 2.0 - FULL_SPEED

    @property
    def slow(self) -> Reason | None:
        """A program that had come up to full speed plays at less, because of the slider or of the limiter; None: not reported."""
        if math.isnan(self.speed) or self.at_full_speed:
            return None
        return PROGRAM_SLOW(share_percent=100.0 * self.speed)


def arm_state(row: Array) -> ArmState:
    """The state that one row (WIDTH,) reports."""
    of = {name: row[column] for name, column in layout_of(len(row)).column.items()}
    x, y, z = of["actual_tool_accelerometer"]
    return ArmState(
        robot_mode=int(of["robot_mode"][0]),
        safety_mode=int(of["safety_mode"][0]),
        safety_bits=int(of["safety_status_bits"][0]),
        runtime_state=int(of["runtime_state"][0]),
        q=of["actual_q"],
        qd=of["actual_qd"],
        target_q=of["target_q"],
        target_qd=of["target_qd"],
        temperature_c=of["joint_temperatures"],
        speed_scaling=float(of["speed_scaling"][0]),
        speed_fraction=float(of["target_speed_fraction"][0]),
        payload_kg=float(of["payload"][0]),
        payload_cog_m=tuple(of["payload_cog"].tolist()),
        accelerometer_m_s2=(float(x), float(y), float(z)),
        digital_inputs=float(of["actual_digital_input_bits"][0]),
        status_bits=float(of["robot_status_bits"][0]),
        controller_s=float(of["timestamp"][0]),
        host_s=float(of["host_monotonic_s"][0]),
        joint_modes=tuple(of["joint_mode"].tolist()),
        tcp_pose=tuple(of["actual_TCP_pose"].tolist()),
    )
