"""Versions of PolyScope, the software of a controller."""

from typing import NamedTuple


class Version(NamedTuple):
    """A version of PolyScope, as RTDE and the dashboard report it."""

    major: int
    minor: int
    bugfix: int
    build: int


# For each generation, the newest version that ur-rtde 1.6.5 handles with its small control recipe.
DEFAULT_VERSION = {"cb3": "3.15.8.106339", "e-series": "5.11.0.108249"}
BUILD_DATE = {3: "Mar 10 2022", 5: "Mar 10 2021", 10: "Dec 12 2025"}  # by major version
X = 10  # from this major version on: PolyScope X
ROBOT_API = {  # version of the Robot API, by the first minor version of PolyScope X that has it; that of 10.11 is not published
    11: (3, 0, 0),
    12: (3, 1, 4),
    13: (3, 1, 6),
    14: (5, 0, 107),
}


def robot_api_of(version: Version) -> tuple[int, int, int] | None:
    """The version of the Robot API that PolyScope X of this version has; None where it has none."""
    since = [minor for minor in ROBOT_API if (X, minor) <= version[:2]]
    return ROBOT_API[max(since)] if since else None
