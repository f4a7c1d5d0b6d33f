"""Messages by whatever apprise speaks: chats, telephones, pagers. I/O.

These services take no idempotency key: a connection that is lost before the answer may have a message arrive twice.
"""

import logging
import re
import threading
from collections.abc import Collection
from typing import Any

from monitor.errors import BadInput
from monitor.gateway.notify.people import Refused
from monitor.gateway.notify.settings import NotifySettings, RecipientSettings
from monitor.gateway.notify.texts import Message

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

    def __init__(self, settings: NotifySettings) -> None:
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

    def rest(self) -> None:
        """Nothing is open."""
