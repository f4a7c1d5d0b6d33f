"""The weights that every replay identifies beside friction, where an arm carries more than anybody declared.

A replay of 30 s determines the rigid base parameters with the standard deviations below: those of `identify` on the full physics of the
simulator. The drives' magnets weaken as they warm, so all weights seem to vary with the season.
"""

from functools import cache

import numpy as np

from monitor.judge.drift.undeclared import MASS_PARAMETERS, RigidFit
from monitor.model.base import base_parameters
from monitor.model.robot import INERTIAL, PER_JOINT, Mounting, load_robot
from monitor.recording import Array

STD = np.array([
    0.039, 0.22, 0.054, 0.005, 0.067, 0.032, 0.011, 0.015, 0.13, 0.045, 0.0035, 0.034,
    0.031, 0.012, 0.014, 0.0054, 0.0015, 0.013, 0.0054, 0.0055, 0.0094, 0.0062, 0.0019, 0.00097,
    0.0045, 0.0019, 0.0018, 0.004, 0.0031, 0.0012, 0.00096, 0.002, 0.0011, 0.0012, 0.0014, 0.0025,
])  # fmt: skip
"""[kg, kg·m, kg·m²] of a UR5's 36 rigid base parameters on the ground."""
MAGNETS_PER_K = 0.001  # by which all weights seem lighter in a warmer motor
CENTRE_M = (0.0, 0.0, 0.05)  # of the mass, from the last joint's frame …
CENTRE_STD_M = 0.03  # … and how it differs from arm to arm


class Weights:
    """Rigid base parameters of every arm and replay; they are drawn as the replays come."""

    def __init__(self, rng: np.random.Generator, carried_kg: Array, motor_c: Array) -> None:
        """carried_kg : (R, A) beyond what is declared at first, motor_c : (R, A, J)."""
        self._columns, self._names, self._of_mass, nominal = _arm()
        self._values = nominal * (1.0 + 0.03 * rng.normal(size=(carried_kg.shape[1], len(nominal))))  # (A, R)
        centre_m = np.array(CENTRE_M) + CENTRE_STD_M * rng.normal(size=(carried_kg.shape[1], 3))
        self._load = np.concatenate([np.ones((len(centre_m), 1)), centre_m], axis=1) @ self._of_mass.T  # (A, R) of one kilogram
        self._carried_kg = carried_kg
        self._scale = np.exp(-MAGNETS_PER_K * (motor_c.mean(axis=2) - 25.0))
        self._seed = int(rng.integers(2**31))

    def fits(self, number: int) -> tuple[RigidFit, ...]:
        """What the replays of that number identify, of each arm."""
        true = (self._values + self._carried_kg[number][:, None] * self._load) * self._scale[number][:, None]
        seen = true + STD * np.random.default_rng((self._seed, number)).normal(size=true.shape)
        return tuple(RigidFit(self._columns, self._names, values, np.diag(STD**2), self._of_mass) for values in seen)


@cache
def _arm() -> tuple[Array, tuple[str, ...], Array, Array]:
    """Columns and names of a UR5's rigid base parameters, what a mass at the flange adds to them, and the manufacturer's values."""
    robot = load_robot("ur5")
    base = base_parameters(robot, Mounting())
    rigid = np.array(base.columns) % PER_JOINT < INERTIAL
    last = PER_JOINT * (robot.joints - 1)
    names = tuple(np.array(base.names)[rigid].tolist())
    values = (base.combination @ robot.nominal_parameters())[rigid]
    return np.array(base.columns, dtype=float)[rigid], names, base.combination[rigid][:, last : last + MASS_PARAMETERS], values
