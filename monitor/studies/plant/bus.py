"""A plant of simulated arms on the bus: many arms in each session, each with its own keys, token and answers. I/O."""

import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import orjson
import zenoh

from monitor import __version__
from monitor.errors import BadInput, BusError
from monitor.publish.documents import AckRequest, ShelveRequest, UnackRequest, UnshelveRequest
from monitor.publish.queries import MOST_EVENTS, events_question, history_question, request
from monitor.publish.session import ROOT, session_config
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S
from monitor.studies.plant.lives import Lives

log = logging.getLogger(__name__)

ARMS_A_SESSION = 100
MONITOR_S, HEALTH_S = 10.0, 60.0  # [s] as daemons publish
ANSWERING = 2  # threads
ALERT_COMMANDS: dict[str, tuple[str, type[AckRequest]]] = {  # the transition that each makes, and what it asks for
    "cmd/ack": ("acknowledged", AckRequest),
    "cmd/unack": ("unacknowledged", UnackRequest),
    "cmd/shelve": ("shelved", ShelveRequest),
    "cmd/unshelve": ("unshelved", UnshelveRequest),
}
FROZEN_SHARE = 0.01  # of the arms: their tokens are there, and they say nothing more


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedPlant:
    """How large the plant is, where it meets the bus, and how fast its time runs."""

    arms: int = 100
    sites: int = 3
    days: int = 60  # of life before the beginning
    speed: float = 1.0  # simulated seconds a second
    seed: int = 0
    connect: tuple[str, ...] = ()  # routers; the sites join them in turn
    routers: tuple[str, ...] = ()  # endpoints at which this process is the router

    def __post_init__(self) -> None:
        """Raises BadInput naming the figure that is out of its range."""
        for name, low, high in (("arms", 1, 10_000), ("sites", 1, 1000), ("days", 1, 3650), ("speed", 0.0, 1e6)):
            if not low <= getattr(self, name) <= high:
                raise BadInput(f"--{name} {getattr(self, name)!r}: expected {low:g} to {high:g}")
        if not (self.connect or self.routers):
            raise BadInput("expected --connect or --router: the arms must meet the bus somewhere")


