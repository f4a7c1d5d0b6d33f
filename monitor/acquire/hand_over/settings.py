"""Whether a running program lends the arm, and how: the value that [replay] hand_over… sets.

`replay` waits for the program's node itself, in the same call: the process that says "a replay is due" in the controller's registers is the
one that takes the arm and streams, because the node waits 0.08 s and a register belongs to one connection. While it waits, the progress
that it shows is of the phase `node`, with why the last node was passed by, and `should_stop` is asked as ever.
"""

import ipaddress
from dataclasses import dataclass
from typing import Self

from monitor.errors import BadInput

NONE = "none"
WAYS = ("external_control", "script_node")  # the program's node asks our server at Play; or the same text lies on the controller as a file


@dataclass(frozen=True, slots=True, kw_only=True)
class HandOver:
    """How a production program lends the arm."""

    by: str  # one of WAYS
    bind: str  # IPv4 address of this host on which the server of `external_control` listens; 0.0.0.0: on every one
    port: int
    wait_s: float  # how long one replay waits for a node at which every condition holds

    @property
    def serves(self) -> bool:
        """Whether a server must answer on `bind` and `port` while the service runs: without it the program's node blocks at Play."""
        return self.by == "external_control"

    @classmethod
    def of(cls, by: str, listen: str, wait_h: float) -> Self | None:
        """The value of the three keys; None where no program lends the arm. Raises BadInput naming the key."""
        address, _, port = listen.partition(":")
        try:
            bind = str(ipaddress.IPv4Address(address))
        except ValueError:
            bind = ""
        if not bind or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise BadInput(f"replay: hand_over_listen = {listen!r}; expected an IPv4 address of this host and a port, e.g. 0.0.0.0:50002")
        if by == NONE:
            return None
        if by not in WAYS:
            raise BadInput(f"replay: hand_over = {by!r}; expected {NONE}, {' or '.join(WAYS)}")
        return cls(by=by, bind=bind, port=int(port), wait_s=3600.0 * wait_h)
