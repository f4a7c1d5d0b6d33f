"""Everything of `monitor` that the golden set touches, behind thin functions: after a restructuring only this file is adapted."""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import zenoh

import monitor
from monitor.cli import main as cli
from monitor.config.files import find_excitation
from monitor.config.load import load
from monitor.errors import MotionRefused, ReplayAborted
from monitor.identify.document import document as identification_document
from monitor.judge.alerts.health import alert_document
from monitor.judge.assess import assess
from monitor.judge.assessment import Assessment
from monitor.judge.belief import Belief
from monitor.judge.document import plain
from monitor.judge.friction.figures import found_wear
from monitor.judge.settings import AssessSettings
from monitor.publish.metrics import MetricsServer, families
from monitor.publish.session import session_config
from monitor.reason import reason_of
from monitor.recording import Recording
from monitor.service.daemon import Daemon
from monitor.service.housekeeping import Housekeeping
from monitor.service.main_loop import Reloader, Workers, monitor_document
from monitor.service.monitor_document import MonitorDocument
from monitor.service.page import page
from monitor.service.problems import Problems
from monitor.service.scheduler import Clocks, Scheduler
from monitor.service.shared_state import ReplayRequests
from monitor.service.systemd import Heartbeats
from monitor.simulate.controller.controller import Controller
from monitor.simulate.launch import settings_from
from monitor.simulate.scenario import scenario_from_document
from monitor.simulate.stepped import stepped_replay
from monitor.store.formats.recordings import read_recording, write_recording
from monitor.store.from_files.series import Series, dated, manifest
from monitor.store.store import Store
from monitor.studies.rehearsal.fleet import FleetSettings, Wear
from monitor.studies.rehearsal.rehearse import play as play_fleet

LOGGER = "monitor"  # the parent of every logger of the package


def command_line() -> None:
    """Be `joint-monitor` with what stands in `sys.argv`."""
    cli.main()


def package_folder() -> Path:
    """Whose code this is."""
    return Path(monitor.__file__).parent


# --- simulated arms ------------------------------------------------------------------------------------------------------


def simulated(robot: str, *, seed: int, mounting: str, scenario: dict[str, Any], name: str) -> Controller:
    """One simulated arm in its scenario; nothing has moved yet."""
    return Controller(settings_from(scenario_from_document(scenario, name, name), robot=robot, seed=seed, mounting=mounting))


def live_until(arm: Controller, lived_s: float) -> None:
    """Let the arm's life pass until so long after its scenario began; it may be there already."""
    if lived_s > arm.clock.lived_s:
        why = arm.pass_time((lived_s - arm.clock.lived_s) / 3600.0)
        assert not why, why


def replayed(arm: Controller, excitation: str) -> Recording:
    """One repetition of a shipped excitation, stepped."""
    return stepped_replay(arm, replace(find_excitation(excitation, Path()), repetitions=1))


def true_gains(arm: Controller) -> list[float]:
    """[N·m/A] of the simulated drives."""
    gains: list[float] = arm.arm.gain_nm_per_a.tolist()
    return gains


def said_of(recording: Recording, *, quality: dict[str, Any] | None = None, **context: Any) -> Recording:
    """The recording with further entries in its context and its quality."""
    changed = replace(recording.context, **context)
    return replace(recording, context=changed, quality={**recording.quality, **(quality or {})})


def keep(path: Path, recording: Recording) -> None:
    """As our Parquet."""
    write_recording(path, replace(recording, source=path.name))


def recording_of(path: Path) -> Recording:
    """From our Parquet."""
    return read_recording(path)


def told_of(recording: Recording) -> dict[str, Any]:
    """Signals, circumstances and quality."""
    return {
        "signals": dict(recording.signals),
        "context": asdict(recording.context),
        "quality": dict(recording.quality),
        "source": recording.source,
    }


# --- verdicts ------------------------------------------------------------------------------------------------------------


