"""The main thread: live comparison, the arm's state for the scheduler, periodic documents, reload, watchdog. I/O."""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pydantic import ValidationError

from monitor.acquire.driver import ErrorLink
from monitor.acquire.state import ROBOT_MODE_RUNNING
from monitor.config.load import load
from monitor.config.reload import reloaded
from monitor.errors import BadConfiguration, StoreError
from monitor.publish import documents
from monitor.publish.documents import Reload, worded
from monitor.publish.timestamps import utc
from monitor.reason import Sentence
from monitor.service.daemon import Daemon
from monitor.service.housekeeping import Housekeeping
from monitor.service.live import ArmLink, LiveFeed
from monitor.service.monitor_document import MonitorDocument, OfOthers, status_line
from monitor.service.problems import Problems
from monitor.service.replay import Monitor
from monitor.service.scheduler import Scheduler
from monitor.service.systemd import Heartbeats, Watchdog, notify, reloading

log = logging.getLogger(__name__)


class Reloader:
    """Reloads the configuration on request, and keeps the outcome of the last reload for the monitor's document."""

    def __init__(self, monitor: Monitor, scheduler: Scheduler) -> None:
        self._monitor, self._scheduler = monitor, scheduler
        self.outcome: Reload | None = None  # of the last reload; None before the first

    def reload(self) -> None:
        """Read the file once more. A mistake in it is logged, and the settings in force stay."""
        reloading()
        try:
            found = reloaded(self._monitor.configuration, load(self._monitor.configuration.path, reads_files=True))
        except BadConfiguration as error:
            log.error("reload refused, the old configuration stays: %s", error)
            self._keep(done=False, text=str(error))
        else:
            self._monitor.reconfigure(found.configuration)
            self._scheduler.reconsider()
            log.info("reloaded: %s", found.text)
            self._keep(done=True, text=found.text, waiting=found.waiting, held=found.held)
        notify("READY=1")

    def _keep(self, *, done: bool, text: str, waiting: Sequence[str] = (), held: Sequence[str] = ()) -> None:
        self.outcome = Reload(at=utc(time.time()), done=done, text=text, waiting=list(waiting), held=list(held))


WORKER_PATIENCE_S = 90.0  # a worker is late after this: an upload, a permit, an assessment on a busy machine take less
UNFIT = Sentence("document_unfit", "the document {document} is not published: {values} of its values do not fit it; the journal names them")
MONITOR_PERIOD_S = 10.0  # between two documents `monitor`


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """The parts that the loop calls, and the problems and heartbeats that they share."""

    scheduler: Scheduler
    housekeeping: Housekeeping
    document: MonitorDocument
    reloader: Reloader
    problems: Problems
    heartbeats: Heartbeats


class MainLoop:
    """Runs until the daemon stops or the history is found damaged."""

    def __init__(self, daemon: Daemon, link: ArmLink, workers: Workers, hangup: threading.Event, errors: ErrorLink | None = None) -> None:
        """`hangup` is set to request a reload. errors : None where nobody hears what the controller reports."""
        self._errors = errors
        self._daemon, self._link, self._workers, self._hangup = daemon, link, workers, hangup
        self._watchdog = Watchdog(workers.heartbeats)
        self._feed = LiveFeed(daemon.live, daemon.bus, link, daemon.listener, daemon.duty)
        self._health_at = self._monitor_at = 0.0  # monotonic; 0: not yet

    def run(self) -> None:
        """Until `stopping` is set, or housekeeping finds damage."""
        state = self._daemon.state
        while not self._feed.wait(state.stopping) and self._workers.housekeeping.damaged is None:
            self._feed.step()
            if self._errors is not None and state.configuration.inspection.wanted:
                self._daemon.duty.hear(self._errors.poll())
            self._observe()
            if self._hangup.is_set():
                self._hangup.clear()
                self._workers.reloader.reload()
                self._monitor_at = 0.0  # whoever asked for the reload looks at the STATUS line now
            now = time.monotonic()
            ended = state.replay_ended.is_set()
            if ended or now - self._monitor_at >= MONITOR_PERIOD_S or not self._monitor_at:
                state.replay_ended.clear()
                self._monitor_at = now
                self._look()
                self._guarded("duty", self._daemon.duty.step)
                self._guarded("monitor", self._publish_monitor)
            if now - self._health_at >= state.configuration.bus.health_period_s or not self._health_at:
                self._health_at = now
                self._guarded("health", self._daemon.publisher.health)
            self._watchdog.check()

    def _guarded(self, what: str, say: Callable[[], object]) -> None:
        """Say one document. One that its own model refuses is a fault of this program: it is told, and everything else goes on."""
        problems, name = self._workers.problems, f"document_{what}"
        try:
            say()
            problems.clear(name)
        except ValidationError as error:
            if name not in problems:
                log.exception("the document %s does not fit its model", what)
            problems.report(name, UNFIT(document=what, values=error.error_count()))
            self._workers.heartbeats.beat("bus", WORKER_PATIENCE_S)  # a restart would meet the same fault

    def _observe(self) -> None:
        """Hand the arm's state to the scheduler and to the problems."""
        link, problems = self._link, self._workers.problems
        newest = link.latest()
        self._workers.scheduler.observe(
            link.reachable and newest is not None and newest.robot_mode == ROBOT_MODE_RUNNING,
            None if newest is None or not link.reachable else tuple(newest.temperature_c.tolist()),
        )
        problems.update("arm", link.problem)
        try:
            self._daemon.heard.observe(link.reachable, link.problem)
        except StoreError as error:
            problems.report("store", error.reason)
        problems.update("restored", self._daemon.alerts.restored)
        problems.update("assessment", self._daemon.monitor.unassessed)

    def _look(self) -> None:
        """Look at the monitor itself: the alerts that it raises about itself. A clock that is not believed dates nothing."""
        problems = self._workers.problems
        if "clock" in problems:
            return
        try:
            problems.update("nothing_learnt", self._daemon.look())
        except StoreError as error:  # the next round tries again
            problems.report("store", error.reason)

    def _publish_monitor(self) -> None:
        workers, bus = self._workers, self._daemon.bus
        workers.problems.update("router", bus.without_router())
        document = monitor_document(self._daemon, self._link, workers)
        # the sender's heartbeat is that this document leaves, whatever the history does
        self._daemon.publisher.say(document, done=lambda: workers.heartbeats.beat("bus", WORKER_PATIENCE_S))
        workers.document.write(document)
        notify(f"STATUS={status_line(self._daemon.monitor.health_state, document)}")


def monitor_document(daemon: Daemon, link: ArmLink, workers: Workers) -> documents.Monitor:
    """The document `monitor`."""
    try:
        upcoming = workers.scheduler.coming(1)
    except StoreError:  # reported as a problem by those who need more of it than this
        upcoming = []
    due = daemon.state.due
    return workers.document.collect(
        OfOthers(
            reload=workers.reloader.outcome,
            next_replay_due=utc(upcoming[0].opens_unix_s) if upcoming else None,
            next_replay_why=upcoming[0].why if upcoming else None,
            due=None if due is None else due.document(),
            lag_s=workers.scheduler.lag_s,
            arm=documents.ArmLink(heard=link.reachable, **worded(trouble=link.problem)),
            bus=daemon.bus.waiting(),
            workers=workers.heartbeats.ages_s(),
            overrides=list(daemon.state.configuration.overrides),
        )
    )
