"""The sections of the gateway in the plant's file, the channels that exist, and how far each gets. I/O.

All channels are off by default. A further one is a settings class and an entry of `CHANNELS`.
"""

import dataclasses
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from annotated_types import Interval

from monitor.config.notify import NotifySettings
from monitor.errors import BadConfiguration, BadInput
from monitor.gateway.channel import Channel, Surroundings
from monitor.gateway.connection import Finding, believed, needs
from monitor.gateway.mqtt import broker
from monitor.gateway.mqtt import channel as mqtt
from monitor.gateway.notify import people
from monitor.gateway.opcua import settings as opcua
from monitor.gateway.ros2 import channel as ros2
from monitor.gateway.tickets import listener as tickets
from monitor.gateway.tickets.settings import TicketSettings
from monitor.plant.settings import OF_GATEWAY, OF_SERVICE, PlantConfiguration, PlantSettings, load_sections
from monitor.publish.session import read_as_session
from monitor.views.language.catalogue import LANGUAGES


class Kind(NamedTuple):
    """A kind of channels: their section of the file, and how they are made."""

    section: str
    settings: type
    enabled: Callable[[Any], bool]  # of the section's settings
    make: Callable[[Any, Surroundings], Sequence[Channel]]
    check: Callable[[Any, PlantConfiguration], Sequence[Finding]]  # from outside of the service; no message is sent
    read_files: Callable[[Any, PlantConfiguration], object]  # those that the section names, as the channel reads them; raises BadInput
    owes: bool = False  # whether transitions become deliveries; else a channel shows states, and several gateways may


def _opcua(settings: opcua.OpcuaSettings, surroundings: Surroundings) -> Sequence[Channel]:
    needs("asyncua", "[opcua]")
    from monitor.gateway.opcua.server import OpcuaChannel  # the library takes a second

    return [OpcuaChannel(settings, surroundings)]


def _authority(section: str) -> Callable[[Any, PlantConfiguration], object]:
    return lambda settings, plant: believed(settings.ca_file, plant.folder, section)


