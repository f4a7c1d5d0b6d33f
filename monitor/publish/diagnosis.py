"""Why the bus cannot be reached, and what to do: each step of a connection is tried, since Zenoh itself reports only a time-out. I/O.

The steps are the address, the listener, TLS in both directions, the password, and access control. Nothing is changed: an empty command,
which every daemon refuses, shows whether commands would arrive.
"""

import json
import socket
import ssl
from dataclasses import dataclass

import zenoh

from monitor.errors import BadInput
from monitor.publish.session import session_config, setting, tls_context

TCP, TLS = "tcp", "tls"
READ_S = 0.5  # [s] in TLS 1.3 the refusal of our certificate comes after the handshake
_REFUSALS = {  # by the name of the TLS alert, RFC 8446 §6.2
    "CERTIFICATE_REQUIRED": "no_certificate",
    "HANDSHAKE_FAILURE": "no_certificate",  # TLS 1.2's alert for it
    "UNKNOWN_CA": "own_certificate",
    "BAD_CERTIFICATE": "own_certificate",
    "CERTIFICATE_EXPIRED": "own_certificate",
    "CERTIFICATE_UNKNOWN": "own_certificate",
    "DECRYPT_ERROR": "own_certificate",
    "ACCESS_DENIED": "own_certificate",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """The result of one attempt. `cause` is `reached` or the step that failed; `text` says what was found and what to do."""

    who: str
    endpoint: str
    cause: str
    text: str

    @property
    def reached(self) -> bool:
        """Whether every step succeeded."""
        return self.cause == "reached"


class _Failed(Exception):
    def __init__(self, cause: str, text: str) -> None:
        super().__init__(text)
        self.cause, self.text = cause, text


def reach(endpoint: str, key_prefix: str, *, who: str, zenoh_file: str = "", answers: bool = True, timeout_s: float = 3.0) -> Reach:
    """Try one endpoint with this Zenoh configuration.

    who : a name for the report, e.g. "commands". answers : a monitor must answer there; otherwise a router is enough.
    Raises BadInput where the file cannot be read or is no Zenoh configuration.
    """
    config = session_config(mode="client", connect=(endpoint,), zenoh_file=zenoh_file)
    protocol, _, address = endpoint.partition("/")
    try:
        if protocol in (TCP, TLS):
            host, port = _address(address)
            _somebody_listens(host, port, timeout_s)
            if protocol == TLS:
                _tls_both_ways(config, host, port, timeout_s)
        text = _session(config, protocol, endpoint, key_prefix, answers=answers, timeout_s=timeout_s)
    except _Failed as failed:
        return Reach(who=who, endpoint=endpoint, cause=failed.cause, text=failed.text)
    return Reach(who=who, endpoint=endpoint, cause="reached", text=text)


def _address(address: str) -> tuple[str, int]:
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    if not (host and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise _Failed("no_address", f"{address!r} is no HOST:PORT; expected e.g. 127.0.0.1:7447")
    return host.strip("[]"), int(port)


def _somebody_listens(host: str, port: int, timeout_s: float) -> None:
    try:
        socket.create_connection((host, port), timeout=timeout_s).close()
    except ConnectionRefusedError:
        raise _Failed(
            "nobody",
            f"nobody listens there: is the daemon (joint-monitor run) or the router up, and is this its port? {host} itself answers",
        ) from None
    except socket.gaierror:
        raise _Failed("no_address", f"the name {host!r} is not known: correct the endpoint, or the name service") from None
    except OSError as error:  # no route, no answer in time
        raise _Failed(
            "no_answer", f"{host} does not answer ({error.strerror or 'timed out'}): is the host up, the cable in, the firewall open?"
        ) from None


def _tls_both_ways(config: zenoh.Config, host: str, port: int, timeout_s: float) -> None:
    """The handshake that Zenoh would make, with the same files."""
    settings = setting(config, "transport/link/tls")
    authority, certificate = (settings.get(name) for name in ("root_ca_certificate", "connect_certificate"))
    try:
        context = tls_context(config)
    except BadInput as error:
        raise _Failed("certificate_files", str(error)) from None
    try:
        with (
            socket.create_connection((host, port), timeout=timeout_s) as plain,
            context.wrap_socket(plain, server_hostname=host) as secured,
        ):
            secured.settimeout(READ_S)
            try:
                secured.recv(1)
            except TimeoutError:
                return  # the other side waits for data: the handshake was accepted
    except ssl.SSLCertVerificationError as error:
        raise _Failed(
            "their_certificate",
            f"its certificate is not to be trusted: {error.verify_message}. It must come from the authority in {authority or 'the system'} "
            f"and name {host}",
        ) from None
    except ssl.SSLError as error:
        raise _refused(error, str(certificate) if certificate else None) from None
    except OSError:
        raise _Failed("no_tls", "it hangs up on TLS: it seems to speak plain TCP; is the endpoint tcp/… instead of tls/…?") from None
    raise _Failed("own_certificate", f"it hangs up after the handshake: does it take the certificate {certificate}?")


def _refused(error: ssl.SSLError, certificate: str | None) -> _Failed:
    reason = (error.reason or "").upper()
    cause = next((cause for alert, cause in _REFUSALS.items() if alert in reason), None)
    if cause is None:
        return _Failed("no_tls", f"it does not speak TLS as we do ({error.reason}): is the endpoint tcp/… instead of tls/…?")
    if certificate is None:
        cause = "no_certificate"
    word = reason.removeprefix("TLSV13_ALERT_").removeprefix("TLSV1_ALERT_").removeprefix("SSLV3_ALERT_").replace("_", " ").lower()
    if cause == "no_certificate":
        return _Failed(
            cause, f"it asks for a certificate ({word}), and none is configured: [bus] client_zenoh = …, see deploy/zenoh/viewer.json5"
        )
    return _Failed(
        cause, f"it does not accept our certificate ({word}): {certificate} must come from the authority that the daemon or router trusts"
    )


def _session(config: zenoh.Config, protocol: str, endpoint: str, key_prefix: str, *, answers: bool, timeout_s: float) -> str:
    config.insert_json5("connect/timeout_ms", json.dumps(int(1000 * timeout_s)))
    user = setting(config, "transport/auth/usrpwd").get("user")
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        if protocol == TCP and _speaks_tls(*_address(endpoint.partition("/")[2]), timeout_s):
            raise _Failed("is_tls", "it speaks TLS: the endpoint is tls/…, and a certificate may be asked for") from None
        if user:
            raise _Failed("password", f"it does not let {user!r} in: user or password is wrong, or nobody text it of that user") from None
        raise _Failed(
            "password", "somebody listens and does not let us in: it asks for a user and password, or it is no Zenoh; "
            "transport.auth.usrpwd in the file of [bus] client_zenoh"
        ) from None  # fmt: skip
    with session:
        if not answers:
            return "connected"
        routers = session.info.routers_zid()
        if not _answered(session, f"{key_prefix}/info", timeout_s):
            whose = "the name in our certificate" if protocol == TLS else f"the user {user!r}" if user else "whoever we are"
            if routers:
                raise _Failed(
                    "nothing_said",
                    f"connected to a router, and no monitor answers at {key_prefix}: the daemon is not connected to that router, or its "
                    f"access control does not let {whose} look",
                )
            raise _Failed(
                "denied",
                f"connected to the daemon, and it answers nothing at {key_prefix}: its access control does not let {whose} look, or it is "
                "another robot's",
            )
        may_act = _answered(session, f"{key_prefix}/cmd/ack", timeout_s)
        return "connected, may look and act" if may_act else "connected, may look, may not act (acknowledge, shelve, ask for a replay)"


def _answered(session: zenoh.Session, key: str, timeout_s: float) -> bool:
    """Whether any reply came, an error included."""
    for reply in session.get(key, timeout=timeout_s):
        if reply.ok is not None or (reply.err is not None and b"imeout" not in reply.err.payload.to_bytes()):
            return True
    return False


def _speaks_tls(host: str, port: int, timeout_s: float) -> bool:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # nothing secret is sent
    try:
        with socket.create_connection((host, port), timeout=timeout_s) as plain, context.wrap_socket(plain):
            return True
    except (OSError, ssl.SSLError):
        return False
