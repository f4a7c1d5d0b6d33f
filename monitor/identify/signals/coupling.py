"""Recordings of arms whose motors are coupled, in the positions of the motors."""

from dataclasses import replace

from monitor.model.robot import Robot
from monitor.recording import Array, Recording


def at_motors(recording: Recording, robot: Robot) -> Recording:
    """The recording with the positions of the motors, each in units of its own joint, where it holds those of coupled joints.

    Currents are those of the motors already. In these coordinates friction belongs to one motor alone, and so does its ripple.
    """
    if robot.coupling is None or robot.recorded_at_motors or recording.joints != robot.joints:
        return recording

    def moved(x: Array | None) -> Array | None:
        return None if x is None else robot.motors_of(x)

    return replace(
        recording,
        q=robot.motors_of(recording.q),
        qd=moved(recording.qd),
        qdd=moved(recording.qdd),
        target_q=moved(recording.target_q),
        target_qd=moved(recording.target_qd),
        target_qdd=moved(recording.target_qdd),
    )
