"""Daemon: the loop. Due? Replay, assess, store, publish — it only moves messages; what they mean is judged elsewhere."""

import dataclasses
import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
import zenoh

from monitor import __version__
from monitor.assess import Assessment, Rejected, alert_document, assess
from monitor.config import Configuration
from monitor.errors import BadInput, MotionRefused, ReplayAborted, RobotUnreachable
from monitor.files import read_recording, write_recording
from monitor.judge.belief import Belief, belief_from_document
from monitor.judge.compensation import CompensatedModel, model_from_document
from monitor.judge.document import plain
from monitor.judge.health import Alert, Health, acknowledge, health_from_document, shelve
from monitor.model.fourier import Excitation
from monitor.production import Production, Sample
from monitor.publish.answers import torque_answer
from monitor.publish.bus import Answer, Bus
from monitor.publish.documents import AckRequest, ReplayRequest, ShelveRequest
from monitor.publish.metrics import MetricsServer
from monitor.publish.questions import MOST_EVENTS, events_after, history_question, request
from monitor.recording import Array, Context, Recording
from monitor.store import Event, LedgerRow, Store
from monitor.timestamps import outside, rfc3339

log = logging.getLogger(__name__)

Play = Callable[[Excitation, Context, Callable[[], bool]], Recording]
"""How a replay is had: excitation, context, should_stop → Recording. Raises MotionRefused, RobotUnreachable, ReplayAborted."""


