"""The channels that exist. A further one is a section, a settings class, and an entry here."""

from collections.abc import Sequence

from monitor.gateway.channel import Channel, Finding, Kind, Surroundings
from monitor.gateway.mqtt.settings import MqttSettings
from monitor.gateway.notify.settings import NotifySettings
from monitor.gateway.opcua.settings import OpcuaSettings
from monitor.gateway.ros2.settings import Ros2Settings
from monitor.gateway.tickets.settings import TicketSettings
from monitor.plant.settings import PlantConfiguration


def _mqtt(settings: MqttSettings, surroundings: Surroundings) -> Sequence[Channel]:
    from monitor.gateway.mqtt.channel import MqttChannel

    return [MqttChannel(settings, surroundings)]


def _check_mqtt(settings: MqttSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    from monitor.gateway.mqtt.check import check

    return check(settings, plant)


def _notify(settings: NotifySettings, surroundings: Surroundings) -> Sequence[Channel]:
    from monitor.gateway.notify.ways import channels

    return channels(settings, surroundings)


def _check_notify(settings: NotifySettings, plant: PlantConfiguration) -> Sequence[Finding]:
    from monitor.gateway.notify.check import check

    return check(settings, plant)


def _opcua(settings: OpcuaSettings, surroundings: Surroundings) -> Sequence[Channel]:
    from monitor.gateway.opcua.channel import OpcuaChannel

    return [OpcuaChannel(settings, surroundings)]


def _check_opcua(settings: OpcuaSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    from monitor.gateway.opcua.check import check

    return check(settings, plant)


def _ros2(settings: Ros2Settings, surroundings: Surroundings) -> Sequence[Channel]:
    from monitor.gateway.ros2.channel import Ros2Channel

    return [Ros2Channel(settings, surroundings)]


def _check_ros2(settings: Ros2Settings, plant: PlantConfiguration) -> Sequence[Finding]:
    from monitor.gateway.ros2.check import check

    return check(settings, plant)


def _tickets(settings: TicketSettings, surroundings: Surroundings) -> Sequence[Channel]:
    from monitor.gateway.tickets.ways import channels

    return channels(settings, surroundings)


def _check_tickets(settings: TicketSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    from monitor.gateway.tickets.check import check

    return check(settings, plant)


# settings class of each section
SECTIONS: dict[str, type] = {
    "notify": NotifySettings,
    "tickets": TicketSettings,
    "mqtt": MqttSettings,
    "opcua": OpcuaSettings,
    "ros2": Ros2Settings,
}
CHANNELS: tuple[Kind, ...] = (
    Kind("notify", lambda settings: bool(settings.to), _notify, _check_notify, owes=True),
    Kind("tickets", lambda settings: bool(settings.open_url), _tickets, _check_tickets, owes=True),
    Kind("mqtt", lambda settings: bool(settings.host), _mqtt, _check_mqtt),
    Kind("opcua", lambda settings: bool(settings.listen), _opcua, _check_opcua),
    Kind("ros2", lambda settings: bool(settings.connect), _ros2, _check_ros2),
)
