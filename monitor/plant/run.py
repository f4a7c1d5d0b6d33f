"""The plant as a service: it runs until SIGTERM; a database or a router that is away is waited for. I/O.

Of several plants of one database one leads: it alone follows and copies. The others show the screen, and are ready to take over.
"""

import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from monitor import __version__
from monitor.errors import BadConfiguration, StoreError, StoreUnavailable
from monitor.plant.arm import ArmName
from monitor.plant.daily import Daily
from monitor.plant.database import PATIENCE_S, Database
from monitor.plant.follow import Following
from monitor.plant.ingest import RUNNING, set_note
from monitor.plant.links import Inbox, Link
from monitor.plant.lock import OnlyOne
from monitor.plant.priors import Learn, Priors
from monitor.plant.pull import Copying
from monitor.plant.settings import PlantConfiguration
from monitor.publish.session import BusSettings, log_refusals, read_as_session
from monitor.service.systemd import Heartbeats, StatusLine, Watchdog, notify
from monitor.store.disk import refuse_network

if TYPE_CHECKING:
    from monitor.plant.screen.app import ScreenServer
    from monitor.publish.metrics import MetricsServer

log = logging.getLogger(__name__)

TICK_S = 0.5
HEARTBEAT_S = 10.0  # between two notes that the plant runs
STANDBY_S = 2.0  # between two attempts to lead
KEY = 7_447_028  # of the advisory lock of the plant that leads
LONGEST_PAUSE_S = 60.0  # between two attempts to reach the database


class Plant:
    """One running plant. A context manager; `step` is called until it ends."""

    def __init__(self, configuration: PlantConfiguration, learn: Learn | None = None) -> None:
        """`learn` : makes the priors of new arms; None: none are made.

        Raises BadConfiguration, BadInput where database or Zenoh configuration are none, else as `errors.cannot_listen`.
        """
        settings = configuration.plant
        self.inbox, priors = Inbox(), Priors()
        self.links: dict[str, Link] = {}
        self.screen: ScreenServer | None = None
        self.trouble: str | None = "the database is not open yet"
        self.leads = False  # whether this plant follows and copies; else another one does
        with ExitStack() as opening:  # what is open is closed where the next one cannot be opened
            self.database = Database(configuration.database, patience_s=PATIENCE_S)
            opening.callback(self.database.close)
            self._lead = OnlyOne(self.database, "plant", KEY)
            opening.callback(self._lead.release)
            for endpoint in settings.connect:
                self.links[endpoint] = link = Link(endpoint, self.inbox, configuration.zenoh_file, answers=priors.answer)
                opening.callback(link.close)
            copying = opening.enter_context(Copying(self.database, self.links, settings.workers, time.time))
            self.following = Following(self.database, self.inbox, self.links, copying, settings.silent_s, time.time)
            if configuration.screen.listen:
                self.screen = opening.enter_context(_screen(configuration, self.database, self._ways))
            address, days = configuration.database, settings.identified_days
            opening.enter_context(Daily(self.database, address, days, learn, priors, lambda: self.leads and self.trouble is None))
            if configuration.metrics.listen:
                opening.enter_context(_metrics(configuration, self.database))
            self._stack = opening.pop_all()
        self._pause_s, self._next_try, self._heartbeat_at = 0.0, 0.0, 0.0
        self._began_unix_s = time.time()

    def __enter__(self) -> "Plant":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def step(self) -> None:
        """Take what has come, and write it. Raises StoreError where waiting for the database would change nothing."""
        trouble = self.following.receive()
        try:
            if trouble is not None and self.trouble is None:
                raise trouble
            if (self.trouble is not None or not self.leads) and time.monotonic() < self._next_try:
                return
            if not self.leads:
                self.database.make_folder()
            if not self._lead.take():
                self._stand_by()
                return
            begins = self.trouble is not None or not self.leads
            if begins:
                self._open()
                if not self.leads:
                    log.info("this plant leads")
                self.leads = True
            self.following.write()
            if begins or time.monotonic() - self._heartbeat_at >= HEARTBEAT_S:
                self._heartbeat()  # what can be read may still be locked: the trouble is over once a row is written
            if self.trouble is not None:
                self._answers()
        except StoreUnavailable as error:
            self._away(str(error))

    def _ways(self, name: ArmName) -> list[Link]:
        """The routers that answer and behind which an arm is; for the screen's threads."""
        arm = self.following.arms.get(name)
        return [] if arm is None else [self.links[each] for each in tuple(arm.ways) if self.links[each].up]

    def status(self) -> str:
        """The line that `systemctl status` shows."""
        counts = self.following.counts()
        lost = [endpoint for endpoint, link in self.links.items() if not link.up]
        parts = [f"WAITING FOR THE DATABASE, nothing is stored: {self.trouble}"] if self.trouble else []
        parts += ["STANDS BY: another plant leads"] if not self.leads and not self.trouble else []
        parts += [f"{counts.arms} arms, {counts.sick} sick, {counts.silent} silent"]
        parts += [f"{counts.copying} being copied"] if counts.copying else []
        parts += [f"{counts.problems} cannot be copied"] if counts.problems else []
        parts += [f"no answer from {', '.join(lost)}"] if lost else []
        return "; ".join([*parts, self.database.name])[:500]

    def _open(self) -> None:
        self.database.forget()
        self.database.migrate()
        self.following.look_again()

    def _stand_by(self) -> None:
        if self.leads or self.trouble is not None:
            log.info("another plant leads: this one shows the screen, and takes over when that one ends")
        self.leads, self.trouble, self._pause_s = False, None, 0.0
        self._next_try = time.monotonic() + STANDBY_S
        self.following.stand_by()
        if self.screen is not None:
            self.screen.screen.rest()

    def _answers(self) -> None:
        if self._pause_s:
            log.info("the database answers again: %s", self.database.name)
        self.trouble, self._pause_s = None, 0.0

    def _away(self, why: str) -> None:
        if self.trouble != why:
            log.error("trouble=database: %s; waiting for it", why, extra={"trouble": "database"})
        self.trouble = why
        self._pause_s = min(max(2.0 * self._pause_s, 1.0), LONGEST_PAUSE_S)
        self._next_try = time.monotonic() + self._pause_s

    def _heartbeat(self) -> None:
        self._heartbeat_at = time.monotonic()
        if self.screen is not None:
            self.screen.screen.rest()
        document = {
            "version": __version__,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started_at_unix_s": self._began_unix_s,
            "ways": {endpoint: link.up for endpoint, link in self.links.items()},
            "copying": self.following.counts().copying,
        }
        self.database.make_partitions_ahead(time.time())
        set_note(self.database, RUNNING, time.time(), document)
        self.following.look_again()


