"""Recordings of arms whose motors are coupled, in the positions of the motors."""

from monitor.model.robot import Robot
from monitor.recording import Recording


def at_motors(recording: Recording, robot: Robot) -> Recording:
    """The recording with the positions of the motors, each in units of its own joint, where it holds those of coupled joints.

    Currents are those of the motors already. In these coordinates friction belongs to one motor alone, and so does its ripple.
    """
    if robot.coupling is None or robot.recorded_at_motors or recording.joints != robot.joints:
        return recording
    return recording.changed(("q", "qd", "qdd", "target_q", "target_qd", "target_qdd"), robot.motors_of)
