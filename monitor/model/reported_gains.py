"""Joint gains that others have reported of one arm of a model whose manufacturer publishes none. They are a beginning, not this arm's own.

A gain is the torque at the joint for one ampere: the motor's torque constant times the gear ratio [N·m/A].
"""

from typing import NamedTuple


class ReportedGains(NamedTuple):
    """Gains of one arm, and where they were reported."""

    values_nm_per_a: tuple[float, ...]  # (J,)
    source: str  # a sentence that can stand as a comment beside the figures


REPORTED_GAINS = {
    "ur5e": ReportedGains(
        (10.15, 10.15, 10.13, 8.10, 8.20, 8.08),
        "of another UR5e: the torque constants of its factory calibration, 0.080 to 0.1005 N·m/A, as published with the project AURT "
        "(github.com/INTO-CPS-Association/aurt), times the gear ratio 101",
    ),
    "ur10e": ReportedGains(
        (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
        "of another arm: the drive gains with which the authors of github.com/shamilmamedov/dynamic_calibration began for a UR10e; "
        "they found better ones of their own arm from a known payload",
    ),
}
