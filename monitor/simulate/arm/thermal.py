"""Heat of the joints. Each joint has two nodes: the motor, where the temperature sensor is, and the grease.

C_m·Ṫ_m = P_m − G_mg·(T_m − T_g) − G_ma·(T_m − T_a),  C_g·Ṫ_g = P_g − G_mg·(T_g − T_m).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array

IDLE_RISE_K = 3.0  # a powered joint at rest is this much warmer than the room, because of brake coil and drive electronics


class Temperatures(NamedTuple):
    """Temperatures of motor and grease, each (J,) [°C]."""

    motor_c: Array
    grease_c: Array


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots, since the modes are a cached property
class ThermalModel:
    """Heat capacities and conductances, each (J,)."""

    motor_j_per_k: Array
    grease_j_per_k: Array
    motor_grease_w_per_k: Array
    motor_room_w_per_k: Array
    winding_ohm: Array  # R; the copper loss is I²·R

    @property
    def idle_w(self) -> Array:
        """(J,) loss of a powered joint at rest [W]."""
        result: Array = IDLE_RISE_K * self.motor_room_w_per_k
        return result

    def idle(self, ambient_c: float) -> Temperatures:
        """The equilibrium of a powered arm at rest in a room of this temperature."""
        level = np.full(len(self.motor_j_per_k), ambient_c + IDLE_RISE_K)
        return Temperatures(level, level.copy())

    def step(self, state: Temperatures, motor_w: Array, grease_w: Array, ambient_c: float, dt_s: float) -> Temperatures:
        """One explicit Euler step. dt must be far below the time constants, which are minutes."""
        across = self.motor_grease_w_per_k * (state.motor_c - state.grease_c)
        to_room = self.motor_room_w_per_k * (state.motor_c - ambient_c)
        motor = state.motor_c + dt_s * (motor_w - across - to_room) / self.motor_j_per_k
        return Temperatures(motor, state.grease_c + dt_s * (grease_w + across) / self.grease_j_per_k)

    def leap(self, state: Temperatures, motor_w: Array, grease_w: Array, ambient_c: float, dt_s: float) -> Temperatures:
        """One exact step of any length under constant powers: the two modes decay towards the steady state."""
        steady_motor = ambient_c + (motor_w + grease_w) / self.motor_room_w_per_k
        steady = np.stack([steady_motor, steady_motor + grease_w / self.motor_grease_w_per_k], axis=1)  # (J, 2)
        rate, modes, inverse = self._modes
        away = np.stack([state.motor_c, state.grease_c], axis=1) - steady
        share = (inverse @ away[..., None])[..., 0] * np.exp(rate * dt_s)
        now = steady + (modes @ share[..., None])[..., 0]
        return Temperatures(now[:, 0], now[:, 1])

    @cached_property
    def _modes(self) -> tuple[Array, Array, Array]:
        """Rates (J, 2) [1/s], modes (J, 2, 2) and their inverse (J, 2, 2)."""
        A = np.empty((len(self.motor_j_per_k), 2, 2))
        A[:, 0, 0] = -(self.motor_grease_w_per_k + self.motor_room_w_per_k) / self.motor_j_per_k
        A[:, 0, 1] = self.motor_grease_w_per_k / self.motor_j_per_k
        A[:, 1, 0] = self.motor_grease_w_per_k / self.grease_j_per_k
        A[:, 1, 1] = -self.motor_grease_w_per_k / self.grease_j_per_k
        rate, modes = np.linalg.eig(A)  # real and negative: A is similar to a symmetric negative definite matrix
        return rate.real, modes.real, np.linalg.inv(modes.real)


def default_thermal(robot: Robot) -> ThermalModel:
    """A thermal model in which mass and surface of a joint are proportional to its torque.

    The slow time constant is about 45 min, that between grease and motor about 3 min. A UR5 that plays the excitation without a pause
    warms by 11–15 K in half an hour, as in Raviola et al. (2021), §4.
    """
    room = 3.6e-3 * robot.max_torque_nm * np.resize(np.array([1.0, 1.15, 1.05, 1.0, 0.95, 1.0]), robot.joints)
    return ThermalModel(
        motor_j_per_k=1900.0 * room,
        grease_j_per_k=1400.0 * room,
        motor_grease_w_per_k=8.0 * room,
        motor_room_w_per_k=room,
        winding_ohm=60.0 / robot.max_torque_nm,
    )
