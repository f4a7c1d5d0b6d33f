"""What an arm publishes beside its motion: ideal values, or values as they were recorded from real arms.

The figures of `Recorded` come from public recordings:
- a UR5 that stands, 256 rows at 10 Hz: accelerometer 9.275 m/s² long and 0.7° off, noise 0.05–0.06 m/s², steps of 1/512 g; 47.73 ± 0.02 V
  at the supply, 47.3–47.6 V at the joints; 0.55 ± 0.04 A; 0.43 ± 0.02 ms of computation; a force at the tool of 0.5 N ± 0.15 N where
  nothing touches it; `joint_control_output` equal to `target_current`; a joint that stands pulls up to 0.17 A against its friction
- a UR3e in pick-and-place, 888 rows at 25 Hz: `speed_scaling` 0 in all 164 rows without a program and in 2 of 724 rows with one, else 1;
  a joint that stands pulls up to ±0.58 A more than gravity needs; wrist 3 at +4π
- UR10e and UR3e in motion: `target_current` is target moment/gain plus friction of 0.045–0.060 of a joint's maximum torque, and
  0.04–0.07 of it per rad/s; at rest it holds no friction
"""

import numpy as np

from monitor.model.robot import STANDARD_GRAVITY_M_S2, Robot
from monitor.recording import Array
from monitor.simulate.settings import SimulateSettings

SUPPLY_V = 48.0
ELECTRONICS_A = 0.9  # current of the electronics of the whole arm

ACCELEROMETER_SHARE = 9.27 / STANDARD_GRAVITY_M_S2  # what the recorded accelerometer shows of gravity
ACCELEROMETER_OFF_M_S2 = np.array([-0.07, 0.0, 0.09])  # and its offset
ACCELEROMETER_NOISE_M_S2, ACCELEROMETER_STEP_M_S2 = 0.055, STANDARD_GRAVITY_M_S2 / 512.0
MAIN_V, ROBOT_V, VOLTAGE_NOISE_V = 47.73, 47.78, 0.018
JOINT_V = np.array([47.62, 47.64, 47.57, 47.51, 47.62, 47.33])
RECORDED_ELECTRONICS_A, CURRENT_NOISE_A = 0.55, 0.04
EXECUTION_MS, EXECUTION_NOISE_MS = 0.43, 0.02
TOOL_FORCE = np.array([0.48, -0.02, -0.23, -0.0014, 0.0008, -0.012])  # [N] and [N·m]
TOOL_FORCE_NOISE = np.array([0.15, 0.087, 0.137, 0.0038, 0.0028, 0.0034])
COULOMB_SHARE, VISCOUS_SHARE = 0.055, 0.05  # friction in `target_current`, as a share of the maximum torque; the second per rad/s
FRICTION_SMOOTH_RAD_S = 0.01  # below this speed the friction in `target_current` fades
START_S = (0.004, 0.020)  # `speed_scaling` stays 0 for so long after a program's start
# torque with which a joint that stands pulls against its friction, as a share of the maximum torque: 0.15 A on size 3, 0.05 A on size 1
HELD_SHARE = np.array([-0.013, -0.014, -0.015, -0.009, 0.0, -0.008])


class Personality:
    """What an arm publishes beside its motion. This one is ideal: no forces at the tool, constant voltages, an exact accelerometer."""

    def __init__(self, robot: Robot) -> None:
        self._nothing = np.zeros(robot.joints)
        self._voltages = np.full(2 + robot.joints, SUPPLY_V)
        self._execution_ms = 250.0 / robot.rate_hz

    def start_s(self) -> float:
        """For how long `speed_scaling` stays 0 after a program's start [s]."""
        return 0.0

    def held_nm(self) -> Array:
        """(J,) torque beyond gravity with which the arm that was just switched on stands against its friction [N·m]."""
        return self._nothing

    def accelerometer(self, at_rest: Array) -> Array:
        """(3,) reading of the accelerometer where an ideal one shows `at_rest` [m/s²]."""
        return at_rest

    def target_friction_nm(self, target_qd: Array) -> Array:  # noqa: ARG002 - `Recorded` reads it
        """(J,) friction that the controller includes in `target_current` at these target speeds [N·m]."""
        return self._nothing

    def voltages(self) -> Array:
        """(8,) main voltage, robot voltage and the voltages of the joints [V]."""
        return self._voltages

    def supply_a(self, drives_a: float) -> float:
        """Current of the whole arm, where the drives draw `drives_a` [A]."""
        return ELECTRONICS_A + drives_a

    def tool_force(self) -> Array:
        """(6,) force and torque that the controller estimates at a tool that nothing touches [N, N·m]."""
        return self._nothing

    def execution_ms(self) -> float:
        """How long the controller computes in a control period [ms]."""
        return self._execution_ms


class Recorded(Personality):
    """An arm as recorded. The numbers are drawn from the seed, apart from the noise of the sensors."""

    def __init__(self, robot: Robot, seed: int) -> None:
        super().__init__(robot)
        self._max_nm = robot.max_torque_nm
        self._joints = robot.joints
        self._dice = np.random.default_rng([seed, 20])  # a stream of its own
        self._supply = np.concatenate([[MAIN_V, ROBOT_V], np.resize(JOINT_V, robot.joints)])

    def start_s(self) -> float:
        """A draw from START_S."""
        return float(self._dice.uniform(*START_S))

    def held_nm(self) -> Array:
        """(J,) as recorded, by the size of the joint."""
        held: Array = np.resize(HELD_SHARE, self._joints) * self._max_nm
        return held

    def accelerometer(self, at_rest: Array) -> Array:
        """(3,) too short, a little off, noisy and in steps."""
        noisy = ACCELEROMETER_SHARE * at_rest + ACCELEROMETER_OFF_M_S2 + ACCELEROMETER_NOISE_M_S2 * self._dice.standard_normal(3)
        stepped: Array = ACCELEROMETER_STEP_M_S2 * np.rint(noisy / ACCELEROMETER_STEP_M_S2)
        return stepped

    def target_friction_nm(self, target_qd: Array) -> Array:
        """(J,) the controller's own model of friction, which neither temperature nor wear changes."""
        friction: Array = self._max_nm * (COULOMB_SHARE * np.tanh(target_qd / FRICTION_SMOOTH_RAD_S) + VISCOUS_SHARE * target_qd)
        return friction

    def voltages(self) -> Array:
        """(8,) with noise."""
        noisy: Array = self._supply + VOLTAGE_NOISE_V * self._dice.standard_normal(len(self._supply))
        return noisy

    def supply_a(self, drives_a: float) -> float:
        """Electronics and drives, with noise."""
        return RECORDED_ELECTRONICS_A + drives_a + CURRENT_NOISE_A * float(self._dice.standard_normal())

    def tool_force(self) -> Array:
        """(6,) not zero, with noise."""
        noisy: Array = TOOL_FORCE + TOOL_FORCE_NOISE * self._dice.standard_normal(6)
        return noisy

    def execution_ms(self) -> float:
        """With noise."""
        return EXECUTION_MS + EXECUTION_NOISE_MS * abs(float(self._dice.standard_normal()))


def personality_of(settings: SimulateSettings) -> Personality:
    """The personality that the settings name."""
    return Recorded(settings.arm, settings.seed) if settings.personality == "recorded" else Personality(settings.arm)
