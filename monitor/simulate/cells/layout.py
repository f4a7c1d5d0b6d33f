"""Where things stand in a cell, for an arm of any size: tool poses, joint positions and moves of a program."""

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics, pose_of
from monitor.simulate.controller.moves import Move

ELBOW_UP = (-1.7, 2.0, -1.87, -math.pi / 2, 0.0)  # joints 2 … 6 of an arm that reaches forward with its tool down: where searches begin
SCATTER_SHARE = 0.02  # a cell of another seed stands elsewhere by this share of the reach
DECLARED_SHARE, DECLARED_M = 0.02, 0.003  # a person declares a mass and its centre with these standard deviations

Pose = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How fast a program moves at full speed: joints [rad/s, rad/s²] and lines of the tool [m/s, m/s²]."""

    joints: float = 1.6
    joints_2: float = 2.6
    lines: float = 0.5
    lines_2: float = 1.6


@dataclass(kw_only=True, eq=False)  # without slots: what __post_init__ prepares is no field
class Layout:
    """Places of one cell. Lengths are shares of the arm's reach, angles are in degrees; the seed moves the places a little."""

    robot: Robot
    tcp_m: float  # from the flange to the tool's point, along the flange's z
    seed: int
    pace: Pace = field(default_factory=Pace)
    _known: dict[Pose, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Prepare the kinematics with the tool."""
        self.kinematics = Kinematics(self.robot)
        self.kinematics.tool = np.array([0.0, 0.0, self.tcp_m, 0.0, 0.0, 0.0])
        self.reach_m = float(np.abs(self.robot.a_m).sum())
        self.dice = np.random.default_rng([self.seed, 25])

    def place(self, radius: float, azimuth: float, height: float, *, turn: float = 0.0, tilt: float = 0.0) -> Pose:
        """The pose of a tool that points down at a place around the base; `turn` is about its axis, `tilt` away from the vertical."""
        scatter = SCATTER_SHARE * self.dice.standard_normal(3)
        a, r = math.radians(azimuth) + float(scatter[0]), (radius + float(scatter[1])) * self.reach_m
        return self.exact((r * math.cos(a), r * math.sin(a), (height + float(scatter[2])) * self.reach_m), azimuth, turn=turn, tilt=tilt)

    def exact(self, xyz_m: tuple[float, float, float], azimuth: float, *, turn: float = 0.0, tilt: float = 0.0) -> Pose:
        """The pose of a tool at a point [m] of the base."""
        down = pin.utils.rotate("z", math.radians(azimuth)) @ pin.utils.rotate("y", math.pi - math.radians(tilt))
        rotation = down @ pin.utils.rotate("z", math.radians(turn))
        x, y, z, rx, ry, rz = pose_of(pin.SE3(rotation, np.array(xyz_m))).tolist()
        return x, y, z, rx, ry, rz

    @staticmethod
    def shifted(pose: Pose, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> Pose:
        """The same pose elsewhere, along the base's axes."""
        return pose[0] + x_m, pose[1] + y_m, pose[2] + z_m, *pose[3:]

    def up(self, pose: Pose, share: float = 0.15) -> Pose:
        """The pose above."""
        return self.shifted(pose, z_m=share * self.reach_m)

    def q(self, pose: Pose) -> Array:
        """(6,) joint positions of a pose, elbow up. Raises BadInput where the arm does not reach it."""
        if pose not in self._known:
            near = np.array([math.atan2(pose[1], pose[0]) + math.pi, *ELBOW_UP])
            near[0] = math.remainder(near[0], 2.0 * math.pi)
            found = self.kinematics.inverse(pin.SE3(pin.exp3(np.array(pose[3:])), np.array(pose[:3])), near)
            if found is None:
                raise BadInput(f"cell: a {self.robot.name} does not reach {np.round(pose, 3).tolist()}")
            self._known[pose] = found
        return self._known[pose]

    def to(self, pose: Pose, *, blend_m: float = 0.0) -> Move:
        """A movej to a pose."""
        target = tuple(self.q(pose).tolist())
        return Move(target, pose=False, straight=False, speed=self.pace.joints, acceleration=self.pace.joints_2, blend_m=blend_m)

    def along(self, pose: Pose, *, blend_m: float = 0.0, speed_m_s: float | None = None) -> Move:
        """A movel to a pose."""
        speed = self.pace.lines if speed_m_s is None else speed_m_s
        return Move(pose, pose=True, straight=True, speed=speed, acceleration=self.pace.lines_2, blend_m=blend_m)


@dataclass(frozen=True, slots=True)
class Mass:
    """A mass at the flange: [kg], and its centre in the frame of the flange [m]."""

    kg: float
    com_m: tuple[float, float, float]

    def with_(self, other: "Mass") -> "Mass":
        """Both together."""
        kg = self.kg + other.kg
        if kg <= 0.0:
            return Mass(0.0, self.com_m)
        x, y, z = ((self.kg * a + other.kg * b) / kg for a, b in zip(self.com_m, other.com_m, strict=True))
        return Mass(kg, (x, y, z))

    def declared(self, dice: np.random.Generator) -> tuple[float, ...]:
        """The figures of a set_payload as a person enters them, who weighed and measured: mass and centre."""
        kg = max(self.kg * (1.0 + DECLARED_SHARE * float(dice.standard_normal())), 0.0)
        return round(kg, 2), *(round(m + DECLARED_M * float(dice.standard_normal()), 3) for m in self.com_m)
