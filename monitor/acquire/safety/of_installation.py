"""Conditions on the drives and on the controller's installation: gains, tool, payload's centre, its limits of speed and space.

What the configuration says of the installation is compared with what the controller reports, where it reports it. Limits that it does
not report are those of the configuration; where that says nothing, they are not checked.
"""

import math
from typing import NamedTuple

import numpy as np

from monitor.acquire.safety.inputs import ConditionInputs, Unreported
from monitor.design.clearance import frames
from monitor.errors import MotionRefused
from monitor.model.robot import Mounting, Robot
from monitor.reason import Reason, Sentence
from monitor.recording import Array

LEAST_CURRENT_A, MOST_CURRENT_A = 0.5, 100.0  # at a joint's largest torque; known arms need 2.6 A (a UR3's wrist) to 55 A (a UR20's base)
COG_ERROR_M = 0.01  # between two centres of gravity: with 5 kg it is 0.5 N·m at the wrist, a tenth of its friction
LIGHT_KG = 0.05  # the centre of a lighter payload does not matter
TCP_ERROR_M, TCP_ERROR_DEG = 0.01, 2.0  # a controller's calibrated kinematics differ from the published ones by a few millimetres
SPEED_SHARE = 0.95  # of the installation's limit: a servo overshoots a little
PLANE_MARGIN_M = 0.01  # for the calibration, too
CHECK_RATE_HZ = 125.0  # between two samples a point at 2 m/s moves by 16 mm, along a curve that bends far less
WAY_SAMPLES = 101  # of the way to the start: at most 0.025 rad between two


class _Points(NamedTuple):
    """Places (N, K, 3) [m] and speeds (N, K) [m/s] of the elbow, the flange and the TCP, in the base's frame."""

    place: Array
    speed: Array


NAMES = ("elbow", "flange", "TCP")


GAINS_UNKNOWN = Sentence(
    "gains_unknown",
    "robot.gains_nm_per_a is empty, and the torque per ampere of a {arm} is not published: without it no collision is "
    "noticed and no replay can be judged; `joint-monitor init` finds it, then give robot.gains_nm_per_a",
)
GAIN_WRONG = Sentence(
    "gain_wrong",
    "robot.gains_nm_per_a: with {gain_nm_per_a:g} N·m/A {joint:joint} would need {current_a:.3g} A for its largest torque; "
    "expected {least_a:g} to {most_a:g} A: a gain is that of the joint, the motor's torque constant times the gear ratio",
)
GAINS_CONFIGURED = Sentence("gains_configured", "as configured")
GAINS_PUBLISHED = Sentence("gains_published", "published for the {arm}")


def drive_gains(inputs: ConditionInputs) -> Reason:
    """The torque per ampere of every joint is known: without it no collision is noticed."""
    gains = inputs.installation.drive_gains(inputs.robot)
    if gains is None:
        raise MotionRefused(GAINS_UNKNOWN(arm=inputs.robot.name))
    current_a = inputs.robot.max_torque_nm / gains  # (J,) at the joint's largest torque
    wrong = np.flatnonzero(~((current_a >= LEAST_CURRENT_A) & (current_a <= MOST_CURRENT_A)))
    if wrong.size:
        j = int(wrong[0])
        raise MotionRefused(
            GAIN_WRONG(gain_nm_per_a=gains[j], joint=j + 1, current_a=current_a[j], least_a=LEAST_CURRENT_A, most_a=MOST_CURRENT_A)
        )
    return GAINS_CONFIGURED() if inputs.installation.gains_nm_per_a else GAINS_PUBLISHED(arm=inputs.robot.name)


TCP_SPEED_LIMIT_UNKNOWN = Sentence(
    "tcp_speed_limit_unknown", "robot.tcp_speed_limit_m_s names none: a limit of the installation would show as a protective stop"
)
TCP_TOO_FAST = Sentence(
    "tcp_too_fast",
    "the {point:word} moves at {speed_m_s:.2f} m/s; at most {share_percent:g} % of robot.tcp_speed_limit_m_s = {limit_m_s:g}",
)
TCP_SPEED_WITHIN = Sentence("tcp_speed_within", "at most {speed_m_s:.2f} m/s ({point:word}), the limit is {limit_m_s:g} m/s")


def tcp_speed(inputs: ConditionInputs) -> Reason:
    """Elbow, flange and TCP stay below the speed limit of the installation, on the trajectory and on the way to its start."""
    limit = inputs.installation.tcp_speed_limit_m_s
    if limit == 0.0:
        raise Unreported(TCP_SPEED_LIMIT_UNKNOWN())
    speed = np.max(_points(inputs).speed, axis=0)  # (K,)
    k = int(np.argmax(speed))
    if not speed[k] <= SPEED_SHARE * limit:
        raise MotionRefused(TCP_TOO_FAST(point=NAMES[k], speed_m_s=speed[k], share_percent=100 * SPEED_SHARE, limit_m_s=limit))
    return TCP_SPEED_WITHIN(speed_m_s=speed[k], point=NAMES[k], limit_m_s=limit)


