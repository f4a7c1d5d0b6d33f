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
BUILD_DATE = {3: "Mar 10 2022", 5: "Mar 10 2021"}  # by major version
