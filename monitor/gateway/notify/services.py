"""Messages as signed JSON by HTTP, and by whatever apprise speaks: chats, telephones, pagers. I/O.

A webhook has the same `webhook-id` and `Idempotency-Key` where it is sent again: whoever keeps them takes each message once. The services
of apprise take no such key: a connection that is lost before the answer may have a message arrive twice.
"""

import logging
import re
import threading
from collections.abc import Callable, Collection, Sequence
from typing import Any
from urllib.parse import urlsplit

import orjson

from monitor.config.notify import NotifySettings, RecipientSettings
from monitor.errors import BadInput
from monitor.gateway.connection import (
    Finding,
    HttpClient,
    Refused,
    Steps,
    attempted,
    believed,
    dial,
    http_reason,
    retry_after_s,
    signed,
)
from monitor.gateway.notify.messages import Message
from monitor.plant.settings import PlantConfiguration
from monitor.publish.timestamps import outside

VERSION = "joint-monitor.notification.v1"


class WebhookWay:
    """A `Way`."""

    name = "webhook"

    def __init__(self, settings: NotifySettings, plant: PlantConfiguration, now: Callable[[], float]) -> None:
        """Raises BadInput where ca_file is no certificate."""
        self._targets = {each.name: each for each in settings.to if each.webhook}
        self._context, self._now = believed(settings.ca_file, plant.folder, "notify"), now
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

    def check(self) -> Sequence[Finding]:
        """Each recipient up to TLS; nothing is posted."""

        def walk(steps: Steps) -> None:
            where = urlsplit(target.webhook)
            safe = where.scheme == "https"
            dial(where.hostname or "", where.port or (443 if safe else 80), steps, self._context if safe else None).close()
            steps.say("authorisation", "whether it takes our signature shows with the first message: nothing is posted here")

        found = []
        for target in self._targets.values():
            found += [one._replace(text=f"{target.name}: {one.text}") for one in attempted(self.name, walk)]
        return found

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


# --- apprise

SHORTEST = 6  # letters of a part of an address that may be a secret
WHOLE_S = 30.0  # for which an answer is waited for; one that comes later counts at the next attempt
LONGEST = 300  # letters of what a service says


class _Attempt(threading.Thread):
    """One message on its way: these libraries know no time within which a request as a whole must end."""

    def __init__(self, target: Any, message: Message) -> None:
        super().__init__(name=f"apprise {message.recipient}", daemon=True)
        self._target, self.message = target, message
        self.why: str | None = None  # it was not taken

    def run(self) -> None:
        """Hand it over."""
        import apprise

        message = self.message
        capture: Any = apprise.LogCapture
        kind = "info" if message.kind == "report" else "warning"
        with capture(level=logging.WARNING, fmt="%(message)s") as said:
            try:
                taken = self._target.notify(title=message.subject, body=message.text, notify_type=kind, body_format="text")
            except Exception as error:  # a plugin of others may raise anything
                self.why = f"apprise: {type(error).__name__}"
                return
            if not taken:
                self.why = f"not taken: {' '.join(said.getvalue().split()) or 'the service says no reason'}"


class AppriseWay:
    """A `Way`."""

    name = "apprise"

    def __init__(self, settings: NotifySettings, plant: PlantConfiguration, now: Callable[[], float]) -> None:  # noqa: ARG002 - as the others
        """Raises BadInput where an address is none that apprise knows; the address is not repeated, because it holds a secret."""
        import apprise

        # its messages hold addresses, and with them secrets: what is worth knowing of them is in our own error
        logging.getLogger("apprise").propagate = False
        self._targets: dict[str, Any] = {}
        secrets: set[str] = set()
        self._attempts: dict[str, _Attempt] = {}  # by recipient: those that have no answer yet
        self._late: set[str] = set()  # messages whose answer came after we had stopped waiting: they are through
        for each in settings.to:
            if not each.apprise:
                continue
            target = apprise.Apprise()
            if not target.add(each.apprise):
                raise BadInput(f"notify.to: {each.name!r}: apprise: is no address that apprise {apprise.__version__} knows")
            self._targets[each.name] = target
            secrets |= {part for part in re.split(r"[/:@?&=,]+", each.apprise) if len(part) >= SHORTEST}
        self._secrets = sorted(secrets, key=len, reverse=True)  # of everybody: what two services say at once is not told apart

    def addresses(self, recipient: RecipientSettings) -> Collection[str]:
        """Its name: the address itself holds a secret."""
        return (recipient.name,) if recipient.apprise else ()

    def ready(self) -> None:
        """Always: each recipient has a server of his own."""

    def send(self, message: Message) -> Any:
        """Hand it over. Raises Refused."""
        attempt = self._attempts.get(message.recipient)
        if attempt is not None and attempt.message.name != message.name:
            self._end(attempt)
            if attempt.why is None:
                self._late.add(attempt.message.name)
            attempt = None
        if message.name in self._late:
            self._late.discard(message.name)
            return
        if attempt is None:
            attempt = self._attempts[message.recipient] = _Attempt(self._targets[message.recipient], message)
            attempt.start()
        self._end(attempt)
        if (why := attempt.why) is not None:
            for secret in self._secrets:
                why = why.replace(secret, "***")
            raise Refused(f"{message.recipient}: {why[:LONGEST]}")  # cut after that: a part of a secret would not be known as one

    def _end(self, attempt: _Attempt) -> None:
        """Wait for its answer. Raises Refused."""
        attempt.join(WHOLE_S)
        if attempt.is_alive():
            raise Refused(f"{attempt.message.recipient}: apprise: the service does not answer in time")
        del self._attempts[attempt.message.recipient]

    def check(self) -> Sequence[Finding]:
        """Whether apprise knows the addresses."""
        text = f"{', '.join(self._targets)}: addresses that apprise knows; the services themselves are asked by the first message"
        return [Finding(self.name, "settings", True, text)]

    def rest(self) -> None:
        """Nothing is open."""
