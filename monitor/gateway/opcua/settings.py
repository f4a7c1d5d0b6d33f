"""The section [opcua], the server's own certificate, who may sign in, and what `gateway check` says of them. I/O."""

import asyncio
import errno
import ipaddress
import os
import socket
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from annotated_types import Interval

from monitor.config.files import write_whole
from monitor.errors import BadConfiguration, BadInput
from monitor.gateway.connection import Finding, NotReached, Steps, attempted, needs
from monitor.plant.screen.people import User, read_users
from monitor.plant.settings import PlantConfiguration

if TYPE_CHECKING:
    from asyncua.crypto.truststore import TrustStore
    from cryptography.x509 import Certificate, GeneralName

PATH = "/joint-monitor"  # of the endpoint's address
FOLDER = "opcua"  # in the plant's own directory
CERTIFICATE, KEY = "server.der", "server.pem"
DAYS = 5 * 365  # of a certificate of our own: clients trust this one, so it changes seldom
SOON_DAYS = 30.0
ASKED_S = 5.0  # for which another server at our address is waited for


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcuaSettings:
    """Where the server listens, and who may read."""

    listen: str = ""  # HOST:PORT, e.g. "0.0.0.0:4840"; empty: no server
    host: str = ""  # by which clients reach it; empty: the address of `listen`, or this host's name where that is every address
    users_file: str = ""  # lines NAME:ROLE:DIGEST as joint-monitor plant user writes them; the token is the password, every role may read
    allow_anonymous: bool = False  # true: whoever reaches the server may read, over an encrypted channel
    allow_unsecured: bool = False  # true: also without encryption; a password then travels as it is
    trusted_clients: str = ""  # folder of client certificates (DER or PEM), or of their authorities; empty: any certificate
    cert_file: str = ""  # own certificate (DER or PEM); empty: the server makes one when it first starts, and keeps it
    key_file: str = ""  # its key (PEM)
    sites: tuple[str, ...] = ()  # only these sites are served; empty: all
    most_arms: Annotated[int, Interval(ge=1, le=1000)] = 200  # more are left out, and that is told; an arm takes 0.6 MB
    bad_after_h: Annotated[float, Interval(gt=0.0, le=8760.0)] = 24.0  # [h] silence after which values are Bad instead of Uncertain

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        if not self.listen:
            return
        self.address()
        if not (self.users_file or self.allow_anonymous):
            raise BadInput("opcua: nobody could sign in; expected users_file, or allow_anonymous = true")
        if bool(self.cert_file) != bool(self.key_file):
            raise BadInput("opcua: cert_file and key_file belong together; expected both or neither")
        if "/" in self.host or any(character.isspace() for character in self.host):
            raise BadInput(f"opcua: host = {self.host!r}; expected a name or an address alone, e.g. plant.example")

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        host, _, port = self.listen.rpartition(":")
        host = host.strip("[]")
        if not host or "/" in host or not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise BadInput(f"opcua: listen = {self.listen!r}; expected HOST:PORT, e.g. 0.0.0.0:4840")
        return host, int(port)

    def url(self, host_name: str) -> str:
        """The endpoint's address. host_name : of this host, where the server listens at every address."""
        host, port = self.address()
        shown = self.host or (host_name if host in {"0.0.0.0", "::"} else host)  # noqa: S104 - compared, not opened
        return f"opc.tcp://{f'[{shown}]' if ':' in shown else shown}:{port}{PATH}"


class Identity(NamedTuple):
    """Who the server is."""

    uri: str  # of the application; stands in its certificate
    host: str
    certificate: Path
    key: Path
    own: bool  # whether the certificate is made here


def identity(settings: OpcuaSettings, folder: Path, directory: Path) -> Identity:
    """Where the certificate lies, or will lie. folder : from which relative paths start. directory : the plant's own."""
    host = socket.gethostname()
    uri = f"urn:{host}:joint-monitor:gateway"
    if settings.cert_file:
        return Identity(uri, host, folder / settings.cert_file, folder / settings.key_file, own=False)
    place = directory / FOLDER
    return Identity(uri, host, place / CERTIFICATE, place / KEY, own=True)


