"""Versions of PolyScope, the software of a controller, and the names of URScript that came with them."""

import re
from functools import cache
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


Since = tuple[
    tuple[int, ...], ...
]  # the first versions that have something; a later generation has it from its first on, unless it has its own

# The first versions that know a name of URScript, or `function.parameter`. As published: the manufacturer's client library 2.14 and its
# maintainers, and the script manual 5.25.1 (`direct_torque`). A name that is not here is one of every version.
NAMES_SINCE: dict[str, Since] = {
    "str_cat": ((3, 8),),
    "ft_rtde_input_enable": ((3, 14, 1), (5, 9, 1)),
    "set_target_payload": ((5, 10),),
    "optimovej": ((5, 21), (10, 8)),
    "optimovel": ((5, 21), (10, 8)),
    "direct_torque": ((5, 23), (10, 10)),
    "direct_torque.viscous_scale": ((5, 25, 1), (10, 12, 1)),
    "direct_torque.coulomb_scale": ((5, 25, 1), (10, 12, 1)),
}


@cache
def unknown_names(version: Version) -> re.Pattern[str] | None:
    """What finds a call with a name that this version does not know, with that name as its last group; None where it knows all of them."""
    unknown = [name.split(".") for name, since in NAMES_SINCE.items() if not knows(version, since)]
    calls = [rf"\b({function})\s*\(" for function, *parameter in unknown if not parameter]
    calls += [rf"\b{function}\s*\([^\n#]*\b({parameter[0]})\s*=(?!=)" for function, *parameter in unknown if parameter]
    return re.compile("|".join(calls)) if calls else None


def knows(version: Version, since: Since) -> bool:
    """Whether a controller of this version has what came with these."""
    first = [each for each in since if each[0] <= version.major]
    return bool(first) and version >= first[-1]
