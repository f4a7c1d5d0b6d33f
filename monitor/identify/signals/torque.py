"""Joint torque, as the drives report it."""

import numpy as np

from monitor.errors import BadInput
from monitor.identify.signals.motion import Motion
from monitor.model.robot import Robot
from monitor.recording import Array

GAIN_NM_PER_A = (1e-3, 1e4)  # plausible torque per ampere: from a small servo to ten times the largest joint of any arm


def joint_torque(motion: Motion, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m] of a motion. Raises BadInput as `drive_torque`, and where the robot has another number of joints."""
    name = motion.source or "recording"
    if motion.q.shape[1] != robot.joints:
        raise BadInput(f"{name}: has {motion.q.shape[1]} joints; {robot.name} has {robot.joints}")
    return drive_torque(name, motion.torque, motion.current, robot, gains)


def drive_torque(name: str, torque: Array | None, current: Array | None, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m]: the measured torque where there is one, else current × gain.

    gains : (J,) torque per ampere at the joint [N·m/A]; None for the published torque constant × gear ratio, Raviola et al. (2021),
    table 2. Raises BadInput where there is neither torque nor current, or gains are missing or implausible.
    """
    if gains is not None and (gains.shape != (robot.joints,) or not np.all((gains >= GAIN_NM_PER_A[0]) & (gains <= GAIN_NM_PER_A[1]))):
        least, most = GAIN_NM_PER_A
        given = np.array2string(np.asarray(gains), separator=",")
        raise BadInput(f"--gains: {given}; expected {robot.joints} numbers between {least:g} and {most:g} [N·m/A]")
    if torque is not None and (gains is None or current is None):
        return torque
    if current is None:
        raise BadInput(f"{name}: holds neither current nor torque; expected actual_current or actual_torque for every joint")
    if gains is None:
        gains = robot.drive_gain_nm_per_a
        if not np.all(np.isfinite(gains)):
            raise BadInput(
                f"{robot.name}: the torque constants of this model are not published; give the joint gains "
                f"as --gains with {robot.joints} numbers [N·m/A], in a configuration as robot.gains_nm_per_a, or record torque"
            )
    driven: Array = current * gains
    return driven
