"""Topics of arms and their names in Home Assistant. Any name of a site or a robot has a topic of its own. No I/O, no clock.

A level of a topic may be any text without `/`, `+`, `#` and NUL; a name in Home Assistant holds only a–z, A–Z, 0–9, `_` and `-`.
"""

from typing import NamedTuple
from urllib.parse import quote, unquote

GATEWAY = "availability"  # below the root: whether the gateway is connected
ONLINE, OFFLINE = "online", "offline"  # Home Assistant's defaults
_SEPARATOR = "_-"  # an escaped name never holds it: its `_` is doubled, or begins a byte in hexadecimal


class ArmTopics(NamedTuple):
    """The topics of one arm."""

    root: str
    site: str
    robot: str

    @property
    def base(self) -> str:
        """Below which the arm's topics lie."""
        return f"{self.root}/{quote(self.site, safe='')}/{quote(self.robot, safe='')}"

    @property
    def availability(self) -> str:
        """Whether the arm's monitor is heard."""
        return f"{self.base}/availability"

    @property
    def state(self) -> str:
        """The arm at a glance."""
        return f"{self.base}/state"

    @property
    def alerts(self) -> str:
        """Its active alerts."""
        return f"{self.base}/alerts"

    def joint(self, joint: int) -> str:
        """One joint."""
        return f"{self.base}/joint/{joint}"

    @property
    def acknowledge(self) -> str:
        """Where a client acknowledges."""
        return f"{self.base}/cmd/ack"

    @property
    def identity(self) -> str:
        """The arm's name in Home Assistant; no two arms, and no two roots, share one."""
        return _SEPARATOR.join(_escaped(name) for name in (self.root, self.site, self.robot))

    def discovery(self, prefix: str) -> str:
        """Where Home Assistant expects the arm's device discovery."""
        return f"{prefix}/device/{self.identity}/config"


def gateway(root: str) -> str:
    """Whether the gateway is connected."""
    return f"{root}/{GATEWAY}"


def named(root: str, topic: str) -> ArmTopics | None:
    """The arm of a topic below the root; None where it is of none."""
    if not topic.startswith(f"{root}/"):
        return None
    levels = topic.removeprefix(f"{root}/").split("/")
    if len(levels) < 3 or not levels[0] or not levels[1]:
        return None
    found = ArmTopics(root, unquote(levels[0]), unquote(levels[1]))
    return found if topic.startswith(f"{found.base}/") else None  # another way to write the same name is nobody's topic


def _escaped(name: str) -> str:
    """Letters, digits and `-` stay; `_` is doubled, any other byte is `_` and two hexadecimal digits. No two names become the same."""
    return "".join(
        "__" if character == "_" else character if character == "-" or (character.isascii() and character.isalnum()) else _bytes(character)
        for character in name
    )


def _bytes(character: str) -> str:
    return "".join(f"_{byte:02x}" for byte in character.encode("utf-8", "surrogatepass"))
