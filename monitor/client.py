"""Client: the bus for other people's programs, and for our own commands.

with Client("tcp/127.0.0.1:7447", "site", "cell-3") as client:
    print(client.get("health"))
    print(client.torque(q=[...], qd=[...], temperature_c=[...]))
"""

import json
import queue
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import zenoh

from monitor.errors import BadInput, BusError
from monitor.publish.bus import prefix, session_config


class Message(NamedTuple):
    """One document, with its key below the robot's prefix."""

    key: str
    document: dict[str, Any]


class Client:
    """A session that looks at one robot's monitor."""

    def __init__(self, endpoint: str, site: str, robot: str, *, timeout_s: float = 5.0) -> None:
        """Connect.

        Raises BusError where nobody listens at the endpoint.
        """
        self._prefix = prefix(site, robot)
        self._timeout_s = timeout_s
        config = session_config(mode="client", connect=(endpoint,))
        config.insert_json5("connect/timeout_ms", json.dumps(int(timeout_s * 1000)))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError:
            raise BusError(
                f"{endpoint}: nobody answers; is the daemon (joint-monitor run) or the router up, and is this its endpoint?"
            ) from None

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def get(self, selector: str, payload: Mapping[str, Any] | None = None) -> list[Message]:
        """The last values that match a selector below the prefix, e.g. `health`, `joint/*/friction`, `**`.

        Raises BadInput where the selector is none, BusError where the daemon answers with an error or not in time.
        """
        answers = []
        key = self._key(selector)
        data = None if payload is None else json.dumps(payload).encode()
        for reply in self._session.get(key, payload=data, timeout=self._timeout_s):
            if reply.ok is None:
                problem = reply.err.payload.to_bytes().decode(errors="replace") if reply.err else "no answer"
                try:
                    message = json.loads(problem)["error"]
                except (ValueError, KeyError, TypeError):
                    raise BusError(f"{self._prefix}/{selector}: {problem}") from None
                raise BadInput(message)
            answers.append(self._message(reply.ok))
        return answers

    def torque(self, **arguments: Any) -> dict[str, Any]:
        """Temperature-corrected torque of one sample or of N: `q`, `qd`, `qdd` [rad, rad/s, rad/s²], `temperature_c`.

        Raises BadInput with the daemon's words where the arguments are wrong, BusError where nobody answers.
        """
        answers = self.get("torque", {name: value for name, value in arguments.items() if value is not None})
        if not answers:
            raise BusError(f"{self._prefix}/torque: no answer; is a daemon running for this robot?")
        return answers[0].document

    def watch(self, selector: str = "**", *, with_last: bool = True, until: Callable[[], bool] = lambda: False) -> Iterator[Message]:
        """First the last values, then everything that is said, until `until()` or the end of the program.

        Raises as `get`.
        """
        key = self._key(selector)
        # the callback only hands over: a slow one would block the whole link after 256 samples
        arrived: queue.SimpleQueue[Message] = queue.SimpleQueue()

        def hand_over(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                arrived.put(self._message(sample))

        subscriber = self._session.declare_subscriber(key, hand_over)
        try:
            if with_last:
                yield from self.get(selector)
            while not until():
                try:
                    yield arrived.get(timeout=0.2)  # in slices, so that Ctrl-C and `until` are heard
                except queue.Empty:
                    continue
        finally:
            subscriber.undeclare()

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
