"""A joint that stands one or more whole turns on: the trajectory is played around the nearest turn, not wound back.

The path through the cell is the same, and so are the trajectory's digest, its proof and what is identified from it: positions enter all
of them by their sine and cosine.
"""

import dataclasses
import math

import numpy as np

from monitor.model.fourier import Excitation
from monitor.model.robot import Robot
from monitor.recording import Array

TURN_RAD = 2.0 * math.pi
CURVE_SAMPLES = 1001  # of one period: between two a curve below 10 Hz exceeds them by less than a thousandth of its swing
ROUNDING_RAD = 1e-6


def turned(excitation: Excitation, robot: Robot, q: Array) -> Excitation:
    """The same trajectory with each joint as many whole turns on as bring its start nearest to q (J,), within the joint's range.

    A joint without end leaves ±max_position_rad only where it stands beyond it already: that shows that its installation allows it.
    """
    if not np.all(np.isfinite(q)):
        return excitation
    wished = np.round((q - excitation.at(np.zeros(1)).q[0]) / TURN_RAD)  # (J,)
    if not np.any(wished):
        return excitation
    curve = excitation.at(np.linspace(0.0, excitation.pass_s, CURVE_SAMPLES)).q  # (N, J)
    free = (robot.endless > 0.0) & (np.abs(q) > robot.max_position_rad)  # (J,)
    limit = np.where(free, np.inf, robot.max_position_rad + ROUNDING_RAD)
    lowest = np.ceil((-limit - np.min(curve, axis=0)) / TURN_RAD)
    highest = np.floor((limit - np.max(curve, axis=0)) / TURN_RAD)
    turns = np.clip(wished, np.minimum(lowest, 0.0), np.maximum(highest, 0.0))  # (J,)
    return excitation if not np.any(turns) else dataclasses.replace(excitation, offset_rad=excitation.offset_rad + TURN_RAD * turns)
