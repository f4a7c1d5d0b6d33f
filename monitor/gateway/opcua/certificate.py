"""The server's own certificate: given, or made when it first starts, and kept. I/O."""

import ipaddress
import os
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from monitor.config.files import write_whole
from monitor.errors import BadInput
from monitor.gateway.opcua.settings import OpcuaSettings

if TYPE_CHECKING:
    from cryptography.x509 import Certificate, GeneralName

FOLDER = "opcua"  # in the plant's own directory
CERTIFICATE, KEY = "server.der", "server.pem"
DAYS = 5 * 365  # of a certificate of our own: clients trust this one, so it changes seldom
SOON_DAYS = 30.0
WITHOUT = "OPC UA needs the package asyncua; install joint-monitor[gateway]"


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
    try:
        from asyncua.crypto import cert_gen
        from cryptography import x509
        from cryptography.hazmat.primitives.serialization import Encoding
        from cryptography.x509.oid import ExtendedKeyUsageOID
    except ImportError:
        raise BadInput(WITHOUT) from None
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
