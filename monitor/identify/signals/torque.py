"""Joint torque, as the drives report it."""

import numpy as np

from monitor.errors import BadInput
from monitor.identify.signals.motion import Motion
from monitor.model.robot import Robot
from monitor.recording import Array

GAIN_NM_PER_A = (1e-3, 1e4)  # plausible torque per ampere: from a small servo to ten times the largest joint of any arm


def joint_torque(motion: Motion, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m]: the measured torque where there is one, else current × gain.

    gains : (J,) torque per ampere at the joint [N·m/A]; None for the published torque constant × gear ratio, Raviola et al. (2021),
    table 2. Raises BadInput where gains are missing or implausible, or the motion has another number of joints than the robot.
    """
    name = motion.source or "recording"
    if motion.q.shape[1] != robot.joints:
        raise BadInput(f"{name}: has {motion.q.shape[1]} joints; {robot.name} has {robot.joints}")
    if gains is not None and (gains.shape != (robot.joints,) or not np.all((gains >= GAIN_NM_PER_A[0]) & (gains <= GAIN_NM_PER_A[1]))):
        least, most = GAIN_NM_PER_A
        given = np.array2string(np.asarray(gains), separator=",")
        raise BadInput(f"--gains: {given}; expected {robot.joints} numbers between {least:g} and {most:g} [N·m/A]")
    if motion.torque is not None and (gains is None or motion.current is None):
        return motion.torque
    if motion.current is None:  # `motion` lets no such recording through
        raise BadInput(f"{name}: holds neither current nor torque")
    if gains is None:
        gains = robot.drive_gain_nm_per_a
        if not np.all(np.isfinite(gains)):
            raise BadInput(
                f"{robot.name}: the torque constants of this model are not published; give the joint gains "
                f"as --gains with {robot.joints} numbers [N·m/A], in a configuration as robot.gains_nm_per_a, or record torque"
            )
    torque: Array = motion.current * gains
    return torque
