"""Since which version a controller knows a variable of RTDE, by the manufacturer's guide; what is newer is NOT_FOUND.

Where the guide does not say it, the note tells what the entry rests on.
"""

import re
from typing import NamedTuple

from monitor.simulate.settings import Version

ALWAYS, NEVER = (0, 0, 0), (99, 0, 0)


class Since(NamedTuple):
    """First version on CB3 and on the e-Series."""

    cb3: tuple[int, ...] = ALWAYS
    e_series: tuple[int, ...] = ALWAYS

    def __contains__(self, version: object) -> bool:
        """Whether a controller of this version knows it."""
        return isinstance(version, Version) and version[:3] >= (self.cb3 if version.major < 5 else self.e_series)


UPPER = Since((3, 9, 0), (5, 3, 0))  # what is left to clients other than fieldbuses: bits from 64 on, the other registers from 24 on
SINCE = {
    "elbow_position": Since((3, 5, 0)),
    "elbow_velocity": Since((3, 5, 0)),
    "safety_status": Since((3, 10, 0), (5, 4, 0)),
    "payload": Since((3, 11, 0), (5, 5, 1)),
    "payload_cog": Since((3, 11, 0), (5, 5, 1)),
    "tcp_offset": Since((3, 12, 0), (5, 5, 1)),  # said by the manufacturer's client library; the guide has it since 2025
    "script_control_line": Since((3, 14, 0), (5, 9, 0)),
    "payload_inertia": Since((3, 15, 0), (5, 11, 0)),
    "tool_output_mode": Since(NEVER, (5, 2, 0)),
    "tool_digital_output0_mode": Since(NEVER, (5, 2, 0)),
    "tool_digital_output1_mode": Since(NEVER, (5, 2, 0)),
    "ft_raw_wrench": Since(NEVER, (5, 9, 0)),  # the e-Series' own sensor
    # not in the guide of 5.11, asked for by clients of newer controllers; when exactly they came is not confirmed
    "joint_position_deviation_ratio": Since(NEVER, (5, 12, 0)),
    "collision_detection_ratio": Since(NEVER, (5, 15, 0)),
    "time_scale_source": Since(NEVER, (5, 17, 0)),
    "actual_current_as_torque": Since(NEVER, (5, 23, 0)),  # ur-rtde asks for it from there on
}
NUMBERED = re.compile(r"(?:in|out)put_(bit|int|double)_register_(\d+)")


def known(name: str, version: Version) -> bool:
    """Whether a controller of this version knows the variable, if any does."""
    numbered = NUMBERED.fullmatch(name)
    if numbered and int(numbered[2]) >= (64 if numbered[1] == "bit" else 24):
        return version in UPPER
    return version in SINCE.get(name, Since())
