"""What channels that speak HTTP share: a client whose requests end in time, whatever the other side does. I/O."""

import asyncio
import logging
import ssl
from collections.abc import Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeVar

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
            return f"its certificate is not believed ({cause.verify_message}); give the authority's certificate as ca_file"
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, httpx.TimeoutException):
        return "does not answer in time"
    if isinstance(error, httpx.ConnectError):
        return f"cannot be reached: {error}"
    return f"no answer: {type(error).__name__}"
