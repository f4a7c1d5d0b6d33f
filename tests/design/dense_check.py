"""The independent check of clearance: frames by pinocchio, distances by coal.

By default the arm is the same union of capsules; `exact` takes the cylinders with flat ends that they were drawn around. A tool's box is
a box. The pairs that may meet follow from a rule here, not from the code under test.
"""

from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from monitor.design.cell import Cell, rotation
from monitor.design.shapes import arm_capsules, arm_cylinders
from monitor.model.robot import Mounting, Robot


class Gaps(NamedTuple):
    """As monitor.design.clearance.Gaps."""

    to_itself_m: np.ndarray
    to_cell_m: np.ndarray


class Judge:
    """A GeometryModel of one arm in one cell."""

    def __init__(self, robot: Robot, mounting: Mounting, cell: Cell, *, exact: bool) -> None:
        self.model = robot.pinocchio_model(mounting)
        self.data = self.model.createData()
        self.geometry = pin.GeometryModel()
        self.arm: list[tuple[int, int, bool]] = []  # geometry, link, is it the tool
        capsules = arm_capsules(robot.name)
        parts = [
            (int(link), p, q, float(radius)) for link, (p, q), radius in zip(capsules.link, capsules.ends_m, capsules.radius_m, strict=True)
        ]
        if exact:
            parts = [(part.link, part.start_m, part.end_m, part.radius_m) for part in arm_cylinders(robot)]
        for link, p, q, radius in parts:
            joint, to_link = self._parent(link, robot)
            length = float(np.linalg.norm(q - p))
            shape = coal.Cylinder(radius, length) if exact else coal.Capsule(radius, length)
            self._add(joint, to_link * _along(p, q), shape, link, tool=False)
        tool = cell.tool
        joint, to_link = self._parent(6, robot)
        if tool.shape == "capsule":
            p, q = np.array(tool.start_m), np.array(tool.end_m)
            self._add(joint, to_link * _along(p, q), coal.Capsule(tool.radius_m, float(np.linalg.norm(q - p))), 6, tool=True)
        elif tool.shape == "box":
            place = pin.SE3(rotation(tool.rpy_deg), np.array(tool.centre_m))
            self._add(joint, to_link * place, coal.Box(*tool.size_m), 6, tool=True)
        self.things: list[tuple[int, bool]] = []  # geometry, is it square to joint 1
        world = pin.SE3(mounting.rotation.T, np.zeros(3))  # pinocchio's world is the base
        square = mounting.rotation[:, 2]
        for _, point, normal in cell.planes(mounting):
            # a half-space as coal has it: n·x ≤ d is solid
            n = mounting.rotation.T @ normal
            half = coal.Halfspace(n, float(normal @ point))
            self.things.append((self._add_world(half, pin.SE3.Identity()), bool(abs(normal @ square) > 1 - 1e-9)))
        for box in cell.boxes:
            place = world * pin.SE3(rotation(box.rpy_deg), np.array(box.centre_m))
            self.things.append((self._add_world(coal.Box(*box.size_m), place), False))
        self.self_pairs = [
            (a, b) for a, i, _ in self.arm for b, k, tool_b in self.arm if k - i >= 2 and ((i, k) not in {(3, 5), (4, 6)} or tool_b)
        ]
        self.cell_pairs = [(a, thing) for thing, is_square in self.things for a, i, _ in self.arm if i >= (2 if is_square else 1)]
        for a, b in (*self.self_pairs, *self.cell_pairs):
            self.geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.geometry_data = self.geometry.createData()

    def gaps(self, q: np.ndarray) -> Gaps:
        """(N,) least distances at q (N, J)."""
        found = np.empty((len(q), 2))
        first_of_cell = len(self.self_pairs)
        for n, pose in enumerate(q):
            pin.computeDistances(self.model, self.data, self.geometry, self.geometry_data, pose)
            distances = np.array([result.min_distance for result in self.geometry_data.distanceResults])
            found[n] = distances[:first_of_cell].min(), distances[first_of_cell:].min() if self.cell_pairs else np.inf
        return Gaps(found[:, 0], found[:, 1])

    def collides(self, q: np.ndarray) -> bool:
        """Whether any two bodies touch at any of q (N, J)."""
        return any(pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, pose, True) for pose in q)

    def _parent(self, link: int, robot: Robot) -> tuple[int, pin.SE3]:
        if link == 0:
            return 0, pin.SE3(robot.base_rotation, np.zeros(3))
        frame = self.model.frames[self.model.getFrameId(f"dh_{link}")]
        return frame.parentJoint, frame.placement

    def _add(self, joint: int, place: pin.SE3, shape: object, link: int, *, tool: bool) -> None:
        number = self.geometry.addGeometryObject(pin.GeometryObject(f"g{self.geometry.ngeoms}", joint, joint, place, shape))
        self.arm.append((number, link, tool))

    def _add_world(self, shape: object, place: pin.SE3) -> int:
        return self.geometry.addGeometryObject(pin.GeometryObject(f"g{self.geometry.ngeoms}", 0, 0, place, shape))


def judge(robot: Robot, mounting: Mounting, cell: Cell, *, exact: bool = False) -> Judge:
    """A new check. It shares only the published shapes and the cell with the code under test."""
    return Judge(robot, mounting, cell, exact=exact)


def _along(p: np.ndarray, q: np.ndarray) -> pin.SE3:
    length = float(np.linalg.norm(q - p))
    z = (q - p) / length if length > 0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return pin.SE3(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (p + q))
