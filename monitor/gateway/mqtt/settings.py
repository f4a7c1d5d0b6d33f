"""The section [mqtt] of the plant's file."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from monitor.errors import BadInput

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
