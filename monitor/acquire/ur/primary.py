"""The controller's primary port, read only: the joint limits of its installation, which come with its configuration data.

Nothing is sent there. A controller sends its state some ten times a second, and its configuration with the first one; its layout is in the
manufacturer's guide to the client interfaces.
"""

import math
import socket
import struct
import time

from monitor.acquire.state import JointLimits

PORT = 30001
ROBOT_STATE, CONFIGURATION = 16, 6  # type of a message, type of a package within it
JOINTS = 6
PAIRS = struct.Struct(f">{4 * JOINTS}d")  # lowest and highest position of each joint, then greatest speed and acceleration of each
HEAD = struct.Struct(">iB")  # length with this head, type
LONGEST_MESSAGE = 65_536  # bytes; a state has about 1500
WITHIN_S = 0.5  # the first state comes within 0.1 s of the connection


def joint_limits(host: str, within_s: float = WITHIN_S) -> JointLimits | None:
    """The limits that the controller's configuration data name; None where none come within that time, or where they make no sense."""
    until = time.monotonic() + within_s
    waiting = b""
    try:
        with socket.create_connection((host, PORT), timeout=within_s) as connection:
            while (left_s := until - time.monotonic()) > 0.0:
                connection.settimeout(left_s)
                data = connection.recv(LONGEST_MESSAGE)
                if not data:
                    return None
                waiting += data
                while len(waiting) >= HEAD.size:
                    length, kind = HEAD.unpack_from(waiting)
                    if not HEAD.size <= length <= LONGEST_MESSAGE:
                        return None
                    if len(waiting) < length:
                        break
                    message, waiting = waiting[HEAD.size : length], waiting[length:]
                    if kind == ROBOT_STATE and (found := limits_in_state(message)):
                        return found
    except OSError:
        return None
    return None


def limits_in_state(state: bytes) -> JointLimits | None:
    """The limits in the packages of one robot state, without its head; None where it has no configuration data."""
    while len(state) >= HEAD.size:
        length, kind = HEAD.unpack_from(state)
        if not HEAD.size <= length <= len(state):
            return None
        if kind == CONFIGURATION and length >= HEAD.size + PAIRS.size:
            values = PAIRS.unpack_from(state, HEAD.size)
            position, motion = values[: 2 * JOINTS], values[2 * JOINTS :]
            limits = JointLimits(lowest_rad=position[::2], highest_rad=position[1::2], speed_rad_s=motion[::2])
            return limits if _sensible(limits) else None
        state = state[length:]
    return None


def _sensible(limits: JointLimits) -> bool:
    """Whether every joint has a range and a speed."""
    figures = (*limits.lowest_rad, *limits.highest_rad, *limits.speed_rad_s)
    ranges = zip(limits.lowest_rad, limits.highest_rad, strict=True)
    return not any(map(math.isnan, figures)) and all(low < high for low, high in ranges) and min(limits.speed_rad_s) > 0.0
