"""Where things stand in a cell, for an arm of any size: tool poses, joint positions and moves of a program."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from monitor.errors import BadInput
from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.kinematics import Kinematics, pose_of
from monitor.simulate.machine.machine import Machine
from monitor.simulate.machine.moves import Move

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


# --- What acts on the arm of a cell: parts that are gripped, surfaces, parts that stick, people, stops ---

BORE_M = 0.02  # radius within which a tool is in a bore


@dataclass(slots=True, kw_only=True, eq=False)
class Tool:
    """The tool's point as it is now."""

    at_m: Array  # (3,) in the frame of the base
    toward: Array  # (3,) direction of its motion, of length 1 or, where it creeps, less


class Thing:
    """Something in a cell. It acts as a force at the tool's point, as a torque on the joints, or by what it does to the machine."""

    def step(self, machine: Machine, tool: Tool) -> bool:  # noqa: ARG002 - the signature of what overrides it
        """Look at the arm once in a control period. Returns whether it presses on the arm."""
        return False

    def force_n(self, at_m: Array) -> Array:  # noqa: ARG002
        """(3,) force on the tool's point at this place, along the axes of the base."""
        return np.zeros(3)

    def torque_nm(self, joints: int) -> Array:
        """(J,) torque on the joints that no force at the tool explains."""
        return np.zeros(joints)


@dataclass(slots=True, kw_only=True, eq=False)
class Grip(Thing):
    """A part, or a tool of a tool changer, that the arm carries while an output is on."""

    output: int
    mass: Mass


@dataclass(slots=True, kw_only=True, eq=False)
class Surface(Thing):
    """An elastic plane: it pushes the tool's point along its normal, and rubs against its motion."""

    point_m: tuple[float, float, float]
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    stiffness_n_m: float = 30_000.0
    friction: float = 0.3
    wave_m: float = 0.0  # height of its unevenness, over 0.15 m
    _toward: Array = field(default_factory=lambda: np.zeros(3))

    def step(self, machine: Machine, tool: Tool) -> bool:  # noqa: ARG002
        """Whether the tool is in the surface."""
        self._toward = tool.toward
        return self._depth_m(tool.at_m) > -0.002

    def _depth_m(self, at_m: Array) -> float:
        away = at_m - np.array(self.point_m)
        wave = self.wave_m * math.sin(2.0 * math.pi * float(away[0] + away[1]) / 0.15)
        return wave - float(away @ np.array(self.normal))

    def force_n(self, at_m: Array) -> Array:
        """Elastic push and friction."""
        push = self.stiffness_n_m * max(self._depth_m(at_m), 0.0)
        result: Array = push * np.array(self.normal) - self.friction * push * self._toward
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Bore(Thing):
    """A tight bore that goes down from its mouth: it rubs on what moves in it, both ways."""

    mouth_m: tuple[float, float, float]
    friction_n: float
    _toward: Array = field(default_factory=lambda: np.zeros(3))

    def step(self, machine: Machine, tool: Tool) -> bool:  # noqa: ARG002
        """Whether the tool is in the bore."""
        self._toward = tool.toward
        x, y, z = (tool.at_m - np.array(self.mouth_m)).tolist()
        return z < 0.0 and math.hypot(x, y) < BORE_M

    def force_n(self, at_m: Array) -> Array:  # noqa: ARG002
        """Friction against the motion."""
        result: Array = -self.friction_n * self._toward
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Sticking(Thing):
    """A part that sticks in its seat when it is pulled out: a spring from where it was gripped, until it breaks away."""

    output: int
    breaks_n: float
    stiffness_n_m: float = 4000.0
    every: int = 1  # so many grips apart
    _grips: int = 0
    _on: bool = False
    _anchor: Array | None = None

    def step(self, machine: Machine, tool: Tool) -> bool:
        """Whether the part holds the tool back."""
        on = bool(machine.registers.outputs.digital >> self.output & 1)
        if on and not self._on:
            self._grips += 1
            self._anchor = tool.at_m.copy() if self._grips % self.every == 0 else None
        self._on = on
        if not on or (self._anchor is not None and np.linalg.norm(self.force_n(tool.at_m)) > self.breaks_n):
            self._anchor = None
        return self._anchor is not None

    def force_n(self, at_m: Array) -> Array:
        """The pull of the spring."""
        if self._anchor is None:
            return np.zeros(3)
        result: Array = self.stiffness_n_m * (self._anchor - at_m)
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Leaning(Thing):
    """Somebody leans on the arm, or a hose pulls at it, again and again: a torque on one joint for a time."""

    joint: int  # 0 … J−1
    torque_nm_on_joint: float
    first_s: float
    seconds: float
    every_s: float
    _now: bool = False

    def step(self, machine: Machine, tool: Tool) -> bool:  # noqa: ARG002
        """Whether it presses now."""
        since_s = machine.clock.now_s - self.first_s
        self._now = since_s >= 0.0 and since_s % self.every_s < self.seconds
        return self._now

    def torque_nm(self, joints: int) -> Array:
        """The torque on its joint."""
        result = np.zeros(joints)
        if self._now:
            result[self.joint] = self.torque_nm_on_joint
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Hand(Thing):
    """A hand that leads the arm in freedrive: it pulls the tool's point like a spring along a few places, and lets go."""

    ways_m: Sequence[tuple[float, float, float]]
    seconds_each: float = 3.0
    stiffness_n_m: float = 1500.0
    force_max_n: float = 120.0
    _since_s: float | None = None
    _from: Array = field(default_factory=lambda: np.zeros(3))
    _target: Array = field(default_factory=lambda: np.zeros(3))

    def step(self, machine: Machine, tool: Tool) -> bool:
        """Whether the hand pulls."""
        if not machine.compliance.freedrive:
            self._since_s = None
            return False
        now_s = machine.clock.now_s
        if self._since_s is None:
            self._since_s, self._from = now_s, tool.at_m.copy()
        share = (now_s - self._since_s) / self.seconds_each
        points = [np.zeros(3), *map(np.array, self.ways_m)]
        i = min(int(share), len(points) - 1)
        ahead = points[min(i + 1, len(points) - 1)]
        self._target = self._from + points[i] + min(share - i, 1.0) * (ahead - points[i])
        return True

    def force_n(self, at_m: Array) -> Array:
        """The pull of the hand."""
        pull = self.stiffness_n_m * (self._target - at_m)
        result: Array = pull * min(1.0, self.force_max_n / max(float(np.linalg.norm(pull)), 1e-9))
        return result


@dataclass(slots=True, kw_only=True, eq=False)
class Stopping(Thing):
    """Protective stops, each acknowledged by a person after a time, who lets the program go on."""

    first_s: float
    every_s: float
    seconds: float = 8.0
    _next_s: float | None = None
    _stopped_s: float | None = None

    def step(self, machine: Machine, tool: Tool) -> bool:  # noqa: ARG002
        """Stop, or acknowledge."""
        now_s = machine.clock.now_s
        self._next_s = self.first_s if self._next_s is None else self._next_s
        if self._stopped_s is None and now_s >= self._next_s and machine.modes.unstopped:
            self._stopped_s, self._next_s = now_s, self._next_s + self.every_s
            machine.supervisor.protective_stop("something was in the way")
        elif self._stopped_s is not None and now_s - self._stopped_s >= self.seconds:
            self._stopped_s = None
            machine.supervisor.acknowledge()
        return False
