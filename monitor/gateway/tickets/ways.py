"""The channels of [tickets] that are configured: the tickets, and what listens for acknowledgements. I/O."""

from collections.abc import Sequence

from monitor.gateway.channel import Channel, Surroundings, needs
from monitor.gateway.tickets.channel import Tickets
from monitor.gateway.tickets.settings import TicketSettings


def channels(settings: TicketSettings, surroundings: Surroundings) -> Sequence[Channel]:
    """The channels. Raises BadInput, BadConfiguration where a library is absent."""
    needs("httpx", "tickets")
    found: list[Channel] = [Tickets(settings, surroundings)]
    if settings.listen:
        from monitor.gateway.tickets.listener import Listener

        found.append(Listener(settings, surroundings))
    return found
