"""May the arm move now? Permission, trajectory and present state, each refusal with its reason.

Pure functions of what they are given: `replay` and the child process `stream` both ask them, so that neither needs
to trust the other. Where a cell is configured, the whole path is checked against it again, and so is the straight way from where the
arm stands. Until site limits are guarded too, only a simulated arm may move: any address that is not a loopback literal is refused.
"""

import ipaddress
import math
from dataclasses import dataclass

import numpy as np

from monitor.design.cell import Cell
from monitor.design.clearance import surroundings
from monitor.design.proof import cell_of, recheck
from monitor.errors import BadInput, MotionRefused
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array

ROBOT_MODE_RUNNING = 7
SAFETY_MODE_NORMAL = 1
SAFETY_BITS_NORMAL = 0b1  # bit 0 alone; any other bit is reduced mode, a stop or a fault
RUNTIME_STOPPED = 1
RUNTIME_PLAYING = 2

MAX_ACCELERATION_RAD_S2 = 5.5 * math.pi  # Raviola et al. (2021), section 2.3: the limit of the excitation's optimisation
MAX_HARMONIC_HZ = 5.0  # ten times the paper's; what is faster would slip between the samples at which limits are checked
MAX_DURATION_S = 600.0  # twenty full replays: longer is a slip of the pen
END_SPEED_RAD_S = 1e-3  # coefficients are stored to 1e-6: ends that are "zero" are so to about 1e-5
END_ACCELERATION_RAD_S2 = 2e-2
STANDSTILL_RAD_S = 0.02  # speed noise of an arm at rest stays below
HOLD_ERROR_RAD = 0.05  # an arm that holds its pose has its target within this of its position

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySettings:
    """How a replay approaches, plays, watches and gives up."""

    host: str
    allow_motion: bool = False
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
    startup_timeout_s: float = 10.0  # interpreter, imports, connections, checks
    control_timeout_s: float = 12.0  # upload of the control script; ur-rtde itself waits 5 s for it to run
    phase_grace_s: float = 4.0  # beyond a phase's own duration
    silence_timeout_s: float = 1.0  # the child tells something at least every 0.1 s while the arm moves
    finish_timeout_s: float = 6.0
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmState:
    """One snapshot of the controller, as far as the guards ask."""

    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime_state: int
    q: Array  # (J,) [rad]
    qd: Array  # (J,) [rad/s]
    target_q: Array  # (J,) [rad]
    target_qd: Array  # (J,) [rad/s]
    temperature_c: Array  # (J,)


def permission(settings: ReplaySettings, excitation: Excitation, robot: Robot) -> None:
    """May this excitation be played on this robot at all?

    Raises MotionRefused with the reason; returns if nothing speaks against it.
    """
    permitted(settings)
    if excitation.robot != robot.name:
        raise MotionRefused(f"the excitation was designed for {excitation.robot!r}, the arm is {robot.name!r}")
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)
    if settings.cell is not None:
        clear_of(settings.cell, excitation, robot)


def clear_of(cell: Cell, excitation: Excitation, robot: Robot) -> None:
    """Raises MotionRefused unless the trajectory was proved against this very cell, and the proof holds when done again."""
    try:
        proved = cell_of(excitation)
        if proved is None:
            raise MotionRefused(
                f"the excitation was never proved against a cell, and the arm stands in {cell.name!r}: design one for it, "
                "or set replay.cell = 'unchecked' if nothing is within its reach"
            )
        if proved.digest != cell.digest:
            raise MotionRefused(
                f"the excitation was proved against the cell {proved.name!r} ({proved.digest}), the arm stands in {cell.name!r} "
                f"({cell.digest}): {_difference(proved, cell)}; design one for this cell"
            )
        near = recheck(excitation, robot, cell)
    except BadInput as error:
        raise MotionRefused(f"the excitation's clearance cannot be checked: {error}") from None
    if near is not None:
        raise MotionRefused(f"the excitation does not keep clear in the cell {cell.name!r}, whatever its file says: {near}")


def clear_approach(cell: Cell, excitation: Excitation, robot: Robot, q: Array) -> None:
    """Raises MotionRefused unless the straight way in joint space from q (J,) to the start keeps the cell's margins."""
    try:
        line = surroundings(robot, excitation.mounting, cell).line(q, excitation.at(np.zeros(1)).q[0])
    except BadInput as error:
        raise MotionRefused(f"the approach cannot be checked: {error}") from None
    near = line.short_of(cell)
    if near is not None:
        raise MotionRefused(f"on the straight way from where the arm stands to the start, {near}; drive it nearer to the start by hand")


def _difference(one: Cell, other: Cell) -> str:
    """Which tables of two cells differ."""
    a, b = one.as_document(), other.as_document()
    keys = [f"cell.{key}" for key in {*a["cell"], *b["cell"]} - {"name"} if a["cell"].get(key) != b["cell"].get(key)]
    keys += [table for table in ("wall", "box", "tool") if a[table] != b[table]]
    return f"they differ in {', '.join(sorted(keys))}"


