"""The channel `mqtt`: keeps a broker's retained messages as the arms are. I/O.

Only the newest value of each topic counts, so nothing is queued while the broker is away: when it is back, everything is told once. What is
remembered of a topic is a digest of what was told last.
"""

import hashlib
import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import orjson

from monitor.errors import BadInput
from monitor.gateway.channel import Surroundings
from monitor.gateway.commands import Commands
from monitor.gateway.connection import NotReached, Steps
from monitor.gateway.mqtt.broker import Broker, MqttSettings, connected, heard_topics
from monitor.gateway.mqtt.messages import OFFLINE, ONLINE, ArmTopics, discovery, gateway, messages, named
from monitor.gateway.values import Delivery, Transition
from monitor.plant.arm import MOST_JOINTS, ArmName, HeardArm
from monitor.plant.screen.people import Role
from monitor.publish.documents import Alert
from monitor.publish.shown import unacknowledged

log = logging.getLogger(__name__)

AT_MOST_S = 5.0  # of one step for hearing, and for telling: the rest is done by the next one
PAUSE_S = 1.0
GOODBYE_S = 3.0
LONGEST_NAME, LONGEST_WHY = 100, 2000  # letters of whoever acknowledges, and of his reason


class MqttChannel:
    """A `Channel`. It owes nothing: a retained message holds for whoever comes later."""

    name = "mqtt"

    def __init__(self, settings: MqttSettings, surroundings: Surroundings) -> None:
        self._settings, self._arms, self._commands = settings, surroundings.arms, surroundings.commands
        self._folder: Path = surroundings.plant.folder
        self._broker: Broker | None = None
        self._told: dict[str, bytes] = {}  # digest of what the broker keeps, by topic
        self._seen: dict[ArmName, tuple[HeardArm, bool]] = {}  # what it was told of: the state, and whether it was heard
        self._due: dict[ArmName, None] = {}  # to be told, in order
        self._gone: dict[ArmTopics, None] = {}  # to be cleared
        self._online = False

    def offer(self, transition: Transition) -> Sequence[Delivery]:  # noqa: ARG002 - of Channel
        """Nothing is owed."""
        return ()

    def status(self) -> str:
        """For `gateway status`."""
        broker = self._broker
        if broker is None or not broker.connected:
            return "not connected"
        waits = f", {len(self._due)} to be told" if self._due else ""
        denied = f"; the broker refuses messages: {broker.denied}" if broker.denied else ""
        return f"{len(self._seen)} arms at {self._settings.address[0]}, MQTT {'5' if broker.version_5 else '3.1.1'}{waits}{denied}"

    def step(self, now_unix_s: float) -> float:
        """Tell what has changed. Raises NotReached."""
        broker = self._connected()
        try:
            self._look(now_unix_s, broker)
            self._hear(broker)
            until = time.monotonic() + AT_MOST_S
            while self._gone and time.monotonic() < until:
                self._clear(broker, next(iter(self._gone)))
            while self._due and time.monotonic() < until:
                self._tell(broker, next(iter(self._due)), now_unix_s)
            if not self._online and self._seen and not self._due:
                broker.send(gateway(self._settings.root), ONLINE.encode(), retain=True)
                self._online = True
        except NotReached:
            self._leave()
            raise
        return 0.0 if self._due or self._gone or not broker.incoming.empty() else PAUSE_S

    def close(self) -> None:
        """Say goodbye: everybody sees that the gateway tells nothing any more."""
        broker, self._broker = self._broker, None
        if broker is None:
            return
        if broker.connected:
            try:
                broker.send(gateway(self._settings.root), OFFLINE.encode(), retain=True)
                broker.wait_idle(GOODBYE_S)
            except NotReached:
                log.info("mqtt: the broker is away; its last will says that the gateway is gone")
        broker.close()

    # --- the connection

    def _connected(self) -> Broker:
        """The connection, a new one where it was lost: everything is told anew, since nobody knows what the broker still has."""
        if self._broker is not None and self._broker.connected:
            return self._broker
        if self._broker is not None:
            why = self._broker.why
            self._leave()
            raise NotReached("tcp", f"{self._settings.address[0]}: {why}")
        broker = connected(self._settings, self._folder, Steps())
        self._told.clear()
        self._online = False
        self._due |= dict.fromkeys(self._seen)
        self._broker = broker
        try:
            for topic in heard_topics(self._settings):  # one by one: a broker may refuse one of them
                for why in broker.subscribe([topic]).values():
                    log.warning("mqtt: the broker does not let us hear %s: %s", topic, why)
        except NotReached:
            self._leave()
            raise
        log.info("mqtt: connected with %s, MQTT %s", self._settings.address[0], "5" if broker.version_5 else "3.1.1")
        return broker

    def _leave(self) -> None:
        broker, self._broker = self._broker, None
        if broker is not None:
            broker.close()

    # --- what there is to tell

    def _look(self, now_unix_s: float, broker: Broker) -> None:
        """Note which arms have changed, and which are gone. No arm at all means that the plant's database was not read yet."""
        arms = {name: state for name, state in self._arms().items() if not self._settings.sites or name.site in self._settings.sites}
        if not arms:
            return
        for name, state in arms.items():
            before, heard = self._seen.get(name), state.silence(now_unix_s) is None
            if before is None or before[0] is not state or before[1] != heard:
                self._seen[name] = (state, heard)
                self._due[name] = None
        for name in [name for name in self._seen if name not in arms]:
            del self._seen[name]
            self._due.pop(name, None)
            self._gone[self._topics(name)] = None
        kept, broker.kept = broker.kept, set()
        for topic in kept:
            found = named(self._settings.root, topic)
            if found is not None and ArmName(found.site, found.robot) not in arms:
                self._gone[found] = None  # told by an earlier run, and removed since

    def _tell(self, broker: Broker, name: ArmName, now_unix_s: float) -> None:
        topics, arm = self._topics(name), self._seen[name][0]
        told = messages(arm, topics, now_unix_s)
        if self._settings.home_assistant:
            announced = discovery(arm, topics, acknowledge=self._settings.allow_acknowledge)
            told = {topics.discovery(self._settings.home_assistant): announced} | told
        for topic, payload in told.items():
            digest = hashlib.blake2b(payload, digest_size=8).digest()
            if self._told.get(topic) != digest:
                broker.send(topic, payload, retain=True)
                self._told[topic] = digest
        self._due.pop(name, None)

    def _clear(self, broker: Broker, topics: ArmTopics) -> None:
        """An empty retained message takes the kept one away; Home Assistant removes the device."""
        emptied = [topics.state, topics.alerts, *(topics.joint(joint) for joint in range(1, MOST_JOINTS + 1)), topics.availability]
        if self._settings.home_assistant:
            emptied.insert(0, topics.discovery(self._settings.home_assistant))
        for topic in emptied:
            broker.send(topic, b"", retain=True)
            self._told.pop(topic, None)
        log.info("mqtt: %s/%s is no arm of the plant; its topics are cleared", topics.site, topics.robot)
        del self._gone[topics]

    def _topics(self, name: ArmName) -> ArmTopics:
        return ArmTopics(self._settings.root, name.site, name.robot)

    # --- what comes back

    def _hear(self, broker: Broker) -> None:
        until = time.monotonic() + AT_MOST_S  # an arm that does not answer takes ten seconds, and a hundred requests may wait
        while not broker.incoming.empty() and time.monotonic() < until:
            topic, payload, kept = broker.incoming.get()
            if self._settings.home_assistant and topic == f"{self._settings.home_assistant}/status":
                if payload == ONLINE.encode():
                    self._announce()
            elif self._settings.allow_acknowledge and topic.endswith("/cmd/ack"):
                self._acknowledge(broker, topic, payload, kept=kept)

    def _announce(self) -> None:
        """Home Assistant was started: it is told of every device once more."""
        log.info("mqtt: Home Assistant was started; %d devices are announced", len(self._seen))
        for name in self._seen:
            self._told.pop(self._topics(name).discovery(self._settings.home_assistant), None)
            self._due[name] = None

    def _acknowledge(self, broker: Broker, topic: str, payload: bytes, *, kept: bool) -> None:
        """Carry out what somebody asks, and answer beside it. A message that the broker kept is of nobody knows when: it is refused."""
        found = named(self._settings.root, topic)
        if found is None:
            return
        name = ArmName(found.site, found.robot)
        try:
            if kept:
                raise BadInput("the message was retained; publish it without `retain`")
            known = self._seen.get(name)
            if known is None:
                raise BadInput(f"{name} is no arm of the plant")
            about = request_in(payload)
            done, text = acknowledge(self._commands, name, asked_for(known[0].alerts, about), about)
        except BadInput as error:
            log.warning("mqtt: a message on %r is refused: %s", topic, error)
            done, text = 0, str(error)
        broker.send(f"{topic}/answer", orjson.dumps({"done": done, "text": text}), retain=False)


