"""Daemon: the loop. Due? Replay, assess, store, publish — it only moves messages; what they mean is judged elsewhere."""

import dataclasses
import importlib
import logging
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from monitor.acquire.state import ROBOT_MODE_RUNNING
from monitor.assess import Rejected
from monitor.config.load import Configuration, load
from monitor.config.reload import reloaded
from monitor.errors import BadConfiguration, BadInput, MotionRefused, ReplayAborted, RobotUnreachable, StoreError, StoreUnavailable
from monitor.judge.alerts.conditions import CONDITIONS, STORE_RESTORED
from monitor.judge.alerts.documents import alert_document
from monitor.judge.alerts.health import Alert, Health
from monitor.judge.alerts.life_cycle import acknowledge, service_alert, shelve
from monitor.judge.alerts.staleness import stale_joints
from monitor.judge.document import plain
from monitor.judge.torque.compensated_model import CompensatedModel
from monitor.model.fourier import Excitation
from monitor.publish.bus import Bus, handler
from monitor.publish.documents import AckRequest, ReplayRequest, ShelveRequest
from monitor.publish.health_document import health_told
from monitor.publish.live_torque import LiveTorque
from monitor.publish.metrics import MetricsServer
from monitor.publish.queries import MOST_EVENTS, events_after, history_question, request
from monitor.publish.session import log_refusals
from monitor.publish.timestamps import outside, rfc3339
from monitor.publish.torque_query import torque_answer
from monitor.recording import Array, Context, Recording
from monitor.service.assess_and_store import EstimatorState, adopt_orphans, assess_stored, load_state, state_after
from monitor.service.info import info
from monitor.service.maintenance import Maintenance
from monitor.service.page import page
from monitor.service.problems import Problems
from monitor.service.production import Production, Sample
from monitor.service.recompute import roll_back
from monitor.service.scheduler import Scheduler
from monitor.service.systemd import Heartbeats, Watchdog, notify, reloading
from monitor.store.events import AlertEvent
from monitor.store.ledger import LedgerRow
from monitor.store.recordings import read_recording, write_recording
from monitor.store.store import RESTORED, Store

log = logging.getLogger(__name__)