def load(path: Path) -> "Certificate":
    """Raises BadInput where it is none."""
    from cryptography import x509

    try:
        content = path.read_bytes()
        return x509.load_pem_x509_certificate(content) if b"-----BEGIN" in content else x509.load_der_x509_certificate(content)
    except OSError as error:
        raise BadInput(f"opcua: {path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise BadInput(f"opcua: {path}: holds no certificate, neither DER nor PEM") from None


def days_left(certificate: "Certificate") -> float:
    """Until it ends; negative: it has ended."""
    return (certificate.not_valid_after_utc - datetime.now(UTC)).total_seconds() / 86_400.0


def ensure(who: Identity, settings: OpcuaSettings) -> bool:
    """Make certificate and key where there are none, or where our own has ended. Returns whether they were made. Raises BadInput."""
    if not who.own:
        load(who.certificate)
        return False
    if who.key.is_file() and who.certificate.is_file() and days_left(load(who.certificate)) > 0.0:
        return False
    needs("asyncua", "[opcua]")
    from asyncua.crypto import cert_gen
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding
    from cryptography.x509.oid import ExtendedKeyUsageOID

    try:
        who.key.parent.mkdir(parents=True, exist_ok=True)
        os.chmod(who.key.parent, 0o700)
    except OSError as error:
        raise BadInput(f"opcua: {who.key.parent}: cannot be made: {error.strerror}") from None
    key = cert_gen.generate_private_key()
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(who.uri), x509.DNSName(who.host)]
    for host in dict.fromkeys(each for each in (settings.host, settings.address()[0]) if each and each not in {"0.0.0.0", "::", who.host}):  # noqa: S104
        names.append(_name(host))
    about = {"organizationName": "joint-monitor"}
    usage = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = cert_gen.generate_self_signed_app_certificate(key, f"joint-monitor gateway {who.host}", about, names, usage, DAYS)
    write_whole(who.key, cert_gen.dump_private_key_as_pem(key), mode=0o600)
    write_whole(who.certificate, certificate.public_bytes(Encoding.DER), mode=0o644)
    return True


