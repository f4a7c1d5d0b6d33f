"""Ways to the arms: a Zenoh session for each router, the tokens of the arms behind it, and what they say. I/O.

Zenoh's threads only hand over: a token to a queue, the newest document of each key to a mapping. So little grows while the database is
away.
"""

import json
import logging
import queue
import re
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import orjson
import zenoh

from monitor.errors import BadInput, BusError
from monitor.plant.arm import ArmName
from monitor.publish.session import PLANT, ROOT, prefix, session_config
from monitor.reason import Sentence

log = logging.getLogger(__name__)

DOCUMENTS = ("health", "monitor", "info", "inspection")
FOLLOWED = (*DOCUMENTS, "alert/*/*")  # last values that are kept
TRIGGERS = ("event", "joint/*/friction", "joint/*/maintenance")  # what they hold is copied by cursor
MONITOR, MOST_MONITORS = "monitor", 4  # how many of an arm are kept beside the newest one
ALIVE = "alive/monitor"
LONGEST_NAME = 100  # letters of a site or a robot
_LAST_VALUE = re.compile("|".join((*DOCUMENTS, "alert/(?:arm|j[1-9])/[a-z0-9_]{1,60}")))  # no others can fill a table
TIMEOUT_S = 5.0
NO_ANSWER = Sentence("endpoint_no_answer", "{endpoint} does not answer")
LATE = Sentence("monitor_does_not_answer", "its monitor is there, and does not answer within {timeout_s:g} s")(timeout_s=TIMEOUT_S)
NOBODY_HEARS = Sentence("nobody_hears_it", "{arm} does not answer, and nothing was done: nobody hears its monitor")
DONE_OR_NOT = Sentence("done_or_not", "{arm} does not answer, and nobody knows whether it was done: {why}")
NO_JSON = Sentence("answer_no_json", "{arm}: its answer is no JSON")
REFUSED_S = (1.0, 30.0)  # [s] first and longest pause between two attempts to open a session


def named(key: str) -> tuple[ArmName, str] | None:
    """The arm of a key, and what follows; None where no monitor has such a name: anybody may say anything on a bus."""
    parts = key.split("/", 4)
    if len(parts) < 5 or "/".join(parts[:2]) != ROOT or max(map(len, parts[2:4])) > LONGEST_NAME:
        return None
    try:
        prefix(parts[2], parts[3])
    except BadInput:
        return None
    return ArmName(parts[2], parts[3]), parts[4]


class Received(NamedTuple):
    """What has come since it was taken last."""

    newest: dict[tuple[ArmName, str], bytes]  # documents
    monitors: dict[ArmName, list[bytes]]  # documents `monitor` that these have replaced, the oldest first
    triggered: dict[ArmName, float]  # arms whose history goes on, with the time since when


class Inbox:
    """What the sessions hand over, for the plant's main thread."""

    def __init__(self) -> None:
        self.tokens: queue.SimpleQueue[tuple[str, ArmName, bool]] = queue.SimpleQueue()  # by which way, whose, whether it is there
        self.ways: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()  # which way opened or was lost
        self._lock = threading.Lock()
        self._newest: dict[tuple[ArmName, str], bytes] = {}
        self._monitors: dict[ArmName, list[bytes]] = {}  # documents `monitor` before the newest one: two monitors may speak at once
        self._triggered: dict[ArmName, float] = {}
        self.received = 0

    def put(self, arm: ArmName, key: str, payload: bytes) -> None:
        """Keep the newest document of a key."""
        with self._lock:
            if key == MONITOR and (before := self._newest.get((arm, key))) is not None and before != payload:
                self._monitors.setdefault(arm, []).append(before)
                del self._monitors[arm][:-MOST_MONITORS]
            self._newest[arm, key] = payload
            self.received += 1

    def trigger(self, arm: ArmName) -> None:
        """Note that an arm's history goes on."""
        with self._lock:
            self._triggered.setdefault(arm, time.monotonic())

    def take(self) -> Received:
        """Everything since the last call."""
        with self._lock:
            received = Received(self._newest, self._monitors, self._triggered)
            self._newest, self._monitors, self._triggered = {}, {}, {}
        return received