LONGEST_PAUSE_S = 0.5  # the main loop's: the link to the arm is looked at so often, however seldom its torque is told
AT_START = 3  # recordings that wait are assessed before the service is ready; more of them, after a restored history, in peace
WAIT_FOR_DISK_S = 5.0
PATIENCE_S = 90.0  # with a worker that does not say it is alive: an upload, a permit, an assessment on a busy machine are shorter
MONITOR_PERIOD_S = 10.0

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
        self._robot = configuration.robot_description
        self._started_at_unix_s = now()
        self._one_at_a_time = threading.Lock()
        self._held = EstimatorState()
        self._live: LiveTorque | None = None
        self._next_due_unix_s: float | None = None
        self.production = Production(configuration.assess.residual)  # what is heard between replays
        self._judging = threading.Lock()  # health changes by a replay's verdict and by people's words, and by one at a time
        self.restored: str | None = None  # what became of a damaged history, until the alert of it is raised
        self.wanted: Callable[[], None] | None = None  # how a replay that somebody asks for is scheduled
        self.pull_forward: Callable[[float], None] | None = None  # production looked odd at that time: the next replay may come sooner
        self.on_busy: Callable[[], None] | None = None  # told often while a replay is under way, or its assessment
        answers = {
            "torque": self._answer_torque,
            "history": self._answer_history,
            "event": self._answer_event,
            "cmd/ack": self._answer_ack,
            "cmd/shelve": self._answer_shelve,
            "cmd/replay": self._answer_replay,
        }
        self.bus = Bus(configuration.bus, configuration.key_prefix, {key: handler(key, about) for key, about in answers.items()})

    def __enter__(self) -> "Daemon":
        """Take up what the last run left: nothing is replayed, what was recorded is assessed, what was decided is said."""
        try:
            self._take_up()
        except BaseException:
            self.bus.close()  # a session left open would keep a failed daemon alive
            raise
        return self

    def _take_up(self) -> None:
        self._held = load_state(self._store)
        self._prepare_live(self._last_recording())
        if self._held.belief is not None:
            self.production.continue_from(self._held.belief.usage)
        restored = self._store.restored
        if restored is not None:
            log.error("%s", restored.told)
        self.restored = self._store.notes.get(RESTORED) or None
        if self.restored is not None:  # also where the last start ended in the middle of it
            adopted = adopt_orphans(self._store, self._now())
            if adopted:
                log.warning("%d recordings that the restored history does not know wait for their assessment", adopted)
        try:
            self.recover(at_most=AT_START)
            self._tell_restored()
        except StoreUnavailable as error:  # the schedule's thread tries again, and tells it
            log.warning("what the last run left half-way is finished later: %s", error)
        self._say_everything()
        for event in self._store.events.rows(unpublished=True):
            self._say_event(event)

    def recover(self, at_most: int | None = None) -> None:
        """Finish what a crash, or a disk that took no more, left half-way: aborted, or assessed now. Raises StoreError."""
        with self._one_at_a_time:
            before = {row.id for row in self._store.ledger.rows(states=("started",))}
            waiting = self._store.ledger.repair(self._now())
            for row in self._store.ledger.rows(states=("aborted",), limit=len(before) + 1) if before else ():
                if row.id in before:
                    log.warning("replay=%d verdict=aborted reason=%r", row.id, row.reason, extra={"replay": row.id, "verdict": "aborted"})
            for row in waiting[:at_most]:
                self._assess_stored(row.id)
                self.busy()

    def roll_back(self) -> bool:
        """Take back what was learnt in a future that a wrong clock made up; False where the recordings to do so are gone."""
        with self._one_at_a_time, self._judging:
            known = roll_back(self._store, self._now())
            if known is not None:
                self._held = known
                self._prepare_live(self._last_recording())
        if known is not None:
            self._say_everything()
        return known is not None

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self.bus.close()

    def busy(self) -> None:
        """Whoever works through this daemon is alive; the service hands in who is told."""
        if self.on_busy is not None:
            self.on_busy()

    def _should_stop(self) -> bool:
        self.busy()
        return self.stopping.is_set()

    @property
    def torque_model(self) -> CompensatedModel | None:
        """What is known of the arm's torque now."""
        return self._held.model

    @property
    def health_state(self) -> str | None:
        """NE 107 state of the arm, with STALE where it is too old; None until a replay has been assessed."""
        health = self._health  # one read: a replay may put another in its place meanwhile
        if health is None:
            return None
        return f"{health.state} (STALE)" if any(stale_joints(health, self._now(), self.configuration.assess.health)) else health.state

    @property
    def _health(self) -> Health | None:
        return self._held.health

    @_health.setter
    def _health(self, health: Health) -> None:
        self._held = dataclasses.replace(self._held, health=health)

    @property
    def _model(self) -> CompensatedModel | None:
        return self._held.model

    def reconfigured(self, configuration: Configuration) -> None:
        """Other settings from now on, and `info` says so."""
        self.configuration = configuration
        self.production.use(configuration.assess.residual)
        with self._judging:
            self._prepare_live(self._last_recording())
        self._say_info()
        self.say_health()

    # --- one replay ------------------------------------------------------------------------------

    def perform(self, window_unix_s: float, kind: str = "scheduled") -> LedgerRow | None:
        """One window: claim it, replay, record, assess, publish; None where the ledger has it already.

        Never raises for what a robot may do: the ledger says how it ended, and why.
        """
        with self._one_at_a_time:
            ledger_id = self._store.ledger.claim(window_unix_s, kind, self._now())
            if ledger_id is None:
                return None
            for waiting in self._store.ledger.repair(self._now(), but=ledger_id):
                self._assess_stored(waiting.id)  # in time order: an older one could not be learnt from afterwards
            self._perform(ledger_id)
            row = self._store.ledger.row(ledger_id)
            self.say_replay({"state": "ended", "replay": row.id, "verdict": row.state, "reason": row.reason})
            if row.state == "assessed" and self._health is not None:
                state, why = self._health.state, self._health.why
                log.info("replay=%d verdict=assessed health=%s why=%r", row.id, state, why, extra={"replay": row.id, "verdict": "assessed"})
            else:
                told = {"replay": row.id, "verdict": row.state}
                log.warning("replay=%d verdict=%s reason=%r", row.id, row.state, row.reason, extra=told)
            return row

    def skip(self, window_unix_s: float, reason: str, kind: str = "scheduled") -> None:
        """Enter a window that was missed, so that it is seen and never made up for."""
        with self._one_at_a_time:
            ledger_id = self._store.ledger.claim(window_unix_s, kind, self._now())
            if ledger_id is not None:
                self._store.ledger.end(ledger_id, "skipped", reason, self._now())
                log.warning("window=%.0f verdict=skipped reason=%r", window_unix_s, reason)

    def _perform(self, ledger_id: int) -> None:
        try:
            recording = self._play(self.configuration.excitation, self.configuration.context, self._should_stop)
        except (MotionRefused, RobotUnreachable) as error:
            self._store.ledger.end(ledger_id, "skipped", str(error), self._now())
            return
        except ReplayAborted as error:
            stop = error.cause if error.needs_a_person else None
            self._store.ledger.end(ledger_id, "aborted", str(error), self._now(), stop=stop)
            return
        except Exception as error:  # a fault of ours: the child is dead and the arm was stopped; the window is told as ended, and by what
            log.exception("replay=%d ended by a fault of the monitor's own", ledger_id)
            self._store.ledger.end(ledger_id, "aborted", f"internal: {type(error).__name__}: {error}", self._now(), stop="internal")
            return
        # the host's clock, not the controller's, dates a recording; a study's clock is its host's
        now = self._now()
        context = dataclasses.replace(recording.context, recorded_at_unix_s=now, revolutions=self.production.revolutions(now))
        recording = dataclasses.replace(recording, context=context)
        path = self._store.recordings.path(ledger_id)
        try:
            write_recording(path, dataclasses.replace(recording, source=path.name))
        except StoreError as error:
            self._store.ledger.end(ledger_id, "aborted", str(error), self._now())
            return
        self._store.ledger.mark_recorded(ledger_id)
        self._assess_stored(ledger_id)  # what was written, not what was measured: so a recomputation sees the very same

    def _assess_stored(self, ledger_id: int) -> None:
        with self._judging:
            entered = assess_stored(self._store, self.configuration, self._held, ledger_id, self._now)
            if isinstance(entered.outcome, Rejected):
                return
            known = self._held.belief.context if self._held.belief else None
            self._held = state_after(self._held, entered)
            self._prepare_live(entered.recording)
        self.busy()
        if entered.outcome.identification.temperature_c is not None:
            self.present_temperature_c = entered.outcome.identification.temperature_c
        context = entered.outcome.belief.context
        if known is None or (known.serial, known.firmware) != (context.serial, context.firmware):
            self._say_info()
        for joint in entered.outcome.friction:
            self._say("friction", plain(joint), joint=joint.joint)
        self._say_state()
        for event in entered.events:
            self._say_event(event)

    def _prepare_live(self, recording: Recording | None) -> None:
        """Beforehand, for the model that is held now and the replay it was learnt from last: nobody who asks waits for it."""
        if self._held.model is not None:
            self._live = LiveTorque(self._held.model, self._robot, self.configuration.gains_nm_per_a, recording)

    def _last_recording(self) -> Recording | None:
        """Of the last replay that was assessed; None where it is kept no longer."""
        assessed = self._store.ledger.rows(states=("assessed",), limit=1)
        try:
            return read_recording(self._store.recordings.path(assessed[0].id)) if assessed else None
        except BadInput as error:
            log.warning("live torque: its noise is not known until the next replay: %s", error)
            return None

    # --- what is said ----------------------------------------------------------------------------

    def next_due(self, unix_s: float | None) -> None:
        """When the schedule will replay next, for `health`."""
        self._next_due_unix_s = unix_s
        self.say_health()

    def say_health(self) -> None:
        """Overall and per-joint state, and whether it is too old; also while nothing is known yet."""
        now = self._now()
        self._say(
            "health",
            {
                **health_told(self._health, now, self.configuration.assess.health),
                "production": [plain(each) for each in self.production.evidence()],
                "next_replay_due_unix_s": self._next_due_unix_s,
                "said_at_unix_s": now,
            },
        )

    def say_monitor(self, document: dict[str, Any], *, done: Callable[[], None] | None = None) -> None:
        """How the monitor itself is."""
        self._say("monitor", document, done=done)

    def say_replay(self, document: dict[str, Any]) -> None:
        """What is going to happen to the arm, or has: for the cell's own programs."""
        self._say("replay", {**document, "said_at_unix_s": self._now()})

    def say_live(self, document: dict[str, Any]) -> None:
        """One sample of predicted against measured torque."""
        self.bus.say("torque-live", document)

    def _say(self, kind: str, document: dict[str, Any], *, done: Callable[[], None] | None = None, **parts: Any) -> None:
        told = outside(document)
        assert isinstance(told, dict)
        self.bus.say(kind, told, done=done, **parts)

    def _say_state(self) -> None:
        self.say_health()
        if self._model is not None:
            self._say("model", self._model.as_document())
        for alert in self._health.alerts if self._health else ():
            self._say_alert(alert)

    def _say_alert(self, alert: Alert) -> None:
        place = "arm" if alert.joint is None else f"j{alert.joint}"
        self._say("alert", alert_document(alert), where=place, condition=alert.condition)

    def _say_event(self, event: AlertEvent) -> None:
        self.bus.say("event", _event_document(event), done=lambda: self._store.events.mark_published(event.seq))

    def _say_info(self) -> None:
        context = self._held.belief.context if self._held.belief else None
        self._say("info", info(self.configuration, started_at_unix_s=self._started_at_unix_s, context=context))

    def _say_everything(self) -> None:
        self._say_info()
        newest = self._store.assessments.friction(limit=self._robot.joints)
        for document in newest:
            self._say("friction", joint=document["joint"], document={key: value for key, value in document.items() if key != "replay"})
        self._say_state()

    # --- what is asked ---------------------------------------------------------------------------

    def _answer_torque(self, request: Any) -> dict[str, Any]:
        model = self._model  # one read: a replay may put another in its place meanwhile
        if model is None:
            raise BadInput("torque: there is no model yet; it comes with the first replay that is assessed")
        return torque_answer(model, self._robot, self.present_temperature_c, request)

    def _answer_history(self, parameters: Any) -> dict[str, Any]:
        asked = history_question(parameters, self._robot.joints)
        rows, following = self._store.assessments.history(
            joint=asked.joint, from_unix_s=asked.from_unix_s, to_unix_s=asked.to_unix_s, after=asked.after, limit=asked.limit
        )
        for row in rows:  # their one time; five years of them are asked for at once
            row["recorded_at"] = rfc3339(row.pop("recorded_at_unix_s"))
        return {"rows": rows, "next": following}

    def _answer_event(self, parameters: Any) -> dict[str, Any]:
        after = events_after(parameters)
        kept = self._store.events.range()
        events = [_event_document(event) for event in self._store.events.rows(after=after, limit=MOST_EVENTS)]
        return {"events": events, "first_kept": kept[0] if kept else None, "last": kept[1] if kept else None}

    def _answer_ack(self, payload: Any) -> dict[str, Any]:
        asked = request(AckRequest, payload)

        def change(health: Health, at: float) -> Health:
            return acknowledge(health, asked.joint, asked.condition, by=asked.by, why=asked.why, at_unix_s=at)

        return self._revised("acknowledged", asked, change)

    def _answer_shelve(self, payload: Any) -> dict[str, Any]:
        asked = request(ShelveRequest, payload)

        def change(health: Health, at: float) -> Health:
            until = at + 3600.0 * asked.hours
            return shelve(health, asked.joint, asked.condition, by=asked.by, why=asked.why, until_unix_s=until, at_unix_s=at)

        return self._revised("shelved", asked, change)

    def _revised(self, kind: str, asked: AckRequest, change: Callable[[Health, float], Health]) -> dict[str, Any]:
        """What a person did to an alert. Raises BadInput where there is no such active alert."""
        with self._judging:
            at = self._now()
            if self._health is None:
                raise BadInput(f"cmd: no alert can be {kind}: no replay has been assessed yet")
            health = change(self._health, at)
            alert = next(alert for alert in health.alerts if alert.key == (asked.joint, asked.condition) and alert.active)
            self._keep(health, kind, alert, at)
        log.info("alert=%s/%s %s by=%r why=%r", asked.joint or "arm", asked.condition, kind, asked.by, asked.why)
        return {"done": kind, "alert": outside(alert_document(alert))}

    def _raise_own(self, condition: str, text: str) -> None:
        """An alert of the arm that the monitor raises about itself; kept by the judge, and cleared once it has been acknowledged."""
        with self._judging:
            at = self._now()
            self._revise_own("raised", service_alert(CONDITIONS[condition], text, at), at)

    def _tell_restored(self) -> None:
        """Raise what became of a damaged history, as soon as there is a verdict beside which it can stand."""
        if self.restored is None or self._health is None:
            return
        if all(alert.condition != STORE_RESTORED for alert in self._health.active_alerts):  # a crash may have come before the note
            self._raise_own(STORE_RESTORED, self.restored)
        self._store.notes.set(RESTORED, "")
        self.restored = None

    def clear_own(self) -> None:
        """What the monitor raised about itself is over once a person has seen it."""
        self._tell_restored()
        with self._judging:
            at = self._now()
            raised_by_service = {name for name, condition in CONDITIONS.items() if condition.raised_by_service}
            for alert in self._health.active_alerts if self._health else ():
                if alert.condition in raised_by_service and alert.acknowledged_at_unix_s is not None:
                    self._revise_own("cleared", dataclasses.replace(alert, cleared_at_unix_s=at, updated_at_unix_s=at), at)

    def _revise_own(self, kind: str, alert: Alert, at: float) -> None:
        assert self._health is not None
        others = tuple(other for other in self._health.alerts if other.key != alert.key)
        self._keep(dataclasses.replace(self._health, alerts=(*others, alert)), kind, alert, at)

    def _keep(self, health: Health, kind: str, alert: Alert, at: float) -> None:
        """What became of an alert without a replay: durable first, then said."""
        events = self._store.events.revise(health.as_document(), [{"kind": kind, **alert_document(alert)}], at)
        self._health = health
        self._say_alert(alert)
        self.say_health()
        for event in events:
            self._say_event(event)

    def _answer_replay(self, payload: Any) -> dict[str, Any]:
        asked = request(ReplayRequest, payload)
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
        now, live = self._now(), self._live
        dt_s = self.production.moved(now, qd)
        if live is None:
            return
        predicted, measured = live.compared(q, qd, qdd, current, temperature_c)
        if not self._one_at_a_time.locked():  # a replay speaks for itself
            self.production.worked(live.model, predicted, Sample(now, qd, qdd, measured), dt_s)
            self._look_forward(now)
        self.say_live({"at": rfc3339(now), **live.document(q, qd, temperature_c, predicted, measured)})

    def _look_forward(self, now: float) -> None:
        """Where work says that friction has risen, the next replay may come sooner: windows, permission, guard decide as for any other."""
        why = None if self.pull_forward is None else self.production.pull_forward()
        if why is not None and self.pull_forward is not None and self.configuration.replay.allow_motion is True:
            log.info("evidence for an earlier replay: %s", why)
            self.pull_forward(now)


