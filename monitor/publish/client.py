"""The typed client of the bus, for other people's programs and for the commands. I/O.

with Client("tcp/127.0.0.1:7447", "site", "cell-3") as client:
    print(client.health().state)
    print(client.torque(q=[...], qd=[...], temperature_c=[...]).torque_nm)
    for alert in client.alerts():
        print(alert.text)
"""

import json
import queue
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import zenoh
from pydantic import BaseModel

from monitor.errors import BadInput, BusError
from monitor.publish.documents import (
    Alert,
    Answer,
    Events,
    Friction,
    Health,
    History,
    HistoryRow,
    Info,
    Model,
    Torque,
)
from monitor.publish.queries import (
    AckRequest,
    Asked,
    InspectedRequest,
    ReplayRequest,
    Request,
    ServicedRequest,
    ShelveRequest,
    UnackRequest,
    UndoInspectedRequest,
    UndoServicedRequest,
    UnshelveRequest,
    request,
)
from monitor.publish.registry import KINDS, kind_of
from monitor.publish.session import prefix, session_config

JUDGED_AGAIN_S = 120.0  # for weeks of replays to be judged once more, on a slow machine
EVENT = KINDS["event"].key()
Content = TypeVar("Content", bound=BaseModel)


def _asked(model: type[Asked], **fields: Any) -> Asked:
    """Raises BadInput that names every wrong field, as the daemon would."""
    return request(model, kind_of(model).key(), fields)


class Message(NamedTuple):
    """One document, with its key below the robot's prefix."""

    key: str
    document: dict[str, Any]


