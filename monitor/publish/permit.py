"""The permit: before a motion the monitor asks the cell's own program on the key `permit/replay` below the robot's prefix. I/O.

Only the answer {"allow": true, "why": "…"} permits the motion. Any other answer, an error, or text that is no JSON refuses it. Where
several programs answer, all of them must allow it.
"""

import json
import logging
from typing import NamedTuple

import zenoh

from monitor.errors import BusError
from monitor.publish.documents import Permit, encoded
from monitor.publish.registry import KINDS
from monitor.publish.session import BusSettings, encoding, session_config

log = logging.getLogger(__name__)

KEY = KINDS["permit"].key()


class PermitReply(NamedTuple):
    """The answer to one request for a permit."""

    allowed: bool
    text: str


def ask_permit(session: zenoh.Session, prefix: str, question: Permit, timeout_s: float) -> PermitReply | None:
    """Ask once; None where nobody answered in that time."""
    answers: list[PermitReply] = []
    silent = False  # a program that answers this key has not answered yet
    try:
        replies = session.get(
            f"{prefix}/{KEY}",
            payload=encoded(question),
            encoding=encoding("permit"),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
    except zenoh.ZError as error:
        return PermitReply(False, f"permit/replay cannot be asked: {printable(str(error))}")
    for reply in replies:
        if reply.ok is not None:
            answers.append(_read(reply.ok.payload.to_bytes()))
        elif reply.err is not None and b"timeout" in reply.err.payload.to_bytes().lower():
            silent = True
        elif reply.err is not None:
            reply_text = printable(reply.err.payload.to_bytes().decode(errors="replace"))
            answers.append(PermitReply(False, f"permit/replay answered with an error: {reply_text}"))
    refused = next((answer for answer in answers if not answer.allowed), None)
    if refused is not None or silent or not answers:
        return refused
    return answers[0]


def _read(payload: bytes) -> PermitReply:
    try:
        document = json.loads(payload)
    except (ValueError, RecursionError):
        return PermitReply(False, f"permit/replay answered {payload[:80]!r}; expected JSON with allow and why")
    if not isinstance(document, dict) or not isinstance(document.get("allow"), bool):
        return PermitReply(False, f'permit/replay answered {payload[:80]!r}; expected {{"allow": true or false, "why": text}}')
    why = printable(str(document.get("why", "no reason given")))
    return PermitReply(document["allow"], f"permit/replay says {'yes' if document['allow'] else 'no'}: {why}")


def printable(text: str) -> str:
    """Text from another program, made safe for one line of a log."""
    return "".join(letter if letter.isprintable() else " " for letter in text[:200])


class Asker:
    """A session for asking without a daemon. It listens where the daemon would; where a daemon runs, it is its client."""

    def __init__(self, settings: BusSettings, prefix: str) -> None:
        """Raises BusError where neither is possible."""
        self._prefix = prefix
        try:
            config = session_config(
                mode="peer", listen=settings.listen, connect=settings.connect, wait_for_peer=False, zenoh_file=settings.zenoh
            )
            self._session = zenoh.open(config)
        except zenoh.ZError:  # a daemon runs and has the endpoint: be its client
            try:
                self._session = zenoh.open(session_config(mode="client", connect=settings.listen, zenoh_file=settings.client_zenoh))
            except zenoh.ZError as error:
                raise BusError(f"Zenoh cannot open {', '.join(settings.listen)}: {str(error).split(' at /')[0]}") from None

    def __enter__(self) -> "Asker":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def ask(self, question: Permit, timeout_s: float) -> PermitReply | None:
        """Ask once, as the function `ask_permit`."""
        return ask_permit(self._session, self._prefix, question, timeout_s)
