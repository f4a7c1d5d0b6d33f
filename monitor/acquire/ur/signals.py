"""The RTDE variables that make a row, and the getter of ur-rtde that reads each."""

from typing import NamedTuple

from monitor.acquire.rows import WIDTHS


class Signal(NamedTuple):
    """One RTDE variable and the getter of ur-rtde that reads it."""

    variable: str  # its name in a row
    getter: str
    optional: bool = False  # controllers of some generations do not report it; the row holds NaN then

    @property
    def width(self) -> int:
        """Values a tick."""
        return WIDTHS[self.variable]


SIGNALS: tuple[Signal, ...] = (
    Signal("timestamp", "getTimestamp"),
    Signal("actual_q", "getActualQ"),
    Signal("actual_qd", "getActualQd"),
    Signal("actual_current", "getActualCurrent"),
    Signal("joint_temperatures", "getJointTemperatures"),
    Signal("target_q", "getTargetQ"),
    Signal("target_qd", "getTargetQd"),
    Signal("target_qdd", "getTargetQdd"),
    Signal("target_current", "getTargetCurrent"),
    Signal("target_moment", "getTargetMoment"),
    Signal("robot_mode", "getRobotMode"),
    Signal("safety_mode", "getSafetyMode"),
    Signal("runtime_state", "getRuntimeState"),
    Signal("safety_status_bits", "getSafetyStatusBits"),
    Signal("speed_scaling", "getSpeedScaling", optional=True),
    Signal("target_speed_fraction", "getTargetSpeedFraction", optional=True),
    Signal("payload", "getPayload", optional=True),  # from software 3.11 and 5.6 on
    Signal("payload_cog", "getPayloadCog", optional=True),
    Signal("actual_tool_accelerometer", "getActualToolAccelerometer", optional=True),
    Signal("actual_digital_input_bits", "getActualDigitalInputBits", optional=True),
    Signal("robot_status_bits", "getRobotStatus", optional=True),
    Signal("joint_mode", "getJointMode", optional=True),
    Signal("actual_TCP_pose", "getActualTCPPose", optional=True),
    Signal("actual_TCP_force", "getActualTCPForce", optional=True),
)
