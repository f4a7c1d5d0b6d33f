"""The regressor: joint torque as a matrix of the motion times the standard parameters, Raviola et al. (2021), eq. (1)–(4).

Parameters of joint i, in this order: m, mx, my, mz (first moments), Jxx, Jxy, Jxz, Jyy, Jyz, Jzz (about the DH origin, so
not about the centre of mass), all in standard DH frame i; then fc, fv (friction) and Im (rotor inertia referred to the joint).
Joint j feels only the links from j outward: Y is upper block-triangular, and only that half is computed.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from monitor.errors import BadInput
from monitor.model.friction import LAWS
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array

COULOMB, VISCOUS, ROTOR = INERTIAL, INERTIAL + 1, INERTIAL + 2  # columns within a joint's block
_KINDS = ("m{0}", "m{0}x{0}", "m{0}y{0}", "m{0}z{0}", "J{0}xx", "J{0}xy", "J{0}xz", "J{0}yy", "J{0}yz", "J{0}zz", "fc{0}", "fv{0}", "Im{0}")


class _Vector(NamedTuple):
    """A 3-vector for every sample, by component: long contiguous rows are what numpy is quick at."""

    x: Array
    y: Array
    z: Array

    def cross(self, other: "_Vector") -> "_Vector":
        return _Vector(self.y * other.z - self.z * other.y, self.z * other.x - self.x * other.z, self.x * other.y - self.y * other.x)

    def dot(self, other: "_Vector") -> Array:
        product: Array = self.x * other.x + self.y * other.y + self.z * other.z
        return product

    def plus(self, other: "_Vector") -> "_Vector":
        return _Vector(self.x + other.x, self.y + other.y, self.z + other.z)


def parameter_names(joints: int) -> tuple[str, ...]:
    """(13·J,) names as the paper's appendix spells them: m1, m1x1, …, J1zz, fc1, fv1, Im1, m2, …"""
    return tuple(kind.format(joint) for joint in range(1, joints + 1) for kind in _KINDS)


def friction_columns(joints: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Columns of fc and of fv among the 13·J, each (J,) of int."""
    first = PER_JOINT * np.arange(joints)
    return first + COULOMB, first + VISCOUS


def regressor(robot: Robot, mounting: Mounting, q: Array, qd: Array, qdd: Array) -> Array:
    """Y with torque = Y · parameters.

    q, qd, qdd : (N, J) [rad, rad/s, rad/s²]. Returns (N, J, 13·J); memory runs along the samples (a transposed view), because
    every use of it walks down the samples of one joint. Raises BadInput where the shapes do not fit the robot.
    """
    J = robot.joints
    if q.ndim != 2 or q.shape[1] != J or qd.shape != q.shape or qdd.shape != q.shape:
        raise BadInput(f"{robot.name}: q, q̇, q̈ are {q.shape}, {qd.shape}, {qdd.shape}; expected (samples, {J}) for each")
    N = len(q)
    Y = np.zeros((J, PER_JOINT * J, N))  # (J, P, N)
    angle = q.T + robot.zero_rad[:, None]  # (J, N)
    cos, sin = np.cos(angle), np.sin(angle)  # (J, N)
    speed, acceleration = np.ascontiguousarray(qd.T), np.ascontiguousarray(qdd.T)  # (J, N)
    still = np.zeros(N)

    # Newton–Euler outward. The base accelerates upward: gravity then needs no term of its own.
    w, dw = _Vector(still, still, still), _Vector(still, still, still)
    a = _Vector(*(still - component for component in robot.gravity(mounting)))
    # axes of joints 1…i and their moment arms (axis × vector from the axis to the origin), in the present frame
    axis = _Vector(np.empty((0, N)), np.empty((0, N)), np.empty((0, N)))  # (i, N) each
    arm = axis
    for i in range(J):
        v = speed[i]
        dw = _Vector(dw.x + w.y * v, dw.y - w.x * v, dw.z + acceleration[i])  # ω̇ + z q̈ + ω × z q̇
        w = _Vector(w.x, w.y, w.z + v)
        axis = _Vector(*(np.vstack([part, np.full((1, N), own)]) for part, own in zip(axis, (0.0, 0.0, 1.0), strict=True)))
        arm = _Vector(*(np.vstack([part, np.zeros((1, N))]) for part in arm))

        c, s = cos[i], sin[i]
        ca, sa = np.cos(robot.alpha_rad[i]), np.sin(robot.alpha_rad[i])
        w, dw, a, axis, arm = (_into_next(vector, c, s, float(ca), float(sa)) for vector in (w, dw, a, axis, arm))
        y, d = robot.y_m[i], robot.d_m[i]
        to_here = _Vector(robot.a_m[i], ca * y + sa * d, ca * d - sa * y)  # origin i−1 → i, fixed in frame i
        a = a.plus(dw.cross(to_here)).plus(w.cross(w.cross(to_here)))
        arm = arm.plus(axis.cross(to_here))

        _link_block(Y[: i + 1, PER_JOINT * i : PER_JOINT * i + INERTIAL], axis, arm, w, dw, a)
        Y[i, PER_JOINT * i + ROTOR] = acceleration[i]
    friction = LAWS["paper"].columns(qd, None)  # (N, J, 2)
    for i in range(J):
        Y[i, PER_JOINT * i + COULOMB : PER_JOINT * i + ROTOR] = friction[:, i].T
    return Y.transpose(2, 0, 1)  # (N, J, P)


def _into_next(v: _Vector, c: Array, s: Array, ca: float, sa: float) -> _Vector:
    """Components in frame i of a vector given in frame i−1: (Rot(z, q)·Rot(x, α))ᵀ v."""
    y = c * v.y - s * v.x
    return _Vector(c * v.x + s * v.y, ca * y + sa * v.z, ca * v.z - sa * y)


def _link_block(block: Array, axis: _Vector, arm: _Vector, w: _Vector, dw: _Vector, a: _Vector) -> None:
    """Fill (i, 10, N): what one link's ten inertial parameters do on each axis inward of it.

    The link pushes with f = m·a + (S(ω̇) + S(ω)²)·mc and n = mc × a + Jω̇ + ω × Jω at its DH origin; an axis feels z·n + (z × r)·f.
    """
    block[:, 0] = arm.dot(a)
    # (S(ω̇) + S(ω)²)ᵀ·arm = arm × ω̇ + ω (ω·arm) − arm ω², and z·(mc × a) = mc·(a × z)
    turn, lean, along = arm.cross(dw), a.cross(axis), w.dot(arm)
    w2 = w.dot(w)
    for k in range(3):
        block[:, 1 + k] = turn[k] + lean[k] + w[k] * along - arm[k] * w2
    # z·Jω̇ + z·(ω × Jω) = z·Jω̇ + (z × ω)·Jω, with J symmetric
    b = axis.cross(w)
    block[:, 4] = axis.x * dw.x + b.x * w.x
    block[:, 5] = axis.x * dw.y + axis.y * dw.x + b.x * w.y + b.y * w.x
    block[:, 6] = axis.x * dw.z + axis.z * dw.x + b.x * w.z + b.z * w.x
    block[:, 7] = axis.y * dw.y + b.y * w.y
    block[:, 8] = axis.y * dw.z + axis.z * dw.y + b.y * w.z + b.z * w.y
    block[:, 9] = axis.z * dw.z + b.z * w.z