def _name(host: str) -> "GeneralName":
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def users_of(path: Path) -> dict[str, User]:
    """The users who may sign in with their token. Raises BadInput where the file cannot be read."""
    try:
        return read_users(path.read_text("utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"opcua: users_file {path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def read_files(settings: OpcuaSettings, plant: PlantConfiguration) -> None:
    """Read users, our own certificate with its key, and those that clients must show. Raises BadInput."""
    needs("asyncua", "[opcua]")
    if settings.users_file:
        users_of(plant.folder / settings.users_file)
    who = identity(settings, plant.folder, plant.directory)
    if not who.own:
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        certificate = load(who.certificate)
        try:
            key = load_pem_private_key(who.key.read_bytes(), None)
        except OSError as error:
            raise BadInput(f"opcua: {who.key}: cannot be read: {error.strerror}") from None
        except (TypeError, ValueError) as error:
            raise BadInput(f"opcua: {who.key}: holds no key as PEM: {error}") from None
        if key.public_key() != certificate.public_key():
            raise BadInput(f"opcua: {who.key}: is not the key of {who.certificate}")
    if settings.trusted_clients:
        asyncio.run(trust_store(settings, plant.folder))


async def trust_store(settings: OpcuaSettings, folder: Path) -> "TrustStore | None":
    """The certificates that clients must show; None: any. Raises BadInput."""
    if not settings.trusted_clients:
        return None
    from asyncua.crypto.truststore import TrustStore

    place = folder / settings.trusted_clients
    if not place.is_dir():
        raise BadInput(f"opcua: trusted_clients {place}: is no folder")
    store = TrustStore([place], [])
    try:
        await store.load()
    except (OSError, ValueError) as error:
        raise BadInput(f"opcua: trusted_clients {place}: expected certificates there, *.der or *.pem: {error}") from None
    return store


def expect_free(settings: OpcuaSettings) -> None:
    """Raises NotReached where nobody can listen at the address, with the errno as its cause."""
    host, port = settings.address()
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        raise NotReached("address", f"{settings.listen}: cannot listen there: {error.strerror or error}") from error


# --- what `gateway check` says; nothing is opened for others


def check(settings: OpcuaSettings, plant: PlantConfiguration) -> Sequence[Finding]:
    """Users, certificate, address."""
    try:
        needs("asyncua", "[opcua]")
    except BadConfiguration as absent:
        return [Finding("opcua", "settings", False, str(absent))]
    who = identity(settings, plant.folder, plant.directory)
    return [
        *attempted("opcua", lambda steps: _say_users(settings, plant.folder, steps)),
        *attempted("opcua", lambda steps: _say_certificate(who, steps)),
        *attempted("opcua", lambda steps: _say_address(settings, who, steps)),
    ]


def _say_users(settings: OpcuaSettings, folder: Path, steps: Steps) -> None:
    also = [
        *(["everybody without a name (allow_anonymous)"] if settings.allow_anonymous else []),
        *(["and without encryption (allow_unsecured)"] if settings.allow_unsecured else []),
    ]
    if not settings.users_file:
        steps.say("authentication", " ".join(also))
        return
    path = folder / settings.users_file
    try:
        users = users_of(path)
    except BadInput as error:
        raise NotReached("authentication", str(error)) from None
    if not users and not settings.allow_anonymous:
        raise NotReached("authentication", f"users_file {path}: holds nobody; joint-monitor plant user puts somebody in")
    steps.say("authentication", ", ".join([f"{len(users)} users of {path}, with their token as password", *also]))


def _say_certificate(who: Identity, steps: Steps) -> None:
    if who.own and not who.certificate.exists():
        steps.say("certificate", f"there is none yet: the first start makes {who.certificate}")
        return
    try:
        certificate = load(who.certificate)
    except BadInput as error:
        raise NotReached("certificate", str(error)) from None
    left, until = days_left(certificate), f"{certificate.not_valid_after_utc:%Y-%m-%d}"
    if left <= 0.0:
        what = "the next start makes another one, which clients must trust anew" if who.own else "put another one there"
        raise NotReached("certificate", f"{who.certificate}: has ended on {until}; {what}")
    steps.say("certificate", f"{who.certificate}: valid until {until}" + (f": {left:.0f} days are left" if left < SOON_DAYS else ""))


def _say_address(settings: OpcuaSettings, who: Identity, steps: Steps) -> None:
    """Free, or already ours."""
    try:
        expect_free(settings)
    except NotReached as taken:
        if not isinstance(taken.__cause__, OSError) or taken.__cause__.errno != errno.EADDRINUSE:
            raise NotReached("address", f"{taken}: is it an address of this host?") from None
    else:
        steps.say("address", f"{settings.listen} is free; the endpoint will be {settings.url(who.host)}")
        return
    host, port = settings.address()
    reached = "127.0.0.1" if host == "0.0.0.0" else "::1" if host == "::" else host  # noqa: S104
    shown = _shown_certificate(f"opc.tcp://{f'[{reached}]' if ':' in reached else reached}:{port}")
    if shown is None:
        raise NotReached("address", f"{settings.listen}: another program listens there; choose another port")
    if not who.certificate.exists() or shown != _der(who):
        raise NotReached("address", f"{settings.listen}: another OPC UA server listens there; choose another port")
    steps.say("address", f"{settings.listen}: the gateway listens there, with this certificate")


def _der(who: Identity) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return load(who.certificate).public_bytes(Encoding.DER)


def _shown_certificate(url: str) -> bytes | None:
    """The certificate of the OPC UA server there; None: there is none."""
    import asyncio

    from asyncua import Client, ua

    async def ask() -> bytes | None:
        found = await Client(url, timeout=ASKED_S).connect_and_get_server_endpoints()
        return next((bytes(each.ServerCertificate) for each in found if each.ServerCertificate), b"")

    try:
        with ThreadPoolExecutor(1) as thread:  # an event loop may run in the caller's own
            return thread.submit(asyncio.run, asyncio.wait_for(ask(), 2.0 * ASKED_S)).result()
    except (OSError, TimeoutError, ua.UaError):
        return None
