"""The arm as capsules, slightly larger than it is, in its Denavit–Hartenberg frames.

Every link is one to three cylinders: the housings of its joints and the tube between them. A capsule of 1.1 times the radius, with an axis
shortened to match, holds the whole cylinder with its edges. A housing that turns about its own axis is fixed to the link before it: its
space does not change by that turn, and the pairs that are checked remain those that can change.

Sources of the figures. The offsets along the shoulder and elbow axes are `offsets` in the manufacturer's physical_parameters.yaml
(Universal_Robots_ROS2_Description, BSD-3-Clause). The radii were measured on the manufacturer's collision meshes of UR3, UR5 and UR10,
where they depend on the size of the joint alone (size 0 to 4: 32, 39, 46, 60, 76 mm), plus `SLACK_M`. The same meshes gave how far a
housing reaches along its axis, in radii of its joint. With these figures the capsules hold every point of those meshes. The e-Series has
the same sizes of joints and gets their radii, with twice the slack. UR20 and UR30 were not measured: their radii are extrapolated by the
fourth root of the torque limit, which fits sizes 0 to 4 to 4 %, and rounded up. Cables, dress packs and hooks for the pendant are not
included.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from monitor.errors import BadInput
from monitor.model.robot import Robot, load_robot
from monitor.recording import Array, Indices

SLACK_M = 0.003  # so that the capsules hold every point of the meshes that were measured
FATTER = 1.1  # a capsule's radius over its cylinder's: a larger one needs more room at the side, a smaller one beyond the ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """The dimensions of one model's capsules [m]."""

    base: float  # radius of the foot
    connector: float  # reach of the foot's cable outlet along y of the base
    shoulder: float  # radius of joints 1 and 2
    elbow: float  # radius of joint 3
    wrist: float  # radius of joints 4, 5, 6
    upper_arm: float  # radius of the tube
    forearm: float
    shoulder_offset: float  # along joint 2's axis, to the middle of the upper arm
    elbow_offset: float  # along joint 3's axis, to the middle of the forearm
    slack: float = SLACK_M


def _of_joints(joints: tuple[float, float, float], foot: tuple[float, float], offsets: tuple[float, float], slack: float) -> Sizes:
    """The sizes of a model by the radii of its joints (shoulder, elbow, wrist), its foot (radius, connector) and its offsets [m]."""
    shoulder, elbow, wrist = joints
    return Sizes(
        base=foot[0], connector=foot[1], shoulder=shoulder, elbow=elbow, wrist=wrist,
        upper_arm=max(elbow, 0.92 * shoulder), forearm=1.12 * wrist,
        shoulder_offset=offsets[0], elbow_offset=offsets[1], slack=slack,
    )  # fmt: skip


