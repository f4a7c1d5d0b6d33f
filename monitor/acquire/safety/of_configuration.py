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
from monitor.reason import Reason, Sentence
from monitor.recording import Array

MAX_ACCELERATION_RAD_S2 = 5.5 * math.pi  # Raviola et al. (2021), section 2.3: the limit of the excitation's optimisation
MAX_HARMONIC_HZ = 5.0  # ten times the paper's; a faster motion could exceed a limit between the samples that are checked
MAX_DURATION_S = 600.0  # as long as twenty full replays: a longer one is a mistake in the file
END_SPEED_RAD_S = 1e-3  # coefficients are stored with 6 decimals, so a speed that is meant to be zero is within about 1e-5
END_ACCELERATION_RAD_S2 = 2e-2  # for the same reason
CHECK_RATE_HZ = 500.0  # between two samples a curve below 10 Hz exceeds them by less than 0.05 %


HARMONIC_TOO_FAST = Sentence(
    "harmonic_too_fast", "the excitation's highest harmonic is {fastest_hz:.3g} Hz; expected at most {limit_hz:g} Hz"
)
EXCITATION_TOO_LONG = Sentence("excitation_too_long", "the excitation takes {duration_s:.3g} s; expected at most {limit_s:g} s")
EXCITATION_JOINTS = Sentence("excitation_joints", "the excitation moves {excitation_joints} joints, the arm has {arm_joints}")
EXCITATION_LIMIT = Sentence(
    "excitation_limit", "the excitation breaks the limit of {joint:joint}: {quantity:word} {value:.4g} {unit}, at most {limit:.4g}"
)


def within_limits(excitation: Excitation, *, max_position_rad: Array, max_speed_rad_s: Array) -> None:
    """Check the limits of one excitation on a robot with limits of position (J,) and speed (J,).

    Raises MotionRefused naming the joint, the value and the limit that the sampled curve breaks.
    """
    fastest_hz = excitation.harmonics / excitation.pass_s
    if fastest_hz > MAX_HARMONIC_HZ:
        raise MotionRefused(HARMONIC_TOO_FAST(fastest_hz=fastest_hz, limit_hz=MAX_HARMONIC_HZ))
    if not excitation.duration_s <= MAX_DURATION_S:
        raise MotionRefused(EXCITATION_TOO_LONG(duration_s=excitation.duration_s, limit_s=MAX_DURATION_S))
    joints = len(max_position_rad)
    if len(excitation.offset_rad) != joints:
        raise MotionRefused(EXCITATION_JOINTS(excitation_joints=len(excitation.offset_rad), arm_joints=joints))
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
            raise MotionRefused(EXCITATION_LIMIT(joint=j + 1, quantity=what, value=worst[j], unit=unit, limit=limit[j]))


NEVER_PROVED = Sentence(
    "never_proved",
    "the excitation was never proved against a cell, and the arm stands in {cell!r}: design one for it, or set replay.cell = "
    "'unchecked' if nothing is within its reach",
)
PROVED_FOR_ANOTHER_CELL = Sentence(
    "proved_for_another_cell",
    "the excitation was proved against the cell {proved_cell!r} ({proved_digest}), the arm stands in {cell!r} "
    "({cell_digest}): {difference}; design one for this cell",
)
CLEARANCE_UNCHECKED = Sentence("clearance_unchecked", "the excitation's clearance cannot be checked: {why}")
NOT_CLEAR = Sentence("not_clear", "the excitation does not keep clear in the cell {cell!r}, whatever its file says: {why}")


def clear_of(cell: Cell, excitation: Excitation, robot: Robot) -> None:
    """Raises MotionRefused unless the trajectory was proved against exactly this cell, and the proof succeeds again now."""
    try:
        proved = cell_of(excitation)
        if proved is None:
            raise MotionRefused(NEVER_PROVED(cell=cell.name))
        if proved.digest != cell.digest:
            raise MotionRefused(
                PROVED_FOR_ANOTHER_CELL(
                    proved_cell=proved.name,
                    proved_digest=proved.digest,
                    cell=cell.name,
                    cell_digest=cell.digest,
                    difference=_difference(proved, cell),
                )
            )
        near = recheck(excitation, robot, cell)
    except BadInput as error:
        raise MotionRefused(CLEARANCE_UNCHECKED(why=str(error))) from None
    if near is not None:
        raise MotionRefused(NOT_CLEAR(cell=cell.name, why=str(near)))


