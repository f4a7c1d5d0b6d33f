"""Conditions on what is known before the controller is asked: the configuration, the trajectory, the time, the history."""

import ipaddress
import math

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.design.cell import Cell
from monitor.design.clearance import Clearance, surroundings
from monitor.design.proof import cell_of, recheck
from monitor.errors import BadInput, MotionRefused
from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.reason import joint_text
from monitor.recording import Array

MAX_ACCELERATION_RAD_S2 = 5.5 * math.pi  # Raviola et al. (2021), section 2.3: the limit of the excitation's optimisation
MAX_HARMONIC_HZ = 5.0  # ten times the paper's; a faster motion could exceed a limit between the samples that are checked
MAX_DURATION_S = 600.0  # as long as twenty full replays: a longer one is a mistake in the file
END_SPEED_RAD_S = 1e-3  # coefficients are stored with 6 decimals, so a speed that is meant to be zero is within about 1e-5
END_ACCELERATION_RAD_S2 = 2e-2  # for the same reason
CHECK_RATE_HZ = 500.0  # between two samples a curve below 10 Hz exceeds them by less than 0.05 %


def within_limits(excitation: Excitation, *, max_position_rad: Array, max_speed_rad_s: Array) -> None:
    """Check the limits of one excitation on a robot with limits of position (J,) and speed (J,).

    Raises MotionRefused naming the joint, the value and the limit that the sampled curve breaks.
    """
    fastest_hz = excitation.harmonics / excitation.pass_s
    if fastest_hz > MAX_HARMONIC_HZ:
        raise MotionRefused(f"the excitation's highest harmonic is {fastest_hz:.3g} Hz; expected at most {MAX_HARMONIC_HZ:g} Hz")
    if not excitation.duration_s <= MAX_DURATION_S:
        raise MotionRefused(f"the excitation takes {excitation.duration_s:.3g} s; expected at most {MAX_DURATION_S:g} s")
    joints = len(max_position_rad)
    if len(excitation.offset_rad) != joints:
        raise MotionRefused(f"the excitation moves {len(excitation.offset_rad)} joints, the arm has {joints}")
    t_s = np.linspace(0.0, excitation.pass_s, max(2, round(excitation.pass_s * CHECK_RATE_HZ) + 1))  # (N,) one period: the rest repeats it
    curve = excitation.at(t_s)
    limits = (
        ("position", "rad", curve.q, max_position_rad),
        ("speed", "rad/s", curve.qd, max_speed_rad_s),
        ("acceleration", "rad/s²", curve.qdd, np.full(joints, MAX_ACCELERATION_RAD_S2)),
        ("speed at the start", "rad/s", curve.qd[:1], np.full(joints, END_SPEED_RAD_S)),
        ("acceleration at the start", "rad/s²", curve.qdd[:1], np.full(joints, END_ACCELERATION_RAD_S2)),
    )  # the Fourier series is periodic, so its end is its start
    for what, unit, values, limit in limits:
        worst = np.max(np.abs(values), axis=0)  # (J,)
        beyond = np.flatnonzero(~(worst <= limit))
        if beyond.size:
            j = int(beyond[0])
            raise MotionRefused(
                f"the excitation breaks the limit of {joint_text(j + 1)}: {what} {worst[j]:.4g} {unit}, at most {limit[j]:.4g}"
            )


def clear_of(cell: Cell, excitation: Excitation, robot: Robot) -> None:
    """Raises MotionRefused unless the trajectory was proved against exactly this cell, and the proof succeeds again now."""
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


def clear_line(cell: Cell, excitation: Excitation, robot: Robot, begin: Array, end: Array) -> Clearance:
    """The clearance of the straight way in joint space between two positions (J,), to the start of the excitation or from its end.

    Raises MotionRefused where it is less than the margins of the cell.
    """
    try:
        line = surroundings(robot, excitation.mounting, cell).line(begin, end)
    except BadInput as error:
        raise MotionRefused(f"the approach cannot be checked: {error}") from None
    near = line.short_of(cell)
    if near is not None:
        raise MotionRefused(f"on the straight way from where the arm stands to the start, {near}; drive it nearer to the start by hand")
    return line


def _difference(one: Cell, other: Cell) -> str:
    """In which tables two cells differ, in words."""
    a, b = one.as_document(), other.as_document()
    keys = [f"cell.{key}" for key in {*a["cell"], *b["cell"]} - {"name"} if a["cell"].get(key) != b["cell"].get(key)]
    keys += [table for table in ("wall", "box", "tool") if a[table] != b[table]]
    return f"they differ in {', '.join(sorted(keys))}"


