"""The figures that the paper prints: Raviola et al., Robotics 2021, 10, 83.

Only the report of the reproduction reads them. Nothing that identifies or judges does.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from monitor.model.robot import Robot

TITLE = (
    "Raviola et al., Effects of Temperature and Mounting Configuration on the Dynamic Parameters Identification of Industrial Robots, "
    "Robotics 2021, 10, 83"
)
COUNTS = {"ground": 52, "ceiling": 52, "wall": 54}  # base parameters, §2.3
# standard parameters that are identifiable alone, identifiable in combination, and without effect, as the paper counts them
CLASSES = {"ground": (30, 39, 9), "wall": (30, 42, 6)}
CEILING_CONDITION = 0.5  # condition number on the ceiling over that on the ground, about; figure 2
SAMPLES = 3750  # N of its e_N: 30 s at 125 Hz
LS_S, WLS_S = 0.05, 138.9  # time to solve [s]
UNCHANGED = 40  # base parameters that do not change with temperature: all but fc and fv
WARM_UP_MIN = 30.0  # length of its warm-up [min]
# e_N [N·m] of table 8: ground, ceiling with its own regressor, ceiling with the ground's regressor
TRANSFER = (0.0043, 0.0050, 0.6144)


@dataclass(frozen=True, slots=True, kw_only=True)
class Printed:
    """The tables of one robot; tuples of six hold joints 1 to 6."""

    validation: tuple[float, float, float]  # e_N [N·m] before identification, by LS, by WLS; table 3
    viscous_change: tuple[float, ...]  # of fv over the campaign, as a fraction
    average_nm: tuple[float, ...]  # change of joint torque from cold to warm
    largest_nm: tuple[float, ...]  # of the same change
    share: Mapping[int, float]  # by joint size: the largest change over the maximum joint torque
    cold_c: tuple[float, ...] | None = None  # joint temperatures before the warm-up; None where the paper prints none
    warm_c: tuple[float, ...] | None = None  # after 30 minutes
    # of fv, of a real arm of another laboratory, from recordings of one evening 35 minutes apart; None: nobody published any.
    # `python -m tests.evidence.real_arms warm-up` finds it, and a test holds it where the recordings are
    elsewhere_change: tuple[float, ...] | None = None


PRINTED = {
    "ur3": Printed(
        validation=(0.1945, 0.0247, 0.0258),
        viscous_change=(-0.106, -0.116, -0.195, -0.264, -0.255, -0.239),
        average_nm=(0.27, 0.42, 0.59, 0.40, 0.41, 0.39),
        largest_nm=(1.02, 1.25, 1.17, 0.87, 1.03, 0.79),
        share={2: 0.020, 1: 0.042, 0: 0.075},
        elsewhere_change=(-0.095, -0.103, -0.147, -0.314, -0.288, -0.254),
    ),
    "ur5": Printed(
        validation=(0.4207, 0.0530, 0.0553),
        viscous_change=(-0.088, -0.210, -0.136, -0.235, -0.211, -0.155),
        average_nm=(0.70, 2.43, 1.45, 0.46, 0.72, 0.40),
        largest_nm=(3.09, 10.90, 4.75, 1.49, 1.57, 0.98),
        share={3: 0.042, 1: 0.048},
        cold_c=(25.2, 24.9, 22.2, 26.1, 22.4, 23.2),
        warm_c=(36.5, 34.6, 32.6, 37.9, 39.7, 40.1),
    ),
}

ERRATA = (
    "UR3's second row must read m1z1 − 4.104·J2xz: the factor is the inverse of its own upper arm; 2.353 belongs to the UR5.",
    "By columns the ground splits 36 / 33 / 9 and a wall 37 / 34 / 7. The paper counts a first moment as a product, so as combined, and "
    "on the wall m1 as combined too, though m1 alone shows in no torque; both ways of counting are below.",
    "e_N = √(eᵀe)/N falls with 1/√N, so it is compared at the paper's own N, and the RMS stands beside it.",
    "The paper's d_i leaves out the scale of the noise; its 138.9 s for WLS come from a dense W, where scaling the rows is enough.",
)


def appendix(robot: Robot) -> dict[str, dict[str, float]]:
    """Rows of equations A1 and A2 that contain lengths of the arm, as formulas of these lengths.

    Returns for the name of each leading parameter the coefficients of the other parameters in its combination.
    """
    a2, a3 = abs(robot.a_m[1]), abs(robot.a_m[2])
    d4, d5, d6 = (float(d) for d in robot.d_m[3:])
    return {
        "m1z1": {"J2xz": -1 / a2},
        "m2": {"J2zz": -1 / a2**2, "Im2": -1 / a2**2, "J3zz": 1 / a3**2},
        "m2x2": {"J2zz": -1 / a2, "Im2": -1 / a2},
        "m2z2": {"J2xz": 1 / a2, "J3xz": -1 / a3},
        "m3": {"J3zz": -1 / a3**2, "m4": 1.0, "m5": 1.0, "m6": 1.0},
        "m3x3": {"J3zz": -1 / a3},
        "m3z3": {"J3xz": 1 / a3, "m4": d4, "m4y4": 1.0, "m5": d4, "m6": d4},
        "m4z4": {"m5": d5, "m5y5": -1.0, "m6": d5},
        "J4yy": {"m5": d5**2, "m5y5": -2 * d5, "J5zz": 1.0, "m6": d5**2},
        "m5z5": {"m6": d6, "m6z6": 1.0},
        "J5yy": {"m6": d6**2, "m6z6": 2 * d6, "J6yy": 1.0},
    }


def furthest(terms: Mapping[str, float], printed: Mapping[str, float]) -> float:
    """The largest difference between coefficients of a row; infinite where one row has a term that the other does not have."""
    if set(terms) != set(printed):
        return math.inf
    return max(abs(terms[name] - value) for name, value in printed.items())