_SIZE = (0.0323, 0.0390, 0.0460, 0.0600, 0.0756)  # radius of a joint by its size [m]
# radii of shoulder, elbow and wrist, by the sizes of joints that the models are built of
_SMALL = (_SIZE[2], _SIZE[1], _SIZE[0])
_MIDDLE = (_SIZE[3], _SIZE[3], _SIZE[1])
_LARGE = (_SIZE[4], _SIZE[3], _SIZE[2])
_LARGEST = (0.100, 0.086, 0.060)  # [m] of joints with 738, 433 and 107 N·m
SIZES = {
    "ur3": _of_joints(_SMALL, (0.064, 0.100), (0.1198, 0.0275), SLACK_M),
    "ur5": _of_joints(_MIDDLE, (0.0745, 0.110), (0.13585, 0.0165), SLACK_M),
    "ur10": _of_joints(_LARGE, (0.095, 0.110), (0.1755, 0.049042), SLACK_M),  # the published 0.220941 is not the middle of its mesh
    "ur3e": _of_joints(_SMALL, (0.064, 0.100), (0.120, 0.027), 2 * SLACK_M),
    "ur5e": _of_joints(_MIDDLE, (0.0745, 0.110), (0.138, 0.007), 2 * SLACK_M),
    "ur10e": _of_joints(_LARGE, (0.095, 0.110), (0.1762, 0.0393), 2 * SLACK_M),
    "ur16e": _of_joints(_LARGE, (0.095, 0.110), (0.176, 0.040), 2 * SLACK_M),
    "ur20": _of_joints(_LARGEST, (0.1225, 0.140), (0.260, 0.043), 2 * SLACK_M),
    "ur30": _of_joints(_LARGEST, (0.1225, 0.140), (0.260, 0.043), 2 * SLACK_M),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Capsules:
    """C capsules, each fixed to one DH frame; frame 0 is the base, which does not move."""

    names: tuple[str, ...]  # C
    link: Indices  # (C,) the frame that it is fixed to
    ends_m: Array  # (C, 2, 3) ends of its axis, in that frame
    radius_m: Array  # (C,)

    @property
    def reach_m(self) -> Array:
        """(C,) distance of its farthest point from the origin of its frame."""
        reach: Array = np.max(np.linalg.norm(self.ends_m, axis=2), axis=1) + self.radius_m
        return reach

    def joined(self, other: "Capsules") -> "Capsules":
        """The capsules of both."""
        return Capsules(
            names=self.names + other.names,
            link=np.concatenate([self.link, other.link]),
            ends_m=np.concatenate([self.ends_m, other.ends_m]),
            radius_m=np.concatenate([self.radius_m, other.radius_m]),
        )


def around_cylinder(start: Array, end: Array, radius: float) -> tuple[Array, Array, float]:
    """Axis ends (3,), (3,) and radius of the capsule that holds the cylinder from start to end (3,) with its flat ends."""
    length = float(np.linalg.norm(end - start))
    inset = radius * math.sqrt(FATTER**2 - 1.0)
    if length <= 2.0 * inset:  # a disc is held by a ball about its middle
        middle = 0.5 * (start + end)
        return middle, middle, math.hypot(radius, 0.5 * length)
    step = inset / length * (end - start)
    return start + step, end - step, FATTER * radius


def sizes_of(robot: Robot) -> Sizes:
    """The dimensions of a model's capsules. Raises BadInput for a robot whose shape is not known."""
    if robot.name not in SIZES:
        raise BadInput(f"robot {robot.name!r}: no shapes are known for its collision check; known are {', '.join(sorted(SIZES))}")
    return SIZES[robot.name]


class Cylinder(NamedTuple):
    """One part of a link: a solid cylinder with flat ends."""

    name: str
    link: int  # the DH frame that it is fixed to
    start_m: Array  # (3,) one end of its axis, in that frame
    end_m: Array
    radius_m: float


def arm_cylinders(robot: Robot) -> tuple[Cylinder, ...]:
    """The cylinders that stand for a UR model, without slack.

    Raises BadInput for a robot whose shape is not known.
    """
    s = sizes_of(robot)
    R, E, W = s.shoulder, s.elbow, s.wrist
    d1, d4 = float(robot.d_m[0]), float(robot.d_m[3])
    upper, fore = -float(robot.a_m[1]), -float(robot.a_m[2])
    top = s.shoulder_offset + 1.27 * R  # end of the upper arm, along joint 2's axis
    between = s.elbow_offset + 0.9 * E  # between upper arm and forearm, along joint 3's axis
    x, y, z = np.eye(3)
    # name, frame, from, to, radius; the factors beside the radii are those that the meshes need
    parts = [
        ("foot", 0, -0.003 * z, max(0.03, d1 - 1.05 * R) * z, s.base),
        ("connector", 0, 0.018 * z, 0.018 * z + s.connector * y, 0.024),
        ("shoulder", 1, -(R + 0.02) * y, (R + 0.014) * y, R),
        ("shoulder motor", 1, -R * z, 1.2 * R * z, R),
        ("upper arm at the shoulder", 1, 1.12 * R * z, top * z, R),
        ("upper arm", 2, (upper - 0.5 * R) * x + s.shoulder_offset * z, s.shoulder_offset * z, s.upper_arm),
        ("upper arm at the elbow", 2, between * z, top * z, E),
        ("elbow", 2, (s.elbow_offset - 1.15 * E) * z, (s.elbow_offset + 1.35 * E) * z, E),
        ("forearm", 3, fore * x + s.elbow_offset * z, s.elbow_offset * z, s.forearm),
        ("forearm at the wrist", 3, (s.elbow_offset - 1.48 * W) * z, (d4 - 1.17 * W) * z, W),
        ("wrist 1 along joint 4", 4, -1.45 * W * y, W * y, W),
        ("wrist 1 along joint 5", 4, -1.5 * W * z, 1.36 * W * z, W),
        ("wrist 2 along joint 5", 5, -W * y, 1.46 * W * y, W),
        ("wrist 2 along joint 6", 5, -1.5 * W * z, 1.36 * W * z, W),
        ("wrist 3", 6, -1.3 * W * z, 0.0 * z, 1.05 * W),
    ]
    return tuple(Cylinder(*part) for part in parts)


@lru_cache
def arm_capsules(robot_name: str) -> Capsules:
    """The capsules of one UR model.

    Raises BadInput for a robot whose shape is not known.
    """
    robot = load_robot(robot_name)
    cylinders = arm_cylinders(robot)
    made = [around_cylinder(part.start_m, part.end_m, part.radius_m) for part in cylinders]
    return Capsules(
        names=tuple(part.name for part in cylinders),
        link=np.array([part.link for part in cylinders]),
        ends_m=np.array([(start, end) for start, end, _ in made]),
        radius_m=np.array([radius for *_, radius in made]) + sizes_of(robot).slack,
    )
