"""Where the daemon is met: Zenoh sessions, the keys of one robot, credentials, a document's encoding, and the address for Prometheus."""

import difflib
import json
import os
import re
import ssl
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import zenoh

from monitor.errors import BadInput, MonitorError, cannot_listen

PLANT = "joint-monitor/plant/v1"  # below it the plant answers
ROOT = "joint-monitor/v1"
PATIENCE_US = 500_000  # [µs] a client that is megabytes behind is waited for, then disconnected; it may connect again
_WAIT_BEFORE_CLOSE = "transport/link/tx/queue/congestion_control/block/wait_before_close"
_ID = re.compile(r"[a-z0-9_-]+\Z")
_OF_HOST = re.compile(r"(?:tcp|tls|quic|udp|ws)/(?:[^?#]*:(\d{1,5})(?=[?#]|\Z))?")  # protocols whose address ends with a port
MOST_PORT = 65535
RENAMED = {  # keys of Zenoh's configuration that version 1.0 renamed: eclipse-zenoh/zenoh, pull requests 1200 and 1503
    **{f"server_{what}": f"listen_{what}" for what in ("certificate", "private_key", "certificate_base64", "private_key_base64")},
    **{f"client_{what}": f"connect_{what}" for what in ("certificate", "private_key", "certificate_base64", "private_key_base64")},
    "client_auth": "enable_mtls",
    "server_name_verification": "verify_name_on_connect",
    "wait_before_drop": "drop/wait_before_drop",
    "actions": "messages",
    "get": "query",
}
_TLS_FILES = ("root_ca_certificate", *(f"{side}_{what}" for side in ("listen", "connect") for what in ("certificate", "private_key")))
_UNKNOWN = re.compile(r"unknown (field|variant) `([^`]*)`")
_ERRNO = re.compile(r"\(os error (\d+)\)")  # Rust's name for it
_ENDPOINT = re.compile(r"(tcp|tls|udp|quic|ws|unixsock-stream|unixpipe|serial|vsock)/[^\s?#]+\S*\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """Where the daemon meets the bus. Consumers connect to one of `listen`, or to the router in `connect`."""

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)  # endpoints that the daemon opens; the default is loopback only
    connect: tuple[str, ...] = ()  # routers that the daemon joins; it tries again for ever in the background
    live_rate_hz: float = 5.0  # [Hz] rate of torque/live
    health_period_s: float = 60.0  # [s] longest time between two publications of `health`
    query_workers: int = 2  # threads that answer queries
    zenoh: str = ""  # path of a Zenoh configuration (JSON5) for the daemon: TLS, authentication, access control; see deploy/zenoh/
    client_zenoh: str = ""  # the same for the commands on this machine: watch, alerts, ack, predict, …

    def __post_init__(self) -> None:
        """Raises BadInput naming the figure that is out of its range."""
        for name, low, high in (("live_rate_hz", 0.1, 125.0), ("health_period_s", 1.0, 3600.0), ("query_workers", 1, 32)):
            if not low <= getattr(self, name) <= high:
                raise BadInput(f"bus: {name} = {getattr(self, name)!r}; expected {low:g} to {high:g}")
        for name in ("listen", "connect"):
            for endpoint in getattr(self, name):
                if not _ENDPOINT.match(endpoint):
                    raise BadInput(f"bus: {name}: {endpoint!r} is no endpoint; expected PROTOCOL/ADDRESS, e.g. tcp/127.0.0.1:7447")
                if (port := _OF_HOST.match(endpoint)) and not (port[1] and int(port[1]) <= MOST_PORT):
                    raise BadInput(f"bus: {name}: {endpoint!r} has no port; expected HOST:PORT after the protocol, e.g. tcp/127.0.0.1:7447")
        if not (self.listen or self.connect):
            raise BadInput("bus: listen and connect are both empty: nobody could hear; expected an endpoint in one of them")


def prefix(site: str, robot: str) -> str:
    """The key below which all keys of one robot lie.

    Raises BadInput where an id holds anything but a–z, 0–9, _ and -.
    """
    for name, value in (("site", site), ("robot id", robot)):
        if not _ID.match(value):
            raise BadInput(f"{name} {value!r}: expected only a–z, 0–9, _ and - (it becomes part of a Zenoh key)")
    return f"{ROOT}/{site}/{robot}"


def session_config(
    *, mode: str, listen: tuple[str, ...] = (), connect: tuple[str, ...] = (), wait_for_peer: bool = True, zenoh_file: str = ""
) -> zenoh.Config:
    """Zenoh's configuration without scouting: only the given endpoints are used.

    zenoh_file : path of a JSON5 configuration for TLS, authentication and access control, or empty. In it `${CREDENTIALS_DIRECTORY}` is
    the service manager's folder of secrets, and `${CREDENTIAL:name}` the content of one of its files.
    Raises BadInput where it cannot be read or is no Zenoh configuration.
    """
    config = _from_file(zenoh_file) if zenoh_file else zenoh.Config()
    values: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,  # it would leave files behind after kill −9
        "connect/retry": {
            "period_init_ms": 250,
            "period_max_ms": 2000,
            "period_increase_factor": 2,
        },  # connected soon after a router's restart
    }
    if mode != "client":
        values[_WAIT_BEFORE_CLOSE] = PATIENCE_US  # Zenoh's own 5 s for each slow client would delay all others
    if not wait_for_peer:
        values |= {"connect/timeout_ms": -1, "connect/exit_on_failure": False}
    for key, value in values.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise BadInput(f"bus: {key}: {value!r} given: {_said(error)}") from None
    return config


def read_as_session(zenoh_file: str, listen: tuple[str, ...] = (), *, secrets_needed: bool = True) -> None:
    """Read a Zenoh configuration, and every file that it names, as a session does: one is opened at spare addresses, and closed.

    listen : endpoints, of which the protocols count. secrets_needed : where false, credentials and a text that asks for them are left out.
    Raises BadInput where Zenoh would refuse one of them.
    """
    spare = tuple(re.sub(r"/[^?#]*", "/127.0.0.1:0", endpoint, count=1) for endpoint in listen if _OF_HOST.match(endpoint))
    if zenoh_file and not secrets_needed and ASKS in _text(zenoh_file):
        check_syntax(zenoh_file)
        return
    config = session_config(mode="peer", listen=spare, zenoh_file=zenoh_file)
    where = f"{zenoh_file}: " if zenoh_file else ""
    try:
        tls_context(config)
    except BadInput as error:
        raise BadInput(f"{where}{error}") from None
    try:
        zenoh.open(config).close()
    except zenoh.ZError as error:
        raise BadInput(f"{where}{_said(error)}") from None


def check_syntax(zenoh_file: str) -> None:
    """Read a Zenoh configuration without the credentials that it asks for. Raises BadInput."""
    _parsed(zenoh_file, re.sub(r"\$\{CREDENTIAL[^}]*\}", "credential", _text(zenoh_file)))


def tls_context(config: zenoh.Config) -> ssl.SSLContext:
    """How a session with this configuration connects over TLS. Raises BadInput naming the file that cannot be read, or does not fit."""
    settings = setting(config, "transport/link/tls")
    files = {name: str(settings[name]) for name in _TLS_FILES if settings.get(name)}
    for name, path in files.items():
        try:
            open(path, "rb").close()
        except OSError as error:
            raise BadInput(f"{name} {path}: cannot be read: {error.strerror}") from None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = settings.get("verify_name_on_connect") is not False
    authority = files.get("root_ca_certificate")
    try:
        if authority:
            context.load_verify_locations(authority)
        else:
            context.load_default_certs()
    except ssl.SSLError as error:
        raise BadInput(f"root_ca_certificate {authority}: holds no certificate as PEM ({error.reason})") from None
    for side, ours in (("listen", ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)), ("connect", context)):
        certificate, key = (files.get(f"{side}_{what}") for what in ("certificate", "private_key"))
        try:
            if certificate and key:
                ours.load_cert_chain(certificate, key, password="")  # or a key with a password would be asked for at the terminal
        except ssl.SSLError as error:
            raise BadInput(f"{side}_certificate {certificate}, {side}_private_key {key}: are no pair as PEM ({error.reason})") from None
    return context


def setting(config: zenoh.Config, key: str) -> dict[str, Any]:
    """The part of a configuration below a key."""
    found = json.loads(config.get_json(key))
    return found if isinstance(found, dict) else {}


def not_opened(error: zenoh.ZError, listen: tuple[str, ...]) -> MonitorError:
    """Zenoh's error of a session that listens. Raises nothing; the kind is that of `cannot_listen`."""
    number = found[1] if (found := _ERRNO.search(str(error))) else None
    where = next((endpoint for endpoint in listen if endpoint.partition("/")[2] in str(error)), ", ".join(listen) or "a session")
    return cannot_listen(f"bus.listen: {where}", None if number is None else int(number), _said(error))


def _said(error: zenoh.ZError) -> str:
    """What Zenoh says, without the places in its own source."""
    return re.sub(r" at /\S+:\d+\.?", "", str(error))


ASKS = "${CREDENTIAL"


def _with_credentials(path: str, text: str) -> str:
    """The text with `${CREDENTIALS_DIRECTORY}` and `${CREDENTIAL:name}` replaced. Raises BadInput where a credential cannot be read."""
    if ASKS not in text:
        return text
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    if not folder:
        raise BadInput(f"{path}: asks for $CREDENTIALS_DIRECTORY, which the service manager sets (LoadCredential=); it is not set here")

    def secret(match: re.Match[str]) -> str:
        try:
            return json.dumps((Path(folder) / match.group(1)).read_text("utf-8").rstrip("\n"))[1:-1]
        except (OSError, UnicodeDecodeError):
            raise BadInput(f"{path}: the credential {match.group(1)!r} cannot be read below $CREDENTIALS_DIRECTORY") from None

    return re.sub(r"\$\{CREDENTIAL:([\w.-]+)\}", secret, text.replace("${CREDENTIALS_DIRECTORY}", folder))


def _text(path: str) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            return file.read()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: cannot be read: {error}") from None


def _from_file(path: str) -> zenoh.Config:
    return _parsed(path, _with_credentials(path, _text(path)))


def _parsed(path: str, text: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_json5(text)
    except zenoh.ZError as error:
        said = _said(error)
    if (unknown := _UNKNOWN.search(said)) is None:
        raise BadInput(f"{path}: is no Zenoh configuration: {said}")
    what, word = {"field": "key", "variant": "word"}[unknown[1]], unknown[2]
    known = re.findall(r"`([^`]*)`", said[unknown.end() :])
    near = difflib.get_close_matches(word, known, n=1)
    if RENAMED.get(word, "").split("/")[0] in known:
        right = f"it is now {RENAMED[word]}"
    else:
        right = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    raise BadInput(f"{path}: is no Zenoh configuration: unknown {what} {word!r}; {right}")


# a router that does not answer is the problem `router`, in our words and in our log
_ZENOH_WARNINGS = "warn,zenoh::net::routing::hat::peer=error,zenoh::net::runtime::orchestrator=error"
# who connects and under which name, who is refused by access control, certificate or password; only warnings of all else
_ZENOH_LOG_LEVELS = (
    f"{_ZENOH_WARNINGS},zenoh::net::routing::interceptor=info,zenoh_link_tls=debug,zenoh_transport::unicast::establishment::accept=debug"
)


def log_refusals(settings: BusSettings) -> None:
    """Let Zenoh log accepted and refused clients to standard output, which the journal records; RUST_LOG overrides the levels.

    Call it once in a process, before its first session. Without a Zenoh configuration nobody is refused, and only warnings are logged.
    """
    if not sys.stdout.isatty():
        os.environ.setdefault("NO_COLOR", "1")
    zenoh.init_log_from_env_or(_ZENOH_LOG_LEVELS if settings.zenoh else _ZENOH_WARNINGS)


@cache
def encoding(kind: str) -> zenoh.Encoding:
    """The encoding that names the kind of document, `application/json;joint-monitor.<kind>.v1`."""
    return zenoh.Encoding(f"application/json;joint-monitor.{kind}.v1")


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsSettings:
    """Where Prometheus may scrape."""

    listen: str = ""  # HOST:PORT, e.g. "127.0.0.1:9464"; empty: nowhere

    def __post_init__(self) -> None:
        """Raises BadInput where `listen` is no address."""
        if self.listen:
            self.address()

    def address(self) -> tuple[str, int]:
        """Host and port. Raises BadInput."""
        host, _, port = self.listen.rpartition(":")
        if not host or not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
            raise BadInput(f"metrics: listen = {self.listen!r}; expected HOST:PORT, e.g. 127.0.0.1:9464")
        return host, int(port)