SAFETY_PLANES_UNKNOWN = Sentence(
    "safety_planes_unknown", "robot.safety_planes names none: a plane of the installation would show as a protective stop"
)
NEAR_SAFETY_PLANE = Sentence(
    "near_safety_plane", "the {point:word} comes within {left_mm:.0f} mm of plane {plane} of robot.safety_planes; at least {least_mm:g} mm"
)
CLEAR_OF_SAFETY_PLANES = Sentence("clear_of_safety_planes", "{planes} planes, at least {left_mm:.0f} mm left")


def safety_planes(inputs: ConditionInputs) -> Reason:
    """Elbow, flange and TCP stay on the free side of the installation's safety planes, on the trajectory and on the way to its start."""
    planes = inputs.installation.safety_planes
    if not planes:
        raise Unreported(SAFETY_PLANES_UNKNOWN())
    place = _points(inputs).place  # (N, K, 3)
    nearest = math.inf
    for number, (a, b, c, d) in enumerate(planes, start=1):
        left = np.min(d - place @ np.array([a, b, c]), axis=0)  # (K,) [m]
        k = int(np.argmin(left))
        if not left[k] >= PLANE_MARGIN_M:
            raise MotionRefused(NEAR_SAFETY_PLANE(point=NAMES[k], left_mm=1000.0 * left[k], plane=number, least_mm=1000.0 * PLANE_MARGIN_M))
        nearest = min(nearest, float(left[k]))
    return CLEAR_OF_SAFETY_PLANES(planes=len(planes), left_mm=1000.0 * nearest)


PAYLOAD_COG_NOT_REPORTED = Sentence(
    "payload_cog_not_reported", "not reported: a payload whose centre is elsewhere would be taken for friction"
)
PAYLOAD_COG_OF_NO_PAYLOAD = Sentence("payload_cog_of_no_payload", "{cog_m} m, of no payload")
PAYLOAD_COG_NOT_CONFIGURED = Sentence("payload_cog_not_configured", "the controller reckons with {cog_m} m, robot.payload_cog_m names none")
ANOTHER_PAYLOAD_COG = Sentence(
    "another_payload_cog",
    "the controller reckons with {cog_m} m, robot.payload_cog_m is {configured_m}: {apart_mm:.0f} mm apart, at most {limit_mm:g}",
)
PAYLOAD_COG_AS_CONFIGURED = Sentence("payload_cog_as_configured", "{cog_m} m, as configured")


def payload_cog(inputs: ConditionInputs) -> Reason:
    """The controller reckons with the configured centre of gravity of the payload."""
    expected, state = inputs.installation.payload_cog_m, inputs.arm
    if not _reported(state.payload_cog_m):
        raise Unreported(PAYLOAD_COG_NOT_REPORTED())
    reported = ", ".join(f"{value:.3f}" for value in state.payload_cog_m)
    if state.payload_kg < LIGHT_KG:
        return PAYLOAD_COG_OF_NO_PAYLOAD(cog_m=reported)
    if not expected:
        raise Unreported(PAYLOAD_COG_NOT_CONFIGURED(cog_m=reported))
    apart = math.dist(expected, state.payload_cog_m)
    if not apart <= COG_ERROR_M:
        wanted = ", ".join(f"{value:.3f}" for value in expected)
        raise MotionRefused(
            ANOTHER_PAYLOAD_COG(cog_m=reported, configured_m=wanted, apart_mm=1000.0 * apart, limit_mm=1000.0 * COG_ERROR_M)
        )
    return PAYLOAD_COG_AS_CONFIGURED(cog_m=reported)


TCP_NOT_REPORTED = Sentence("tcp_not_reported", "not reported: a tool that nobody told the monitor is not noticed")
POSITIONS_NOT_FINITE = Sentence("positions_not_finite", "unknown: the controller reports positions that are not finite")
TCP_NOT_CONFIGURED = Sentence("tcp_not_configured", "the controller's TCP is at {tcp}, robot.tcp_offset names none")
ANOTHER_TCP = Sentence(
    "another_tcp",
    "the controller's TCP is at {tcp}: {apart_mm:.0f} mm and {apart_deg:.1f}° from robot.tcp_offset; at most {limit_mm:g} mm "
    "and {limit_deg:g}°",
)
TCP_AS_CONFIGURED = Sentence("tcp_as_configured", "{tcp}, as configured")


