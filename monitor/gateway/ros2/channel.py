"""ROS 2: the section [ros2], the connection to its router, and the channel that publishes every arm's diagnostics as a node does. I/O.

Only the present counts, so nothing is owed: who subscribes later hears it within a period.
"""

import json
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import zenoh
from annotated_types import Interval

from monitor.errors import BadInput
from monitor.gateway.channel import Surroundings
from monitor.gateway.connection import Finding, NotReached, Steps, attempted, dial, needs
from monitor.gateway.ros2.messages import MESSAGE, NO_HASH, NS, Publication, encoded, statuses, type_hash
from monitor.gateway.values import Delivery, Transition
from monitor.plant.arm import HeardArm
from monitor.plant.settings import PlantConfiguration
from monitor.publish.session import BusSettings, session_config

log = logging.getLogger(__name__)

CONNECT_MS = 2000
MOST_SEQUENCE = 2**62
NO_ROUTER = "no Zenoh router answers; does `ros2 run rmw_zenoh_cpp rmw_zenohd` run there?"
SUBSCRIBER = "MS"  # a kind of entity
NODES_S = 2.0  # [s] until all nodes have answered
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


def zenoh_file(settings: Ros2Settings, plant: PlantConfiguration) -> str:
    """The absolute path of the Zenoh configuration; empty: there is none."""
    return str(plant.folder / settings.zenoh) if settings.zenoh else ""


def opened(settings: Ros2Settings, plant: PlantConfiguration, steps: Steps) -> zenoh.Session:
    """A session with the router of the ROS 2 nodes. Raises NotReached, BadInput for a wrong file, BadConfiguration without rosbags."""
    needs("rosbags", "[ros2]")
    config = session_config(mode="client", connect=(settings.connect,), zenoh_file=zenoh_file(settings, plant))
    config.insert_json5("connect/timeout_ms", json.dumps(CONNECT_MS))
    at = re.match(r"(?:tcp|tls)/(?:\[(.+)\]|([^:]+)):(\d+)", settings.connect)  # other protocols are Zenoh's alone to try
    if at:
        try:
            dial(at[1] or at[2], int(at[3]), steps).close()
        except NotReached as error:
            raise NotReached(error.step, f"{error}; {NO_ROUTER}") from None
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        raise NotReached("zenoh", f"{settings.connect}: {NO_ROUTER}") from None
    steps.say("zenoh", f"a session with {settings.connect}")
    return session


def publication_of(settings: Ros2Settings, session: zenoh.Session) -> Publication:
    """What is published in a session."""
    return Publication(
        domain=settings.domain,
        session_id=str(session.info.zid()),
        node=settings.node,
        topic=settings.topic,
        message=MESSAGE,
        type_hash=type_hash() if settings.type_hash else NO_HASH,
    )


class Ros2Channel:
    """A `Channel`."""

    name = "ros2"

    def __init__(self, settings: Ros2Settings, surroundings: Surroundings) -> None:
        """Raises BadConfiguration where rosbags is absent."""
        needs("rosbags", "[ros2]")
        self._settings, self._arms, self._plant = settings, surroundings.arms, surroundings.plant
        self._session: zenoh.Session | None = None
        self._publication: Publication | None = None
        self._tokens: list[zenoh.LivelinessToken] = []  # one that nobody holds ends
        self._sequence = 0
        self._told = 0

    def offer(self, transition: Transition) -> Sequence[Delivery]:  # noqa: ARG002 - of Channel
        """Nothing is owed."""
        return ()

    def status(self) -> str:
        """For `gateway status`."""
        if self._session is None or self._publication is None:
            return "not connected"
        return f"{self._told} arms on {self._settings.topic} of domain {self._settings.domain} at {self._settings.connect}"

    def step(self, now_unix_s: float) -> float:
        """Publish every arm, a message each. Raises NotReached where the router is away."""
        session, publication = self._opened()
        if not session.info.routers_zid() and not session.info.peers_zid():
            self._told = 0
            raise NotReached("zenoh", f"{self._settings.connect}: the router is away; the session waits for it")
        arms = [state for name, state in self._arms().items() if not self._settings.sites or name.site in self._settings.sites]
        try:
            for state in arms:
                self._publish(session, publication, state, now_unix_s)
        except zenoh.ZError as error:
            self.close()
            raise NotReached("zenoh", f"{self._settings.connect}: {error}") from None
        self._told = len(arms)
        return self._settings.period_s

    def close(self) -> None:
        """End the node: its tokens go, and every other node sees it."""
        session, self._session, self._publication, self._tokens = self._session, None, None, []
        if session is not None:
            session.close()

    def _opened(self) -> tuple[zenoh.Session, Publication]:
        if self._session is not None and self._publication is not None:
            return self._session, self._publication
        session = opened(self._settings, self._plant, Steps())
        publication = publication_of(self._settings, session)
        self._tokens = [session.liveliness().declare_token(token) for token in (publication.node_token, publication.token)]
        self._session, self._publication, self._sequence = session, publication, 0
        log.info("ros2: node %s publishes %s", self._settings.node, publication.key)
        return session, publication

    def _publish(self, session: zenoh.Session, publication: Publication, state: HeardArm, now_unix_s: float) -> None:
        self._sequence = self._sequence % MOST_SEQUENCE + 1
        payload = encoded(statuses(state, now_unix_s), now_unix_s)
        session.put(publication.key, payload, attachment=publication.attachment(self._sequence, round(now_unix_s * NS)))


def check(settings: Ros2Settings, plant: PlantConfiguration) -> Sequence[Finding]:
    """How far the gateway gets to the nodes of ROS 2, and who is there. Nothing is published."""

    def walk(steps: Steps) -> None:
        session = opened(settings, plant, steps)
        try:
            _say_nodes(settings, session, steps)
        finally:
            session.close()

    return attempted("ros2", walk)


def _say_nodes(settings: Ros2Settings, session: zenoh.Session, steps: Steps) -> None:
    """Which nodes of the domain subscribe to the topic; none is no mistake, they may come later."""
    publication = publication_of(settings, session)
    replies = session.liveliness().get(f"@ros2_lv/{settings.domain}/**", timeout=NODES_S)
    tokens = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
    topic = publication.token.split("/")[9:11]
    hearing = [token for token in tokens if len(token) == 13 and token[5] == SUBSCRIBER and token[9:11] == topic]
    other = sorted({token[11] for token in hearing if token[11] != publication.type_hash})
    if other:
        says = "type_hash = false" if settings.type_hash else "type_hash = true"
        raise NotReached("nodes", f"subscribers of {settings.topic} have another type, {other[0]}; try {says}")
    names = ", ".join(sorted({token[8] for token in hearing})) or "nobody yet"
    steps.say("nodes", f"{len(tokens)} entities in domain {settings.domain}; {settings.topic} is heard by {names}")