class Client:
    """A session with one robot's monitor. A context manager."""

    def __init__(self, endpoint: str, site: str, robot: str, *, timeout_s: float = 5.0, zenoh_file: str = "") -> None:
        """Connect.

        zenoh_file : path of a Zenoh configuration (JSON5) with certificates or passwords, where the daemon or router asks for them.
        Raises BusError where the endpoint does not answer or refuses the client, BadInput where the file is no Zenoh configuration.
        """
        self._prefix = prefix(site, robot)
        self._timeout_s = timeout_s
        config = session_config(mode="client", connect=(endpoint,), zenoh_file=zenoh_file)
        config.insert_json5("connect/timeout_ms", json.dumps(int(timeout_s * 1000)))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError:
            raise BusError(
                f"{endpoint}: nobody answers, or not to us; is the daemon (joint-monitor run) or the router up, is this its endpoint, "
                f"and does it ask for a certificate or a password?"
            ) from None

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def get(self, selector: str, payload: Mapping[str, Any] | None = None, *, timeout_s: float | None = None) -> list[Message]:
        """The last values that match a selector below the prefix, e.g. `health`, `joint/*/friction`, `**`.

        Raises BadInput for an invalid selector or an error reply, BusError where the daemon does not answer in time.
        """
        answers = []
        key = self._key(selector)
        data = None if payload is None else json.dumps(payload).encode()
        for reply in self._session.get(key, payload=data, timeout=timeout_s or self._timeout_s):
            if reply.ok is None:
                problem = reply.err.payload.to_bytes().decode(errors="replace") if reply.err else "no answer"
                try:
                    message = json.loads(problem)["error"]
                except (ValueError, KeyError, TypeError):
                    raise BusError(f"{self._prefix}/{selector}: {problem}") from None
                raise BadInput(message)
            answers.append(self._message(reply.ok))
        return answers

    def health(self) -> Health:
        """NE 107 states of arm and joints. Raises BusError where no daemon answers for this robot."""
        return self._last_one(Health)

    def info(self) -> Info:
        """The document `info`: who watches this robot, with what, and since when. Raises BusError where no daemon answers for it."""
        return self._last_one(Info)

    def model(self) -> Model:
        """The temperature-compensated model. Raises BusError where there is none yet."""
        return self._last_one(Model)

    def alerts(self, *, cleared: bool = False) -> list[Alert]:
        """Active alerts, the oldest first; with `cleared` also the last cleared one of each condition."""
        return sorted((alert for alert in self._last_all(Alert) if cleared or alert.active), key=lambda alert: alert.raised_at)

    def friction(self) -> list[Friction]:
        """Each joint after the last replay, in order."""
        return sorted(self._last_all(Friction), key=lambda row: row.joint)

    def documents(self, kind: str) -> list[BaseModel]:
        """The last values of a registered kind, in the order of their keys. Raises KeyError for a kind that is not registered."""
        registered = KINDS[kind]
        found = [message for selector in registered.selectors for message in self.get(selector)]
        return [registered.model.model_validate(message.document) for message in sorted(found, key=lambda message: message.key)]

    def torque(
        self, *, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike | None = None, temperature_c: npt.ArrayLike | None = None
    ) -> Torque:
        """Temperature-corrected torque of one sample (J,) or of N (N, J).

        q, qd, qdd : [rad, rad/s, rad/s²]; qdd is 0 where it is not given. temperature_c : of the joints [°C], the present ones where
        not given. Raises BadInput with the daemon's text where the arguments are wrong, BusError where no daemon answers.
        """
        given = {"q": q, "qd": qd, "qdd": qdd, "temperature_c": temperature_c}
        try:
            request = {name: np.asarray(value, dtype=float).tolist() for name, value in given.items() if value is not None}
        except (TypeError, ValueError):
            raise BadInput("torque: expected numbers, J or (N, J) of each argument") from None
        return Torque.model_validate(self._one(kind_of(Torque).key(), request).document)

    def history(self, *, joint: int | None = None, since: str | None = None, until: str | None = None) -> Iterator[HistoryRow]:
        """Past estimates, the oldest first, page by page; times as RFC 3339."""
        after: int | None = 0
        while after is not None:
            parameters = {"joint": joint, "from": since, "to": until, "after": after}
            text = ";".join(f"{name}={value}" for name, value in parameters.items() if value is not None)
            page = History.model_validate(self._one(f"{kind_of(History).key()}?{text}").document)
            yield from page.rows
            after = page.next

    def events(self, after: int = 0) -> Events:
        """Transitions of alerts with numbers above `after`: those that a program missed."""
        return Events.model_validate(self._one(f"{kind_of(Events).key()}?after={after}").document)

    def acknowledge(self, joint: int | None, condition: str, *, by: str, why: str = "") -> Alert:
        """Acknowledge an alert: a person has seen it. Raises BadInput where there is no such active alert."""
        return self._command(_asked(AckRequest, joint=joint, condition=condition, by=by, why=why))

    def shelve(self, joint: int | None, condition: str, *, hours: float, by: str, why: str = "") -> Alert:
        """Shelve an alert: it need not be shown for some hours. Raises BadInput where there is no such active alert."""
        return self._command(_asked(ShelveRequest, joint=joint, condition=condition, hours=hours, by=by, why=why))

    def unacknowledge(self, joint: int | None, condition: str, *, by: str, why: str = "") -> Alert:
        """Take the acknowledgements of an alert back. Raises BadInput where there is no such active alert, or it is not acknowledged."""
        return self._command(_asked(UnackRequest, joint=joint, condition=condition, by=by, why=why))

    def unshelve(self, joint: int | None, condition: str, *, by: str, why: str = "") -> Alert:
        """End the shelving of an alert. Raises BadInput where there is no such active alert, or it is not shelved."""
        return self._command(_asked(UnshelveRequest, joint=joint, condition=condition, by=by, why=why))

    def serviced(self, joint: int, kind: str, *, by: str, why: str, at: str | None = None) -> Answer:
        """Declare work on a joint: it was `replaced`, `greased` or `overhauled`, now or at a time (RFC 3339 or a date).

        Raises BadInput with the daemon's reason where it refuses.
        """
        return self._answer(_asked(ServicedRequest, joint=joint, kind=kind, by=by, why=why, at=at))

    def undo_serviced(self, joint: int, *, by: str, why: str = "") -> Answer:
        """Take the last declared work on a joint back. Raises BadInput with the daemon's reason where that is not possible."""
        return self._answer(_asked(UndoServicedRequest, joint=joint, by=by, why=why), timeout_s=max(self._timeout_s, JUDGED_AGAIN_S))

    def inspected(self, request: InspectedRequest | UndoInspectedRequest) -> Answer:
        """Record a check of [inspection], or take the last record of it back. Raises BadInput with the daemon's reason where it refuses."""
        return self._answer(request)

    def request_replay(self, *, by: str, why: str = "") -> str:
        """Request a replay now. Raises BadInput with the daemon's reason where it refuses."""
        answer = self._one(kind_of(ReplayRequest).key(), _asked(ReplayRequest, by=by, why=why).model_dump())
        return str(answer.document["done"])

    def watch(
        self,
        selector: str = "**",
        *,
        with_last: bool = True,
        until: Callable[[], bool] = lambda: False,
        alive: Callable[[bool], None] = lambda _: None,
    ) -> Iterator[Message]:
        """Yield the last values, then every document that is published, until `until()` is true.

        Where the selector includes `event`, every transition comes once and in order. Those missed while the link, a router or the daemon
        was down follow as soon as the daemon is back, together with the last values. `alive` is called with False when the monitor, or the
        way to it, is gone, and with True when it is back. Raises as `get`.
        """
        key = self._key(selector)
        # the callbacks only fill a queue: a slow one would block the whole link after 256 samples
        arrived: queue.SimpleQueue[Message | bool] = queue.SimpleQueue()

        def hand_over(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                arrived.put(self._message(sample))

        def back(sample: zenoh.Sample) -> None:
            arrived.put(sample.kind == zenoh.SampleKind.PUT)

        log = _Transitions(self) if zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(f"{self._prefix}/{EVENT}")) else None
        subscriber = self._session.declare_subscriber(key, hand_over)
        # without its history the subscriber would not be told that a token from before it is gone; that history's PUT is no return
        alive_key = f"{self._prefix}/alive/monitor"
        known = any(reply.ok is not None for reply in self._session.liveliness().get(alive_key, timeout=self._timeout_s))
        token = self._session.liveliness().declare_subscriber(alive_key, back, history=True)
        try:
            if log is not None:
                log.begin(with_last=with_last)
            if with_last:
                yield from self._last(selector)
            while not until():
                try:
                    message = arrived.get(timeout=0.2)  # short waits, so that Ctrl-C and `until` take effect
                except queue.Empty:
                    continue
                if isinstance(message, bool):
                    known, was_known = False, known
                    if message and was_known:
                        continue
                    alive(message)
                    if not message:
                        continue
                    if log is not None:
                        yield from log.missed()
                    yield from self._again(selector)
                elif message.key == EVENT and log is not None:
                    yield from log.next(message)
                else:
                    yield message
        finally:
            subscriber.undeclare()
            token.undeclare()

    def _last(self, selector: str) -> list[Message]:
        """Last values in the order of their keys. `event` is a log without a last value: a query there is answered with a page of it."""
        return sorted((message for message in self.get(selector) if message.key != EVENT), key=lambda message: message.key)

    def _again(self, selector: str) -> list[Message]:
        try:
            return self._last(selector)
        except BusError:  # the daemon is gone again; its next return calls this again
            return []

    def _one(self, selector: str, payload: Mapping[str, Any] | None = None, *, timeout_s: float | None = None) -> Message:
        answers = self.get(selector, payload, timeout_s=timeout_s)
        if not answers:
            raise BusError(f"{self._prefix}/{selector}: no answer; is a daemon running for this robot, and has it assessed a replay?")
        return answers[0]

    def _last_one(self, model: type[Content]) -> Content:
        return model.model_validate(self._one(kind_of(model).key()).document)

    def _last_all(self, model: type[Content]) -> list[Content]:
        return [model.model_validate(message.document) for selector in kind_of(model).selectors for message in self.get(selector)]

    def _command(self, request: Request) -> Alert:
        return Alert.model_validate(self._one(kind_of(type(request)).key(), request.model_dump()).document["alert"])

    def _answer(self, request: Request, *, timeout_s: float | None = None) -> Answer:
        return Answer.model_validate(self._one(kind_of(type(request)).key(), request.model_dump(), timeout_s=timeout_s).document)

    def _key(self, selector: str) -> str:
        key = f"{self._prefix}/{selector}"
        try:
            zenoh.Selector(key)
        except zenoh.ZError as wrong:
            why = str(wrong).split(" at ")[0].split(": ", 1)[-1]
            raise BadInput(f"{selector!r} is no key expression ({why}); expected e.g. health, joint/*/friction or **") from None
        return key

    def _message(self, sample: zenoh.Sample) -> Message:
        return Message(str(sample.key_expr).removeprefix(f"{self._prefix}/"), json.loads(sample.payload.to_bytes()))


class _Transitions:
    """Passes on every numbered transition once and in order, and asks the daemon for missed ones."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._last: int | None = None

    def begin(self, *, with_last: bool) -> None:
        """Start after the newest transition: earlier ones stand in the last values."""
        try:
            self._last = self._client.events().last or 0
        except (BusError, BadInput):
            self._last = None if with_last else 0  # no daemon yet: the first transition that arrives is the beginning

    def next(self, message: Message) -> Iterator[Message]:
        """A transition that arrived, preceded by those that did not."""
        number = int(message.document.get("seq", 0))
        if self._last is None:
            self._last = number - 1
        if number > self._last + 1:
            yield from self.missed(before=number)
        if number > self._last:
            self._last = number
            yield message

    def missed(self, before: int | None = None) -> Iterator[Message]:
        """The transitions after the last one passed on, as far as the daemon still has them."""
        if self._last is None:
            return
        try:
            events = self._client.events(self._last).events
        except (BusError, BadInput):
            return
        for event in events:
            if event.seq > self._last and (before is None or event.seq < before):
                self._last = event.seq
                yield Message(EVENT, event.model_dump(mode="json"))
