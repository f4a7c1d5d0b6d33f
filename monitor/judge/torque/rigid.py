"""Torque of an arm's links and rotors by recursive Newton–Euler, from base parameters.

Rigid torque is linear in the inertial parameters, so pinocchio's recursive Newton–Euler computes it without the regressor. The base
parameters are a regrouped set and describe no physical arm: a link may have a first moment without a mass, while pinocchio stores a
centre of mass. Therefore every link gets a point mass at the origin of its frame, and the torque of the point masses alone is subtracted.
"""

from typing import TYPE_CHECKING

import numpy as np

from monitor.model.regressor import ROTOR
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, Robot
from monitor.recording import Array

if TYPE_CHECKING:
    import pinocchio

MIN_MASS_KG = 0.1  # of a link with its point mass: the centre of mass mx/m keeps its digits
POINT_MASSES_KG = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0, 2560.0)  # J ≤ 8 links can exclude eight of these


class RigidTorque:
    """Torque of links and rotors; immutable, shared by threads."""

    def __init__(self, robot: Robot, mounting: Mounting, columns: tuple[int, ...], values: Array) -> None:
        """Parameters `values` (R,) stand in these columns of the regressor; the others are 0."""
        import pinocchio as pin  # its import takes 0.2 s, so only a program that predicts torque pays for it

        J = robot.joints
        self._rnea = pin.rnea
        parameters = np.zeros(PER_JOINT * J)
        parameters[list(columns)] = values
        blocks = parameters.reshape(J, PER_JOINT)
        self.rotor = blocks[:, ROTOR]  # (J,) inertia of the rotors at the joints [kg·m²]
        masses = blocks[:, 0]
        point_mass = next(mass for mass in POINT_MASSES_KG if np.all(np.abs(masses + mass) >= MIN_MASS_KG))
        points = np.zeros((J, INERTIAL))
        points[:, 0] = point_mass
        self._arm, self._points = _pinocchio_arm(robot, mounting, blocks[:, :INERTIAL] + points), _pinocchio_arm(robot, mounting, points)
        self._data = self._arm.createData(), self._points.createData()

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """(N, J) [N·m] at states q, qd, qdd (N, J) [rad, rad/s, rad/s²]."""
        # pinocchio holds the interpreter's lock from the call until its result is copied: threads may share the workspace
        rnea, (arm_data, points_data) = self._rnea, self._data
        torque = np.empty_like(q)
        for n in range(len(q)):
            state = q[n], qd[n], qdd[n]
            torque[n] = rnea(self._arm, arm_data, *state)
            torque[n] -= rnea(self._points, points_data, *state)
        torque += qdd * self.rotor
        return torque


def _pinocchio_arm(robot: Robot, mounting: Mounting, blocks: Array) -> "pinocchio.Model":
    """Pinocchio's model with the inertial parameters `blocks` (J, 10), each about its link's DH origin in the axes of the DH frame."""
    import pinocchio as pin

    model = robot.pinocchio_model(mounting)
    for i, (m, mx, my, mz, xx, xy, xz, yy, yz, zz) in enumerate(blocks.tolist()):
        to_dh = model.frames[model.getFrameId(f"dh_{i + 1}")].placement
        about_dh = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz]))  # in pinocchio's order
        model.inertias[i + 1] = to_dh.act(about_dh)
    return model
