"""The controller's kinematics: tool poses, inverse kinematics and Jacobians, computed by pinocchio.

A pose is (6,): position [m] and rotation vector [rad] in the robot's base, as the manufacturer writes it.
"""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from monitor.model.robot import Robot
from monitor.recording import Array

POSITION_TOLERANCE_M, ANGLE_TOLERANCE_RAD = 1e-6, 1e-6
ITERATIONS = 60  # per attempt
DAMPING = 1e-8  # added to J·Jᵀ in the inverse kinematics, so that the iteration passes singularities
STEP_MAX_RAD = 0.5  # largest joint step of one iteration
RESTARTS = 6  # attempts from other joint positions, if the first attempt does not reach the pose
NO_TOOL = np.zeros(6)
BASE_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def se3(pose: Sequence[float] | Array) -> "pin.SE3":
    """The rigid motion of a pose (6,)."""
    vector = np.asarray(pose, dtype=float)
    return pin.SE3(pin.exp3(vector[3:]), vector[:3].copy())


def pose_of(motion: "pin.SE3") -> Array:
    """The pose (6,) of a rigid motion."""
    return np.concatenate([motion.translation, pin.log3(motion.rotation)])


def composed(first: Sequence[float] | Array, second: Sequence[float] | Array) -> Array:
    """One pose (6,) after another: pose_trans of URScript."""
    return pose_of(se3(first) * se3(second))


class Kinematics:
    """Kinematics of one arm with a tool at its flange. The frame is the robot's base; the mounting does not matter."""

    def __init__(self, robot: Robot) -> None:
        self._model = robot.pinocchio_model()
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(f"dh_{robot.joints}")
        self._limit = robot.max_position_rad
        self._joints = robot.joints
        self.tool = NO_TOOL
        placements = self._model.jointPlacements[1 : robot.joints + 1]
        lengths = [float(np.linalg.norm(placement.translation)) for placement in placements[1:]]
        self._shoulder = placements[0].translation.copy()
        self._reach = sum(lengths) + float(np.linalg.norm(self._model.frames[self._frame].placement.translation))

    def flange(self, q: Array) -> "pin.SE3":
        """The placement of the flange at joint positions (J,)."""
        pin.framesForwardKinematics(self._model, self._data, q)
        return self._data.oMf[self._frame].copy()

    def at(self, q: Array, tool: Array | None = None) -> "pin.SE3":
        """The placement of the tool at joint positions (J,): of the tool that is set, or of the given one (6,)."""
        offset = self.tool if tool is None else tool
        flange = self.flange(q)
        return flange * se3(offset) if offset.any() else flange

    def pose(self, q: Array, tool: Array | None = None) -> Array:
        """The pose (6,) of the tool at joint positions (J,)."""
        return pose_of(self.at(q, tool))

    def watch(self) -> "ToolWatch":
        """An object that computes pose and speed of the tool fast enough for every control period."""
        return ToolWatch(self, self._model, self._frame)

    def jacobian(self, q: Array) -> Array:
        """(6, J) Jacobian: q̇ to the velocity of the tool's point and its angular velocity, both along the axes of the base."""
        J = pin.computeFrameJacobian(self._model, self._data, q, self._frame, BASE_AXES)
        if self.tool.any():
            arm = self.at(q).translation - self.flange(q).translation
            J = J.copy()
            J[:3] -= pin.skew(arm) @ J[3:]
        result: Array = J
        return result

    def speed(self, q: Array, qd: Array) -> Array:
        """(6,) velocity [m/s] and angular velocity [rad/s] of the tool, along the axes of the base."""
        result: Array = self.jacobian(q) @ qd
        return result

    def elbow(self, q: Array) -> Array:
        """(3,) position of the elbow: where the axis of the third joint meets the upper arm [m]."""
        pin.forwardKinematics(self._model, self._data, q)
        place: Array = self._data.oMi[min(3, self._joints)].translation.copy()
        return place

    def elbow_speed(self, q: Array, qd: Array) -> Array:
        """(3,) velocity of the elbow [m/s]."""
        pin.forwardKinematics(self._model, self._data, q, qd)
        joint = min(3, self._joints)
        speed: Array = pin.getVelocity(self._model, self._data, joint, BASE_AXES).linear.copy()
        return speed

    def towards(self, q: Array, velocity: Array) -> Array:
        """(J,) joint speeds that give the tool this velocity (6,). They are damped near singularities."""
        J = self.jacobian(q)
        result: Array = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), velocity)
        return result

    def inverse(self, goal: "pin.SE3", near: Array, *, restarts: int = RESTARTS) -> Array | None:
        """(J,) joint positions within their ranges for a placement of the tool; None if none are found. The search begins at `near` (J,).

        The steps are damped least squares (Nakamura and Hanafusa, 1986) with a constant damping.
        """
        if not math.dist(goal.translation, self._shoulder) <= self._reach + math.hypot(*self.tool[:3]):
            return None  # out of reach; a search in vain would take as long as twenty control periods
        rng = np.random.default_rng(0)  # so that equal arguments give equal results
        for attempt in range(1 + restarts):
            q = near.copy() if attempt == 0 else near + rng.uniform(-1.5, 1.5, len(near))
            for _ in range(ITERATIONS):
                here = self.at(q)
                away = goal.translation - here.translation
                turn = goal.rotation @ here.rotation.T
                about = pin.log3(turn)
                if np.abs(away).max() < POSITION_TOLERANCE_M and np.abs(about).max() < ANGLE_TOLERANCE_RAD:
                    if (np.abs(q) <= self._limit).all():
                        return q
                    break
                J = self.jacobian(q)
                step = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), np.concatenate([away, about]))
                q = q + step * min(1.0, STEP_MAX_RAD / max(float(np.abs(step).max()), 1e-12))
        return None


class ToolWatch:
    """Computes what `Kinematics.pose` and `Kinematics.speed` return in one pass. The last result is kept for equal arguments."""

    def __init__(self, kinematics: Kinematics, model: "pin.Model", frame: int) -> None:
        self._kinematics, self._model, self._frame = kinematics, model, frame
        self._data = model.createData()
        self._q = self._qd = self._tool = self._known = np.empty(0)
        self.flange = pin.SE3.Identity()  # placement of the flange at the last call

    def at(self, q: Array, qd: Array) -> Array:
        """(12,) pose and velocity of the tool at q, q̇ (J,)."""
        tool = self._kinematics.tool
        if q is self._q and qd is self._qd and tool is self._tool:
            return self._known
        self._q, self._qd, self._tool = q, qd, tool
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, qd)
        flange = self.flange = pin.updateFramePlacement(model, data, self._frame)
        twist: Array = pin.getFrameVelocity(model, data, self._frame, BASE_AXES).vector
        if tool is not NO_TOOL:
            arm = flange.rotation @ tool[:3]
            twist = np.concatenate((twist[:3] + np.cross(twist[3:], arm), twist[3:]))
            flange = flange * se3(tool)
        known: Array = np.concatenate((flange.translation, pin.log3(flange.rotation), twist))
        self._known = known
        return known
