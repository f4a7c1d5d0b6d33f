"""What `gateway check` says of OPC UA: users, certificate, address. Nothing is opened for others. I/O."""

import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from monitor.errors import BadInput
from monitor.gateway.channel import Finding
from monitor.gateway.opcua.certificate import SOON_DAYS, WITHOUT, Identity, days_left, identity, load
from monitor.gateway.opcua.settings import OpcuaSettings
from monitor.plant.screen.people import read_users
from monitor.plant.settings import PlantConfiguration

CHANNEL = "opcua"
TIMEOUT_S = 5.0


def check(settings: OpcuaSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """Everything that can be seen from outside of the service."""
    return list(_findings(settings, plant))


def _findings(settings: OpcuaSettings, plant: PlantConfiguration) -> Iterator[Finding]:
    who = identity(settings, plant.folder, plant.directory)
    try:
        import asyncua  # noqa: F401 - whether it is there
    except ImportError:
        yield Finding(CHANNEL, "settings", False, WITHOUT)
        return
    yield _users(settings, plant)
    certificate = _certificate(who)
    yield certificate
    yield _address(settings, who)


def _users(settings: OpcuaSettings, plant: PlantConfiguration) -> Finding:
    also = [
        *(["everybody without a name (allow_anonymous)"] if settings.allow_anonymous else []),
        *(["and without encryption (allow_unsecured)"] if settings.allow_unsecured else []),
    ]
    if not settings.users_file:
        return Finding(CHANNEL, "authentication", True, " ".join(also))
    path = plant.folder / settings.users_file
    try:
        users = read_users(path.read_text("utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        return Finding(CHANNEL, "authentication", False, f"users_file {path}: cannot be read: {why}")
    except BadInput as error:
        return Finding(CHANNEL, "authentication", False, f"users_file {error}")
    if not users and not settings.allow_anonymous:
        return Finding(CHANNEL, "authentication", False, f"users_file {path}: holds nobody; joint-monitor plant user puts somebody in")
    return Finding(CHANNEL, "authentication", True, ", ".join([f"{len(users)} users of {path}, with their token as password", *also]))


def _certificate(who: Identity) -> Finding:
    if who.own and not who.certificate.exists():
        return Finding(CHANNEL, "certificate", True, f"there is none yet: the first start makes {who.certificate}")
    try:
        certificate = load(who.certificate)
    except BadInput as error:
        return Finding(CHANNEL, "certificate", False, str(error))
    left, until = days_left(certificate), f"{certificate.not_valid_after_utc:%Y-%m-%d}"
    if left <= 0.0:
        what = "the next start makes another one, which clients must trust anew" if who.own else "put another one there"
        return Finding(CHANNEL, "certificate", False, f"{who.certificate}: has ended on {until}; {what}")
    soon = f": {left:.0f} days are left" if left < SOON_DAYS else ""
    return Finding(CHANNEL, "certificate", True, f"{who.certificate}: valid until {until}{soon}")


def _address(settings: OpcuaSettings, who: Identity) -> Finding:
    """Free, or already ours."""
    host, port = settings.address()
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
        return Finding(CHANNEL, "address", True, f"{settings.listen} is free; the endpoint will be {settings.url(who.host)}")
    except OSError as error:
        if error.errno != 98:
            return Finding(CHANNEL, "address", False, f"{settings.listen}: {error.strerror}: is it an address of this host?")
    reached = "127.0.0.1" if host == "0.0.0.0" else "::1" if host == "::" else host  # noqa: S104
    shown = _shown_certificate(f"opc.tcp://{f'[{reached}]' if ':' in reached else reached}:{port}")
    if shown is None:
        return Finding(CHANNEL, "address", False, f"{settings.listen}: another program listens there; choose another port")
    if not who.certificate.exists() or shown != _der(who):
        return Finding(CHANNEL, "address", False, f"{settings.listen}: another OPC UA server listens there; choose another port")
    return Finding(CHANNEL, "address", True, f"{settings.listen}: the gateway listens there, with this certificate")


def _der(who: Identity) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return load(who.certificate).public_bytes(Encoding.DER)


def _shown_certificate(url: str) -> bytes | None:
    """The certificate of the OPC UA server there; None: there is none."""
    import asyncio

    from asyncua import Client, ua

    async def ask() -> bytes | None:
        found = await Client(url, timeout=TIMEOUT_S).connect_and_get_server_endpoints()
        return next((bytes(each.ServerCertificate) for each in found if each.ServerCertificate), b"")

    try:
        with ThreadPoolExecutor(1) as thread:  # an event loop may run in the caller's own
            return thread.submit(asyncio.run, asyncio.wait_for(ask(), 2.0 * TIMEOUT_S)).result()
    except (OSError, TimeoutError, ua.UaError):
        return None
