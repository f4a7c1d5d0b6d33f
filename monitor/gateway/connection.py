"""Reaching a server: name, TCP, TLS, HTTP requests and their signatures. The run and the check take the same steps. I/O."""

import asyncio
import base64
import binascii
import hashlib
import hmac
import logging
import socket
import ssl
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from monitor.config.extras import absent
from monitor.errors import BadConfiguration, BadInput, MonitorError

CONNECT_S = 5.0


class Finding(NamedTuple):
    """One line of `gateway check`: how far a channel gets."""

    channel: str
    step: str  # settings, name, tcp, tls, authentication, authorisation, …
    ok: bool
    text: str  # what was found, and what to do


class Steps:
    """The steps of a connection as they are taken. `gateway check` shows them; a run drops them."""

    def __init__(self, channel: str = "") -> None:
        self.channel, self.found = channel, list[Finding]()

    def say(self, step: str, text: str, *, ok: bool = True) -> None:
        """Note a step."""
        self.found.append(Finding(self.channel, step, ok, text))


class NotReached(MonitorError):
    """The other side does not answer, or does not let us in: no message gets through now."""

    def __init__(self, step: str, text: str, wait_s: float = 0.0) -> None:
        """`step` : at which it ended. wait_s : until it is tried again, where that is long [s]."""
        super().__init__(text)
        self.step, self.wait_s = step, wait_s


class Refused(MonitorError):
    """The other side answers, and does not take this message or request."""

    def __init__(self, text: str, wait_s: float = 0.0) -> None:
        """`wait_s` : for which the other side asks, or until a person has changed something [s]."""
        super().__init__(text)
        self.wait_s = wait_s


def attempted(channel: str, walk: Callable[[Steps], None]) -> list[Finding]:
    """What an attempt found: each step that it took, and the one at which it ended."""
    steps = Steps(channel)
    try:
        walk(steps)
    except NotReached as error:
        steps.say(error.step, str(error), ok=False)
    except BadInput as error:
        steps.say("settings", str(error), ok=False)
    return steps.found


def needs(module: str, what: str) -> None:
    """Raises BadConfiguration that says what to install where a package of another project is absent."""
    if find_spec(module) is None:
        raise BadConfiguration(absent(module, what))


def dial(host: str, port: int, steps: Steps, context: ssl.SSLContext | None = None, timeout_s: float = CONNECT_S) -> socket.socket:
    """A connection; with `context` over TLS. Raises NotReached."""
    try:
        connection = socket.create_connection((host, port), timeout_s)
        if context is not None:
            connection = context.wrap_socket(connection, server_hostname=host)
    except (OSError, ValueError) as error:
        raise not_reached(host, port, steps, error) from None
    say_reached(steps, host, port, connection)
    return connection


def say_reached(steps: Steps, host: str, port: int, connection: socket.socket) -> None:
    """Note name, TCP and, where it is spoken, TLS of a connection."""
    steps.say("name", f"{host} is {connection.getpeername()[0]}")
    steps.say("tcp", f"{host}:{port} answers")
    if isinstance(connection, ssl.SSLSocket):
        say_tls(steps, connection)


def say_tls(steps: Steps, connection: ssl.SSLSocket) -> None:
    """Note what was agreed on, and until when the certificate holds."""
    until = (connection.getpeercert() or {}).get("notAfter")
    steps.say("tls", f"{connection.version()}; the certificate is believed" + (f", and holds until {until}" if until else ""))


def not_reached(host: str, port: int, steps: Steps, error: Exception) -> NotReached:
    """At which step a connection ended, why, and what to do. The steps before it are noted."""
    if isinstance(error, socket.gaierror | UnicodeError):
        return NotReached("name", f"{host} is not known here: look at its spelling and at this host's name server")
    steps.say("name", f"{host} is known")
    if not isinstance(error, ssl.SSLError):
        what = ": a firewall, or a host that is off" if isinstance(error, TimeoutError) else ""
        return NotReached("tcp", f"{host}:{port}: {reason(error)}{what}")
    steps.say("tcp", f"{host}:{port} answers")
    if isinstance(error, ssl.SSLCertVerificationError):
        return NotReached("tls", f"{host}: {untrusted(error)}")
    return NotReached("tls", f"{host}: no TLS ({error.reason or error}): another port, or another setting of tls")


def untrusted(error: ssl.SSLCertVerificationError) -> str:
    """Why a certificate is not believed, and what to do."""
    return f"its certificate is not believed ({error.verify_message}): give the authority's certificate as ca_file"


def reason(error: Exception) -> str:
    """Why a socket ended, in a few words."""
    if isinstance(error, TimeoutError):
        return "does not answer in time"
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there: look at the port, and whether the server runs"
    return str(getattr(error, "strerror", None) or error or type(error).__name__)


