"""The text of the program's hand-over node: made for one controller, and kept for a start at which that controller is off. I/O.

What is kept is ur-rtde's part. It depends on the controller's software and on ur-rtde alone, so it holds as long as these are the same.
"""

import hashlib
import json
import os
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, Self

from monitor.acquire.driver import Driver
from monitor.acquire.ur.driver import UNIVERSAL_ROBOTS
from monitor.acquire.ur.node_script import control_script, hand_over_script
from monitor.errors import BadInput

FILE = "hand-over-node.json"
MARK = "# joint-monitor node "  # begins the first line of the text; its number follows


class NodeText(NamedTuple):
    """What a node of the program gets."""

    software: str | None  # of the controller that it was made for; None: it does not say
    control: str  # ur-rtde's control script
    text: str

    @classmethod
    def of(cls, software: str | None, control: str) -> Self:
        """The text around ur-rtde's. Raises BadInput where ur-rtde's text is not as expected."""
        number = hashlib.sha256(hand_over_script(control).encode()).hexdigest()[:12]
        return cls(software, control, f"{MARK}{number}\n{hand_over_script(control, version=version_of(number))}")

    @property
    def number(self) -> str:
        """The number in the first line: two texts with one number are the same."""
        return number_of(self.text) or ""


def version_of(number: str) -> int:
    """What a program that has the text of this number says in the register VERSION: its first seven digits, within 32 bits, and never 0."""
    return int(number[:7], 16) or 1


def node_text(host: str, *, driver: Driver = UNIVERSAL_ROBOTS, script: Callable[[str], str] = control_script) -> NodeText:
    """The text for the controller at this address. Raises RobotUnreachable where it does not answer, BadInput for an unknown ur-rtde."""
    return NodeText.of(driver.identity(host).firmware, script(host))


def number_of(text: str) -> str | None:
    """The number in the first line of a node's text; None where it is not ours."""
    first = text.partition("\n")[0].strip()
    return first.removeprefix(MARK) if first.startswith(MARK) else None


def keep(directory: Path, node: NodeText) -> None:
    """Keep ur-rtde's part beside the history, whole or not at all; where the disk refuses, the next start asks the controller again."""
    path = directory / FILE
    temporary = path.with_suffix(".tmp")
    with suppress(OSError):
        temporary.write_text(json.dumps({"software": node.software, "control": node.control, "library": _library()}), "utf-8")
        os.replace(temporary, path)


def kept(directory: Path) -> NodeText | None:
    """The text that was kept last; None where there is none, or another ur-rtde is installed since."""
    try:
        document = json.loads((directory / FILE).read_text("utf-8"))
        if document["library"] != _library():
            return None
        return NodeText.of(document["software"], str(document["control"]))
    except (OSError, ValueError, TypeError, KeyError, BadInput):
        return None


def _library() -> str:
    return version("ur_rtde")
