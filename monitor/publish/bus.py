"""The bus: the monitor's documents on Zenoh, for other people's programs. I/O.

Every document is UTF-8 JSON below `joint-monitor/v1/<site>/<robot>`. One queryable answers `get` with the last values, so that a client
that starts late and asks receives the same as an early one; a plain subscriber receives what comes after it. A thread with a bounded
queue publishes: a frozen router blocks that thread alone.
"""

import logging
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import orjson
import zenoh

from monitor.errors import BadInput
from monitor.publish import permit
from monitor.publish.documents import Document, Error, Permit, Waiting, as_json, encoded
from monitor.publish.registry import KINDS, PUBLISHED, Delivery, answer_kind, kind_of, takes_payload
from monitor.publish.session import PLANT, BusSettings, encoding, not_opened, session_config

log = logging.getLogger(__name__)

QUEUE_LENGTH = 512  # documents; a replay publishes about a dozen
LONGEST_PARAMETERS = 1000
JSON_NAMES = {type(None): "null", bool: "true or false", int: "a number", float: "a number", str: "a string", list: "an array"}
PLANT_TIMEOUT_S = 5.0
LARGEST_QUERY_BYTES = 4_000_000  # 1000 samples × 6 joints × 4 signals are about 0.5 MB of JSON


class QueryHandler(NamedTuple):
    """The function that answers queries on one key, and the kind of its answer.

    `about` receives the query's JSON object, or the selector's parameters where the key takes no payload. The text of its BadInput becomes
    the error reply.
    """

    kind: str
    about: Callable[[Mapping[str, Any]], Document]
    payload: bool = True


class Sent(NamedTuple):
    """A last value: its kind, the document, and the document as it was sent."""

    kind: str
    document: Document
    payload: bytes


def handler(key: str, about: Callable[[Mapping[str, Any]], Document]) -> QueryHandler:
    """The handler of a registered key: the registry knows the kind of its answer and whether it takes a payload."""
    return QueryHandler(answer_kind(key).name, about, payload=takes_payload(key))


