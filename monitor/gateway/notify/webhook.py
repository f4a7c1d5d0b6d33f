"""Messages as signed JSON by HTTP. I/O.

A message has the same `webhook-id` and `Idempotency-Key` where it is sent again: whoever keeps them takes each message once.
"""

import ssl
from collections.abc import Callable, Collection
from typing import Any

import orjson

from monitor.gateway.http_client import HttpClient, http_reason, retry_after_s
from monitor.gateway.notify.people import Refused
from monitor.gateway.notify.settings import NotifySettings, RecipientSettings
from monitor.gateway.notify.texts import Message
from monitor.gateway.signing import signed
from monitor.publish.timestamps import outside

VERSION = "joint-monitor.notification.v1"


class WebhookWay:
    """A `Way`."""

    name = "webhook"

    def __init__(self, settings: NotifySettings, context: ssl.SSLContext, now: Callable[[], float]) -> None:
        self._targets = {each.name: each for each in settings.to if each.webhook}
        self._context, self._now = context, now
        self._client: HttpClient | None = None

    def addresses(self, recipient: RecipientSettings) -> Collection[str]:
        """Its name: the address itself may hold a secret."""
        return (recipient.name,) if recipient.webhook else ()

    def ready(self) -> None:
        """Always: each recipient has a server of his own."""

    def send(self, message: Message) -> Any:
        """Post it. Raises Refused."""
        import httpx

        target = self._targets[message.recipient]
        body = orjson.dumps(webhook_document(message))
        headers = {"Content-Type": "application/json", "Idempotency-Key": message.name, "User-Agent": "joint-monitor"}
        headers |= signed(target.webhook_secret, message.name, self._now(), body)
        if self._client is None:
            self._client = HttpClient(self._context)
        try:
            answer = self._client.request("POST", target.webhook, headers, body)
        except (httpx.HTTPError, httpx.InvalidURL, OSError, ValueError) as error:
            raise Refused(f"{target.name}: {http_reason(error)}") from None
        if not answer.is_success:
            raise Refused(f"{target.name}: answers {answer}", retry_after_s(answer.headers.get("retry-after")))
        return {"status": answer.status}

    def rest(self) -> None:
        """Close the connections."""
        client, self._client = self._client, None
        if client is not None:
            client.close()


def webhook_document(message: Message) -> dict[str, Any]:
    """What is posted: names within v1 only grow."""
    document = {
        "kind": VERSION,
        "id": message.name,
        "type": message.kind,
        "recipient": message.recipient,
        "made_at_unix_s": message.made_at_unix_s,
        "subject": message.subject,
        "text": message.text,
        "transitions": [dict(each) for each in message.transitions],
    }
    published = outside(document)
    assert isinstance(published, dict)
    return published