def tcp_offset(inputs: ConditionInputs) -> Reason:
    """The controller's tool centre point is the configured one. It follows from the TCP pose and the flange's, by forward kinematics."""
    expected, state = inputs.installation.tcp_offset, inputs.arm
    if not _reported(state.tcp_pose):
        raise Unreported(TCP_NOT_REPORTED())
    if not np.all(np.isfinite([*state.q, *state.tcp_pose])):
        raise MotionRefused(POSITIONS_NOT_FINITE())
    place, turn = offset_of(inputs.robot, state.q, np.array(state.tcp_pose))
    reported = ", ".join(str(round(1000.0 * value)) for value in place) + " mm"
    if not expected:
        raise Unreported(TCP_NOT_CONFIGURED(tcp=reported))
    apart_m = float(np.linalg.norm(place - np.array(expected[:3])))
    apart_deg = angle_deg(turn.T @ rotation(np.array(expected[3:])))
    if not (apart_m <= TCP_ERROR_M and apart_deg <= TCP_ERROR_DEG):
        raise MotionRefused(
            ANOTHER_TCP(
                tcp=reported, apart_mm=1000.0 * apart_m, apart_deg=apart_deg, limit_mm=1000.0 * TCP_ERROR_M, limit_deg=TCP_ERROR_DEG
            )
        )
    return TCP_AS_CONFIGURED(tcp=reported)


def offset_of(robot: Robot, q: Array, tcp_pose: Array) -> tuple[Array, Array]:
    """Position (3,) [m] and attitude (3, 3) of the TCP in the flange's frame, from its pose (6,) in the base's frame at q (J,)."""
    attitudes, origins = frames(robot, Mounting(), q[None])
    flange, at = attitudes[0, -1], origins[0, -1]
    return flange.T @ (tcp_pose[:3] - at), flange.T @ rotation(tcp_pose[3:])


def rotation(vector: Array) -> Array:
    """The rotation matrix (3, 3) of a rotation vector (3,) [rad]: Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:  # a smaller angle is lost in rounding
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K
    return turned


def angle_deg(turn: Array) -> float:
    """The angle [°] of a rotation matrix (3, 3)."""
    return math.degrees(math.acos(min(max(0.5 * (float(np.trace(turn)) - 1.0), -1.0), 1.0)))


def _reported(values: tuple[float, ...]) -> bool:
    """Whether a controller reports these; a value that is not finite is refused where it is compared."""
    return bool(values) and not any(math.isnan(value) for value in values)


def _points(inputs: ConditionInputs) -> _Points:
    """Elbow, flange and TCP along one pass of the trajectory, and along the way to its start where the arm's position is known."""
    excitation, robot, state = inputs.played, inputs.robot, inputs.state
    curve = excitation.at(np.linspace(0.0, excitation.pass_s, max(2, round(excitation.pass_s * CHECK_RATE_HZ) + 1)))
    q, qd = curve.q, curve.qd
    if state is not None and np.all(np.isfinite(state.target_q)):
        for begin, end in inputs.way_from(state).lines:
            way = end - begin  # (J,)
            farthest = float(np.max(np.abs(way)))
            if farthest > 0.0:
                share = np.linspace(0.0, 1.0, WAY_SAMPLES)[:, None]
                q = np.vstack([begin + share * way, q])
                qd = np.vstack([np.tile(inputs.settings.approach_speed_rad_s * way / farthest, (WAY_SAMPLES, 1)), qd])
    return points(robot, q, qd, _tool(inputs))


def _tool(inputs: ConditionInputs) -> Array:
    """(3,) [m] the TCP in the flange's frame: as configured, else as the controller reports it, else the flange itself."""
    state = inputs.state
    if inputs.installation.tcp_offset:
        return np.array(inputs.installation.tcp_offset[:3])
    if state is not None and len(state.tcp_pose) and np.all(np.isfinite([*state.q, *state.tcp_pose])):
        return offset_of(inputs.robot, state.q, np.array(state.tcp_pose))[0]
    return np.zeros(3)


def points(robot: Robot, q: Array, qd: Array, tool_m: Array) -> _Points:
    """Elbow, flange and TCP at positions q (N, J) and speeds qd (N, J), the TCP at tool_m (3,) in the flange's frame."""
    attitudes, origins = frames(robot, Mounting(), q)
    J = robot.joints
    axes, at = attitudes[:, :-1, :, 2], origins[:, :-1]  # (N, J, 3) joint i turns about z of frame i − 1
    tcp = origins[:, -1] + attitudes[:, -1] @ tool_m
    placed, fast = [], []
    for place, moved_by in ((origins[:, min(2, J)], min(2, J)), (origins[:, -1], J), (tcp, J)):
        velocity = sum(qd[:, i, None] * np.cross(axes[:, i], place - at[:, i]) for i in range(moved_by))  # (N, 3)
        placed.append(place)
        fast.append(np.linalg.norm(velocity, axis=1))
    return _Points(np.stack(placed, axis=1), np.stack(fast, axis=1))