def _event_document(event: AlertEvent) -> dict[str, Any]:
    told = outside({"seq": event.seq, "at_unix_s": event.at_unix_s, **event.document})
    assert isinstance(told, dict)
    return told


def serve(configuration: Configuration, *, replay_now: bool = False) -> None:
    """Run until SIGTERM or SIGINT; SIGHUP reads the configuration again. A moving arm is stopped first.

    `replay_now` asks for one replay at the start, whatever the schedule says.

    Raises StoreError or BusError where the daemon cannot start, StoreError where the history was found damaged while it ran.
    """
    from monitor.acquire.listen import Listener, ListenSettings
    from monitor.service.motion import move

    log_refusals(configuration.bus)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # until there is something that could be reloaded
    for heavy in ("filterpy.kalman", "scipy.signal"):  # now, and not while somebody waits for the first verdict
        importlib.import_module(heavy)
    with ExitStack() as stack:
        store = _opened(configuration.state_directory, stack)

        def play(excitation: Excitation, context: Context, should_stop: Callable[[], bool]) -> Recording:
            (row,) = store.ledger.rows(limit=1)
            return move(
                daemon.configuration,
                store,
                excitation,
                context,
                should_stop=should_stop,
                first_pass_path=store.recordings.first_pass_path(row.id),
                ask=daemon.bus.ask_permit,
                announce=lambda about: daemon.say_replay({"state": "announced", "replay": row.id, **about}),
                model=daemon.torque_model,
            )

        daemon = stack.enter_context(Daemon(configuration, store, now=time.time, play=play))
        if configuration.metrics.listen:
            stack.enter_context(MetricsServer(configuration.metrics, daemon.bus.last_values))
        stack.enter_context(page(configuration, daemon.bus, store))
        hangup = threading.Event()
        for number, event in ((signal.SIGTERM, daemon.stopping), (signal.SIGINT, daemon.stopping), (signal.SIGHUP, hangup)):
            # from another thread: the main one may hold the event's own lock at the moment of the signal
            signal.signal(number, lambda *_, event=event: threading.Thread(target=event.set, daemon=True).start())

        heartbeats, problems = Heartbeats(), Problems(time.time)
        heartbeats.beat("bus", PATIENCE_S)  # one that never sends its first document is missed as well
        scheduler = Scheduler(daemon, store, problems)
        maintenance = Maintenance(store, lambda: daemon.configuration.store, problems, time.time)
        daemon.wanted, daemon.pull_forward = scheduler.want, scheduler.evidence
        daemon.on_busy = lambda: heartbeats.beat("replays", PATIENCE_S)
        if replay_now:
            scheduler.want()
        workers = [
            # one thread that lives as long as the service: a replay's child must not outlive the thread that started it
            threading.Thread(target=scheduler.run, args=(daemon.stopping, daemon.busy), name="replays"),
            threading.Thread(
                target=maintenance.run, args=(daemon.stopping, lambda: heartbeats.beat("upkeep", 10 * PATIENCE_S)), name="upkeep"
            ),
        ]
        for worker in workers:
            worker.start()
            stack.callback(worker.join)
        stack.callback(daemon.stopping.set)

        listener = Listener(
            ListenSettings(host=configuration.robot.host, rate_hz=max(configuration.robot.listen_hz, configuration.bus.live_rate_hz))
        )
        listener.start()
        stack.callback(listener.stop)
        notify("READY=1")
        upcoming = scheduler.coming(1)
        following = rfc3339(upcoming[0].opens_unix_s) if upcoming else "never"
        log.info("watching robot=%s host=%s next=%s", configuration.robot.id, configuration.robot.host, following)
        stack.callback(notify, "STOPPING=1\nSTATUS=stopping")
        _watch(daemon, listener, scheduler, maintenance, problems, heartbeats, hangup)
        log.info("stopping")
        if maintenance.damaged is not None:
            raise StoreError(f"{store.directory}: the history was found damaged: {maintenance.damaged}; the next start restores it")


