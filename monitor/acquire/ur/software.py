"""What a controller's software tells of it: its generation, whether ur-rtde can drive it, and whether replays on it are tested."""

import re
from typing import NamedTuple

from monitor.acquire.state import Identity, Software
from monitor.model.robot import robot_names

GENERATIONS = {"cb3": ("3",), "e-series": ("5", "10")}  # each by the major versions of its software
E_SERIES_FROM = 5  # first major version of the software of the e-Series


class Span(NamedTuple):
    """A span of versions of the controller's software, both ends included, by major and minor number."""

    first: tuple[int, int]
    last: tuple[int, int]
    reason: str  # of its bounds
    drives: bool = True  # ur-rtde can drive it
    tested: bool = True  # replays on it are tested, as far as its wire is known


SOFTWARE = (  # what is in none of these spans moves only where the configuration allows untested software
    Span((3, 0), (3, 9), "RTDE's protocol 2, which ur-rtde speaks, came with 3.10", drives=False),
    Span((3, 10), (3, 15), "CB3: from RTDE's protocol 2 to the generation's last version; 3.15 is what the tests play against"),
    Span((5, 0), (5, 3), "ur-rtde asks a minor version of 4 or more for its registers, and crashes in its constructor", drives=False),
    Span((5, 4), (5, 23), "e-Series: from ur-rtde's registers to the newest version for which it has a recipe"),
    Span((10, 0), (10, 10), "PolyScope X before 10.11 has neither a dashboard nor a Robot API: no program could be stopped", drives=False),
    Span((10, 11), (99, 99), "PolyScope X: its Robot API is known from public sources and a simulated controller only", tested=False),
)


def generation_of(firmware: str | None) -> str | None:
    """The generation of arms that a version of the software drives: its name does not tell UR5 and UR5e apart. None: unknown."""
    major = (firmware or "").partition(".")[0]
    return next((name for name, of_it in GENERATIONS.items() if major in of_it), None)


def understood(identity: Identity) -> Identity:
    """The same, with what its software tells of it."""
    match = re.match(r"(\d+)\.(\d+)", identity.firmware or "")
    version = (int(match[1]), int(match[2])) if match else None
    span = next((each for each in SOFTWARE if version is not None and each.first <= version <= each.last), None)
    known = Software(expected=_tested()) if span is None else Software(span.drives, span.drives and span.tested, span.reason, _tested())
    says_later = identity.robot_api
    return identity._replace(
        generation=generation_of(identity.firmware),
        software=known,
        no_remote_control="PolyScope X tells it from 10.12 on; " if says_later else "this generation has no local control; ",
    )


def _tested() -> str:
    """The spans of tested versions, as text."""
    spans = [f"{span.first[0]}.{span.first[1]} to {span.last[0]}.{span.last[1]}" for span in SOFTWARE if span.drives and span.tested]
    return " and ".join(spans)


def model_of(identity: Identity) -> str | None:
    """The shipped model that a controller names: an e-Series controller leaves the e out, and its software is 5 or newer."""
    if identity.model is None:
        return None
    plain, known = identity.model.lower(), robot_names()
    major = (identity.firmware or "").partition(".")[0]
    e_series = major.isdigit() and int(major) >= E_SERIES_FROM
    wanted = (f"{plain}e", plain) if e_series and not plain.endswith("e") else (plain,)
    return next((name for name in wanted if name in known), None)