class Bus:
    """One open session: it publishes last values and answers queries. A context manager. Publishing never blocks for long or raises."""

    def __init__(self, settings: BusSettings, key_prefix: str, answers: Mapping[str, QueryHandler] | None = None) -> None:
        """Open the session.

        answers : handlers by key below the prefix. Only a query for exactly that key reaches one: a wildcard never starts an action.
        Raises as `session.not_opened`.
        """
        self._settings = settings
        self._prefix = key_prefix
        self._answers = dict(answers or {})
        self._last: dict[str, Sent] = {}
        self._lock = threading.Lock()
        # the fastest queue; `_enqueue` limits its length
        self._outbox: queue.SimpleQueue[tuple[str, str, bytes, bool, Callable[[], None] | None] | None] = queue.SimpleQueue()
        self.dropped = 0
        config = session_config(
            mode="peer", listen=settings.listen, connect=settings.connect, wait_for_peer=False, zenoh_file=settings.zenoh
        )
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise not_opened(error, settings.listen) from None
        self._inbox: queue.SimpleQueue[zenoh.Query | None] = queue.SimpleQueue()  # likewise; `_hand_over` limits it
        self._queryable = self._session.declare_queryable(f"{key_prefix}/**", self._hand_over, complete=True)
        self._alive = self._session.liveliness().declare_token(f"{key_prefix}/alive/monitor")
        self._robot_alive: zenoh.LivelinessToken | None = None
        self._threads = [threading.Thread(target=self._send, name="bus-send", daemon=True)]
        self._threads += [threading.Thread(target=self._serve, name=f"bus-serve-{n}", daemon=True) for n in range(settings.query_workers)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "Bus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Send what is queued, then close the session. A second call does nothing. An open session would block the interpreter's exit."""
        if self._session.is_closed():
            return
        self._outbox.put(None)
        self._threads[0].join(timeout=11.0)
        if self._threads[0].is_alive():
            log.warning("bus: %d documents were not sent before closing", self._outbox.qsize() - 1)
        self._queryable.undeclare()
        for _ in self._threads[1:]:
            self._inbox.put(None)
        for thread in self._threads[1:]:
            thread.join(timeout=6.0)
        self._session.close()

    # --- out ------------------------------------------------------------------------------------

    def say(self, document: Document, *, done: Callable[[], None] | None = None) -> None:
        """Publish a document on the key and with the delivery that the registry names for its type.

        A last value is kept for every later `get`; the samples of a stream are dropped where the network is slow. done : runs once the
        document is sent; it has no effect for a stream. Raises KeyError for a type that is not registered, or is never published.
        """
        kind = kind_of(type(document))
        if kind.delivery not in PUBLISHED:
            raise KeyError(f"{kind.name} is {kind.delivery.value}: it is not published")
        key, payload, stream = kind.key_of(document), encoded(document), kind.delivery is Delivery.STREAM
        if kind.delivery is not Delivery.TRANSITION:
            with self._lock:
                self._last[key] = Sent(kind.name, document, payload)
        self._enqueue((key, kind.name, payload, stream, None if stream else done))

    def answer(self, handlers: Mapping[str, QueryHandler]) -> None:
        """Answer queries on these keys below the prefix from now on, besides those given at construction."""
        self._answers = {**self._answers, **handlers}

    def last_values(self) -> dict[str, Document]:
        """The documents that answer a plain `get`, by key below the prefix."""
        with self._lock:
            return {key: sent.document for key, sent in self._last.items()}

    def waiting(self) -> Waiting:
        """Numbers of documents to send, of queries to answer, and of documents dropped so far."""
        return Waiting(to_send=self._outbox.qsize(), to_answer=self._inbox.qsize(), dropped=self.dropped)

    def without_router(self) -> str | None:
        """The problem that no configured router answers; None where one does, or none is configured."""
        if not self._settings.connect or self._session.info.routers_zid() or self._session.info.peers_zid():
            return None
        return f"nobody answers at {', '.join(self._settings.connect)}; what is said reaches only who asks here; tried again for ever"

    def last_payloads(self) -> dict[str, bytes]:
        """The last values as encoded payloads by key; a payload is a new object only after a new publication."""
        with self._lock:
            return {key: sent.payload for key, sent in self._last.items()}

    def ask(self, key: str, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """The answer to a query on a key below the prefix as JSON, for the page. Raises BadInput with the error reply's text."""
        return as_json(self._answers[key].about(about))

    def ask_permit(self, question: Permit, timeout_s: float) -> permit.PermitReply | None:
        """Ask for a permit on `permit/replay`; None where nobody answers in that time."""
        return permit.ask_permit(self._session, self._prefix, question, timeout_s)

    def ask_plant(self, key: str, timeout_s: float = PLANT_TIMEOUT_S) -> bytes | None:
        """The plant's answer on a key of its own; None where nobody answers in that time. Raises BadInput with the text of a refusal."""
        for reply in self._session.get(f"{PLANT}/{key}", timeout=timeout_s):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            if reply.err is not None and reply.err.encoding == encoding("error"):  # else Zenoh's own, that the time is over
                raise BadInput(str(orjson.loads(reply.err.payload.to_bytes())["error"]))
        return None

    def robot_alive(self, alive: bool) -> None:
        """Hold or drop the liveliness token of the link to the arm."""
        if alive and self._robot_alive is None:
            self._robot_alive = self._session.liveliness().declare_token(f"{self._prefix}/alive/robot")
        elif not alive and self._robot_alive is not None:
            self._robot_alive.undeclare()
            self._robot_alive = None

    def _enqueue(self, item: tuple[str, str, bytes, bool, Callable[[], None] | None]) -> None:
        if self._outbox.qsize() < QUEUE_LENGTH:
            self._outbox.put(item)
        else:
            self.dropped += 1
            if self.dropped == 1 or self.dropped % 1000 == 0:
                log.warning("bus: queue full, %d documents dropped; last values are still answered", self.dropped)

    def _send(self) -> None:
        while (item := self._outbox.get()) is not None:
            key, kind, payload, may_drop, done = item
            try:
                self._session.put(
                    f"{self._prefix}/{key}",
                    payload,
                    encoding=encoding(kind),
                    congestion_control=zenoh.CongestionControl.DROP if may_drop else zenoh.CongestionControl.BLOCK,
                )
                if done is not None:
                    done()
            except Exception:  # the thread must survive one bad document; the log names it
                log.exception("bus: %s could not be sent", key)

    # --- in -------------------------------------------------------------------------------------

    def _hand_over(self, query: zenoh.Query) -> None:
        # on Zenoh's own thread: hand over at once, because a slow answer here would block the whole link
        if self._inbox.qsize() < QUEUE_LENGTH:
            self._inbox.put(query)
        else:
            with query:
                _refuse(query, f"busy: {QUEUE_LENGTH} queries are waiting; ask again later")

    def _serve(self) -> None:
        while (query := self._inbox.get()) is not None:
            with query:
                try:
                    self._answer(query)
                except BadInput as error:
                    _refuse(query, str(error))
                except Exception as error:  # without a reply the client would wait until its time-out
                    log.exception("bus: query %s failed", query.key_expr)
                    _refuse(query, f"internal: {type(error).__name__}")

    def _answer(self, query: zenoh.Query) -> None:
        selector = str(query.key_expr)
        key = selector.removeprefix(f"{self._prefix}/")
        if key in self._answers:  # only the exact key: a wildcard must never make anything happen
            answer = self._answers[key]
            about = _payload(query, key) if answer.payload else _parameters(query, key)
            found = answer.about(about)
            if type(found) is not KINDS[answer.kind].model:
                raise TypeError(f"{key} is answered by {KINDS[answer.kind].model.__name__}, not by {type(found).__name__}")
            query.reply(query.key_expr, encoded(found), encoding=encoding(answer.kind))
            return
        with self._lock:
            known = list(self._last.items())
        for name, sent in known:
            full = zenoh.KeyExpr(f"{self._prefix}/{name}")
            if query.key_expr.intersects(full):
                query.reply(full, sent.payload, encoding=encoding(sent.kind))


def _refuse(query: zenoh.Query, why: str) -> None:
    query.reply_err(encoded(Error(error=why)), encoding=encoding("error"))


def _parameters(query: zenoh.Query, key: str) -> Mapping[str, str]:
    text = str(query.parameters)
    if len(text) > LONGEST_PARAMETERS:
        raise BadInput(f"{key}: the selector's parameters have {len(text)} characters; at most {LONGEST_PARAMETERS} are read")
    return dict(part.partition("=")[::2] for part in text.split(";") if part)


def _payload(query: zenoh.Query, key: str) -> Mapping[str, Any]:
    payload = query.payload
    if payload is None:
        raise BadInput(f"{key}: the query carries no payload; expected a JSON object")
    if len(payload) > LARGEST_QUERY_BYTES:
        raise BadInput(f"{key}: the payload has {len(payload)} bytes; at most {LARGEST_QUERY_BYTES} are read")
    try:
        document = orjson.loads(payload.to_bytes())
    except orjson.JSONDecodeError as error:
        raise BadInput(f"{key}: the payload is not JSON: {error}") from None
    if not isinstance(document, dict):
        raise BadInput(f"{key}: the payload is {JSON_NAMES.get(type(document), 'no object')}; expected a JSON object")
    return document
