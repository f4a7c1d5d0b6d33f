"""The lives of a plant's arms: the rehearsal fleet, judged day by day by the daemon's own functions, as the documents of its monitors."""

import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import orjson
import zenoh

from monitor import __version__
from monitor.errors import BadInput, BusError
from monitor.judge.alerts.conditions import CONDITIONS
from monitor.judge.friction.figures import expected, expected_row, found_wear, wear_and_rate
from monitor.judge.settings import AssessSettings
from monitor.publish.queries import (
    MOST_EVENTS,
    AckRequest,
    ShelveRequest,
    UnackRequest,
    UnshelveRequest,
    events_question,
    history_question,
    request,
)
from monitor.publish.session import ROOT, session_config
from monitor.publish.timestamps import rfc3339
from monitor.recording import DAY_S, Array
from monitor.studies.figures import DAYS_A_YEAR
from monitor.studies.rehearsal.fleet import Fleet, FleetSettings, Wear
from monitor.studies.rehearsal.play import JudgedDay, judged_days

WORN_SHARE = 0.2  # of the arms: one joint of each wears
PER_YEAR = 0.1, 1.5  # fraction: rates between which they are drawn
ONSET_DAYS = 10.0, 120.0
CLEARED_AFTER = 5  # replays without a tier end an alert
LONGEST_DAYS = 20_000  # of a life
CONDITION = "wear_rising"
TIERS = tuple(CONDITIONS[CONDITION].tiers)


class Figures(NamedTuple):
    """All arms after one morning, (A, J) each; float32, so that a year of 1000 arms fits into memory."""

    day: int
    replayed: np.ndarray  # (A,)
    torque_nm: Array
    torque_std_nm: Array
    wear: Array
    wear_std: Array
    rate: Array
    rate_std: Array
    temperature_c: Array
    coulomb_nm: Array
    viscous: Array


class Transition(NamedTuple):
    """One transition of the alert of one joint."""

    day: int
    joint: int  # from 1
    kind: str
    tier: str
    raised: int  # day
    change: float
    at_unix_s: float | None = None  # where a person did it; none: at the replay of the day
    by: str | None = None
    why: str | None = None


@dataclass(slots=True)
class _Alert:
    """The alert of one joint while it is active."""

    tier: int
    raised: int
    updated: int
    without: int = 0  # replays in a row without a tier
    change: float = 0.0
    said: dict[str, Any] = field(default_factory=dict)  # what people have done to it, as its document says


