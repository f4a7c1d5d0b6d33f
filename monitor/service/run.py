"""The process of `joint-monitor run`: signals, the history, the bus, worker threads, and the main loop. I/O."""

import logging
import os
import signal
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import NamedTuple

from monitor.acquire.listen import Listener, ListenSettings
from monitor.acquire.watch import Caller, ReplayProgress
from monitor.config.load import load
from monitor.config.schema import Configuration
from monitor.errors import BadConfiguration, StoreError, StoreUnavailable
from monitor.model.fourier import Excitation
from monitor.publish.session import log_refusals
from monitor.publish.timestamps import rfc3339
from monitor.reason import Sentence
from monitor.recording import Context, Recording
from monitor.service.computing import HERE, Apart
from monitor.service.daemon import Daemon
from monitor.service.history.assess_and_store import misfit
from monitor.service.housekeeping import Housekeeping
from monitor.service.main_loop import WORKER_PATIENCE_S, MainLoop, Reloader, Workers
from monitor.service.monitor_document import MonitorDocument
from monitor.service.motion import ReplayWindow, move, permit_by, progress_log
from monitor.service.node import NodeServer
from monitor.service.problems import Problems
from monitor.service.replay import Replay
from monitor.service.scheduler import Clocks, Scheduler
from monitor.service.shared_state import ReplayRequests
from monitor.service.systemd import Heartbeats, Watchdog, notify, reloading
from monitor.service.uploads import Stopping, Uploads
from monitor.store.store import Store

log = logging.getLogger(__name__)

MOTION_NO_LONGER_ALLOWED = Sentence("motion_no_longer_allowed", "allow_motion is no longer true")
DISK_WAIT_S = 5.0  # between two attempts to open a history whose disk is full or read-only


class Running(NamedTuple):
    """The daemon that `serve` has started, for whoever hands in its clock, or tells people of its alerts."""

    daemon: Daemon
    store: Store
    scheduler: Scheduler
    requests: ReplayRequests
    problems: Problems


def serve(
    configuration: Configuration,
    *,
    replay_now: bool = False,
    clocks: Clocks | None = None,
    play: Callable[[Replay], Replay] | None = None,
    running: Callable[[Running], AbstractContextManager[object]] | None = None,
) -> None:
    """Run until SIGTERM or SIGINT; SIGHUP reads the configuration again. A moving arm is stopped first.

    `replay_now` requests one replay at the start, whatever the schedule says. clocks : the host's where none are given. play : makes of
    a replay over RTDE how a recording is made; over RTDE where nothing is given. running : a context in which the daemon runs, made once
    it is ready.

    Raises StoreError or BusError where the daemon cannot start, BadConfiguration where the history cannot be continued with these settings,
    StoreError where it was found damaged while the daemon ran.
    """
    log_refusals(configuration.bus)
    hangup = _on_hangup()  # from now on no request for a reload is lost
    with ExitStack() as stack:
        store, configuration = open_store(configuration, stack, hangup)
        _check_fits(configuration, store)
        trial, clocks = clocks is not None, clocks or Clocks()
        requests, heartbeats, problems = ReplayRequests(), Heartbeats(), Problems(clocks.now)
        if replay_now:
            requests.request()

        def over_rtde(excitation: Excitation, context: Context, should_stop: Callable[[], bool], window: ReplayWindow, /) -> Recording:
            return _replay_over_rtde(daemon, store, excitation, context, should_stop, window)

        def alive() -> None:
            heartbeats.beat("replays", WORKER_PATIENCE_S)

        def gathered() -> None:
            heartbeats.beat("production", 10 * WORKER_PATIENCE_S)

        daemon = stack.enter_context(
            Daemon(
                configuration,
                store,
                now=clocks.now,
                play=over_rtde if play is None else play(over_rtde),
                requests=requests,
                alive=alive,
                compute=HERE if trial else Apart(alive),
                compute_production=HERE if trial else Apart(gathered),
            )
        )
        if configuration.metrics.listen:
            from monitor.publish.metrics import MetricsServer, families  # and with it a client of Prometheus and an HTTP server

            stack.enter_context(MetricsServer(configuration.metrics, lambda: families(daemon.bus.last_values())))
        if configuration.page.listen:
            from monitor.service.page import page  # and with it a web server

            stack.enter_context(page(configuration, daemon.bus, store, clocks.now, HERE if trial else Apart()))
        lent = configuration.replay.lent
        if lent is not None and lent.serves:
            stack.enter_context(NodeServer(lent, configuration.robot.host, store.directory, problems, driver=configuration.driver))
        _handle_signals(daemon.state.stopping)
        heartbeats.beat("bus", WORKER_PATIENCE_S)  # one that never sends its first document is missed as well
        scheduler = Scheduler(daemon.monitor, store, problems, requests, clocks)

        def sending() -> None:
            if daemon.state.stopping.is_set():
                raise Stopping

        apart = HERE if trial else Apart(sending)
        uploads = Uploads(store, lambda: daemon.state.configuration, problems, clocks.now, compute=apart)
        workers = Workers(
            scheduler=scheduler,
            housekeeping=Housekeeping(store, lambda: daemon.state.configuration.store, problems, clocks.now, uploads.observe),
            document=MonitorDocument(store, problems, clocks.now, trial=trial),
            reloader=Reloader(daemon.monitor, scheduler),
            problems=problems,
            heartbeats=heartbeats,
        )
        _start_threads(daemon, workers, uploads, alive, gathered, stack)
        if running is not None:
            stack.enter_context(running(Running(daemon, store, scheduler, requests, problems)))
        _watch(daemon, configuration, workers, hangup, stack)
        log.info("stopping")
        workers.document.write_end()
        if workers.housekeeping.damaged is not None:
            raise StoreError(
                f"{store.directory}: the history was found damaged: {workers.housekeeping.damaged}; the next start restores it"
            )


