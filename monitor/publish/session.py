"""Where the daemon is met: Zenoh sessions, the keys of one robot, credentials, a document's encoding, and the address for Prometheus."""

import json
import os
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import zenoh

from monitor.errors import BadInput

ROOT = "joint-monitor/v1"
PATIENCE_US = 500_000  # [µs] a client that is megabytes behind is waited for, then disconnected; it may connect again
_WAIT_BEFORE_CLOSE = "transport/link/tx/queue/congestion_control/block/wait_before_close"
_ID = re.compile(r"[a-z0-9_-]+\Z")
_OF_HOST = re.compile(r"(?:tcp|tls|quic|udp|ws)/(?:[^?#]*:(\d{1,5})(?=[?#]|\Z))?")  # protocols whose address ends with a port
MOST_PORT = 65535
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
        config.insert_json5(key, json.dumps(value))
    return config


def _with_credentials(path: str, text: str) -> str:
    """The text with `${CREDENTIALS_DIRECTORY}` and `${CREDENTIAL:name}` replaced. Raises BadInput where a credential cannot be read."""
    if "${CREDENTIAL" not in text:
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


def _from_file(path: str) -> zenoh.Config:
    try:
        with open(path, encoding="utf-8") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: cannot be read: {error}") from None
    text = _with_credentials(path, text)
    try:
        return zenoh.Config.from_json5(text)
    except zenoh.ZError as error:
        raise BadInput(f"{path}: is no Zenoh configuration: {str(error).split(' at /')[0]}") from None


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
