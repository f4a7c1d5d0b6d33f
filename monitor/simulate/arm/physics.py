"""Arm: torque → motion, heat and wear. Rigid bodies by pinocchio, joints by the laws of this room.

One step of length h, second order, from the state (q, v):
q_m = q + h/2·v;  M(q_m)·(v⁺ − v) = h·[τ − n(q_m, v_m) − s − k·(v + v⁺)/2];  q⁺ = q_m + h/2·v⁺
s is dry friction: |sⱼ| ≤ Dⱼ, and sⱼ = Dⱼ·sign(v⁺ⱼ) wherever v⁺ⱼ ≠ 0 (a linear complementarity problem, solved exactly), so a
joint that is held stands still: no creep, no chatter.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from monitor.model.robot import Mounting, Robot
from monitor.recording import Array
from monitor.simulate.arm.friction import REFERENCE_C, SMOOTH_SPEED_RAD_S, STRIBECK_RAD_S, FrictionLaw, default_law
from monitor.simulate.arm.thermal import Temperatures, ThermalModel, default_thermal
from monitor.simulate.arm.wear import PRODUCTION_LOAD, PRODUCTION_MOVING, PRODUCTION_SPEED_RAD_S, Wear

SETTLE_S = 0.05  # heat and wear are slow
SERVO_RAD_S = 100.0  # bandwidth of the joint servo: friction of 10 N·m bends a base joint by under a milliradian
SERVO_INTEGRAL_PER_S = 25.0  # takes the rest of the error away, and ends the creep after a stop, in a tenth of a second
SERVO_INTEGRAL_MAX_RAD_S2 = 40.0  # as much as friction can ask for
SERVO_INTEGRAL_MAX_RAD_S = SERVO_INTEGRAL_MAX_RAD_S2 / (SERVO_RAD_S**2 * SERVO_INTEGRAL_PER_S)  # the same, as the integral of the error
ROTOR_KG_M2_PER_NM = 0.0075  # rotor inertia at the joint per maximum torque: 1.1 kg·m² on a size 3 joint
# Kt·G of arms whose torque constants are not published: the simulator's own choice, by joint size (12 … 330 N·m);
# sizes 1 and 3 follow the factory calibration of a UR5e (0.080 and 0.1005 N·m/A at the motor)
ASSUMED_GAIN = ([12.0, 28.0, 56.0, 150.0, 330.0], [4.6, 8.1, 10.5, 10.2, 13.5])


class Target(NamedTuple):
    """Where the servo is asked to be, each (J,)."""

    q: Array
    qd: Array
    qdd: Array


class Arm:
    """State and laws of one simulated arm. `step` moves it, `settle` warms and wears it."""

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
    ) -> None:
        J = robot.joints
        self.robot, self.ambient_c = robot, ambient_c
        self.law = law or default_law(robot)
        self.thermal = thermal or default_thermal(robot)
        self.gain_nm_per_a = drive_gain(robot)
        self.rotor_kg_m2 = ROTOR_KG_M2_PER_NM * robot.max_torque_nm
        self._copper = self.thermal.winding_ohm / self.gain_nm_per_a**2  # W per (N·m)²
        # arrays where a number would do: numpy takes twice as long over array·number as over array·array at this size
        self._half, self._one = np.full(J, 0.5), np.ones(J)
        self._integral_top = np.full(J, SERVO_INTEGRAL_MAX_RAD_S)
        self._stiffness, self._damping = np.full(J, SERVO_RAD_S**2), np.full(J, 2.0 * SERVO_RAD_S)
        self._patience = np.full(J, SERVO_INTEGRAL_PER_S)
        self._stribeck, self._smooth = np.full(J, -1.0 / STRIBECK_RAD_S**2), np.full(J, SMOOTH_SPEED_RAD_S**2)

        self.q, self.qd = q.astype(float), np.zeros(J)
        self.qdd = np.zeros(J)
        self.torque_nm = np.zeros(J)  # of the drives, in the middle of the last step
        self.torque_before_nm = np.zeros(J)
        self.friction_nm = np.zeros(J)
        self.temperatures: Temperatures = self.thermal.idle(ambient_c)
        self.wear = Wear.fresh(J, wear_per_revolution)
        self.load_nm = np.zeros(J)  # through the gears, link side
        self._elapsed_s = 0.0
        self._now, self._sums = np.zeros((2, 4, J))  # friction work, torque², travel, load·travel: rates, and what they add up to
        self._integral = np.zeros(J)
        self._slide = np.zeros(J)  # −1, 0, 1: how each joint slid in the last step
        self._sliding = False  # all of them
        self.powered = True  # else a joint at rest has no losses
        self.mounting, self.payload_kg, self.payload_com_m = mounting or Mounting(), payload_kg, tuple(payload_com_m)
        self.carry()
        self.torque_nm = pin.nonLinearEffects(self.model, self._data, self.q, self.qd).copy()  # the servo has been holding it
        self.torque_before_nm = self.torque_nm
        self._grip()

    def carry(
        self,
        mounting: Mounting | None = None,
        payload_kg: float | None = None,
        payload_com_m: tuple[float, ...] | None = None,
        *,
        declared: bool = True,
    ) -> None:
        """Hang the arm otherwise, or give it another payload; untold, the servo goes on reckoning with what it was told last."""
        self.mounting = mounting or self.mounting
        self.payload_kg = self.payload_kg if payload_kg is None else payload_kg
        self.payload_com_m = payload_com_m or self.payload_com_m
        self.model = arm_model(self.robot, self.mounting, self.payload_kg, self.payload_com_m)
        self.flange = self.model.getFrameId(f"dh_{self.robot.joints}")
        self._data: pin.Data = self.model.createData()
        self._rest_of: Array | None = None  # the q at which the arm stands and M and n are known
        if declared:
            self.believe(self.model)
        else:
            self._believed_differs = True

    def believe(self, model: "pin.Model") -> None:
        """What the controller reckons with from now on: its feed-forward follows it, the body does not."""
        self.believed, self._believed_data = model, model.createData()
        self._believed_differs = model is not self.model

    # --- motion ---------------------------------------------------------------------------------------------------
    def step(self, h: float, target: Target) -> None:
        """One servo period: computed torque on the body as believed, PID for what it does not know, which is friction."""
        M, n, q_m, v_m = self._middle(h)
        given, integral = self._servo(h, target, M, n, q_m, v_m)
        if integral is not None:
            self._integral = integral
        self._integrate(h, given, M, n, q_m)

    def stand(self, h: float, target: Target) -> bool:
        """A step of any length of an arm that friction holds, exact because nothing moves; False, and no step, if it would move."""
        if self._sliding or self._slide.any() or self.qd.any():
            return False
        q = self.q
        if self._rest_of is not q:
            self._rest_M, self._rest_n, _, _ = self._middle(0.0)
            self._rest_of = q
        n = self._rest_n
        given, integral = self._servo(h, target, self._rest_M, n, q, self.qd)
        held = given - n
        if True in (np.abs(held) > (1.0 + self.law.stiction) * (self._grip_nm + self._grip_load * np.abs(n))).tolist():
            return False
        if integral is not None:
            self._integral = integral
        self.load_nm, self.friction_nm, self.qdd = n, held, self.qd
        self.torque_before_nm, self.torque_nm = self.torque_nm, given
        return True

    def _servo(self, h: float, target: Target, M: Array, n: Array, q_m: Array, v_m: Array) -> tuple[Array, Array | None]:
        error = target.q - q_m
        integral = np.minimum(np.maximum(self._integral + h * error, -self._integral_top), self._integral_top)
        wanted = self._stiffness * (error + self._patience * integral) + self._damping * (target.qd - v_m) + target.qdd
        if self._believed_differs:
            M = pin.crba(self.believed, self._believed_data, q_m)
            n = pin.nonLinearEffects(self.believed, self._believed_data, q_m, v_m)
        limit = self.robot.max_torque_nm
        asked = M.dot(wanted) + n
        if True in (np.abs(asked) > limit).tolist():
            return np.minimum(np.maximum(asked, -limit), limit), None  # at the limit an integral would only wind up
        return asked, integral

    def push(self, h: float, torque_nm: Array) -> None:
        """One step under given drive torques (J,), the servo out of the loop."""
        M, n, q_m, _ = self._middle(h)
        self._integrate(h, torque_nm, M, n, q_m)

    def brake(self) -> None:
        """Brakes closed, drives off: the arm stands."""
        self.qd = np.zeros_like(self.qd)
        self.qdd = np.zeros_like(self.qd)
        self.torque_nm = np.zeros_like(self.qd)
        self.torque_before_nm = self.torque_nm
        self._integral = np.zeros_like(self.qd)
        self._slide, self._sliding = np.zeros_like(self.qd), False

    def _middle(self, h: float) -> tuple[Array, Array, Array, Array]:
        half = h * self._half
        q_m = self.q + half * self.qd
        v_m = self.qd + half * self.qdd
        M: Array = pin.crba(self.model, self._data, q_m)
        n: Array = pin.nonLinearEffects(self.model, self._data, q_m, v_m)
        return M, n.copy(), q_m, v_m

    def _integrate(self, h: float, torque: Array, M: Array, n: Array, q_m: Array) -> None:
        v, law = self.qd, self.law
        load = self.load_nm = self.torque_nm - self.friction_nm - self.rotor_kg_m2 * self.qdd  # of the step before
        speed2 = v * v
        D = (self._one + law.stiction * np.exp(speed2 * self._stribeck)) * (self._grip_nm + self._grip_load * np.abs(load))
        half = h * (self._half_concave * (speed2 + self._smooth) ** self._power + self._half_linear)
        A = M.copy(order="F")
        A.flat[:: len(v) + 1] += half
        free = torque - n
        after = self._slide_or_stick(A, M.dot(v) - half * v + h * free, h * D)
        self.qdd = (after - v) / h
        self.friction_nm = free - M.dot(self.qdd)
        self.q, self.qd = q_m + (0.5 * h) * after, after
        self.torque_before_nm, self.torque_nm = self.torque_nm, torque

    def _slide_or_stick(self, A: Array, b: Array, D: Array) -> Array:
        """The only v with A·v = b − s, |s| ≤ D, s = D·sign(v) where v ≠ 0, by principal pivoting from the last step's pattern."""
        z = self._slide
        if self._sliding:  # nearly always, they go on sliding
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
            s = b - A @ v  # the impulse that friction would have to give
            right = np.where(stuck, np.where(np.abs(s) <= D, 0.0, np.sign(s)), np.where(v * z > 0.0, z, 0.0))
            wrong = right != z
            if not wrong.any():
                break
            if attempt > 6:  # Murty's rule, one at a time, cannot cycle
                wrong[int(np.argmax(wrong)) + 1 :] = False
            z = np.where(wrong, right, z)
        self._slide, self._sliding = z, bool(z.all())
        result: Array = np.where(z == 0.0, 0.0, v)
        return result

    def _grip(self) -> None:
        """What friction owes to temperature and wear, both constant within a tick."""
        none = np.zeros_like(self.qd)
        self._grip_nm = self.law.dry(none, self.temperatures.grease_c, self.wear.coulomb)
        self._grip_load = self.wear.coulomb * self.law.load_factor
        thin = self.wear.viscous * np.exp(-self.law.viscous_per_k * (self.temperatures.grease_c - REFERENCE_C))
        self._half_concave, self._half_linear = 0.5 * thin * self.law.concave_nm, 0.5 * thin * self.law.linear_nm_s_per_rad
        self._power = 0.5 * (self.law.exponent - 1.0)

    # --- heat and wear ------------------------------------------------------------------------------------------
    def settle(self, dt_s: float) -> None:
        """Account for the last dt; every SETTLE_S turn losses into heat and travel into wear."""
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
        self.temperatures = self.thermal.step(self.temperatures, motor_w, grease_w, self.ambient_c, elapsed)
        travel = np.maximum(travel_rad, 1e-12)
        self.wear.use(travel / math.tau, load_travel / travel / self.robot.max_torque_nm)
        self._sums[:] = 0.0
        self._elapsed_s = 0.0
        self._grip()

    def regrease(self, joint: int, recovery: float) -> None:
        """New grease in one joint (0 … J−1): this share of its wear goes."""
        self.wear.regrease(joint, recovery)
        self._grip()

    def replace_joint(self, joint: int, friction_factor: float) -> None:
        """Another joint in its place: unworn, its friction this many times the old one's when new; as warm as the room."""
        scale = np.ones(self.robot.joints)
        scale[joint] = friction_factor
        law = self.law
        self.law = replace(
            law, coulomb_nm=scale * law.coulomb_nm, concave_nm=scale * law.concave_nm, linear_nm_s_per_rad=scale * law.linear_nm_s_per_rad
        )
        self.wear.renew(joint)
        for node in self.temperatures:
            node[joint] = self.ambient_c
        self._grip()

    def set_temperatures(self, temperatures: Temperatures) -> None:
        """Begin somewhere else than at idle equilibrium."""
        self.temperatures = temperatures
        self._grip()

    def set_wear(self, joint: int, coulomb: float | None = None, viscous: float | None = None, per_revolution: float | None = None) -> None:
        """Wear factors of one joint (0 … J−1), on command, and how fast it wears from now on."""
        if per_revolution is not None:
            self.wear.per_revolution[joint] = per_revolution
        if coulomb is not None:
            self.wear.coulomb[joint] = coulomb
        if viscous is not None:
            self.wear.viscous[joint] = viscous
        self._grip()

    def live(self, hours: float, ambient_c: float, duty: float) -> None:
        """Let time pass without computing motion: `duty` of it is a typical job, the rest rest."""
        self.ambient_c = ambient_c
        speed = np.full(self.robot.joints, PRODUCTION_SPEED_RAD_S)
        load = PRODUCTION_LOAD * self.robot.max_torque_nm
        left = 3600.0 * hours
        while left > 1e-9:
            dt = min(600.0, left)  # fine enough for friction heat, which follows the temperature, to be right within a percent
            left -= dt
            moving = duty * PRODUCTION_MOVING
            resisting = self.law.torque(speed, load, self.temperatures.grease_c, self.wear.coulomb, self.wear.viscous)
            current = (load + resisting) / self.gain_nm_per_a
            motor_w = (self.thermal.idle_w if self.powered else 0.0) + moving * self.thermal.winding_ohm * current * current
            self.temperatures = self.thermal.leap(self.temperatures, motor_w, moving * resisting * speed, ambient_c, dt)
            self.wear.use(moving * speed * dt / math.tau, np.full(self.robot.joints, PRODUCTION_LOAD))
        self._grip()

    # --- truth --------------------------------------------------------------------------------------------------
    def measured_torque_nm(self) -> Array:
        """(J,) drive torque now: the last two steps' carried on to the end of the last."""
        result: Array = self.torque_nm + self._half * (self.torque_nm - self.torque_before_nm)
        return result

    def electric_w(self) -> float:
        """What all drives take now: motion, and loss in the windings."""
        torque = self.torque_nm
        return float(torque.dot(self.qd) + (self._copper * torque).dot(torque))

    def gravity_nm(self) -> Array:
        """(J,) what holds the arm up where it is."""
        result: Array = pin.computeGeneralizedGravity(self.model, self.model.createData(), self.q)
        return result

    def rigid_torque(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Without friction: at the drives (rotors included) and at the links, for states (N, J)."""
        data = self.model.createData()
        rotor = self.rotor_kg_m2 * qdd
        drive = np.array([pin.rnea(self.model, data, *row) for row in zip(q, qd, qdd, strict=True)]).reshape(q.shape)
        return drive, drive - rotor

    def friction_torque(self, qd: Array, load_nm: Array, grease_c: Array | None = None) -> Array:
        """(N, J) friction with today's wear, at given grease temperatures or the present ones."""
        grease = self.temperatures.grease_c if grease_c is None else grease_c
        return self.law.torque(qd, load_nm, grease, self.wear.coulomb, self.wear.viscous)

    def energy_j(self) -> float:
        """Kinetic, rotors included, and potential."""
        return self.kinetic_j() + float(pin.computePotentialEnergy(self.model, self.model.createData(), self.q))

    def kinetic_j(self) -> float:
        """With the rotors."""
        return float(0.5 * self.qd @ pin.crba(self.model, self.model.createData(), self.q) @ self.qd)


def arm_model(robot: Robot, mounting: Mounting, payload_kg: float, payload_com_m: tuple[float, ...]) -> "pin.Model":
    """The rigid body with its rotors, and a point mass in the flange's frame."""
    model = robot.pinocchio_model(mounting)
    if payload_kg > 0.0:
        at_flange = model.frames[model.getFrameId(f"dh_{robot.joints}")].placement
        model.appendBodyToJoint(robot.joints, pin.Inertia(payload_kg, np.array(payload_com_m), np.zeros((3, 3))), at_flange)
    model.armature = ROTOR_KG_M2_PER_NM * robot.max_torque_nm
    return model


def drive_gain(robot: Robot) -> Array:
    """(J,) Kt·G [N·m/A]: the published one, else ASSUMED_GAIN by the joint's maximum torque."""
    published = robot.drive_gain_nm_per_a
    return np.where(np.isnan(published), np.interp(robot.max_torque_nm, *ASSUMED_GAIN), published)