class Daemon:
    """One robot's monitor: holds the state between replays and says it on the bus.

    The clock (UTC, seconds since 1970) and the way to have a recording come in by the door: the service hands in the
    host's clock and a replay over RTDE, a study hands in its own.
    """

    def __init__(self, configuration: Configuration, store: Store, *, now: Callable[[], float], play: Play) -> None:
        self.configuration = configuration
        self.stopping = threading.Event()
        self.present_temperature_c: Array | None = None  # (J,) newest known, from a replay or from listening
        self._store = store
        self._now = now
        self._play = play
        self._robot = configuration.model
        self._one_at_a_time = threading.Lock()
        self._belief: Belief | None = None
        self._health: Health | None = None
        self._model: CompensatedModel | None = None
        self._next_due_unix_s: float | None = None
        self.production = Production(configuration.assess.residual)  # what is heard between replays; of the listening thread
        self._judging = threading.Lock()  # health changes by a replay's verdict and by people's words, and by one at a time
        self.wanted: Callable[[], None] | None = None  # how a replay that somebody asks for is scheduled
        answers = {
            "torque": Answer("torque", self._answer_torque),
            "history": Answer("history", self._answer_history, payload=False),
            "event": Answer("events", self._answer_event, payload=False),
            "cmd/ack": Answer("answer", self._answer_ack),
            "cmd/shelve": Answer("answer", self._answer_shelve),
            "cmd/replay": Answer("answer", self._answer_replay),
        }
        self.bus = Bus(configuration.bus, configuration.key_prefix, answers)

    def __enter__(self) -> "Daemon":
        """Take up what the last run left: nothing is replayed, what was recorded is assessed, what was decided is said."""
        try:
            self._take_up()
        except BaseException:
            self.bus.close()  # a session left open would keep a failed daemon alive
            raise
        return self

    def _take_up(self) -> None:
        state = self._store.state()
        if state is not None:
            self._belief = belief_from_document(state.belief)
            self.production.continue_from(self._belief.usage)
            self._health = health_from_document(state.health)
            self._model = model_from_document(state.model)
        before = {row.id for row in self._store.ledger(states=("started",))}
        waiting = self._store.repair(self._now())
        for row in self._store.ledger(states=("aborted",)):
            if row.id in before:
                log.warning("replay=%d verdict=aborted reason=%r", row.id, row.reason)
        for row in waiting:
            self._assess_stored(row)
        self._say_everything()
        for event in self._store.events(unpublished=True):
            self._say_event(event)

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self.bus.close()

    @property
    def model(self) -> CompensatedModel | None:
        """What is known of the arm's torque now."""
        return self._model

    # --- one replay ------------------------------------------------------------------------------

    def perform(self, window_unix_s: float, kind: str = "scheduled") -> LedgerRow | None:
        """One window: claim it, replay, record, assess, publish; None where the ledger has it already.

        Never raises for what a robot may do: the ledger says how it ended, and why.
        """
        with self._one_at_a_time:
            ledger_id = self._store.claim(window_unix_s, kind, self._now())
            if ledger_id is None:
                return None
            self._perform(ledger_id)
            (row,) = self._store.ledger(limit=1)
            self.say_replay({"state": "ended", "replay": row.id, "verdict": row.state, "reason": row.reason})
            if row.state == "assessed" and self._health is not None:
                log.info("replay=%d verdict=assessed health=%s why=%r", row.id, self._health.state, self._health.why)
            else:
                log.warning("replay=%d verdict=%s reason=%r", row.id, row.state, row.reason)
            return row

    def skip(self, window_unix_s: float, reason: str) -> None:
        """Enter a window that was missed, so that it is seen and never made up for."""
        with self._one_at_a_time:
            ledger_id = self._store.claim(window_unix_s, "scheduled", self._now())
            if ledger_id is not None:
                self._store.end(ledger_id, "skipped", reason, self._now())
                log.warning("window=%.0f verdict=skipped reason=%r", window_unix_s, reason)

    def _perform(self, ledger_id: int) -> None:
        try:
            recording = self._play(self.configuration.excitation, self.configuration.context, self.stopping.is_set)
        except (MotionRefused, RobotUnreachable) as error:
            self._store.end(ledger_id, "skipped", str(error), self._now())
            return
        except ReplayAborted as error:
            stop = error.cause if error.needs_a_person else None
            self._store.end(ledger_id, "aborted", str(error), self._now(), stop=stop)
            return
        # the host's clock, not the controller's, dates a recording; a study's clock is its host's
        now = self._now()
        context = dataclasses.replace(recording.context, recorded_at_unix_s=now, revolutions=self.production.revolutions(now))
        recording = dataclasses.replace(recording, context=context)
        write_recording(self._store.recording_path(ledger_id), recording)
        self._store.recorded(ledger_id)
        self._assess(ledger_id, recording)

    def _assess_stored(self, row: LedgerRow) -> None:
        try:
            recording = read_recording(self._store.recording_path(row.id))
        except BadInput as error:
            self._store.end(row.id, "rejected", str(error), self._now())
            return
        self._assess(row.id, recording)

    def _assess(self, ledger_id: int, recording: Recording) -> None:
        with self._judging:
            self._assess_alone(ledger_id, recording)

    def _assess_alone(self, ledger_id: int, recording: Recording) -> None:
        configuration = self.configuration
        gains = configuration.robot.gains_nm_per_a
        try:
            outcome = assess(
                recording,
                robot=self._robot,
                mounting=configuration.mounting,
                belief=self._belief,
                health=self._health,
                gains=np.array(gains) if gains else None,
                settings=configuration.assess,
            )
        except BadInput as error:
            outcome = Rejected(str(error))
        except Exception as error:  # a fault of ours in one recording must not end the service, now and at every start
            log.exception("replay=%d cannot be assessed", ledger_id)
            outcome = Rejected(f"internal: {type(error).__name__}: {error}")
        if isinstance(outcome, Rejected):
            self._store.end(ledger_id, "rejected", outcome.reason, self._now())
            return
        events = self._store.commit(
            ledger_id,
            at_unix_s=self._now(),
            recorded_at_unix_s=recording.context.recorded_at_unix_s or self._now(),
            assessment=outcome.as_document(),
            friction=[plain(joint) for joint in outcome.friction],
            belief=outcome.belief.as_document(),
            health=outcome.health.as_document(),
            model=outcome.model.as_document(),
            events=[{"kind": transition.kind, **alert_document(transition.alert)} for transition in outcome.transitions],
        )
        self._hold(outcome)
        for joint in outcome.friction:
            self._say(f"joint/{joint.joint}/friction", "friction", plain(joint))
        self._say_state()
        for event in events:
            self._say_event(event)

    def _hold(self, outcome: Assessment) -> None:
        self._belief, self._health, self._model = outcome.belief, outcome.health, outcome.model
        if outcome.identification.temperature_c is not None:
            self.present_temperature_c = outcome.identification.temperature_c

    # --- what is said ----------------------------------------------------------------------------

    def next_due(self, unix_s: float | None) -> None:
        """When the schedule will replay next, for `health`."""
        self._next_due_unix_s = unix_s
        self.say_health()

    def say_health(self) -> None:
        """Overall and per-joint state; also while nothing is known yet."""
        document = {"state": None, "joints": [], "alerts": []} if self._health is None else self._health.as_document()
        self._say("health", "health", {**document, "next_replay_due_unix_s": self._next_due_unix_s, "said_at_unix_s": self._now()})

    def say_replay(self, document: dict[str, Any]) -> None:
        """What is going to happen to the arm, or has: for the cell's own programs."""
        self._say("replay", "replay", {**document, "said_at_unix_s": self._now()})

    def say_live(self, document: dict[str, Any]) -> None:
        """One sample of predicted against measured torque."""
        self.bus.stream("torque/live", "torque-live", document)

    def _say(self, key: str, kind: str, document: dict[str, Any], *, done: Callable[[], None] | None = None) -> None:
        told = outside(document)
        assert isinstance(told, dict)
        self.bus.publish(key, kind, told, done=done)

    def _say_state(self) -> None:
        self.say_health()
        if self._model is not None:
            self._say("model", "model", self._model.as_document())
        for alert in self._health.alerts if self._health else ():
            self._say_alert(alert)

    def _say_alert(self, alert: Alert) -> None:
        place = "arm" if alert.joint is None else f"j{alert.joint}"
        self._say(f"alert/{place}/{alert.condition}", "alert", alert_document(alert))

    def _say_event(self, event: Event) -> None:
        self.bus.event(_event_document(event), done=lambda: self._store.published(event.seq))

    def _say_everything(self) -> None:
        configuration = self.configuration
        info = {
            "robot": dataclasses.asdict(configuration.robot),
            "version": __version__,
            "host": socket.gethostname(),
            "trajectory_digest": configuration.excitation.digest,
            "started_at_unix_s": self._now(),
        }
        self._say("info", "info", info)
        newest = self._store.friction(limit=self._robot.joints)
        for document in newest:
            self._say(f"joint/{document['joint']}/friction", "friction", {key: value for key, value in document.items() if key != "replay"})
        self._say_state()

    # --- what is asked ---------------------------------------------------------------------------

    def _answer_torque(self, request: Any) -> dict[str, Any]:
        if self._model is None:
            raise BadInput("torque: there is no model yet; it comes with the first replay that is assessed")
        return torque_answer(self._model, self._robot, self.present_temperature_c, request)

    def _answer_history(self, parameters: Any) -> dict[str, Any]:
        asked = history_question(parameters, self._robot.joints)
        rows, following = self._store.history(
            joint=asked.joint, from_unix_s=asked.from_unix_s, to_unix_s=asked.to_unix_s, after=asked.after, limit=asked.limit
        )
        return {"rows": outside(rows), "next": following}

    def _answer_event(self, parameters: Any) -> dict[str, Any]:
        after = events_after(parameters)
        kept = self._store.event_range()
        events = [_event_document(event) for event in self._store.events(after=after, limit=MOST_EVENTS)]
        return {"events": events, "first_kept": kept[0] if kept else None, "last": kept[1] if kept else None}

    def _answer_ack(self, payload: Any) -> dict[str, Any]:
        asked = request(AckRequest, "cmd/ack", payload)

        def change(health: Health, at: float) -> Health:
            return acknowledge(health, asked.joint, asked.condition, by=asked.by, why=asked.why, at_unix_s=at)

        return self._revised("acknowledged", asked, change)

    def _answer_shelve(self, payload: Any) -> dict[str, Any]:
        asked = request(ShelveRequest, "cmd/shelve", payload)

        def change(health: Health, at: float) -> Health:
            until = at + 3600.0 * asked.hours
            return shelve(health, asked.joint, asked.condition, by=asked.by, why=asked.why, until_unix_s=until, at_unix_s=at)

        return self._revised("shelved", asked, change)

    def _revised(self, kind: str, asked: AckRequest, change: Callable[[Health, float], Health]) -> dict[str, Any]:
        """What a person did to an alert: durable first, then said. Raises BadInput where there is no such active alert."""
        with self._judging:
            at = self._now()
            if self._health is None:
                raise BadInput(f"cmd: no alert can be {kind}: no replay has been assessed yet")
            health = change(self._health, at)
            alert = next(alert for alert in health.alerts if alert.key == (asked.joint, asked.condition) and alert.active)
            events = self._store.revise(health.as_document(), [{"kind": kind, **alert_document(alert)}], at)
            self._health = health
            self._say_alert(alert)
            self.say_health()
            for event in events:
                self._say_event(event)
        log.info("alert=%s/%s %s by=%r why=%r", asked.joint or "arm", asked.condition, kind, asked.by, asked.why)
        return {"done": kind, "alert": outside(alert_document(alert))}

    def _answer_replay(self, payload: Any) -> dict[str, Any]:
        asked = request(ReplayRequest, "cmd/replay", payload)
        if self.configuration.replay.allow_motion is not True:
            raise BadInput("cmd/replay: refused: motion is not allowed here (allow_motion is false)")
        if self.wanted is None:
            raise BadInput("cmd/replay: refused: this monitor schedules no replays")
        if self._one_at_a_time.locked():
            raise BadInput("cmd/replay: refused: a replay is under way")
        self.wanted()
        log.info("replay wanted by=%r why=%r", asked.by, asked.why)
        return {"done": "accepted"}

    def live(self, q: Array, qd: Array, qdd: Array, current: Array, temperature_c: Array) -> None:
        """Say predicted against measured torque of the arm's present motion; all (J,)."""
        self.present_temperature_c = temperature_c
        dt_s = self.production.moved(self._now(), qd)
        if self._model is None:
            return
        gains = np.array(self.configuration.robot.gains_nm_per_a or self._robot.drive_gain_nm_per_a)
        predicted = self._model.torque(self._robot, q[None], qd[None], qdd[None], temperature_c[None])
        measured = current * gains
        known = bool(np.all(np.isfinite(measured)))
        if not self._one_at_a_time.locked():  # a replay speaks for itself
            self.production.worked(self._model, predicted, Sample(self._now(), qd, qdd, measured), dt_s)
            self._pull_forward()
        self.say_live(
            {
                "at": rfc3339(self._now()),
                "q_rad": q.tolist(),
                "qd_rad_s": qd.tolist(),
                "temperature_c": temperature_c.tolist(),
                "predicted_nm": predicted.torque[0].tolist(),
                "std_nm": predicted.std[0].tolist(),
                "measured_nm": measured.tolist() if known else None,
                "residual_nm": (measured - predicted.torque[0]).tolist() if known else None,
                "extrapolated": predicted.extrapolated[0].tolist(),
                "model_revision": self._model.revision,
            }
        )

    def _pull_forward(self) -> None:
        """Ask for a replay where work says that friction has risen; permission, windows and the guard decide as for any other."""
        why = self.production.pull_forward() if self.wanted is not None else None
        if why is not None and self.configuration.replay.allow_motion is True and self.wanted is not None:
            log.info("replay pulled forward: %s", why)
            self.wanted()