def _opened(directory: Path, stack: ExitStack) -> Store:
    """The history, as soon as its disk takes it: full or read-only, it is waited for and told, since nobody may be there to start us again.

    Raises StoreError where waiting would change nothing.
    """
    watchdog, told = Watchdog(Heartbeats()), ""
    while True:
        try:
            return stack.enter_context(Store.open(directory))
        except StoreUnavailable as error:
            if str(error) != told:
                told = str(error)
                log.error("trouble=store: %s; waiting for it", told, extra={"trouble": "store"})
            notify(f"READY=1\nSTATUS=waiting for the history, nothing is watched: {told}")
            for _ in range(int(WAIT_FOR_DISK_S)):
                watchdog.look()
                time.sleep(1.0)


def _watch(
    daemon: Daemon,
    listener: Any,
    scheduler: Scheduler,
    maintenance: Maintenance,
    problems: Problems,
    heartbeats: Heartbeats,
    hangup: threading.Event,
) -> None:
    """Main loop: live predictions from what is heard; how the arm and the monitor are; the watchdog, while everybody is alive."""
    watchdog = Watchdog(heartbeats)
    said_health = said_monitor = live_due = 0.0
    while not daemon.stopping.wait(min(0.5 / daemon.configuration.bus.live_rate_hz, LONGEST_PAUSE_S)) and maintenance.damaged is None:
        period_s = 1.0 / daemon.configuration.bus.live_rate_hz
        fresh = listener.poll()
        if fresh and (now := time.monotonic()) >= live_due - 0.25 * period_s:  # a row may come a little early, and is not left out for it
            live_due = max(live_due + period_s, now)
            state = fresh[-1]
            daemon.live(state.q, state.qd, state.target_qdd, state.current, state.temperature_c)
        daemon.bus.robot_alive(listener.reachable)
        state = listener.latest()
        scheduler.heard(
            listener.reachable and state is not None and state.robot_mode == ROBOT_MODE_RUNNING,
            None if state is None or not listener.reachable else tuple(state.temperature_c.tolist()),
        )
        problems.said("arm", listener.problem)
        problems.said("restored", daemon.restored)
        if hangup.is_set():
            hangup.clear()
            reload(daemon, scheduler, maintenance)
        now = time.monotonic()
        if now - said_health >= daemon.configuration.bus.health_period_s or not said_health:
            said_health = now
            try:
                daemon.clear_own()
            except StoreError as error:  # the next round tries again
                problems.found("store", str(error))
            daemon.say_health()
        if now - said_monitor >= MONITOR_PERIOD_S or not said_monitor:
            said_monitor = now
            problems.said("router", daemon.bus.without_router())
            document = maintenance.document(_known(daemon, listener, scheduler, heartbeats))
            # the sender's heartbeat is that this document leaves, whatever the history does
            daemon.say_monitor(document, done=lambda: heartbeats.beat("bus", PATIENCE_S))
            maintenance.write(document)
            notify(f"STATUS={status_line(daemon.health_state, document)}")
        watchdog.look()


