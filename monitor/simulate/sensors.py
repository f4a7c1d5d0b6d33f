"""What the controller measures of the arm: noise and quantisation in place of the truth.

Figures come from public recordings of real arms. Current at standstill (10 Hz): 0.030 A on the three big joints, 0.010 A on the
wrists, successive samples correlated by 0.3 on the wrists. Moving (UR10e, 100 Hz, above 5 Hz): about three times as much, which
is mostly torque ripple of the gear. Encoder at standstill: 13–21 µrad. q̇ is exactly zero at standstill. Temperatures: steps
of 1/16 K.
"""

from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.physics import Arm

STILL_CURRENT_A = ([12.0, 28.0, 56.0, 150.0, 330.0], [0.009, 0.011, 0.018, 0.030, 0.060])  # by the joint's maximum torque [N·m]
RIPPLE_PER_RAD_S = 2.0  # current noise grows by this share per rad/s, up to RIPPLE_MAX
RIPPLE_MAX = 2.0
SLOW_SHARE = 0.5  # of the variance is a first-order process, the rest white: together 0.3 from sample to sample
SLOW_KEEP = 0.6  # per sample of 8 ms
CURRENT_STEP_A = 1e-3
POSITION_NOISE_RAD = 1.5e-5
POSITION_STEP_RAD = 2.0**-20
SPEED_NOISE_RAD_S = 4e-4  # only while moving
SPEED_STEP_RAD_S = 1e-6
STANDSTILL_RAD_S = 1e-4
TEMPERATURE_NOISE_K = 0.02
TEMPERATURE_STEP_K = 1.0 / 16.0
BLOCK = 256  # ticks of noise drawn at once


class Measured(NamedTuple):
    """One tick, each (J,)."""

    q: Array
    qd: Array
    current: Array
    temperature_c: Array


class Sensors:
    """Reads an arm; deterministic from the seed."""

    def __init__(self, robot: Robot, seed: int, tick_s: float) -> None:
        self._dice = np.random.default_rng(seed)
        self._joints = robot.joints
        self._still_a = np.interp(robot.max_torque_nm, *STILL_CURRENT_A)
        self._keep = SLOW_KEEP ** (tick_s / 0.008)
        self._slow = np.zeros(robot.joints)
        self._block = np.empty((0, 5, robot.joints))
        self._next = 0

    def read(self, arm: Arm) -> Measured:
        """One measurement of the present state."""
        if self._next >= len(self._block):
            self._block, self._next = self._dice.standard_normal((BLOCK, 5, self._joints)), 0
        white, push, on_q, on_qd, on_temperature = self._block[self._next]
        self._next += 1
        keep = self._keep
        self._slow = keep * self._slow + (1.0 - keep * keep) ** 0.5 * push
        ripple = 1.0 + np.minimum(RIPPLE_PER_RAD_S * np.abs(arm.qd), RIPPLE_MAX)
        noise = self._still_a * ripple * ((1.0 - SLOW_SHARE) ** 0.5 * white + SLOW_SHARE**0.5 * self._slow)
        current = arm.measured_torque_nm() / arm.gain_nm_per_a + noise
        moving = np.abs(arm.qd) > STANDSTILL_RAD_S
        return Measured(
            q=np.rint((arm.q + POSITION_NOISE_RAD * on_q) / POSITION_STEP_RAD) * POSITION_STEP_RAD,
            qd=np.where(moving, np.rint((arm.qd + SPEED_NOISE_RAD_S * on_qd) / SPEED_STEP_RAD_S) * SPEED_STEP_RAD_S, 0.0),
            current=np.rint(current / CURRENT_STEP_A) * CURRENT_STEP_A,
            temperature_c=np.rint((arm.temperatures.motor_c + TEMPERATURE_NOISE_K * on_temperature) / TEMPERATURE_STEP_K)
            * TEMPERATURE_STEP_K,
        )
