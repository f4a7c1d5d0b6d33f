"""What a channel of the gateway is: one way to tell others what the plant knows. A further one is an entry of `settings.CHANNELS`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from monitor.gateway.commands import Commands
from monitor.gateway.outbox import Outbox
from monitor.gateway.values import Delivery, Transition
from monitor.plant.arm import ArmName, HeardArm
from monitor.plant.settings import PlantConfiguration


class Channel(Protocol):
    """One way to tell. The gateway's thread calls `offer`; a thread of this channel's own calls `step`, so that none holds up another."""

    @property
    def name(self) -> str:
        """In lower case; names its deliveries, its thread, its line of the status."""

    def offer(self, transition: Transition) -> Sequence[Delivery]:
        """What is owed because of this transition; it is committed as the transition is taken. No I/O, quick, repeatable."""

    def step(self, now_unix_s: float) -> float:
        """Do what is due. Returns the seconds [s] after which it wants to be called again; at most two minutes may pass within.

        Raises MonitorError where something is away: the text is shown as the channel's trouble, and the next call comes later and later.
        """

    def status(self) -> str:
        """For `gateway status`, in one line."""

    def close(self) -> None:
        """End; called by the gateway's thread after the channel's thread has ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What the gateway gives a channel."""

    plant: PlantConfiguration
    language: str  # of what is told to people where a recipient has no language of his own
    link: str  # address of the plant's screen for people; empty: none
    outbox: Outbox
    arms: Callable[[], Mapping[ArmName, HeardArm]]  # as they were heard last
    transitions: Callable[[float, float], list[Transition]]  # told between two times of this clock, in the order in which they came
    commands: Commands
    now: Callable[[], float]
    scrub: Callable[[str], str]  # a text without any secret in it
