"""The regressor: joint torque as a matrix of the motion times the standard parameters, Raviola et al. (2021), eq. (1)–(4).

Parameters of joint i, in this order: m, mx, my, mz (first moments), Jxx, Jxy, Jxz, Jyy, Jyz, Jzz (about the DH origin, not about the
centre of mass), all in standard DH frame i; then fc, fv (friction) and Im (rotor inertia referred to the joint).
Where motors are coupled (`Robot.coupling`), states and torques are those of the motors: friction and rotors act there, and the rigid part
is that of the joints, seen from the motors.
The links from j outward act on joint j, and no others. So Y is upper block-triangular, and only that half is computed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.friction import PAPER
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array, Indices

ROUNDING = 1e-15  # a smaller sine or cosine is zero: the cosine of α = π/2 is 6e-17 in floating point
COULOMB, VISCOUS, ROTOR = INERTIAL, INERTIAL + 1, INERTIAL + 2  # columns within a joint's block
_KINDS = ("m{0}", "m{0}x{0}", "m{0}y{0}", "m{0}z{0}", "J{0}xx", "J{0}xy", "J{0}xz", "J{0}yy", "J{0}yz", "J{0}zz", "fc{0}", "fv{0}", "Im{0}")


def parameter_names(joints: int) -> tuple[str, ...]:
    """(13·J,) names in the spelling of the paper's appendix: m1, m1x1, …, J1zz, fc1, fv1, Im1, m2, …"""
    return tuple(kind.format(joint) for joint in range(1, joints + 1) for kind in _KINDS)


def friction_columns(joints: int) -> tuple[Indices, Indices]:
    """Columns of fc and of fv among the 13·J, (J,) each."""
    first = PER_JOINT * np.arange(joints)
    return first + COULOMB, first + VISCOUS


def regressor(robot: Robot, mounting: Mounting, q: Array, qd: Array, qdd: Array) -> Array:
    """Y (N, J, 13·J) with torque = Y · parameters.

    q, qd, qdd : (N, J) [rad, rad/s, rad/s²]. Memory runs along the samples (the result is a transposed view), because users read the
    samples of one joint. Raises BadInput where the shapes do not fit the robot.
    """
    J = robot.joints
    Y = np.zeros((J, PER_JOINT * J, len(q)))  # (J, P, N)
    blocks = [Y[: i + 1, PER_JOINT * i : PER_JOINT * i + INERTIAL] for i in range(J)]
    _fill(blocks, [range(INERTIAL)] * J, robot, robot.gravity(mounting)[:, None], (q, qd, qdd))
    if robot.coupling is not None:
        Y = np.tensordot(robot.share_of_motors, Y, 1)
    joints = np.arange(J)
    Y[joints, PER_JOINT * joints + ROTOR] = qdd.T
    for i in range(J):
        Y[i, PER_JOINT * i + COULOMB : PER_JOINT * i + ROTOR] = PAPER.columns(qd[:, i]).T
    return Y.transpose(2, 0, 1)  # (N, J, P)


class Felt(NamedTuple):
    """Where the columns of each joint's row that are not zero lie among the columns asked for."""

    places: tuple[Indices, ...]  # of each joint: those of the links outward of it, then its own fc, fv and Im
    kinds: tuple[tuple[int, ...], ...]  # of each link: which of its ten inertial columns are asked for


def felt_columns(columns: Sequence[int], joints: int, innermost: Sequence[int] | None = None) -> Felt:
    """What each joint feels of these columns of Y (ascending; every joint's fc and fv among them).

    innermost : as in `Robot`, where motors are coupled; None: each joint's own.
    """
    first = range(joints) if innermost is None else innermost
    link, kind = np.divmod(np.asarray(columns), PER_JOINT)
    inertial = kind < INERTIAL
    places = tuple(
        np.concatenate([np.flatnonzero(inertial & (link >= i)), np.flatnonzero(~inertial & (link == j))]) for j, i in enumerate(first)
    )
    return Felt(places, tuple(tuple(kind[inertial & (link == i)].tolist()) for i in range(joints)))


def felt_regressor(robot: Robot, mounting: Mounting, felt: Felt, q: Array, qd: Array, qdd: Array, direction: Array) -> list[Array]:
    """Of each joint the columns of Y that it feels, (N, K) in the order of `felt`; no other column is formed.

    direction : (N, J) stands in the columns of fc. Memory runs along the samples. Raises BadInput as `regressor`.
    """
    return felt_under(robot, robot.gravity(mounting)[:, None], felt, q, qd, qdd, direction)