class Lives:
    """The arms of a plant, from a seed. Every number counts from 1: replays, changes and transitions of each arm."""

    def __init__(self, arms: int, seed: int, begin_unix_s: float, assess: AssessSettings | None = None) -> None:
        """Nothing has happened yet; `live` lets days pass. begin_unix_s : of the first day."""
        self.assess = assess or AssessSettings()
        self.arms, self.seed, self.begin_unix_s = arms, seed, begin_unix_s
        self.fleet = Fleet(FleetSettings(arms=arms, seed=seed), _wear(arms, seed))
        self.joints = self.fleet.joints
        self.figures: list[Figures] = []
        self.replays: list[list[int]] = [[] for _ in range(arms)]  # the days on which each arm replayed: the k-th is replay k + 1
        self.transitions: list[list[Transition]] = [[] for _ in range(arms)]
        self._alerts: list[dict[int, _Alert]] = [{} for _ in range(arms)]
        self._days: Iterator[JudgedDay] = judged_days(self.fleet, LONGEST_DAYS, self.assess)

    @property
    def day(self) -> int:
        """Days that have passed."""
        return len(self.figures)

    def live(self, days: int = 1) -> None:
        """Let days pass: work, a night, and the replay of the next morning."""
        for judged in (next(self._days) for _ in range(days)):
            figures = self._figures(judged)
            raises = judged.evidence.raises.reshape(self.arms, self.joints)
            for arm in np.flatnonzero(figures.replayed).tolist():
                self.replays[arm].append(figures.day)
                for joint in range(self.joints):
                    if raises[arm, joint] >= 0 or joint in self._alerts[arm]:
                        self._alert(arm, joint, int(raises[arm, joint]), figures)
            self.figures.append(figures)

    def at_unix_s(self, day: int) -> float:
        """When the replay of a day was recorded: at five in the morning."""
        return self.begin_unix_s + day * DAY_S + 5 * 3600.0

    def row(self, arm: int, replay: int, joint: int) -> dict[str, Any]:
        """One joint after one replay, as a row of `history`. joint : from 0."""
        day = self.replays[arm][replay - 1]
        of = self.figures[day]
        coulomb, viscous, torque, std = (float(each[arm, joint]) for each in (of.coulomb_nm, of.viscous, of.torque_nm, of.torque_std_nm))
        temperature = float(of.temperature_c[arm, joint])
        return {
            **{"replay": replay, "joint": joint + 1, "recorded_at": rfc3339(self.at_unix_s(day))},
            **{"coulomb_nm": coulomb, "coulomb_std_nm": 0.01 * coulomb, "viscous_nm_s_per_rad": viscous},
            **{"viscous_std_nm_s_per_rad": 0.02 * viscous, "temperature_c": temperature if np.isfinite(temperature) else None},
            **{"reference_speed_rad_s": self.fleet.settings.reference_speed_rad_s, "reference_temperature_c": 25.0},
            **{"reference_torque_nm": torque, "reference_torque_std_nm": std, "wear": float(of.wear[arm, joint])},
            **{"wear_std": float(of.wear_std[arm, joint]), "wear_rate_per_day": float(of.rate[arm, joint])},
            "wear_rate_std_per_day": float(of.rate_std[arm, joint]),
            "remaining_life": {"trend_probability": 0.0, "p10_days": None, "p50_days": None, "p90_days": None, "verdict": "not simulated"},
        }

    def change(self, arm: int, seq: int) -> dict[str, Any]:
        """One entry of the log of changes: here a replay was judged when it was recorded."""
        rows = [self.row(arm, seq, joint) for joint in range(self.joints)]
        return {"seq": seq, "replay": seq, "at": rows[0]["recorded_at"], "rows": rows}

    def event(self, arm: int, seq: int) -> dict[str, Any]:
        """One transition as it is published."""
        found = self.transitions[arm][seq - 1]
        active = found.kind != "cleared"
        at = self.at_unix_s(found.day) if found.at_unix_s is None else found.at_unix_s
        return {
            **{"seq": seq, "kind": found.kind, "at": rfc3339(at), "by": found.by, "why": found.why},
            **self._alert_document(found.joint, found.tier, found.raised, found.day, found.change),
            **{"active": active, "cleared_at": None if active else rfc3339(self.at_unix_s(found.day))},
        }

    def health(self, arm: int) -> dict[str, Any]:
        """The arm at a glance, without the times that only its publisher knows."""
        active = self._alerts[arm]
        last = self.replays[arm][-1] if self.replays[arm] else None
        stale = last is not None and self.day - 1 - last > self.assess.health.stale_days
        states = []
        for joint in range(self.joints):
            tier = TIERS[active[joint].tier] if joint in active else None
            state = CONDITIONS[CONDITION].tiers[tier].state if tier else "NORMAL"
            since = self.at_unix_s(active[joint].raised if joint in active else (self.replays[arm] or [0])[0])
            why = _text(joint + 1, active[joint].change) if joint in active else "no change"
            states.append({"joint": joint + 1, "state": state, "why": why, "since": rfc3339(since), "stale": stale})
        order = ("NORMAL", "MAINTENANCE_REQUIRED", "FAILURE")
        worst = max(states, key=lambda each: order.index(str(each["state"])))
        alerts = [
            {**self._alert_document(j + 1, TIERS[a.tier], a.raised, a.updated, a.change), **a.said} for j, a in sorted(active.items())
        ]
        return {
            **{"state": None if last is None else worst["state"], "why": worst["why"], "since": worst["since"]},
            **{"joints": states if last is not None else [], "alerts": alerts, "next_replay_due": None, "stale": stale},
        }

    def act(self, arm: int, kind: str, request: AckRequest, at_unix_s: float) -> dict[str, Any]:
        """What a person does to an alert; returns the alert after it. kind : of the transition that it makes.

        Raises BadInput without such an active alert.
        """
        alert = self._alerts[arm].get((request.joint or 0) - 1)
        if alert is None or request.condition != CONDITION:
            where = "arm" if request.joint is None else f"j{request.joint}"
            raise BadInput(f"there is no active alert {where}/{request.condition}")
        at = rfc3339(at_unix_s)
        if kind == "acknowledged":
            alert.said |= {"acknowledged_at": at, "acknowledged_by": request.by, "acknowledged_why": request.why}
        elif kind == "shelved":
            assert isinstance(request, ShelveRequest)
            until = rfc3339(at_unix_s + 3600.0 * request.hours)
            alert.said |= {"shelved_until": until, "shelved_by": request.by, "shelved_why": request.why}
        else:
            what = {"unacknowledged": "acknowledged", "unshelved": "shelved"}[kind]
            alert.said = {name: value for name, value in alert.said.items() if not name.startswith(what)}
        self._transition(arm, alert.updated, (request.joint or 0) - 1, kind, at_unix_s, request.by, request.why)
        return next(each for each in self.health(arm)["alerts"] if each["joint"] == request.joint)

    def _alert(self, arm: int, joint: int, tier: int, of: Figures) -> None:
        """The alert of a joint after a replay that gives a tier, or −1."""
        alerts, change = self._alerts[arm], float(np.expm1(of.wear[arm, joint]))
        alert = alerts.get(joint)
        if alert is None:
            alerts[joint] = _Alert(tier=tier, raised=of.day, updated=of.day, change=change)
            self._transition(arm, of.day, joint, "raised")
        elif tier < 0:
            alert.without += 1
            if alert.without >= CLEARED_AFTER:
                self._transition(arm, of.day, joint, "cleared")
                del alerts[joint]
        else:
            alert.without, alert.change = 0, change
            if tier > alert.tier:
                alert.tier, alert.updated = tier, of.day
                self._transition(arm, of.day, joint, "updated")

    def _transition(self, arm: int, day: int, joint: int, kind: str, *of_person: Any) -> None:
        alert = self._alerts[arm][joint]
        self.transitions[arm].append(Transition(day, joint + 1, kind, TIERS[alert.tier], alert.raised, alert.change, *of_person))

    def _alert_document(self, joint: int, tier: str, raised: int, updated: int, change: float) -> dict[str, Any]:
        return {
            **{"joint": joint, "condition": CONDITION, "tier": tier, "active": True, "raised_at": rfc3339(self.at_unix_s(raised))},
            **{"updated_at": rfc3339(self.at_unix_s(updated)), "change": change, "probability": 0.99, "text": _text(joint, change)},
            "action": CONDITIONS[CONDITION].tiers[tier].advice,
        }

    def _figures(self, judged: JudgedDay) -> Figures:
        state, shape = judged.result.state.friction, (self.arms, self.joints)
        N = self.arms * self.joints
        mean, var = expected(state, expected_row(state, np.full(N, 25.0), np.zeros(N), self.assess.friction))
        torque, seen, rates = np.exp(mean), judged.now.seen, wear_and_rate(state)
        rate, rate_std = rates.mean[:, 1], np.sqrt(np.maximum(rates.cov[:, 1, 1], 0.0))
        each = (torque, torque * np.sqrt(var), *found_wear(state), rate, rate_std)
        figures = (*each, seen.temperature_c, np.nan_to_num(seen.coulomb_nm), np.nan_to_num(seen.viscous_nm_s_per_rad))
        small: list[Any] = [np.asarray(one, np.float32).reshape(shape) for one in figures]
        return Figures(judged.number, judged.now.replayed.copy(), *small)


