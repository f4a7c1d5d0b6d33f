"""LAPACK's `dposv` from scipy, without the rest of `scipy.linalg`: that takes a third of the time in which a simulator starts."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
import scipy

from monitor.model.robot import Mounting, Robot
from monitor.recording import Array
from monitor.simulate.arm.damage import KNEE_C, OVERHEATED_K, Bearings, Damage, Gears
from monitor.simulate.arm.friction import (
    PRODUCTION_LOAD,
    PRODUCTION_MOVING,
    PRODUCTION_SPEED_RAD_S,
    REFERENCE_C,
    SMOOTH_SPEED_RAD_S,
    FrictionLaw,
    RunIn,
    Wear,
    default_law,
)
from monitor.simulate.arm.thermal import Temperatures, ThermalModel, default_thermal

Solved = tuple[Array, Array, int]


def _dposv() -> Callable[[Array, Array], Solved]:
    """The function of the compiled module alone; where scipy has another layout, that of the package."""
    spec = PathFinder.find_spec("scipy.linalg._flapack", [str(Path(scipy.__file__).parent / "linalg")])
    if spec is not None and spec.loader is not None:
        compiled = module_from_spec(spec)
        spec.loader.exec_module(compiled)
        found: Callable[[Array, Array], Solved] = compiled.dposv
        return found
    from scipy.linalg.lapack import dposv

    whole: Callable[[Array, Array], Solved] = dposv
    return whole


dposv = _dposv()  # (A, b) → factor of A, x with A·x = b, 0 where A is positive definite


# --- What presses against an arm from outside: a torque on one joint, or an elastic wall in its way -----


class Pressing(Protocol):
    """Whatever presses against an arm."""

    left_s: float  # time for which it lasts yet; inf: until it is removed

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,) [N·m]."""


@dataclass(slots=True, kw_only=True, eq=False)
class Contact:
    """One contact at one joint, for a time."""

    joint: int  # 0 … J−1
    left_s: float  # time for which it lasts yet; inf: until it is removed
    torque_nm_on_joint: float = 0.0  # constant torque on the joint, with its sign
    stiffness_nm_per_rad: float = 0.0  # of a wall that the joint touches at wall_rad
    wall_rad: float = 0.0
    side: float = 1.0  # the wall is above (1) or below (−1) the joint's position: it only pushes back

    def torque_nm(self, q: Array) -> Array:
        """(J,) torque on the joints at q (J,) [N·m]."""
        pressed = np.zeros_like(q)
        depth_rad = max(self.side * (float(q[self.joint]) - self.wall_rad), 0.0)
        pressed[self.joint] = self.torque_nm_on_joint - self.side * self.stiffness_nm_per_rad * depth_rad
        return pressed


# --- The arm: drive torque becomes motion, heat and wear. Pinocchio computes the rigid bodies; this package has the laws of the joints ---

SETTLE_S = 0.05  # step of heat and wear, which are slow
SERVO_RAD_S = 100.0  # bandwidth of the joint servo: friction of 10 N·m deflects a base joint by less than a milliradian
SERVO_INTEGRAL_PER_S = 25.0  # rate of the integral term: it removes the rest of the error within a tenth of a second
SERVO_INTEGRAL_MAX_RAD_S2 = 40.0  # limit of the integral term: what friction can need at most
# the same limit for the integral of the error
SERVO_INTEGRAL_MAX_RAD_S = SERVO_INTEGRAL_MAX_RAD_S2 / (SERVO_RAD_S**2 * SERVO_INTEGRAL_PER_S)
JAM_NM = 1e6  # friction of a joint that is stuck: far beyond any drive and any impact
PARTS = 2  # of a servo period, where gears are elastic
USUAL_RATIO = 101.0  # of gears whose ratio is not published
STRAIN_SHARE = 0.8  # of dry friction: the servo of a standing arm pulls at most with this
ROTOR_KG_M2_PER_NM = 0.0075  # rotor inertia at the joint per maximum torque; it gives 1.1 kg·m² for size 3
# Kt·G of arms whose torque constants are not published: maximum torque of the joint [N·m], gain [N·m/A]. The figures are assumptions
# of the simulator; those of sizes 1 and 3 follow the factory calibration of a UR5e (0.080 and 0.1005 N·m/A at the motor).
ASSUMED_GAIN = ([12.0, 28.0, 56.0, 150.0, 330.0], [4.6, 8.1, 10.5, 10.2, 13.5])


