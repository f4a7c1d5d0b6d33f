"""Motions along tool paths: movel and speedl, as functions that a `Reference` advances."""

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.reference import Reference

CHECKS = 40  # places along a line that are looked at before the arm starts
ANGLE_PER_METRE = 1.0  # a turn of one radian takes as long as a way of one metre
CORRECTION_PER_S = 20.0  # how fast a line is found again after the integration's drift


def trapezoid(t: float, speed: float, acceleration: float) -> tuple[float, float, bool]:
    """Share of a way 0 … 1, its rate [1/s], and whether it is over, t after the start from rest."""
    speed = min(speed, math.sqrt(acceleration))
    ramp_s, total_s = speed / acceleration, speed / acceleration + 1.0 / speed
    if t >= total_s:
        return 1.0, 0.0, True
    if t < ramp_s:
        return 0.5 * acceleration * t * t, acceleration * t, False
    if total_s - t < ramp_s:
        return 1.0 - 0.5 * acceleration * (total_s - t) ** 2, acceleration * (total_s - t), False
    return speed * (t - 0.5 * ramp_s), speed, False


def line(
    reference: Reference, kinematics: Kinematics, goal: "pin.SE3", speed_m_s: float, acceleration_m_s2: float, max_speed: Array
) -> str:
    """The movel of URScript, from where the reference is; says why it cannot be made, or nothing."""
    start = kinematics.at(reference.q)
    way = goal.translation - start.translation
    axis = start.rotation @ pin.log3(start.rotation.T @ goal.rotation)  # along the base's axes
    length = max(float(np.linalg.norm(way)), float(np.linalg.norm(axis)) / ANGLE_PER_METRE)
    if length < 1e-9:
        reference.hold()
        return ""
    twist = np.concatenate([way, axis])
    top = min(speed_m_s / length, math.sqrt(acceleration_m_s2 / length))

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
    end = q
    t = 0.0

    def advance(h: float) -> None:
        nonlocal t
        pace, _ = reference.paced(h)
        t += pace * h
        s, rate, over = trapezoid(t, speed_m_s / length, acceleration_m_s2 / length)
        if over:
            reference.put(end, np.zeros_like(end), (end - reference.q) * 0.0)
            reference.hold()
            return
        here, there = kinematics.at(reference.q), at(s)
        drift = np.concatenate([there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T)])
        qd = kinematics.towards(reference.q, pace * rate * twist + CORRECTION_PER_S * drift)
        reference.glide(qd, h)

    reference.begin("line", advance)
    return ""


def tool_speed(kinematics: Kinematics, reference: Reference, max_speed: Array) -> Callable[[Array, float], None]:
    """The speedl of URScript: a function of the wanted velocity (6,) and acceleration [m/s²], to be called as often as it is told anew."""
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