def judged(manifest_file: Path, config: Path) -> Iterator[dict[str, Any]]:
    """Every document behind the verdicts of one arm's recordings, each with the state that the one before left."""
    configuration = load(config)
    series = Series(entries=manifest(manifest_file), robot=configuration.robot_description, mounting=configuration.mounting)
    last: Assessment | None = None
    for recording, mounting in dated(series):
        outcome = assess(
            recording,
            robot=configuration.robot_description,
            mounting=mounting,
            belief=None if last is None else last.belief,
            health=None if last is None else last.health,
            model=None if last is None else last.model,
            gains=configuration.gains_nm_per_a,
            settings=configuration.assess,
        )
        if not isinstance(outcome, Assessment):
            yield {"file": recording.source, "rejected": outcome.reason}
            continue
        last = outcome
        yield {
            "file": recording.source,
            "assessment": outcome.as_document(),
            "friction": plain(outcome.friction),
            "transitions": [{"kind": transition.kind, **alert_document(transition.alert)} for transition in outcome.transitions],
            "identification": identification_document(outcome.identification),
            "belief": {**outcome.belief.as_document(), **_opened(outcome.belief)},
            "health": outcome.health.as_document(),
            "model": outcome.model.as_document(),
        }


def _opened(belief: Belief) -> dict[str, Any]:
    """The packed states of a belief by figures, without the covariances: a difference of these means something."""
    names = ("x", "p", "scale", "log_evidence", "odds", "peaks", "risen", "fell", "moved", "found", "replays", "slot")
    states = {"friction": belief.friction, **belief.beside}
    opened = {series: {name: plain(getattr(state, name)) for name in names} for series, state in states.items()}
    return {"friction": opened.pop("friction"), "beside": opened}


def small_fleet(*, arms: int, days: int, seed: int) -> dict[str, Any]:
    """A fleet in which one joint of each arm is damaged, judged day by day: the arrays of its verdicts."""
    none = np.zeros(arms)
    wear = Wear(joint=np.arange(arms) % 6.0, onset_day=none + 65.0, step=none + 0.06, per_day=none + 0.002)
    played = play_fleet(FleetSettings(arms=arms, days=days, seed=seed), AssessSettings(), wear, learning=40)
    names = ("tier_day", "falling_day", "common_day", "early", "covered", "covered_worn", "slope_error_per_k")
    arrays = {name: plain(getattr(played, name)) for name in names}
    return {**arrays, **dict(zip(("wear", "wear_std"), map(plain, found_wear(played.state.friction)), strict=True))}


# --- the daemon ----------------------------------------------------------------------------------------------------------


class Clock:
    """The daemon's, in the hand of whoever drives it; its two clocks go alike."""

    def __init__(self, unix_s: float) -> None:
        self.began_unix_s = self.unix_s = unix_s

    def now(self) -> float:
        """UTC."""
        return self.unix_s

    def monotonic(self) -> float:
        """The one that nobody sets."""
        return 1000.0 + self.unix_s - self.began_unix_s


def refused(why: str) -> Exception:
    """The exception of a guard that refuses a motion."""
    return MotionRefused(why)


def aborted(why: str, cause: str) -> Exception:
    """What ends a motion."""
    return ReplayAborted(why, cause)


