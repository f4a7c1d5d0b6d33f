"""Arm: torque → motion, heat and wear. Rigid bodies by pinocchio, joints by the laws of this room.

One step of length h, second order, from the state (q, v):
q_m = q + h/2·v;  M(q_m)·(v⁺ − v) = h·[τ − n(q_m, v_m) − s − k·(v + v⁺)/2];  q⁺ = q_m + h/2·v⁺
s is dry friction: |sⱼ| ≤ Dⱼ, and sⱼ = Dⱼ·sign(v⁺ⱼ) wherever v⁺ⱼ ≠ 0 (a linear complementarity problem, solved exactly), so a
joint that is held stands still: no creep, no chatter.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from monitor.model.robot import Mounting, Robot
from monitor.recording import Array
from monitor.simulate.friction import REFERENCE_C, SMOOTH_SPEED_RAD_S, FrictionLaw, default_law
from monitor.simulate.thermal import Temperatures, ThermalModel, default_thermal

SETTLE_S = 0.05  # heat and wear are slow
SERVO_RAD_S = 100.0  # bandwidth of the joint servo: friction of 10 N·m bends a base joint by under a milliradian
SERVO_INTEGRAL_PER_S = 25.0  # takes the rest of the error away, and ends the creep after a stop, in a tenth of a second
SERVO_INTEGRAL_MAX_RAD_S2 = 40.0  # as much as friction can ask for
ROTOR_KG_M2_PER_NM = 0.0075  # rotor inertia at the joint per maximum torque: 1.1 kg·m² on a size 3 joint
RATED_LOAD = 0.25  # share of the maximum torque at which wear per revolution is quoted
HEALTHY_WEAR_PER_REVOLUTION = 2e-8  # 1 % in half a million revolutions, some months of hard work
VISCOUS_SHARE_OF_WEAR = 0.5  # metal and seals wear more than oil does
# Kt·G of arms whose torque constants are not published: the simulator's own choice, by joint size (12 … 330 N·m);
# sizes 1 and 3 follow the factory calibration of a UR5e (0.080 and 0.1005 N·m/A at the motor)
ASSUMED_GAIN = ([12.0, 28.0, 56.0, 150.0, 330.0], [4.6, 8.1, 10.5, 10.2, 13.5])
PRODUCTION_LOAD = 0.12  # share of the maximum torque, typical of a job without much payload
PRODUCTION_SPEED_RAD_S = 0.7  # of every joint while a typical job moves
PRODUCTION_MOVING = 0.6  # share of a duty hour in which one joint moves


class Target(NamedTuple):
    """Where the servo is asked to be, each (J,)."""

    q: Array
    qd: Array
    qdd: Array


@dataclass(slots=True, eq=False)
class Wear:
    """Multipliers of dry and viscous friction and what made them, each (J,)."""

    coulomb: Array
    viscous: Array
    per_revolution: Array
    revolutions: Array
    rated_revolutions: Array  # weighted by load

    def use(self, revolutions: Array, load: Array) -> None:
        """Turn by (J,) revolutions under a (J,) load, as a share of the maximum torque."""
        rated = revolutions * load / RATED_LOAD
        self.revolutions += revolutions
        self.rated_revolutions += rated
        self.coulomb += self.per_revolution * rated
        self.viscous += VISCOUS_SHARE_OF_WEAR * self.per_revolution * rated


class Sums:
    """What `settle` gathers until it is worth turning into heat and wear."""

    def __init__(self, joints: int) -> None:
        self.elapsed_s = 0.0
        self.friction_j, self.copper_j, self.travel_rad, self.load_travel = np.zeros((4, joints))


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
        payload_com_m: tuple[float, float, float] = (0.0, 0.0, 0.05),
        law: FrictionLaw | None = None,
        thermal: ThermalModel | None = None,
        wear_per_revolution: Array | None = None,
    ) -> None:
        J = robot.joints
        self.robot, self.ambient_c, self.payload_kg = robot, ambient_c, payload_kg
        self.law = law or default_law(robot)
        self.thermal = thermal or default_thermal(robot)
        self.gain_nm_per_a = drive_gain(robot)
        self.rotor_kg_m2 = ROTOR_KG_M2_PER_NM * robot.max_torque_nm
        self.model = robot.pinocchio_model(mounting)
        self.flange = self.model.getFrameId(f"dh_{J}")
        if payload_kg > 0.0:
            at_flange = self.model.frames[self.flange].placement
            self.model.appendBodyToJoint(J, pin.Inertia(payload_kg, np.array(payload_com_m), np.zeros((3, 3))), at_flange)
        self.model.armature = self.rotor_kg_m2.copy()
        self._data = self.model.createData()

        self.q, self.qd = q.astype(float), np.zeros(J)
        self.qdd = np.zeros(J)
        self.torque_nm = np.zeros(J)  # of the drives, in the middle of the last step
        self.torque_before_nm = np.zeros(J)
        self.friction_nm = np.zeros(J)
        self.temperatures: Temperatures = self.thermal.idle(ambient_c)
        per_revolution = np.full(J, HEALTHY_WEAR_PER_REVOLUTION) if wear_per_revolution is None else wear_per_revolution
        self.wear = Wear(np.ones(J), np.ones(J), per_revolution.astype(float), np.zeros(J), np.zeros(J))
        self.load_nm = np.zeros(J)  # through the gears, link side
        self._sums = Sums(J)
        self._integral = np.zeros(J)
        self._slide = np.zeros(J)  # −1, 0, 1: how each joint slid in the last step
        self._grip()

    # --- motion ---------------------------------------------------------------------------------------------------
    def step(self, h: float, target: Target) -> None:
        """One servo period: computed torque on the true rigid body, PID for what it does not know, which is friction."""
        M, n, q_m, v_m = self._middle(h)
        error = target.q - q_m
        integral = np.minimum(np.maximum(self._integral + h * error, -self._integral_max), self._integral_max)
        wanted = SERVO_RAD_S**2 * (error + SERVO_INTEGRAL_PER_S * integral) + 2.0 * SERVO_RAD_S * (target.qd - v_m) + target.qdd
        limit = self.robot.max_torque_nm
        asked = M @ wanted + n
        given = np.minimum(np.maximum(asked, -limit), limit)
        if (given == asked).all():  # at the limit an integral would only wind up
            self._integral = integral
        self._integrate(h, given, M, n, q_m)

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
        self._slide = np.zeros_like(self.qd)

    def _middle(self, h: float) -> tuple[Array, Array, Array, Array]:
        q_m = self.q + (0.5 * h) * self.qd
        v_m = self.qd + (0.5 * h) * self.qdd
        M: Array = pin.crba(self.model, self._data, q_m)
        n: Array = pin.nonLinearEffects(self.model, self._data, q_m, v_m)
        return M, n.copy(), q_m, v_m

    def _integrate(self, h: float, torque: Array, M: Array, n: Array, q_m: Array) -> None:
        v = self.qd
        qdd = self.qdd
        load = self.load_nm = M @ qdd - self.rotor_kg_m2 * qdd + n  # q̈ of the step before
        D = self._grip_nm + self._grip_load * np.abs(load)
        half = (
            (0.5 * h) * self._thin * (self.law.concave_nm * (v * v + SMOOTH_SPEED_RAD_S**2) ** self._power + self.law.linear_nm_s_per_rad)
        )
        A = M.copy(order="F")
        A.flat[:: len(v) + 1] += half
        b = M @ v - half * v + h * (torque - n)
        after = self._slide_or_stick(A, b, h * D)
        self.qdd = (after - v) / h
        self.friction_nm = torque - n - M @ self.qdd
        self.q, self.qd = q_m + (0.5 * h) * after, after
        self.torque_before_nm, self.torque_nm = self.torque_nm, torque

    def _slide_or_stick(self, A: Array, b: Array, D: Array) -> Array:
        """The only v with A·v = b − s, |s| ≤ D, s = D·sign(v) where v ≠ 0, by principal pivoting from the last step's pattern."""
        z = self._slide
        if z.all():  # all joints slide: nearly always, they go on sliding
            v: Array = dposv(A, b - D * z)[1]
            if (v * z > 0.0).all():
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
        self._slide = z
        result: Array = np.where(z == 0.0, 0.0, v)
        return result

    def _grip(self) -> None:
        """What friction owes to temperature and wear, both constant within a tick."""
        none = np.zeros_like(self.qd)
        self._grip_nm = self.law.dry(none, self.temperatures.grease_c, self.wear.coulomb)
        self._grip_load = self.wear.coulomb * self.law.load_factor
        self._thin = self.wear.viscous * np.exp(-self.law.viscous_per_k * (self.temperatures.grease_c - REFERENCE_C))
        self._power = 0.5 * (self.law.exponent - 1.0)
        self._integral_max = np.full_like(self.qd, SERVO_INTEGRAL_MAX_RAD_S2 / (SERVO_RAD_S**2 * SERVO_INTEGRAL_PER_S))

    # --- heat and wear ------------------------------------------------------------------------------------------
    def settle(self, dt_s: float) -> None:
        """Account for the last dt; every SETTLE_S turn losses into heat and travel into wear."""
        sums = self._sums
        current = self.torque_nm / self.gain_nm_per_a
        speed = np.abs(self.qd)
        sums.elapsed_s += dt_s
        sums.friction_j += dt_s * self.friction_nm * self.qd
        sums.copper_j += dt_s * self.thermal.winding_ohm * current * current
        sums.travel_rad += dt_s * speed
        sums.load_travel += dt_s * speed * np.abs(self.load_nm)
        if sums.elapsed_s < SETTLE_S:
            return
        motor_w = self.thermal.idle_w + sums.copper_j / sums.elapsed_s
        grease_w = np.maximum(sums.friction_j, 0.0) / sums.elapsed_s
        self.temperatures = self.thermal.step(self.temperatures, motor_w, grease_w, self.ambient_c, sums.elapsed_s)
        travel = np.maximum(sums.travel_rad, 1e-12)
        self.wear.use(travel / math.tau, sums.load_travel / travel / self.robot.max_torque_nm)
        self._sums = Sums(self.robot.joints)
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
            motor_w = self.thermal.idle_w + moving * self.thermal.winding_ohm * current * current
            self.temperatures = self.thermal.leap(self.temperatures, motor_w, moving * resisting * speed, ambient_c, dt)
            self.wear.use(moving * speed * dt / math.tau, np.full(self.robot.joints, PRODUCTION_LOAD))
        self._grip()

    # --- truth --------------------------------------------------------------------------------------------------
    def measured_torque_nm(self) -> Array:
        """(J,) drive torque now: the last two steps' carried on to the end of the last."""
        result: Array = 1.5 * self.torque_nm - 0.5 * self.torque_before_nm
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
        data = self.model.createData()
        M = pin.crba(self.model, data, self.q)
        return float(0.5 * self.qd @ M @ self.qd + pin.computePotentialEnergy(self.model, data, self.q))


def drive_gain(robot: Robot) -> Array:
    """(J,) Kt·G [N·m/A]: the published one, else ASSUMED_GAIN by the joint's maximum torque."""
    published = robot.drive_gain_nm_per_a
    return np.where(np.isnan(published), np.interp(robot.max_torque_nm, *ASSUMED_GAIN), published)
