"""What a trajectory must keep: limits of position, speed and acceleration, rest at its ends, clearance in its cell."""

import math

import numpy as np

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
