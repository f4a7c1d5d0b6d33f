"""The controller's primary port, read only: joint limits of its installation and kind of arm, both in its configuration data.

Nothing is sent there. A controller sends its state some ten times a second, and its configuration with the first one; its layout is in the
manufacturer's guide to the client interfaces.
"""

import math
import socket
import struct
import time
from typing import NamedTuple

from monitor.acquire.state import JointLimits
from monitor.acquire.ur.ports.packages import LONGEST, take_packages

PORT = 30001
ROBOT_STATE, CONFIGURATION = 16, 6  # type of a message, type of a package within it
JOINTS = 6
PAIRS = struct.Struct(f">{4 * JOINTS}d")  # lowest and highest position of each joint, then greatest speed and acceleration of each
KIND = struct.Struct(">i")  # of arm; after the limits, four defaults, a radius, 24 kinematic parameters and two versions
KIND_AT = PAIRS.size + 8 * (4 + 1 + 4 * JOINTS) + 2 * 4
KINDS = {1: "UR5", 2: "UR10", 3: "UR3", 4: "UR16", 5: "UR18", 6: "UR8LONG", 7: "UR20", 8: "UR30", 9: "UR15"}  # the manufacturer's numbers
HEAD = struct.Struct(">iB")  # length with this head, type
WITHIN_S = 0.5  # the first state comes within 0.1 s of the connection


class Configured(NamedTuple):
    """What the configuration data say; None where they do not say it, or where it makes no sense."""

    limits: JointLimits | None = None
    model: str | None = None  # for example "UR5"; an e-Series has the same as a CB3


def configured(host: str, within_s: float = WITHIN_S) -> Configured:
    """What the controller's configuration data say; nothing where none come within that time."""
    until = time.monotonic() + within_s
    waiting = bytearray()
    try:
        with socket.create_connection((host, PORT), timeout=within_s) as connection:
            while (left_s := until - time.monotonic()) > 0.0:
                connection.settimeout(left_s)
                data = connection.recv(LONGEST)
                if not data:
                    return Configured()
                waiting += data
                for kind, message in take_packages(waiting, HEAD):
                    if kind == ROBOT_STATE and (found := configured_in_state(message)):
                        return found
    except OSError:
        return Configured()
    return Configured()


def configured_in_state(state: bytes) -> Configured | None:
    """What the packages of one robot state say, without its head; None where it has no configuration data."""
    while len(state) >= HEAD.size:
        length, kind = HEAD.unpack_from(state)
        if not HEAD.size <= length <= len(state):
            return None
        if kind == CONFIGURATION and length >= HEAD.size + PAIRS.size:
            values = PAIRS.unpack_from(state, HEAD.size)
            position, motion = values[: 2 * JOINTS], values[2 * JOINTS :]
            limits = JointLimits(lowest_rad=position[::2], highest_rad=position[1::2], speed_rad_s=motion[::2])
            kind_at = HEAD.size + KIND_AT
            number = KIND.unpack_from(state, kind_at)[0] if length >= kind_at + KIND.size else 0
            return Configured(limits if _sensible(limits) else None, KINDS.get(number))
        state = state[length:]
    return None


def _sensible(limits: JointLimits) -> bool:
    """Whether every joint has a range and a speed."""
    figures = (*limits.lowest_rad, *limits.highest_rad, *limits.speed_rad_s)
    ranges = zip(limits.lowest_rad, limits.highest_rad, strict=True)
    return not any(map(math.isnan, figures)) and all(low < high for low, high in ranges) and min(limits.speed_rad_s) > 0.0