class Target(NamedTuple):
    """A target of the servo, each (J,)."""

    q: Array
    qd: Array
    qdd: Array


class Arm:
    """State and laws of one simulated arm. `step` moves the arm, `settle` warms and wears it."""

    def __init__(
        self,
        robot: Robot,
        *,
        q: Array,
        ambient_c: float = 22.0,
        mounting: Mounting | None = None,
        payload_kg: float = 0.0,
        payload_com_m: tuple[float, ...] = (0.0, 0.0, 0.05),
        law: FrictionLaw | None = None,
        thermal: ThermalModel | None = None,
        wear_per_revolution: Array | None = None,
        run_in: float = 0.0,
    ) -> None:
        J = robot.joints
        self.robot, self.ambient_c = robot, ambient_c
        self._sound_law = self.law = law or default_law(robot)
        self.damage = Damage.none(J)
        self.thermal = thermal or default_thermal(robot)
        self.gain_nm_per_a = drive_gain(robot)
        self.rotor_kg_m2 = ROTOR_KG_M2_PER_NM * robot.max_torque_nm
        self._gear_ratio = np.where(np.isnan(robot.gear_ratio), USUAL_RATIO, robot.gear_ratio)
        # arrays instead of numbers: at this size numpy takes twice as long for array·number as for array·array
        self._half, self._one = np.full(J, 0.5), np.ones(J)
        self._integral_top, self._integral_least = np.full(J, SERVO_INTEGRAL_MAX_RAD_S), np.full(J, -SERVO_INTEGRAL_MAX_RAD_S)
        self._step_s, self._h, self._half_h = 0.0, np.zeros(J), np.zeros(J)  # the last step's length, and the half of it
        self._stiffness, self._damping = np.full(J, SERVO_RAD_S**2), np.full(J, 2.0 * SERVO_RAD_S)
        self._patience = np.full(J, SERVO_INTEGRAL_PER_S)
        self._smooth = np.full(J, SMOOTH_SPEED_RAD_S**2)
        self._gears: Gears | None = None  # None: no gear is damaged, and the arm is rigid
        self._bearings: Bearings | None = None
        self._misread = self._weak = False  # whether an encoder misreads, and whether a magnet is weak

        self.q, self.qd = q.astype(float), np.zeros(J)
        self.qdd = np.zeros(J)
        self.torque_nm = np.zeros(J)  # drive torque in the middle of the last step
        self.torque_before_nm = np.zeros(J)  # drive torque in the middle of the step before
        self.friction_nm = np.zeros(J)
        self.temperatures: Temperatures = self.thermal.idle(ambient_c)
        self.wear, self.run_in = Wear.fresh(J, wear_per_revolution), RunIn(J, run_in)
        self.load_nm = np.zeros(J)  # torque through the gears, on the side of the link
        self._elapsed_s = 0.0
        self._now, self._sums = np.zeros((2, 4, J))  # rates of friction work, torque², travel and load·travel, and their integrals
        self._integral = np.zeros(J)
        self._slide = np.zeros(J)  # sign of each joint's motion in the last step; 0 where friction held it
        self._sliding = False  # whether all joints moved
        self.contact: Pressing | None = None  # what presses against the arm
        self._jam_nm = np.zeros(J)  # friction of joints that are stuck
        self.powered = True  # without power, a joint at rest has no losses
        self.mounting, self.payload_kg, self.payload_com_m = mounting or Mounting(), payload_kg, tuple(payload_com_m)
        self.carry()
        self.torque_nm = pin.nonLinearEffects(self.model, self._data, self.q, self.qd).copy()  # the servo has held the arm
        self.torque_before_nm = self.torque_nm
        self._update_damage()

    def carry(
        self,
        mounting: Mounting | None = None,
        payload_kg: float | None = None,
        payload_com_m: tuple[float, ...] | None = None,
        *,
        declared: bool = True,
    ) -> None:
        """Change the mounting or the payload. If they are not declared, the servo keeps computing with the model that it had."""
        self.mounting = mounting or self.mounting
        self.payload_kg = self.payload_kg if payload_kg is None else payload_kg
        self.payload_com_m = payload_com_m or self.payload_com_m
        self.model = arm_model(self.robot, self.mounting, self.payload_kg, self.payload_com_m)
        self.flange = self.model.getFrameId(f"dh_{self.robot.joints}")
        self._data: pin.Data = self.model.createData()
        self._rest_of: Array | None = None  # the q for which M and n of the standing arm are known
        if declared:
            self.assume_model(self.model)
        else:
            self._believed_differs = True

    def assume_model(self, model: "pin.Model") -> None:
        """Use this model in the feed-forward of the servo from now on. The body does not change."""
        self.assumed_model, self._assumed_data = model, model.createData()
        self._believed_differs = model is not self.model

    # --- motion ---------------------------------------------------------------------------------------------------
    def step(self, h: float, target: Target) -> None:
        """Compute one servo period of length h: computed torque with the assumed model, and a PID term for friction."""
        if self._gears is None:
            self._servoed(h, target)
            return
        part_s = h / PARTS  # the servo's damping is for motor and link, and a motor before a soft gear needs a faster drive
        for i in range(PARTS):
            later_s = (i + 0.5) * part_s - 0.5 * h
            self._servoed(part_s, Target(target.q + later_s * target.qd, target.qd + later_s * target.qdd, target.qdd))

    def _servoed(self, h: float, target: Target) -> None:
        M, n, q_m, v_m = self._middle(h)
        given, integral = self._servo(h, target, M, n, q_m, v_m)
        if integral is not None:
            self._integral = integral
        self._integrate(h, given, M, n, q_m)

    def stand(self, h: float, target: Target) -> bool:
        """Make a step of any length if friction holds the arm; it is exact, because nothing moves. Returns False if the arm would move."""
        if self._sliding or self._slide.any() or self.qd.any() or self._gears is not None:
            return False
        q = self.q
        if self._rest_of is not q:
            self._rest_M, self._rest_n, _, _ = self._middle(0.0)
            self._rest_of = q
        n = self._rest_n
        given, integral = self._servo(h, target, self._rest_M, n, q, self.qd)
        held = given - n
        if self.contact is not None:
            held = held + self.contact.torque_nm(q)
        if True in (np.abs(held) > (1.0 + self.law.stiction) * (self._dry_nm + self._dry_load * np.abs(n))).tolist():
            return False
        if integral is not None:
            self._integral = integral
        self.load_nm, self.friction_nm, self.qdd = n, held, self.qd
        self.torque_before_nm, self.torque_nm = self.torque_nm, given
        return True

    def _servo(self, h: float, target: Target, M: Array, n: Array, q_m: Array, v_m: Array) -> tuple[Array, Array | None]:
        if self._misread:
            too_much, slope = self.damage.encoder(q_m, self._gear_ratio)
            q_m, v_m = q_m + too_much, v_m * (1.0 + slope)
        error = target.q - q_m
        integral = np.minimum(np.maximum(self._integral + self._lengths(h)[0] * error, self._integral_least), self._integral_top)
        wanted = self._stiffness * (error + self._patience * integral) + self._damping * (target.qd - v_m) + target.qdd
        if self._believed_differs:
            M = pin.crba(self.assumed_model, self._assumed_data, q_m)
            n = pin.nonLinearEffects(self.assumed_model, self._assumed_data, q_m, v_m)
        limit = self.robot.max_torque_nm
        asked = M.dot(wanted) + n
        if True in (np.abs(asked) > limit).tolist():
            return self._driven(np.minimum(np.maximum(asked, -limit), limit)), None  # at the limit, the integral would wind up
        return self._driven(asked), integral

    def _driven(self, asked_nm: Array) -> Array:
        """(J,) torque of the drives where the controller asks for this one."""
        return self.damage.flux * asked_nm if self._weak else asked_nm

    def strain(self, held_nm: Array) -> None:
        """Let the servo of the standing arm pull with this torque (J,) beyond gravity, as after a motion; friction holds as much of it."""
        M, n, _, _ = self._middle(0.0)
        dry = self._dry_nm + self._dry_load * np.abs(n)
        held = np.minimum(np.maximum(held_nm, -STRAIN_SHARE * dry), STRAIN_SHARE * dry)
        if not held.any():
            return
        self._integral = np.linalg.solve(M, held) / (self._stiffness * self._patience)
        self.torque_nm = n + held
        self.torque_before_nm, self.friction_nm = self.torque_nm, held

    def push(self, h: float, torque_nm: Array) -> None:
        """Make one step of length h under given drive torques (J,), without the servo."""
        M, n, q_m, _ = self._middle(h)
        self._integrate(h, torque_nm, M, n, q_m)

    def jam(self, joint: int, *, jammed: bool) -> None:
        """Let one joint (0 … J−1) stick mechanically, or let it go: no drive can turn it."""
        self._jam_nm[joint] = JAM_NM if jammed else 0.0
        self._update_friction()

    def brake(self) -> None:
        """Close the brakes and switch the drives off: the arm stands."""
        self.qd = np.zeros_like(self.qd)
        self.qdd = np.zeros_like(self.qd)
        self.torque_nm = np.zeros_like(self.qd)
        self.torque_before_nm = self.torque_nm
        self._integral = np.zeros_like(self.qd)
        self._slide, self._sliding = np.zeros_like(self.qd), False
        if self._gears is not None:
            self._gears.stop()

    def _middle(self, h: float) -> tuple[Array, Array, Array, Array]:
        half = self._lengths(h)[1]
        q_m = self.q + half * self.qd
        v_m = self.qd + half * self.qdd
        x_m, w_m = (q_m, v_m) if self._gears is None else self._gears.links(self.q, half)
        M: Array = pin.crba(self.model, self._data, x_m)
        n: Array = pin.nonLinearEffects(self.model, self._data, x_m, w_m)
        return M, n.copy(), q_m, v_m

    def _lengths(self, h: float) -> tuple[Array, Array]:
        """(J,) the length of a step and (J,) the half of it; nearly all steps have the same."""
        if h != self._step_s:
            self._step_s, self._h = h, np.full(len(self.q), h)
            self._half_h = h * self._half
        return self._h, self._half_h

    def _integrate(self, step_s: float, torque: Array, M: Array, n: Array, q_m: Array) -> None:
        v, (h, half_h) = self.qd, self._lengths(step_s)
        load = self.load_nm = self.torque_nm - self.friction_nm - self.rotor_kg_m2 * self.qdd  # in the step before
        speed2 = v * v
        D = (self._one + self.law.stiction * np.exp(speed2 * self._stribeck)) * (self._dry_nm + self._dry_load * np.abs(load))
        half = h * (self._half_concave * (speed2 + self._smooth) ** self._power + self._half_linear)
        if self._bearings is not None:
            D = D + self._bearings.pulse_nm(q_m)
        if self._gears is not None:
            after = self._behind_gears(self._gears, step_s, torque, M, n, q_m, D, half)
            self.qdd = (after - v) / h
        else:
            A = M.copy(order="F")
            A.flat[:: len(v) + 1] += half
            free = torque - n
            if self.contact is not None:
                free = free + self.contact.torque_nm(q_m)
            after = self._slide_or_stick(A, M.dot(v) - half * v + h * free, h * D)
            self.qdd = (after - v) / h
            self.friction_nm = free - M.dot(self.qdd)
        self.q, self.qd = q_m + half_h * after, after
        self.torque_before_nm, self.torque_nm = self.torque_nm, torque

    def _behind_gears(self, gears: Gears, h: float, torque: Array, M: Array, n: Array, q_m: Array, D: Array, half: Array) -> Array:
        """(J,) speeds of the motors after a step in which they turn the links through elastic gears; friction is on the motors."""
        v, (x_m, _) = self.qd, gears.links(self.q, self._half_h)
        pressed = -n if self.contact is None else self.contact.torque_nm(x_m) - n
        A, b = gears.reduced(M, (torque, pressed), v, q_m, x_m, h)
        A.flat[:: len(v) + 1] += half
        b -= half * v
        after = self._slide_or_stick(np.asfortranarray(A), b, h * D)
        gears.follow(v, after, h)
        self.friction_nm = (b - A.dot(after) + half * (v + after)) / h
        return after

    def _slide_or_stick(self, A: Array, b: Array, D: Array) -> Array:
        """The only v with A·v = b − s, |s| ≤ D, and s = D·sign(v) where v ≠ 0. Each argument is (J,), A is (J, J).

        Principal pivoting from the pattern of the last step: Cottle, Pang and Stone (1992), ch. 4.
        """
        z = self._slide
        if self._sliding:  # nearly always, all joints keep their direction
            v: Array = dposv(A, b - D * z)[1]
            if min((v * z).tolist()) > 0.0:
                return v
        for attempt in range(64):
            stuck = z == 0.0
            held = A.copy(order="F")
            held[stuck] = 0.0
            held[:, stuck] = 0.0
            held[stuck, stuck] = 1.0
            v = dposv(held, np.where(stuck, 0.0, b - D * z))[1]
            s = b - A @ v  # the friction impulse that this v needs
            right = np.where(stuck, np.where(np.abs(s) <= D, 0.0, np.sign(s)), np.where(v * z > 0.0, z, 0.0))
            wrong = right != z
            if not wrong.any():
                break
            if attempt > 6:  # changing one index at a time, Murty's rule, cannot cycle
                wrong[int(np.argmax(wrong)) + 1 :] = False
            z = np.where(wrong, right, z)
        self._slide, self._sliding = z, bool(z.all())
        result: Array = np.where(z == 0.0, 0.0, v)
        return result

    def _update_friction(self) -> None:
        """Compute the terms of friction that depend on temperature, wear and run-in only. They are constant within a control period."""
        none, run_in = np.zeros_like(self.qd), self.run_in.factor
        self._dry_nm = run_in * self.law.dry(none, self.temperatures.grease_c, self.wear.coulomb) + self._jam_nm
        self._dry_load = run_in * self.wear.coulomb * self.law.load_factor
        thin = run_in * self.wear.viscous * np.exp(-self.law.viscous_per_k * (self.temperatures.grease_c - REFERENCE_C))
        self._half_concave, self._half_linear = 0.5 * thin * self.law.concave_nm, 0.5 * thin * self.law.linear_nm_s_per_rad
        self._power = 0.5 * (self.law.exponent - 1.0)
        self._stribeck = -1.0 / self.law.stribeck_rad_s**2

    # --- damage -------------------------------------------------------------------------------------------------
    def damage_joint(self, name: str, joint: int, severity: float) -> None:
        """Give one joint (0 … J−1) a fault of `damage.DAMAGES`, from 0, sound, to 1."""
        self.damage.severity[name][joint] = severity
        if name == "demagnetisation":  # by heat that is over
            self.damage.flux[joint] = 1.0
            self.damage.heat(np.where(np.arange(len(self.q)) == joint, KNEE_C + OVERHEATED_K * severity, KNEE_C))
        self._update_damage()

    def repair(self) -> None:
        """All joints are sound again; wear stays."""
        self.damage = Damage.none(self.robot.joints)
        self._update_damage()

    def _update_damage(self) -> None:
        """Compute what depends on the faults of joints only."""
        damage, size = self.damage, self.robot.max_torque_nm
        self.law = damage.law(self._sound_law, size)
        before, self._gears = self._gears, None
        if damage.of_gears:
            gears = Gears(damage, self.robot, self._gear_ratio, self.rotor_kg_m2)
            self._gears = gears.rest(self.q, self.qd, self.load_nm, before)
        bearing = damage.severity["bearing"]
        self._bearings = Bearings(bearing, self.robot, self._gear_ratio) if bearing.any() else None
        self._misread = any(damage.severity[name].any() for name in ("joint_encoder", "motor_encoder"))
        self._weak = bool((damage.flux < 1.0).any())
        self._copper = self.thermal.winding_ohm / self.true_gain_nm_per_a**2  # W per (N·m)²
        self._update_friction()

    @property
    def true_gain_nm_per_a(self) -> Array:
        """(J,) torque per current of these magnets; the controller reckons with `gain_nm_per_a` [N·m/A]."""
        return self.damage.flux * self.gain_nm_per_a

    def encoders(self) -> tuple[Array, Array]:
        """(J,) position and speed as the encoders show them, without noise."""
        if not self._misread:
            return self.q, self.qd
        too_much, slope = self.damage.encoder(self.q, self._gear_ratio)
        return self.q + too_much, self.qd * (1.0 + slope)

    # --- heat and wear ------------------------------------------------------------------------------------------
    def settle(self, dt_s: float) -> None:
        """Add the last dt to the sums of losses and travel. Every SETTLE_S they become heat and wear. A contact ends with its time."""
        if self.contact is not None:
            self.contact.left_s -= dt_s
            if self.contact.left_s <= 0.0:
                self.contact = None
        now, qd = self._now, self.qd
        self._elapsed_s += dt_s
        np.multiply(self.friction_nm, qd, out=now[0])
        np.multiply(self.torque_nm, self.torque_nm, out=now[1])
        np.abs(qd, out=now[2])
        np.multiply(now[2], np.abs(self.load_nm), out=now[3])
        self._sums += dt_s * now
        elapsed = self._elapsed_s
        if elapsed < SETTLE_S - 1e-9:
            return
        friction_j, torque2_s, travel_rad, load_travel = self._sums
        motor_w = self._copper * torque2_s / elapsed + (self.thermal.idle_w if self.powered else 0.0)
        grease_w = np.maximum(friction_j, 0.0) / elapsed
        self._become(self.thermal.step(self.temperatures, motor_w, grease_w, self.ambient_c, elapsed))
        travel = np.maximum(travel_rad, 1e-12)
        self.wear.use(travel / math.tau, load_travel / travel / self.robot.max_torque_nm)
        self.run_in.pass_by(elapsed, travel_rad)
        self._sums[:] = 0.0
        self._elapsed_s = 0.0
        self._update_friction()

    def regrease(self, joint: int, recovery: float) -> None:
        """Put new grease into one joint (0 … J−1): this share of its wear disappears, and of the lubricant's age."""
        self.wear.regrease(joint, recovery)
        self.damage.severity["aged_lubricant"][joint] *= 1.0 - recovery
        self._update_damage()

    def replace_joint(self, joint: int, friction_factor: float) -> None:
        """Replace a joint (0 … J−1) by a new one, as warm as the room, with this multiple of the unworn friction of the old one."""
        scale = np.ones(self.robot.joints)
        scale[joint] = friction_factor
        law = self._sound_law
        self._sound_law = replace(
            law, coulomb_nm=scale * law.coulomb_nm, concave_nm=scale * law.concave_nm, linear_nm_s_per_rad=scale * law.linear_nm_s_per_rad
        )
        self.wear.renew(joint)
        for node in self.temperatures:
            node[joint] = self.ambient_c
        self.damage.renew(joint)
        self._update_damage()

    def set_temperatures(self, temperatures: Temperatures) -> None:
        """Set the temperatures of the joints."""
        self._become(temperatures)
        self._update_friction()

    def _become(self, temperatures: Temperatures) -> None:
        """Let the joints be so warm; magnets that are too hot lose flux."""
        self.temperatures = temperatures
        if self.damage.heat(temperatures.motor_c):
            self._update_damage()

    def set_wear(self, joint: int, coulomb: float | None = None, viscous: float | None = None, per_revolution: float | None = None) -> None:
        """Set the wear factors of one joint (0 … J−1), and its growth per revolution. None keeps the present value."""
        if per_revolution is not None:
            self.wear.per_revolution[joint] = per_revolution
        if coulomb is not None:
            self.wear.coulomb[joint] = coulomb
        if viscous is not None:
            self.wear.viscous[joint] = viscous
        self._update_friction()

    def pass_time(self, hours: float, ambient_c: float, duty: float) -> None:
        """Let time pass without computing motion. The arm does a typical job in the share `duty` of the time and rests otherwise."""
        self.ambient_c = ambient_c
        speed = np.full(self.robot.joints, PRODUCTION_SPEED_RAD_S)
        load = PRODUCTION_LOAD * self.robot.max_torque_nm
        left = 3600.0 * hours
        while left > 1e-9:
            dt = min(600.0, left)  # short enough: friction heat, which depends on the temperature, is right within a percent
            left -= dt
            moving = duty * PRODUCTION_MOVING
            resisting = self.law.torque(speed, load, self.temperatures.grease_c, self.wear.coulomb, self.wear.viscous)
            current = (load + resisting) / self.true_gain_nm_per_a
            motor_w = (self.thermal.idle_w if self.powered else 0.0) + moving * self.thermal.winding_ohm * current * current
            self._become(self.thermal.leap(self.temperatures, motor_w, moving * resisting * speed, ambient_c, dt))
            self.run_in.pass_production(dt, duty)
            self.wear.use(moving * speed * dt / math.tau, np.full(self.robot.joints, PRODUCTION_LOAD))
        self._update_friction()

    # --- truth --------------------------------------------------------------------------------------------------
    def measured_torque_nm(self) -> Array:
        """(J,) drive torque now, extrapolated from the last two steps to the end of the last one [N·m]."""
        result: Array = self.torque_nm + self._half * (self.torque_nm - self.torque_before_nm)
        return result

    def electric_w(self) -> float:
        """Electric power of all drives now: mechanical power and loss in the windings [W]."""
        torque = self.torque_nm
        return float(torque.dot(self.qd) + (self._copper * torque).dot(torque))

    def rigid_torque(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Torque without friction for states (N, J): at the drives, with the rotors, and at the links, each (N, J) [N·m]."""
        data = self.model.createData()
        rotor = self.rotor_kg_m2 * qdd
        drive = np.array([pin.rnea(self.model, data, *row) for row in zip(q, qd, qdd, strict=True)]).reshape(q.shape)
        return drive, drive - rotor

    def friction_torque(self, qd: Array, load_nm: Array, grease_c: Array | None = None) -> Array:
        """(N, J) friction torque with the present wear and without run-in, at given grease temperatures or the present ones [N·m]."""
        grease = self.temperatures.grease_c if grease_c is None else grease_c
        return self.law.torque(qd, load_nm, grease, self.wear.coulomb, self.wear.viscous)


def arm_model(robot: Robot, mounting: Mounting, payload_kg: float, payload_com_m: tuple[float, ...]) -> "pin.Model":
    """The rigid-body model with its rotors. The payload is a point mass in the flange's frame."""
    model = robot.pinocchio_model(mounting)
    if payload_kg > 0.0:
        at_flange = model.frames[model.getFrameId(f"dh_{robot.joints}")].placement
        model.appendBodyToJoint(robot.joints, pin.Inertia(payload_kg, np.array(payload_com_m), np.zeros((3, 3))), at_flange)
    model.armature = ROTOR_KG_M2_PER_NM * robot.max_torque_nm
    return model


def drive_gain(robot: Robot) -> Array:
    """(J,) Kt·G [N·m/A]: the published value, or else ASSUMED_GAIN for the maximum torque of the joint."""
    published = robot.drive_gain_nm_per_a
    return np.where(np.isnan(published), np.interp(robot.max_torque_nm, *ASSUMED_GAIN), published)