CHANNELS: tuple[Kind, ...] = (
    Kind("notify", NotifySettings, lambda settings: bool(settings.to), people.channels, people.check, _authority("notify"), owes=True),
    Kind(
        "tickets",
        TicketSettings,
        lambda settings: bool(settings.open_url),
        tickets.channels,
        tickets.check,
        _authority("tickets"),
        owes=True,
    ),
    Kind(
        "mqtt",
        broker.MqttSettings,
        lambda settings: bool(settings.host),
        lambda *given: [mqtt.MqttChannel(*given)],
        broker.check,
        lambda settings, plant: settings.tls and broker.tls_context(settings, plant.folder),
    ),
    Kind("opcua", opcua.OpcuaSettings, lambda settings: bool(settings.listen), _opcua, opcua.check, opcua.read_files),
    Kind(
        "ros2",
        ros2.Ros2Settings,
        lambda settings: bool(settings.connect),
        lambda *given: [ros2.Ros2Channel(*given)],
        ros2.check,
        lambda settings, plant: read_as_session(ros2.zenoh_file(settings, plant)),
    ),
)
SHORTEST_SECRET = 4  # letters; a shorter one would black out half of a message


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewaySettings:
    """The section [gateway]: what all channels share."""

    language: str = "en"  # of messages, where a recipient has none of his own: en or de
    silent_hours: Annotated[float, Interval(ge=0.0, le=8760.0)] = 24.0  # an arm that nobody hears for so long is told of; 0: never
    plant_silent_minutes: Annotated[float, Interval(ge=0.0, le=1440.0)] = 15.0  # the same of the plant's own service; 0: never
    already_active: bool = True  # alerts that an arm says and whose raising was told to nobody are told once
    link: str = ""  # address of the plant's screen as people reach it, for links in messages, e.g. "https://plant.example"

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        if self.language not in LANGUAGES:
            raise BadInput(f"gateway: language = {self.language!r}; expected {', '.join(LANGUAGES)}")
        if self.link and not re.match(r"https?://[^\s/]+", self.link):
            raise BadInput(f'gateway: link = {self.link!r}; expected an address, e.g. "https://plant.example"')


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayConfiguration:
    """The checked configuration of the gateway."""

    path: Path | None
    plant: PlantConfiguration
    gateway: GatewaySettings
    sections: Mapping[str, Any]  # settings of each channel's section
    overrides: tuple[str, ...] = ()
    secrets: tuple[str, ...] = field(default=(), repr=False)

    def scrub(self, text: str) -> str:
        """The text without any secret of the configuration."""
        for secret in self.secrets:
            text = text.replace(secret, "***")
        return text

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of channels that run."""
        return tuple(kind for kind in CHANNELS if kind.enabled(self.sections[kind.section]))

    @property
    def enabled(self) -> tuple[str, ...]:
        """The sections whose channels run."""
        return tuple(kind.section for kind in self.kinds)

    def expect_channel(self) -> None:
        """Raises BadConfiguration where no channel is configured: nothing would ever be told."""
        if not self.enabled:
            names = ", ".join(f"[{kind.section}]" for kind in CHANNELS)
            raise BadConfiguration(f"{self.path or 'the default configuration'}: no channel is configured; expected one of {names}")

    def check_files(self) -> None:
        """Read the files that the configuration names, as they will be used. Raises BadConfiguration."""
        try:
            read_as_session(self.plant.zenoh_file)
            for kind in self.kinds:
                kind.read_files(self.sections[kind.section], self.plant)
        except BadInput as error:
            raise BadConfiguration(str(error)) from None

    @property
    def owes(self) -> bool:
        """Whether a channel that runs makes deliveries of transitions; one gateway alone may do so with a database."""
        return any(kind.owes for kind in self.kinds)


def load_gateway(path: Path | None, environment: Mapping[str, str] | None = None) -> GatewayConfiguration:
    """Read and check what the gateway needs of the plant's file. JOINT_MONITOR__SECTION__KEY replaces a value of the file.

    Raises BadConfiguration that lists every mistake with its line and key.
    """
    own = {"plant": PlantSettings, "gateway": GatewaySettings, **{kind.section: kind.settings for kind in CHANNELS}}
    read = load_sections(path, own, (*OF_GATEWAY, *OF_SERVICE), environment)
    sections = {name: read.settings[name] for name in (kind.section for kind in CHANNELS)}
    return GatewayConfiguration(
        path=path,
        plant=PlantConfiguration(path=path, plant=read.settings["plant"], overrides=read.overrides),
        gateway=read.settings["gateway"],
        sections=sections,
        overrides=read.overrides,
        secrets=secrets_of(sections.values(), read.secrets.values()),
    )


def secrets_of(sections: Iterable[Any], more: Iterable[str] = ()) -> tuple[str, ...]:
    """The secrets of these settings, and more of them; the longest first, as one may hold another."""
    found = {secret for settings in sections for secret in _secrets(settings)} | set(more)
    return tuple(sorted((each for each in found if len(each) >= SHORTEST_SECRET), key=len, reverse=True))


def _secrets(settings: Any) -> Iterator[str]:
    """The texts that a settings class marks as secret: the fields that its `repr` leaves out."""
    if not dataclasses.is_dataclass(settings):
        return
    for each in dataclasses.fields(settings):
        value = getattr(settings, each.name)
        if isinstance(value, tuple):
            for part in value:
                yield from _secrets(part)
        elif isinstance(value, Mapping):
            yield from (part for part in value.values() if isinstance(part, str) and not each.repr)
        elif isinstance(value, str) and not each.repr:
            yield value
        else:
            yield from _secrets(value)


def check_file(path: Path) -> tuple[Path, list[Finding]] | None:
    """The file of a gateway, and how far it gets. None where it has no channel."""
    try:
        configuration = load_gateway(path)
        return (path, check_all(configuration)) if configuration.enabled else None
    except BadInput as error:  # a credential of the service's that whoever calls this may not read, for example
        return path, [Finding("gateway", "settings", False, str(error))]


def check_all(configuration: GatewayConfiguration, *, send: bool = False) -> list[Finding]:
    """The findings of all configured channels, without any secret in them. send : send everybody a test message, too."""
    found = [finding for kind in configuration.kinds for finding in kind.check(configuration.sections[kind.section], configuration.plant)]
    if send:
        found += people.send_test(configuration.sections["notify"], configuration.plant, configuration.gateway.language, time.time)
    return [finding._replace(text=configuration.scrub(finding.text)) for finding in found]