def _text(joint: int, change: float) -> str:
    return f"Friction of joint {joint} is {100.0 * change:+.0f} % against its beginning."


def _wear(arms: int, seed: int) -> Wear:
    """One joint of some arms wears, at rates and from days of their own."""
    rng = np.random.default_rng(seed + 1)
    worn = rng.random(arms) < WORN_SHARE
    per_year = np.exp(rng.uniform(np.log(PER_YEAR[0]), np.log(PER_YEAR[1]), arms))
    return Wear(
        joint=rng.integers(0, 6, arms).astype(float),
        onset_day=np.where(worn, rng.uniform(*ONSET_DAYS, arms).round(), 1e9),
        step=np.zeros(arms),
        per_day=np.where(worn, per_year / DAYS_A_YEAR, 0.0),
    )


# --- A plant of simulated arms on the bus: many arms in each session, each with its own keys, token and answers. I/O ---

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
        asked = request(model, key, document)
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
        disk = {"history_bytes": 0, "last_backup_at": None, "free_bytes": None, "sqlite": ""}
        process = {"resident_bytes": None, "cpu_s": 0.0, "threads": 1, "pid": 0, "pid_namespace": None}
        cursors = {"history_id": self.history_id(arm), "last_event": len(self.lives.transitions[arm]), "last_change": len(days)}
        return {
            **{"version": __version__, "programs": {}, "started_at": rfc3339(self._began_unix_s), "uptime_s": now - self._began_unix_s},
            **{"said_at": rfc3339(now), "troubles": [], "last_replay": last, "next_replay_due": None, "next_replay_why": None},
            **{"lag_s": None, "arm": {"heard": True}, "bus": {"to_send": 0, "to_answer": 0, "dropped": 0}},
            **{"store": disk | cursors, "process": process, "workers": {}, "reload": None},
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
        if question.stored_after is not None:  # no arm of these has tables
            return {"rows": [], "next": None, "history_id": self.history_id(arm)}
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
