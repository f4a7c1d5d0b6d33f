"""Physically consistent parameters: positive masses, inertia tensors of real mass distributions, friction that opposes motion.

Base parameters hold all that torque reveals, but many sets of standard parameters have the same base parameters. This module chooses, among
the sets whose links are physically consistent, the one that fits best. A link is physically consistent where its pseudo-inertia
[Σ, mc; mcᵀ, m] is positive semidefinite: Wensing, Kim and Slotine (2018). Where torque determines no parameter, a weak prior keeps it near
the manufacturer's. The work is done on triangular factors, without the recordings.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.fit.fit import Fit
from monitor.identify.fit.least_squares import Factor, residual_rms
from monitor.model.base import Base
from monitor.model.regressor import COULOMB, ROTOR, VISCOUS
from monitor.model.robot import INERTIAL, PER_JOINT, Robot
from monitor.model.urdf import urdf_text
from monitor.recording import Array

_ENTRY = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # Jxx, Jxy, Jxz, Jyy, Jyz, Jzz
_UPPER = tuple((row, column) for column in range(4) for row in range(column + 1))  # Clarabel's order: the upper triangle by columns
PERFECT = 1e-3  # fraction of the torque: the least residual that is assumed, since a smaller one exceeds the solver's digits
UNKNOWN_WEIGHT = 0.01  # of the prior where the manufacturer gives no mass: enough to make the solution unique
MASS_FACTOR = (0.5, 2.0)  # bounds, as factors on the manufacturer's mass; torque alone does not bound the masses
UNKNOWN_MASS_KG = (0.01, 100.0)  # bounds where the manufacturer gives no mass
SPREAD_M = 0.005  # least radius of gyration of a link in every direction
PRIOR_WEIGHT = 1.0  # 1: a prior of about ±100 % on the manufacturer's figures, for residuals of unit size
UNKNOWN_LINK_KG = 5.0  # a link's typical mass, where the manufacturer gives none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhysicallyConsistentArm:
    """A physically consistent arm, and its residual beside that of the unconstrained fit."""

    parameters: Array  # (13·J,) standard parameters in DH frames
    extra: Array  # (E,) friction parameters after fc and fv, none negative
    values: Array  # (B + E,) base parameters and extra friction parameters that follow from these
    robot: Robot  # masses, centres of mass and inertias as identified
    residual_ratio: float  # weighted RMS residual / that of unconstrained least squares
    rms_nm: Array  # (J,) residual over the samples of the factors

    @property
    def coulomb_nm(self) -> Array:
        """(J,) fc of each joint [N·m]."""
        return self.parameters[COULOMB::PER_JOINT]

    @property
    def viscous_nm_s_per_rad(self) -> Array:
        """(J,) fv of each joint [N·m·s/rad]."""
        return self.parameters[VISCOUS::PER_JOINT]

    @property
    def rotor_kg_m2(self) -> Array:
        """(J,) rotor inertia at the joint; simulators call it armature."""
        return self.parameters[ROTOR::PER_JOINT]

    def urdf(self) -> str:
        """The arm as a URDF, with fc and fv. A URDF cannot hold rotor inertia."""
        return urdf_text(self.robot, self.coulomb_nm, self.viscous_nm_s_per_rad)

    def toml(self) -> str:
        """The arm with the keys of `monitor/model/robots/*.toml`; friction and rotor inertia are in a table `joints`."""
        return _toml(self)


def physically_consistent(
    joints: Sequence[Factor],
    weights: Array,
    combination: Array,
    robot: Robot,
) -> PhysicallyConsistentArm:
    """The physically consistent parameters with the smallest residual over the rows in the factors.

    weights : (J,) of each joint's rows, best one over its residual [1/(N·m)]. combination : (B, 13·J), base = combination · standard; or
    (B + E, 13·J + E) with E more friction parameters at the end, which stay non-negative as fc, fv and Im do.
    Raises BadInput where shapes do not fit or values are not finite, Unidentifiable where no arm is within the bounds or the solver fails.
    """
    P = PER_JOINT * robot.joints
    E = combination.shape[1] - P
    if E < 0 or combination.shape[0] != joints[0].R.shape[1] - 1 or len(weights) != robot.joints or len(joints) != robot.joints:
        raise BadInput(
            f"{robot.name}: {len(joints)} factors of {joints[0].R.shape[1] - 1} columns, weights {weights.shape} and combination "
            f"{combination.shape} do not fit; expected {robot.joints} factors, ({robot.joints},) and (columns, {P} or more)"
        )
    stacked = np.concatenate([weight * factor.R for weight, factor in zip(weights, joints, strict=True)])
    if not np.all(np.isfinite(stacked)):
        raise BadInput(f"{robot.name}: factors or weights are not finite; expected what least squares was solved with")
    R = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=float)  # (≤ B + 1, B + 1)
    A, b = R[:, :-1], R[:, -1]
    best = float(np.linalg.norm(b - A @ np.linalg.lstsq(A, b, rcond=None)[0]))
    samples = max(1, sum(factor.samples for factor in joints))
    # with residuals of unit size the prior has the same weight for every recording; a perfect fit must not have an infinite weight
    unit = max(best, PERFECT * float(np.linalg.norm(b)), 1e-12) / math.sqrt(samples)
    scale, prior = _scale(robot, E), np.append(robot.nominal_parameters(with_inertia=True), np.zeros(E))
    found = scale * _solve(A @ combination * (scale / unit), b / unit, prior / scale, scale, robot)

    values = combination @ found
    return PhysicallyConsistentArm(
        parameters=found[:P],
        extra=found[P:],
        values=values,
        robot=_with(robot, found[:P]),
        residual_ratio=float(np.linalg.norm(b - A @ values) / best) if best > 0.0 else 1.0,
        rms_nm=residual_rms(joints, values),
    )


def physical_fit(found: Fit, base: Base, robot: Robot) -> tuple[Fit, PhysicallyConsistentArm]:
    """The fit with the parameters of the physically consistent arm that is nearest to it, and that arm."""
    extra = found.joints[0].R.shape[1] - 1 - base.count
    physical = physically_consistent(found.joints, found.weights, scipy.linalg.block_diag(base.combination, np.eye(extra)), robot)
    return replace(found, solution=replace(found.solution, values=physical.values)), physical


def _scale(robot: Robot, extra: int) -> Array:
    """(13·J + E,) the typical size of each parameter on such an arm, for the scaling of the problem."""
    total = float(np.sum(robot.mass_kg))
    blocks = []
    for i, (mass, com, about_com, strongest) in enumerate(
        zip(robot.mass_kg, robot.com_m, robot.inertia_kg_m2, robot.max_torque_nm, strict=True)
    ):
        m = max(float(mass), 0.02 * total) if mass > 0.0 else UNKNOWN_LINK_KG
        link = float(np.linalg.norm([robot.a_m[i], robot.y_m[i], robot.d_m[i]]))
        length = max(0.05, link, float(np.linalg.norm(com)), math.sqrt(max(0.0, float(np.trace(about_com))) / m))
        friction = 0.05 * float(strongest) if math.isfinite(strongest) else 1.0
        rotor = 0.01 * float(strongest) if math.isfinite(strongest) else m * length**2
        blocks.append([m, *[m * length] * 3, *[m * length**2] * 6, friction, friction, rotor])
    return np.append(np.array(blocks).ravel(), np.ones(extra))


def _solve(A: Array, b: Array, prior: Array, scale: Array, robot: Robot) -> Array:
    """The scaled parameters x that minimise ‖A x − b‖² + w·‖(x − prior)‖², by Clarabel; w acts on links and rotors, not on friction.

    Raises Unidentifiable where the solver fails or finds no solution.
    """
    import clarabel  # only where this fit is asked for

    pull = np.zeros(len(prior))
    for i in range(robot.joints):
        weight = PRIOR_WEIGHT if robot.mass_kg[i] > 0.0 else UNKNOWN_WEIGHT * PRIOR_WEIGHT
        pull[[*range(PER_JOINT * i, PER_JOINT * i + INERTIAL), PER_JOINT * i + ROTOR]] = weight
    quadratic = 2.0 * (A.T @ A + np.diag(pull))
    linear = -2.0 * (A.T @ b + pull * prior)

    rows, bounds, cones = [], [], []
    free = np.flatnonzero(np.arange(len(prior)) >= PER_JOINT * robot.joints)
    positive = [PER_JOINT * i + kind for i in range(robot.joints) for kind in (COULOMB, VISCOUS, ROTOR)] + [int(k) for k in free]
    limits = _mass_bounds(robot)  # (J, 2)
    bound = np.zeros((len(positive) + 2 * robot.joints, len(prior)))
    at_most = np.zeros(len(bound))
    bound[np.arange(len(positive)), positive] = -1.0  # −x ≤ 0
    for i, (least, most) in enumerate(limits):
        column, row = PER_JOINT * i, len(positive) + 2 * i
        bound[row, column], at_most[row] = -1.0, -least / scale[column]
        bound[row + 1, column], at_most[row + 1] = 1.0, most / scale[column]
    rows.append(bound)
    bounds.append(at_most)
    cones.append(clarabel.NonnegativeConeT(len(bound)))
    for i in range(robot.joints):
        block = slice(PER_JOINT * i, PER_JOINT * i + INERTIAL)
        length = scale[PER_JOINT * i + 1] / scale[PER_JOINT * i]
        pseudo = _pseudo_inertia_map(scale[block], length) / scale[PER_JOINT * i]  # entries of order one
        least = limits[i, 0] * (SPREAD_M / length) ** 2 / scale[PER_JOINT * i]
        rows.append(np.zeros((len(_UPPER), len(prior))))
        rows[-1][:, block] = -pseudo
        bounds.append(np.array([-least if row == column < 3 else 0.0 for row, column in _UPPER]))
        cones.append(clarabel.PSDTriangleConeT(4))

    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1
    objective, constraints = scipy.sparse.csc_matrix(np.triu(quadratic)), scipy.sparse.csc_matrix(np.concatenate(rows))
    problem = (objective, linear, constraints, np.concatenate(bounds), cones, options)
    try:
        answer = clarabel.DefaultSolver(*problem).solve()
    except BaseException as wrong:  # an error inside the solver is a PanicException, which does not derive from Exception
        if type(wrong).__name__ != "PanicException":
            raise
        raise Unidentifiable(f"{robot.name}: the solver broke down ({wrong}); expected factors of a well-excited recording") from None
    if answer.status not in {clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved}:
        raise Unidentifiable(
            f"{robot.name}: no physical arm was found ({answer.status}); expected masses within {MASS_FACTOR[0]:g} to "
            f"{MASS_FACTOR[1]:g} of the manufacturer's: check robot, gains and mounting"
        )
    return np.asarray(answer.x, dtype=float)


def _mass_bounds(robot: Robot) -> Array:
    """(J, 2) least and largest mass [kg]. The last link may carry a tool or payload."""
    known = robot.mass_kg > 0.0
    bounds = np.where(known[:, None], np.multiply.outer(robot.mass_kg, MASS_FACTOR), UNKNOWN_MASS_KG)
    if math.isfinite(robot.payload_max_kg):
        bounds[-1, 1] += robot.payload_max_kg
    return bounds


def _pseudo_inertia_map(scale: Array, length: float) -> Array:
    """(10, 10) map from scaled m, mx … Jzz to the upper triangle of the pseudo-inertia, with lengths in units of `length`.

    Entries off the diagonal have the factor √2, so that the norm of the triangle is that of the matrix.
    """
    columns = []
    for k in range(INERTIAL):
        pseudo = np.zeros((4, 4))
        if k == 0:
            pseudo[3, 3] = 1.0
        elif k < 4:
            pseudo[k - 1, 3] = 1.0 / length
        else:
            row, column = _ENTRY[k - 4]
            J = np.zeros((3, 3))
            J[row, column] = J[column, row] = 1.0
            pseudo[:3, :3] = (0.5 * np.trace(J) * np.eye(3) - J) / length**2
        columns.append([pseudo[at] * (1.0 if at[0] == at[1] else math.sqrt(2.0)) for at in _UPPER])
    return np.array(columns).T * scale


def _with(robot: Robot, parameters: Array) -> Robot:
    """The robot with masses, centres of mass, and tensors about these, from its standard parameters."""
    blocks = parameters.reshape(robot.joints, PER_JOINT)
    mass = blocks[:, 0]
    com = blocks[:, 1:4] / mass[:, None]
    tensor = np.empty((robot.joints, 3, 3))
    for k, (row, column) in enumerate(_ENTRY):
        tensor[:, row, column] = tensor[:, column, row] = blocks[:, 4 + k]
    steiner = np.array([m * (c @ c * np.eye(3) - np.outer(c, c)) for m, c in zip(mass, com, strict=True)])
    return replace(robot, mass_kg=mass, com_m=com, inertia_kg_m2=tensor - steiner)


def _toml(found: PhysicallyConsistentArm) -> str:
    """The text of `PhysicallyConsistentArm.toml`."""
    import tomlkit  # only where this file is asked for

    robot = found.robot
    arm: dict[str, Any] = {
        "name": robot.name,
        "generation": robot.generation,
        "rate_hz": float(robot.rate_hz),
        "payload_max_kg": float(robot.payload_max_kg),
        "gear_ratio": robot.gear_ratio.tolist(),
        "torque_constant_nm_per_a": robot.torque_constant_nm_per_a.tolist(),
        "max_torque_nm": robot.max_torque_nm.tolist(),
        "max_speed_rad_s": robot.max_speed_rad_s.tolist(),
        "max_position_rad": robot.max_position_rad.tolist(),
        "base_rotation": robot.base_rotation.tolist(),
    }
    if robot.coupling is not None:
        arm |= {"coupling": robot.coupling.tolist(), "positions_at": "motors" if robot.recorded_at_motors else "joints"}
    geometry = {"a_m": robot.a_m, "d_m": robot.d_m, "alpha_rad": robot.alpha_rad, "zero_rad": robot.zero_rad, "y_m": robot.y_m}
    arm["link"] = [
        {
            "name": name,
            **{key: float(values[i]) for key, values in geometry.items()},
            "mass_kg": float(robot.mass_kg[i]),
            "com_m": robot.com_m[i].tolist(),
            "inertia_kg_m2": {f"{'xyz'[r]}{'xyz'[c]}": float(robot.inertia_kg_m2[i, r, c]) for r, c in _ENTRY},
        }
        for i, name in enumerate(robot.link_names)
    ]
    arm["joints"] = {
        "coulomb_nm": found.coulomb_nm.tolist(),
        "viscous_nm_s_per_rad": found.viscous_nm_s_per_rad.tolist(),
        "rotor_kg_m2": found.rotor_kg_m2.tolist(),
    }
    return (
        f"# {robot.name}: identified and physically consistent. Standard Denavit-Hartenberg frames, SI units, angles in radians.\n"
        "# Inertia tensors about the centre of mass, along the DH axes. nan: not known; inf: no limit known.\n"
        f"# joints: identified with the links; a simulator calls the rotor inertia armature.\n{tomlkit.dumps(arm)}"
    )
