"""Motions of the tool: movel and speedl, as functions that advance a `Reference`."""

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.reference import Reference, total_s, trapezoid

CHECKS = 40  # points of a line for which joint positions are computed before the arm starts
ANGLE_PER_METRE = 1.0  # a rotation by one radian takes as long as a translation by one metre
CORRECTION_PER_S = 20.0  # rate at which the drift of the integration away from the line is corrected


def line(
    reference: Reference, kinematics: Kinematics, goal: "pin.SE3", speed_m_s: float, acceleration_m_s2: float, max_speed: Array
) -> str:
    """Start a movel from the present reference. Returns why the arm cannot make it, or an empty text."""
    start = kinematics.at(reference.q)
    way = goal.translation - start.translation
    axis = start.rotation @ pin.log3(start.rotation.T @ goal.rotation)  # along the base's axes
    length = max(float(np.linalg.norm(way)), float(np.linalg.norm(axis)) / ANGLE_PER_METRE)
    if length < 1e-9:
        reference.hold()
        return ""
    twist = np.concatenate([way, axis])
    acceleration = acceleration_m_s2 / length
    top = min(speed_m_s / length, math.sqrt(acceleration))

    def at(s: float) -> "pin.SE3":
        return pin.SE3(pin.exp3(s * axis) @ start.rotation, start.translation + s * way)

    q = reference.q
    for i in range(1, CHECKS + 1):
        found = kinematics.inverse(at(i / CHECKS), q, restarts=0)
        if found is None:
            return f"no joint positions for the tool at {100 * i // CHECKS} % of the way"
        rate = np.abs(kinematics.towards(found, twist)) * top
        if (rate > max_speed).any() or np.abs(found - q).max() > 1.0:
            joint = int(np.argmax(rate / max_speed)) + 1
            return f"joint {joint} would have to turn faster than it can at {100 * i // CHECKS} % of the way: near a singularity"
        q = found
    end, end_s = q, total_s(top, acceleration)
    t = 0.0

    def advance(h: float) -> None:
        nonlocal t
        slider, _ = reference.slider_share(h)
        t += slider * h
        if t >= end_s:
            reference.put(end, np.zeros_like(end), (end - reference.q) * 0.0)
            reference.hold()
            return
        s, rate, _ = trapezoid(t, top, acceleration)
        here, there = kinematics.at(reference.q), at(s)
        drift = np.concatenate([there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)])
        qd = kinematics.towards(reference.q, slider * rate * twist + CORRECTION_PER_S * drift)
        reference.glide(qd, h)

    reference.begin("line", advance)
    return ""


def tool_speed(kinematics: Kinematics, reference: Reference, max_speed: Array) -> Callable[[Array, float], None]:
    """A speedl: a function that takes the wanted velocity (6,) and the acceleration [m/s²]. Every call replaces the wanted velocity."""
    wanted, limit = np.zeros(6), 0.0
    now = kinematics.speed(reference.q, reference.qd)

    def advance(h: float) -> None:
        nonlocal now
        change = wanted - now
        largest = float(np.abs(change).max())
        now = wanted if largest <= limit * h else now + change * (limit * h / largest)
        qd = kinematics.towards(reference.q, now)
        reference.glide(qd * min(1.0, float(np.min(max_speed / np.maximum(np.abs(qd), 1e-9)))), h)

    def ask(velocity: Array, acceleration: float) -> None:
        nonlocal wanted, limit
        wanted, limit = velocity, max(acceleration, 0.01)
        if reference.mode != "speedl":
            reference.begin("speedl", advance)

    return ask