def open_store(configuration: Configuration, stack: ExitStack, hangup: threading.Event) -> tuple[Store, Configuration]:
    """The history, as soon as its disk takes it, and the settings then in force: `hangup` asks to read them again.

    A full or read-only disk is reported and waited for: nobody may be there to restart us. Raises StoreError where waiting would change
    nothing.
    """
    watchdog, reported = Watchdog(Heartbeats()), ""
    while True:
        try:
            return stack.enter_context(Store.open(configuration.state_directory)), configuration
        except StoreUnavailable as error:
            text = f"{error}{_beside_state_directory(configuration.state_directory)}"
            if text != reported:
                reported = text
                log.error("trouble=store: %s; waiting for it", reported, extra={"trouble": "store"})
            notify(f"READY=1\nSTATUS=waiting for the history, nothing is watched: {reported}")
            for _ in range(int(DISK_WAIT_S)):
                watchdog.check()
                if hangup.wait(1.0):
                    hangup.clear()
                    configuration = _reread(configuration)
                    break


def _reread(configuration: Configuration) -> Configuration:
    """The configuration once more, where nothing is in force yet that would have to stay; the old one where the new one is wrong."""
    reloading()
    try:
        found = load(configuration.path, reads_files=True)
    except BadConfiguration as error:
        log.error("reload refused, the old configuration stays: %s", error)
        return configuration
    log.info("reloaded while waiting for the history: all of it is taken")
    return found


def _beside_state_directory(directory: Path) -> str:
    """What to do where a service's history is not where the service may write."""
    state = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    if not state or directory.is_relative_to(state):
        return ""
    return f"; the unit may write below {state} alone: leave [store] directory out, or name it in ReadWritePaths="


def _check_fits(configuration: Configuration, store: Store) -> None:
    """Raises BadConfiguration where the history is of another model or reference speed: nothing could be learnt with it."""
    state = store.assessments.state()
    if state is not None:
        why = misfit(configuration, state.belief.get("robot"), state.belief.get("reference_speed_rad_s"))
        if why is not None:
            raise BadConfiguration(f"{store.directory}: {why}")


