"""How far the gateway gets at its broker: name, TCP, TLS, authentication, authorisation. No arm's topic is touched. I/O."""

from collections.abc import Iterator, Sequence

from monitor.errors import BadInput
from monitor.gateway.channel import Finding
from monitor.gateway.mqtt.broker import Broker, BrokerAway, Denied, tls_context
from monitor.gateway.mqtt.settings import MqttSettings
from monitor.gateway.reach import reach, tls
from monitor.plant.settings import PlantConfiguration

CHANNEL = "mqtt"
OF_CHECK = " check"  # a client id of its own: a running gateway keeps its connection


def check(settings: MqttSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """Each step until one fails."""
    return list(_steps(settings, plant))


def _steps(settings: MqttSettings, plant: PlantConfiguration) -> Iterator[Finding]:
    host, port = settings.address
    for finding in reach(CHANNEL, host, port):
        yield finding
        if not finding.ok:
            return
    try:
        if settings.tls:
            found = tls(CHANNEL, host, port, tls_context(settings, plant.folder))
            yield found
            if not found.ok:
                return
        broker = Broker(settings, plant.folder, suffix=OF_CHECK)
        try:
            broker.open()
        except BrokerAway:
            broker = Broker(settings, plant.folder, version_5=False, suffix=OF_CHECK)
            broker.open()
    except BrokerAway as away:
        yield Finding(CHANNEL, "authentication", False, f"{away}; {_advice(settings, str(away))}")
        return
    except BadInput as wrong:
        yield Finding(CHANNEL, "settings", False, str(wrong))
        return
    try:
        who = f"as {settings.user}" if settings.user else "without a user"
        yield Finding(CHANNEL, "authentication", True, f"MQTT {'5' if broker.version_5 else '3.1.1'}, {who}")
        yield _rights(settings, broker)
    finally:
        broker.close()


def _rights(settings: MqttSettings, broker: Broker) -> Finding:
    """Whether we may hear and publish. MQTT 3.1.1 has no word for a message that is not taken."""
    topics = [f"{settings.root}/+/+/availability"]
    topics += [f"{settings.home_assistant}/status"] if settings.home_assistant else []
    topics += [f"{settings.root}/+/+/cmd/ack"] if settings.allow_acknowledge else []
    published = [f"{settings.root}/check"]
    published += [f"{settings.home_assistant}/device/joint-monitor-check/check"] if settings.home_assistant else []
    doing = "subscribe to"
    try:
        for topic in topics:
            broker.subscribe([topic])
        doing = "publish on"
        for topic in published:
            broker.send(topic, b"{}", retain=False)
            if not broker.wait_idle():
                raise BrokerAway(f"{topic}: {broker.why}")
            if broker.denied:
                raise Denied(f"{topic}: {broker.denied}")
    except BrokerAway as away:
        return Finding(CHANNEL, "authorisation", False, f"we may not {doing} {away}; allow it in the broker's access control")
    unsure = "" if broker.version_5 else "; MQTT 3.1.1 does not say whether a message was taken"
    return Finding(CHANNEL, "authorisation", True, f"we may hear {', '.join(topics)} and publish below {settings.root}{unsure}")


def _advice(settings: MqttSettings, why: str) -> str:
    if "not authori" in why.lower() or "password" in why.lower():
        return "look at user and password, and at the broker's list of users"
    if settings.tls:
        return "a broker that asks for a certificate hangs up without one: look at cert_file and key_file"
    return "a port for TLS does not speak without it: look at tls and port"