APPROACH_UNCHECKED = Sentence("approach_unchecked", "the approach cannot be checked: {why}")
APPROACH_NOT_CLEAR = Sentence(
    "approach_not_clear", "on the straight way from where the arm stands to the start, {why}; drive it nearer to the start by hand"
)


def clear_line(cell: Cell, excitation: Excitation, robot: Robot, begin: Array, end: Array) -> Clearance:
    """The clearance of the straight way in joint space between two positions (J,), to the start of the excitation or from its end.

    Raises MotionRefused where it is less than the margins of the cell.
    """
    try:
        line = surroundings(robot, excitation.mounting, cell).line(begin, end)
    except BadInput as error:
        raise MotionRefused(APPROACH_UNCHECKED(why=str(error))) from None
    near = line.short_of(cell)
    if near is not None:
        raise MotionRefused(APPROACH_NOT_CLEAR(why=str(near)))
    return line


def _difference(one: Cell, other: Cell) -> str:
    """In which tables two cells differ, in words."""
    a, b = one.as_document(), other.as_document()
    keys = [f"cell.{key}" for key in {*a["cell"], *b["cell"]} - {"name"} if a["cell"].get(key) != b["cell"].get(key)]
    keys += [table for table in ("wall", "box", "tool") if a[table] != b[table]]
    return f"they differ in {', '.join(sorted(keys))}"


