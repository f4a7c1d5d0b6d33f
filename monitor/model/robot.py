"""Robot: kinematics, masses, drives and limits of a serial arm, and how it is mounted.

Frames are standard Denavit–Hartenberg: frame i is fixed to link i, joint i turns about z of frame i−1, and
frame i−1 → i is Rot(z, qᵢ)·Trans(z, dᵢ)·Trans(x, aᵢ)·Rot(x, αᵢ). An arm of another source may need three more figures: the DH angle where
a joint reads zero, the attitude of frame 0 in the base, and an offset along y where two axes are nearly parallel, so that their common
normal is far away.
"""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from monitor.errors import BadInput
from monitor.recording import Array

if TYPE_CHECKING:
    import pinocchio

STANDARD_GRAVITY_M_S2 = 9.80665
MAX_LINKS = 8
INERTIAL = 10  # m, mx, my, mz, Jxx, Jxy, Jxz, Jyy, Jyz, Jzz
_UPPER = np.triu_indices(3)  # of a tensor, in the order of the ten
PER_JOINT = 13  # the ten inertial parameters, then fc, fv, Im (rotor inertia referred to the joint)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Attitude of the robot's base in the world: Rot(z, yaw)·Rot(y, pitch)·Rot(x, roll), Raviola et al. (2021), eq. (3)."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @classmethod
    def parse(cls, text: str) -> "Mounting":
        """The mounting in the text `ground`, `ceiling`, `wall`, or `ROLL,PITCH,YAW` in degrees.

        Raises BadInput for anything else.
        """
        known = {"ground": (0.0, 0.0, 0.0), "ceiling": (180.0, 0.0, 0.0), "wall": (90.0, 0.0, 0.0)}
        try:
            degrees = known[text] if text in known else tuple(float(part) for part in text.split(","))
        except ValueError:
            degrees = ()
        if len(degrees) != 3 or not all(math.isfinite(angle) for angle in degrees):
            raise BadInput(f"mounting {text!r}: expected ground, ceiling, wall or ROLL,PITCH,YAW in degrees, e.g. 90,0,0")
        return cls.of([math.radians(angle) for angle in degrees])

    @classmethod
    def of(cls, angles_rad: Sequence[float]) -> "Mounting":
        """The mounting with roll, pitch, yaw [rad]; the inverse of `angles_rad`."""
        roll, pitch, yaw = angles_rad
        return cls(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)

    @property
    def angles_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw [rad]."""
        return self.roll_rad, self.pitch_rad, self.yaw_rad

    @property
    def rotation(self) -> Array:
        """(3, 3) rotation from the base to the world."""
        cr, sr = math.cos(self.roll_rad), math.sin(self.roll_rad)
        cp, sp = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        cy, sy = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        rot_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        rot_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        rot_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        rotation: Array = rot_z @ rot_y @ rot_x
        return rotation

    @property
    def gravity_in_base(self) -> Array:
        """(3,) gravity [m/s²]. Components of the size of rounding are zero: g_y = 1e-15 would add two false base parameters."""
        gravity: Array = self.rotation.T @ np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2])
        return np.where(np.abs(gravity) < 1e-12 * STANDARD_GRAVITY_M_S2, 0.0, gravity)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Robot:
    """One arm as its manufacturer publishes it. A figure that is not published is NaN."""

    name: str
    generation: str  # "cb3" | "e-series"
    rate_hz: float  # controller's tick
    link_names: tuple[str, ...]  # J
    a_m: Array  # (J,)
    d_m: Array  # (J,)
    alpha_rad: Array  # (J,)
    mass_kg: Array  # (J,)
    com_m: Array  # (J, 3) in DH frame i
    inertia_kg_m2: Array  # (J, 3, 3) about the centre of mass, axes of DH frame i
    gear_ratio: Array  # (J,)
    torque_constant_nm_per_a: Array  # (J,) motor side
    max_torque_nm: Array  # (J,)
    max_speed_rad_s: Array  # (J,)
    max_position_rad: Array  # (J,)
    payload_max_kg: float
    zero_rad: Array = field(default_factory=lambda: np.zeros(0))  # (J,) DH angle where the joint reads zero; default: 0
    y_m: Array = field(default_factory=lambda: np.zeros(0))  # (J,) offset along y after Rot(z), beside aᵢ and dᵢ: Hayati (1983); default: 0
    base_rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3) DH frame 0 → the robot's base
    # (J, J) C of θ = C·q: turns of the motors, each in turns of its own joint, by those of the joints. None: each turns its joint alone
    coupling: Array | None = None
    recorded_at_motors: bool = False  # recordings hold θ; else q
    endless: Array = field(default_factory=lambda: np.zeros(0))  # (J,) 1: it turns without end, and max_position_rad is for design

    def __post_init__(self) -> None:
        """Sets offsets that were not given to zero."""
        for name in ("zero_rad", "y_m", "endless"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(self.joints))

    @property
    def joints(self) -> int:
        """J."""
        return len(self.link_names)

    @property
    def reach_rad(self) -> Array:
        """(J,) largest |q| that a joint can have [rad]; infinite where it turns without end."""
        reach: Array = np.where(self.endless > 0.0, np.inf, self.max_position_rad)
        return reach

    def motors_of(self, x: Array) -> Array:
        """Positions, speeds or accelerations of the joints (N, J) → those of the motors, each in units of its own joint."""
        return x if self.coupling is None else x @ self.coupling.T

    def joints_of(self, x: Array) -> Array:
        """Positions, speeds or accelerations of the motors (N, J) → those of the joints."""
        return x if self.coupling is None else np.asarray(np.linalg.solve(self.coupling, x.T).T)

    @property
    def share_of_motors(self) -> Array:
        """(J, J) S of τ_motor = S·τ_joint: by the power q̇ᵀτ_joint = θ̇ᵀτ_motor it is C⁻ᵀ. Entries of the size of rounding are zero."""
        if self.coupling is None:
            return np.eye(self.joints)
        share = np.linalg.inv(self.coupling).T
        return np.where(np.abs(share) < 1e-12, 0.0, share)

    @property
    def innermost(self) -> list[int]:
        """(J,) of each motor the innermost joint (from 0) whose torque it bears."""
        return [int(np.flatnonzero(row)[0]) for row in self.share_of_motors]

    @property
    def drive_gain_nm_per_a(self) -> Array:
        """(J,) joint torque per motor current Kt·G [N·m/A]; NaN where the torque constant is not published."""
        gain: Array = self.torque_constant_nm_per_a * self.gear_ratio
        return gain

    def nominal_parameters(self, *, with_inertia: bool = False) -> Array:
        """(13·J,) the manufacturer's masses and centres of mass as standard parameters about the DH origins.

        with_inertia : also the published tensors about the centres of mass. Friction and rotor inertia are zero.
        """
        first = self.mass_kg[:, None] * self.com_m
        (x, y, z), (mx, my, mz) = self.com_m.T, first.T
        J = np.stack([my * y + mz * z, -mx * y, -mx * z, mx * x + mz * z, -my * z, mx * x + my * y], axis=1)  # xx, xy, xz, yy, yz, zz
        if with_inertia:
            J += self.inertia_kg_m2[:, *_UPPER]
        blocks = np.zeros((self.joints, PER_JOINT))
        blocks[:, 0], blocks[:, 1:4], blocks[:, 4:INERTIAL] = self.mass_kg, first, J
        return blocks.ravel()

    def gravity(self, mounting: Mounting) -> Array:
        """(3,) gravity in DH frame 0 [m/s²]; components of the size of rounding are zero, as in `Mounting.gravity_in_base`."""
        gravity: Array = self.base_rotation.T @ mounting.gravity_in_base
        return np.where(np.abs(gravity) < 1e-12 * STANDARD_GRAVITY_M_S2, 0.0, gravity)

    def pinocchio_model(self, mounting: Mounting | None = None) -> "pinocchio.Model":
        """The arm in pinocchio with the published inertias; gravity in the frame of the robot's base.

        Joint frame i of pinocchio is DH frame i−1 turned by qᵢ and its zero, so DH frame i is fixed in it.
        """
        import pinocchio as pin  # takes 0.2 s: only where dynamics are asked for

        model = pin.Model()
        model.name = self.name
        before = pin.SE3(self.base_rotation, np.zeros(3))
        parent = 0
        for i, name in enumerate(self.link_names):
            cz, sz = math.cos(self.zero_rad[i]), math.sin(self.zero_rad[i])
            zero = pin.SE3(np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
            parent = model.addJoint(parent, pin.JointModelRZ(), before * zero, name)
            ca, sa = math.cos(self.alpha_rad[i]), math.sin(self.alpha_rad[i])
            turn = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
            to_dh = pin.SE3(turn, np.array([self.a_m[i], self.y_m[i], self.d_m[i]]))
            inertia = pin.Inertia(float(self.mass_kg[i]), self.com_m[i], self.inertia_kg_m2[i])
            model.appendBodyToJoint(parent, inertia, to_dh)
            model.addFrame(pin.Frame(f"dh_{i + 1}", parent, to_dh, pin.FrameType.OP_FRAME))
            before = to_dh
        model.gravity = pin.Motion(np.concatenate([(mounting or Mounting()).gravity_in_base, np.zeros(3)]))
        return model


def robot_names() -> list[str]:
    """The models that `load_robot` knows, sorted."""
    return sorted(entry.name.removesuffix(".toml") for entry in files("monitor.model.robots").iterdir() if entry.name.endswith(".toml"))


@lru_cache
def load_robot(name: str) -> Robot:
    """The published parameters of one model, by its name.

    Raises BadInput for a name that is not in `robot_names()`.
    """
    if name not in robot_names():
        raise BadInput(f"robot {name!r} is not known; known are {', '.join(robot_names())}")
    return robot_from_document(tomllib.loads(files("monitor.model.robots").joinpath(f"{name}.toml").read_text("utf-8")))


def robot_from_document(document: dict[str, Any]) -> Robot:
    """The robot in a document with the keys of `monitor/model/robots/*.toml`.

    Raises BadInput naming the key whose value no arm can have, KeyError or TypeError where a key is missing or of another kind.
    """
    links = document["link"]
    if not 1 <= len(links) <= MAX_LINKS:
        raise BadInput(f"[[link]]: {len(links)} links; expected 1 to {MAX_LINKS}")
    unknown = [math.nan] * len(links)

    def tensor(entry: dict[str, float]) -> list[list[float]]:
        xx, xy, xz, yy, yz, zz = (entry[key] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
        return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]

    robot = Robot(
        name=str(document["name"]),
        generation=str(document["generation"]),
        rate_hz=float(document["rate_hz"]),
        link_names=tuple(link["name"] for link in links),
        a_m=np.array([link["a_m"] for link in links], dtype=float),
        d_m=np.array([link["d_m"] for link in links], dtype=float),
        alpha_rad=np.array([link["alpha_rad"] for link in links], dtype=float),
        mass_kg=np.array([link["mass_kg"] for link in links], dtype=float),
        com_m=np.array([link["com_m"] for link in links], dtype=float),
        inertia_kg_m2=np.array([tensor(link["inertia_kg_m2"]) for link in links], dtype=float),
        gear_ratio=np.array(document.get("gear_ratio", unknown), dtype=float),
        torque_constant_nm_per_a=np.array(document.get("torque_constant_nm_per_a", unknown), dtype=float),
        max_torque_nm=np.array(document["max_torque_nm"], dtype=float),
        max_speed_rad_s=np.array(document["max_speed_rad_s"], dtype=float),
        max_position_rad=np.array(document["max_position_rad"], dtype=float),
        payload_max_kg=float(document["payload_max_kg"]),
        zero_rad=np.array([link.get("zero_rad", 0.0) for link in links], dtype=float),
        y_m=np.array([link.get("y_m", 0.0) for link in links], dtype=float),
        base_rotation=np.array(document.get("base_rotation", np.eye(3)), dtype=float),
        coupling=np.array(document["coupling"], dtype=float) if "coupling" in document else None,
        recorded_at_motors=_at_motors(document),
        endless=np.array([link["name"] in document.get("endless", ()) for link in links], dtype=float),
    )
    _refuse_impossible(robot)
    return robot


def _at_motors(document: dict[str, Any]) -> bool:
    """Whether `positions_at` says that recordings hold those of the motors. Raises BadInput for another word, or without coupling."""
    where = document.get("positions_at", "joints")
    if where not in ("joints", "motors"):
        raise BadInput(f"positions_at: {where!r}; expected joints or motors")
    if where == "motors" and "coupling" not in document:
        raise BadInput("positions_at: motors needs the coupling, θ = C·q; without one, both are the same")
    return bool(where == "motors")


def _refuse_impossible(robot: Robot) -> None:
    """Raises BadInput naming a figure that no arm can have. Torque constants, gear ratios, masses may be NaN, limits may be infinite."""
    J = robot.joints
    vectors = ("a_m", "d_m", "alpha_rad", "zero_rad", "y_m", "mass_kg", "gear_ratio", "torque_constant_nm_per_a")
    for key in (*vectors, "max_torque_nm", "max_speed_rad_s", "max_position_rad"):
        value = getattr(robot, key)
        if value.shape != (J,) or value.dtype.kind != "f":
            raise BadInput(f"{key}: {value.tolist()!r}; expected {J} numbers")
    for key, most in (("a_m", 10.0), ("d_m", 10.0), ("y_m", 10.0), ("alpha_rad", 10.0), ("zero_rad", 10.0), ("com_m", 10.0)):
        value = getattr(robot, key)
        if not np.all(np.abs(value) <= most):
            raise BadInput(f"{key}: {value.tolist()!r}; expected finite numbers up to {most:g} in size")
    for key in ("gear_ratio", "torque_constant_nm_per_a", "max_torque_nm", "max_speed_rad_s", "max_position_rad"):
        value = getattr(robot, key)
        if np.any(value <= 0.0):
            raise BadInput(f"{key}: {value.tolist()!r}; expected positive numbers")
    if np.any(robot.mass_kg < 0.0) or np.any(robot.mass_kg > 1e4):
        raise BadInput(f"mass_kg: {robot.mass_kg.tolist()!r}; expected 0 to 10 000 kg")
    if robot.com_m.shape != (J, 3) or not np.all(np.isfinite(robot.inertia_kg_m2)):
        raise BadInput("com_m, inertia_kg_m2: expected three coordinates and six finite moments for every link")
    least = np.linalg.eigvalsh(robot.inertia_kg_m2)[:, 0]  # (J,)
    if np.any(least < -1e-6 * np.maximum(np.trace(robot.inertia_kg_m2, axis1=1, axis2=2), 1e-9)):
        raise BadInput(f"inertia_kg_m2 of link {int(np.argmin(least)) + 1} has a negative principal moment: no body has one")
    C = robot.coupling
    if C is not None and (C.shape != (J, J) or not np.all(np.abs(C) <= 10.0) or np.linalg.cond(C) > 1e3):
        raise BadInput(f"coupling: {C.tolist()!r}; expected {J} rows of {J} numbers up to 10 in size, of θ = C·q, that can be inverted")
    turn = robot.base_rotation
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
        raise BadInput(f"base_rotation: {turn.tolist()!r}; expected a rotation matrix, 3 × 3")
    if not (math.isnan(robot.rate_hz) or 1.0 <= robot.rate_hz <= 10_000.0):
        raise BadInput(f"rate_hz = {robot.rate_hz!r}; expected 1 to 10 000")
    if robot.payload_max_kg < 0.0:
        raise BadInput(f"payload_max_kg = {robot.payload_max_kg!r}; expected 0 or more")
