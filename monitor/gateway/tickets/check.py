"""How far tickets get: the maintenance system up to whether it lets us in; the address for acknowledgements. Nothing is opened. I/O."""

import errno
import socket
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from urllib.parse import urlsplit

from monitor.errors import BadInput, MonitorError
from monitor.gateway.channel import Finding
from monitor.gateway.reach import believed, reach, tls
from monitor.gateway.tickets.settings import TicketSettings
from monitor.plant.settings import PlantConfiguration

CHANNEL = "tickets"


def check(settings: TicketSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """A finding for each step."""
    return [*_system(settings, plant), *_listens(settings)]


def _system(settings: TicketSettings, plant: PlantConfiguration) -> Iterator[Finding]:
    if find_spec("httpx") is None:
        yield Finding(CHANNEL, "settings", False, "the package httpx is absent: pip install 'joint-monitor[gateway]'")
        return
    try:
        context = believed(settings.ca_file, plant.folder, CHANNEL)
    except BadInput as error:
        yield Finding(CHANNEL, "settings", False, str(error))
        return
    where = urlsplit(settings.open_url)
    host, port = where.hostname or "", where.port or (443 if where.scheme == "https" else 80)
    found = list(reach(CHANNEL, host, port))
    if found[-1].ok:
        open_to_all = Finding(CHANNEL, "tls", True, "none, as open_url says: everybody on the way can read requests and authorization")
        found.append(tls(CHANNEL, host, port, context) if where.scheme == "https" else open_to_all)
    yield from found
    if not found[-1].ok:
        return
    if not settings.check_url:
        text = "not asked: check_url names an address that may be read, e.g. that of one ticket"
        yield Finding(CHANNEL, "authorisation", True, text)
        return
    from monitor.gateway.tickets.rest import Rest, TicketRefused

    rest = Rest(settings, plant.folder)
    try:
        rest.ask(settings.check_url)
    except TicketRefused as refused:
        step = "authentication" if " 401 " in f"{refused} " else "authorisation"
        yield Finding(CHANNEL, step, False, f"{refused}: look at authorization, and at what it may do")
    except MonitorError as error:
        yield Finding(CHANNEL, "http", False, str(error))
    else:
        yield Finding(CHANNEL, "authorisation", True, "check_url is answered")
    finally:
        rest.close()


def _listens(settings: TicketSettings) -> Iterator[Finding]:
    if not settings.listen:
        return
    host, _, port = settings.listen.rpartition(":")
    host = host.strip("[]")
    try:
        socket.create_server((host, int(port)), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        why = "the gateway that runs has it, or another program" if taken else "is it an address of this host?"
        yield Finding("acknowledgements", "address", taken, f"{settings.listen}: {error.strerror}: {why}")
        return
    yield Finding("acknowledgements", "address", True, f"{settings.listen} is free: the gateway does not run yet")