def _known(daemon: Daemon, listener: Any, scheduler: Scheduler, heartbeats: Heartbeats) -> dict[str, Any]:
    """What the monitor's own document says beside what upkeep knows."""
    try:
        upcoming = scheduler.coming(1)
    except StoreError:  # told as trouble by whoever needs more of it than this
        upcoming = []
    return {
        "next_replay_due_unix_s": upcoming[0].opens_unix_s if upcoming else None,
        "next_replay_why": upcoming[0].why if upcoming else None,
        "lag_s": scheduler.lag_s,
        "arm": {"heard": listener.reachable, "trouble": listener.problem},
        "bus": daemon.bus.lengths(),
        "workers": heartbeats.ages_s(),
        "overrides": list(daemon.configuration.overrides),
    }


def reload(daemon: Daemon, scheduler: Scheduler, maintenance: Maintenance) -> None:
    """SIGHUP: the configuration once more; all of it is right, or nothing of it is taken."""
    reloading()
    try:
        found = reloaded(daemon.configuration, load(daemon.configuration.path))
    except BadConfiguration as error:
        log.error("reload refused, the old configuration stays: %s", error)
        maintenance.reload = {"at_unix_s": time.time(), "done": False, "told": str(error), "waiting": []}
    else:
        daemon.reconfigured(found.configuration)
        scheduler.reconsider()
        log.info("reloaded: %s", found.told)
        maintenance.reload = {"at_unix_s": time.time(), "done": True, "told": found.told, "waiting": list(found.waiting)}
    notify("READY=1")


def status_line(health: str | None, document: dict[str, Any]) -> str:
    """What `systemctl status` shows."""
    last, due = document["last_replay"], document["next_replay_due_unix_s"]
    parts = [
        health or "no replay assessed yet",
        f"last replay {last['replay']} {last['state']}" if last else "no replay yet",
        f"next {rfc3339(due)}" if due else "none scheduled",
        "arm heard" if document["arm"]["heard"] else "arm not heard",
    ]
    parts += [f"{trouble['name']}: {trouble['text']}" for trouble in document["troubles"] if trouble["name"] != "arm"]
    return "; ".join(parts).replace("\n", " ")[:500]
