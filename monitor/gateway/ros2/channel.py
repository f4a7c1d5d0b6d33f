"""The channel `ros2`: publishes every arm's diagnostics again and again, as a node of ROS 2 does. I/O.

Only the present counts, so nothing is owed: who subscribes later hears it within a period.
"""

import json
import logging
from collections.abc import Sequence

import zenoh

from monitor.errors import BusError
from monitor.gateway.channel import Surroundings, needs
from monitor.gateway.figures import figures
from monitor.gateway.ros2.graph import NO_HASH, Publication
from monitor.gateway.ros2.messages import MESSAGE, NS, encoded, statuses, type_hash
from monitor.gateway.ros2.settings import Ros2Settings
from monitor.gateway.values import ArmState, Delivery, Transition
from monitor.plant.settings import PlantConfiguration
from monitor.publish.session import session_config

log = logging.getLogger(__name__)

CONNECT_MS = 2000
MOST_SEQUENCE = 2**62


def open_session(settings: Ros2Settings, plant: PlantConfiguration) -> zenoh.Session:
    """A session with the router of the ROS 2 nodes. Raises BusError where it does not answer, BadInput for a wrong file."""
    config = session_config(
        mode="client", connect=(settings.connect,), zenoh_file=str(plant.folder / settings.zenoh) if settings.zenoh else ""
    )
    config.insert_json5("connect/timeout_ms", json.dumps(CONNECT_MS))
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        raise BusError(f"{settings.connect}: no Zenoh router answers; does `ros2 run rmw_zenoh_cpp rmw_zenohd` run there?") from None


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
        needs("rosbags", "[ros2]: messages of ROS 2")
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
        """Publish every arm, a message each. Raises BusError where the router is away."""
        session, publication = self._opened()
        if not session.info.routers_zid() and not session.info.peers_zid():
            self._told = 0
            raise BusError(f"{self._settings.connect}: the router is away; the session waits for it")
        arms = [state for name, state in self._arms().items() if not self._settings.sites or name.site in self._settings.sites]
        try:
            for state in arms:
                self._publish(session, publication, state, now_unix_s)
        except zenoh.ZError as error:
            self.close()
            raise BusError(f"{self._settings.connect}: {error}") from None
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
        session = open_session(self._settings, self._plant)
        publication = publication_of(self._settings, session)
        self._tokens = [session.liveliness().declare_token(token) for token in (publication.node_token, publication.token)]
        self._session, self._publication, self._sequence = session, publication, 0
        log.info("ros2: node %s publishes %s", self._settings.node, publication.key)
        return session, publication

    def _publish(self, session: zenoh.Session, publication: Publication, state: ArmState, now_unix_s: float) -> None:
        self._sequence = self._sequence % MOST_SEQUENCE + 1
        payload = encoded(statuses(figures(state), now_unix_s), now_unix_s)
        session.put(publication.key, payload, attachment=publication.attachment(self._sequence, round(now_unix_s * NS)))
