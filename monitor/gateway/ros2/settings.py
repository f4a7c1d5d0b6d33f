"""The section [ros2] of the plant's file."""

import re
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Interval

from monitor.errors import BadInput
from monitor.publish.session import BusSettings

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")  # of a name in ROS 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Settings:
    """Behind which router the ROS 2 nodes are, and as which node the gateway speaks."""

    connect: str = ""  # of the router that rmw_zenoh uses, e.g. "tcp/ros-host.example:7447"; empty: no ROS 2 is told
    zenoh: str = ""  # path of a Zenoh configuration (JSON5) with certificates or a password for that router
    domain: Annotated[int, Interval(ge=0, le=232)] = 0  # ROS_DOMAIN_ID of the nodes
    node: str = "joint_monitor"  # name of the node that the gateway is
    topic: str = "/diagnostics"  # that of diagnostic_aggregator and rqt_robot_monitor
    period_s: Annotated[float, Interval(ge=0.2, le=3600.0)] = 2.0  # [s] diagnostic_aggregator calls stale what is older than 5 s
    type_hash: bool = True  # false for ROS 2 Humble, whose messages have no hash of their type
    sites: tuple[str, ...] = ()  # only these sites are told; empty: all

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        if self.connect:
            try:
                BusSettings(connect=(self.connect,))  # refuses what is no endpoint
            except BadInput as error:
                raise BadInput(f"ros2: {str(error).removeprefix('bus: ')}") from None
        if not _TOKEN.match(self.node):
            raise BadInput(f"ros2: node = {self.node!r}; expected letters, digits and _, as ROS 2 names its nodes")
        if not self.topic.startswith("/") or not all(_TOKEN.match(part) for part in self.topic[1:].split("/")):
            raise BadInput(f'ros2: topic = {self.topic!r}; expected the whole name of a topic, e.g. "/diagnostics"')
