"""A recording and the robot that it is of: whether they belong together, its motion in the positions of the motors, and its torque."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.errors import BadInput, Unidentifiable
from monitor.identify.settings import SignalSettings
from monitor.identify.signals.motion import Motion, motion
from monitor.identify.signals.rows import usual_size
from monitor.model.robot import Robot
from monitor.recording import Array, Recording

ANY_JOINT = 1e-6  # fraction of the joints: one that moves is enough
LEAST_S = 2.0  # [s] the filter needs it
GAIN_NM_PER_A = (1e-6, 1e4)  # plausible torque per ampere, or per a drive's own unit: up to ten times the largest joint of any arm
MOST_A = 200.0  # ten times what the drives of a UR can carry, five times those of arms for 300 kg


def refuse_other_arm(recording: Recording, robot: Robot) -> None:
    """Raises BadInput where the recording names another robot model than the one given. A recording without a name passes."""
    made_by = recording.context.robot
    if made_by is not None and made_by != robot.name:
        raise BadInput(f"{recording.source or 'recording'}: recorded on a {made_by}; the robot given is {robot.name}")


def refuse_twice(recordings: Sequence[Recording]) -> None:
    """Raises BadInput where one recording is given twice: it would count as two independent measurements."""
    given: dict[str, Recording] = {}
    for one in recordings:
        first = given.setdefault(one.samples_digest, one)
        if first is not one:
            raise BadInput(f"{one.source or 'recording'} is {first.source or 'recording'} once more: it says nothing new; give it once")


def at_motors(recording: Recording, robot: Robot) -> Recording:
    """The recording with the positions of the motors, each in units of its own joint, where it holds those of coupled joints.

    Currents are those of the motors already. In these coordinates friction belongs to one motor alone, and so does its ripple.
    """
    if robot.coupling is None or robot.recorded_at_motors or recording.joints != robot.joints:
        return recording
    return recording.changed(("q", "qd", "qdd", "target_q", "target_qd", "target_qdd"), robot.motors_of)


def motion_of(recording: Recording, robot: Robot, settings: SignalSettings | None = None) -> Motion:
    """The motion of a recording of this robot, in the positions of its motors. Raises as `refuse_other_arm` and `motion`."""
    refuse_other_arm(recording, robot)
    return motion(at_motors(recording, robot), settings)


def motions_of(recordings: Sequence[Recording], robot: Robot, settings: SignalSettings) -> list[Motion]:
    """`motion_of` each recording. Of several, each must move one joint, and all together most of them.

    A sweep of one joint shows that joint's friction; the sweeps of all joints show that of the arm. Raises as `motion_of` and
    `refuse_twice`, and Unidentifiable where all together are too short or move too few joints.
    """
    for recording in recordings:
        refuse_other_arm(recording, robot)
    refuse_twice(recordings)
    if len(recordings) < 2:
        return [motion_of(recording, robot, settings) for recording in recordings]
    least_s = min(LEAST_S, settings.min_duration_s)
    alone = replace(settings, min_moving_share=min(ANY_JOINT, settings.min_moving_share), min_duration_s=least_s)
    motions = [motion_of(recording, robot, alone) for recording in recordings]
    joints = motions[0].q.shape[1]
    fastest = np.max([np.quantile(np.abs(moved.qd), 0.99, axis=0) for moved in motions], axis=0)  # (J,)
    moving = int(np.sum(fastest >= settings.min_speed_rad_s))
    needed = int(np.ceil(settings.min_moving_share * joints))
    if moving < needed:
        still = ", ".join(str(j + 1) for j in np.flatnonzero(fastest < settings.min_speed_rad_s))
        raise Unidentifiable(
            f"the {len(motions)} recordings together move {moving} of {joints} joints, not joints {still}; friction shows only in motion: "
            f"expected {settings.min_speed_rad_s:g} rad/s or more on at least {needed} joints"
        )
    duration_s = sum(moved.duration_s for moved in motions)
    if duration_s < settings.min_duration_s:
        raise Unidentifiable(
            f"the {len(motions)} recordings together are {duration_s:.3g} s long; expected at least {settings.min_duration_s:g} s of motion"
        )
    return motions


def joint_torque(motion: Motion, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m] of a motion. Raises BadInput as `drive_torque`, and where the robot has another number of joints."""
    name = motion.source or "recording"
    if motion.q.shape[1] != robot.joints:
        raise BadInput(f"{name}: has {motion.q.shape[1]} joints; {robot.name} has {robot.joints}")
    return drive_torque(name, motion.torque, motion.current, robot, gains)


def drive_torque(name: str, torque: Array | None, current: Array | None, robot: Robot, gains: Array | None = None) -> Array:
    """Joint torque (N, J) [N·m]: the measured torque where there is one, else current × gain.

    gains : (J,) torque per ampere at the joint [N·m/A]; None for the published torque constant × gear ratio, Raviola et al. (2021),
    table 2. Raises BadInput where there is neither torque nor current, where gains are given for torque alone, missing, or implausible,
    and Unidentifiable where currents without gains are of a size that no drive of an arm has.
    """
    if gains is not None and (gains.shape != (robot.joints,) or not np.all((gains >= GAIN_NM_PER_A[0]) & (gains <= GAIN_NM_PER_A[1]))):
        least, most = GAIN_NM_PER_A
        given = np.array2string(np.asarray(gains), separator=",")
        raise BadInput(f"--gains: {given}; expected {robot.joints} numbers between {least:g} and {most:g} [N·m/A]")
    if torque is not None and gains is None:
        return torque
    if torque is not None and current is None:
        raise BadInput(
            f"{name}: holds torque [N·m] and no current, and --gains are torque per ampere; expected one of both: leave --gains out, or "
            f"name the columns actual_current by --columns where they are what a gain makes torque of"
        )
    if current is None:
        raise BadInput(f"{name}: holds neither current nor torque; expected actual_current or actual_torque for every joint")
    if gains is None:
        if (largest := float(np.max(usual_size(current), initial=0.0))) > MOST_A:
            raise Unidentifiable(
                f"{name}: currents of {largest:.4g} are no amperes: expected [A]; if they are in mA, divide them by 1000; "
                "if they are a drive's own units, say with --gains what torque one of them is"
            )
        gains = robot.drive_gain_nm_per_a
        if not np.all(np.isfinite(gains)):
            raise BadInput(
                f"{robot.name}: {'a URDF does not say' if robot.generation == 'urdf' else 'for this model nobody has published'} "
                f"the torque constants; give the joint gains "
                f"as --gains with {robot.joints} numbers [N·m/A], in a configuration as robot.gains_nm_per_a, or record torque"
            )
    driven: Array = current * gains
    return driven
