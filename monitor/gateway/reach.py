"""How far a server can be reached: name, TCP, TLS; each a finding with what to do. For the checks of channels. I/O."""

import socket
import ssl
from collections.abc import Iterator
from pathlib import Path

from monitor.errors import BadInput
from monitor.gateway.channel import Finding

TIMEOUT_S = 5.0


def reach(channel: str, host: str, port: int) -> Iterator[Finding]:
    """Name and TCP; the last finding says whether somebody listens."""
    try:
        addresses = sorted({str(found[4][0]) for found in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)})
    except (OSError, UnicodeError):
        yield Finding(channel, "name", False, f"{host} is not known here: look at its spelling and at this host's name server")
        return
    yield Finding(channel, "name", True, f"{host} is {', '.join(addresses[:3])}")
    try:
        socket.create_connection((host, port), TIMEOUT_S).close()
    except OSError as error:
        why = "nobody answers in time: a firewall, or a host that is off" if isinstance(error, TimeoutError) else _reason(error)
        yield Finding(channel, "tcp", False, f"{host}:{port}: {why}")
        return
    yield Finding(channel, "tcp", True, f"{host}:{port} answers")


def tls(channel: str, host: str, port: int, context: ssl.SSLContext) -> Finding:
    """The handshake of a server that speaks TLS from the beginning."""
    try:
        with socket.create_connection((host, port), TIMEOUT_S) as plain, context.wrap_socket(plain, server_hostname=host) as wrapped:
            return Finding(channel, "tls", True, tls_text(wrapped))
    except (OSError, ValueError) as error:
        return Finding(channel, "tls", False, tls_refusal(host, error))


def believed(ca_file: str, folder: Path, section: str) -> ssl.SSLContext:
    """Whose certificates are believed: those of this authority; without one, those that the system believes.

    folder : from which a relative name starts. Raises BadInput where the file is no certificate.
    """
    try:
        return ssl.create_default_context(cafile=str(folder / ca_file) if ca_file else None)
    except (OSError, ssl.SSLError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadInput(f"{section}: ca_file {ca_file}: cannot be read as PEM: {why}") from None


def tls_text(wrapped: ssl.SSLSocket) -> str:
    """What was agreed on, and until when the certificate holds."""
    certificate = wrapped.getpeercert() or {}
    until = certificate.get("notAfter")
    return f"{wrapped.version()}; the certificate is believed" + (f", and holds until {until}" if until else "")


def tls_refusal(host: str, error: Exception) -> str:
    """Why there is no TLS, and what to do."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{host}: its certificate is not believed ({error.verify_message}): give the authority's certificate as ca_file"
    if isinstance(error, ssl.SSLError):
        return f"{host}: no TLS ({error.reason or error}): another port, or another setting of tls"
    return f"{host}: {_reason(error)}"


def _reason(error: Exception) -> str:
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there: look at the port, and whether the server runs"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)