def believed(ca_file: str, folder: Path, section: str) -> ssl.SSLContext:
    """Whose certificates are believed: those of this authority; without one, those that the system believes.

    folder : from which a relative name starts. Raises BadInput where the file is no certificate.
    """
    try:
        return ssl.create_default_context(cafile=str(folder / ca_file) if ca_file else None)
    except (OSError, ssl.SSLError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadInput(f"{section}: ca_file {ca_file}: cannot be read as PEM: {why}") from None


# --- HTTP requests that end in time, whatever the other side does

T = TypeVar("T")
TIMEOUT_S = 15.0  # of one look for more
WHOLE_S = 30.0  # of one request: a server that answers a letter at a time holds nobody up for longer
LARGEST = 1_000_000  # bytes of an answer that are read


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a server answers."""

    status: int
    headers: Mapping[str, str]  # names in lower case
    content: bytes

    @property
    def is_success(self) -> bool:
        """Whether it has done it."""
        return 200 <= self.status < 300

    @property
    def text(self) -> str:
        """What it says, for people."""
        return self.content.decode("utf-8", "replace")

    def __str__(self) -> str:
        try:
            return f"{self.status} {HTTPStatus(self.status).phrase}"
        except ValueError:
            return str(self.status)


class HttpClient:
    """Requests of one thread, one after the other. Its connections last until `close`. It logs no address: that may hold a secret."""

    def __init__(self, context: ssl.SSLContext, headers: Mapping[str, str] | None = None) -> None:
        import httpx

        logging.getLogger("httpx").setLevel(logging.WARNING)
        self._runner = asyncio.Runner()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="http")  # an event loop may run in the caller's own
        self._client = httpx.AsyncClient(verify=context, timeout=TIMEOUT_S, trust_env=False, headers=headers)

    def request(self, method: str, url: str, headers: Mapping[str, str], content: bytes | None) -> Answer:
        """The answer. Raises httpx.HTTPError, httpx.InvalidURL, OSError, ValueError."""
        return self._run(self._asked(method, url, headers, content))

    def close(self) -> None:
        """Close the connections."""
        try:
            self._run(self._client.aclose())
        finally:
            self._thread.submit(self._runner.close).result()
            self._thread.shutdown()

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        return self._thread.submit(self._runner.run, work).result()

    async def _asked(self, method: str, url: str, headers: Mapping[str, str], content: bytes | None) -> Answer:
        import httpx

        try:
            async with asyncio.timeout(WHOLE_S), self._client.stream(method, url, headers=headers, content=content) as answer:
                read = bytearray()
                async for part in answer.aiter_bytes():
                    read += part
                    if len(read) > LARGEST:
                        break
        except TimeoutError:
            raise httpx.ReadTimeout(f"nothing whole within {WHOLE_S:g} s") from None
        named = {name.lower(): value for name, value in answer.headers.items()}
        return Answer(status=answer.status_code, headers=named, content=bytes(read))


def retry_after_s(text: str | None) -> float:
    """The seconds that an answer asks us to wait [s]; 0 where it does not say so; a day at most."""
    return min(float(text), 86_400.0) if text and text.isascii() and text.isdigit() else 0.0


def http_reason(error: Exception) -> str:
    """Why there was no answer, without the address: it may hold a secret."""
    import httpx

    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ssl.SSLCertVerificationError):
            return untrusted(cause)
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, httpx.TimeoutException):
        return "does not answer in time"
    if isinstance(error, httpx.ConnectError):
        return f"cannot be reached: {error}"
    return f"no answer: {type(error).__name__}"


# --- Signatures by Standard Webhooks (standardwebhooks.com): HMAC-SHA256 of ID.TIMESTAMP.BODY, base64 after `v1,`

ID, TIMESTAMP, SIGNATURE = "webhook-id", "webhook-timestamp", "webhook-signature"
PREFIX = "whsec_"  # of a secret in base64
TOLERANCE_S = 300.0  # between the sender's clock and ours


def key_of(secret: str) -> bytes:
    """The key of a secret: whsec_ and base64, or any other text as it is. Raises BadInput."""
    if not secret.startswith(PREFIX):
        return secret.encode()
    try:
        return base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except binascii.Error:
        raise BadInput("a webhook's secret begins with whsec_, and goes on with what is no base64") from None


def signed(secret: str, name: str, at_unix_s: float, body: bytes) -> dict[str, str]:
    """The headers of a message. name : the same one where it is sent again."""
    at = str(int(at_unix_s))
    return {ID: name, TIMESTAMP: at, SIGNATURE: f"v1,{_signature(secret, name, at, body)}"}


def verified(secret: str, headers: Mapping[str, str], body: bytes, now_unix_s: float) -> str:
    """The name of a message that somebody with this secret has signed lately. Raises BadInput that says why it is none."""
    try:
        name, at, signatures = (headers[each] for each in (ID, TIMESTAMP, SIGNATURE))
    except KeyError as error:
        raise BadInput(f"the header {error.args[0]} is missing") from None
    if not (at.isascii() and at.isdigit() and len(at) < 13):
        raise BadInput(f"the header {TIMESTAMP} is no time; expected seconds since 1970")
    if abs(now_unix_s - int(at)) > TOLERANCE_S:
        raise BadInput(f"it was signed more than {TOLERANCE_S:g} s ago, or one of the clocks is wrong")
    expected = _signature(secret, name, at, body)
    given = [each.partition(",")[2] for each in signatures.split() if each.startswith("v1,")]
    if not any(hmac.compare_digest(expected.encode(), each.encode()) for each in given):
        raise BadInput("its signature is not that of our secret")
    return name


def _signature(secret: str, name: str, at: str, body: bytes) -> str:
    return base64.b64encode(hmac.new(key_of(secret), f"{name}.{at}.".encode() + body, hashlib.sha256).digest()).decode()
