"""Torque that an arm needs in one state: by its own model, or by the manufacturer's parameters with typical friction."""

from typing import NamedTuple, Protocol

import numpy as np

from monitor.judge.torque.model import CompensatedModel
from monitor.judge.torque.predictor import Predictor
from monitor.model.robot import STANDARD_GRAVITY_M_S2, Mounting, Robot
from monitor.recording import Array

# typical friction of harmonic drives, as shares of the joint's largest torque: that of a UR5e by its factory calibration is
# 0.04 + 0.035·|q̇|^0.68, that of worn and of older arms is more
COULOMB, VISCOUS, EXPONENT = 0.045, 0.045, 2.0 / 3.0
ROTOR_KG_M2_PER_NM = 0.007  # rotor inertia at the joint over its largest torque: 1.0 kg·m² for 150 N·m
UNKNOWN_COM_M = 0.15  # the centre of mass of a payload is within so much of the flange where nobody says where it is
STILL_RAD_S = 0.02  # the sign of friction is smooth within this speed
KNOWN_COM_M = 0.03  # what remains where somebody does


class AtRow(NamedTuple):
    """Torque in one state, (J,) each [N·m]."""

    torque: Array  # with friction
    friction: Array  # its friction, with the sign of the speed
    coulomb_nm: Array  # friction that a slow joint has, ≥ 0


class ExpectedTorque(Protocol):
    """What knows the torque of an arm."""

    payload_nm: Array  # (J,) largest torque of what is not known of the payload [N·m]

    def at(self, q: Array, qd: Array, qdd: Array, temperature_c: Array, /) -> AtRow:
        """Torque in one state; (J,) each [rad, rad/s, rad/s², °C]."""


def expected_torque(
    robot: Robot,
    mounting: Mounting,
    model: CompensatedModel | None,
    *,
    payload_kg: float,
    payload_com_m: tuple[float, float, float] | None,
    payload_error_kg: float,
) -> ExpectedTorque:
    """By the model where there is one; else by the manufacturer's parameters."""
    reach_m = _reach_m(robot)
    error_nm = STANDARD_GRAVITY_M_S2 * payload_error_kg * reach_m
    if model is not None:
        return _ByModel(robot, model, error_nm)
    com_error_m = UNKNOWN_COM_M if payload_com_m is None else KNOWN_COM_M
    payload_nm = error_nm + STANDARD_GRAVITY_M_S2 * payload_kg * com_error_m
    return _ByManufacturer(robot, mounting, payload_kg, payload_com_m or (0.0, 0.0, 0.0), payload_nm)


def _reach_m(robot: Robot) -> Array:
    """(J,) how far the flange can be from each joint's axis: the lengths of the links after it [m]."""
    lengths = np.hypot(robot.a_m, robot.d_m)
    return np.array([np.sum(lengths[j:]) for j in range(robot.joints)])


class TypicalFriction:
    """Friction of an arm that nobody has identified."""

    def __init__(self, most_nm: Array) -> None:
        """most_nm : (J,) largest torque of the joints; 0 where a joint has none of this friction."""
        self.coulomb_nm, self._viscous = COULOMB * most_nm, VISCOUS * most_nm

    def at(self, qd: Array) -> Array:
        """(J,) at speeds qd (J,) [N·m]."""
        friction: Array = self.coulomb_nm * np.tanh(qd / STILL_RAD_S) + self._viscous * np.sign(qd) * np.abs(qd) ** EXPONENT
        return friction


class JointInertia:
    """Inertia of the arm at its joints by the manufacturer's parameters, with typical rotors."""

    def __init__(self, robot: Robot, mounting: Mounting) -> None:
        import pinocchio as pin

        self._arm = robot.pinocchio_model(mounting)
        self._data, self._crba = self._arm.createData(), pin.crba
        self._rotor = np.diag(ROTOR_KG_M2_PER_NM * robot.max_torque_nm)

    def at(self, q: Array) -> Array:
        """(J, J) at q (J,) [kg·m²]."""
        inertia: Array = self._crba(self._arm, self._data, q) + self._rotor
        return inertia


class _ByModel:
    """The temperature-compensated model; without temperatures, at its reference temperature."""

    def __init__(self, robot: Robot, model: CompensatedModel, payload_nm: Array) -> None:
        self.payload_nm = payload_nm
        self._predictor = Predictor(model, robot)
        self._reference_c = np.broadcast_to(np.asarray(model.viscous.reference_c, dtype=float), (robot.joints,))
        known = [law.at(self._reference_c).value for law in (model.coulomb, model.viscous)]
        unknown = ~np.all(np.isfinite(known), axis=0)  # a joint whose friction was never identified has the typical one
        self._typical = TypicalFriction(np.where(unknown, robot.max_torque_nm, 0.0)) if unknown.any() else None
        self._coulomb_nm = np.where(unknown, COULOMB * robot.max_torque_nm, model.coulomb_at(self._reference_c).value)

    def at(self, q: Array, qd: Array, qdd: Array, temperature_c: Array, /) -> AtRow:
        temperature_c = np.where(np.isfinite(temperature_c), temperature_c, self._reference_c)
        found = self._predictor.sample(q.tolist(), qd.tolist(), qdd.tolist(), temperature_c.tolist())
        torque, friction = np.array(found.torque), np.array(found.friction)
        if self._typical is not None:
            torque, friction = torque + self._typical.at(qd), friction + self._typical.at(qd)
        return AtRow(torque, friction, self._coulomb_nm)


class _ByManufacturer:
    """Recursive Newton–Euler with the published parameters, the payload as a point mass, typical rotors and friction."""

    def __init__(self, robot: Robot, mounting: Mounting, payload_kg: float, com_m: tuple[float, float, float], payload_nm: Array) -> None:
        import pinocchio as pin

        self.payload_nm = payload_nm
        self._arm = robot.pinocchio_model(mounting)
        if payload_kg > 0.0:
            flange = self._arm.frames[self._arm.getFrameId(f"dh_{robot.joints}")].placement
            self._arm.appendBodyToJoint(robot.joints, pin.Inertia(payload_kg, np.array(com_m), np.zeros((3, 3))), flange)
        self._data, self._rnea = self._arm.createData(), pin.rnea
        most = robot.max_torque_nm
        self._rotor, self._friction = ROTOR_KG_M2_PER_NM * most, TypicalFriction(most)

    def at(self, q: Array, qd: Array, qdd: Array, _temperature_c: Array, /) -> AtRow:
        friction = self._friction.at(qd)
        return AtRow(self._rnea(self._arm, self._data, q, qd, qdd) + self._rotor * qdd + friction, friction, self._friction.coulomb_nm)
