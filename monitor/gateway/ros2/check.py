"""How far the gateway gets to the nodes of ROS 2: name, TCP, Zenoh, and who is there. Nothing is published. I/O."""

import re
from collections.abc import Iterator, Sequence

import zenoh

from monitor.errors import BadConfiguration, BadInput, BusError
from monitor.gateway.channel import Finding, needs
from monitor.gateway.reach import reach
from monitor.gateway.ros2.channel import open_session, publication_of
from monitor.gateway.ros2.settings import Ros2Settings
from monitor.plant.settings import PlantConfiguration

CHANNEL = "ros2"
SUBSCRIBER = "MS"
TIMEOUT_S = 2.0


def check(settings: Ros2Settings, plant: PlantConfiguration) -> Sequence[Finding]:
    """Each step until one fails."""
    return list(_steps(settings, plant))


def _steps(settings: Ros2Settings, plant: PlantConfiguration) -> Iterator[Finding]:
    try:
        needs("rosbags", "[ros2]: messages of ROS 2")
    except BadConfiguration as absent:
        yield Finding(CHANNEL, "settings", False, str(absent))
        return
    at = re.match(r"(?:tcp|tls)/(?:\[(.+)\]|([^:]+)):(\d+)", settings.connect)  # other protocols are Zenoh's alone to try
    for finding in reach(CHANNEL, at[1] or at[2], int(at[3])) if at else ():
        yield finding
        if not finding.ok:
            return
    try:
        session = open_session(settings, plant)
    except (BusError, BadInput) as error:
        yield Finding(CHANNEL, "zenoh", False, str(error))
        return
    try:
        yield Finding(CHANNEL, "zenoh", True, f"a session with {settings.connect}")
        yield _nodes(settings, session)
    finally:
        session.close()


def _nodes(settings: Ros2Settings, session: zenoh.Session) -> Finding:
    """Which nodes of the domain subscribe to the topic; none is no mistake, they may come later."""
    publication = publication_of(settings, session)
    replies = session.liveliness().get(f"@ros2_lv/{settings.domain}/**", timeout=TIMEOUT_S)
    tokens = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
    topic = publication.token.split("/")[9:11]
    hearing = [token for token in tokens if len(token) == 13 and token[5] == SUBSCRIBER and token[9:11] == topic]
    other = sorted({token[11] for token in hearing if token[11] != publication.type_hash})
    if other:
        says = "type_hash = false" if settings.type_hash else "type_hash = true"
        return Finding(CHANNEL, "nodes", False, f"subscribers of {settings.topic} have another type, {other[0]}; try {says}")
    names = ", ".join(sorted({token[8] for token in hearing})) or "nobody yet"
    return Finding(CHANNEL, "nodes", True, f"{len(tokens)} entities in domain {settings.domain}; {settings.topic} is heard by {names}")
