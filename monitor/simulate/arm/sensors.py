"""What the controller measures of the arm: noise and quantisation in place of the truth.

How the figures were derived, from public recordings of real arms. Standing arm of size UR5, 256 samples at 10 Hz: standard
deviation per joint of the current 30, 29, 32, 10, 10, 12 mA (1.48·MAD of the differences over √2: 32, 28, 35, 9, 8, 10 mA), so
30 mA on size 3 and 11 mA on size 1; correlation of successive samples 0.0 on the big joints and 0.3–0.4 on the wrists, here 0.3
from tick to tick, since what lies between is unknown; positions 13–21 µrad; q̇ exactly 0; temperatures in steps of 1/16 K. UR10e on a
Fourier trajectory at 94 Hz, current above 5 Hz (fourth-order Butterworth, both ways): 193, 188, 105, 30, 39, 27 mA, up to three
times as much as its size at rest, and 1.1 to 1.7 times as much above 0.7 rad/s as below 0.1 rad/s: mostly ripple of the gears.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Arm

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
STEP = np.array([[POSITION_STEP_RAD], [SPEED_STEP_RAD_S], [CURRENT_STEP_A], [TEMPERATURE_STEP_K]])
PER_STEP = 1.0 / STEP
BLOCK = 256  # ticks of noise drawn at once
GLITCH_EVERY = 32  # ticks between the wrong temperatures of a glitching sensor


class Measured(NamedTuple):
    """One tick, each (J,)."""

    q: Array
    qd: Array
    current: Array
    temperature_c: Array


@dataclass(slots=True, eq=False)
class SensorFaults:
    """What is wrong with the sensors, on command; nothing of it at the start."""

    frozen_c: Array | None = None  # temperatures as they were when they froze
    glitch_c: dict[int, float] = field(default_factory=dict)  # joint (0 … J−1) → what its sensor says now and then
    stuck_a: dict[int, float] = field(default_factory=dict)  # joint → the current that its sensor goes on telling
    noise_factor: float = 1.0  # multiplies the noise of all currents
    encoder_offset_rad: Array | None = None  # (J,) encoder position minus true position

    @property
    def any(self) -> bool:
        """Whether anything is wrong that `Sensors` does not see to when it draws its noise."""
        return bool(self.glitch_c or self.stuck_a) or self.frozen_c is not None or self.encoder_offset_rad is not None


class Sensors:
    """Reads an arm; deterministic from the seed."""

    def __init__(self, robot: Robot, seed: int, tick_s: float, current_noise: float = 1.0) -> None:
        """`current_noise` multiplies the noise of the currents of the recorded arms."""
        self._dice = np.random.default_rng(seed)
        self._joints = robot.joints
        self._still_a = np.interp(robot.max_torque_nm, *STILL_CURRENT_A)
        self._keep = SLOW_KEEP ** (tick_s / 0.008)
        self._slow = np.zeros(robot.joints)
        self._one, self._ripple = np.ones(robot.joints), np.full(robot.joints, RIPPLE_PER_RAD_S)  # arrays: numpy is quicker with them
        self._ripple_max, self._standstill = np.full(robot.joints, RIPPLE_MAX), np.full(robot.joints, STANDSTILL_RAD_S)
        self._block = np.empty((0, 4, robot.joints))
        self._next = 0
        self.faults = SensorFaults(noise_factor=current_noise)

    def read(self, arm: Arm) -> Measured:
        """One measurement of the present state."""
        if self._next >= len(self._block):
            self._draw()
        noise = self._block[self._next]
        self._next += 1
        speed, seen = np.abs(arm.qd), np.empty(noise.shape)
        seen[0], seen[1], seen[2], seen[3] = arm.q, arm.qd, arm.measured_torque_nm() / arm.gain_nm_per_a, arm.temperatures.motor_c
        noise[2] *= self._one + np.minimum(self._ripple * speed, self._ripple_max)
        seen += noise
        seen *= PER_STEP
        np.rint(seen, out=seen)
        seen *= STEP
        seen[1] *= speed > self._standstill
        measured = Measured(*seen)
        return self._wrong(measured) if self.faults.any else measured

    def _draw(self) -> None:
        """The next block of noise, (BLOCK, 4, J): on position, speed, current, temperature, in their units."""
        white, push, on_q, on_qd, on_temperature = self._dice.standard_normal((BLOCK, 5, self._joints)).transpose(1, 0, 2)
        keep, slow = self._keep, (1.0 - self._keep**2) ** 0.5 * push
        slow[0] += keep * self._slow
        back = 1
        while back < BLOCK:  # slowᵢ = keep·slowᵢ₋₁ + pushᵢ, by doubling the reach of each sum
            slow[back:] += keep**back * slow[:-back].copy()
            back *= 2
        self._slow = slow[-1].copy()
        on_current = self.faults.noise_factor * self._still_a * ((1.0 - SLOW_SHARE) ** 0.5 * white + SLOW_SHARE**0.5 * slow)
        noise = (POSITION_NOISE_RAD * on_q, SPEED_NOISE_RAD_S * on_qd, on_current, TEMPERATURE_NOISE_K * on_temperature)
        self._block, self._next = np.stack(noise, axis=1), 0

    def set_current_noise(self, factor: float) -> None:
        """Multiply the usual noise of the currents by this factor from now on."""
        before, self.faults.noise_factor = self.faults.noise_factor, factor
        if before == 0.0:  # nothing there to be made louder: the rest of the block is drawn anew
            self._next = len(self._block)
            return
        self._block = self._block.copy()
        self._block[self._next :, 2] *= factor / before

    def _wrong(self, right: Measured) -> Measured:
        """What sensors with faults tell instead."""
        faults = self.faults
        if faults.encoder_offset_rad is not None:
            right = right._replace(q=right.q + faults.encoder_offset_rad)
        if faults.frozen_c is not None:
            right = right._replace(temperature_c=faults.frozen_c)
        if faults.glitch_c and self._next % GLITCH_EVERY == 0:
            told = right.temperature_c.copy()
            for joint, value in faults.glitch_c.items():
                told[joint] = value
            right = right._replace(temperature_c=told)
        if faults.stuck_a:
            current = right.current.copy()
            for joint, value in faults.stuck_a.items():
                current[joint] = value
            right = right._replace(current=current)
        return right