def _event_document(event: Event) -> dict[str, Any]:
    told = outside({"seq": event.seq, "at_unix_s": event.at_unix_s, **event.document})
    assert isinstance(told, dict)
    return told


def serve(configuration: Configuration, *, replay_now: bool = False) -> None:
    """Run until SIGTERM or SIGINT. A moving arm is stopped first.

    `replay_now` asks for one replay at the start, whatever the schedule says.

    Raises StoreError or BusError where the daemon cannot start.
    """
    from apscheduler.events import EVENT_JOB_MISSED
    from apscheduler.executors.pool import ThreadPoolExecutor
    from apscheduler.schedulers.background import BackgroundScheduler
    from apscheduler.triggers.cron import CronTrigger

    from monitor.acquire.listen import Listener, ListenSettings
    from monitor.motion import move

    # whom Zenoh did not let in is told in the journal
    zenoh.init_log_from_env_or("warn,zenoh::net::routing::interceptor=info")
    with ExitStack() as stack:
        store = stack.enter_context(Store.open(configuration.state_directory))

        def play(excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
            (row,) = store.ledger(limit=1)
            return move(
                configuration,
                store,
                excitation,
                context,
                should_stop=should_stop,
                first_pass_path=store.first_pass_path(row.id),
                ask=daemon.bus.ask_permit,
                announce=lambda about: daemon.say_replay({"state": "announced", "replay": row.id, **about}),
                model=daemon.model,
            )

        daemon = stack.enter_context(Daemon(configuration, store, now=time.time, play=play))
        if configuration.metrics.listen:
            stack.enter_context(MetricsServer(configuration.metrics, daemon.bus.last_values))
        for number in (signal.SIGTERM, signal.SIGINT):
            # from another thread: the main one may hold the event's own lock at the moment of the signal
            signal.signal(number, lambda *_: threading.Thread(target=daemon.stopping.set, daemon=True).start())

        # one worker that lives as long as the scheduler: a replay's child must not outlive the thread that started it
        scheduler = BackgroundScheduler(timezone="UTC", executors={"default": ThreadPoolExecutor(1)})
        trigger = CronTrigger.from_crontab(configuration.schedule.cron, timezone="UTC")

        def window() -> None:
            # the job may run late by up to the grace: its window is the last one at or before now
            daemon.perform(_last_fire(trigger, time.time(), configuration.schedule.grace_s))
            due = job.next_run_time
            daemon.next_due(due.timestamp() if due else None)

        job = scheduler.add_job(
            window, trigger, id="replay", coalesce=True, max_instances=1, misfire_grace_time=int(configuration.schedule.grace_s)
        )
        scheduler.add_listener(
            lambda event: daemon.skip(event.scheduled_run_time.timestamp(), "missed: the monitor or its host was not running"),
            EVENT_JOB_MISSED,
        )

        def wanted() -> None:
            scheduler.add_job(lambda: daemon.perform(time.time(), "requested"), id="wanted", misfire_grace_time=None, replace_existing=True)

        daemon.wanted = wanted
        if replay_now:
            wanted()
        scheduler.start()
        stack.callback(scheduler.shutdown, wait=True)
        daemon.next_due(job.next_run_time.timestamp())

        listener = Listener(ListenSettings(host=configuration.robot.host, rate_hz=max(1.0, configuration.bus.live_rate_hz)))
        listener.start()
        stack.callback(listener.stop)
        notify("READY=1")
        log.info("watching robot=%s host=%s next=%s", configuration.robot.id, configuration.robot.host, job.next_run_time)
        stack.callback(notify, "STOPPING=1")
        _listen(daemon, listener)
        log.info("stopping")


def _last_fire(trigger: Any, now_unix_s: float, grace_s: float) -> float:
    """The newest window of a schedule at or before now; now itself where there was none within the grace."""
    from datetime import UTC, datetime, timedelta

    now = datetime.fromtimestamp(now_unix_s, tz=UTC)
    at = trigger.get_next_fire_time(None, now - timedelta(seconds=grace_s + 1.0))
    newest = None
    while at is not None and at <= now:
        newest = at
        at = trigger.get_next_fire_time(at, at + timedelta(microseconds=1))
    return newest.timestamp() if newest is not None else now_unix_s


def _listen(daemon: Daemon, listener: Any) -> None:
    """Main loop: live predictions from what is heard; one line when the arm is lost, one when it is back."""
    said_health = time.monotonic()
    trouble: str | None = None
    while not daemon.stopping.wait(0.5 / daemon.configuration.bus.live_rate_hz):
        fresh = listener.poll()
        if fresh:
            state = fresh[-1]
            daemon.live(state.q, state.qd, state.target_qdd, state.current, state.temperature_c)
        daemon.bus.robot_alive(listener.reachable)
        if listener.trouble != trouble:
            if listener.trouble is None:
                log.info("robot=%s heard again", daemon.configuration.robot.id)
            elif trouble is None:
                log.warning("robot=%s cannot be heard: %s", daemon.configuration.robot.id, listener.trouble)
            trouble = listener.trouble
        if time.monotonic() - said_health >= daemon.configuration.bus.health_period_s:
            said_health = time.monotonic()
            daemon.say_health()


def notify(message: str) -> None:
    """Tell the service manager, where there is one (sd_notify(3))."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)