PRIVATE_NETWORKS = tuple(ipaddress.IPv4Network(network) for network in ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16"))  # RFC 1918

CB3, CB3_HZ = "cb3", 125.0  # what a controller of this generation sends at most; later ones send 500


def motion_allowed(inputs: ConditionInputs) -> str:
    """The configuration allows motion. Only the value true itself does; a text such as "false" does not."""
    if inputs.settings.allow_motion is not True:
        raise MotionRefused("motion is not allowed: allow_motion is false (set it to true to let this arm move)")
    return "allow_motion is true"


def local_address(host: str) -> ipaddress.IPv4Address:
    """The address, where it is a literal one of this machine or of a private network. Raises MotionRefused."""
    try:
        ipv4 = ipaddress.IPv4Address(host)
    except ValueError:
        raise MotionRefused(
            f"host {host!r}: expected a literal IPv4 address, as 192.168.0.10; a name may mean another arm some day"
        ) from None
    if not (ipv4.is_loopback or ipv4.is_link_local or any(ipv4 in network for network in PRIVATE_NETWORKS)):
        raise MotionRefused(f"host {host}: expected an address of this machine or of a private network")
    return ipv4


def address(inputs: ConditionInputs) -> str:
    """The address is a literal one of this machine, or of a private network; a real arm there has its cell and slow first passes."""
    settings = inputs.settings
    host = settings.host
    if local_address(host).is_loopback:
        return f"{host} is a simulated arm"
    if not settings.first_pass:
        raise MotionRefused(f"host {host} is a real arm, and first_pass is false: only a simulated one may go without")
    if settings.cell is None:
        raise MotionRefused(f"host {host} is a real arm, and its cell is unchecked: describe what stands around it")
    return f"{host} is a real arm: first passes are slow, clearances are proved"


def time_window(inputs: ConditionInputs) -> str:
    """The motion, with the way to the start and back, ends before the open time window closes."""
    left = inputs.settings.minutes_left(inputs.now_unix_s)
    if left is None:
        raise MotionRefused(f"now is outside every allowed window: {', '.join(inputs.settings.windows_utc)} UTC")
    needed = (inputs.excitation.duration_s + _there_and_back_s(inputs)) / 60.0
    if left < needed:
        raise MotionRefused(f"the window closes in {left:.1f} minutes, the motion alone takes {needed:.1f}")
    return "at any time" if math.isinf(left) else f"open for another {left:.0f} minutes"


def _there_and_back_s(inputs: ConditionInputs) -> float:
    """Duration of the way to the start and back; 0 where it is not known where the arm stands."""
    if inputs.state is None or not np.all(np.isfinite(inputs.state.target_q)):
        return 0.0
    way = inputs.way_from(inputs.state)
    return way.to_start(inputs.settings).duration_s + way.to_home(inputs.settings).duration_s


def trajectory(inputs: ConditionInputs) -> str:
    """The trajectory was designed for this robot and this mounting, and keeps every limit of the robot."""
    excitation, robot = inputs.excitation, inputs.robot
    if excitation.robot != robot.name:
        raise MotionRefused(f"the excitation was designed for {excitation.robot!r}, the arm is {robot.name!r}")
    mounting = inputs.context.mounting_rad
    if mounting is not None and not np.allclose(mounting, excitation.mounting.angles_rad, atol=1e-6):
        designed = np.round(np.degrees(excitation.mounting.angles_rad), 3)
        raise MotionRefused(f"the excitation was designed for mounting {designed}°, the arm hangs at {np.degrees(mounting)}°")
    if robot.generation == CB3 and inputs.settings.rate_hz > CB3_HZ:
        raise MotionRefused(
            f"rate_hz = {inputs.settings.rate_hz:g}: a {robot.name} sends {CB3_HZ:g} rows a second at most, and a motion that follows them "
            f"would be slower than designed; expected at most {CB3_HZ:g}"
        )
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)
    return f"{excitation.digest}, {excitation.duration_s:.1f} s within every limit of the {robot.name}"


def trajectory_clear(inputs: ConditionInputs) -> str:
    """The trajectory was proved clear of the configured cell, and is so when it is proved again."""
    cell = inputs.settings.cell
    if cell is None:
        raise Unreported("the configuration says unchecked: nothing is known to be within reach, and no clearance is proved")
    clear_of(cell, inputs.excitation, inputs.robot)
    return f"proved against the cell {cell.name!r}, and proved again now"


def previous_stop(inputs: ConditionInputs) -> str:
    """A person has acknowledged every earlier stop that a person must check."""
    if inputs.stopped_before is not None:
        raise MotionRefused(f"{inputs.stopped_before}; a person must look at the arm and say so: joint-monitor allow")
    return "no stop is waiting for a person"