def permitted(settings: ReplaySettings) -> None:
    """Raises MotionRefused unless motion is allowed and the address is a loopback literal (127.0.0.0/8)."""
    if settings.allow_motion is not True:
        raise MotionRefused("motion is not allowed: allow_motion is false (set it to true to let this arm move)")
    try:
        address = ipaddress.IPv4Address(settings.host)
    except ValueError:
        address = None
    if address is None or not address.is_loopback:
        raise MotionRefused(f"host {settings.host!r}: only a simulated arm may move yet; expected a literal address 127.x.y.z")


def within_limits(excitation: Excitation, *, max_position_rad: Array, max_speed_rad_s: Array) -> None:
    """Raises MotionRefused naming the joint, the value and the limit that the sampled curve breaks."""
    fastest_hz = excitation.harmonics / excitation.pass_s
    if fastest_hz > MAX_HARMONIC_HZ:
        raise MotionRefused(f"the excitation's highest harmonic is {fastest_hz:.3g} Hz; expected at most {MAX_HARMONIC_HZ:g} Hz")
    if not excitation.duration_s <= MAX_DURATION_S:
        raise MotionRefused(f"the excitation takes {excitation.duration_s:.3g} s; expected at most {MAX_DURATION_S:g} s")
    joints = len(max_position_rad)
    if len(excitation.offset_rad) != joints:
        raise MotionRefused(f"the excitation moves {len(excitation.offset_rad)} joints, the arm has {joints}")
    # one period tells all; between samples at 500 Hz a curve below 10 Hz exceeds its samples by less than 0.05 %
    t_s = np.linspace(0.0, excitation.pass_s, max(2, round(excitation.pass_s * 500.0) + 1))  # (N,)
    curve = excitation.at(t_s)
    limits = (
        ("position", "rad", curve.q, max_position_rad),
        ("speed", "rad/s", curve.qd, max_speed_rad_s),
        ("acceleration", "rad/s²", curve.qdd, np.full(joints, MAX_ACCELERATION_RAD_S2)),
        ("speed at the start", "rad/s", curve.qd[:1], np.full(joints, END_SPEED_RAD_S)),
        ("acceleration at the start", "rad/s²", curve.qdd[:1], np.full(joints, END_ACCELERATION_RAD_S2)),
    )  # the series is periodic: its start is its end
    for what, unit, values, limit in limits:
        worst = np.max(np.abs(values), axis=0)  # (J,)
        beyond = np.flatnonzero(~(worst <= limit))
        if beyond.size:
            j = int(beyond[0])
            raise MotionRefused(f"the excitation breaks the limit of joint {j + 1}: {what} {worst[j]:.4g} {unit}, at most {limit[j]:.4g}")


def ready(state: ArmState, settings: ReplaySettings, start_q: Array) -> None:
    """May the arm begin to move from where it is to start_q (J,)? Nobody else's program runs, it is well and at rest.

    Raises MotionRefused with the first reason found.
    """
    if state.safety_mode != SAFETY_MODE_NORMAL or state.safety_bits != SAFETY_BITS_NORMAL:
        name = SAFETY_MODES.get(state.safety_mode, "unknown")
        raise MotionRefused(f"safety mode is {state.safety_mode} ({name}), bits {state.safety_bits:#x}; expected 1 (normal), bits 0x1")
    if state.robot_mode != ROBOT_MODE_RUNNING:
        raise MotionRefused(f"robot mode is {state.robot_mode} ({ROBOT_MODES.get(state.robot_mode, 'unknown')}); expected 7 (running)")
    if state.runtime_state != RUNTIME_STOPPED:
        name = RUNTIME_STATES.get(state.runtime_state, "unknown")
        raise MotionRefused(f"a program is {name} on the controller (runtime state {state.runtime_state}); it is not ours to stop")
    if not all(np.all(np.isfinite(part)) for part in (state.q, state.qd, state.target_q, state.target_qd, state.temperature_c)):
        raise MotionRefused("the controller reports values that are not finite")
    speed = np.maximum(np.abs(state.qd), np.abs(state.target_qd))  # (J,)
    if np.max(speed) > STANDSTILL_RAD_S:
        j = int(np.argmax(speed))
        raise MotionRefused(f"the arm is moving: joint {j + 1} at {speed[j]:.3f} rad/s; expected standstill")
    hold = np.abs(state.q - state.target_q)  # (J,)
    if np.max(hold) > HOLD_ERROR_RAD:
        j = int(np.argmax(hold))
        raise MotionRefused(f"joint {j + 1} is {hold[j]:.3f} rad from the controller's own target; at most {HOLD_ERROR_RAD}")
    far = np.abs(state.q - start_q)  # (J,)
    if np.max(far) > settings.max_approach_rad:
        j = int(np.argmax(far))
        raise MotionRefused(f"joint {j + 1} is {far[j]:.2f} rad from the start of the excitation; at most {settings.max_approach_rad:g}")
    coldest, hottest = settings.joint_temperature_range_c
    outside = np.flatnonzero((state.temperature_c < coldest) | (state.temperature_c > hottest))
    if outside.size:
        j = int(outside[0])
        raise MotionRefused(f"joint {j + 1} is at {state.temperature_c[j]:.1f} °C; allowed are {coldest:g} to {hottest:g} °C")
