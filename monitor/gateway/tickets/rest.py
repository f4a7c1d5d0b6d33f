"""Requests to the maintenance system: JSON over HTTP. I/O."""

from pathlib import Path
from typing import Any

import orjson

from monitor.errors import MonitorError
from monitor.gateway.http_client import LARGEST, Answer, HttpClient, http_reason, retry_after_s
from monitor.gateway.reach import believed
from monitor.gateway.tickets.settings import TicketSettings

REFUSED_WAIT_S = 300.0  # until a request that was refused is repeated: a person has to change something


class TicketRefused(MonitorError):
    """The maintenance system answers, and does not take the request."""

    def __init__(self, text: str, wait_s: float) -> None:
        """`wait_s` : until it is repeated [s]."""
        super().__init__(text)
        self.wait_s = wait_s


class Rest:
    """One maintenance system; its connection lasts a step."""

    def __init__(self, settings: TicketSettings, folder: Path) -> None:
        """Raises BadInput where ca_file is no certificate."""
        self._context = believed(settings.ca_file, folder, "tickets")
        self._headers = {"User-Agent": "joint-monitor", "Accept": "application/json", **settings.headers}
        if settings.authorization:
            self._headers["Authorization"] = settings.authorization
        self._client: HttpClient | None = None

    def send(self, method: str, url: str, body: Any, key: str) -> tuple[Any, str]:
        """The answer, and the address that it names. Raises TicketRefused, MonitorError where nobody answers."""
        content = orjson.dumps(body)
        answer = self._request(method, url, {"Content-Type": "application/json", "Idempotency-Key": key}, content)
        return _json(answer), answer.headers.get("location", "")

    def ask(self, url: str) -> Any:
        """The answer to a question; None where there is nothing. Raises TicketRefused, MonitorError where nobody answers."""
        answer = self._request("GET", url, {}, None, nothing=(404, 410))
        return _json(answer) if answer.is_success else None

    def close(self) -> None:
        """Close the connection."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _request(self, method: str, url: str, headers: dict[str, str], content: bytes | None, nothing: tuple[int, ...] = ()) -> Answer:
        import httpx

        if self._client is None:
            self._client = HttpClient(self._context, self._headers)
        try:
            answer = self._client.request(method, url, headers, content)
        except (httpx.ConnectError, httpx.ConnectTimeout) as error:
            raise MonitorError(f"the maintenance system: {http_reason(error)}") from None
        except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
            # it may be this request that it does not survive, and the others shall get through
            raise TicketRefused(f"the maintenance system: {http_reason(error)}", 0.0) from None
        if answer.is_success or answer.status in nothing:
            return answer
        said = " ".join(answer.text[:300].split())
        text = f"the maintenance system answers {answer}: {said}".rstrip(": ")
        raise TicketRefused(text, max(retry_after_s(answer.headers.get("retry-after")), REFUSED_WAIT_S if answer.status < 500 else 0.0))


def _json(answer: Answer) -> Any:
    """The document of an answer; None where it is none: the ticket is there all the same."""
    try:
        return orjson.loads(answer.content) if 0 < len(answer.content) <= LARGEST else None
    except orjson.JSONDecodeError:
        return None