class PlantOnBus:
    """Simulated monitors that publish and answer until they are closed. A context manager."""

    def __init__(self, settings: SimulatedPlant, lives: Lives, now: Callable[[], float] = time.time) -> None:
        """Open routers, sessions, answers and tokens. Raises BusError where an endpoint cannot be opened."""
        self.settings, self.lives, self._now = settings, lives, now
        self.names = [(f"site-{arm % settings.sites + 1}", f"arm-{arm + 1:04d}") for arm in range(settings.arms)]
        self._began_unix_s = now()
        self._lock = threading.Lock()  # lives grow while they are asked
        self._queries: queue.SimpleQueue[tuple[int, zenoh.Query] | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._stack = ExitStack()
        self._sessions: dict[int, zenoh.Session] = {}
        self._held: list[object] = []  # what nobody holds ends
        self.answered = self.published = 0
        try:
            for endpoint in settings.routers:
                self._stack.enter_context(zenoh.open(session_config(mode="router", listen=(endpoint,))))
            self._open()
        except zenoh.ZError as error:
            self._stack.close()
            raise BusError(
                f"Zenoh cannot open {', '.join((*settings.routers, *settings.connect))}: {str(error).split(' at /')[0]}"
            ) from None
        self._threads = [threading.Thread(target=self._answer, daemon=True) for _ in range(ANSWERING)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "PlantOnBus":
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for _thread in self._threads:
            self._queries.put(None)
        self._stack.close()

    def run(self, stopping: threading.Event) -> None:
        """Publish as monitors do, and let time pass, until asked to stop."""
        settings, began = self.settings, time.monotonic()
        days, round_ = self.lives.day, 0
        while not stopping.is_set():
            for arm in range(settings.arms):  # spread evenly over ten seconds, as daemons are
                due = began + MONITOR_S * (round_ + arm / settings.arms)
                if (wait := due - time.monotonic()) > 0.005 and stopping.wait(wait):
                    return
                if self.frozen(arm):
                    continue
                self.say(arm, "monitor", self.monitor(arm))
                if (round_ + arm) % round(HEALTH_S / MONITOR_S) == 0:
                    self.say(arm, "health", self.health(arm))
                while self.lives.day < days + int((time.monotonic() - began) * settings.speed / DAY_S) and not stopping.is_set():
                    self.pass_day()
            round_ += 1

    def pass_day(self) -> None:
        """One more day, and what the monitors publish after its replays."""
        before = [len(each) for each in self.lives.transitions]
        with self._lock:
            self.lives.live()
        for arm in range(self.settings.arms):
            if self.frozen(arm) or not self.lives.figures[-1].replayed[arm]:
                continue
            replay = len(self.lives.replays[arm])
            for joint in range(self.lives.joints):
                self.say(arm, f"joint/{joint + 1}/friction", self.lives.row(arm, replay, joint))
            for seq in range(before[arm] + 1, len(self.lives.transitions[arm]) + 1):
                self.say(arm, "event", self.lives.event(arm, seq))
                self.say(arm, "health", self.health(arm))

    def command(self, arm: int, key: str, payload: bytes) -> dict[str, Any]:
        """The answer to a command; what it changes is published. Raises BadInput where it is refused."""
        if key not in ALERT_COMMANDS:
            known = ", ".join(ALERT_COMMANDS)
            raise BadInput(f"{key}: this arm is simulated: it does not move, and knows no work; it answers {known}")
        try:
            document = orjson.loads(payload)
        except orjson.JSONDecodeError:
            raise BadInput(f"{key}: is no JSON") from None
        if not isinstance(document, dict):
            raise BadInput(f"{key}: expected a JSON object")
        kind, model = ALERT_COMMANDS[key]
        asked = request(model, document)
        with self._lock:
            alert = self.lives.act(arm, kind, asked, self._now())
            event = self.lives.event(arm, len(self.lives.transitions[arm]))
            health = self.health(arm)
        self.say(arm, f"alert/j{asked.joint}/{asked.condition}", alert)
        self.say(arm, "health", health)
        self.say(arm, "event", event)
        return {"done": kind, "alert": alert}

    def frozen(self, arm: int) -> bool:
        """Whether this arm's monitor hangs: it is there and says nothing."""
        return arm % 100 == 37 and self.settings.arms * FROZEN_SHARE >= 1.0

    def say(self, arm: int, key: str, document: dict[str, Any]) -> None:
        """Publish one document."""
        self.published += 1
        self._sessions[arm].put(f"{self._prefix(arm)}/{key}", orjson.dumps(document))

    def health(self, arm: int) -> dict[str, Any]:
        """The document `health`."""
        return {**self.lives.health(arm), "said_at": rfc3339(self._now())}

    def info(self, arm: int) -> dict[str, Any]:
        """The document `info`."""
        site, robot = self.names[arm]
        return {
            **{"robot": {"model": self.lives.fleet.settings.robot, "site": site, "id": robot}, "version": __version__, "host": "simulated"},
            **{"trajectory_digest": "simulated", "started_at": rfc3339(self._began_unix_s)},
        }

    def monitor(self, arm: int) -> dict[str, Any]:
        """The document `monitor`."""
        now, days = self._now(), self.lives.replays[arm]
        window = rfc3339(self.lives.at_unix_s(days[-1])) if days else None
        last = {"replay": len(days), "window": window, "state": "assessed", "reason": None, "ended_at": window} if days else None
        cursors = {"history_id": self.history_id(arm), "last_event": len(self.lives.transitions[arm]), "last_change": len(days)}
        return {
            **{"version": __version__, "programs": {}, "started_at": rfc3339(self._began_unix_s), "uptime_s": now - self._began_unix_s},
            **{"said_at": rfc3339(now), "troubles": [], "last_replay": last, "next_replay_due": None, "next_replay_why": None},
            **{"lag_s": None, "arm": {"heard": True}, "bus": {}, "store": cursors, "process": {}, "workers": {}, "reload": None},
            "overrides": [],
        }

    def history_id(self, arm: int) -> str:
        """What tells this arm's history from another one's."""
        return f"simulated-{self.settings.seed}-{arm}-{self.lives.begin_unix_s:.0f}"

    def _prefix(self, arm: int) -> str:
        site, robot = self.names[arm]
        return f"{ROOT}/{site}/{robot}"

    def _open(self) -> None:
        """Sessions of up to `ARMS_A_SESSION` arms of one site, joined to its router."""
        endpoints = self.settings.connect or self.settings.routers
        for site in range(self.settings.sites):
            arms = range(site, self.settings.arms, self.settings.sites)
            for first in range(0, len(arms), ARMS_A_SESSION):
                config = session_config(mode="client", connect=(endpoints[site % len(endpoints)],))
                config.insert_json5("connect/timeout_ms", json.dumps(5000))
                session = self._stack.enter_context(zenoh.open(config))
                for arm in arms[first : first + ARMS_A_SESSION]:
                    self._sessions[arm] = session
                    self._held.append(session.declare_queryable(f"{self._prefix(arm)}/**", self._hand_over(arm), complete=True))
                    self._held.append(session.liveliness().declare_token(f"{self._prefix(arm)}/alive/monitor"))

    def _hand_over(self, arm: int) -> Callable[[zenoh.Query], None]:
        return lambda query: self._queries.put((arm, query))

    def _answer(self) -> None:
        while (asked := self._queries.get()) is not None:
            arm, query = asked
            with query:
                try:
                    self._reply(arm, query)
                    self.answered += 1
                except BadInput as error:
                    query.reply_err(orjson.dumps({"error": str(error)}))
                except Exception as error:  # a client must not wait for its time-out
                    log.exception("query %s failed", query.key_expr)
                    query.reply_err(orjson.dumps({"error": f"internal: {type(error).__name__}"}))

    def _reply(self, arm: int, query: zenoh.Query) -> None:
        key = str(query.key_expr).removeprefix(f"{self._prefix(arm)}/")
        parameters = dict(part.partition("=")[::2] for part in str(query.parameters).split(";") if part)
        if key in {"history", "event"}:
            with self._lock:
                document = self._history(arm, parameters) if key == "history" else self._events(arm, parameters)
            query.reply(query.key_expr, orjson.dumps(document))
            return
        if key.startswith("cmd/"):
            query.reply(query.key_expr, orjson.dumps(self.command(arm, key, query.payload.to_bytes() if query.payload else b"")))
            return
        with self._lock:
            found = {
                name: made() for name, made in self._known(arm).items() if query.key_expr.intersects(zenoh.KeyExpr(self._full(arm, name)))
            }
        for name, document in found.items():
            query.reply(self._full(arm, name), orjson.dumps(document))

    def _known(self, arm: int) -> dict[str, Callable[[], dict[str, Any]]]:
        """An arm's last values by key, made only where somebody asks for them: a plant that starts asks every arm five times."""
        known: dict[str, Callable[[], dict[str, Any]]] = {
            "health": lambda: self.health(arm),
            "monitor": lambda: self.monitor(arm),
            "info": lambda: self.info(arm),
        }
        for alert in self.health(arm)["alerts"]:
            known[f"alert/j{alert['joint']}/{alert['condition']}"] = partial(dict, alert)
        if newest := len(self.lives.replays[arm]):
            known |= {f"joint/{joint + 1}/friction": partial(self.lives.row, arm, newest, joint) for joint in range(self.lives.joints)}
        return known

    def _full(self, arm: int, name: str) -> str:
        return f"{self._prefix(arm)}/{name}"

    def _history(self, arm: int, parameters: dict[str, str]) -> dict[str, Any]:
        lives, question = self.lives, history_question(parameters, self.lives.joints)
        last = len(lives.replays[arm])
        if question.changed_after is not None:
            numbers = range(question.changed_after + 1, last + 1)[: max(question.limit // lives.joints, 1)]
            changes = [lives.change(arm, seq) for seq in numbers]
            return {"rows": [], "next": _next(numbers, last), "changes": changes, "history_id": self.history_id(arm)}
        joints = range(lives.joints) if question.joint is None else [question.joint - 1]
        numbers = range(question.after + 1, last + 1)[: max(question.limit // len(joints), 1)]
        rows = [lives.row(arm, replay, joint) for replay in numbers for joint in joints]
        return {"rows": rows, "next": _next(numbers, last)}

    def _events(self, arm: int, parameters: dict[str, str]) -> dict[str, Any]:
        after, limit = events_question(parameters)
        last = len(self.lives.transitions[arm])
        numbers = range(after + 1, last + 1)
        numbers = numbers[-MOST_EVENTS:] if limit is None else numbers[:limit]
        events = [self.lives.event(arm, seq) for seq in numbers]
        following = None if limit is None else _next(numbers, last)
        identity = self.history_id(arm)
        return {"events": events, "first_kept": 1 if last else None, "last": last or None, "next": following, "history_id": identity}


def _next(numbers: Sequence[int], last: int) -> int | None:
    """The number that the next page follows; None at the end."""
    return numbers[-1] if numbers and numbers[-1] < last else None
