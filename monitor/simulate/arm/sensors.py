"""The sensors of the arm: they add noise and quantisation to the true state.

The figures come from public recordings of real arms. A standing UR5, 256 samples at 10 Hz: the standard deviation of the current is
30, 29, 32, 10, 10 and 12 mA per joint (1.48·MAD of the differences over √2 gives 32, 28, 35, 9, 8 and 10 mA), so it is 30 mA on size 3
and 11 mA on size 1. The correlation of successive samples is 0.0 on the big joints and 0.3–0.4 on the wrists; here it is 0.3 from one
control period to the next, since faster changes were not recorded. Positions vary by 13–21 µrad, q̇ is exactly 0, and temperatures come
in steps of 1/16 K. A UR10e on a Fourier trajectory at 94 Hz, current above 5 Hz (fourth-order Butterworth, forwards and backwards):
193, 188, 105, 30, 39 and 27 mA. This is up to three times the noise of these sizes at rest, and 1.1 to 1.7 times as much above
0.7 rad/s as below 0.1 rad/s; most of it is ripple of the gears.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array
from monitor.simulate.arm.physics import Arm

# maximum torque of the joint [N·m], standard deviation of the current at rest [A]
STILL_CURRENT_A = ([12.0, 28.0, 56.0, 150.0, 330.0], [0.009, 0.011, 0.018, 0.030, 0.060])
RIPPLE_PER_RAD_S = 2.0  # the noise of the current grows by this share per rad/s
RIPPLE_MAX = 2.0  # and by this share at most
SLOW_SHARE = 0.5  # share of the variance that is a first-order process; the rest is white, which gives a correlation of 0.3
SLOW_KEEP = 0.6  # correlation of the first-order process over 8 ms
CURRENT_STEP_A = 1e-3
POSITION_NOISE_RAD = 1.5e-5
POSITION_STEP_RAD = 2.0**-20
SPEED_NOISE_RAD_S = 4e-4  # only while the joint moves
SPEED_STEP_RAD_S = 1e-6
ZERO_SPEED_RAD_S = 1e-4  # below this speed the sensor shows exactly zero
TEMPERATURE_NOISE_K = 0.02
TEMPERATURE_STEP_K = 1.0 / 16.0
STEP = np.array([[POSITION_STEP_RAD], [SPEED_STEP_RAD_S], [CURRENT_STEP_A], [TEMPERATURE_STEP_K]])
PER_STEP = 1.0 / STEP
BLOCK = 256  # control periods for which noise is drawn at once
GLITCH_EVERY = 32  # control periods between two wrong temperatures of a faulty sensor


class Measured(NamedTuple):
    """One reading of the sensors, each (J,)."""

    q: Array
    qd: Array
    current: Array
    temperature_c: Array


@dataclass(slots=True, eq=False)
class SensorFaults:
    """The present faults of the sensors."""

    frozen_c: Array | None = None  # (J,) temperatures that the sensors show instead of the true ones
    glitch_c: dict[int, float] = field(default_factory=dict)  # joint (0 … J−1) → the wrong temperature that its sensor sometimes shows
    stuck_a: dict[int, float] = field(default_factory=dict)  # joint → the current that its sensor shows all the time
    noise_factor: float = 1.0  # multiplies the noise of all currents
    encoder_offset_rad: Array | None = None  # (J,) encoder position minus true position

    @property
    def any(self) -> bool:
        """Whether a reading must be changed. The noise factor does not count: it is part of the drawn noise."""
        return bool(self.glitch_c or self.stuck_a) or self.frozen_c is not None or self.encoder_offset_rad is not None


class Sensors:
    """Reads an arm. Equal seeds give equal noise."""

    def __init__(self, robot: Robot, seed: int, tick_s: float, current_noise: float = 1.0) -> None:
        """`current_noise` multiplies the noise of the currents of the recorded arms."""
        self._dice = np.random.default_rng(seed)
        self._joints = robot.joints
        self._still_a = np.interp(robot.max_torque_nm, *STILL_CURRENT_A)
        self._keep = SLOW_KEEP ** (tick_s / 0.008)
        self._slow = np.zeros(robot.joints)
        # arrays instead of numbers, because numpy is faster with them
        self._one, self._ripple = np.ones(robot.joints), np.full(robot.joints, RIPPLE_PER_RAD_S)
        self._ripple_max, self._standstill = np.full(robot.joints, RIPPLE_MAX), np.full(robot.joints, ZERO_SPEED_RAD_S)
        self._block = np.empty((0, 4, robot.joints))
        self._next = 0
        self.faults = SensorFaults(noise_factor=current_noise)

    def read(self, arm: Arm) -> Measured:
        """Measure the present state of the arm."""
        if self._next >= len(self._block):
            self._draw()
        noise = self._block[self._next]
        self._next += 1
        speed, values = np.abs(arm.qd), np.empty(noise.shape)
        values[0], values[1] = arm.encoders()
        values[2], values[3] = arm.measured_torque_nm() / arm.true_gain_nm_per_a, arm.temperatures.motor_c
        noise[2] *= self._one + np.minimum(self._ripple * speed, self._ripple_max)
        values += noise
        values *= PER_STEP
        np.rint(values, out=values)
        values *= STEP
        values[1] *= speed > self._standstill
        measured = Measured(*values)
        return self._with_faults(measured) if self.faults.any else measured

    def _draw(self) -> None:
        """Draw the next block of noise (BLOCK, 4, J): of position, speed, current and temperature, in their units."""
        white, driving, on_q, on_qd, on_temperature = self._dice.standard_normal((BLOCK, 5, self._joints)).transpose(1, 0, 2)
        keep, slow = self._keep, (1.0 - self._keep**2) ** 0.5 * driving
        slow[0] += keep * self._slow
        back = 1
        while back < BLOCK:  # slowᵢ = keep·slowᵢ₋₁ + drivingᵢ, computed by doubling the length of the partial sums
            slow[back:] += keep**back * slow[:-back].copy()
            back *= 2
        self._slow = slow[-1].copy()
        on_current = self.faults.noise_factor * self._still_a * ((1.0 - SLOW_SHARE) ** 0.5 * white + SLOW_SHARE**0.5 * slow)
        noise = (POSITION_NOISE_RAD * on_q, SPEED_NOISE_RAD_S * on_qd, on_current, TEMPERATURE_NOISE_K * on_temperature)
        self._block, self._next = np.stack(noise, axis=1), 0

    def set_current_noise(self, factor: float) -> None:
        """Multiply the usual noise of the currents by this factor from now on."""
        before, self.faults.noise_factor = self.faults.noise_factor, factor
        if before == 0.0:  # no noise that could be scaled: the next reading draws a new block
            self._next = len(self._block)
            return
        self._block = self._block.copy()
        self._block[self._next :, 2] *= factor / before

    def _with_faults(self, reading: Measured) -> Measured:
        """The reading of sensors with faults."""
        faults = self.faults
        if faults.encoder_offset_rad is not None:
            reading = reading._replace(q=reading.q + faults.encoder_offset_rad)
        if faults.frozen_c is not None:
            reading = reading._replace(temperature_c=faults.frozen_c)
        if faults.glitch_c and self._next % GLITCH_EVERY == 0:
            temperature = reading.temperature_c.copy()
            for joint, value in faults.glitch_c.items():
                temperature[joint] = value
            reading = reading._replace(temperature_c=temperature)
        if faults.stuck_a:
            current = reading.current.copy()
            for joint, value in faults.stuck_a.items():
                current[joint] = value
            reading = reading._replace(current=current)
        return reading
