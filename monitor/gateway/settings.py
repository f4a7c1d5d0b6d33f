"""The settings of the gateway: sections of the plant's file, all off by default. I/O."""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from monitor.errors import BadConfiguration, BadInput
from monitor.gateway.channels import CHANNELS, SECTIONS
from monitor.plant.settings import OF_GATEWAY, OF_SERVICE, PlantConfiguration, PlantSettings, load_sections
from monitor.views.language.catalogue import LANGUAGES

SHORTEST_SECRET = 4  # letters; a shorter one would black out half of a message


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewaySettings:
    """The section [gateway]: what all channels share."""

    language: str = "en"  # of messages, where a recipient has none of his own: en or de
    silent_hours: Annotated[float, Interval(ge=0.0, le=8760.0)] = 24.0  # an arm that nobody hears for so long is told of; 0: never
    plant_silent_minutes: Annotated[float, Interval(ge=0.0, le=1440.0)] = 15.0  # the same of the plant's own service; 0: never
    already_active: bool = True  # alerts that were active before the gateway first ran, or knew the arm, are told once
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
    def enabled(self) -> tuple[str, ...]:
        """The sections whose channels run."""
        return tuple(kind.section for kind in CHANNELS if kind.enabled(self.sections[kind.section]))

    def expect_channel(self) -> None:
        """Raises BadConfiguration where no channel is configured: nothing would ever be told."""
        if not self.enabled:
            names = ", ".join(f"[{kind.section}]" for kind in CHANNELS)
            raise BadConfiguration(f"{self.path or 'the default configuration'}: no channel is configured; expected one of {names}")

    @property
    def owes(self) -> bool:
        """Whether a channel that runs makes deliveries of transitions; one gateway alone may do so with a database."""
        return any(kind.owes for kind in CHANNELS if kind.enabled(self.sections[kind.section]))


def load_gateway(path: Path | None, environment: Mapping[str, str] | None = None) -> GatewayConfiguration:
    """Read and check what the gateway needs of the plant's file. JOINT_MONITOR__SECTION__KEY replaces a value of the file.

    Raises BadConfiguration that lists every mistake with its line and key.
    """
    own = {"plant": PlantSettings, "gateway": GatewaySettings, **SECTIONS}
    read = load_sections(path, own, (*OF_GATEWAY, *OF_SERVICE), environment)
    sections = {name: read.settings[name] for name in SECTIONS}
    found = {secret for settings in sections.values() for secret in _secrets(settings)} | set(read.secrets.values())
    return GatewayConfiguration(
        path=path,
        plant=PlantConfiguration(path=path, plant=read.settings["plant"], overrides=read.overrides),
        gateway=read.settings["gateway"],
        sections=sections,
        overrides=read.overrides,
        secrets=tuple(sorted((each for each in found if len(each) >= SHORTEST_SECRET), key=len, reverse=True)),
    )


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
