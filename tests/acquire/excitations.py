"""Small excitations for the tests."""

import numpy as np

from monitor.model.fourier import Excitation
from monitor.model.robot import Mounting


def short(
    *,
    robot: str = "ur5",
    period_s: float = 3.0,
    amplitude_rad: float | None = None,
    joint: int = 0,
    start_speed_rad_s: float = 0.0,
    start_acceleration_rad_s2: float = 0.0,
) -> Excitation:
    """Every joint swings by about 0.2 rad about a pose near the home pose, at rest at both ends.

    `amplitude_rad` and the start values bend one joint's curve: its greatest |q|, and what it does at t = 0.
    """
    w = 2.0 * np.pi / period_s
    # q̇ = a(cos wt − cos 2wt): q̇(0) = 0, and q̈(0) = 0
    a = np.zeros((2, 6))
    a[0] = 0.15 * w * np.array([1.0, -0.8, 1.0, 0.9, -1.0, 1.0])
    a[1] = -a[0]
    b = np.zeros((2, 6))
    offset = np.array([0.1, -1.5, 0.2, -1.4, 0.1, -0.1])
    if amplitude_rad is not None:
        swing = 1.299038  # greatest of sin x − sin(2x)/2
        offset[joint] = 0.0
        a[0, joint], a[1, joint] = amplitude_rad / swing * w, -amplitude_rad / swing * w
    a[0, joint] += start_speed_rad_s
    b[0, joint] += start_acceleration_rad_s2 / w
    return Excitation(
        robot=robot, mounting=Mounting(), period_s=period_s, repetitions=1, offset_rad=offset, a_rad_s=a, b_rad_s=b, source="test"
    )
