"""The friction of the simulated joints. Its law is not among the laws that the monitor identifies.

τ_f = {w_c·[Fc(T) + c·|τ_link|] + d}·(1 + σ·e^(−(q̇/v_s)²))·sign(q̇) + w_v·e^(−k(T−25))·[Fv·(|q̇|)^p + fl·|q̇|]·sign(q̇)

T is the temperature of the grease, w_c and w_v are the wear factors of dry and viscous friction, d is the drag of a brake, zero in a
sound joint. The bracket with σ is the Stribeck effect: the dry friction of a joint at rest is (1 + σ) times that of a joint that slides
faster than v_s, so a joint that is pulled slowly by a soft drive sticks and slips. The concave shape follows the factory sweeps of a UR5e
(p ≈ 0.52–0.63 there), the load term follows measurements of a UR10e. The magnitudes are those of the sweeps, scaled by the maximum torque
of each joint.
"""

from dataclasses import dataclass

import numpy as np

from monitor.model.robot import Robot
from monitor.recording import Array

REFERENCE_C = 25.0
SMOOTH_SPEED_RAD_S = 0.01  # the concave term is linear below this speed; otherwise its slope at rest would be infinite
STRIBECK_RAD_S = 0.008  # v_s: boundary lubrication ends far below the speeds of any job


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrictionLaw:
    """Parameters of the law at 25 °C without wear, each (J,)."""

    coulomb_nm: Array
    load_factor: Array  # c, dry friction per transmitted torque
    concave_nm: Array  # Fv, at 1 rad/s
    exponent: Array  # p
    linear_nm_s_per_rad: Array  # fl
    viscous_per_k: Array  # k, relative decrease of viscous friction per kelvin
    coulomb_per_k: Array  # relative decrease of dry friction per kelvin; it is close to zero
    stiction: Array  # σ, what rest adds to dry friction, as a share of it
    stribeck_rad_s: Array  # v_s
    drag_nm: Array  # d, whatever wear, load and temperature are

    def dry(self, load_nm: Array, grease_c: Array, wear: Array) -> Array:
        """Dry friction far above the Stribeck speed, ≥ 0 [N·m]. All (…, J)."""
        warm = 1.0 - self.coulomb_per_k * (grease_c - REFERENCE_C)
        result: Array = wear * (self.coulomb_nm * warm + self.load_factor * np.abs(load_nm)) + self.drag_nm
        return result

    def stribeck_factor(self, qd: Array) -> Array:
        """The Stribeck factor of dry friction: 1 + σ at rest, 1 in motion. All (…, J)."""
        result: Array = 1.0 + self.stiction * np.exp(-((qd / self.stribeck_rad_s) ** 2))
        return result

    def viscous_coefficient(self, qd: Array, grease_c: Array, wear: Array) -> Array:
        """Viscous friction torque divided by q̇, > 0 [N·m·s/rad]. All (…, J)."""
        thin = wear * np.exp(-self.viscous_per_k * (grease_c - REFERENCE_C))
        concave = self.concave_nm * (qd * qd + SMOOTH_SPEED_RAD_S**2) ** (0.5 * (self.exponent - 1.0))
        result: Array = thin * (concave + self.linear_nm_s_per_rad)
        return result

    def torque(self, qd: Array, load_nm: Array, grease_c: Array, wear_coulomb: Array, wear_viscous: Array) -> Array:
        """Friction torque with the sign of the speed; 0 at rest [N·m]. All (…, J)."""
        viscous = self.viscous_coefficient(qd, grease_c, wear_viscous) * qd
        result: Array = np.sign(qd) * self.stribeck_factor(qd) * self.dry(load_nm, grease_c, wear_coulomb) + viscous
        return result


def default_law(robot: Robot) -> FrictionLaw:
    """Plausible friction of any arm: proportional to the maximum torque of the joints, and different for each joint."""
    size = robot.max_torque_nm
    return FrictionLaw(
        coulomb_nm=0.050 * size * _pattern(robot.joints, [1.00, 1.18, 0.88, 1.05, 0.92, 1.14]),
        load_factor=_pattern(robot.joints, [0.040, 0.050, 0.045, 0.035, 0.050, 0.040]),
        concave_nm=0.045 * size * _pattern(robot.joints, [1.00, 1.12, 0.95, 1.10, 0.90, 1.02]),
        exponent=_pattern(robot.joints, [0.65, 0.68, 0.63, 0.66, 0.61, 0.64]),
        linear_nm_s_per_rad=0.026 * size * _pattern(robot.joints, [1.00, 0.94, 1.08, 0.90, 1.05, 1.12]),
        viscous_per_k=_pattern(robot.joints, [0.012, 0.016, 0.014, 0.019, 0.018, 0.015]),
        coulomb_per_k=np.full(robot.joints, 0.0008),
        stiction=_pattern(robot.joints, [0.10, 0.13, 0.11, 0.12, 0.09, 0.12]),
        stribeck_rad_s=np.full(robot.joints, STRIBECK_RAD_S),
        drag_nm=np.zeros(robot.joints),
    )