def _screen(configuration: PlantConfiguration, database: Database, ways: Callable[[ArmName], list[Link]]) -> "ScreenServer":
    """The screen, which a plant without one does not import: it takes a third of a second."""
    from monitor.plant.screen.app import ScreenServer

    return ScreenServer(configuration.screen, configuration.folder, database, ways)


def _metrics(configuration: PlantConfiguration, database: Database) -> "MetricsServer":
    """The figures for Prometheus, with a client of it that a plant without them does not load."""
    from monitor.plant.metrics import plant_families
    from monitor.publish.metrics import MetricsServer

    return MetricsServer(configuration.metrics, lambda: plant_families(database))


def check_files(configuration: PlantConfiguration) -> None:
    """Read the files that the configuration names. Raises BadInput where one cannot be read, or is not what it should be."""
    read_as_session(configuration.zenoh_file)
    if isinstance(configuration.database, Path):
        try:
            refuse_network(configuration.database.parent)
        except StoreError as error:
            raise BadConfiguration(error.reason) from None
    if (users := configuration.screen.users_path(configuration.folder)) is not None:
        from monitor.plant.screen.settings import read_users_file

        read_users_file(users)


def serve(configuration: PlantConfiguration, learn: Learn | None = None) -> None:
    """Run until SIGTERM or SIGINT. learn : as `Plant`. Raises BadInput where a file that the configuration names is wrong, StoreError."""
    check_files(configuration)
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    log_refusals(BusSettings(zenoh=configuration.zenoh_file))
    watchdog = Watchdog(Heartbeats())
    with Plant(configuration, learn) as plant:
        line = StatusLine()
        while not stopping.wait(TICK_S):
            plant.step()
            watchdog.check()
            status = plant.status()
            if line.say(status):
                log.info("running: %s", status)
        log.info("stopping")
        notify("STOPPING=1")
        try:
            plant.following.receive()
            if plant.leads and plant.trouble is None:
                plant.following.write()
        except StoreError as error:
            log.warning("what was heard last is not stored; the arms say it again: %s", error)