def felt_under(robot: Robot, gravity: Array, felt: Felt, q: Array, qd: Array, qdd: Array, direction: Array) -> list[Array]:
    """`felt_regressor` under a gravity of each sample's own, (3, N) or (3, 1) in DH frame 0 [m/s²]."""
    J, ends = robot.joints, np.cumsum([0, *(len(kinds) for kinds in felt.kinds)])
    W = int(ends[-1])
    Y = np.empty((J, W + PER_JOINT - INERTIAL, len(q)))  # each joint's own columns follow those of the links: what it feels is one block
    blocks = [Y[: i + 1, ends[i] : ends[i + 1]] for i in range(J)]
    if robot.coupling is None:
        _fill(blocks, felt.kinds, robot, gravity, (q, qd, qdd))
    else:
        Y[:] = 0.0
        _fill(blocks, felt.kinds, robot, gravity, (q, qd, qdd))
        Y[:, :W] = np.tensordot(robot.share_of_motors, Y[:, :W], 1)
    first = ends[robot.innermost] if robot.coupling is not None else ends
    Y[:, W], Y[:, W + 1], Y[:, W + 2] = direction.T, qd.T, qdd.T
    return [Y[j, first[j] : first[j] + len(felt.places[j])].T for j in range(J)]


def _fill(blocks: Sequence[Array], kinds: Sequence[Sequence[int]], robot: Robot, gravity: Array, state: tuple[Array, Array, Array]) -> None:
    """Fill each link's block (i + 1, K, N): the torque of these of its ten inertial parameters on each axis inward of it.

    gravity : as in `felt_under`. state : q, q̇, q̈ as for `regressor`. Raises BadInput where the shapes do not fit the robot.
    """
    J, (q, qd, qdd) = robot.joints, state
    if q.ndim != 2 or q.shape[1] != J or qd.shape != q.shape or qdd.shape != q.shape:
        raise BadInput(f"{robot.name}: q, q̇, q̈ are {q.shape}, {qd.shape}, {qdd.shape}; expected (samples, {J}) for each")
    q, qd, qdd = (robot.joints_of(x) for x in (q, qd, qdd))
    N = len(q)
    angle = q.T + robot.zero_rad[:, None]  # (J, N)
    cos, sin = np.cos(angle), np.sin(angle)  # (J, N)
    speed, acceleration = np.ascontiguousarray(qd.T), np.ascontiguousarray(qdd.T)  # (J, N)

    # Newton–Euler outward. The base accelerates upward, which has the effect of gravity.
    link = np.zeros((3, 3, N))  # (xyz, [ω, ω̇, a], N) in the present frame
    link[:, 2] = -gravity
    # axes of joints 1…J and their moment arms (axis × vector from the axis to the origin), in the present frame
    screw = np.zeros((3, 2, J, N))  # (xyz, [axis, arm], J, N)
    scratch = np.empty((J, N))
    for i in range(J):
        v, w, dw, a = speed[i], link[:, 0], link[:, 1], link[:, 2]
        dw[0] += w[1] * v
        dw[1] -= w[0] * v
        dw[2] += acceleration[i]  # ω̇ + z q̈ + ω × z q̇
        w[2] += v
        screw[2, 0, i] = 1.0

        ca, sa = (0.0 if abs(x) < ROUNDING else x for x in (math.cos(robot.alpha_rad[i]), math.sin(robot.alpha_rad[i])))
        seen = screw[:, :, : i + 1]  # (3, 2, i + 1, N)
        for vectors in (link, seen):
            _into_next(vectors, cos[i], sin[i], ca, sa)
        y, d = robot.y_m[i], robot.d_m[i]
        to_here = np.array([robot.a_m[i], ca * y + sa * d, ca * d - sa * y])  # origin i−1 → i, fixed in frame i
        turning = _turning(w, dw)  # (3, 3, N)
        for k, length in enumerate(to_here):
            if length != 0.0:
                a += turning[:, k] * length
                _add_cross(seen[:, 1], seen[:, 0], k, length)
        _link_block(blocks[i], kinds[i], seen, link, turning, scratch[: i + 1])