@dataclass(frozen=True, slots=True, kw_only=True)
class Running:
    """A daemon that is under way, with everything that the service puts around it."""

    daemon: Daemon
    store: Store
    workers: Workers
    requests: ReplayRequests
    clock: Clock
    page_url: str | None

    def perform(self, window_unix_s: float) -> None:
        """One window."""
        self.daemon.monitor.perform(window_unix_s)

    def skip(self, window_unix_s: float, why: str) -> None:
        """One window that was missed."""
        self.daemon.monitor.skip(window_unix_s, reason_of(why))

    def tick(self) -> None:
        """The scheduler looks at its clocks, and has done what is due."""
        self.workers.scheduler.tick()

    def schedules(self) -> None:
        """From now on a scheduler serves what is requested, and what production gives reason for."""
        daemon = self.daemon
        daemon.state.requests = self.requests

    def observe_production(self, recording: Recording, row: int, heavier: Sequence[float]) -> None:
        """One sample of the arm at work: that of a recording, with so many times the current."""
        signals = {name: values[row] for name, values in recording.signals.items()}
        current = signals["current"] * np.array(heavier)
        self.daemon.live.sample(signals["q"], signals["qd"], signals["target_qdd"], current, signals["temperature_c"])

    def say(self, key: str, kind: str, document: dict[str, Any]) -> None:
        """Anything: who listens knows that all before it has arrived."""
        self.daemon.bus._enqueue((key, kind, json.dumps(document).encode(), False, None))

    def say_health(self) -> None:
        """As every minute."""
        self.daemon.look()
        self.daemon.publisher.health()

    def say_monitor(self) -> None:
        """As every ten seconds."""
        link = SimpleNamespace(reachable=True, problem=None)
        document = monitor_document(self.daemon, link, self.workers)  # type: ignore[arg-type]
        self.daemon.publisher.say(document)
        self.workers.document.write(document)

    def acknowledge(self, joint: int, by: str, why: str) -> None:
        """Acknowledge on the bus, whatever the alerts of the joint are."""
        health = self.daemon.state.health
        for alert in health.active_alerts if health else ():
            if alert.joint == joint:
                self.daemon.bus.ask("cmd/ack", {"joint": joint, "condition": alert.condition, "by": by, "why": why})

    def last_values(self) -> dict[str, Any]:
        """The last values by key, as a client that connects late gets them."""
        return {key: json.loads(payload) for key, payload in self.daemon.bus.last_payloads().items()}

    def announce(self, moves_at_unix_s: float) -> None:
        """Announce a motion, as before the arm moves."""
        self.daemon.publisher.replay(
            {"state": "announced", "replay": 1, "robot": "ur5", "moves_at_unix_s": moves_at_unix_s, "duration_s": 10.0}
        )

    def look_after(self) -> None:
        """Backup, retention, disk and clock."""
        self.workers.maintenance.check()


Play = Callable[[], Recording]
"""The next recording, or what ended its motion as an exception."""


@contextmanager
def running(config: Path, clock: Clock, play: Play) -> Iterator[Running]:
    """The daemon of a configuration with its bus, schedule, upkeep, page and metrics; every replay is had from `play`."""
    configuration = load(config)

    def had(_: Any, context: Any, *__: Any) -> Recording:
        recording = play()
        seen = {"firmware": recording.context.firmware, "serial": recording.context.serial}
        return replace(recording, context=replace(context, **seen))

    with ExitStack() as stack:
        store = stack.enter_context(Store.open(configuration.state_directory))
        daemon = stack.enter_context(Daemon(configuration, store, now=clock.now, play=had))
        if configuration.metrics.listen:
            stack.enter_context(MetricsServer(configuration.metrics, lambda: families(daemon.bus.last_values())))
        served = stack.enter_context(page(configuration, daemon.bus, store, now=clock.now))
        problems, requests = Problems(clock.now, clock.monotonic), ReplayRequests()
        scheduler = Scheduler(daemon.monitor, store, problems, requests, Clocks(now=clock.now, monotonic=clock.monotonic))
        workers = Workers(
            scheduler=scheduler,
            housekeeping=Housekeeping(store, lambda: daemon.state.configuration.store, problems, clock.now),
            document=MonitorDocument(store, problems, clock.now),
            reloader=Reloader(daemon.monitor, scheduler),
            problems=problems,
            heartbeats=Heartbeats(),
        )
        url = None if served is None else served.url
        yield Running(daemon=daemon, store=store, workers=workers, requests=requests, clock=clock, page_url=url)


def listener(endpoint: str) -> zenoh.Session:
    """A session of somebody else's on the daemon's bus."""
    return zenoh.open(session_config(mode="client", connect=(endpoint,)))


def key_prefix(config: Path) -> str:
    """Under which everything of an arm is found."""
    return load(config).key_prefix


@contextmanager
def log_lines(into: list[str]) -> Iterator[None]:
    """What the package logs meanwhile, without the names of its modules."""

    class Lines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            into.append(f"{record.levelname} {record.getMessage()}")

    logger, handler = logging.getLogger(LOGGER), Lines()
    level, propagates = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagates


def rows(recording: Recording, every: int) -> Sequence[int]:
    """Numbers of samples, evenly spaced."""
    numbers: list[int] = np.arange(0, recording.samples, every).tolist()
    return numbers
