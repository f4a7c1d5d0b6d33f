"""The broker: the section [mqtt], one connection, and how far it gets. I/O.

A connection ends when it is lost; whoever needs another one makes another one. Little is kept: at most `WINDOW` messages wait for the
broker's word, and at most `MOST_COMMANDS` commands for us.
"""

import logging
import queue
import ssl
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from annotated_types import Interval

from monitor.errors import BadInput
from monitor.gateway.connection import Finding, NotReached, Steps, attempted, believed, not_reached, say_reached
from monitor.gateway.mqtt.messages import OFFLINE, gateway
from monitor.plant.settings import PlantConfiguration

log = logging.getLogger(__name__)

WINDOW = 100  # messages that the broker has not acknowledged yet
WAIT_S = 10.0  # for the broker's word
MOST_COMMANDS = 100  # that wait; more are dropped, and that is logged
LARGEST = 65_536  # [bytes] of a message that is read
QOS = 1
OF_CHECK = " check"  # suffix of the client id: a running gateway keeps its connection
REFUSED_USER = ("Bad user name or password", "Not authorized")  # of MQTT 5 and 3.1.1, as paho names the codes 134, 135, 4 and 5
OTHER_VERSION = "Unsupported protocol version"
PORT, TLS_PORT = 1883, 8883
LONGEST_ROOT = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class MqttSettings:
    """Which broker is told, how it is reached, and below which topic."""

    host: str = ""  # of the broker, e.g. "broker.example"; empty: no broker is told
    port: Annotated[int, Interval(ge=0, le=65535)] = 0  # 0: 8883 with TLS, 1883 without
    tls: bool = True  # false: every message travels as it is, and a password too
    ca_file: str = ""  # PEM of the authority that signed the broker's certificate; empty: those that the system trusts
    cert_file: str = ""  # PEM of the gateway's own certificate, where the broker asks for one
    key_file: str = ""  # PEM of its key
    user: str = ""  # of the broker's list of users; empty: none
    password: str = field(default="", repr=False)  # "credential:mqtt-password": the file mqtt-password in the service's credentials
    client_id: str = ""  # empty: made of the topic root; no two clients of a broker share one
    root: str = "joint-monitor"  # topics are ROOT/SITE/ROBOT/…; no two gateways of a broker share one
    sites: tuple[str, ...] = ()  # only these sites are told; empty: all
    home_assistant: str = "homeassistant"  # its discovery prefix; empty: nothing is announced
    allow_acknowledge: bool = False  # a message on ROOT/SITE/ROBOT/cmd/ack acknowledges: whoever may publish there may acknowledge
    keepalive_s: Annotated[int, Interval(ge=5, le=3600)] = 30  # [s] after 1.5 of these the broker says that we are gone

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        for key in ("root", "home_assistant"):
            topic = getattr(self, key)
            if topic and not is_topic(topic):
                raise BadInput(f"mqtt: {key} = {topic!r}; expected levels of text with / between them, without +, #, $ at the beginning")
        if not self.root:
            raise BadInput('mqtt: root = ""; expected the topic below which everything is published, e.g. "joint-monitor"')
        if self.password and not self.user:
            raise BadInput("mqtt: password, but no user; expected both or neither")
        if bool(self.cert_file) != bool(self.key_file):
            raise BadInput("mqtt: cert_file and key_file belong together; expected both or neither")
        if not self.tls and (self.ca_file or self.cert_file):
            raise BadInput("mqtt: tls = false, but a certificate is named; expected tls = true beside it")
        if any(character in self.host for character in "/ @") or "://" in self.host:
            raise BadInput(f"mqtt: host = {self.host!r}; expected a name or an address alone, e.g. broker.example")

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the broker."""
        return self.host, self.port or (TLS_PORT if self.tls else PORT)

    @property
    def client(self) -> str:
        """The client id: the same after each start, so that a broker replaces a connection that has died."""
        return self.client_id or f"joint-monitor-gateway {self.root}"


def is_topic(topic: str) -> bool:
    """Whether a text may be the beginning of a topic: MQTT 5, 4.7."""
    levels = topic.split("/")
    return (
        len(topic.encode()) <= LONGEST_ROOT
        and all(levels)
        and not topic.startswith("$")
        and not any(character in "+#" or ord(character) < 0x20 or 0x7F <= ord(character) < 0xA0 for character in topic)
    )


class Incoming(NamedTuple):
    """A message that came."""

    topic: str
    payload: bytes
    kept: bool  # by the broker, from earlier


class Broker:
    """One connection. Its callbacks run in a thread of the library's; everything else is called by one thread."""

    def __init__(self, settings: MqttSettings, folder: Path, *, version_5: bool = True, suffix: str = "") -> None:
        """Nothing is opened yet.

        suffix : of the client id, for a second client beside a running gateway. Raises BadInput where a file cannot be read.
        """
        import paho.mqtt.client as mqtt
        from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

        self._settings, self.version_5 = settings, version_5
        self._window = threading.Semaphore(WINDOW)
        self._changed = threading.Condition()
        self.reached = False  # whether somebody took the connection
        self.answered = False  # and said yes or no in MQTT
        self._connected = False
        self._why: str | None = None  # why not, or not any more
        self._codes: dict[int, list[str | None]] = {}  # by number of a subscription: why each topic was refused
        self._sent = self._acknowledged = 0
        self.denied: str | None = None  # the broker's word on a message that it did not take
        self.incoming: queue.Queue[Incoming] = queue.Queue(MOST_COMMANDS)
        self.kept: set[str] = set()  # topics of messages that the broker kept from earlier
        self._client: Any = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            client_id=settings.client + suffix,
            protocol=MQTTProtocolVersion.MQTTv5 if version_5 else MQTTProtocolVersion.MQTTv311,
            clean_session=None if version_5 else True,
            reconnect_on_failure=False,
        )
        if settings.user:
            self._client.username_pw_set(settings.user, settings.password or None)
        if settings.tls:
            self._client.tls_set_context(tls_context(settings, folder))
        if not suffix:
            self._client.will_set(gateway(settings.root), OFFLINE, QOS, retain=True)
        self._client.on_connect, self._client.on_disconnect = self._on_connect, self._on_disconnect
        self._client.on_publish, self._client.on_subscribe = self._on_publish, self._on_subscribe
        self._client.on_message = self._on_message

    @property
    def connected(self) -> bool:
        """Whether messages can be sent."""
        return self._connected

    @property
    def why(self) -> str:
        """Why there is no connection."""
        return self._why or "the connection was lost"

    @property
    def idle(self) -> bool:
        """Whether the broker has acknowledged everything."""
        return self._acknowledged >= self._sent

    def open(self, steps: Steps) -> None:
        """Connect. Raises NotReached with what is wrong."""
        host, port = self._settings.address
        try:
            self._client.connect_timeout = WAIT_S
            self._client.connect(host, port, keepalive=self._settings.keepalive_s)
            if (connection := self._client.socket()) is not None:  # it may be lost again already
                say_reached(steps, host, port, connection)
        except (OSError, ValueError) as error:
            raise not_reached(host, port, steps, error) from None
        self.reached = True
        self._client.loop_start()
        with self._changed:
            self._changed.wait_for(lambda: self._connected or self._why is not None, timeout=WAIT_S)
        if not self._connected:
            self.close()
            why = self._why or f"it does not speak MQTT: no answer within {WAIT_S:g} s"
            raise NotReached("authentication", f"{host}:{port}: {why}; {self._advice()}")

    def _advice(self) -> str:
        if self._why in REFUSED_USER:
            return "look at user and password, and at the broker's list of users"
        if self._settings.tls:
            return "a broker that asks for a certificate hangs up without one: look at cert_file and key_file"
        return "a port for TLS does not speak without it: look at tls and port"

    def close(self) -> None:
        """End the connection as agreed: the broker does not tell the last will."""
        self._client.disconnect()
        self._client.loop_stop()

    def send(self, topic: str, payload: bytes, *, retain: bool) -> None:
        """Hand a message to the broker, at least once. Waits while too many wait for its word. Raises NotReached."""
        until = time.monotonic() + WAIT_S
        while not self._window.acquire(timeout=0.2):
            if not self._connected or time.monotonic() > until:
                raise NotReached("authorisation", self.why if not self._connected else f"it acknowledges nothing within {WAIT_S:g} s")
        if not self._connected:
            raise NotReached("authorisation", self.why)
        self._sent += 1
        if self._client.publish(topic, payload, QOS, retain).rc != 0:
            raise NotReached("authorisation", self.why)

    def wait_idle(self, timeout_s: float = WAIT_S) -> bool:
        """Wait until everything is acknowledged. Returns whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self.idle or not self._connected, timeout=timeout_s) and self.idle

    def subscribe(self, topics: list[str]) -> dict[str, str]:
        """Subscribe. Returns the topics that the broker refuses, each with its word. Raises NotReached where it says nothing."""
        code, number = self._client.subscribe([(topic, QOS) for topic in topics])
        if code != 0 or number is None:
            raise NotReached("authorisation", self.why)
        with self._changed:
            self._changed.wait_for(lambda: number in self._codes or not self._connected, timeout=WAIT_S)
            codes = self._codes.pop(number, None)
        if codes is None:
            raise NotReached("authorisation", f"{topics[0]}: the subscription was not answered: {self.why}")
        return {topic: refused for topic, refused in zip(topics, codes, strict=False) if refused}

    # --- in the library's thread

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        with self._changed:
            self.answered = True
            self._connected = not code.is_failure
            if code.is_failure:
                self._why = str(code)
            self._changed.notify_all()

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        with self._changed:
            self._connected = False
            if self._why is None:
                self._why = f"the connection was lost ({code})"
            self._changed.notify_all()

    def _on_publish(self, _client: Any, _data: Any, _number: int, code: Any, _properties: Any) -> None:
        self._window.release()
        with self._changed:
            self._acknowledged += 1
            if code.is_failure:
                self.denied = str(code)
            self._changed.notify_all()

    def _on_subscribe(self, _client: Any, _data: Any, number: int, codes: Any, _properties: Any) -> None:
        with self._changed:
            self._codes[number] = [str(code) if code.is_failure else None for code in codes]
            self._changed.notify_all()

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        if message.retain and not message.topic.endswith("/cmd/ack"):
            self.kept.add(message.topic)
        elif len(message.payload) <= LARGEST:
            try:
                self.incoming.put_nowait(Incoming(message.topic, bytes(message.payload), bool(message.retain)))
            except queue.Full:
                log.warning("mqtt: more than %d messages at once; one on %s is dropped", MOST_COMMANDS, message.topic)


def connected(settings: MqttSettings, folder: Path, steps: Steps, suffix: str = "") -> Broker:
    """A connection by MQTT 5, or by 3.1.1 where the broker is an older one. Raises BadInput, NotReached."""
    broker = Broker(settings, folder, suffix=suffix)
    try:
        broker.open(steps)
    except NotReached:
        if not (broker.reached and (not broker.answered or broker.why == OTHER_VERSION)):
            raise  # an older broker may hang up instead of saying so
        steps.found.clear()
        broker = Broker(settings, folder, version_5=False, suffix=suffix)
        broker.open(steps)
    who = f"as {settings.user}" if settings.user else "without a user"
    steps.say("authentication", f"MQTT {'5' if broker.version_5 else '3.1.1'}, {who}")
    return broker


def heard_topics(settings: MqttSettings) -> list[str]:
    """The topics to which a gateway subscribes."""
    topics = [f"{settings.root}/+/+/availability"]
    topics += [f"{settings.home_assistant}/status"] if settings.home_assistant else []
    return topics + ([f"{settings.root}/+/+/cmd/ack"] if settings.allow_acknowledge else [])


def check(settings: MqttSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """How far the gateway gets: name, TCP, TLS, authentication, authorisation. No arm's topic is touched."""

    def walk(steps: Steps) -> None:
        broker = connected(settings, plant.folder, steps, OF_CHECK)
        try:
            _try_rights(settings, broker, steps)
        finally:
            broker.close()

    return attempted("mqtt", walk)