class Link:
    """The way through one router, or to one arm. A thread opens it and tries for ever; an open one comes back by itself."""

    def __init__(
        self, endpoint: str, inbox: Inbox, zenoh_file: str, *, follows: bool = True, answers: Callable[[zenoh.Query], None] | None = None
    ) -> None:
        """`follows` : whether the arms' documents are received; else only questions are asked. answers : new arms' questions for a prior.

        Raises BadInput where the file is no Zenoh configuration.
        """
        self.endpoint = endpoint
        self._inbox, self._follows, self._answers = inbox, follows, answers
        self._config = session_config(mode="client", connect=(endpoint,), zenoh_file=zenoh_file)
        self._config.insert_json5("connect/timeout_ms", json.dumps(2000))
        self._session: zenoh.Session | None = None
        self._subscribers: list[zenoh.Subscriber[None]] = []  # one that nobody holds ends
        self._queryable: zenoh.Queryable[None] | None = None  # likewise
        self._closing = threading.Event()
        self._up = False
        self._thread = threading.Thread(target=self._open, name=f"link {endpoint}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the session."""
        self._closing.set()
        self._thread.join(timeout=10.0)
        if self._session is not None:
            self._session.close()

    @property
    def up(self) -> bool:
        """Whether somebody answers at the endpoint."""
        return self._up

    def reached(self) -> bool:
        """Whether somebody answers at the endpoint at this moment."""
        session = self._session
        return session is not None and bool(session.info.routers_zid() or session.info.peers_zid())

    def check(self) -> None:
        """See whether the other side is still there, and hand over what has changed. To be called every second or so."""
        up = self.reached()
        if up != self._up:
            self._up = up
            if up:
                log.info("%s: answers", self.endpoint)
            else:
                log.warning("%s: does not answer; tried again for ever", self.endpoint)
            self._inbox.ways.put((self.endpoint, up))

    def ask(self, key: str, payload: bytes | None = None) -> bytes:
        """The one answer to a query. Raises BusError where nobody answers in time, BadInput with the text of a refusal."""
        session = self._session
        if session is None:
            raise BusError(NO_ANSWER(endpoint=self.endpoint))
        try:
            for reply in session.get(key, payload=payload, timeout=TIMEOUT_S):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
                said = reply.err.payload.to_bytes().decode(errors="replace") if reply.err else ""
                try:
                    raise BadInput(str(json.loads(said)["error"]))
                except (ValueError, KeyError, TypeError):
                    raise BusError(LATE) from None
        except zenoh.ZError as error:
            raise BusError(str(error).split(" at /")[0]) from None
        raise BusError(LATE)

    def sees(self, arm: ArmName) -> bool:
        """Whether the token of an arm's monitor is behind this endpoint."""
        session = self._session
        if session is None:
            return False
        replies = session.liveliness().get(f"{arm.prefix}/{ALIVE}", timeout=TIMEOUT_S)
        return any(reply.ok is not None for reply in replies)

    def watch(self, arm: ArmName, heard: Callable[[str, bytes], None]) -> "zenoh.Subscriber[None]":
        """Everything that an arm says, by key below its prefix: what it said last, and what it says until the subscriber is undeclared.

        Raises BusError where nobody answers at the endpoint.
        """
        session = self._session
        if session is None:
            raise BusError(NO_ANSWER(endpoint=self.endpoint))

        def take(sample: zenoh.Sample) -> None:
            if (found := named(str(sample.key_expr))) is not None and sample.kind == zenoh.SampleKind.PUT:
                heard(found[1], sample.payload.to_bytes())

        def take_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                take(reply.ok)

        subscriber = session.declare_subscriber(f"{arm.prefix}/**", take)
        session.get(f"{arm.prefix}/**", take_reply, timeout=TIMEOUT_S)
        return subscriber

    def ask_last_values(self, arm: ArmName) -> None:
        """Ask for an arm's last values; they come to the inbox like those that it publishes. Raises BusError."""
        session = self._session
        if session is None:
            raise BusError(NO_ANSWER(endpoint=self.endpoint))
        for selector in FOLLOWED:
            for reply in session.get(f"{arm.prefix}/{selector}", timeout=TIMEOUT_S):
                if reply.ok is None:  # the time is over: to ask for more would take as long again
                    raise BusError(LATE)
                self._document(reply.ok)

    def _open(self) -> None:
        pause_s, told = REFUSED_S[0], False
        while not self._closing.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError:
                if not told:
                    log.warning("%s: nobody answers, or not to us; tried again for ever", self.endpoint)
                    told = True
                self._closing.wait(pause_s)
                pause_s = min(2.0 * pause_s, REFUSED_S[1])
                continue
            self._session = session
            if self._answers is not None:
                self._queryable = session.declare_queryable(f"{PLANT}/prior/*/*", self._answers, complete=True)
            if not self._follows:
                return
            kept = [session.declare_subscriber(f"{ROOT}/*/*/{selector}", self._document) for selector in FOLLOWED]
            kept += [session.declare_subscriber(f"{ROOT}/*/*/{selector}", self._history_goes_on) for selector in TRIGGERS]
            kept.append(session.liveliness().declare_subscriber(f"{ROOT}/*/*/{ALIVE}", self._token, history=True))
            self._subscribers = kept
            return

    def _token(self, sample: zenoh.Sample) -> None:
        if (found := named(str(sample.key_expr))) is not None:
            self._inbox.tokens.put((self.endpoint, found[0], sample.kind == zenoh.SampleKind.PUT))

    def _document(self, sample: zenoh.Sample) -> None:
        found = named(str(sample.key_expr))
        if found is not None and sample.kind == zenoh.SampleKind.PUT and _LAST_VALUE.fullmatch(found[1]):
            self._inbox.put(*found, sample.payload.to_bytes())

    def _history_goes_on(self, sample: zenoh.Sample) -> None:
        if (found := named(str(sample.key_expr))) is not None:
            self._inbox.trigger(found[0])


def command_arm(link: Link | None, arm: ArmName, key: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """An arm's answer to a command, asked once and by one way: a command whose answer is late may have been carried out.

    Raises BadInput where no way leads there, the arm does not answer, or answers no JSON.
    """
    if link is None:
        raise BadInput(NOBODY_HEARS(arm=str(arm)))
    try:
        answer = orjson.loads(link.ask(f"{arm.prefix}/{key}", orjson.dumps(dict(document))))
    except BusError as error:
        raise BadInput(DONE_OR_NOT(arm=str(arm), why=error.reason)) from None
    except orjson.JSONDecodeError:
        raise BadInput(NO_JSON(arm=str(arm))) from None
    return answer if isinstance(answer, dict) else {}
