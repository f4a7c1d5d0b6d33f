"""Motions that a program renews in every control period: servoj, speedj and speedl."""

import math
from collections.abc import Sequence
from itertools import chain

import numpy as np

from monitor.recording import Array
from monitor.simulate.controller.program.machine import Machine

SERVO_TIME_MIN_S, SERVO_TIME_MAX_S = 1e-4, 10.0  # range of servoj's argument `time`; a shorter time means one control period
LOOKAHEAD_S, GAIN = (0.03, 0.2), (100.0, 2000.0)  # documented ranges of servoj's arguments


def follow(machine: Machine, targets: Sequence[Sequence[float]], time_s: float, lookahead_s: float, gain: float) -> bool:
    """Give targets (J,) of servoj, oldest first, to the reference. Returns False if they lead to a protective stop."""
    if not all(map(math.isfinite, (*chain.from_iterable(targets), time_s, lookahead_s, gain))):
        machine.supervisor.protective_stop("servoj with a target that is not a number")
        return False
    jump = machine.moves.sudden(targets[-1]) if targets else ""
    if jump:
        machine.supervisor.protective_stop(f"servoj: {jump}")
        return False
    time_s = min(time_s, SERVO_TIME_MAX_S) if time_s > SERVO_TIME_MIN_S else 0.0
    lookahead_s, gain = min(max(lookahead_s, LOOKAHEAD_S[0]), LOOKAHEAD_S[1]), min(max(gain, GAIN[0]), GAIN[1])
    machine.reference.follow([list(target) for target in targets], time_s, lookahead_s, gain)
    return True


def joint_speed(machine: Machine, wanted: Array, acceleration: float) -> None:
    """Give the speed of speedj (J,) [rad/s] to the reference. A figure that is not finite is a protective stop."""
    if np.isfinite(wanted).all() and math.isfinite(acceleration):
        machine.reference.speed(wanted, acceleration)
    else:
        machine.supervisor.protective_stop("speedj with a target that is not a number")


def tool_speed(machine: Machine, wanted: Array, acceleration: float) -> None:
    """Give the speed of speedl (6,) [m/s, rad/s] along the base's axes to the reference.

    A figure that is not finite is a protective stop.
    """
    if np.isfinite(wanted).all() and math.isfinite(acceleration):
        machine.moves.tool_speed(wanted, acceleration)
    else:
        machine.supervisor.protective_stop("speedl with a target that is not a number")