def _pattern(joints: int, values: list[float]) -> Array:
    return np.resize(np.array(values), joints)


# --- Wear of the simulated joints: dry and viscous friction grow in proportion to revolutions times load ---

RATED_LOAD = 0.25  # load that the wear per revolution refers to, as a share of the maximum torque
HEALTHY_WEAR_PER_REVOLUTION = 2e-8  # 1 % in half a million revolutions, which take some months of hard work
VISCOUS_SHARE_OF_WEAR = 0.5  # viscous friction grows half as fast as dry friction: metal and seals wear more than oil
PRODUCTION_LOAD = 0.12  # load in a typical job with a small payload, as a share of the maximum torque
PRODUCTION_SPEED_RAD_S = 0.7  # speed of a joint that moves in a typical job
PRODUCTION_MOVING = 0.6  # share of the working time in which one joint moves


@dataclass(slots=True, eq=False)
class Wear:
    """The wear factors of dry and viscous friction, and what has caused them, each (J,)."""

    coulomb: Array
    viscous: Array
    per_revolution: Array  # growth of the dry factor per revolution at rated load
    revolutions: Array
    rated_revolutions: Array  # revolutions weighted by load over RATED_LOAD

    @classmethod
    def fresh(cls, joints: int, per_revolution: Array | None) -> "Wear":
        """The wear of a new arm. None for the growth per revolution means that of a healthy arm."""
        rate = np.full(joints, HEALTHY_WEAR_PER_REVOLUTION) if per_revolution is None else per_revolution.astype(float)
        return cls(np.ones(joints), np.ones(joints), rate, np.zeros(joints), np.zeros(joints))

    def use(self, revolutions: Array, load: Array) -> None:
        """Wear by (J,) revolutions under a load (J,), which is a share of the maximum torque."""
        rated = revolutions * load / RATED_LOAD
        self.revolutions += revolutions
        self.rated_revolutions += rated
        self.coulomb += self.per_revolution * rated
        self.viscous += VISCOUS_SHARE_OF_WEAR * self.per_revolution * rated

    def regrease(self, joint: int, recovery: float) -> None:
        """Take away this share of a joint's wear by new grease. The rest stays: metal that was worn off does not come back."""
        self.coulomb[joint] = 1.0 + (self.coulomb[joint] - 1.0) * (1.0 - recovery)
        self.viscous[joint] = 1.0 + (self.viscous[joint] - 1.0) * (1.0 - recovery)

    def renew(self, joint: int) -> None:
        """Replace a joint by a new one, which wears as a healthy joint does."""
        self.coulomb[joint] = self.viscous[joint] = 1.0
        self.per_revolution[joint] = HEALTHY_WEAR_PER_REVOLUTION
        self.revolutions[joint] = self.rated_revolutions[joint] = 0.0


def rated_revolutions_an_hour(duty: float) -> float:
    """Rated revolutions of every joint in one hour of a typical job with this duty, as `Arm.pass_time` counts them."""
    return duty * PRODUCTION_MOVING * PRODUCTION_SPEED_RAD_S * 3600.0 / (2.0 * np.pi) * PRODUCTION_LOAD / RATED_LOAD


# --- The run-in after rest: friction of a joint that has rested is higher, and falls while it moves -----

RUN_S = 15.0  # τ_run
REST_S = 900.0  # τ_rest
MOVING_RAD_S = 0.02  # mean speed of a joint that moves


class RunIn:
    """The run-in of each joint. With ρ = 0 there is none, and `factor` is exactly 1."""

    def __init__(self, joints: int, share: float) -> None:
        """The joints have rested. share : ρ, what rest adds to friction."""
        self.share = share
        self.rested: Array = np.ones(joints)  # r

    @property
    def factor(self) -> Array:
        """(J,) friction over that of the joint that has moved for long."""
        result: Array = 1.0 + self.share * self.rested
        return result

    def pass_by(self, elapsed_s: float, travel_rad: Array) -> None:
        """Let time pass in which each joint travelled so far, (J,)."""
        moving = travel_rad > MOVING_RAD_S * elapsed_s
        run, rest = np.exp(-elapsed_s / RUN_S), np.exp(-elapsed_s / REST_S)
        self.rested = np.where(moving, self.rested * run, 1.0 - (1.0 - self.rested) * rest)

    def pass_production(self, elapsed_s: float, duty: float) -> None:
        """Let time pass in which the arm did a typical job in the share `duty` of it, with short rests in between."""
        moving = duty * PRODUCTION_MOVING
        rate = moving / RUN_S + (1.0 - moving) / REST_S
        level = (1.0 - moving) / REST_S / rate
        self.rested = level + (self.rested - level) * np.exp(-elapsed_s * rate)