def request_in(payload: bytes) -> Mapping[str, Any]:
    """What somebody asks for. Raises BadInput."""
    try:
        about = orjson.loads(payload)
    except orjson.JSONDecodeError:
        raise BadInput('expected a JSON object, e.g. {"joint": 3, "by": "Ada", "why": "ordered a gear"}') from None
    if not isinstance(about, dict):
        raise BadInput("expected a JSON object")
    unknown = set(about) - {"joint", "condition", "by", "why"}
    if unknown:
        raise BadInput(f"{sorted(unknown)[0]!r} is unknown; known are joint, condition, by, why")
    joint = about.get("joint")
    if joint is not None and (isinstance(joint, bool) or not isinstance(joint, int)):
        raise BadInput(f"joint = {joint!r}; expected a number, or null for the arm")
    for key in ("condition", "by", "why"):
        if key in about and not isinstance(about[key], str):
            raise BadInput(f"{key} = {about[key]!r}; expected text")
    return about


def asked_for(alerts: Sequence[Alert], about: Mapping[str, Any]) -> list[Alert]:
    """The alerts that a request names and that wait for a person; without `joint` those of every joint and of the arm."""
    return [
        each
        for each in unacknowledged(alerts)
        if ("joint" not in about or each.joint == about["joint"]) and about.get("condition", each.condition) == each.condition
    ]


def acknowledge(commands: Commands, name: ArmName, alerts: Sequence[Alert], about: Mapping[str, Any]) -> tuple[int, str]:
    """Acknowledge alerts at the arm itself, until it refuses one. Returns how many, and what to tell."""
    who = " ".join(str(about.get("by") or "somebody").split())[:LONGEST_NAME]
    for done, alert in enumerate(alerts):
        document = {"joint": alert.joint, "condition": alert.condition, "why": str(about.get("why") or "")[:LONGEST_WHY]}
        try:
            # whoever the broker lets publish there has this role, because `allow_acknowledge` says so
            commands.send(name, "ack", document, who=f"{who} (MQTT)", role=Role.acknowledge, via="mqtt")
        except BadInput as error:
            return done, str(error)
    return len(alerts), f"acknowledged: {len(alerts)}" if alerts else "no alert waits for a person"