def _replay_over_rtde(
    daemon: Daemon, store: Store, excitation: Excitation, context: Context, should_stop: Callable[[], bool], window: ReplayWindow
) -> Recording:
    """One replay with the arm."""
    log_progress = progress_log()

    def on_progress(at: ReplayProgress) -> None:
        log_progress(at)
        if at.passed_by is not None:
            window.passed_by(at.passed_by)

    return move(
        daemon.state.configuration,
        store,
        excitation,
        context,
        caller=Caller(
            announce=lambda about: daemon.publisher.replay_announced(window.enter(), about),
            ask=permit_by(daemon.bus.ask_permit),
            should_stop=should_stop,
            forbidden=lambda: None if daemon.state.configuration.replay.allow_motion is True else MOTION_NO_LONGER_ALLOWED(),
            on_progress=on_progress,
        ),
        window=window,
        model=daemon.state.torque_model,
        compute=daemon.state.compute,
    )


def _on_hangup() -> threading.Event:
    """The event that SIGHUP sets."""
    hangup = threading.Event()
    _set_by(signal.SIGHUP, hangup)
    return hangup


def _handle_signals(stopping: threading.Event) -> None:
    """SIGTERM and SIGINT set `stopping`."""
    for number in (signal.SIGTERM, signal.SIGINT):
        _set_by(number, stopping)


def _set_by(number: signal.Signals, event: threading.Event) -> None:
    # from another thread: the main one may hold the event's own lock at the moment of the signal
    signal.signal(number, lambda *_: threading.Thread(target=event.set, daemon=True).start())


def _start_threads(
    daemon: Daemon, workers: Workers, uploads: Uploads, alive: Callable[[], None], gathered: Callable[[], None], stack: ExitStack
) -> None:
    """Start the threads of the scheduler, of housekeeping, of the archive and of ordinary work; leaving the stack stops and joins them."""
    stopping = daemon.state.stopping

    def maintained() -> None:
        workers.heartbeats.beat("upkeep", 10 * WORKER_PATIENCE_S)

    threads = [
        # one thread that lives as long as the service: a replay's child must not outlive the thread that started it
        threading.Thread(target=workers.scheduler.run, args=(stopping, alive), name="replays"),
        threading.Thread(target=workers.housekeeping.run, args=(stopping, maintained), name="upkeep"),
        threading.Thread(target=uploads.run, args=(stopping,), name="uploads"),
    ]
    if daemon.listener is not None:
        threads.append(threading.Thread(target=daemon.listener.run, args=(stopping, gathered), name="production"))
    for thread in threads:
        thread.start()
        stack.callback(thread.join)
    stack.callback(stopping.set)


def _watch(daemon: Daemon, configuration: Configuration, workers: Workers, hangup: threading.Event, stack: ExitStack) -> None:
    """Start receiving the arm's state, report that the service is ready, and run the main loop."""
    rate_hz = max(configuration.robot.listen_hz, configuration.bus.live_rate_hz)
    if configuration.production.listen:
        rate_hz = max(rate_hz, configuration.production.rate_hz)
    listener = Listener(ListenSettings(host=configuration.robot.host, rate_hz=rate_hz), configuration.driver)
    listener.start()
    stack.callback(listener.stop)
    notify("READY=1")
    if (prior := configuration.assess.drift.prior) is not None:
        log.info("joints begin with the prior of a fleet model=%s arms=%d digest=%s", prior.model, prior.arms, prior.digest)
    upcoming = workers.scheduler.coming(1)
    following = rfc3339(upcoming[0].opens_unix_s) if upcoming else "never"
    log.info("watching robot=%s host=%s next=%s", configuration.robot.id, configuration.robot.host, following)
    stack.callback(notify, "STOPPING=1\nSTATUS=stopping")
    errors = configuration.driver.errors(configuration.robot.host)
    stack.callback(errors.close)
    MainLoop(daemon, listener, workers, hangup, errors).run()
