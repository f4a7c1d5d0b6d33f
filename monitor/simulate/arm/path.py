"""A path of several moves that flow into each other, as a controller blends them.

Each move is a trapezoid of its own from rest to rest. A blend starts the next move while the one before brakes, and adds the two: position
and speed are continuous, and the tool cuts the corner. Two trapezoids that overlap so have no more than the speed of either where their
ramps are alike.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics
from monitor.simulate.arm.reference import Reference, total_s, trapezoid

MODE = "path"  # of the reference while such a path is under way
NODES = 11  # joint positions of a straight line are interpolated between so many; over 1 m a UR5's tool stays within 0.1 mm of the line
ANGLE_PER_METRE = 1.0  # a rotation by one radian takes as long as a translation by one metre
SPEED_SHARE = 0.95  # a line near a singularity is slowed to this share of the joints' limits

Curve = Callable[[float], tuple[Array, Array, Array]]  # share of the way 0 … 1 → q, dq/ds, d²q/ds², each (J,)


class Stretch(NamedTuple):
    """A curve with the trapezoid in which it is travelled: speed and acceleration of the share [1/s, 1/s²]."""

    curve: Curve
    speed: float
    acceleration: float


@dataclass(slots=True)
class _Leg:
    stretch: Stretch
    start: Array
    end: Array
    t_s: float = 0.0

    @property
    def left_s(self) -> float:
        return self.total_s - self.t_s

    @property
    def ramp_s(self) -> float:
        return self.stretch.speed / self.stretch.acceleration

    @property
    def total_s(self) -> float:
        return total_s(self.stretch.speed, self.stretch.acceleration)

    def at(self) -> tuple[Array, Array, Array]:
        """Position, and its first and second derivative by the time of the path."""
        s, sd, sdd = trapezoid(self.t_s, self.stretch.speed, self.stretch.acceleration)
        q, along, bend = self.stretch.curve(s)
        return q, sd * along, sdd * along + sd * sd * bend


class Path:
    """The moves that are under way on one reference."""

    def __init__(self, reference: Reference) -> None:
        self._reference, self._legs = reference, list[_Leg]()

    def add(self, stretch: Stretch) -> None:
        """Travel this stretch, which begins where the last one ends, from now on."""
        if self._reference.mode != MODE:
            self._legs = []
        self._legs.append(_Leg(stretch, stretch.curve(0.0)[0], stretch.curve(1.0)[0]))
        if self._reference.mode != MODE:
            self._reference.begin(MODE, self._advance)

    @property
    def end(self) -> Array:
        """(J,) where the last move ends, or where the arm is asked to be."""
        return self._legs[-1].end if self._reference.mode == MODE else self._reference.q - self._reference.given

    @property
    def brakes(self) -> bool:
        """Whether the last move is in its second ramp, so that another one may begin."""
        return self._reference.mode == MODE and len(self._legs) == 1 and self._legs[0].left_s < self._legs[0].ramp_s

    def _advance(self, h: float) -> None:
        reference, legs = self._reference, self._legs
        share, change = reference.slider_share(h)
        q, qd, qdd = reference.given.copy(), np.zeros_like(reference.q), np.zeros_like(reference.q)
        for leg in legs[1:]:
            q -= leg.start
        for leg in legs:
            leg.t_s = min(leg.t_s + share * h, leg.total_s)
            at, speed, acceleration = leg.at()
            q += at
            qd += share * speed
            qdd += share * share * acceleration + change * speed
        reference.put(q, qd, qdd)
        legs[:-1] = [leg for leg in legs[:-1] if leg.left_s > 0.0]
        if len(legs) == 1 and legs[0].left_s <= 0.0:
            reference.hold()


def joints(start: Array, end: Array, speed_rad_s: float, acceleration_rad_s2: float, max_speed: Array) -> Stretch | None:
    """A movej: all joints together, the fastest with this speed. None where there is nothing to travel."""
    way = end - start
    length = float(np.abs(way).max())
    if length < 1e-9:
        return None
    none = np.zeros_like(way)
    speed = min(speed_rad_s / length, float(np.min(max_speed / np.maximum(np.abs(way), 1e-12))))
    return _stretch(lambda s: (start + s * way, way, none), speed, acceleration_rad_s2 / length)


def line(
    kinematics: Kinematics, start: Array, goal: "pin.SE3", speed_m_s: float, acceleration_m_s2: float, max_speed: Array
) -> Stretch | str | None:
    """A movel of the tool from joint positions (J,) to a placement. Returns why the arm cannot make it; None where nothing is to travel.

    The joint positions are computed at Chebyshev's nodes and interpolated (Trefethen, 2013, ch. 2).
    """
    here = kinematics.at(start)
    way = goal.translation - here.translation
    axis = here.rotation @ pin.log3(here.rotation.T @ goal.rotation)
    length = max(float(np.linalg.norm(way)), float(np.linalg.norm(axis)) / ANGLE_PER_METRE)
    if length < 1e-9:
        return None
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    found = [start]
    for s in nodes[1:]:
        q = kinematics.inverse(pin.SE3(pin.exp3(s * axis) @ here.rotation, here.translation + s * way), found[-1], restarts=0)
        if q is None or np.abs(q - found[-1]).max() > 1.0:
            return f"no joint positions for the tool at {100 * s:.0f} % of the way"
        found.append(q)
    J, powers = len(start), np.arange(NODES)
    weights = np.linalg.solve((2.0 * nodes[:, None] - 1.0) ** powers, np.array(found))  # of powers of x = 2s − 1
    first, second = np.zeros_like(weights), np.zeros_like(weights)
    first[:-1] = 2.0 * powers[1:, None] * weights[1:]
    second[:-1] = 2.0 * powers[1:, None] * first[1:]
    stacked = np.hstack([weights, first, second])

    def curve(s: float) -> tuple[Array, Array, Array]:
        row: Array = ((2.0 * s - 1.0) ** powers).dot(stacked)
        return row[:J], row[J : 2 * J], row[2 * J :]

    fastest = np.max([np.abs(curve(s)[1]) / max_speed for s in np.linspace(0.0, 1.0, 21)])
    return _stretch(curve, min(speed_m_s / length, SPEED_SHARE / max(float(fastest), 1e-9)), acceleration_m_s2 / length)


def _stretch(curve: Curve, speed: float, acceleration: float) -> Stretch:
    return Stretch(curve, min(speed, math.sqrt(acceleration)), acceleration)