def _into_next(v: Array, c: Array, s: Array, ca: float, sa: float) -> None:
    """Vectors (3, …, N) given in frame i−1 → their components in frame i, in place: (Rot(z, q)·Rot(x, α))ᵀ v."""
    x, y, z = v
    across = c * y
    across -= s * x
    x *= c
    y *= s
    x += y
    if ca == 0.0:  # axes at right angles, which is the usual case
        np.multiply(z, sa, out=y)
        np.multiply(across, -sa, out=z)
    elif sa == 0.0:
        np.multiply(across, ca, out=y)
        z *= ca
    else:
        np.multiply(across, ca, out=y)
        y += sa * z
        z *= ca
        across *= sa
        z -= across


def _turning(w: Array, dw: Array) -> Array:
    """(3, 3, N) S(ω̇) + S(ω)²: the acceleration that a point of the link has per metre from the origin. ω, ω̇ : (3, N)."""
    turning = w[:, None] * w[None]  # ωωᵀ
    squares = [turning[k, k].copy() for k in range(3)]
    for k in range(3):
        row, column = (k + 1) % 3, (k + 2) % 3
        turning[k, k] = -(squares[row] + squares[column])
        turning[row, column] -= dw[k]
        turning[column, row] += dw[k]
    return turning


def _add_cross(total: Array, v: Array, k: int, length: float) -> None:
    """Add v × (length along axis k) to the total, both (3, …, N)."""
    row, column = (k + 1) % 3, (k + 2) % 3
    total[row] += v[column] * length  # e.g. v × x = (0, v_z, −v_y)
    total[column] -= v[row] * length


def _link_block(block: Array, kinds: Sequence[int], screw: Array, link: Array, turning: Array, scratch: Array) -> None:
    """Fill (i, K, N): the torque of these of one link's ten inertial parameters on each axis inward of it.

    The link's force is f = m·a + (S(ω̇) + S(ω)²)·mc, and its moment n = mc × a + Jω̇ + ω × Jω at its DH origin. The torque on an axis is
    z·n + (z × r)·f. screw : (3, [axis, arm], i, N); link : (3, [ω, ω̇, a], N); turning : (3, 3, N); scratch : (i, N).
    """
    axis, arm, a = screw[:, 0], screw[:, 1], link[:, 2]
    masses, ends = np.searchsorted(kinds, (1, 4))  # places of m, of the first moments, of the inertias
    if masses:
        np.einsum("cin,cn->in", arm, a, out=block[:, 0])
    if ends > masses:
        chosen = [kind - 1 for kind in kinds[masses:ends]]
        np.einsum("cin,ckn->ikn", arm, turning[:, chosen] if len(chosen) < 3 else turning, out=block[:, masses:ends])
    for place, kind in enumerate(kinds[masses:ends], masses):
        into, row, column = block[:, place], kind % 3, (kind + 1) % 3  # z·(mc × a) = mc·(a × z)
        into += np.multiply(a[row], axis[column], out=scratch)
        into -= np.multiply(a[column], axis[row], out=scratch)
    if ends < len(kinds):
        moment = _moment(link[:, 0], link[:, 1], [kind - 4 for kind in kinds[ends:]])
        np.einsum("cin,ckn->ikn", axis, moment, out=block[:, ends:])


def _moment(w: Array, dw: Array, kinds: Sequence[int]) -> Array:
    """(3, K, N): Jω̇ + ω × Jω by these of Jxx, Jxy, Jxz, Jyy, Jyz, Jzz, numbered from 0. ω, ω̇ : (3, N)."""
    x, y, z = w
    dx, dy, dz = dw
    xy, xz, yz = x * y, x * z, y * z
    moment = np.empty((3, len(kinds), len(x)))
    for place, kind in enumerate(kinds):
        a, b, c = moment[:, place]
        if kind == 0:
            a[:], b[:] = dx, xz
            np.negative(xy, out=c)
        elif kind == 1:
            np.subtract(dy, xz, out=a)
            np.add(dx, yz, out=b)
            np.subtract(x * x, y * y, out=c)
        elif kind == 2:
            np.add(dz, xy, out=a)
            np.subtract(z * z, x * x, out=b)
            np.subtract(dx, yz, out=c)
        elif kind == 3:
            np.negative(yz, out=a)
            b[:], c[:] = dy, xy
        elif kind == 4:
            np.subtract(y * y, z * z, out=a)
            np.subtract(dz, xy, out=b)
            np.add(dy, xz, out=c)
        else:
            a[:], c[:] = yz, dz
            np.negative(xz, out=b)
    return moment