def _try_rights(settings: MqttSettings, broker: Broker, steps: Steps) -> None:
    """Whether we may hear and publish. MQTT 3.1.1 has no word for a message that is not taken. Raises NotReached."""

    def refused(doing: str, topic: str, why: str) -> NotReached:
        return NotReached("authorisation", f"we may not {doing} {topic}: {why}; allow it in the broker's access control")

    topics = heard_topics(settings)
    for topic in topics:
        for why in broker.subscribe([topic]).values():
            raise refused("subscribe to", topic, why)
    published = [f"{settings.root}/check"]
    published += [f"{settings.home_assistant}/device/joint-monitor-check/check"] if settings.home_assistant else []
    for topic in published:
        broker.send(topic, b"{}", retain=False)
        if not broker.wait_idle() or broker.denied:
            raise refused("publish on", topic, broker.denied or broker.why)
    unsure = "" if broker.version_5 else "; MQTT 3.1.1 does not say whether a message was taken"
    steps.say("authorisation", f"we may hear {', '.join(topics)} and publish below {settings.root}{unsure}")


def tls_context(settings: MqttSettings, folder: Path) -> ssl.SSLContext:
    """What the broker must show, and what we show. Raises BadInput naming a file that cannot be read."""
    context = believed(settings.ca_file, folder, "mqtt")
    if settings.cert_file:
        try:
            context.load_cert_chain(folder / settings.cert_file, folder / settings.key_file)
        except (OSError, ssl.SSLError) as error:
            why = getattr(error, "strerror", None) or error
            raise BadInput(f"mqtt: cert_file {settings.cert_file}, key_file {settings.key_file}: {why}") from None
    return context