PRIVATE_NETWORKS = tuple(ipaddress.IPv4Network(network) for network in ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16"))  # RFC 1918

CB3, CB3_HZ = "cb3", 125.0  # what a controller of this generation sends at most; later ones send 500


MOTION_NOT_ALLOWED = Sentence("motion_not_allowed", "motion is not allowed: allow_motion is false (set it to true to let this arm move)")
MOTION_ALLOWED = Sentence("motion_allowed", "allow_motion is true")


def motion_allowed(inputs: ConditionInputs) -> Reason:
    """The configuration allows motion. Only the value true itself does; a text such as "false" does not."""
    if inputs.settings.allow_motion is not True:
        raise MotionRefused(MOTION_NOT_ALLOWED())
    return MOTION_ALLOWED()


NOT_AN_ADDRESS = Sentence(
    "not_an_address", "host {host!r}: expected a literal IPv4 address, as 192.168.0.10; a name may mean another arm some day"
)
ADDRESS_NOT_PRIVATE = Sentence("address_not_private", "host {host}: expected an address of this machine or of a private network")


def local_address(host: str) -> ipaddress.IPv4Address:
    """The address, where it is a literal one of this machine or of a private network. Raises MotionRefused."""
    try:
        ipv4 = ipaddress.IPv4Address(host)
    except ValueError:
        raise MotionRefused(NOT_AN_ADDRESS(host=host)) from None
    if not (ipv4.is_loopback or ipv4.is_link_local or any(ipv4 in network for network in PRIVATE_NETWORKS)):
        raise MotionRefused(ADDRESS_NOT_PRIVATE(host=host))
    return ipv4


SIMULATED_ARM = Sentence("simulated_arm", "{host} is this machine: an arm here is taken for a simulated one")
FIRST_PASS_MISSING = Sentence(
    "first_pass_missing", "host {host} is a real arm, and first_pass is false: only a simulated one may go without"
)
CELL_MISSING = Sentence("cell_missing", "host {host} is a real arm, and its cell is unchecked: describe what stands around it")
REAL_ARM = Sentence("real_arm", "{host} is a real arm: first passes are slow, clearances are proved")


def address(inputs: ConditionInputs) -> Reason:
    """The address is a literal one of this machine, or of a private network; a real arm there has its cell and slow first passes."""
    settings = inputs.settings
    host = settings.host
    if local_address(host).is_loopback:
        return SIMULATED_ARM(host=host)
    if not settings.first_pass:
        raise MotionRefused(FIRST_PASS_MISSING(host=host))
    if settings.cell is None:
        raise MotionRefused(CELL_MISSING(host=host))
    return REAL_ARM(host=host)


OUTSIDE_EVERY_WINDOW = Sentence("outside_every_window", "now is outside every allowed window: {windows} UTC")
WINDOW_TOO_SHORT = Sentence("window_too_short", "the window closes in {left_min:.1f} minutes, the motion alone takes {needed_min:.1f}")
ANY_TIME = Sentence("any_time", "at any time")
WINDOW_OPEN = Sentence("window_open", "open for another {left_min:.0f} minutes")


def time_window(inputs: ConditionInputs) -> Reason:
    """The motion, with the way to the start and back, ends before the open time window closes."""
    left = inputs.settings.minutes_left(inputs.now_unix_s)
    if left is None:
        raise MotionRefused(OUTSIDE_EVERY_WINDOW(windows=", ".join(inputs.settings.windows_utc)))
    needed = (inputs.excitation.duration_s + _there_and_back_s(inputs)) / 60.0
    if left < needed:
        raise MotionRefused(WINDOW_TOO_SHORT(left_min=left, needed_min=needed))
    return ANY_TIME() if math.isinf(left) else WINDOW_OPEN(left_min=left)


def _there_and_back_s(inputs: ConditionInputs) -> float:
    """Duration of the way to the start and back; 0 where it is not known where the arm stands."""
    if inputs.state is None or not np.all(np.isfinite(inputs.state.target_q)):
        return 0.0
    way = inputs.way_from(inputs.state)
    return way.to_start(inputs.settings).duration_s + way.to_home(inputs.settings).duration_s


EXCITATION_OF_ANOTHER_ARM = Sentence("excitation_of_another_arm", "the excitation was designed for {excitation_arm!r}, the arm is {arm!r}")
EXCITATION_OF_ANOTHER_MOUNTING = Sentence(
    "excitation_of_another_mounting", "the excitation was designed for mounting {designed_deg:g}°, the arm hangs at {mounting_deg:g}°"
)
RATE_TOO_HIGH = Sentence(
    "rate_too_high",
    "rate_hz = {rate_hz:g}: a {arm} sends {limit_hz:g} rows a second at most, and a motion that follows them would be slower "
    "than designed; expected at most {limit_hz:g}",
)
WITHIN_LIMITS = Sentence("within_limits", "{digest}, {duration_s:.1f} s within every limit of the {arm}")


def trajectory(inputs: ConditionInputs) -> Reason:
    """The trajectory was designed for this robot and this mounting, and keeps every limit of the robot."""
    excitation, robot = inputs.excitation, inputs.robot
    if excitation.robot != robot.name:
        raise MotionRefused(EXCITATION_OF_ANOTHER_ARM(excitation_arm=excitation.robot, arm=robot.name))
    mounting = inputs.context.mounting_rad
    if mounting is not None and not np.allclose(mounting, excitation.mounting.angles_rad, atol=1e-6):
        designed = np.round(np.degrees(excitation.mounting.angles_rad), 3)
        raise MotionRefused(EXCITATION_OF_ANOTHER_MOUNTING(designed_deg=designed, mounting_deg=np.degrees(mounting)))
    if robot.generation == CB3 and inputs.settings.rate_hz > CB3_HZ:
        raise MotionRefused(RATE_TOO_HIGH(rate_hz=inputs.settings.rate_hz, arm=robot.name, limit_hz=CB3_HZ))
    within_limits(excitation, max_position_rad=robot.max_position_rad, max_speed_rad_s=robot.max_speed_rad_s)
    return WITHIN_LIMITS(digest=excitation.digest, duration_s=excitation.duration_s, arm=robot.name)


CELL_UNCHECKED = Sentence(
    "cell_unchecked", "the configuration says unchecked: nothing is known to be within reach, and no clearance is proved"
)
PROVED_CLEAR = Sentence("proved_clear", "proved against the cell {cell!r}, and proved again now")


def trajectory_clear(inputs: ConditionInputs) -> Reason:
    """The trajectory was proved clear of the configured cell, and is so when it is proved again."""
    cell = inputs.settings.cell
    if cell is None:
        raise Unreported(CELL_UNCHECKED())
    clear_of(cell, inputs.excitation, inputs.robot)
    return PROVED_CLEAR(cell=cell.name)


STOP_WAITS = Sentence("stop_waits", "{stop}; a person must look at the arm and say so: joint-monitor allow")
NO_STOP_WAITS = Sentence("no_stop_waits", "no stop is waiting for a person")


def previous_stop(inputs: ConditionInputs) -> Reason:
    """A person has acknowledged every earlier stop that a person must check."""
    if inputs.last.stopped_before is not None:
        raise MotionRefused(STOP_WAITS(stop=inputs.last.stopped_before))
    return NO_STOP_WAITS()
