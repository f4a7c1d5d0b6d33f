"""One connection to an MQTT broker. It ends when it is lost; whoever needs another one makes another one. I/O.

Little is kept: at most `WINDOW` messages wait for the broker's word, and at most `MOST_COMMANDS` commands for us.
"""

import logging
import queue
import ssl
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from monitor.errors import BadInput, MonitorError
from monitor.gateway.mqtt.settings import MqttSettings
from monitor.gateway.mqtt.topics import OFFLINE, gateway

log = logging.getLogger(__name__)

WINDOW = 100  # messages that the broker has not acknowledged yet
WAIT_S = 10.0  # for the broker's word
MOST_COMMANDS = 100  # that wait; more are dropped, and that is logged
LARGEST = 65_536  # [bytes] of a message that is read
QOS = 1
WITHOUT = "MQTT needs the package paho-mqtt; install joint-monitor[gateway]"


class BrokerAway(MonitorError):
    """The broker does not answer, or does not let us in."""


class Denied(BrokerAway):
    """The broker lets us in, and does not let us do this."""


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
        try:
            import paho.mqtt.client as mqtt
            from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
        except ImportError:
            raise BadInput(WITHOUT) from None
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

    def open(self) -> None:
        """Connect. Raises BrokerAway with what is wrong."""
        host, port = self._settings.address
        try:
            self._client.connect_timeout = WAIT_S
            self._client.connect(host, port, keepalive=self._settings.keepalive_s)
        except (OSError, ValueError) as error:
            raise BrokerAway(f"{host}:{port}: {reason(error)}") from None
        self.reached = True
        self._client.loop_start()
        with self._changed:
            self._changed.wait_for(lambda: self._connected or self._why is not None, timeout=WAIT_S)
        if not self._connected:
            self.close()
            raise BrokerAway(f"{host}:{port}: {self._why or f'it does not speak MQTT: no answer within {WAIT_S:g} s'}")

    def close(self) -> None:
        """End the connection as agreed: the broker does not tell the last will."""
        self._client.disconnect()
        self._client.loop_stop()

    def send(self, topic: str, payload: bytes, *, retain: bool) -> None:
        """Hand a message to the broker, at least once. Waits while too many wait for its word. Raises BrokerAway."""
        until = time.monotonic() + WAIT_S
        while not self._window.acquire(timeout=0.2):
            if not self._connected or time.monotonic() > until:
                raise BrokerAway(self.why if not self._connected else f"it acknowledges nothing within {WAIT_S:g} s")
        if not self._connected:
            raise BrokerAway(self.why)
        self._sent += 1
        if self._client.publish(topic, payload, QOS, retain).rc != 0:
            raise BrokerAway(self.why)

    def wait_idle(self, timeout_s: float = WAIT_S) -> bool:
        """Wait until everything is acknowledged. Returns whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self.idle or not self._connected, timeout=timeout_s) and self.idle

    def subscribe(self, topics: list[str]) -> None:
        """Raises Denied where the broker refuses one, BrokerAway where it says nothing."""
        code, number = self._client.subscribe([(topic, QOS) for topic in topics])
        if code != 0 or number is None:
            raise BrokerAway(self.why)
        with self._changed:
            self._changed.wait_for(lambda: number in self._codes or not self._connected, timeout=WAIT_S)
            codes = self._codes.pop(number, None)
        if codes is None:
            raise BrokerAway(f"{topics[0]}: the subscription was not answered: {self.why}")
        for topic, refused in zip(topics, codes, strict=False):
            if refused:
                raise Denied(f"{topic}: {refused}")

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


def tls_context(settings: MqttSettings, folder: Path) -> ssl.SSLContext:
    """What the broker must show, and what we show. Raises BadInput naming a file that cannot be read."""
    try:
        context = ssl.create_default_context(cafile=str(folder / settings.ca_file) if settings.ca_file else None)
    except (OSError, ssl.SSLError) as error:
        raise BadInput(f"mqtt: ca_file {settings.ca_file}: {reason(error)}") from None
    if settings.cert_file:
        try:
            context.load_cert_chain(folder / settings.cert_file, folder / settings.key_file)
        except (OSError, ssl.SSLError) as error:
            raise BadInput(f"mqtt: cert_file {settings.cert_file}, key_file {settings.key_file}: {reason(error)}") from None
    return context


def reason(error: Exception) -> str:
    """In a few words."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not believed ({error.verify_message})"
    if isinstance(error, ssl.SSLError):
        return f"no TLS ({error.reason or error})"
    if isinstance(error, TimeoutError):
        return "nobody answers in time"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
